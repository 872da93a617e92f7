"""The skeleton: bones, joints and degrees of freedom as arrays.

INPUTS: a model file (``data/human.toml`` holds Table 1 of the first paper).
OUTPUTS: a Skeleton. Names and the tree are static; every number in it is a traced array, so that
gradients reach lengths, masses, diameters, costs and limits.
"""

import tomllib
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from importlib import resources

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

# The virtual root's degrees of freedom: three translations, three rotations.
ROOT_DOF = 6

# Landmark -> bone and fraction of its length from its joint.
_CENTRAL = {
    "pelvis": ("spine1", 0.0),
    "neck": ("neck", 0.0),
    "head": ("head", 0.0),
    "vertex": ("head", 1.0),
}
_PAIRED = {
    "shoulder": ("humerus", 0.0),
    "elbow": ("radius", 0.0),
    "wrist": ("hand", 0.0),
    "hand": ("hand", 1.0),
    "hip": ("femur", 0.0),
    "knee": ("tibia", 0.0),
    "ankle": ("foot", 0.0),
    "toe": ("foot", 1.0),
}
LANDMARKS: dict[str, tuple[str, float]] = _CENTRAL | {
    f"{name}_{side}": (f"{bone}_{side}", at)
    for name, (bone, at) in _PAIRED.items()
    for side in "lr"
}


def landmark_rows(names: Iterable[str]) -> np.ndarray:
    """Where the named landmarks are among all ``LANDMARKS``, (K,) int32.

    Raises:
        KeyError: no such landmark; the message lists the valid ones.
    """
    rows, known = [], list(LANDMARKS)
    for name in names:
        if name not in LANDMARKS:
            raise KeyError(f"unknown landmark {name!r}; the landmarks are {', '.join(known)}")
        rows.append(known.index(name))
    return np.array(rows, np.int32)


ELBOWS = landmark_rows(("elbow_l", "elbow_r"))


# Indices that are kept are int32: JAX remembers an int64 array as it was first seen, and a change
# of precision between two traces would break the second.
@dataclass(frozen=True)
class Tree:
    """What of a skeleton is static: names and who hangs on whom. Hashable.

    Attributes:
        bones: names of the B bones, parents before children.
        parents: index of each bone's parent, -1 for bones that start at the virtual root.
        joints: names of the D degrees of freedom.
        dof_bones: index of the bone that each degree of freedom turns, proximal to distal.
    """

    bones: tuple[str, ...]
    parents: tuple[int, ...]
    joints: tuple[str, ...]
    dof_bones: tuple[int, ...]

    def bone(self, name: str) -> int:
        """Index of a bone by name.

        Raises:
            KeyError: no such bone; the message lists the valid ones.
        """
        if name not in self.bones:
            raise KeyError(f"unknown bone {name!r}; the bones are {', '.join(self.bones)}")
        return self.bones.index(name)

    def joint(self, name: str) -> int:
        """Index of a degree of freedom by name; KeyError lists the valid ones."""
        if name not in self.joints:
            raise KeyError(f"unknown joint {name!r}; the joints are {', '.join(self.joints)}")
        return self.joints.index(name)

    def chain(self, bone: str) -> tuple[int, ...]:
        """Indices of the bones on the path from the root to ``bone``: a kinematic chain."""
        path = [self.bone(bone)]
        while self.parents[path[-1]] >= 0:
            path.append(self.parents[path[-1]])
        return tuple(reversed(path))

    @cached_property
    def leaves(self) -> tuple[int, ...]:
        """Bones that carry no other."""
        return tuple(i for i in range(len(self.bones)) if i not in self.parents)

    @cached_property
    def carries(self) -> np.ndarray:
        """(6 + D, B) booleans: does a degree of freedom, the root's first, move a bone?"""
        chains = [set(self.chain(name)) for name in self.bones]
        moved = [[bone in chain for chain in chains] for bone in self.dof_bones]
        return np.vstack([np.ones((ROOT_DOF, len(self.bones)), bool), np.array(moved, bool)])

    @cached_property
    def hinge_slots(self) -> np.ndarray:
        """(B, S) indices of each bone's degrees of freedom in turning order, -1 where empty."""
        bones = range(len(self.bones))
        per_bone = [[d for d, b in enumerate(self.dof_bones) if b == i] for i in bones]
        slots = np.full((len(bones), max(map(len, per_bone))), -1, np.int32)
        for i, dofs in enumerate(per_bone):
            slots[i, : len(dofs)] = dofs
        return slots

    @cached_property
    def doublings(self) -> tuple[np.ndarray, ...]:
        """Ancestors at distance 1, 2, 4, ... of every bone; -1 past the root."""
        rounds, ancestors = [], np.array(self.parents, np.int32)
        while (ancestors >= 0).any():
            rounds.append(ancestors)
            ancestors = np.where(ancestors >= 0, ancestors[ancestors], -1)
        return tuple(rounds)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Skeleton:
    """A body of B bones with D degrees of freedom and a virtual root at the pelvis.

    With all angles 0 every bone's frame is the body's: x forward, y left, z up.

    Attributes:
        tree: names and topology (static).
        lengths: (B,) metres.
        directions: (B, 3) unit vectors along each bone, in its own frame.
        masses: (B,) kilograms.
        centres: (B,) centre of mass as a fraction of the length.
        diameters: (B, 2) metres, at the near and the far end.
        axes: (D, 3) unit hinge axes, in the frame that the joint's earlier hinges leave.
        limits: (D, 2) smallest and largest angle, radians.
        costs: (6 + D,) mu of equation (4); the root's six first.
        relaxed: (D,) omega of equation (9), radians.
    """

    tree: Tree = field(metadata={"static": True})
    lengths: Array
    directions: Array
    masses: Array
    centres: Array
    diameters: Array
    axes: Array
    limits: Array
    costs: Array
    relaxed: Array

    @classmethod
    def human(cls, height: float | None = None, mass: float | None = None) -> "Skeleton":
        """The paper's subject (Table 1), or a person of that height scaled by Winter's proportions.

        Args:
            height: metres; None keeps Table 1.
            mass: kilograms; None keeps Table 1's, or follows the height at 23 kg/m^2.

        Raises:
            ValueError: height outside 0.5 to 2.5 m, or mass outside 10 to 400 kg.
        """
        from jaxmocap.body.subject import scale_to_height

        skeleton = load_skeleton("human.toml")
        if height is None and mass is None:
            return skeleton
        return scale_to_height(skeleton, height, mass)


def load_skeleton(name: str) -> Skeleton:
    """Read a model file from ``body/data``."""
    tree, bones, joints, root = _read_model(name)
    degree = np.pi / 180
    return Skeleton(
        tree=tree,
        lengths=_column(bones, "length"),
        directions=_column(bones, "direction"),
        masses=_column(bones, "mass"),
        centres=_column(bones, "centre"),
        diameters=_column(bones, "diameter"),
        axes=_column(joints, "axis"),
        limits=_column(joints, "range", degree),
        costs=_numbers([*root["cost"], *(joint["cost"] for joint in joints)]),
        relaxed=_column(joints, "relaxed", degree),
    )


def with_joints(skeleton: Skeleton, name: str) -> Skeleton:
    """The same bones, moved by the joints of a model file: ``torso.toml`` for the upper body.

    ``legs.toml`` has hip and legs, ``whole.toml`` both, ``supple.toml`` wrists and neck as well,
    ``human.toml`` the first paper's.

    Raises:
        KeyError: a joint turns a bone that the skeleton does not have.
    """
    model, tree = load_skeleton(name), skeleton.tree
    carried = tuple(tree.bone(model.tree.bones[bone]) for bone in model.tree.dof_bones)
    return replace(
        skeleton,
        tree=replace(tree, joints=model.tree.joints, dof_bones=carried),
        **{
            key: getattr(model, key).astype(skeleton.lengths.dtype)
            for key in ("axes", "limits", "costs", "relaxed")
        },
    )


def _column(rows: list[dict], key: str, scale: float = 1.0) -> Array:
    """One number, or one vector, of each row."""
    return _numbers([row[key] for row in rows], scale)


def _numbers(values: list, scale: float = 1.0) -> Array:
    """Converted on the host: on the device that would be a program for each shape."""
    dtype = jax.dtypes.canonicalize_dtype(float)
    return jnp.asarray((np.array(values, float) * scale).astype(dtype), dtype)


# The file is kept, not its arrays: those would outlive a trace or a change of precision.
@lru_cache
def _read_model(name: str) -> tuple[Tree, list[dict], list[dict], dict]:
    """The tree, the rows of bones and of joints, and the root, of a model file."""
    data = _data(name)
    source = _data(data["bones_of"]) if "bones_of" in data else data
    bones, joints = source["bone"], _joint_rows(name)
    names = [bone["name"] for bone in bones]
    tree = Tree(
        tuple(names),
        tuple(names.index(bone["parent"]) if bone["parent"] else -1 for bone in bones),
        tuple(joint["name"] for joint in joints),
        tuple(names.index(joint["bone"]) for joint in joints),
    )
    return tree, bones, joints, source["root"]


def _joint_rows(name: str) -> list[dict]:
    """A model file's joints: those that it takes from other files, all or some, then its own."""
    data, taken = _data(name), []
    for source in data.get("joints_of", []):
        rows = {row["name"]: row for row in _joint_rows(source["file"])}
        taken += [rows[joint] for joint in source.get("names", rows)]
    return taken + data.get("joint", [])


def _data(name: str) -> dict:
    """What a model file holds."""
    text = resources.files("jaxmocap.body").joinpath("data", name).read_text(encoding="utf-8")
    return tomllib.loads(text)
