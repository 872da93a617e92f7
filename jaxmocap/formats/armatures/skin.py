"""A body's surface as a skin on its armature's joints; the limbs' where there is no surface.

INPUTS: a Surface around a Skeleton, by choice with a picture of its colours.
OUTPUTS: a SkinnedMesh in a file's axes.

The skin is bound where all angles are 0, the arms hanging: there the bones' frames are the body's,
and there alone a node lies at one place, whichever of its bones is asked. A joint's frame, the
body's own in the T pose, is rotated there as the bone is between the two.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from jaxmocap.body.skeleton import Skeleton
from jaxmocap.body.subject import rest_joints
from jaxmocap.body.surfaces.mesh import atlas_of, mesh_of, normals_of
from jaxmocap.body.surfaces.surface import Surface, rest_nodes
from jaxmocap.formats.armatures.armature import Armature, joint_positions
from jaxmocap.formats.armatures.body_armature import joint_tree, rest_orientations
from jaxmocap.formats.files.errors import InputError
from jaxmocap.geometry.solids import limb_solid

# Radius of a limb whose girth is unknown, as a share of its length.
DEFAULT_RADIUS_SHARE = 0.12
# At most this radius, metres.
MAX_DEFAULT_RADIUS_M = 0.05
SHORTEST_LIMB_M = 1e-4


@dataclass(frozen=True)
class SkinnedMesh:
    """V vertices and F triangles on J joints."""

    vertices: np.ndarray  # (V, 3) where they are bound, metres
    normals: np.ndarray  # (V, 3) unit, outward
    triangles: np.ndarray  # (F, 3) of vertices, counter-clockwise from outside
    joints: np.ndarray  # (V, 4) which carry a vertex
    weights: np.ndarray  # (V, 4) of them, together 1
    bind: np.ndarray  # (J, 4, 4) from where vertices are bound to each joint's frame
    # (V, 2) on the picture, from 0 to 1, rightwards and downwards; or None.
    texture_xy: np.ndarray | None = None
    texture: bytes | None = None  # a PNG file's content; or None


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


# Side of a texture's texel on the surface, metres.
TEXEL_M = 0.0025
# How far apart the bones of one node may put it at rest, metres.
MAX_APART_M = 1e-3
BONES_PER_VERTEX = 4
PNG_SIGNATURE = b"\x89PNG"


def surface_skin(
    path: str | Path,
    skeleton: Skeleton,
    surface: Surface,
    R_file_world: np.ndarray,
    texture: bytes | None = None,
) -> SkinnedMesh:
    """A skeleton's surface on the joints of ``armature_of``, in a file's axes.

    ``texture`` is a PNG file's content, laid out by ``atlas_of`` with texels of ``TEXEL_M``.

    Raises:
        InputError: bones disagree where a node is at rest, more than four carry it, or the picture
            is that of another surface.
    """
    joints = rest_joints(skeleton)
    nodes = rest_nodes(surface, joints)
    _check_skin(path, surface, joints, nodes)
    if texture is not None:
        check_texture(path, skeleton, surface, texture)
    mesh = mesh_of(surface, nodes, atlas_of(surface, nodes, TEXEL_M))
    vertices = nodes[mesh.nodes]
    names, _ = joint_tree(skeleton)
    # What the pelvis and the hips, which do not move against it, carry is the root's.
    carrying = [names.index(b) if b in names else 0 for b in skeleton.tree.bones]
    padding = [(0, 0), (0, BONES_PER_VERTEX - surface.points.bones.shape[1])]
    weights = np.pad(np.asarray(surface.points.shares, float), padding)
    carriers = np.pad(np.array(carrying)[np.asarray(surface.points.bones)], padding)
    carriers, weights = np.where(weights > 0, carriers, 0), weights / weights.sum(1, keepdims=True)
    # From the body with all angles 0 to the frames that its joints have there.
    rest, bind = rest_orientations(skeleton), np.tile(np.eye(4), (len(names), 1, 1))
    for j, name in enumerate(names):
        if name in skeleton.tree.bones:
            bone = skeleton.tree.bone(name)
            R = R_file_world @ rest[bone] @ R_file_world.T
            bind[j, :3, :3], bind[j, :3, 3] = R, -R @ R_file_world @ joints[bone]
    return SkinnedMesh(
        vertices @ R_file_world.T,
        normals_of(vertices, mesh.triangles) @ R_file_world.T,
        mesh.triangles,
        carriers[mesh.nodes],
        weights[mesh.nodes],
        bind,
        mesh.places,
        texture,
    )


def check_texture(path: str | Path, skeleton: Skeleton, surface: Surface, texture: bytes) -> None:
    """InputError where a file's content is not a PNG laid out for this surface."""
    if not texture.startswith(PNG_SIGNATURE):
        raise InputError(path, "is not a PNG file, which a texture is")
    atlas = atlas_of(surface, rest_nodes(surface, rest_joints(skeleton)), TEXEL_M)
    # Width and height, as its header says.
    stated = [int.from_bytes(texture[at : at + 4], "big") for at in (16, 20)]
    if stated != [atlas.width, atlas.height]:
        size, expected = f"{stated[0]} x {stated[1]}", f"{atlas.width} x {atlas.height}"
        problem = f"a texture of {size} texels, expected {expected}, as this surface is laid out"
        raise InputError(path, problem)


def _check_skin(path: str | Path, surface: Surface, joints: np.ndarray, nodes: np.ndarray) -> None:
    """InputError where glTF cannot hold the surface."""
    bones, shares = np.asarray(surface.points.bones), np.asarray(surface.points.shares)
    if bones.shape[1] > BONES_PER_VERTEX:
        problem = f"{bones.shape[1]} bones carry a node, expected {BONES_PER_VERTEX} at most"
        raise InputError(path, problem)
    distances = np.linalg.norm(joints[bones] + surface.points.points_bone - nodes[:, None], axis=-1)
    worst = float(np.where(shares > 0, distances, 0).max())
    if worst > MAX_APART_M:
        raise InputError(
            path, f"a surface whose bones put a node {1e3 * worst:.0f} mm apart at rest, "
            f"expected {1e3 * MAX_APART_M:.0f} mm at most"
        )  # fmt: skip
