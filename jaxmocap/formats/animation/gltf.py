"""glTF out: a skeleton that moves and a mesh around it, for any 3-D viewer.

INPUTS: an Armature, its axes those of glTF: Y up, facing Z, left towards X, metres; by choice a
mesh that its joints carry, with a picture of its colours.
OUTPUTS: a .glb file: a node per joint, an animation of the root's position and of every joint's
rotation, and the mesh (a skin); without one the limbs, as they are in the armature's rest pose.

Samples whose pose is unknown have no key: a viewer moves on from the one before to the one after.
Across gaps (see ``resampling``) the last pose is held. The animation begins at 0 s; its ``extras``
say when that was (``start``, seconds). Where the root is far from the world's origin its positions
are about a local one, since glTF has single precision: ``extras`` say where (``origin``, metres).
"""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

import jaxmocap
from jaxmocap.formats.animation.glb import BinaryChunk, write_document
from jaxmocap.formats.armatures.armature import Armature, BeyondFormatError
from jaxmocap.formats.armatures.skin import SHORTEST_LIMB_M, SkinnedMesh, limb_mesh
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.time_series.resampling import hold_across_gaps
from jaxmocap.geometry.origin import local_origin

SKIN_COLOUR = (0.62, 0.68, 0.76, 1.0)
# glTF's numbers for what a view of the buffer holds: attributes of vertices, or indices.
_ARRAY_BUFFER = 34962
_ELEMENT_ARRAY_BUFFER = 34963


def write_gltf(
    path: str | Path, armature: Armature, mesh: SkinnedMesh | None = None, still: bool = False
) -> None:
    """Write an armature and the mesh that it carries (its limbs by default) as a .glb file.

    ``still`` is without an animation, as the body stands in the first sample.

    Raises:
        InputError: every sample's pose is missing.
        BeyondFormatError: it lasts too long for single precision to separate its samples, or for
            the size of a file; or there is no limb.
    """
    if not armature.is_valid.any():
        raise InputError(path, "every sample's pose is missing")
    origin = local_origin(armature.positions)
    armature = replace(armature, positions=armature.positions - origin)
    motion = hold_across_gaps(armature)
    times = motion.times
    if not (np.diff((times - times[0]).astype(np.float32)) > 0).all():
        problem = f"glTF holds times in single precision, in which samples within {np.ptp(times):g}"
        raise BeyondFormatError(path, f"{problem} s fall together")
    if mesh is None and not (np.linalg.norm(armature.offsets, axis=-1) >= SHORTEST_LIMB_M).any():
        problem = "found no joint away from its parent, expected a limb to be drawn"
        raise BeyondFormatError(path, problem)
    mesh = limb_mesh(armature) if mesh is None else mesh
    binary, joints = BinaryChunk(), list(range(len(armature.names)))
    body = {"name": "body", "mesh": 0, "skin": 0}
    material: dict[str, Any] = {"baseColorTexture": {"index": 0}}
    if mesh.texture is None:
        material = {"baseColorFactor": SKIN_COLOUR}
    material |= {"metallicFactor": 0.0, "roughnessFactor": 0.8}
    document = {
        "asset": {"version": "2.0", "generator": f"jaxmocap {jaxmocap.__version__}"},
        "scene": 0,
        "scenes": [{"nodes": [0, len(joints)]}],
        "nodes": [*_nodes(armature), body],
        "meshes": [{"name": "body", "primitives": [_primitive(binary, mesh)]}],
        "materials": [{"pbrMetallicRoughness": material, "doubleSided": True}],
        "skins": [{"joints": joints, "skeleton": 0, "inverseBindMatrices": binary.add(mesh.bind)}],
    }
    turns: Iterable[tuple[int, bytes]] = ()
    if not still:
        animation, turns = _animation(binary, motion)
        animation["extras"] |= {"origin": origin.tolist()} if origin.any() else {}
        document["animations"] = [animation]
    if mesh.texture is not None:
        view = binary.add_bytes(mesh.texture)
        document["images"] = [{"bufferView": view, "mimeType": "image/png"}]
        document["textures"] = [{"source": 0}]
    write_document(path, document, binary, turns)


def _nodes(armature: Armature) -> list[dict[str, Any]]:
    nodes = []
    for j, name in enumerate(armature.names):
        node = {"name": name, "translation": armature.offsets[j].tolist()}
        children = [i for i, parent in enumerate(armature.parents) if parent == j]
        nodes.append(node | ({"children": children} if children else {}))
    # Until the animation plays, the body stands where it begins.
    first = armature.positions[np.flatnonzero(armature.is_valid)[0]]
    nodes[0]["translation"] = first.tolist()
    return nodes


def _primitive(binary: BinaryChunk, mesh: SkinnedMesh) -> dict[str, Any]:
    """The mesh's arrays."""
    attributes = {
        "POSITION": binary.add(mesh.vertices, bounded=True, target=_ARRAY_BUFFER),
        "NORMAL": binary.add(mesh.normals, target=_ARRAY_BUFFER),
        "JOINTS_0": binary.add(mesh.joints, "<u2", target=_ARRAY_BUFFER),
        "WEIGHTS_0": binary.add(mesh.weights, target=_ARRAY_BUFFER),
    }
    if mesh.texture_xy is not None:
        attributes["TEXCOORD_0"] = binary.add(mesh.texture_xy, target=_ARRAY_BUFFER)
    indices = binary.add(mesh.triangles.ravel(), "<u4", target=_ELEMENT_ARRAY_BUFFER)
    return {"attributes": attributes, "indices": indices, "material": 0}


def _animation(
    binary: BinaryChunk, armature: Armature
) -> tuple[dict[str, Any], Iterator[tuple[int, bytes]]]:
    """Keys of the root's position, and of the rotations of joints that ever rotate.

    The rotations themselves are computed while the file is written.
    """
    times = armature.times
    keys = binary.add(times - times[0], bounded=True)
    samplers: list[dict[str, Any]] = []
    channels: list[dict[str, Any]] = []

    def channel(joint: int, path: str, output: int) -> None:
        channels.append({"sampler": len(samplers), "target": {"node": joint, "path": path}})
        samplers.append({"input": keys, "output": output, "interpolation": "LINEAR"})

    channel(0, "translation", binary.add(armature.positions))
    starts: dict[int, int] = {}
    for joint in np.flatnonzero(armature.largest_turns > 0).tolist():
        output, starts[joint] = binary.reserve((len(times), 4))
        channel(joint, "rotation", output)
    extras = {"start": float(times[0])}
    animation = {"name": "motion", "channels": channels, "samplers": samplers, "extras": extras}
    return animation, _rotation_keys(armature, starts)


def _rotation_keys(armature: Armature, starts: dict[int, int]) -> Iterator[tuple[int, bytes]]:
    """Keys of rotations, some samples at a time, and where each begins; all poses are complete."""
    joints = list(starts)
    before = np.zeros((1, len(joints), 4))
    for rows in armature.blocks() if joints else ():
        R = armature.rotations[rows][:, joints]
        xyzw = Rotation.from_matrix(R.reshape(-1, 3, 3)).as_quat().reshape(*R.shape[:2], 4)
        # Each of the sign nearest to the one before: players interpolate.
        signed = np.concatenate([before, xyzw])
        turns = np.where(np.sum(signed[1:] * signed[:-1], -1) < 0, -1.0, 1.0)
        keys = xyzw * np.cumprod(turns, 0)[..., None]
        before = keys[-1:]
        stored = keys.astype("<f4")
        for column, start in enumerate(starts.values()):
            yield start + stored[0, 0].nbytes * rows.start, stored[:, column].tobytes()
