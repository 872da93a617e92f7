"""``python -m bench.modelling RECORDINGS [--json FILE]``: models of four photographs each.

Photographs of people of the independent mesh, of true joints, lengths and girths, read as the paper
has it and as measured people need. The mesh is measured as by tape and callipers. What the method
assumes of people's proportions it has from ``man`` and ``woman``, who therefore are not among those
that count.

INPUTS: the folder of recordings, with ``person/person.npz`` in it. OUTPUTS: a table, and Metrics.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree

from bench import command, kept, seeds
from bench.figures import Metric, write_json
from jaxmocap.evaluation.tables import align_columns
from jaxmocap.pipelines.silhouettes.model import PHOTOGRAPHS, ModelResult, model_from
from jaxmocap.silhouette.modelling.arm_surface import INNER_RINGS, SLICES
from jaxmocap.silhouette.modelling.measurements import GirthSection, girth_section
from jaxmocap.silhouette.modelling.readings import READINGS
from jaxmocap.synthetic.people.figure import unit
from jaxmocap.synthetic.people.rigged_mesh import Rig, RiggedMesh, load_rig
from jaxmocap.synthetic.photographs import person_in_stance, write_photographs

TRUNK = ("Hip", "Spine", "LowerBack", "Neck", "Head", "UpLeg", "Shoulder")
_BONES = {"humerus": ("Arm", "ForeArm"), "radius": ("ForeArm", "Hand")}
_SIDES = {"l": "Left", "r": "Right"}
PEOPLE = ("tall_man", "short_woman", "broad_man", "slim_woman")
# Where the trunk is measured, of the way from the bottom line to the arm pits; and the arms, of
# each bone.
TRUNK_AT = (0.1, 0.25, 0.4, 0.55, 0.7, 0.85)
ARMS_AT = {"humerus": (0.375, 0.5, 0.625, 0.75), "radius": (0.125, 0.25, 0.5, 0.75)}
# Points along each side of a quadrilateral of the mesh, between which distances are measured.
DENSE = 4


@dataclass(frozen=True)
class MeasuredPerson:
    """A person as they stand: everything in the world, metres.

    Attributes:
        person: whose mesh it is.
        vertices: (V, 3).
        R: (J, 3, 3) turns of the rig's joints from rest.
        joints: (J, 3) of the rig.
    """

    person: RiggedMesh
    vertices: np.ndarray
    R: np.ndarray
    joints: np.ndarray

    @classmethod
    def of(cls, person: RiggedMesh) -> "MeasuredPerson":
        """A person at time 0."""
        now = np.zeros(1)
        R, joints = person.rig(now)
        return cls(person, person.vertices(now)[0], R[0], joints[0])

    def landmarks(self) -> dict[str, np.ndarray]:
        """Landmark name -> (3,)."""
        return {name: at[0] for name, at in self.person.landmarks(np.zeros(1)).items()}

    def trunk(self, height: float) -> GirthSection:
        """The level section of trunk, neck or head at a height."""
        cut = self._cut(TRUNK, np.array([0.0, 0.0, height]), np.array([0.0, 0.0, 1.0]))
        return girth_section(cut[:, [1, 0]])

    def arm(self, bone: str, side: str, at: float) -> GirthSection:
        """The section square to ``humerus`` or ``radius`` of side l or r, at a share of it."""
        near, far = (self._joint(_SIDES[side] + name) for name in _BONES[bone])
        names = self.person.body.names
        shoulder, elbow, wrist = (
            self.person.at(_SIDES[side] + name) for name in ("Arm", "ForeArm", "Hand")
        )
        rest_hinge = np.cross(elbow - shoulder, wrist - elbow)
        hinge = self.R[names.index(_SIDES[side] + _BONES[bone][0])] @ rest_hinge
        along = unit(far - near)
        hinge = unit(hinge - along * (along @ hinge))
        carriers = tuple(_SIDES[side] + name for name in ("Arm", "ForeArm", "Hand"))
        cut = self._cut(carriers, near + at * (far - near), along)
        return girth_section(np.stack([cut @ hinge, cut @ np.cross(along, hinge)], 1))

    def _joint(self, name: str) -> np.ndarray:
        return self.joints[self.person.body.names.index(name)]

    def _cut(self, parts: tuple[str, ...], origin: np.ndarray, normal: np.ndarray) -> np.ndarray:
        """(N, 3) where a plane crosses the edges of faces that only these bones carry most."""
        mesh, names = self.person.mesh, self.person.body.names
        carrier = mesh.bones[np.arange(len(mesh.bones)), mesh.weights.argmax(-1)]
        of_part = np.array([any(part in name for part in parts) for name in names])
        faces = mesh.faces[of_part[carrier][mesh.faces].all(1)]
        a, b = self.vertices[faces], self.vertices[np.roll(faces, -1, 1)]
        above, below = (a - origin) @ normal, (b - origin) @ normal
        crossed = above * below < 0
        share = (above / np.where(crossed, above - below, 1.0))[..., None]
        return (a + share * (b - a))[crossed]


class Errors(NamedTuple):
    """What is off, absolute: (N,) arrays.

    Attributes:
        shoulders: metres.
        elbows: metres.
        wrists: metres.
        lengths: upper arms, forearms, from shoulder to shoulder, metres.
        sizes: widths and depths of trunk and arms, metres.
        girths: of trunk and arms, as a share.
        surface: the trunk's nodes below the arm pits, to the mesh, metres.
        seconds: from files to the model.
    """

    shoulders: np.ndarray
    elbows: np.ndarray
    wrists: np.ndarray
    lengths: np.ndarray
    sizes: np.ndarray
    girths: np.ndarray
    surface: np.ndarray
    seconds: np.ndarray


def errors(rig: Rig, folder: Path, calibration: Path, reading: str) -> Errors:
    """Make the model of a person's photographs and compare."""
    files = {name: folder / f"{name}.png" for name in PHOTOGRAPHS}
    made = model_from(files, calibration, folder / "model", reading=reading)
    body = MeasuredPerson.of(person_in_stance(rig, "front"))
    sizes, girths = sections(made, body)
    shoulders, elbows, wrists = joints(made, rig)
    return Errors(
        shoulders, elbows, wrists, lengths(made, body), sizes, girths, surface(made, body),
        np.array([made.seconds]),
    )  # fmt: skip


def joints(made: ModelResult, rig: Rig) -> np.ndarray:
    """(3, 2) of shoulders, elbows and wrists, metres, in the joint view's stance."""
    truth = MeasuredPerson.of(person_in_stance(rig, "joint")).landmarks()
    off = [
        [
            getattr(b, name) - truth[f"{name}_{s}"]
            for b, s in zip(made.model.bent, "lr", strict=True)
        ]
        for name in ("shoulder", "elbow", "wrist")
    ]
    return np.linalg.norm(off, axis=-1)


def lengths(made: ModelResult, body: MeasuredPerson) -> np.ndarray:
    """(5,) metres."""
    at, measured = body.landmarks(), made.model.lengths()
    ends = {"shoulders": ("shoulder_l", "shoulder_r")}
    for s in "lr":
        ends |= {f"humerus_{s}": (f"shoulder_{s}", f"elbow_{s}")}
        ends |= {f"radius_{s}": (f"elbow_{s}", f"wrist_{s}")}
    return np.abs([measured[k] - np.linalg.norm(at[a] - at[b]) for k, (a, b) in ends.items()])


def sections(made: ModelResult, body: MeasuredPerson) -> tuple[np.ndarray, np.ndarray]:
    """Widths and depths, metres, and girths, as a share."""
    trunk, pairs = made.model.trunk, []
    levels = trunk.rings[:, 0, 2]
    for share in TRUNK_AT:
        height = levels[0] + share * (trunk.pits[:, 2].mean() - levels[0])
        k = int(np.argmin(np.abs(levels - height)))
        pairs.append((girth_section(trunk.rings[k][:, [1, 0]]), body.trunk(levels[k])))
    for arm, side in zip(made.model.arms, "lr", strict=True):
        for first, (bone, shares) in zip((0, SLICES[0]), ARMS_AT.items(), strict=True):
            for share in shares:
                outline = arm[INNER_RINGS + first + round(share * SLICES[0])][:, [2, 0]]
                pairs.append((girth_section(outline), body.arm(bone, side, share)))
    measured, truth = np.array(pairs).swapaxes(0, 1)
    return np.abs(measured - truth)[:, :2].ravel(), np.abs(measured / truth - 1)[:, 2]


def surface(made: ModelResult, body: MeasuredPerson) -> np.ndarray:
    """(N,) metres from the trunk's nodes below the arm pits to the nearest point of the mesh."""
    u, v = (a.ravel()[:, None, None] for a in np.meshgrid(*[np.linspace(0, 1, DENSE)] * 2))
    a, b, c, d = np.moveaxis(body.vertices[body.person.mesh.faces], 1, 0)
    dense = (1 - u) * ((1 - v) * a + v * d) + u * ((1 - v) * b + v * c)
    trunk = made.model.trunk
    nodes = trunk.rings[trunk.rings[:, 0, 2] < trunk.pits[:, 2].min()].reshape(-1, 3)
    return np.asarray(KDTree(dense.reshape(-1, 3)).query(nodes)[0])


def text(rows: dict[str, Errors]) -> str:
    """The table: mean and largest, centimetres and per cent."""
    head = [
        "",
        "shoulders cm",
        "elbows cm",
        "wrists cm",
        "lengths cm",
        "widths, depths cm",
        "girths %",
        "trunk's surface cm",
        "s",
    ]
    cells = [head]
    for name, row in rows.items():
        errors = [f"{100 * e.mean():.1f} ({100 * e.max():.1f})" for e in row[:-1]]
        cells.append([name, *errors, f"{row.seconds.mean():.1f}"])
    return align_columns(cells)


def together(rows: Sequence[Errors]) -> Errors:
    """Of several people."""
    return Errors(*(np.concatenate(parts) for parts in zip(*rows, strict=True)))


def metrics(reading: str, every: Errors) -> list[Metric]:
    """Means and largest of everybody, by one reading."""
    result, start = [], f"model, {reading} reading,"
    for name, off in zip(Errors._fields[:-1], every, strict=False):
        unit, factor = ("%", 100) if name == "girths" else ("cm", 100)
        result.append(Metric(f"{start} {name} mean", float(factor * off.mean()), unit))
        result.append(Metric(f"{start} {name} largest", float(factor * off.max()), unit))
    return result


def main(arguments: Sequence[str] | None = None) -> None:
    """Parse, measure, print."""
    parser = command("bench.modelling", __doc__)
    parser.add_argument("recordings", metavar="RECORDINGS")
    parser.add_argument("--people", default=",".join(PEOPLE), help="default: %(default)s")
    parser.add_argument(
        "--seeds", type=seeds, default=seeds("0"), metavar="0-2", help="of backdrops and noise"
    )
    parser.add_argument("--keep", metavar="DIR", help="keep photographs here")
    options = parser.parse_args(arguments)
    people = Path(options.recordings) / "person" / "person.npz"
    rows: dict[str, dict[str, list[Errors]]] = {reading: {} for reading in READINGS}
    with kept(options.keep) as keep:
        for who, seed in product(options.people.split(","), options.seeds):
            rig, folder = load_rig(people, who), keep / f"{who}_{seed}"
            calibration = write_photographs(folder, rig, seed)
            for reading, of in rows.items():
                of.setdefault(who, []).append(errors(rig, folder, calibration, reading))
    summed = {
        reading: together([each for some in of.values() for each in some])
        for reading, of in rows.items()
    }
    for reading, of in rows.items():
        print(f"\n{reading} reading")
        print(text({who: together(some) for who, some in of.items()} | {"all": summed[reading]}))
    write_json([m for pair in summed.items() for m in metrics(*pair)], options.json)


if __name__ == "__main__":
    main()
