"""``python -m bench.lengths [--seeds 0-2] [--keep DIR]``: what ``scale --recording`` finds.

People of one stature and unusual proportions go through a range of motion before one camera. Each
length that is estimated is held against the truth in its own standard deviations; then the same
recording is tracked with the body as stated, as estimated and as it is.

INPUTS: seeds. OUTPUTS: a table, and Metrics.
"""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from bench import command, kept, seeds
from bench.clips import ELBOWS
from bench.figures import Metric, aligned, write_json
from bench.stretching import stretching, unusual
from jaxmocap.body.proportions import LENGTHS, scaled
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.evaluation.motions import evaluate
from jaxmocap.formats.recordings.recording import Recording
from jaxmocap.pipelines.kept_programs import keep_compiled
from jaxmocap.pipelines.progress import progress_bar
from jaxmocap.pipelines.scaling.fit_lengths import fit_recording
from jaxmocap.pipelines.tracking.track import make_tracker, track
from jaxmocap.synthetic.recording import write_performance

HEIGHT, SECONDS = 1.75, 6.0
AZIMUTHS = (None, -30.0, 30.0, 0.0, 20.0)


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
    body = scaled(recording.skeleton, jnp.asarray(fitted, recording.skeleton.lengths.dtype))
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
    motion = track(own, tracker=make_tracker(own), progress=True)
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
    return f"{aligned(lines)}\n\n{aligned(each)}"


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
