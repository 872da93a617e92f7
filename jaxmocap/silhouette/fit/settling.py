"""When segmentation and pose have settled: neither changes the other any more (section 5).

A new pose is another start of the segmentation, and new contours are another aim of the pose. The
paper iterates both until they converge.

INPUTS: poses and contours of two rounds, one after the other. OUTPUTS: whether they are the same.
"""

from collections.abc import Sequence

import numpy as np
from scipy.spatial import KDTree

from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.silhouette.first_pose import landmark_points
from jaxmocap.silhouette.fit.correspond import Contour

# A pose has settled where its landmarks move no farther in a round, on average, metres. What
# outlines hardly determine, as a hand's turn, moves on by more.
POSE_M = 0.001
# Contours have settled where their points lie no farther across those of the round before, on
# average, pixels.
CONTOUR_PX = 0.1


def has_settled(
    skeleton: Skeleton,
    poses: tuple[Pose, Pose],
    contours: tuple[Sequence[Contour], Sequence[Contour]],
) -> bool:
    """Whether poses and cameras' contours of a round are those of the round before."""
    here, there = (np.asarray(landmark_points(skeleton, pose)) for pose in poses)
    if np.linalg.norm(there - here, axis=1).mean() > POSE_M:
        return False
    return contours_apart(*contours) <= CONTOUR_PX


def contours_apart(before: Sequence[Contour], now: Sequence[Contour]) -> float:
    """Mean distance across the old contours of the new ones' points, pixels, of C cameras.

    Infinite where a camera shows the person in only one of the two; 0 where none does.
    """
    apart = []
    for old, new in zip(before, now, strict=True):
        if not len(old.pixels_xy) or not len(new.pixels_xy):
            if len(old.pixels_xy) or len(new.pixels_xy):
                return np.inf
            continue
        nearest = KDTree(old.pixels_xy).query(new.pixels_xy)[1]
        away = new.pixels_xy - old.pixels_xy[nearest]
        apart.append(np.abs(np.sum(away * old.normals[nearest], 1)))
    return float(np.mean(np.concatenate(apart))) if apart else 0.0
