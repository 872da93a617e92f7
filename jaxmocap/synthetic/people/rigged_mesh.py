"""A body mesh with a rig of its own: its skin, its clothes, its landmarks.

The rest faces -y, left is +x, the feet stand on z = 0. The body is not of our making: the truth is
the rig's own joints.

INPUTS: people as rigged meshes (.npz: vertices, quads, skin weights, joints); turns of the joints.
OUTPUTS: a RiggedMesh: vertices and landmarks at any time.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jaxmocap.formats.files.arrays import INTEGERS, NAMES, ArraySpec, NpzArrays
from jaxmocap.formats.files.errors import InputError, comma_list
from jaxmocap.synthetic.people.figure import basis
from jaxmocap.synthetic.people.meshes import QuadMesh

# Of a vertex or joint of a file.
LARGEST_COORDINATE_M = 100.0
# A vertex's skin weights add up to 1 within this.
WEIGHT_TOLERANCE = 1e-2
# Arrays of a file of people: P of them, V vertices, F faces, J joints; metres.
FILE_ARRAYS = {
    "people": ArraySpec(("P",), NAMES),
    "vertices": ArraySpec(("P", "V", 3), low=-LARGEST_COORDINATE_M, high=LARGEST_COORDINATE_M),
    "quads": ArraySpec(("F", 4), INTEGERS, low=0),
    "skin_joint": ArraySpec(("V", "K"), INTEGERS, low=0),
    "skin_weight": ArraySpec(("V", "K"), low=0, high=1 + WEIGHT_TOLERANCE),
    "joint_names": ArraySpec(("J",), NAMES),
    "joint_parents": ArraySpec(("J",), INTEGERS, low=-1),
    "joints": ArraySpec(("P", "J", 3), low=-LARGEST_COORDINATE_M, high=LARGEST_COORDINATE_M),
}
# Largest numbers of vertices, faces and joints: a frame is drawn face by face.
MOST_PARTS = {"vertices": 200_000, "quads": 200_000, "joint_names": 500}
# The shortest person of a file, metres.
SHORTEST_M = 0.5
# And the tallest.
TALLEST_M = 2.5
# The shortest distance between two joints of a limb, metres.
SHORTEST_LIMB_M = 0.01
# The person who is taken where none is named.
DEFAULT_PERSON = "man"
# Landmark -> joint of the rig, both without their side.
_PAIRED = {
    **{"shoulder": "Arm", "elbow": "ForeArm", "wrist": "Hand", "hand": "HandFinger1"},
    **{"hip": "UpLeg", "knee": "Leg", "ankle": "Foot", "toe": "ToeBase"},
}
_SIDES = {"l": "Left", "r": "Right"}
RIG_LANDMARKS: dict[str, str] = {
    "head": "Head",
    **{
        f"{name}_{s}": side + joint for name, joint in _PAIRED.items() for s, side in _SIDES.items()
    },
}
# Joints that a rig must have.
ROOT = "Hips"
JOINTS = (*dict.fromkeys([ROOT, *RIG_LANDMARKS.values(), "Spine1", "Neck"]),)
LIMBS = [
    (f"{side}{near}", f"{side}{far}")
    for side in _SIDES.values()
    for chain in (("Arm", "ForeArm", "Hand", "HandFinger1"), ("UpLeg", "Leg", "Foot", "ToeBase"))
    for near, far in pairwise(chain)
]
# Colours of what is worn, BGR, 0 to 1.
SHIRT = np.array([0.24, 0.30, 0.66])
TROUSERS = np.array([0.36, 0.30, 0.24])
SKIN = np.array([0.50, 0.60, 0.82])
HAIR = np.array([0.10, 0.14, 0.20])
SHOES = np.array([0.70, 0.70, 0.70])


class Rig(NamedTuple):
    """A mesh and its J joints at rest."""

    mesh: QuadMesh  # at rest, metres
    names: tuple[str, ...]  # of the joints
    parents: tuple[int, ...]  # (J,) indices, -1 at the root
    rest: np.ndarray  # (J, 3) joints at rest, metres: facing -y, left is +x


@dataclass(frozen=True)
class RiggedMesh(ABC):
    """A rigged mesh, moved by the ``rig`` of the classes that derive from it."""

    body: Rig  # mesh and joints at rest

    @property
    def mesh(self) -> QuadMesh:
        """At rest: its faces and colours."""
        return self.body.mesh

    @abstractmethod
    def rig(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Turns (T, J, 3, 3) from rest, and positions (T, J, 3), of the joints."""

    def vertices(self, times: np.ndarray) -> np.ndarray:
        """(T, V, 3) in the world, metres, at (T,) times, seconds."""
        R, joints = self.rig(times)
        return self.mesh.pose_vertices(R, joints - np.einsum("tjab,jb->tja", R, self.body.rest))

    def chain_turns(
        self, turned: dict[str, np.ndarray], legs: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """``rig`` by turns (T, 3, 3) of some joints, and the hips' middle (T, 3).

        A joint without a turn follows its parent.
        """
        turned, placed, names = dict(turned), {}, self.body.names
        for name in self._from_root:
            parent = self.body.parents[names.index(name)]
            if parent < 0:
                rest = (self.at("LeftUpLeg") + self.at("RightUpLeg")) / 2 - self.at(name)
                placed[name] = legs - turned[name] @ rest
                continue
            above = names[parent]
            turned.setdefault(name, turned[above])
            placed[name] = placed[above] + turned[above] @ (self.at(name) - self.at(above))
        R = np.stack([turned[name] for name in names], 1)
        return R, np.stack([placed[name] for name in names], 1)

    def landmarks(self, times: np.ndarray) -> dict[str, np.ndarray]:
        """Landmark name -> (T, 3), world, metres: the rig's joints, and the top of the head."""
        return self._landmarks(*self.rig(times))

    def standing(self) -> dict[str, np.ndarray]:
        """The same landmarks (1, 3) at rest: a static trial."""
        return self._landmarks(
            np.broadcast_to(np.eye(3), (1, len(self.body.names), 3, 3)), self.body.rest[None]
        )

    def _landmarks(self, R: np.ndarray, joints: np.ndarray) -> dict[str, np.ndarray]:
        points = {
            name: joints[:, self.body.names.index(rig)] for name, rig in RIG_LANDMARKS.items()
        }
        head = self.body.names.index("Head")
        vertex = joints[:, head] + R[:, head] @ (self.crown - self.body.rest[head])
        chest = self.body.names.index("Spine1")
        # The base of the neck, a little above the line of the shoulders.
        nape = (self.at("LeftArm") + self.at("RightArm")) / 4 + self.at("Neck") / 2
        neck = joints[:, chest] + R[:, chest] @ (nape - self.body.rest[chest])
        pelvis = (points["hip_l"] + points["hip_r"]) / 2
        return {"pelvis": pelvis, "neck": neck, "vertex": vertex} | points

    @cached_property
    def crown(self) -> np.ndarray:
        """(3,) the highest point of the head, straight above its joint, at rest, metres."""
        return np.append(
            self.body.rest[self.body.names.index("Head"), :2], self.mesh.vertices[:, 2].max()
        )

    @cached_property
    def _from_root(self) -> list[str]:
        """Joint names, parents first."""
        return [self.body.names[i] for i in _from_roots(self.body.parents)]

    def at(self, name: str) -> np.ndarray:
        """(3,) a joint at rest, metres."""
        return self.body.rest[self.body.names.index(name)]


def load_rig(file: str | Path, who: str | None = None, seed: int = 0) -> Rig:
    """One of the people of an .npz file, see ``FILE_ARRAYS``, in clothes worn as the seed says.

    Without a name the one called man, or else the first.

    Raises:
        InputError: no such file, another kind of file, or one that contradicts itself.
        ValueError: no such person.
    """
    data = _read(file)
    people = data["people"].tolist()
    who = (DEFAULT_PERSON if DEFAULT_PERSON in people else people[0]) if who is None else who
    if who not in people:
        raise ValueError(f"unknown person {who!r}; expected one of {', '.join(people)}")
    i = people.index(who)
    mesh = QuadMesh(
        data["vertices"][i].astype(float),
        data["quads"],
        np.zeros((len(data["quads"]), 3)),
        data["skin_joint"].astype(int),
        data["skin_weight"].astype(float),
    )
    names = tuple(data["joint_names"].tolist())
    parents = tuple(data["joint_parents"].tolist())
    rest = data["joints"][i].astype(float)
    mesh = replace(mesh, colours=_colours(mesh, names, rest, np.random.default_rng([seed, 5])))
    return Rig(mesh, names, parents, rest)


def _read(file: str | Path) -> dict[str, np.ndarray]:
    """The arrays of a file of people, checked."""
    arrays = NpzArrays(file)
    if not set(FILE_ARRAYS) <= set(arrays.names):
        expected = f"expected an .npz with {', '.join(FILE_ARRAYS)}"
        raise InputError(file, f"holds no rigged meshes, {expected}")
    data = arrays.read(FILE_ARRAYS)
    for name in FILE_ARRAYS:
        count = max(data[name].shape[:2]) if name == "vertices" else len(data[name])
        if not data[name].size or count > MOST_PARTS.get(name, count):
            expected = f"expected 1 to {MOST_PARTS.get(name, count)}"
            raise InputError(file, f"{name}: found {count}, {expected}")
    _check_below(file, "quads", data["quads"], data["vertices"].shape[1])
    _check_below(file, "skin_joint", data["skin_joint"], len(data["joint_names"]))
    sums = data["skin_weight"].sum(-1)
    if np.abs(sums - 1).max() > WEIGHT_TOLERANCE:
        i = int(np.abs(sums - 1).argmax())
        raise InputError(file, f"skin_weight[{i}]: together {sums[i]:.4g}, expected 1")
    names = data["joint_names"].tolist()
    _check_tree(file, names, data["joint_parents"].tolist())
    for who, vertices, joints in zip(
        data["people"].tolist(), data["vertices"], data["joints"], strict=True
    ):
        _check_body(file, who, vertices, dict(zip(names, joints, strict=True)))
    return data


def _check_body(
    file: str | Path, who: str, vertices: np.ndarray, joints: dict[str, np.ndarray]
) -> None:
    """InputError unless somebody is as tall as people are, and their limbs have lengths."""
    tall = float(np.ptp(vertices[:, 2]))
    if not SHORTEST_M <= tall <= TALLEST_M:
        expected = f"expected {SHORTEST_M:g} to {TALLEST_M:g} m"
        raise InputError(file, f"{who}: found a body {tall:.4g} m tall, {expected}")
    for near, far in LIMBS:
        if np.linalg.norm(joints[far] - joints[near]) < SHORTEST_LIMB_M:
            raise InputError(file, f"{who}: found {near} and {far} at one place")


def _check_below(file: str | Path, name: str, indices: np.ndarray, count: int) -> None:
    if indices.max() >= count:
        problem = f"found index {indices.max()}, expected one below {count}"
        raise InputError(file, f"{name}: {problem}")


def _check_tree(file: str | Path, names: list[str], parents: list[int]) -> None:
    """InputError unless the joints that are asked for are there, and all hang on one root."""
    missing = [name for name in JOINTS if name not in names]
    if missing or len(set(names)) < len(names):
        problem = f"found no {missing[0]}" if missing else "found a name twice"
        raise InputError(file, f"joint_names: {problem}, expected {', '.join(JOINTS)} and others")
    roots = [name for name, parent in zip(names, parents, strict=True) if parent < 0]
    if roots != [ROOT] or max(parents) >= len(parents):
        problem = f"found roots (-1) {comma_list(roots)} and indices to {max(parents)}"
        expected = f"expected {ROOT} alone and indices below {len(parents)}"
        raise InputError(file, f"joint_parents: {problem}, {expected}")
    reached = _from_roots(parents)
    if len(reached) < len(parents):
        loose = next(i for i in range(len(parents)) if i not in reached)
        raise InputError(file, f"joint_parents: {names[loose]} hangs on no root, a loop")


def _from_roots(parents: Sequence[int]) -> list[int]:
    """What hangs on a root (-1), parents first."""
    order = [i for i, parent in enumerate(parents) if parent < 0]
    for i in order:
        order += [child for child, parent in enumerate(parents) if parent == i]
    return order


def _colours(
    mesh: QuadMesh, names: tuple[str, ...], rest: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """(F, 3) clothes by the bone that carries a face most: shirt, trousers, shoes, bare skin."""
    carrier = mesh.bones[np.arange(len(mesh.bones)), mesh.weights.argmax(-1)][mesh.faces[:, 0]]
    middle = mesh.vertices[mesh.faces].mean(1)
    worn = np.broadcast_to(SKIN, (len(mesh.faces), 3)).copy()
    kinds = {
        "shirt": ("Spine", "LowerBack", "Shoulder", "LeftArm", "RightArm"),
        "trousers": ("Hip", "UpLeg", "LeftLeg", "RightLeg"),
        "shoes": ("Foot", "Toe"),
    }
    tones = {"shirt": SHIRT, "trousers": TROUSERS, "shoes": SHOES}
    for kind, parts in kinds.items():
        of_kind = [i for i, name in enumerate(names) if any(part in name for part in parts)]
        worn[np.isin(carrier, of_kind)] = tones[kind]
    head = rest[names.index("Head")]
    on_head = carrier == names.index("Head")
    worn[on_head & ((middle[:, 2] > head[2] + 0.13) | (middle[:, 1] > head[1] + 0.03))] = HAIR
    stripes = 1 + 0.12 * np.sign(np.sin(middle[:, 2] * 130)) * (worn == SHIRT).all(-1)
    return np.clip(worn * (stripes * rng.normal(1, 0.06, len(worn)))[:, None], 0.02, 1)


def rotation_onto(
    direction: np.ndarray, beside: np.ndarray, rest: np.ndarray, rest_beside: np.ndarray
) -> np.ndarray:
    """Rotations (..., 3, 3) of one pair of directions (3,), at rest, onto another (..., 3)."""
    return basis(direction, beside) @ basis(rest, rest_beside).T


def rotation_between(a: np.ndarray, b: np.ndarray, share: float) -> np.ndarray:
    """A rotation (T, 3, 3) between two that are not far apart."""
    mixed = (1 - share) * a + share * b
    return basis(mixed[..., 0], mixed[..., 1])
