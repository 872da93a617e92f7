"""Slices of trunk, arms and thighs, laid out as the skeleton is at rest: arms and legs hang.

INPUTS: a PersonModel, the person's skeleton and landmarks.
OUTPUTS: patch of the surface -> Slices; the generic surface's rings moved to them.

Every ring keeps its level and its nodes' angles about its middle; middle and radii become those
that were measured there. Beyond what was measured the last ratio to the generic ring is carried on,
so that nothing leaps where measured and generic parts meet.
"""

from typing import NamedTuple

import numpy as np

from jaxmocap.body.skeleton import Skeleton
from jaxmocap.body.subject import rest_joints
from jaxmocap.body.surfaces.loft import generic_surface
from jaxmocap.body.surfaces.surface import rest_nodes
from jaxmocap.silhouette.modelling.arm_surface import INNER_RINGS, hand_extent, slice_positions
from jaxmocap.silhouette.modelling.person import SIDES, PersonModel
from jaxmocap.silhouette.modelling.readings import superellipse_ring

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
    """Level slices of a limb at rest, from the pelvis, metres."""

    levels: np.ndarray  # (K,) heights, falling or rising
    # (K, N, 2) closed: ahead, and outwards (to the left on the trunk and the left).
    outlines: np.ndarray
    # Above the highest and below the lowest slice their ratio to a generic surface goes back to 1
    # within so much; infinite where it goes on.
    fades: tuple[float, float]


def measured_slices(
    model: PersonModel, skeleton: Skeleton, marks: dict[str, np.ndarray], spread: np.ndarray
) -> dict[str, BodySlices]:
    """Patch -> what was measured of it.

    ``marks`` are landmarks in the front view, world, metres; ``spread`` (2,) are the left and the
    right thigh there, radians.
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
    """Edges across a spread thigh are as far from its bone at rest."""
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


# A ring of less than this is the closed end of a limb, metres.
CLOSED_M = 1e-4
# Girth of the surface that exponents of girth are measured with.
STOUTER_GIRTH = 1.1


def fitted_grid(grid: np.ndarray, side: float, measured: BodySlices) -> np.ndarray:
    """(along, around, 3) the rings as they were measured; ``side`` is -1 on the right."""
    levels, phi = grid[:, 0, 2], 2 * np.pi * np.arange(grid.shape[1]) / grid.shape[1]
    middles, radii = _polar(grid[..., :2] * [1.0, side], phi)
    ratios, shifts = _ratios_and_shifts(levels, middles, radii, phi, measured)
    middles, radii = middles + shifts, radii * ratios
    across = middles[:, None] + radii[..., None] * np.stack([np.cos(phi), np.sin(phi)], -1)
    return np.concatenate([across * [1.0, side], grid[..., 2:]], -1)


def stoutness(skeleton: Skeleton, measured: dict[str, BodySlices]) -> float:
    """The girth at which a generic surface suits best what was measured, ring by ring."""
    joints, slopes, ratios = rest_joints(skeleton), [], []
    usual, stout = (generic_surface(skeleton, girth) for girth in (1.0, STOUTER_GIRTH))
    nodes, thick = rest_nodes(usual, joints), rest_nodes(stout, joints)
    for patch in usual.patches:
        if patch.name not in measured:
            continue
        grids = [patch.grid(n) for n in (nodes, thick)]
        low, high = np.sort(measured[patch.name].levels)[[0, -1]]
        within = (grids[0][:, 0, 2] > low) & (grids[0][:, 0, 2] < high)
        within[[0, -1]] = False
        new = fitted_grid(grids[0], patch.outwards, measured[patch.name])
        was, grown, now = (np.log(_size(grid[within])) for grid in (*grids, new))
        slopes.append((grown - was) / np.log(STOUTER_GIRTH))
        ratios.append(now - was)
    slope, ratio = np.concatenate(slopes), np.concatenate(ratios)
    return float(np.exp(slope @ ratio / (slope @ slope)))


def _size(grid: np.ndarray) -> np.ndarray:
    """(along,) mean of rings' half width and half depth."""
    return np.ptp(grid[..., :2], axis=1).mean(-1) / 2


def _ratios_and_shifts(
    levels: np.ndarray,
    middles: np.ndarray,
    radii: np.ndarray,
    phi: np.ndarray,
    measured: BodySlices,
) -> tuple[np.ndarray, np.ndarray]:
    """From generic to measured: ratios (along, around) of radii, shifts (along, 2) of middles."""
    order = np.argsort(measured.levels)
    heights, outlines = measured.levels[order], measured.outlines[order]
    there, around = _polar(outlines, phi)
    open_ = radii.min(1) > CLOSED_M
    within = open_ & (levels >= heights[0]) & (levels <= heights[-1])
    rows_within = np.flatnonzero(within)
    rows_within = rows_within[np.argsort(levels[rows_within])]
    at = levels[rows_within]
    result = [np.interp(at, heights, line) for line in np.concatenate([there, around], 1).T]
    result = np.stack(result, 1)
    change = np.concatenate(
        [result[:, :2] - middles[rows_within], result[:, 2:] / radii[rows_within] - 1], 1
    )
    carried = np.stack([np.interp(levels, at, line) for line in change.T], 1)
    (above, below) = measured.fades
    fade = 1 - np.clip(np.maximum((levels - at[-1]) / above, (at[0] - levels) / below), 0, 1)
    carried *= fade[:, None]
    return 1 + carried[:, 2:], carried[:, :2]


def _polar(outlines: np.ndarray, phi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Middles (K, 2) of closed outlines (K, N, 2), and radii (K, U) about them at angles (U,)."""
    middles = (outlines.max(1) + outlines.min(1)) / 2
    radii = np.zeros((len(outlines), len(phi)))
    for row, off in zip(radii, outlines - middles[:, None], strict=True):
        reach, angles = np.linalg.norm(off, axis=1), np.arctan2(off[:, 1], off[:, 0])
        order = np.argsort(angles)
        if reach.max() >= CLOSED_M:
            row[:] = np.interp(phi, angles[order], reach[order], period=2 * np.pi)
    return middles, radii
