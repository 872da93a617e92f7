"""``python -m bench.modelling RECORDINGS [--json FILE]``: models of four photographs each.

Photographs of people of the independent mesh, of true joints, lengths and girths, read as the paper
has it and as measured people need. What the method assumes of people's proportions it has from
``man`` and ``woman``, who therefore are not among those that count.

INPUTS: the folder of recordings, with ``person/person.npz`` in it. OUTPUTS: a table, and Metrics.
"""

from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree

from bench import command, kept, seeds
from bench.anthropometry import MeasuredPerson, tape_measure
from bench.figures import Metric, aligned, write_json
from jaxmocap.pipelines.silhouettes.model import PHOTOGRAPHS, ModelResult, model_from
from jaxmocap.silhouette.modelling.arm_surface import INNER_RINGS, SLICES
from jaxmocap.silhouette.modelling.readings import READINGS
from jaxmocap.synthetic.people.rigged_mesh import Rig, load_rig
from jaxmocap.synthetic.photographs import person_in_stance, write_photographs

PEOPLE = ("tall_man", "short_woman", "broad_man", "slim_woman")
# Where the trunk is measured, of the way from the bottom line to the arm pits; and the arms, of
# each bone.
TRUNK_AT = (0.1, 0.25, 0.4, 0.55, 0.7, 0.85)
ARMS_AT = {"humerus": (0.375, 0.5, 0.625, 0.75), "radius": (0.125, 0.25, 0.5, 0.75)}
# Points along each side of a quadrilateral of the mesh, between which distances are measured.
DENSE = 4


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
        pairs.append((tape_measure(trunk.rings[k][:, [1, 0]]), body.trunk(levels[k])))
    for arm, side in zip(made.model.arms, "lr", strict=True):
        for first, (bone, shares) in zip((0, SLICES[0]), ARMS_AT.items(), strict=True):
            for share in shares:
                outline = arm[INNER_RINGS + first + round(share * SLICES[0])][:, [2, 0]]
                pairs.append((tape_measure(outline), body.arm(bone, side, share)))
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
    return aligned(cells)


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
