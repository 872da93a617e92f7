"""The generic body cut into rigid pieces with round ends, one for each bone, for viewers.

INPUTS: a Skeleton. OUTPUTS: a Solid in the frame of each bone that has flesh.

A viewer moves each piece by its bone's transform alone, so that every mesh is sent once. Where two
pieces meet, each ends in a round cap about their joint: a bent joint stays closed.
"""

from typing import NamedTuple

import numpy as np

from jaxmocap.body.skeleton import Skeleton
from jaxmocap.body.subject import rest_joints
from jaxmocap.body.surfaces.loft import (
    LoftedPart,
    lofted_parts,
    lofted_rings,
    ring_frames,
    stature_of,
)
from jaxmocap.body.surfaces.mesh import facing_outwards, grid_triangles, normals_of
from jaxmocap.geometry.solids import Solid, limb_solid

# Nodes of a ring, and rings of a cap.
AROUND, CAP_RINGS = 24, 6
# Metres between rings.
RING_M = 0.02


class Stretch(NamedTuple):
    """The part of a limb that one bone carries."""

    bone: str  # name
    first: float  # place of its first ring on the limb's bones laid end to end, as in the table
    last: float  # place of its last ring
    near_cap: bool  # whether it ends in a ball about the joint at ``first``, not with the surface
    far_cap: bool  # the same at ``last``


def body_pieces(skeleton: Skeleton) -> dict[str, Solid]:
    """Bone -> its piece, in the bone's frame; clavicles and hips have none.

    Bones that the table of cross-sections does not hold are plain limbs.
    """
    limbs, tree = lofted_parts(), skeleton.tree
    listed = {bone for limb in limbs for bone in (*limb.bones, limb.above) if bone}
    if not listed <= {*tree.bones}:
        return _plain_limbs(skeleton, list(tree.bones))
    joints, pieces = rest_joints(skeleton), {}
    fleshed = {bone for limb in limbs for bone in limb.bones}
    for limb in limbs:
        for stretch in stretches(limb, limb.above != "" and limb.above not in fleshed):
            vertices, triangles = _mesh(skeleton, limb, stretch)
            normals = normals_of(vertices, triangles)
            own = vertices - joints[tree.bone(stretch.bone)]
            pieces[stretch.bone] = Solid(own, normals, triangles)
    return _plain_limbs(skeleton, [bone for bone in tree.bones if bone not in listed]) | pieces


def stretches(limb: LoftedPart, in_trunk: bool) -> list[Stretch]:
    """A limb's stretches from its near end, cut at its bones' joints.

    Args:
        limb: of the table.
        in_trunk: it begins at its first joint, within the trunk's flesh; else with its first ring,
            as a foot does with its heel.
    """
    parts = []
    for k, bone in enumerate(limb.bones):
        near_cap, far_cap = k > 0 or in_trunk, k < len(limb.bones) - 1
        first, last = k if near_cap else limb.at[0], k + 1 if far_cap else limb.at[-1]
        parts.append(Stretch(bone, float(first), float(last), near_cap, far_cap))
    return parts


def _mesh(skeleton: Skeleton, limb: LoftedPart, stretch: Stretch) -> tuple[np.ndarray, np.ndarray]:
    """A stretch's vertices (V, 3) with all angles 0, from the pelvis, and triangles (F, 3)."""
    outer = np.array([stretch.first, stretch.last])
    ends, _, _ = ring_frames(skeleton, limb, outer, stature_of(skeleton))
    axis = ends[1] - ends[0]
    count = max(int(np.ceil(np.linalg.norm(axis) / RING_M)), 3)
    places = np.concatenate([outer[:1], np.linspace(stretch.first, stretch.last, count), outer[1:]])
    grid = lofted_rings(skeleton, limb, places, AROUND)
    near = _cap(grid[1], -axis)[::-1] if stretch.near_cap else grid[:1]
    far = _cap(grid[-2], axis) if stretch.far_cap else grid[-1:]
    grid = np.concatenate([near, grid[1:-1], far])
    vertices = np.concatenate([grid, grid[:, :1]], 1).reshape(-1, 3)
    return vertices, facing_outwards(vertices, grid_triangles(len(grid), AROUND))


def _cap(ring: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """(CAP_RINGS, U, 3) from a ring (U, 3) to a point along an axis (3,): half an ellipsoid."""
    centre = ring.mean(0)
    spokes = ring - centre
    height = np.linalg.norm(spokes, axis=-1).mean() * axis / np.linalg.norm(axis)
    lift = np.linspace(0, np.pi / 2, CAP_RINGS + 1)[1:, None, None]
    return centre + np.cos(lift) * spokes + np.sin(lift) * height


def _plain_limbs(skeleton: Skeleton, bones: list[str]) -> dict[str, Solid]:
    """The hull of two spheres about each of some bones."""
    reach = np.asarray(skeleton.lengths)[:, None] * np.asarray(skeleton.directions)
    radii, tree = np.asarray(skeleton.diameters) / 2, skeleton.tree
    return {bone: limb_solid(reach[tree.bone(bone)], radii[tree.bone(bone)]) for bone in bones}
