"""A mesh that an armature's joints carry, as glTF holds it; the limbs' where there is no surface.

INPUTS: an Armature. OUTPUTS: a SkinnedMesh, in the armature's axes.
"""

from dataclasses import dataclass, replace

import numpy as np

from jaxmocap.formats.armatures.armature import Armature, joint_positions
from jaxmocap.geometry.solids import limb_solid

# Radius of a limb whose girth is unknown, as a share of its length.
DEFAULT_RADIUS_SHARE = 0.12
# At most this radius, metres.
MAX_DEFAULT_RADIUS_M = 0.05
SHORTEST_LIMB_M = 1e-4


@dataclass(frozen=True)
class SkinnedMesh:
    """V vertices and F triangles on J joints.

    Attributes:
        vertices: (V, 3) where they are bound, metres.
        normals: (V, 3) unit, outward.
        triangles: (F, 3) of vertices, counter-clockwise as seen from outside.
        joints: (V, 4) which carry a vertex.
        weights: (V, 4) of them, together 1.
        bind: (J, 4, 4) from where vertices are bound to each joint's frame.
        texture_xy: (V, 2) on the picture, from 0 to 1, rightwards and downwards; or None.
        texture: a PNG file's content; or None.
    """

    vertices: np.ndarray
    normals: np.ndarray
    triangles: np.ndarray
    joints: np.ndarray
    weights: np.ndarray
    bind: np.ndarray
    texture_xy: np.ndarray | None = None
    texture: bytes | None = None


def limb_mesh(armature: Armature) -> SkinnedMesh:
    """The limbs in the rest pose, each carried by the joint where it begins."""
    # One sample of the rest pose, the root at the origin.
    still = np.tile(np.eye(3), (1, len(armature.names), 1, 1))
    at_rest = replace(armature, times=np.zeros(1), positions=np.zeros((1, 3)), rotations=still)
    rest = joint_positions(at_rest)[0]
    vertices, normals, triangles, carriers, count = [], [], [], [], 0
    for j, parent in enumerate(armature.parents):
        reach = armature.offsets[j]
        length = float(np.linalg.norm(reach))
        if parent < 0 or length < SHORTEST_LIMB_M:
            continue
        slim = np.full(2, min(DEFAULT_RADIUS_SHARE * length, MAX_DEFAULT_RADIUS_M))
        solid = limb_solid(reach, slim if armature.radii is None else armature.radii[j])
        vertices.append(rest[parent] + solid.vertices)
        normals.append(solid.normals)
        triangles.append(count + solid.triangles)
        carriers += [[parent, 0, 0, 0]] * len(solid.vertices)
        count += len(solid.vertices)
    bind = np.tile(np.eye(4), (len(armature.names), 1, 1))
    bind[:, :3, 3] = -rest
    return SkinnedMesh(
        np.concatenate(vertices),
        np.concatenate(normals),
        np.concatenate(triangles),
        np.array(carriers),
        np.tile([1.0, 0, 0, 0], (count, 1)),
        bind,
    )
