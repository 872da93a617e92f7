"""glTF out: a skeleton that moves and the limbs around it, for any 3-D viewer.

INPUTS: an Armature, its axes those of glTF: Y up, facing Z, left towards X, metres.
OUTPUTS: a .glb file: a node per joint, an animation of the root's place and of every joint's turn,
and a mesh of the limbs that the joints carry (a skin), its rest pose that of the armature.

Samples whose pose is unknown have no key: a viewer moves on from the one before to the one after.
The animation begins at 0 s; its ``extras`` say when that was (``start``, seconds).
"""

from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

import jaxmocap
from jaxmocap.formats.armature import Armature, joint_positions
from jaxmocap.formats.errors import InputError
from jaxmocap.formats.glb import Binary, write_document
from jaxmocap.geometry.solids import limb_solid

# Flesh of limbs of which nothing is known: a fraction of their length, and at most so much, metres.
SLIMNESS, THICKEST_M = 0.12, 0.05
SHORTEST_M = 1e-4
SKIN_COLOUR = (0.62, 0.68, 0.76, 1.0)
_ARRAYS, _INDICES = 34962, 34963


def write_gltf(path: str | Path, armature: Armature) -> None:
    """Write an armature as a .glb file.

    Raises:
        InputError: no pose is known.
    """
    if not armature.known.any():
        raise InputError(path, "no pose is known in any sample")
    binary, joints = Binary(), list(range(len(armature.names)))
    rest = joint_positions(_resting(armature))[0]
    bind = np.tile(np.eye(4), (len(joints), 1, 1))
    bind[:, :3, 3] = -rest
    body = {"name": "body", "mesh": 0, "skin": 0}
    document = {
        "asset": {"version": "2.0", "generator": f"jaxmocap {jaxmocap.__version__}"},
        "scene": 0,
        "scenes": [{"nodes": [0, len(joints)]}],
        "nodes": [*_nodes(armature), body],
        "meshes": [{"name": "body", "primitives": [_flesh(binary, armature, rest)]}],
        "materials": [{"pbrMetallicRoughness": _surface(), "doubleSided": True}],
        "skins": [{"joints": joints, "skeleton": 0, "inverseBindMatrices": binary.add(bind)}],
        "animations": [_animation(binary, armature)],
    }
    write_document(path, document, binary)


def _surface() -> dict[str, Any]:
    return {"baseColorFactor": SKIN_COLOUR, "metallicFactor": 0.0, "roughnessFactor": 0.8}


def _resting(armature: Armature) -> Armature:
    """One sample of the rest pose, the root at the origin."""
    count = len(armature.names)
    still = np.tile(np.eye(3), (1, count, 1, 1))
    fields = (armature.names, armature.parents, armature.offsets)
    return Armature(*fields, np.zeros(1), np.zeros((1, 3)), still)


def _nodes(armature: Armature) -> list[dict[str, Any]]:
    nodes = []
    for j, name in enumerate(armature.names):
        node = {"name": name, "translation": armature.offsets[j].tolist()}
        children = [i for i, parent in enumerate(armature.parents) if parent == j]
        nodes.append(node | ({"children": children} if children else {}))
    # Until the animation plays, the body stands where it begins.
    first = armature.positions[np.flatnonzero(armature.known)[0]]
    nodes[0]["translation"] = first.tolist()
    return nodes


def _flesh(binary: Binary, armature: Armature, rest: np.ndarray) -> dict[str, Any]:
    """The limbs in the rest pose, each carried by the joint where it begins."""
    vertices, normals, triangles, carriers, count = [], [], [], [], 0
    for j, parent in enumerate(armature.parents):
        reach = armature.offsets[j]
        length = float(np.linalg.norm(reach))
        if parent < 0 or length < SHORTEST_M:
            continue
        slim = np.full(2, min(SLIMNESS * length, THICKEST_M))
        solid = limb_solid(reach, slim if armature.radii is None else armature.radii[j])
        vertices.append(rest[parent] + solid.vertices)
        normals.append(solid.normals)
        triangles.append(count + solid.triangles)
        carriers += [[parent, 0, 0, 0]] * len(solid.vertices)
        count += len(solid.vertices)
    attributes = {
        "POSITION": binary.add(np.concatenate(vertices), bounded=True),
        "NORMAL": binary.add(np.concatenate(normals)),
        "JOINTS_0": binary.add(np.array(carriers), "<u2"),
        "WEIGHTS_0": binary.add(np.tile([1.0, 0, 0, 0], (count, 1))),
    }
    indices = binary.add(np.concatenate(triangles).ravel(), "<u4")
    for accessor in attributes.values():
        binary.views[accessor]["target"] = _ARRAYS
    binary.views[indices]["target"] = _INDICES
    return {"attributes": attributes, "indices": indices, "material": 0}


def _animation(binary: Binary, armature: Armature) -> dict[str, Any]:
    """Keys of the known samples: the root's place, and the turns of joints that ever turn."""
    known = armature.known
    times, R = armature.times[known], armature.rotations[known]
    keys = binary.add(times - times[0], bounded=True)
    samplers: list[dict[str, Any]] = []
    channels: list[dict[str, Any]] = []

    def channel(joint: int, path: str, values: np.ndarray) -> None:
        channels.append({"sampler": len(samplers), "target": {"node": joint, "path": path}})
        samplers.append({"input": keys, "output": binary.add(values), "interpolation": "LINEAR"})

    channel(0, "translation", armature.positions[known])
    for j in range(len(armature.names)):
        if np.abs(R[:, j] - np.eye(3)).max() > 0:
            channel(j, "rotation", _quaternions(R[:, j]))
    extras = {"start": float(times[0])}
    return {"name": "motion", "channels": channels, "samplers": samplers, "extras": extras}


def _quaternions(R: np.ndarray) -> np.ndarray:
    """(T, 4) xyzw of (T, 3, 3), each on the side of the one before, as players interpolate."""
    found = Rotation.from_matrix(R).as_quat()
    turned = np.sign(np.sum(found[1:] * found[:-1], -1))
    signs = np.cumprod(np.concatenate([[1.0], np.where(turned < 0, -1.0, 1.0)]))
    return found * signs[:, None]
