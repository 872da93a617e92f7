"""glTF in: the skeleton of a .glb file and its first animation.

INPUTS: a .glb file with everything in it, of any program. OUTPUTS: an Armature in glTF's axes.

Joints are the first skin's and what they hang on; without a skin, all nodes that hold no mesh.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from jaxmocap.formats.armature import Armature
from jaxmocap.formats.errors import InputError
from jaxmocap.formats.glb import read_array, read_document

# Joints may not slide or grow by more than this: metres, and a factor's difference from 1.
SLIDES_M, GROWS = 1e-3, 1e-3
# Times of different channels that differ by less are one, seconds: float32 has no more.
SAME_S = 1e-5


def read_gltf(path: str | Path) -> Armature:
    """Read the skeleton and the first animation.

    Raises:
        InputError: not such a file, no animation or several skeletons, or joints that grow or
            slide, which an armature does not hold.
    """
    document, content = read_document(path)
    try:
        return _armature(path, document, content)
    except InputError:
        raise
    except ValueError as error:
        raise InputError(path, f"found {error}, which is not read") from None
    except (KeyError, IndexError, TypeError, AttributeError):
        raise InputError(path, "a glTF document that contradicts itself") from None


def _armature(path: str | Path, document: dict[str, Any], content: bytes) -> Armature:
    nodes = document["nodes"]
    if not document.get("animations"):
        raise InputError(path, "holds no animation")
    joints, parents = _joints(path, document)
    animation = document["animations"][0]
    curves = _curves(document, content, animation)
    inputs = [times for (node, _), (times, _, _) in curves.items() if node in joints]
    if not inputs:
        raise InputError(path, "the first animation moves no joint")
    times = _merged(inputs)
    rest = [_rest(nodes[node]) for node in joints]
    moved = np.stack(
        [_places(curves, n, times, r[0]) for n, r in zip(joints, rest, strict=True)], 1
    )
    local = np.stack([_turns(curves, n, times, r[1]) for n, r in zip(joints, rest, strict=True)], 1)
    for j, node in enumerate(joints):
        name = nodes[node].get("name", f"joint{node}")
        if np.abs(rest[j][2] - 1).max() > GROWS or _grows(curves, node):
            raise InputError(path, f"joint {name!r} is scaled, which is not read")
        if j and np.ptp(moved[:, j], axis=0).max() > SLIDES_M:
            raise InputError(path, f"joint {name!r} slides by more than a millimetre")
    start = float(animation.get("extras", {}).get("start", 0.0))
    offsets = moved[0].copy()
    offsets[0] = 0.0
    names = tuple(str(nodes[node].get("name", f"joint{node}")) for node in joints)
    at_rest = [turn for _, turn, _ in rest]
    offsets, R = _from_rest(parents, offsets, np.array(at_rest), local)
    return Armature(names, parents, offsets, times + start, moved[:, 0], R)


def _joints(path: str | Path, document: dict[str, Any]) -> tuple[list[int], tuple[int, ...]]:
    """Nodes that are joints, parents first, and the index of each one's parent among them."""
    nodes = document["nodes"]
    above = {child: i for i, node in enumerate(nodes) for child in node.get("children", ())}
    wanted = {i for i, node in enumerate(nodes) if "mesh" not in node and "camera" not in node}
    if document.get("skins"):
        wanted = set(document["skins"][0]["joints"])
    for node in list(wanted):
        # A loop of nodes would never end.
        for _ in nodes:
            if node in above:
                node = above[node]
                wanted.add(node)
    roots = [node for node in sorted(wanted) if node not in above]
    if len(roots) != 1:
        found = ", ".join(str(nodes[root].get("name", root)) for root in roots) or "none"
        raise InputError(path, f"expected one skeleton, found roots {found}")
    ordered, parents = [roots[0]], [-1]
    for parent, node in enumerate(ordered):
        for child in nodes[node].get("children", ()):
            if child in wanted:
                ordered.append(child)
                parents.append(parent)
    return ordered, tuple(parents)


def _rest(node: Mapping[str, Any]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A node's own place, turn (3, 3) and scale."""
    if "matrix" in node:
        matrix = np.array(node["matrix"], float).reshape(4, 4).T
        scale = np.linalg.norm(matrix[:3, :3], axis=0)
        return matrix[:3, 3], Rotation.from_matrix(matrix[:3, :3] / scale).as_matrix(), scale
    turn = Rotation.from_quat(node.get("rotation", [0, 0, 0, 1])).as_matrix()
    place = np.array(node.get("translation", [0, 0, 0]), float)
    return place, turn, np.array(node.get("scale", [1, 1, 1]), float)


_Curve = tuple[np.ndarray, np.ndarray, bool]


def _curves(
    document: dict[str, Any], content: bytes, animation: Mapping[str, Any]
) -> dict[tuple[int, str], _Curve]:
    """Node and path -> times, values, and whether they are held instead of joined."""
    curves = {}
    for channel in animation["channels"]:
        target, sampler = channel["target"], animation["samplers"][channel["sampler"]]
        mode = sampler.get("interpolation", "LINEAR")
        if mode not in ("LINEAR", "STEP"):
            raise ValueError(f"{mode} interpolation")
        times = read_array(document, content, sampler["input"])
        if not len(times) or not (np.diff(times) > 0).all():
            raise ValueError("times of keys that do not ascend")
        values = read_array(document, content, sampler["output"])
        curves[target.get("node", -1), target["path"]] = times, values, mode == "STEP"
    return curves


def _merged(inputs: list[np.ndarray]) -> np.ndarray:
    """All times that any channel has."""
    times = np.unique(np.concatenate(inputs))
    return times[np.concatenate([[True], np.diff(times) > SAME_S])]


def _grows(curves: Mapping[tuple[int, str], _Curve], node: int) -> bool:
    curve = curves.get((node, "scale"))
    return curve is not None and bool(np.abs(curve[1] - 1).max() > GROWS)


def _places(
    curves: Mapping[tuple[int, str], _Curve], node: int, times: np.ndarray, rest: np.ndarray
) -> np.ndarray:
    """(T, 3) a joint's place in its parent's frame."""
    if (node, "translation") not in curves:
        return np.tile(rest, (len(times), 1))
    keys, values, held = curves[node, "translation"]
    if held:
        return values[_before(keys, times)]
    return np.stack([np.interp(times, keys, column) for column in values.T], 1)


def _turns(
    curves: Mapping[tuple[int, str], _Curve], node: int, times: np.ndarray, rest: np.ndarray
) -> np.ndarray:
    """(T, 3, 3) a joint's turn in its parent's frame."""
    if (node, "rotation") not in curves:
        return np.tile(rest, (len(times), 1, 1))
    keys, values, held = curves[node, "rotation"]
    turns = Rotation.from_quat(values)
    if held or len(keys) == 1:
        return turns.as_matrix()[_before(keys, times)]
    return Slerp(keys, turns)(np.clip(times, keys[0], keys[-1])).as_matrix()


def _before(keys: np.ndarray, times: np.ndarray) -> np.ndarray:
    return np.clip(np.searchsorted(keys, times + SAME_S, "right") - 1, 0, len(keys) - 1)


def _from_rest(
    parents: tuple[int, ...], offsets: np.ndarray, rest: np.ndarray, local: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Offsets (J, 3) and turns (T, J, 3, 3) counted from the rest pose, in which nodes turn too."""
    R_root_rest, R = np.array(rest), np.array(local)
    turned = np.zeros_like(offsets)
    for j, parent in enumerate(parents):
        if parent >= 0:
            turned[j] = R_root_rest[parent] @ offsets[j]
            R_root_rest[j] = R_root_rest[parent] @ rest[j]
            R[:, j] = R_root_rest[parent] @ local[:, j] @ R_root_rest[j].T
        else:
            R[:, j] = local[:, j] @ R_root_rest[j].T
    return turned, R
