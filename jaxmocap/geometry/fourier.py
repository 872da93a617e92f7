"""Signals along curves and surfaces: Fourier series, low-pass, interpolation.

INPUTS: samples, or how many, and where values are wanted.
OUTPUTS: Fourier descriptors of samples, values by them; the matrix that takes samples to values
(second paper, 3.1.4 and 3.1.5).

A transform followed by its inverse is one product with such a matrix: what is filtered often, or
made denser, keeps it.
"""

import numpy as np


def phase_vectors(samples: np.ndarray) -> np.ndarray:
    """Fourier descriptors p_k of a periodic signal's samples (M, D), as of (3.14).

    Returns:
        (N + 1, D) complex, of frequencies 0 to N = M // 2: those of a real signal's negative
        frequencies are their conjugates.
    """
    vectors = np.fft.rfft(samples, axis=0) / len(samples)
    if len(samples) % 2 == 0:
        # The highest stands for itself and its negative.
        vectors[-1] /= 2
    return vectors


def fourier_series(
    vectors: np.ndarray, phases: np.ndarray, harmonics: int | None = None
) -> np.ndarray:
    """(P, D) a signal's values at phases (P,), radians, by its ``phase_vectors``: (3.15).

    With all frequencies, or the lowest few: a low-pass approximation.
    """
    highest = len(vectors) - 1 if harmonics is None else min(harmonics, len(vectors) - 1)
    waves = np.exp(1j * phases[:, None] * np.arange(1, highest + 1))
    return np.real(vectors[0]) + 2 * np.real(waves @ vectors[1 : highest + 1])


def fourier_matrix(count: int, places: np.ndarray, harmonics: int | None = None) -> np.ndarray:
    """(P, count) that takes a periodic signal's samples to its values at ``places`` in [0, count).

    The inverse transform of the transform, (3.15), with all harmonics or the lowest few.
    """
    return fourier_series(phase_vectors(np.eye(count)), 2 * np.pi / count * places, harmonics)


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
