"""The skeleton: bones, joints and degrees of freedom as arrays.

INPUTS: a model file (``data/human.toml`` holds Table 1 of the first paper).
OUTPUTS: a Skeleton. Names and the tree are static; every number in it is a traced array, so that
gradients reach lengths, masses, diameters, costs and limits.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.model_files import HUMAN, joint_rows, landmark_rows_of, read_model

# The virtual root's degrees of freedom: three translations, three rotations.
ROOT_DOF = 6

_LANDMARKS = landmark_rows_of(HUMAN)
# Landmark -> bone and fraction of its length from its joint.
LANDMARKS: dict[str, tuple[str, float]] = {
    row["name"]: (row["bone"], float(row["at"])) for row in _LANDMARKS
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


def landmark_mismatches() -> np.ndarray:
    """By how much skeletons put each of the ``LANDMARKS`` wrong, (L, 3) metres, world, Z up."""
    sides = [row["mismatch"] for row in _LANDMARKS]
    return np.array([(across, across, upright) for across, upright in sides], float)


class Segment(NamedTuple):
    """What kind of bone one is.

    Attributes:
        group: spine, head, shoulder, arm, hip, leg, or what else a body has; "" for none.
        part: the bone's name within its group, the same on both sides.
        side: "l", "r", or "" in the middle.
        drawn: whether silhouettes show it as its cone.
    """

    group: str = ""
    part: str = ""
    side: str = ""
    drawn: bool = True


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
        segments: what kind of bone each is; () where that is not known of any.
        searched: limb that is searched by each degree of freedom, "" for none; () for none at all.
    """

    bones: tuple[str, ...]
    parents: tuple[int, ...]
    joints: tuple[str, ...]
    dof_bones: tuple[int, ...]
    segments: tuple[Segment, ...] = ()
    searched: tuple[str, ...] = ()

    def bone(self, name: str) -> int:
        """Index of a bone by name.

        Raises:
            KeyError: no such bone; the message lists the valid ones.
        """
        if name not in self.bones:
            raise KeyError(f"unknown bone {name!r}; the bones are {', '.join(self.bones)}")
        return self.bones.index(name)

    def bones_in(self, *names: str, side: str | None = None) -> np.ndarray:
        """Indices (K,) of the bones of groups or parts, parents before children.

        Args:
            names: of groups ("arm") or parts ("forearm"); a body that has none yields no bones.
            side: only these, "l", "r" or ""; None for all.
        """
        chosen = [
            i
            for i, segment in enumerate(self.segments)
            if (segment.group in names or segment.part in names) and side in (None, segment.side)
        ]
        return np.array(chosen, np.int32)

    def names_in(self, *names: str, side: str | None = None) -> tuple[str, ...]:
        """The names of ``bones_in``."""
        return tuple(self.bones[i] for i in self.bones_in(*names, side=side))

    @property
    def groups_of_joints(self) -> tuple[str, ...]:
        """The group (D) of the bone that each degree of freedom turns; "" for none."""
        if not self.segments:
            return ("",) * len(self.joints)
        return tuple(self.segments[bone].group for bone in self.dof_bones)

    @property
    def drawn(self) -> np.ndarray:
        """Indices (K,) of the bones that silhouettes show as their cones."""
        if not self.segments:
            return np.arange(len(self.bones), dtype=np.int32)
        return np.flatnonzero([segment.drawn for segment in self.segments]).astype(np.int32)

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
        usual_deviations: (D,) by which joints stray from relaxed, radians (standard deviations).
        rest_deviations: (D,) by which joints stray from 0 of which outlines tell little, radians;
            infinite for the others.
        unmarked_costs: (6 + D,) factors on costs where no marker holds the feet.
        unmarked_relaxed: (D,) least relaxed angles there, radians; minus infinity for none.
        unmarked_least: (D,) least angles there, radians; minus infinity for none.
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
    usual_deviations: Array
    rest_deviations: Array
    unmarked_costs: Array
    unmarked_relaxed: Array
    unmarked_least: Array

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

        skeleton = load_skeleton(HUMAN)
        if height is None and mass is None:
            return skeleton
        return scale_to_height(skeleton, height, mass)


def load_skeleton(name: str | Path) -> Skeleton:
    """Read a body's file.

    Args:
        name: in ``body/data``; or the path of a file of the same form.
    """
    model = read_model(name)
    names = [bone["name"] for bone in model.bones]
    parents = tuple(names.index(bone["parent"]) if bone["parent"] else -1 for bone in model.bones)
    segments = tuple(
        Segment(*(bone.get(key, usual) for key, usual in Segment._field_defaults.items()))
        for bone in model.bones
    )
    bones_alone = Tree(tuple(names), parents, (), (), segments)
    return Skeleton(
        tree=_with_dofs(bones_alone, model.joints),
        lengths=_column(model.bones, "length"),
        directions=_column(model.bones, "direction"),
        masses=_column(model.bones, "mass"),
        centres=_column(model.bones, "centre"),
        diameters=_column(model.bones, "diameter"),
        **joint_columns(model.joints, model.root),
    )


def joint_columns(joints: list[dict], root: dict | None = None) -> dict[str, Array]:
    """A skeleton's arrays of D degrees of freedom, by rows of a body's file.

    Args:
        joints: D rows.
        root: of the virtual root; None leaves its six out of costs.
    """
    degree = np.pi / 180
    feet = [joint.get("unmarked_feet", {}) for joint in joints]
    costs, factors = [joint["cost"] for joint in joints], [each.get("cost", 1.0) for each in feet]
    if root is not None:
        usual = [1.0] * ROOT_DOF
        costs = [*root["cost"], *costs]
        factors = [*root.get("unmarked_feet", {}).get("cost", usual), *factors]
    rest = [joint.get("rest_deviation_rad", np.inf) for joint in joints]
    return {
        "axes": _column(joints, "axis"),
        "limits": _column(joints, "range", degree),
        "costs": _numbers(costs),
        "relaxed": _column(joints, "relaxed", degree),
        "usual_deviations": _column(joints, "deviation", degree),
        "rest_deviations": _numbers(rest),
        "unmarked_costs": _numbers(factors),
        "unmarked_relaxed": _numbers([each.get("relaxed", -np.inf) for each in feet], degree),
        "unmarked_least": _numbers([each.get("least", -np.inf) for each in feet], degree),
    }


def with_joints(skeleton: Skeleton, name: str) -> Skeleton:
    """The same bones, moved by the joints of a model file: ``torso.toml`` for the upper body.

    ``legs.toml`` has hip and legs, ``whole.toml`` both, ``supple.toml`` wrists and neck as well,
    ``human.toml`` the first paper's.

    Raises:
        KeyError: a joint turns a bone that the skeleton does not have.
    """
    model, dtype = read_model(name), skeleton.lengths.dtype
    columns = joint_columns(model.joints, model.root)
    return replace(
        skeleton,
        tree=_with_dofs(skeleton.tree, model.joints),
        **{key: column.astype(dtype) for key, column in columns.items()},
    )


def with_wrists(skeleton: Skeleton) -> Skeleton:
    """The skeleton with a neck that turns, forearms that twist and wrists; once is enough.

    Three points tell nothing of these seven: they are for markers with an orientation.
    """
    rows, dtype = joint_rows("wrists.toml"), skeleton.axes.dtype
    if rows[0]["name"] in skeleton.tree.joints:
        return skeleton
    return replace(
        skeleton,
        tree=_with_dofs(skeleton.tree, rows, added=True),
        **{
            key: jnp.concatenate([getattr(skeleton, key), column.astype(dtype)])
            for key, column in joint_columns(rows).items()
        },
    )


def _with_dofs(tree: Tree, joints: list[dict], added: bool = False) -> Tree:
    """The same bones turned by other degrees of freedom, or by more."""
    names = tuple(joint["name"] for joint in joints)
    turned = tuple(tree.bone(joint["bone"]) for joint in joints)
    searched = tuple(joint.get("limb", "") for joint in joints)
    if added:
        before = tree.searched or ("",) * len(tree.joints)
        names, turned = (*tree.joints, *names), (*tree.dof_bones, *turned)
        searched = (*before, *searched)
    return replace(tree, joints=names, dof_bones=turned, searched=searched)


def _column(rows: list[dict], key: str, scale: float = 1.0) -> Array:
    """One number, or one vector, of each row."""
    return _numbers([row[key] for row in rows], scale)


def _numbers(values: list, scale: float = 1.0) -> Array:
    """Converted on the host: on the device that would be a program for each shape."""
    dtype = jax.dtypes.canonicalize_dtype(float)
    return jnp.asarray((np.array(values, float) * scale).astype(dtype), dtype)
