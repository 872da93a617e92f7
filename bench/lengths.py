"""``python -m bench.lengths [--seeds 0-2] [--keep DIR]``: what ``scale --recording`` finds.

People of one stature and unusual proportions go through a range of motion before one camera:
stretched arms swung to the side and ahead, elbows bent with the upper arms hanging, forearms folded
before the chest, a bow of the knees. Each length that is estimated is held against the truth in its
own standard deviations; then the same recording is tracked with the body as stated, as estimated
and as it is.

INPUTS: seeds. OUTPUTS: a table, and Metrics.
"""

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from bench import command, kept, seeds
from bench.clips import ELBOWS
from bench.figures import Metric, write_json
from jaxmocap.body.proportions import LENGTHS, scale_skeleton
from jaxmocap.body.skeleton import WINTER, Skeleton
from jaxmocap.evaluation.errors import evaluate
from jaxmocap.evaluation.tables import align_columns
from jaxmocap.formats.recordings.recording import Recording
from jaxmocap.hybrid.tracker import HybridTracker
from jaxmocap.pipelines.kept_programs import keep_compiled
from jaxmocap.pipelines.progress import progress_bar
from jaxmocap.pipelines.scaling.fit_lengths import fit_recording
from jaxmocap.pipelines.tracking.track import track
from jaxmocap.synthetic.movements.motions import STANDING, Performance, spline_through
from jaxmocap.synthetic.people.figure import Figure, Posture
from jaxmocap.synthetic.recording import write_performance

# Standard deviations of lengths among people of one stature, both sides alike.
SPREADS = {
    ("spine",): 0.05,
    ("clavicle",): 0.06,
    ("neck", "head"): 0.05,
    ("humerus",): 0.05,
    ("radius",): 0.05,
    ("hand",): 0.05,
    ("hip",): 0.05,
    ("femur",): 0.05,
    ("tibia",): 0.05,
    ("foot",): 0.05,
}
# From sole to crown; what these lengths together are stays as tall as the person.
UPRIGHT = ("spine", "neck", "head", "femur_l", "tibia_l")
UPPER_ARM, STRETCHED = 0.56, 0.955  # of the arm's length
LOW = np.array([-0.14, 0.0, -0.22])
HEIGHT, SECONDS = 1.75, 6.0
AZIMUTHS = (None, -30.0, 30.0, 0.0, 20.0)


def stretching(seconds: float = 6.0, seed: int = 0, height: float = 1.75) -> Performance:
    """The whole range of motion, once."""
    rng = np.random.default_rng([seed, 9])
    keys = [_varied(key, rng) for key in _keys()]
    # Time goes by as the hands' and the pelvis' ways do.
    ways = [_way(a, b) for a, b in pairwise(keys)]
    times = seconds * np.cumsum([0.0, *ways]) / np.sum(ways)
    figure = unusual(height, np.random.default_rng([seed, 77]))
    path = spline_through(list(zip(times.tolist(), keys, strict=True)))
    return Performance(figure, path, np.array([0.0]))


def unusual(height: float, rng: np.random.Generator) -> Figure:
    """A person of this stature whose lengths are not the mean's."""
    usual = Skeleton.human(height, proportions=WINTER)
    bones, lengths = usual.tree.bones, np.array(usual.lengths, float)
    for starts, spread in SPREADS.items():
        lengths[[name.startswith(starts) for name in bones]] *= 1 + spread * rng.normal()
    upright = [bone for bone, name in enumerate(bones) if name.startswith(UPRIGHT)]
    right = [bones.index(name) for name in ("femur_r", "tibia_r")]
    scale = float(np.asarray(usual.lengths)[upright].sum()) / lengths[upright].sum()
    lengths[[*upright, *right]] *= scale
    return Figure.standing(
        replace(usual, lengths=jnp.asarray(lengths, usual.lengths.dtype)), height
    )


def _keys() -> list[Posture]:
    side = [_stretched(angle, 85) for angle in (12, 30, 50, 70, 88, 70, 50, 30, 12)]
    curls = [_curled(bend) for bend in (20, 50, 80, 110, 130, 110, 80, 50, 20)]
    ahead = [_stretched(angle, 12) for angle in (12, 30, 50, 70, 85)]
    folded = [
        _reaching((0.62, 0.15, -0.12), 50),
        _reaching((0.40, 0.12, -0.22), 75),
        _reaching((0.32, 0.10, -0.30), 85),
        _reaching((0.45, 0.12, -0.20), 60),
    ]
    back = [_stretched(angle, 12) for angle in (70, 50, 30, 12)]
    bowed = [
        _low(_curled(bend), share) for bend, share in ((45, 0.4), (70, 0.9), (70, 0.9), (45, 0.4))
    ]
    return [*side, *curls, *ahead, *folded, *back, *bowed, _stretched(12, 60)]


def _reaching(reach: tuple[float, float, float], swivel: float) -> Posture:
    """Both wrists at a place from their shoulders, in arm lengths; knees a little bent."""
    return replace(
        STANDING,
        pelvis=(0.0, 0.0, -0.045),
        reach_l=reach,
        reach_r=reach,
        swivel_l=swivel,
        swivel_r=swivel,
    )


def _stretched(elevation: float, outward: float) -> Posture:
    """Straight arms, degrees from hanging and from ahead."""
    up, out = np.radians([elevation, outward])
    ahead, side = np.sin(up) * np.cos(out), np.sin(up) * np.sin(out)
    x, y, z = (STRETCHED * np.array([ahead, side, -np.cos(up)])).tolist()
    return _reaching((x, y, z), 30)


def _curled(bend: float) -> Posture:
    """Upper arms hanging, elbows bent by so many degrees."""
    out, bend = np.radians([8.0, bend])
    upper = np.array([np.sin(out) * np.cos(1.4), np.sin(out) * np.sin(1.4), -np.cos(out)])
    fore = np.array([np.sin(bend), np.sin(out), -np.cos(bend)])
    fore /= np.linalg.norm(fore)
    x, y, z = (UPPER_ARM * upper + (1 - UPPER_ARM) * fore).tolist()
    return _reaching((x, y, z), 8)


def _low(posture: Posture, share: float) -> Posture:
    """The same with bent knees and a bowed trunk."""
    x, y, z = (np.array(posture.pelvis) + share * LOW).tolist()
    return replace(
        posture, pelvis=(x, y, z), pitch=26 * share, flexion=14 * share, gaze=(0.0, -6 * share)
    )


def _varied(posture: Posture, rng: np.random.Generator) -> Posture:
    """As it comes out one time."""
    left, right = (
        tuple(np.asarray(reach) + rng.uniform(-0.015, 0.015, 3))
        for reach in (posture.reach_l, posture.reach_r)
    )
    swivels = np.array([posture.swivel_l, posture.swivel_r]) + rng.uniform(-5, 5, 2)
    return replace(
        posture, reach_l=left, reach_r=right, swivel_l=float(swivels[0]), swivel_r=float(swivels[1])
    )


def _way(a: Posture, b: Posture) -> float:
    hands = np.linalg.norm(np.subtract(a.reach_l, b.reach_l))
    return float(max(hands, 0.1 + np.linalg.norm(np.subtract(a.pelvis, b.pelvis))))


class LengthErrors(NamedTuple):
    """Of one person.

    Attributes:
        stated: (P,) logarithms of true lengths over stated ones: errors of the guess.
        errors: (P,) of the estimates.
        deviations: (P,) as reported.
        shares: (P,) of the deviations that were there before.
        elbows: mean distance from the truth, metres: with the body stated, estimated, true.
    """

    stated: np.ndarray
    errors: np.ndarray
    deviations: np.ndarray
    shares: np.ndarray
    elbows: tuple[float, float, float]


def measure(folder: Path, seed: int) -> LengthErrors:
    """Render one person, or take what was rendered, find the lengths, and track."""
    where = folder / f"stretching_{seed:03d}"
    if not (where / "recording.toml").exists():
        azimuth = AZIMUTHS[seed % len(AZIMUTHS)]
        performance = stretching(SECONDS, seed, HEIGHT)
        with progress_bar(f"rendering person {seed}", True) as show:
            write_performance(where, performance, SECONDS, seed, show, azimuth)
    recording = Recording.load(where / "recording.toml")
    person = unusual(HEIGHT, np.random.default_rng([seed, 77])).skeleton
    fit, count = fit_recording(recording, True), len(LENGTHS)
    fitted = fit.logarithms[:count]
    body = scale_skeleton(recording.skeleton, jnp.asarray(fitted, recording.skeleton.lengths.dtype))
    true = replace(recording.skeleton, lengths=person.lengths)
    truth = logarithms(person, recording.skeleton)
    after, before = fit.after[:count], fit.before[:count]
    elbows = [_elbows(recording, body, where) for body in (recording.skeleton, body, true)]
    return LengthErrors(
        truth, fitted - truth, after, after / before, (elbows[0], elbows[1], elbows[2])
    )


def logarithms(person: Skeleton, stated: Skeleton) -> np.ndarray:
    """(P,) of the factors that make one person's ``LENGTHS`` of another's."""
    ratio = np.log(np.asarray(person.lengths) / np.asarray(stated.lengths))
    return np.array([np.mean(ratio[np.array(stated.tree.bones_in(*p.bones))]) for p in LENGTHS])


def _elbows(recording: Recording, body: Skeleton, where: Path) -> float:
    own = replace(recording, skeleton=body)
    motion = track(own, tracker=HybridTracker.from_recording(own), progress=True)
    return evaluate(motion, where / "truth.trc", {name: name for name in ELBOWS}).mean


def text(people: dict[int, LengthErrors]) -> str:
    """A line for each person, one for each length."""
    head = ["person", "lengths off, stated", "estimated", "in deviations"]
    lines = [[*head, "elbows, stated", "estimated", "true"]]
    for seed, fit in people.items():
        shown = [rms(fit.stated), rms(fit.errors)]
        elbows = [f"{100 * error:.2f} cm" for error in fit.elbows]
        off = f"{np.sqrt(np.mean((fit.errors / fit.deviations) ** 2)):.2f}"
        lines.append([str(seed), *(f"{100 * value:.1f} %" for value in shown), off, *elbows])
    each = [["length", "off, stated", "estimated", "reported", "of what it was"]]
    for i, proportion in enumerate(LENGTHS):
        columns = [np.array([getattr(f, name)[i] for f in people.values()]) for name in
                   ("stated", "errors", "deviations", "shares")]  # fmt: skip
        shown = [f"{100 * rms(column):.1f} %" for column in columns[:3]]
        each.append([proportion.name, *shown, f"{100 * columns[3].mean():.0f} %"])
    return f"{align_columns(lines)}\n\n{align_columns(each)}"


def rms(values: np.ndarray) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(values**2)))


def metrics(people: dict[int, LengthErrors]) -> Iterator[Metric]:
    """The table's means."""
    for name in ("stated", "errors"):
        every = np.concatenate([getattr(fit, name) for fit in people.values()])
        yield Metric(
            f"lengths off, {'estimated' if name == 'errors' else name}", 100 * rms(every), "%"
        )
    every = np.concatenate([fit.errors / fit.deviations for fit in people.values()])
    yield Metric("lengths off, in deviations", rms(every), "x")
    elbows = np.mean([fit.elbows for fit in people.values()], 0)
    for name, error in zip(("stated", "estimated", "true"), elbows.tolist(), strict=True):
        yield Metric(f"elbows, lengths {name}", 100 * error, "cm")


def main() -> None:
    """Parse, measure, print."""
    parser = command("bench.lengths", __doc__)
    parser.add_argument("--seeds", type=seeds, default=range(3), help="people; default: 0-2")
    parser.add_argument("--keep", metavar="DIR", help="where rendered recordings stay")
    options = parser.parse_args()
    keep_compiled()
    with kept(options.keep) as folder:
        people = {seed: measure(folder, seed) for seed in options.seeds}
    print(text(people))
    write_json(list(metrics(people)), options.json)


if __name__ == "__main__":
    main()
