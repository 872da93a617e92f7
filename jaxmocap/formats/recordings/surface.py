"""A person's surface as a file: plain arrays, so that any program can write one.

INPUTS: .npz with ``patch_names`` (P), ``patch_sizes`` (P, 2: along, around), ``bone_names`` (B),
``bones`` (N, K: indices of the names), ``points_bone`` (N, K, 3: metres, in bones' frames) and
``shares`` (N, K). Nodes come patch by patch, ring by ring. OUTPUTS: a Surface; and the other way.
"""

from pathlib import Path

import numpy as np

from jaxmocap.body.skeleton import Skeleton
from jaxmocap.body.subject import rest_joints
from jaxmocap.body.surfaces.surface import BodyPoints, Patch, Surface, rest_nodes
from jaxmocap.body.tree import Tree
from jaxmocap.compilation.arrays import on_device
from jaxmocap.formats.files.arrays import INTEGERS, NAMES, ArraySpec, NpzArrays
from jaxmocap.formats.files.errors import InputError, comma_list, short_repr
from jaxmocap.formats.files.writing import replacing

PATCH_NAMES = ("torso", "arm_l", "arm_r", "leg_l", "leg_r", "foot_l", "foot_r")
# Rings of a patch, and nodes of a ring.
MIN_NODES = 2
MAX_NODES = 512
# Bones that carry one node.
MAX_BONES_PER_NODE = 8
# Together, the shares of a node's bones may differ from 1 by this.
_SHARE_TOLERANCE = 1e-3
# No body is larger: from a bone's joint to a node that it carries, around a ring, and along a
# patch; nor is a patch shorter; metres.
_FARTHEST_M = 3.0
_LONGEST_RING_M = 5.0
_LONGEST_PATCH_M = 8.0
_SHORTEST_PATCH_M = 1e-3

_ARRAY_SPECS = {
    "patch_names": ArraySpec(("P",), NAMES),
    "patch_sizes": ArraySpec(("P", 2), INTEGERS, low=MIN_NODES, high=MAX_NODES),
    "bone_names": ArraySpec(("B",), NAMES),
    "bones": ArraySpec(("N", "K"), INTEGERS, low=0),
    "points_bone": ArraySpec(("N", "K", 3), low=-_FARTHEST_M, high=_FARTHEST_M),
    "shares": ArraySpec(("N", "K"), low=-_SHARE_TOLERANCE, high=1 + _SHARE_TOLERANCE),
}


def save_surface(path: str | Path, surface: Surface, tree: Tree) -> None:
    """Write a surface to a .npz file."""
    arrays = dict(zip(("bones", "points_bone", "shares"), surface.points, strict=True))
    sizes = [(patch.along, patch.around) for patch in surface.patches]
    with replacing(path) as part, part.open("wb") as file:
        np.savez(
            file,
            patch_names=np.array([patch.name for patch in surface.patches]),
            patch_sizes=np.array(sizes),
            bone_names=np.array(tree.bones),
            **{name: np.asarray(array) for name, array in arrays.items()},  # type: ignore[arg-type]
        )


def load_surface(path: str | Path, tree: Tree) -> Surface:
    """Read a surface for a body with this tree; InputError names the array that does not fit."""
    arrays = NpzArrays(path).read(_ARRAY_SPECS)
    sizes, bones, shares = (arrays[name] for name in ("patch_sizes", "bones", "shares"))
    _check_nodes(path, sizes, bones.shape)
    sum_errors = np.abs(shares.sum(-1) - 1)
    if sum_errors.max() > _SHARE_TOLERANCE:
        i = int(sum_errors.argmax())
        raise InputError(path, f"shares[{i}]: together {shares[i].sum():.4g}, expected 1")
    bone_names = arrays["bone_names"].tolist()
    if unknown := [name for name in bone_names if name not in tree.bones]:
        expected = comma_list(tree.bones)
        problem = f"unknown bone {short_repr(unknown[0])}, expected {expected}"
        raise InputError(path, f"bone_names: {problem}")
    index = np.array([tree.bone(name) for name in bone_names], np.int32)
    if bones.max() >= len(index):
        problem = f"found {bones.max()}, expected an index below {len(index)}"
        raise InputError(path, f"bones: {problem}, of bone_names")
    patches = _patches(path, arrays["patch_names"].tolist(), sizes)
    points_bone = on_device(arrays["points_bone"])
    return Surface(patches, BodyPoints(index[bones], points_bone, on_device(shares)))


def check_surface_extent(path: str | Path, surface: Surface, skeleton: Skeleton) -> None:
    """InputError where a patch is larger than any body's: what samples it would never end."""
    nodes = rest_nodes(surface, rest_joints(skeleton))
    for patch in surface.patches:
        grid = patch.grid(nodes)
        around = np.linalg.norm(np.roll(grid, -1, 1) - grid, axis=-1).sum(1).max()
        along = np.linalg.norm(np.diff(grid, axis=0), axis=-1).max(1).sum()
        middle = np.linalg.norm(np.diff(grid.mean(1), axis=0), axis=-1).sum()
        if around > _LONGEST_RING_M or along > _LONGEST_PATCH_M:
            size = f"{around:.3g} m around and {along:.3g} m along"
            expected = f"at most {_LONGEST_RING_M:g} m and {_LONGEST_PATCH_M:g} m"
            raise InputError(path, f"patch {patch.name}: {size}, expected {expected}")
        if middle < _SHORTEST_PATCH_M:
            raise InputError(path, f"patch {patch.name}: all rings lie at one place")


def _check_nodes(path: str | Path, sizes: np.ndarray, shape: tuple[int, ...]) -> None:
    nodes = sum(along * around for along, around in sizes.tolist())
    if nodes != shape[0]:
        problem = f"found bones of {shape[0]} nodes"
        raise InputError(path, f"{problem}, expected {nodes} nodes by patch_sizes")
    if not nodes:
        raise InputError(path, "patch_sizes: found no patch, expected at least one")
    if not 0 < shape[1] <= MAX_BONES_PER_NODE:
        problem = f"found {shape[1]} bones for each node"
        raise InputError(path, f"bones: {problem}, expected 1 to {MAX_BONES_PER_NODE}")


def _patches(path: str | Path, names: list[str], sizes: np.ndarray) -> tuple[Patch, ...]:
    patches, start = [], 0
    for i, (name, (along, around)) in enumerate(zip(names, sizes.tolist(), strict=True)):
        if name not in PATCH_NAMES:
            problem = f"unknown patch {short_repr(name)}, expected {', '.join(PATCH_NAMES)}"
            raise InputError(path, f"patch_names: {problem}")
        if name in names[:i]:
            raise InputError(path, f"patch_names: {short_repr(name)} is there twice")
        patches.append(Patch(name, around, along, start))
        start += along * around
    return tuple(patches)
