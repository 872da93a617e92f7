"""Common sets of markers: where each one sits on the body, so that no recording has to say it.

INPUTS: ``set``, ``skip`` and ``prefix`` of [markers], [markers.on], the labels of a marker file, a
skeleton. OUTPUTS: entries as those of [markers.on], for the markers that the file has; what is
missing; places on the body with the joints that they determine.

A set is a file in ``data``. Its offsets are metres of a person 1.70 m tall, and grow with the
person. A marker with a ``joint`` is used where the body has that joint: a heel tells nothing of a
body without ankles. Those that sit where there is no bone to name (a wand, a cluster) are
``unused``: [markers.on] can place them.

Head, hands and feet leave trunk, clavicles and ankles open; markers on pelvis, chest, shoulders and
all limbs do not. In a usual posture, with limbs a little bent, the markers' Jacobian shows how far
each joint and each landmark stays open.
"""

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.kinematics import Sites, forward, jacobian, landmark_sites, site_positions
from jaxmocap.body.model import Placed, marker_sites
from jaxmocap.body.model_files import MARKED, joint_rows, proportions_of
from jaxmocap.body.pose import relaxed_pose
from jaxmocap.body.skeleton import JOINT_CENTRES, Skeleton, with_added_joints
from jaxmocap.body.tree import ROOT_DOF
from jaxmocap.formats.files.errors import comma_list, short_repr
from jaxmocap.formats.files.toml import TomlTable
from jaxmocap.formats.recordings.marker_places import MarkerPlace, read_place
from jaxmocap.geometry.rotations import HIGHEST

# Standard deviation of a marker about its point on the body, metres.
MARKER_M = 0.01
# Markers determine a body where they leave none of these landmarks more open than this, metres.
OPEN_M = 0.05
LIMBS = tuple(
    f"{joint}_{side}"
    for joint in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
    for side in "lr"
)
# A joint is determined where its deviation falls to this share of the usual one.
DETERMINED_SHARE = 0.7
# Radians by which limbs are bent: straight, an elbow's or a knee's side would stay open.
BENT = {"elbow_flex": 0.7, "knee_flexion": 0.5, "arm_flex": 0.5, "arm_abduct": 0.5}


def with_marked_joints(skeleton: Skeleton, places: Sequence[Placed]) -> Skeleton:
    """The skeleton with those joints of ``markers.toml`` that the markers determine.

    The skeleton as it is, where markers leave trunk or limbs open.
    """
    rows = joint_rows(MARKED)
    full = with_added_joints(skeleton, rows)
    if not determine_body(full, marker_sites(full, places)):
        return skeleton
    shares = np.asarray(_left_open(full, marker_sites(full, places))[1])
    determined = {
        joint for joint, share in zip(full.tree.joints, shares, strict=True)
        if share < DETERMINED_SHARE
    }  # fmt: skip
    return with_added_joints(skeleton, [row for row in rows if row["name"] in determined])


def determine_body(skeleton: Skeleton, markers: Sites) -> bool:
    """Whether markers leave neither the trunk nor a limb open."""
    # Fewer coordinates than unknowns cannot.
    if 3 * len(markers.bone_indices) < len(skeleton.tree.joints):
        return False
    return bool(_left_open(skeleton, markers)[0].max() < OPEN_M)


@jax.jit
def _left_open(skeleton: Skeleton, markers: Sites) -> tuple[Array, Array]:
    """Deviations of the ``LIMBS``, metres, and (D,) of the joints, as shares of the usual ones."""
    bent = [BENT.get(joint.rpartition("_")[0], 0.0) for joint in skeleton.tree.joints]
    pose = relaxed_pose(skeleton)
    pose = pose._replace(angles=pose.angles + jnp.asarray(bent, pose.angles.dtype))
    frames, usual = forward(skeleton, pose), skeleton.usual_deviations

    def derivatives(sites: Sites) -> Array:
        points = site_positions(skeleton, frames, sites)
        return jacobian(skeleton, frames, sites.bones, points).reshape(-1, ROOT_DOF + usual.size)

    J, limbs = derivatives(markers), derivatives(landmark_sites(skeleton, LIMBS))
    prior = jnp.concatenate([jnp.ones(ROOT_DOF, usual.dtype), 1 / usual**2])
    information = jnp.matmul(J.T, J, precision=HIGHEST) / MARKER_M**2
    covariance = jnp.linalg.inv(information + jnp.diag(prior))
    spread = jnp.sum(jnp.matmul(limbs, covariance, precision=HIGHEST) * limbs, -1).reshape(-1, 3)
    of_joints = jnp.sqrt(jnp.diag(covariance)[ROOT_DOF:])
    return jnp.sqrt(jnp.sum(spread, -1)), of_joints / usual


SET_KEYS = ("set", "skip", "prefix")
# The person whose offsets the files have: OpenSim's full-body model.
STATURE_M = 1.70
_SIDES = (("L", "l"), ("R", "r"))


@dataclass(frozen=True)
class MarkerSet:
    """A set of markers and what a file has of it."""

    name: str
    entries: dict[str, dict[str, Any]]  # label in the file -> its entry, as of [markers.on]
    missing: tuple[str, ...]  # markers of the set that the file does not have, or never measures
    unused: tuple[str, ...]  # labels in the file that the set names but does not place on this body

    def sentence(self) -> str:
        """What was found, in one line."""
        all_count = len(self.entries) + len(self.missing)
        parts = [f"{self.name}: {len(self.entries)} of {all_count} markers"]
        parts += [f"missing {comma_list(self.missing)}"] if self.missing else []
        parts += [f"not used {comma_list(self.unused)}"] if self.unused else []
        return "; ".join(parts)


def set_names() -> tuple[str, ...]:
    """Names of the sets there are."""
    files = resources.files("jaxmocap.formats.marker_sets").joinpath("data").iterdir()
    return tuple(sorted(Path(file.name).stem for file in files if file.name.endswith(".toml")))


@cache
def set_file(name: str) -> tuple[dict[str, dict[str, Any]], tuple[str, ...]]:
    """Marker -> its entry, and unused markers, both with their sides."""
    folder = resources.files("jaxmocap.formats.marker_sets").joinpath("data")
    data = tomllib.loads(folder.joinpath(f"{name}.toml").read_text(encoding="utf-8"))
    markers = {
        label: entry for pattern in data["marker"].items() for label, entry in _both_sides(*pattern)
    }
    unused = [label for each in data["unused"] for label, _ in _both_sides(each, {})]
    return markers, tuple(unused)


def _both_sides(pattern: str, entry: dict[str, Any]) -> list[tuple[str, dict[str, Any]]]:
    """A marker in the middle as it is; of one with a side, the left one and its mirror image."""
    if "{s}" not in pattern:
        return [(pattern, entry)]
    sided = []
    for letter, side in _SIDES:
        texts = {k: v.format(side=side) if isinstance(v, str) else v for k, v in entry.items()}
        if "offset" in entry and side == "r":
            x, y, z = entry["offset"]
            texts["offset"] = [x, -y, z]
        sided.append((pattern.format(s=letter), texts))
    return sided


def read_set(fields: TomlTable, labels: Sequence[str], skeleton: Skeleton) -> MarkerSet | None:
    """The set that [markers] names, of the file's labels, by a person's size; None without.

    Raises:
        InputError: no such set, nothing of it in the file, several people in it, or a marker to
            skip that the set does not have.
    """
    if "set" not in fields:
        for key in SET_KEYS[1:]:
            if key in fields:
                raise fields.error(key, "needs 'set', the set of markers that it is about")
        return None
    name = fields.choice("set", set_names())
    markers, unused = set_file(name)
    skipped = _skipped_markers(fields, (*markers, *unused))
    by_marker = _labels_by_marker(fields, labels, {*markers, *unused})
    fits = {m: "joint" not in e or e["joint"] in skeleton.tree.joints for m, e in markers.items()}
    used = [m for m in markers if fits[m] and m not in skipped]
    if not any(marker in by_marker for marker in used):
        problem = f"none of the markers of {name} is in the file, found {comma_list(labels)}"
        raise fields.error("set", problem)
    factor = _size(skeleton)
    entries = {
        by_marker[m]: {
            "bone": markers[m]["bone"],
            "at": markers[m]["at"],
            "offset": [factor * each for each in markers[m]["offset"]],
        }
        for m in used
        if m in by_marker
    }
    left = [*(m for m in markers if not fits[m]), *unused]
    return MarkerSet(
        name,
        entries,
        tuple(m for m in used if m not in by_marker),
        tuple(by_marker[m] for m in left if m in by_marker and m not in skipped),
    )


def _size(skeleton: Skeleton) -> float:
    """How large a person is against the one of ``STATURE_M``, by trunk and legs."""
    bones = [*skeleton.tree.bones_in("trunk"), *skeleton.tree.bones_in("thigh", "shank", side="l")]
    table = proportions_of(JOINT_CENTRES)["lengths"]
    fractions = sum(table[part] for part in ("trunk", "thigh", "shank"))
    return float(np.asarray(skeleton.lengths, float)[bones].sum()) / (fractions * STATURE_M)


def _skipped_markers(fields: TomlTable, markers: Sequence[str]) -> list[str]:
    """``skip``: markers of the set that are left out."""
    skipped = fields.entries.get("skip", [])
    if not isinstance(skipped, list) or not all(isinstance(each, str) for each in skipped):
        raise fields.error("skip", f"found {short_repr(skipped)}, expected a list of markers")
    for each in skipped:
        if each not in markers:
            problem = f"found {short_repr(each)}, expected some of {comma_list(markers)}"
            raise fields.error("skip", problem)
    return skipped


def _labels_by_marker(
    fields: TomlTable, labels: Sequence[str], markers: set[str]
) -> dict[str, str]:
    """Marker of the set -> its label in the file, which a person's name may precede."""
    people: dict[str, dict[str, str]] = {}
    for label in labels:
        person, _, marker = label.rpartition(":")
        if marker in markers:
            people.setdefault(person, {})[marker] = label
    if "prefix" in fields:
        prefix = fields.text("prefix")
        if prefix.removesuffix(":") not in people:
            found = comma_list(people) if people else "none"
            raise fields.error("prefix", f"found {short_repr(prefix)}, the file has {found}")
        return people[prefix.removesuffix(":")]
    if len(people) > 1:
        problem = f"the file has several people, {comma_list(people)}: state one as prefix"
        raise fields.error("set", problem)
    return next(iter(people.values()), {})


PlacedMarkers = tuple[Skeleton, tuple[MarkerPlace, ...], MarkerSet | None]


def placed_markers(
    fields: TomlTable, on: TomlTable, labels: Sequence[str], skeleton: Skeleton
) -> PlacedMarkers:
    """The places that a set and [markers.on] state.

    A full set determines more than the 21 joints, and those serve more of its markers.

    Returns:
        The body with the joints that they determine, where they sit on it, and the set, or None.
    """

    def on_body(body: Skeleton) -> PlacedMarkers:
        marker_set = read_set(fields, labels, body)
        entries = {**(marker_set.entries if marker_set else {}), **on.entries}
        places = (read_place(fields.path, name, entry) for name, entry in entries.items())
        return body, tuple(places), marker_set

    _, full, _ = on_body(with_added_joints(skeleton, joint_rows(MARKED)))
    if not {place.bone for place in full} <= set(skeleton.tree.bones):
        return on_body(skeleton)
    return on_body(with_marked_joints(skeleton, full))
