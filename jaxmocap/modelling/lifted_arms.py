"""Slightly lifted arms of the front view: where their joints are.

Beside the trunk every row of the silhouette crosses the arm; the middles of the crossings are its
way, on which the bones are laid.

INPUTS: the front View, its landmarks, the arms' joints in the joint view. OUTPUTS: Bones.
"""

import numpy as np
from scipy.ndimage import gaussian_filter1d

from jaxmocap.modelling.arm_surface import ArmBones
from jaxmocap.modelling.pictures.views import PhotographView
from jaxmocap.modelling.separation import FrontLandmarks, trunk_run

# Deviation of the blur over the middles of an arm's rows.
SMOOTH_ROWS = 3.0
# The world's unit vector that the person faces.
AHEAD = np.array([1.0, 0.0, 0.0])


def lifted_arms(
    front: PhotographView, landmarks: FrontLandmarks, bent: tuple[ArmBones, ...]
) -> tuple[ArmBones, ...]:
    """Left and right arm in the front view, in the plane through their shoulders."""
    return tuple(
        _lifted(front, pit, side, bones)
        for pit, side, bones in zip(landmarks.pits, (1, -1), bent, strict=True)
    )


def _lifted(front: PhotographView, pit: np.ndarray, side: int, bones: ArmBones) -> ArmBones:
    """Of an arm on the right (1) or left (-1) of the image."""
    middles, outer = [], float(pit[0])
    for row in range(int(pit[1]) + 1, len(front.mask)):
        columns = np.flatnonzero(front.mask[row])
        beyond = columns[side * (columns - outer) > 0]
        if len(beyond) == 0:
            break
        first, last = trunk_run(front.mask, row, float(beyond[np.argmin(side * beyond)]))
        middles.append(((first + last) / 2, row))
        # The gap beside the trunk widens downwards with the arm.
        outer = max(outer, first - 1) if side > 0 else min(outer, last + 1)
    if not middles:
        raise ValueError("found no arm beside the trunk, expected arms lifted off the trunk")
    way = gaussian_filter1d(np.array(middles), SMOOTH_ROWS, axis=0, mode="nearest")
    places = front.plane_points(way, bones.shoulder, AHEAD)
    ends, after = [bones.shoulder], 0
    for length in bones.lengths:
        far = np.linalg.norm(places[after:] - ends[-1], axis=1)
        after += int(np.argmin(np.abs(far - length)))
        towards = places[after] - ends[-1]
        ends.append(ends[-1] + length * towards / np.linalg.norm(towards))
    return ArmBones(*ends)
