"""For how long markers have been missing, and how far one camera may drift meanwhile.

A camera tells little of how far away a person is: clothes are thicker than what is drawn, and an
arm looks alike ahead of the body and behind it. What follows is along the line of sight.

INPUTS: a Model, the markers of each step. OUTPUTS: seconds without; deviations that grow.
"""

import numpy as np
from jax import Array

from jaxmocap.body.arms import SIDES
from jaxmocap.body.model import Model
from jaxmocap.body.skeleton import landmark_rows
from jaxmocap.smoothing.window.track import LONGEST_INTERVAL_S

# Elbow, wrist and hand's tip of either side.
ARM_LANDMARKS = np.stack(
    [landmark_rows([f"{p}_{s}" for p in ("elbow", "wrist", "hand")]) for s in "lr"]
)
# Beyond ``LONGEST_INTERVAL_S`` the standard deviation of how far away a landmark is grows by so
# much, metres per second, and for so many seconds at most. By five rendered clips with gaps of up
# to a second; 90 % intervals of three others hold 78 to 94 %, of four real cameras 62 to 88 %.
DRIFT_M_S, DRIFT_S = 0.45, 1.0


class MarkerGaps:
    """Seconds since markers were measured last."""

    def __init__(self, model: Model):
        """Of a person with M markers; none was measured yet."""
        tree, bones = model.skeleton.tree, model.markers.bones
        arms = [np.isin(bones, tree.bones_in("arm", side=side)) for side in SIDES]
        # Which markers (3, M) are on the left arm, the right one, the body.
        self._on = np.stack([*arms, np.ones_like(arms[0])])
        self._last = np.full(3, np.nan)

    def step(self, time: float, markers_world: np.ndarray | Array) -> np.ndarray:
        """(3,) seconds of the left arm, the right one, the body; 0 of what had no marker so far.

        Args:
            time: of a step, seconds.
            markers_world: (M, 3) metres; NaN where missing.
        """
        are_there = np.isfinite(np.asarray(markers_world)).all(-1)
        self._last[(self._on & are_there).any(1)] = time
        return np.nan_to_num(time - self._last)


def are_missing(seconds: np.ndarray) -> np.ndarray:
    """Whether markers are missing for so many seconds (...), or just come slowly."""
    return seconds > LONGEST_INTERVAL_S


def add_drift(
    deviations: np.ndarray, seconds: np.ndarray, person: np.ndarray, camera: np.ndarray
) -> np.ndarray:
    """Deviations (L, 3) of landmarks, metres, with what one camera may drift by.

    Args:
        deviations: as long as markers are measured.
        seconds: (3,) of ``MarkerGaps``.
        person: (3,) where somebody is, world, metres.
        camera: (3,) where the camera is.
    """
    away = person - camera
    each = np.full(len(deviations), seconds[2])
    each[ARM_LANDMARKS] = np.maximum(seconds[:2, None], seconds[2])
    drift = DRIFT_M_S * np.clip(each - LONGEST_INTERVAL_S, 0.0, DRIFT_S)
    return np.hypot(deviations, drift[:, None] * away / np.linalg.norm(away))
