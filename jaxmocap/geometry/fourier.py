"""Signals along curves and surfaces as matrices: Fourier series, low-pass, interpolation.

INPUTS: how many samples, and where values are wanted, in samples.
OUTPUTS: the matrix that takes the samples to the values (second paper, 3.1.4 and 3.1.5).

A transform followed by its inverse is one product with such a matrix: what is filtered often, or
made denser, keeps it.
"""

import numpy as np


def fourier_matrix(count: int, places: np.ndarray, harmonics: int | None = None) -> np.ndarray:
    """(P, count) that takes a periodic signal's samples to its values at ``places`` in [0, count).

    The inverse transform of the transform, (3.15), with all harmonics or the lowest few.
    """
    highest = count // 2 if harmonics is None else harmonics
    turns = 2 * np.pi / count * (places[:, None] - np.arange(count))
    waves = [np.cos(k * turns) for k in range(1, min(highest, (count - 1) // 2) + 1)]
    total = 1 + 2 * np.sum(waves, 0) if waves else np.ones_like(turns)
    if count % 2 == 0 and highest >= count // 2:
        total = total + np.cos(count / 2 * turns)
    return total / count


def linear_matrix(count: int, places: np.ndarray, periodic: bool = False) -> np.ndarray:
    """(P, count) of linear interpolation at ``places`` in [0, count - 1], or [0, count)."""
    low = np.floor(places).astype(int)
    low = low if periodic else np.clip(low, 0, count - 2)
    part = (places - low)[:, None]
    eye = np.eye(count)
    return (1 - part) * eye[low % count] + part * eye[(low + 1) % count]


def cosine_matrix(count: int, highest: int) -> np.ndarray:
    """(count, count) low-pass of a signal with ends: its mirrored continuation's lowest waves."""
    mirrored = np.concatenate([np.eye(count), np.eye(count)[::-1]])
    return fourier_matrix(2 * count, np.arange(count), highest) @ mirrored
