"""The skeleton: bones, joints and degrees of freedom as arrays.

INPUTS: a model file (``data/human.toml`` holds Table 1 of the first paper).
OUTPUTS: a Skeleton. Names and the tree are static; every number in it is a traced array, so that
gradients reach lengths, masses, diameters, costs and limits.

A height or a mass scales it by the proportions of ``data/proportions.toml``.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import jax
import numpy as np
from jax import Array

from jaxmocap.body.model_files import (
    HUMAN,
    PROPORTIONS,
    data_of,
    joint_rows,
    proportions_of,
    read_model,
)
from jaxmocap.body.tree import ROOT_DOF, Segment, Tree, with_dofs
from jaxmocap.compilation.arrays import on_device

_LANDMARKS = data_of(HUMAN)["landmark"]
# Landmark -> bone and fraction of its length from its joint.
LANDMARK_PLACES: dict[str, tuple[str, float]] = {
    row["name"]: (row["bone"], float(row["at"])) for row in _LANDMARKS
}
# Their names, in the order of all arrays of them.
LANDMARKS = tuple(LANDMARK_PLACES)


def landmark_rows(names: Iterable[str]) -> np.ndarray:
    """Where the named landmarks are among all ``LANDMARKS``, (K,) int32.

    Raises:
        KeyError: no such landmark; the message lists the valid ones.
    """
    rows = []
    for name in names:
        if name not in LANDMARKS:
            raise KeyError(f"unknown landmark {name!r}; the landmarks are {', '.join(LANDMARKS)}")
        rows.append(LANDMARKS.index(name))
    return np.array(rows, np.int32)


ELBOWS = landmark_rows(("elbow_l", "elbow_r"))


def other_side(names: Sequence[str]) -> np.ndarray:
    """Where each name's counterpart on the body's other side is among them, (K,) int32.

    A name without one, such as ``neck``, is its own.
    """
    ends = {"_l": "_r", "_r": "_l"}
    others = (name[:-2] + ends.get(name[-2:], name[-2:]) for name in names)
    return np.array(
        [names.index(other) if other in names else i for i, other in enumerate(others)], np.int32
    )


def landmark_mismatches() -> np.ndarray:
    """By how much skeletons put each of the ``LANDMARKS`` wrong, (L, 3) metres, world, Z up."""
    sides = [row["mismatch"] for row in _LANDMARKS]
    return np.array([(across, across, upright) for across, upright in sides], float)


TRUNK = ("spine1", "spine2", "spine3")
NECK_HEAD = ("neck", "head")
# Statures that a body may have, metres.
LEAST_HEIGHT_M, MOST_HEIGHT_M = 0.5, 2.5
# Groups of bones that share one number of the tables, in proportion to what they have.
_LONG_TOGETHER = {"spine": "trunk", "head": "neck_head"}
# Clavicles and hips weigh as parts of the trunk.
_HEAVY_TOGETHER = {**_LONG_TOGETHER, "shoulder": "trunk", "hip": "trunk"}
MEAN_BODY_MASS_INDEX = 23.0
# Of ``data/proportions.toml``: where joints are, and what segments are like from outside.
JOINT_CENTRES, WINTER = "joint_centres", "winter"


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
        rest_deviations: (D,) by which joints stray from 0 that outlines hardly determine, radians;
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

    @property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Field -> shape, of all arrays."""
        B, D = len(self.tree.bones), len(self.tree.joints)
        of_bones = {"lengths": (B,), "directions": (B, 3), "masses": (B,), "centres": (B,)}
        of_joints = {"axes": (D, 3), "limits": (D, 2), "costs": (ROOT_DOF + D,)}
        of_joints["unmarked_costs"] = of_joints["costs"]
        each = ("relaxed", "usual_deviations", "rest_deviations")
        one_each = dict.fromkeys((*each, "unmarked_relaxed", "unmarked_least"), (D,))
        return of_bones | {"diameters": (B, 2)} | of_joints | one_each

    @classmethod
    def human(
        cls,
        height: float | None = None,
        mass: float | None = None,
        proportions: str = JOINT_CENTRES,
    ) -> "Skeleton":
        """The paper's subject (Table 1), or a person of that height.

        Args:
            height: metres; None keeps Table 1.
            mass: kilograms; None keeps Table 1's, or follows the height at 23 kg/m^2.
            proportions: of ``data/proportions.toml``: between centres of joints, or "winter".

        Raises:
            ValueError: height outside 0.5 to 2.5 m, or mass outside 10 to 400 kg.
            KeyError: unknown proportions.
        """
        skeleton = load_skeleton(HUMAN)
        if height is None and mass is None:
            return skeleton
        return scale_to_height(skeleton, height, mass, proportions)


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
        tree=with_dofs(bones_alone, model.joints),
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
        tree=with_dofs(skeleton.tree, model.joints),
        **{key: column.astype(dtype) for key, column in columns.items()},
    )


def with_wrists(skeleton: Skeleton) -> Skeleton:
    """The skeleton with a neck that turns, forearms that twist and wrists; once is enough.

    Three points determine none of these seven: they are for markers with an orientation.
    """
    return with_added_joints(skeleton, joint_rows("wrists.toml"))


def with_added_joints(skeleton: Skeleton, rows: list[dict]) -> Skeleton:
    """The skeleton with more joints after its own, by rows of a body's file; none twice."""
    rows = [row for row in rows if row["name"] not in skeleton.tree.joints]
    if not rows:
        return skeleton
    dtype = skeleton.axes.dtype
    return replace(
        skeleton,
        tree=with_dofs(skeleton.tree, rows, added=True),
        **{
            key: on_device(np.concatenate([getattr(skeleton, key), column]), dtype)
            for key, column in joint_columns(rows).items()
        },
    )


def has_wrists(skeleton: Skeleton) -> bool:
    """Whether it has the joints that ``with_wrists`` adds."""
    return joint_rows("wrists.toml")[0]["name"] in skeleton.tree.joints


def _column(rows: list[dict], key: str, scale: float = 1.0) -> Array:
    """One number, or one vector, of each row."""
    return _numbers([row[key] for row in rows], scale)


def _numbers(values: list, scale: float = 1.0) -> Array:
    return on_device(np.array(values, float) * scale)


def scale_to_height(
    skeleton: Skeleton, height: float | None, mass: float | None, proportions: str = JOINT_CENTRES
) -> Skeleton:
    """Scale by height (metres) and mass (kilograms); girths follow from Winter's segments.

    Without a height only the masses change, all by the same factor.

    Raises:
        ValueError: height outside 0.5 to 2.5 m, or mass outside 10 to 400 kg.
        KeyError: unknown proportions.
    """
    if mass is not None and not 10.0 <= mass <= 400.0:
        raise ValueError(f"mass = {mass}: expected kilograms between 10 and 400")
    if height is None:
        factor = 1.0 if mass is None else mass / float(skeleton.masses.sum())
        return replace(skeleton, masses=skeleton.masses * factor)
    if not LEAST_HEIGHT_M <= height <= MOST_HEIGHT_M:
        expected = f"expected metres between {LEAST_HEIGHT_M:g} and {MOST_HEIGHT_M:g}"
        raise ValueError(f"height = {height}: {expected}")
    kilograms = MEAN_BODY_MASS_INDEX * height**2 if mass is None else mass
    masses = _fractions(skeleton, data_of(PROPORTIONS)["masses"], _HEAVY_TOGETHER, skeleton.masses)
    # The table's masses are all of it: what it does not have takes its share from the others.
    masses = masses * kilograms / (masses.sum() if masses.sum() > 1.001 else 1.0)
    # His masses are of his segments.
    lengths, directions = _by_stature(skeleton, height, WINTER)
    scaled = with_girths(skeleton, replace(skeleton, lengths=lengths, masses=on_device(masses)))
    if proportions != WINTER:
        lengths, directions = _by_stature(skeleton, height, proportions)
    return replace(scaled, lengths=lengths, directions=directions)


def _by_stature(skeleton: Skeleton, height: float, proportions: str) -> tuple[Array, Array]:
    """Lengths (B,), metres, and directions (B, 3) of a person of that height."""
    table = proportions_of(proportions)
    shoulder = np.array(table["shoulder"])
    fractions = {**table["lengths"], "shoulder": float(np.linalg.norm(shoulder))}
    lengths = _fractions(skeleton, fractions, _LONG_TOGETHER, skeleton.lengths) * height
    directions = np.array(skeleton.directions)
    for side, left in (("l", 1.0), ("r", -1.0)):
        along = shoulder * [1.0, left, 1.0] / np.linalg.norm(shoulder)
        directions[skeleton.tree.bones_in("shoulder", side=side)] = along
    return on_device(lengths), on_device(directions)


def _fractions(
    skeleton: Skeleton, table: dict[str, float], together: dict[str, str], shares: Array
) -> np.ndarray:
    """One fraction per bone (B,).

    Trunk and neck with head are split in proportion to ``shares``. A bone that the table does not
    have, a tail's, keeps its proportion to all the others.

    Args:
        skeleton: of B bones.
        table: part -> its fraction.
        together: group of bones -> the entry that they share.
        shares: (B,) of the skeleton.
    """
    segments, own = skeleton.tree.segments, np.asarray(shares)
    keys = [together.get(segment.group, segment.part) for segment in segments]
    single = [segment.group not in together for segment in segments]
    fractions = np.full(len(own), np.nan, own.dtype)
    for i, key in enumerate(keys):
        if key in table:
            members = [i] if single[i] else [j for j, other in enumerate(keys) if other == key]
            fractions[i] = table[key] * own[i] / sum(own[j] for j in members)
    is_measured = np.isfinite(fractions)
    return np.where(
        is_measured, fractions, own * fractions[is_measured].sum() / own[is_measured].sum()
    )


def with_girths(old: Skeleton, new: Skeleton) -> Skeleton:
    """Diameters that keep each bone's density: they grow with the root of mass per length."""
    was, now = (np.asarray(each.masses) / np.asarray(each.lengths) for each in (old, new))
    diameters = np.asarray(old.diameters) * np.sqrt(now / was)[:, None]
    return replace(new, diameters=on_device(diameters, old.diameters.dtype))
