"""A recording roughly: some of its events stand for all, while it is still unclear where all is.

INPUTS: events, settings. OUTPUTS: which events, settings by which they weigh like all of them; the
motion in between.
"""

from dataclasses import replace
from itertools import pairwise

import numpy as np
from scipy.interpolate import CubicSpline

from jaxmocap.body.pose import Pose
from jaxmocap.hybrid.smoothing_settings import SmoothingSettings
from jaxmocap.hybrid.trajectory import Trajectory

# Frames of a camera that are looked at lie so far apart, events without one at least as far.
SPARSE_S, BRIDGING_S = 0.045, 0.045
# Where it stands in a packed pose.
QUATERNION = slice(3, 7)


def some_events(times: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Which (e,) of E events stand for all.

    Args:
        times: (E,) seconds.
        seen: (E, C) whether the event has a frame of each camera.
    """
    chosen = [_apart(np.flatnonzero(of_camera), times, SPARSE_S) for of_camera in seen.T]
    rows = np.unique(np.concatenate([*chosen, [0, len(times) - 1]]))
    bridges = [
        first + _apart(np.arange(last - first), times[first:last], BRIDGING_S)
        for first, last in pairwise(rows)
        if times[last] - times[first] > 2 * BRIDGING_S
    ]
    return np.unique(np.concatenate([rows, *bridges]))


def _apart(rows: np.ndarray, times: np.ndarray, seconds: float) -> np.ndarray:
    """Those (k,) of some rows whose times lie at least so far apart."""
    kept: list[int] = []
    for row in rows:
        if not kept or times[row] - times[kept[-1]] >= seconds:
            kept.append(row)
    return np.array(kept, int)


def standing_for_all(settings: SmoothingSettings, events: float, looks: float) -> SmoothingSettings:
    """Settings by which some events are told as they would be among all of them.

    Each stands for several, against which a motion's calmness weighs as before; a sight stands for
    fewer than an event does.

    Args:
        settings: for all events.
        events: share of the events that is left.
        looks: share of the sights.
    """
    fewer = looks / events
    return replace(
        settings,
        acceleration=settings.acceleration / np.float32(np.sqrt(events)),
        silhouette=settings.silhouette * np.float32(np.sqrt(fewer)),
        goal=settings.goal * np.float32(np.sqrt(fewer)),
        keypoints=settings.keypoints * np.float32(np.sqrt(fewer)),
        proportions=settings.proportions / np.float32(fewer),
    )


def at_all_events(times: np.ndarray, rows: np.ndarray, found: Trajectory) -> Trajectory:
    """The motion of E events through some of their poses.

    Args:
        times: (E,) seconds.
        rows: (e,) which events, the first and the last of all among them.
        found: e poses.
    """
    if len(rows) == len(times):
        return found
    path = np.concatenate([np.asarray(part, float) for part in found.poses], -1)
    # The same rotation is two quaternions.
    q = path[:, QUATERNION]
    q[1:] *= np.cumprod(np.where(np.sum(q[1:] * q[:-1], 1) < 0, -1, 1))[:, None]
    path = CubicSpline(times[rows], path)(times)
    path[:, QUATERNION] /= np.linalg.norm(path[:, QUATERNION], axis=1, keepdims=True)
    ends = QUATERNION.start, QUATERNION.stop
    parts = (part.astype(found.poses.angles.dtype) for part in np.split(path, ends, 1))
    return found._replace(poses=Pose._make(parts))
