"""A person from a body mesh with a rig of its own, moved by recorded surface markers.

Neither the body nor the movement is of our making: a fair test. Each bone of the rig turns the way
the markers point and keeps its own length; the truth is the rig's own joints afterwards.

INPUTS: a rigged mesh (.npz: vertices, quads, skin weights, joints), marker positions of the
Plug-in-Gait set over time. OUTPUTS: a MeshPerson: vertices and landmarks at any time.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path

import numpy as np

from jaxmocap.synthetic.meshes import Mesh
from jaxmocap.synthetic.splines import Spline

# Landmark -> joint of the rig, for one side and for the middle.
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
# From the marker on the skin to the joint's centre, metres.
SHOULDER_DEPTH, ELBOW_DEPTH, KNEE_DEPTH, ANKLE_DEPTH = 0.05, 0.035, 0.05, 0.04
MARKERS = (
    *("LFHD", "RFHD", "LBHD", "RBHD", "C7", "CLAV", "LASI", "RASI", "LPSI", "RPSI"),
    *(
        f"{s}{name}"
        for s in "LR"
        for name in ("SHO", "ELB", "WRA", "WRB", "FIN", "KNE", "ANK", "TOE")
    ),
)
SHIRT, TROUSERS, SKIN, HAIR, SHOES = (
    np.array(colour)
    for colour in (
        *((0.24, 0.30, 0.66), (0.36, 0.30, 0.24), (0.50, 0.60, 0.82)),
        *((0.10, 0.14, 0.20), (0.70, 0.70, 0.70)),
    )
)


@dataclass(frozen=True)
class MeshPerson:
    """A rigged mesh that follows markers.

    Attributes:
        mesh: at rest.
        names: of the J joints.
        parents: (J,) indices, -1 at the root.
        rest: (J, 3) joints at rest, metres: facing -y, left is +x.
        markers: positions (3 per marker, in the order of ``MARKERS``) over time.
    """

    mesh: Mesh
    names: tuple[str, ...]
    parents: tuple[int, ...]
    rest: np.ndarray
    markers: Spline

    def vertices(self, times: np.ndarray) -> np.ndarray:
        """(T, V, 3) in the world, metres, at (T,) times, seconds."""
        R, joints = self.rig(times)
        return self.mesh.posed(R, joints - np.einsum("tjab,jb->tja", R, self.rest))

    def rig(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Turns (T, J, 3, 3) from rest, and positions (T, J, 3), of the joints."""
        centres = _centres(self.markers, times)
        turned, placed = _turns(self, centres), {}
        for name in self._from_root:
            parent = self.parents[self.names.index(name)]
            if parent < 0:
                legs = (centres["LeftUpLeg"] + centres["RightUpLeg"]) / 2
                rest = (self._at("LeftUpLeg") + self._at("RightUpLeg")) / 2 - self._at(name)
                placed[name] = legs - turned[name] @ rest
                continue
            above = self.names[parent]
            turned.setdefault(name, turned[above])
            placed[name] = placed[above] + turned[above] @ (self._at(name) - self._at(above))
        R = np.stack([turned[name] for name in self.names], 1)
        return R, np.stack([placed[name] for name in self.names], 1)

    def landmarks(self, times: np.ndarray) -> dict[str, np.ndarray]:
        """Landmark name -> (T, 3), world, metres: the rig's joints, and the top of the head."""
        return self._landmarks(*self.rig(times))

    def standing(self) -> dict[str, np.ndarray]:
        """The same landmarks (1, 3) at rest: a static trial."""
        return self._landmarks(
            np.broadcast_to(np.eye(3), (1, len(self.names), 3, 3)), self.rest[None]
        )

    def _landmarks(self, R: np.ndarray, joints: np.ndarray) -> dict[str, np.ndarray]:
        points = {name: joints[:, self.names.index(rig)] for name, rig in RIG_LANDMARKS.items()}
        head = self.names.index("Head")
        vertex = joints[:, head] + R[:, head] @ (self.crown - self.rest[head])
        neck = (points["shoulder_l"] + points["shoulder_r"]) / 2
        above = joints[:, self.names.index("Neck")] - neck
        pelvis = (points["hip_l"] + points["hip_r"]) / 2
        # The base of the neck, a little above the line of the shoulders.
        return {"pelvis": pelvis, "neck": neck + 0.5 * above, "vertex": vertex} | points

    @cached_property
    def crown(self) -> np.ndarray:
        """(3,) the highest point of the head, straight above its joint, at rest, metres."""
        return np.append(self.rest[self.names.index("Head"), :2], self.mesh.vertices[:, 2].max())

    @cached_property
    def _from_root(self) -> list[str]:
        """Joint names, parents first."""
        order = [i for i, parent in enumerate(self.parents) if parent < 0]
        for i in order:
            order += [child for child, parent in enumerate(self.parents) if parent == i]
        return [self.names[i] for i in order]

    def _at(self, name: str) -> np.ndarray:
        return self.rest[self.names.index(name)]


def mesh_person(
    file: str | Path,
    positions: Mapping[str, np.ndarray],
    rate: float,
    start: float = 0.0,
    seconds: float = 3.0,
    who: str = "man",
    seed: int = 0,
) -> MeshPerson:
    """A person of a file of rigged meshes, doing what markers did.

    Args:
        file: .npz of people.
        positions: marker -> (N, 3), metres, Z up; all of ``MARKERS`` must be there.
        rate: of the markers, per second.
        start: where the movement begins, seconds; it becomes time 0.
        seconds: how long it lasts. On average the person then faces +x above the origin.
        who: which of the file's people.
        seed: of how the clothes are worn.

    Raises:
        ValueError: no such person, a marker is missing, or the markers end before the movement.
    """
    missing = [name for name in MARKERS if name not in positions]
    if missing:
        raise ValueError(f"marker {missing[0]!r} is missing, found {', '.join(positions)}")
    first, last = int(start * rate), int(np.ceil((start + seconds) * rate)) + 2
    paths = np.stack([positions[name][first:last] for name in MARKERS], 1)
    if len(paths) < last - first:
        raise ValueError(
            f"{start} s + {seconds} s: the markers end at {first + len(paths)} samples"
        )
    paths = _facing_forward(paths)
    times = np.arange(first, last) / rate - start
    with np.load(file) as data:
        people = data["people"].tolist()
        if who not in people:
            raise ValueError(f"unknown person {who!r}; expected one of {', '.join(people)}")
        i = people.index(who)
        mesh = Mesh(
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
    return MeshPerson(
        mesh, names, parents, rest, Spline.through(times, paths.reshape(len(times), -1))
    )


def _facing_forward(paths: np.ndarray) -> np.ndarray:
    """Marker paths (N, M, 3) turned and shifted: the pelvis above the origin, facing +x."""
    left_front, right_front = (paths[:, MARKERS.index(name)] for name in ("LASI", "RASI"))
    left = _unit((left_front - right_front).mean(0) * [1.0, 1.0, 0.0])
    R = np.array([[left[1], -left[0], 0.0], [left[0], left[1], 0.0], [0.0, 0.0, 1.0]])
    middle = (left_front + right_front).mean(0) / 2 * [1.0, 1.0, 0.0]
    return (paths - middle) @ R.T


def _colours(
    mesh: Mesh, names: tuple[str, ...], rest: np.ndarray, rng: np.random.Generator
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


def _centres(markers: Spline, times: np.ndarray) -> dict[str, np.ndarray]:
    """Joint centres and directions (T, 3) from the markers on the skin, world."""
    m = dict(zip(MARKERS, markers(times).reshape(-1, len(MARKERS), 3).swapaxes(0, 1), strict=True))
    front, back = (m["LASI"] + m["RASI"]) / 2, (m["LPSI"] + m["RPSI"]) / 2
    neck, pelvis = (m["C7"] + m["CLAV"]) / 2, (front + back) / 2
    across, up = m["LASI"] - m["RASI"], _unit(neck - pelvis)
    width = np.linalg.norm(across, axis=-1, keepdims=True)
    found = {"neck": neck, "up": up, "across": across, "chest": m["LSHO"] - m["RSHO"]}
    found["ahead"] = m["LFHD"] + m["RFHD"] - m["LBHD"] - m["RBHD"]
    found["head"] = m["LFHD"] + m["LBHD"] - m["RFHD"] - m["RBHD"]
    for side, s, other, out in (("Left", "L", "R", 1), ("Right", "R", "L", -1)):
        # After Bell: a hip lies behind, below and outside the middle of the pelvis' front.
        sideways = 0.36 * out * across - width * (0.30 * up + 0.19 * _unit(front - back))
        found[side + "UpLeg"] = front + sideways
        found[side + "Arm"] = m[s + "SHO"] - SHOULDER_DEPTH * up
        found[side + "ForeArm"] = _inward(m[s + "ELB"], (neck + pelvis) / 2, ELBOW_DEPTH)
        found[side + "Hand"] = (m[s + "WRA"] + m[s + "WRB"]) / 2
        found[side + "HandFinger1"] = m[s + "FIN"]
        found[side + "Leg"] = _inward(m[s + "KNE"], m[other + "KNE"], KNEE_DEPTH)
        found[side + "Foot"] = _inward(m[s + "ANK"], m[other + "ANK"], ANKLE_DEPTH)
        found[side + "ToeBase"] = m[s + "TOE"]
    return found


def _turns(person: MeshPerson, centres: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Joint -> (T, 3, 3) turn from rest, for the joints whose bones the markers show."""
    at = person._at
    left, up, ahead = np.eye(3)[0], np.eye(3)[2], -np.eye(3)[1]

    def turn(seen: np.ndarray, beside: np.ndarray, rest: np.ndarray, rest_beside: np.ndarray):
        return _basis(seen, beside) @ _basis(rest, rest_beside).T

    hips = turn(centres["across"], centres["up"], left, up)
    chest = turn(centres["up"], centres["chest"], up, left)
    head = turn(centres["ahead"], centres["head"], ahead, left)
    turned = {
        "Hips": hips,
        "Spine1": chest,
        "Head": head,
        "LowerBack": _between(hips, chest, 1 / 3),
    }
    turned |= {"Spine": _between(hips, chest, 2 / 3), "Neck1": _between(chest, head, 0.5)}
    for side in ("Left", "Right"):
        bones = [side + part for part in ("Arm", "ForeArm", "Hand", "HandFinger1")]
        seen = [centres[b] - centres[a] for a, b in pairwise(bones)]
        rest = [at(b) - at(a) for a, b in pairwise(bones)]
        hinge, rest_hinge = np.cross(seen[0], seen[1]), np.cross(rest[0], rest[1])
        for bone, now, before in zip(bones, seen, rest, strict=False):
            turned[bone] = turn(now, hinge, before, rest_hinge)
        for bone, end in (("UpLeg", "Leg"), ("Leg", "Foot"), ("Foot", "ToeBase")):
            now = centres[side + end] - centres[side + bone]
            turned[side + bone] = turn(
                now, centres["across"], at(side + end) - at(side + bone), left
            )
    return turned


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def _inward(marker: np.ndarray, towards: np.ndarray, depth: float) -> np.ndarray:
    return marker + depth * _unit(towards - marker)


def _basis(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """(..., 3, 3) orthonormal columns: along ``first``, and across it towards ``second``."""
    x = _unit(first)
    z = _unit(np.cross(x, second))
    return np.stack([x, np.cross(z, x), z], -1)


def _between(a: np.ndarray, b: np.ndarray, share: float) -> np.ndarray:
    """A turn (T, 3, 3) between two that are not far apart."""
    mixed = (1 - share) * a + share * b
    return _basis(mixed[..., 0], mixed[..., 1])
