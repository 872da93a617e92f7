"""Markers that a device repeats while it has lost them: their last place, over and over.

A place that was measured differs from the one before in its last digits, even at rest. What stops
from one sample to the next and then repeats to the last digit was not measured. Left alone are
markers that come to rest smoothly, such as an animation's, and coarse ones, which repeat at rest.

INPUTS: sample by sample a time in seconds and positions (M, 3) in metres, NaN where missing.
OUTPUTS: which of the M markers are frozen.
"""

from typing import NamedTuple

import numpy as np

# A marker repeats itself for so long, seconds, and for so many samples,
FROZEN_S, FROZEN_SAMPLES = 0.25, 5
# having moved until then: its two newest steps are not far below the median of those before.
RECENT_STEPS, NEWEST_STEPS = 8, 2
LEAST_RATIO = 0.5
# Coordinates whose smallest step is larger, metres, are coarse.
FINEST_STEP_M = 5e-5


class FrozenState(NamedTuple):
    """What there is to remember of each of M markers."""

    positions: np.ndarray  # (M, 3) metres, the newest ones; NaN before the first
    since: np.ndarray  # (M,) seconds, when it came there
    repeats: np.ndarray  # (M,) how often it has repeated it
    steps: np.ndarray  # (M, RECENT_STEPS) metres, before it came to rest; the newest is the last
    finest: np.ndarray  # (M,) metres, the smallest step of a coordinate that is not 0


def initial_state(count: int) -> FrozenState:
    """The state before the first sample of ``count`` markers."""
    return FrozenState(
        np.full((count, 3), np.nan),
        np.full(count, np.nan),
        np.zeros(count, int),
        np.zeros((count, RECENT_STEPS)),
        np.full(count, np.inf),
    )


def frozen_step(
    state: FrozenState, time: float, positions: np.ndarray
) -> tuple[FrozenState, np.ndarray]:
    """The state after a sample (M, 3), and which (M,) markers are frozen in it."""
    is_present = np.isfinite(positions).all(-1)
    moves = is_present & (positions != state.positions).any(-1)
    repeats = np.where(moves, 0, state.repeats + is_present)
    steps, finest = state.steps, state.finest
    if moves.any():
        change = np.abs(positions - state.positions)
        is_step = moves & np.isfinite(state.since)
        smallest = np.min(np.where(change > 0, change, np.inf), -1)
        finest = np.where(is_step, np.minimum(finest, smallest), finest)
        longer = np.concatenate([steps[:, 1:], np.linalg.norm(change, axis=-1)[:, None]], -1)
        steps = np.where(is_step[:, None], longer, steps)
    state = FrozenState(
        np.where(moves[:, None], positions, state.positions),
        np.where(moves, time, state.since),
        repeats,
        steps,
        finest,
    )
    is_frozen = is_present & (repeats >= FROZEN_SAMPLES) & (time - state.since >= FROZEN_S)
    # Seldom is there anything to look at.
    return state, is_frozen & _stops_at_once(steps, finest) if is_frozen.any() else is_frozen


def _stops_at_once(steps: np.ndarray, finest: np.ndarray) -> np.ndarray:
    """(M,) whether markers stop abruptly, and are not coarse, after (M, RECENT_STEPS) metres."""
    before = np.median(steps[:, :-NEWEST_STEPS], -1)
    newest = steps[:, -NEWEST_STEPS:].max(-1)
    return (before > 0) & (newest >= LEAST_RATIO * before) & (finest <= FINEST_STEP_M)


def find_frozen(times: np.ndarray, positions: np.ndarray, causal: bool = False) -> np.ndarray:
    """(T, M) frozen samples of (T, M, 3): from the first repeat on, as ``frozen_step``'s if causal.

    Marker by marker: sample by sample a long recording would take seconds.
    """
    frozen = np.zeros(positions.shape[:2], bool)
    for marker in range(positions.shape[1]):
        rows = np.flatnonzero(np.isfinite(positions[:, marker]).all(-1))
        if not len(rows):
            continue
        path = positions[rows, marker]
        # Where runs of equal places begin, and where the next one does.
        begins = np.flatnonzero(np.r_[True, (path[1:] != path[:-1]).any(-1)])
        ends = np.r_[begins[1:], len(rows)]
        lasting = times[rows[ends - 1]] - times[rows[begins]]
        is_long = (ends - begins > FROZEN_SAMPLES) & (lasting >= FROZEN_S)
        if not is_long.any():
            continue
        change = np.abs(np.diff(path[begins], axis=0))
        smallest = np.min(np.where(change > 0, change, np.inf), -1)
        finest = np.minimum.accumulate(smallest)
        steps = np.linalg.norm(change, axis=-1)
        for run in np.flatnonzero(is_long & (np.arange(len(begins)) >= RECENT_STEPS)):
            if _stops_at_once(steps[None, run - RECENT_STEPS : run], finest[run - 1]).all():
                repeats = rows[begins[run] + 1 : ends[run]]
                if causal:
                    since = times[repeats] - times[rows[begins[run]]]
                    repeats = repeats[FROZEN_SAMPLES - 1 :][since[FROZEN_SAMPLES - 1 :] >= FROZEN_S]
                frozen[repeats, marker] = True
    return frozen
