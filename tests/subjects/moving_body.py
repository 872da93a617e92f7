"""A motion through all of the joints' ranges, turning about and walking off."""

from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

from jaxmocap.body.motion import Motion
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton

HEIGHT, SAMPLES, RATE = 1.75, 60, 60.0


@cache
def moving_body() -> Motion:
    """A second of every joint between its limits, each at its own pace."""
    rng = np.random.default_rng(5)
    skeleton = Skeleton.human(HEIGHT, proportions="winter")
    low, high = np.asarray(skeleton.limits, float).T
    t = np.arange(SAMPLES) / RATE
    paces, starts = rng.uniform(3, 12, len(low)), rng.uniform(0, 6, len(low))
    angles = low + (high - low) * (0.5 + 0.5 * np.sin(np.outer(t, paces) + starts))
    turns = np.stack([4 * t - 2, 0.4 * np.sin(5 * t), 0.3 * np.cos(7 * t)], -1)
    quaternion = Rotation.from_euler("ZYX", turns).as_quat(scalar_first=True)
    position = np.stack([1.5 * t, np.sin(3 * t), 1.0 + 0.1 * t], -1)
    return Motion(skeleton, t, Pose(position, quaternion, angles))  # type: ignore[arg-type]


def with_parts(motion: Motion, times=None, position=None) -> Motion:
    """The motion with other times, or other places of the pelvis."""
    poses = motion.poses if position is None else motion.poses._replace(position=position)
    return Motion(motion.skeleton, motion.times if times is None else times, poses)
