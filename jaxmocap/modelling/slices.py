"""Slices of trunk, arms and thighs, laid out as the skeleton is at rest: arms and legs hang.

INPUTS: a PersonModel, the person's skeleton and landmarks.
OUTPUTS: patch of the surface -> Slices.
"""

from typing import NamedTuple

import numpy as np

from jaxmocap.body.skeleton import Skeleton
from jaxmocap.body.surfaces.loft import rest_joints
from jaxmocap.modelling.arm_surface import INNER_RINGS, hand_extent, slice_positions
from jaxmocap.modelling.person import SIDES, PersonModel
from jaxmocap.modelling.readings import superellipse_ring

# From here on along an arm (0 the shoulder, 1 the elbow) slices are as they were measured; nearer
# to the shoulder they run into the trunk.
ARM_MEASURED = 0.35
# Below the hips' joints the thighs are part of the trunk's slices.
NEVER = np.inf
# From the lowest slice of a thigh on its ratio to the generic surface fades to 1, metres.
THIGH_FADE_M = 0.15
# Power of a thigh's superellipse.
THIGH_FULLNESS = 2.0
# The highest slice of the trunk holds up to so much above it, metres.
CROWN_M = 0.01


class BodySlices(NamedTuple):
    """Level slices of a limb at rest, from the pelvis, metres.

    Attributes:
        levels: (K,) heights, falling or rising.
        outlines: (K, N, 2) closed: ahead, and outwards (to the left on the trunk and the left).
        fades: above the highest and below the lowest slice their ratio to a generic surface goes
            back to 1 within so much; infinite where it goes on.
    """

    levels: np.ndarray
    outlines: np.ndarray
    fades: tuple[float, float]


def measured_slices(
    model: PersonModel, skeleton: Skeleton, marks: dict[str, np.ndarray], spread: np.ndarray
) -> dict[str, BodySlices]:
    """Patch -> what was measured of it.

    Args:
        model: of the person.
        skeleton: of the person.
        marks: landmarks in the front view, world, metres.
        spread: (2,) of left and right thigh in the front view, radians.
    """
    pelvis = (marks["hip_l"] + marks["hip_r"]) / 2
    slices = {"torso": _trunk(model, pelvis)}
    for k, (side, _) in enumerate(SIDES):
        slices[f"arm_{side}"] = _arm(model, skeleton, k)
        if len(model.legs.heights):
            slices[f"leg_{side}"] = _leg(model, skeleton, marks[f"hip_{side}"], k, spread[k])
    return slices


def _trunk(model: PersonModel, pelvis: np.ndarray) -> BodySlices:
    """From the hips' joints up."""
    rings = model.trunk.rings - pelvis
    levels = rings[:, 0, 2]
    first = int(np.argmax(levels >= 0))
    # The last slice lies a little below the top of the head.
    levels = np.append(levels[first:], levels[-1] + CROWN_M)
    outlines = np.concatenate([rings[first:, :, :2], rings[-1:, :, :2]])
    return BodySlices(levels, outlines, (NEVER, NEVER))


def _arm(model: PersonModel, skeleton: Skeleton, k: int) -> BodySlices:
    """What looks ahead of a stretched arm does so of a hanging one, what looks up, outwards."""
    joints, tree, (side, sign) = rest_joints(skeleton), skeleton.tree, SIDES[k]
    ends = joints[tree.bones_in("arm", side=side)]
    hand = hand_extent(model.bent[k])
    at, rings = slice_positions(), model.arms[k][INNER_RINGS:] - model.bent[k].shoulder
    kept = at >= ARM_MEASURED
    levels = np.interp(at, np.arange(4.0), np.append(ends[:, 2], ends[2, 2] - hand))
    outlines = rings[..., [0, 2]] + ends[0, :2] * [1.0, sign]
    return BodySlices(levels[kept], outlines[kept], (NEVER, NEVER))


def _leg(
    model: PersonModel, skeleton: Skeleton, hip: np.ndarray, k: int, spread: float
) -> BodySlices:
    """Edges seen across a spread thigh are as far from its bone at rest."""
    legs, sign = model.legs, SIDES[k][1]
    joint = rest_joints(skeleton)[skeleton.tree.bone(f"femur_{SIDES[k][0]}")]
    down = hip[2] - legs.heights
    bone = hip[1] + np.tan(spread) * down
    right, left = ((legs.across[:, k] - bone[:, None]) * np.cos(spread)).T
    inner, outer = (right, left) if sign > 0 else (-left, -right)
    back, front = (legs.deep - hip[0]).T
    ahead, out = (front, back, back, front), (outer, outer, inner, inner)
    corners = np.stack([ahead, out], -1).swapaxes(0, 1) + joint[:2] * [1.0, sign]
    outlines = np.stack([superellipse_ring(each, THIGH_FULLNESS) for each in corners])
    return BodySlices(joint[2] - down / np.cos(spread), outlines, (NEVER, THIGH_FADE_M))
