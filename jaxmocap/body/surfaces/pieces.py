"""The generic body cut into rigid pieces with round ends, one for each bone, for viewers.

INPUTS: a Skeleton. OUTPUTS: a Solid in the frame of each bone that has flesh.

A viewer moves each piece by its bone's transform alone, so that every mesh is sent once. Where two
pieces meet, each ends in a round cap about their joint: a bent joint stays closed.
"""

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
        in_trunk = limb.above != "" and limb.above not in fleshed
        for k, bone in enumerate(limb.bones):
            vertices, triangles = _mesh(skeleton, limb, k, in_trunk)
            normals = normals_of(vertices, triangles)
            pieces[bone] = Solid(vertices - joints[tree.bone(bone)], normals, triangles)
    return _plain_limbs(skeleton, [bone for bone in tree.bones if bone not in listed]) | pieces


def _mesh(
    skeleton: Skeleton, limb: LoftedPart, k: int, in_trunk: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V, 3) that a bone carries, all angles 0, from the pelvis, and triangles (F, 3).

    It ends in balls about the bone's joints; at the limb's own ends with the surface.

    Args:
        skeleton: of the person.
        limb: of the table.
        k: which of its bones.
        in_trunk: it begins at its first joint, within the trunk's flesh; else with its first ring,
            as a foot does with its heel.
    """
    near_cap, far_cap = k > 0 or in_trunk, k < len(limb.bones) - 1
    outer = np.array([k if near_cap else limb.at[0], k + 1 if far_cap else limb.at[-1]], float)
    ends, _, _ = ring_frames(skeleton, limb, outer, stature_of(skeleton))
    axis = ends[1] - ends[0]
    count = max(int(np.ceil(np.linalg.norm(axis) / RING_M)), 3)
    places = np.concatenate([outer[:1], np.linspace(outer[0], outer[1], count), outer[1:]])
    grid = lofted_rings(skeleton, limb, places, AROUND)
    near = _cap(grid[1], -axis)[::-1] if near_cap else grid[:1]
    far = _cap(grid[-2], axis) if far_cap else grid[-1:]
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
