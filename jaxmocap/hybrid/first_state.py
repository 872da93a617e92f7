"""The state at the first sample: the body come to rest on its markers, solved again and again.

INPUTS: a tracker, its first markers. OUTPUTS: a State.
"""

from collections.abc import Callable

import jax
import numpy as np

from jaxmocap.hybrid.scan import EVENTS
from jaxmocap.hybrid.tracker import HybridTracker, State

# It rests where the joints turn by less, radians.
SETTLED_RAD, MOST_SETTLING = 1e-3, 10


def settled(tracker: HybridTracker, markers_world: np.ndarray) -> State:
    """By the tracker's own steps, on (M, 3) markers in metres; NaN where missing."""
    tracker.prepare(len(markers_world))
    state, targets = tracker.init(markers_world), np.asarray(markers_world, tracker.dtype)
    for _ in range(MOST_SETTLING):
        ik = tracker.solve(
            tracker.skeleton, tracker.cameras, tracker.settings, state.pose, state.stance, targets
        ).ik
        turned = np.abs(np.asarray(ik.pose.angles) - np.asarray(state.pose.angles)).max()
        state = state._replace(pose=ik.pose, stance=ik.stance)
        if turned < SETTLED_RAD:
            break
    return state


def settled_at_once(
    tracker: HybridTracker, solve_all: Callable, markers_world: np.ndarray
) -> State:
    """The same by one scan over so many samples alike, which spares compiling the step.

    Args:
        tracker: whose state it is.
        solve_all: of the tracker's scans, compiled for ``EVENTS``.
        markers_world: (M, 3) metres; NaN where missing.
    """
    state = tracker.init(markers_world)
    alike = np.tile(np.asarray(markers_world, tracker.dtype), (EVENTS, 1, 1))
    shared = tracker.skeleton, tracker.cameras, tracker.settings
    ik = solve_all(*shared, (state.pose, state.stance), alike)[1].ik
    angles = np.concatenate([np.asarray(state.pose.angles)[None], np.asarray(ik.pose.angles)])
    rests = np.abs(np.diff(angles, axis=0)).max(1) < SETTLED_RAD
    rests[MOST_SETTLING - 1] = True
    pose, stance = jax.tree.map(lambda part: np.asarray(part)[rests.argmax()], (ik.pose, ik.stance))
    return state._replace(pose=pose, stance=stance)
