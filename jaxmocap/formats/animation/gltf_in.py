"""glTF in: the skeleton of a .glb file and its first animation.

INPUTS: a .glb file with everything in it, of any program. OUTPUTS: an Armature in glTF's axes.

Joints are the first skin's and what they hang on; without a skin, all nodes that hold no mesh. What
stands still above the joint that moves about, such as Blender's armature object, is none.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from jaxmocap.formats.animation.glb import Accessors, read_document
from jaxmocap.formats.armatures.armature import MAX_DEPTH, MAX_JOINTS, MAX_ROTATIONS, Armature
from jaxmocap.formats.files.errors import InputError, comma_list, short_name
from jaxmocap.formats.files.json_text import JsonPart
from jaxmocap.formats.time_series.tables import FARTHEST_M, LATEST_S

# Joints other than the root may not slide by more than this, metres.
MAX_SLIDE_M = 1e-3
# A joint's scale may not differ from 1 by more than this: an armature holds none.
MAX_SCALE_ERROR = 1e-3
# Times of different channels that differ by less are one, seconds: float32 has no more.
SAME_TIME_S = 1e-5
# Nodes of a document.
_MAX_NODES = 100_000
# A matrix may differ from a rotation by this, as files round.
_MAX_SHEAR = 1e-2
# A shorter quaternion states no rotation.
_MIN_QUATERNION_LENGTH = 1e-3
# What of a node is animated: numbers of each key. Weights are a mesh's.
_NUMBERS_PER_KEY = {"translation": 3, "rotation": 4, "scale": 3, "weights": 1}


def read_gltf(path: str | Path) -> Armature:
    """Read the skeleton and the first animation; InputError for what an armature does not hold."""
    document, content = read_document(path)
    nodes = document["nodes"]
    if not document.get("animations", []).items():
        raise InputError(path, "holds no animation")
    joints, parents = _joints(document)
    animation = document["animations"][0]
    accessors = Accessors(document, content)
    curves = _curves(document, accessors, animation, set(joints))
    # All times that any channel has.
    inputs = {id(curve.times): curve.times for curve in curves.values()}
    times = np.unique(np.concatenate(list(inputs.values())))
    times = times[np.concatenate([[True], np.diff(times) > SAME_TIME_S])]
    if len(times) * len(joints) > MAX_ROTATIONS:
        problem = f"found {len(times)} samples of {len(joints)} joints"
        raise animation.error(f"{problem}, expected at most {MAX_ROTATIONS} orientations")
    moves = _Moves(nodes, accessors, curves, times)
    above, joints, parents = _without_still_roots(moves, joints, parents)
    names = tuple(nodes[node].get("name", f"joint{node}").text() for node in joints)
    offsets, positions, R = _joint_motion(moves, above, joints, parents)
    extras = animation["extras"]
    start = extras["start"].number(LATEST_S) if extras.has("start") else 0.0
    origin = extras["origin"].numbers(3, FARTHEST_M) if extras.has("origin") else np.zeros(3)
    return Armature(names, parents, offsets, times + start, positions + origin, R)


def _joints(document: JsonPart) -> tuple[list[int], tuple[int, ...]]:
    """Nodes that are joints, parents first, and the index of each one's parent among them."""
    nodes = document["nodes"]
    children, above = _forest(nodes)
    wanted = {
        i for i, node in enumerate(nodes.parts()) if not node.has("mesh") and not node.has("camera")
    }
    if document.get("skins", []).items():
        wanted = {joint.index(nodes) for joint in document["skins"][0]["joints"].parts()}
    for node in list(wanted):
        while (node := above.get(node, -1)) >= 0 and node not in wanted:
            wanted.add(node)
    roots = [node for node in sorted(wanted) if node not in above]
    if len(roots) != 1:
        names = comma_list(nodes[root].get("name", str(root)).text() for root in roots) or "none"
        raise InputError(document.path, f"expected one skeleton, found roots {names}")
    ordered, parents, depths = [roots[0]], [-1], [1]
    for parent, node in enumerate(ordered):
        below = [child for child in children[node] if child in wanted]
        ordered += below
        parents += [parent] * len(below)
        depths += [depths[parent] + 1] * len(below)
        if len(ordered) > MAX_JOINTS or depths[-1] > MAX_DEPTH:
            most = f"{MAX_JOINTS} joints, {MAX_DEPTH} deep below one another"
            raise nodes.error(f"expected at most {most}")
    return ordered, tuple(parents)


def _forest(nodes: JsonPart) -> tuple[list[list[int]], dict[int, int]]:
    """Each node's children, and child -> parent; trees, with no loops and no ways that meet."""
    if len(nodes.items()) > _MAX_NODES:
        raise nodes.error(f"found {len(nodes.items())} nodes, expected at most {_MAX_NODES}")
    children: list[list[int]] = []
    above: dict[int, int] = {}
    for i, node in enumerate(nodes.parts()):
        below = [child.index(nodes) for child in node.get("children", []).parts()]
        for child in below:
            if child in above:
                raise node["children"].error(f"found node {child}, which has a parent already")
            above[child] = i
        children.append(below)
    reached = [i for i in range(len(children)) if i not in above]
    for node in reached:
        reached += children[node]
    if len(reached) < len(children):
        loose = min(set(range(len(children))) - set(reached))
        raise nodes[loose].error("hangs on itself, a loop")
    return children, above


@dataclass(frozen=True)
class _Curve:
    """One animated property of one node: times (K,) of keys, seconds, and its values' accessor."""

    times: np.ndarray
    output: int
    is_step: bool
    part: JsonPart

    def values(self, accessors: Accessors, width: int) -> np.ndarray:
        """(K, width) numbers at its keys."""
        values = accessors.read(self.output, (width,))
        if len(values) != len(self.times):
            raise self.part.error(f"found {len(values)} values for {len(self.times)} keys")
        return values


_Curves = Mapping[tuple[int, str], _Curve]


def _curves(
    document: JsonPart, accessors: Accessors, animation: JsonPart, joints: set[int]
) -> _Curves:
    """Joint and property -> how it is animated."""
    curves: dict[tuple[int, str], _Curve] = {}
    keys: dict[int, np.ndarray] = {}
    nodes, samplers = document["nodes"], animation["samplers"]
    for channel in animation["channels"].parts():
        target = channel["target"]
        if not target.has("node"):
            continue
        node = target["node"].index(nodes)
        path = target["path"].choice(list(_NUMBERS_PER_KEY))
        if node not in joints or path == "weights":
            continue
        if (node, path) in curves:
            raise target.error(f"moves the {path} of node {node} a second time")
        sampler = samplers[channel["sampler"].index(samplers)]
        mode = sampler.get("interpolation", "LINEAR").choice(["LINEAR", "STEP"])
        times = sampler["input"].index(document["accessors"])
        if times not in keys:
            found = keys[times] = accessors.read(times, ())
            if not len(found) or not (np.diff(found) > 0).all() or np.abs(found).max() > LATEST_S:
                problem = f"found times of keys that do not ascend within {LATEST_S:g} s"
                raise sampler["input"].error(problem)
        output = sampler["output"].index(document["accessors"])
        curves[node, path] = _Curve(keys[times], output, mode == "STEP", sampler)
    if not curves:
        raise InputError(document.path, "the first animation moves no joint")
    return curves


@dataclass(frozen=True)
class _Moves:
    """How nodes move in their parents' frames at (T,) times."""

    nodes: JsonPart
    accessors: Accessors
    curves: _Curves
    times: np.ndarray

    def positions(self, node: int) -> np.ndarray:
        """(T, 3) metres."""
        curve = self.curves.get((node, "translation"))
        if curve is None:
            return np.tile(_rest_pose(self.nodes[node])[0], (len(self.times), 1))
        values = curve.values(self.accessors, 3)
        if np.abs(values).max() > FARTHEST_M:
            raise curve.part.error(f"found a joint farther than {FARTHEST_M:g} m from its parent")
        if curve.is_step:
            return values[_last_key(curve.times, self.times)]
        return np.stack([np.interp(self.times, curve.times, column) for column in values.T], 1)

    def rotations(self, node: int) -> np.ndarray:
        """(T, 3, 3)."""
        curve = self.curves.get((node, "rotation"))
        if curve is None:
            return np.broadcast_to(_rest_pose(self.nodes[node])[1], (len(self.times), 3, 3))
        quaternions = curve.values(self.accessors, 4)
        if np.linalg.norm(quaternions, axis=1).min() < _MIN_QUATERNION_LENGTH:
            raise curve.part.error("found a quaternion of length 0, expected 1")
        rotations = Rotation.from_quat(quaternions)
        if np.array_equal(curve.times, self.times):
            return rotations.as_matrix()
        if curve.is_step or len(curve.times) == 1:
            return rotations.as_matrix()[_last_key(curve.times, self.times)]
        within = np.clip(self.times, *curve.times[[0, -1]])
        return Slerp(curve.times, rotations)(within).as_matrix()


def _without_still_roots(
    moves: _Moves, joints: list[int], parents: tuple[int, ...]
) -> tuple[tuple[np.ndarray, np.ndarray], list[int], tuple[int, ...]]:
    """Rotation and position of what stands still above the first joint that moves about; joints."""
    R_above, above = np.eye(3), np.zeros(3)
    while parents.count(0) == 1 and np.ptp(moves.positions(joints[1]), axis=0).max() > MAX_SLIDE_M:
        turns, places = moves.rotations(joints[0]), moves.positions(joints[0])
        if np.ptp(places, axis=0).max() > MAX_SLIDE_M or np.ptp(turns, axis=0).max() > MAX_SLIDE_M:
            break
        R_above, above = R_above @ turns[0], above + R_above @ places[0]
        joints, parents = joints[1:], tuple(parent - 1 for parent in parents[1:])
    return (R_above, above), joints, parents


def _joint_motion(
    moves: _Moves,
    above: tuple[np.ndarray, np.ndarray],
    joints: Sequence[int],
    parents: Sequence[int],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Offsets (J, 3), root's positions (T, 3), rotations (T, J, 3, 3) from the rest pose."""
    offsets, positions = np.zeros((len(joints), 3)), np.zeros((len(moves.times), 3))
    R = np.empty((len(moves.times), len(joints), 3, 3))
    R_root_rest = np.empty((len(joints), 3, 3))
    for j, (node, parent) in enumerate(zip(joints, parents, strict=True)):
        part = moves.nodes[node]
        _, R_rest = _rest_pose(part)
        scale = moves.curves.get((node, "scale"))
        if scale and np.abs(scale.values(moves.accessors, 3) - 1).max() > MAX_SCALE_ERROR:
            raise part.error(f"joint {_name(part)} is scaled, which is not read")
        local_positions = moves.positions(node)
        R_up = above[0] if parent < 0 else R_root_rest[parent]
        if parent < 0:
            positions = above[1] + local_positions @ R_up.T
        elif np.ptp(local_positions, axis=0).max() > MAX_SLIDE_M:
            raise part.error(f"joint {_name(part)} slides by more than a millimetre")
        else:
            offsets[j] = R_up @ local_positions[0]
        R_root_rest[j] = R_up @ R_rest
        R[:, j] = R_up @ moves.rotations(node) @ R_root_rest[j].T
    return offsets, positions, R


def _name(node: JsonPart) -> str:
    return repr(short_name(node.get("name", "without a name").text()))


def _rest_pose(node: JsonPart) -> tuple[np.ndarray, np.ndarray]:
    """A node's own position and rotation (3, 3); InputError where it is scaled."""
    if node.has("matrix"):
        matrix = node["matrix"].numbers(16, FARTHEST_M).reshape(4, 4).T
        R, position = matrix[:3, :3], matrix[:3, 3]
        scale = np.linalg.norm(R, axis=0)
    else:
        quaternion = node.get("rotation", [0, 0, 0, 1]).numbers(4, 1e3)
        if np.linalg.norm(quaternion) < _MIN_QUATERNION_LENGTH:
            raise node["rotation"].error("found a quaternion of length 0, expected 1")
        R = Rotation.from_quat(quaternion).as_matrix()
        position = node.get("translation", [0, 0, 0]).numbers(3, FARTHEST_M)
        scale = node.get("scale", [1, 1, 1]).numbers(3, 1e6)
    if np.abs(scale - 1).max() > MAX_SCALE_ERROR:
        raise node.error(f"joint {_name(node)} is scaled, which is not read")
    if np.linalg.det(R) < 0 or np.abs(R @ R.T - np.eye(3)).max() > _MAX_SHEAR:
        raise node["matrix"].error("found a matrix that mirrors or shears, expected a rotation")
    return position, Rotation.from_matrix(R).as_matrix()


def _last_key(keys: np.ndarray, times: np.ndarray) -> np.ndarray:
    return np.clip(np.searchsorted(keys, times + SAME_TIME_S, "right") - 1, 0, len(keys) - 1)
