"""The One Euro filter: smooth at rest, prompt in motion, no look-ahead.

After G. Casiez, N. Roussel and D. Vogel, "1 € Filter: A Simple Speed-based Low-pass Filter for
Noisy Input in Interactive Systems", CHI 2012. The cut-off follows a marker's speed in space, not
each coordinate's, so that it does not depend on the axes.

INPUTS: sample by sample a time in seconds and positions (M, 3) in metres, NaN where missing.
OUTPUTS: positions (M, 3), NaN where missing.
"""

from typing import NamedTuple

import numpy as np

from jaxmocap.formats.recordings.filters import OneEuroSettings

# The speed is low-passed here, Hz. The paper's 1 Hz lets a stroke run ahead by 13 mm before its
# speed is believed; so it is 4 mm.
SPEED_CUTOFF_HZ = 5.0
# A marker missing for longer starts again, seconds.
FORGET_AFTER_S = 0.2


class OneEuroState(NamedTuple):
    """What the filter remembers of each marker."""

    times: np.ndarray  # (M,) seconds of its last position; NaN before
    positions: np.ndarray  # (M, 3) metres, filtered, then
    velocities: np.ndarray  # (M, 3) metres per second, low-passed, then


def initial_state(count: int) -> OneEuroState:
    """The state before the first sample of ``count`` markers."""
    unknown = np.full((count, 3), np.nan)
    return OneEuroState(np.full(count, np.nan), unknown, np.zeros((count, 3)))


def filter_step(
    settings: OneEuroSettings, state: OneEuroState, time: float, positions: np.ndarray
) -> tuple[OneEuroState, np.ndarray]:
    """Filter one sample.

    Args:
        settings: the filter's two parameters.
        state: after the sample before.
        time: seconds; a sample that is not later than the one before is given back unfiltered.
        positions: (M, 3) metres; NaN where missing.

    Returns:
        The state after it, and the (M, 3) filtered positions.
    """
    positions = np.asarray(positions, float)
    is_present = np.asarray(np.isfinite(positions).all(-1))
    elapsed = time - state.times
    is_continued = is_present & (elapsed > 0) & (elapsed <= FORGET_AFTER_S)
    step = np.where(is_continued, elapsed, 1.0)[:, None]
    last = np.where(is_continued[:, None], state.positions, positions)
    raw_velocities = np.where(is_continued[:, None], (positions - last) / step, 0.0)
    started = np.where(is_continued[:, None], state.velocities, 0.0)
    velocities = started + _smoothing_factor(SPEED_CUTOFF_HZ, step) * (raw_velocities - started)
    speed = np.linalg.norm(velocities, axis=-1, keepdims=True)
    share = _smoothing_factor(settings.cutoff + settings.beta * speed, step)
    filtered = last + share * (positions - last)
    row = is_present[:, None]
    new_state = OneEuroState(
        np.where(is_present, time, state.times),
        np.where(row, filtered, state.positions),
        np.where(row, velocities, state.velocities),
    )
    return new_state, np.where(row, filtered, np.nan)


def _smoothing_factor(cutoff: np.ndarray | float, step: np.ndarray) -> np.ndarray:
    """How far a first-order low-pass goes towards a new value after ``step`` seconds."""
    return 1.0 / (1.0 + 1.0 / (2 * np.pi * np.asarray(cutoff) * step))
