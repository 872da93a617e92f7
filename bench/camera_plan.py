"""``python -m bench.camera_plan``: what ``jaxmocap plan`` expects, beside what is found.

Cameras all about a person, near and far, low and high: each films three movements (rendered), which
are tracked offline. Expected deviations of the elbows come from the movement and the camera's
place alone.

INPUTS: a seed of the places and the people. OUTPUTS: a table with rank correlations; a picture;
Metrics as JSON.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from scipy.stats import rankdata

from bench import command, kept
from bench.clips import ELBOWS, performed
from bench.figures import Metric, table, write_json
from jaxmocap.body.skeleton import ELBOWS as ELBOW_ROWS
from jaxmocap.body.skeleton import LANDMARKS
from jaxmocap.calibration.fitting.camera_plan.expected import of_markers, with_camera
from jaxmocap.calibration.fitting.camera_plan.placement import mean_deviation
from jaxmocap.evaluation.errors import evaluate
from jaxmocap.evaluation.plots import new_panels, save_figure
from jaxmocap.formats.recordings.recording import Recording
from jaxmocap.geometry.cameras import Camera
from jaxmocap.hybrid.settings import Settings
from jaxmocap.pipelines.kept_programs import keep_compiled
from jaxmocap.pipelines.planning.subject import drawn_subject, movement_of, settings_for
from jaxmocap.pipelines.tracking.track import track
from jaxmocap.synthetic.drawing_camera import look_at
from jaxmocap.synthetic.people.clothed_person import clothed_actor
from jaxmocap.synthetic.recording import VIDEO_RATE, recording_parts, video_times, write_parts
from jaxmocap.synthetic.renderer import RotatedMover, Scene, render_frames

MOVEMENTS = ("tennis", "across", "raises")
SECONDS, HEIGHT_M = 4.0, 1.75
PLACES = 12
# From and to: distance, height, and height of what is looked at, metres.
DISTANCES_M, HEIGHTS_M, TARGETS_M = (1.6, 3.6), (0.5, 2.2), (0.9, 1.2)
COLOURS = {"tennis": "#1557b0", "across": "#c62828", "raises": "#2e7d32"}


class Place(NamedTuple):
    """Where a camera stands: azimuth from frontal, degrees; distance, height, target, metres."""

    azimuth: float
    distance: float
    height: float
    target: float

    def camera(self, azimuth: float) -> Camera:
        """At an azimuth about the person."""
        turn = np.deg2rad(azimuth)
        level = self.distance * np.array([np.cos(turn), np.sin(turn)])
        return look_at((*level, self.height), (0.0, 0.0, self.target))


class Outcome(NamedTuple):
    """Deviation of the elbows that was expected, stated and found, centimetres."""

    expected: float
    stated: float
    found: float


def places(seed: int) -> list[Place]:
    """All about the person, evenly, otherwise at random."""
    rng = np.random.default_rng([seed, 45])
    turn = rng.uniform(0, 360 / PLACES)
    return [
        Place(
            -180 + turn + 360 * k / PLACES,
            *(rng.uniform(*span) for span in (DISTANCES_M, HEIGHTS_M, TARGETS_M)),
        )
        for k in range(PLACES)
    ]


def filmed(folder: Path, movement: str, seed: int, place: Place) -> Path:
    """The recording of a movement by a camera at a place, rendered once."""
    path = folder / f"{movement}_{seed}_{place.azimuth:+.0f}_{place.distance:.2f}"
    if (path / "recording.toml").is_file():
        return path
    performance = performed(movement, SECONDS, seed, place.azimuth)
    parts = recording_parts(performance, SECONDS, place.camera(place.azimuth))
    # The room is furnished behind the person, as the camera at azimuth 0 sees it.
    mover = RotatedMover(clothed_actor(performance, seed, 1), place.azimuth)
    scene = Scene.in_room(place.camera(0.0), mover, seed, True)
    write_parts(path, parts, render_frames(scene, video_times(SECONDS)), seed)
    return path


def outcomes(folder: Path, movement: str, seed: int, where: list[Place]) -> Iterator[Outcome]:
    """Of each place."""
    subject = drawn_subject(performed(movement, SECONDS, seed, 0.0), HEIGHT_M, SECONDS)
    moments, skeleton = movement_of(subject), subject.model.skeleton
    settings = settings_for(subject.model, Settings().smoothing, moments)
    information = of_markers(subject.model, settings, moments)
    weights = jnp.zeros(len(LANDMARKS)).at[ELBOW_ROWS].set(0.5)
    for place in where:
        camera, rate = place.camera(place.azimuth), jnp.asarray(float(VIDEO_RATE))
        filmed_too = with_camera(skeleton, settings, information, camera, rate)
        expected = 100 * float(mean_deviation(settings, filmed_too, weights))
        path = filmed(folder, movement, seed, place)
        motion = track(Recording.load(path / "recording.toml"), progress=False)
        errors = evaluate(motion, path / "truth.trc", dict(zip(ELBOWS, ELBOWS, strict=True)))
        assert motion.report is not None
        stated = 100 * float(np.nanmean(motion.report.elbow_deviations))
        outcome = Outcome(expected, stated, 100 * float(np.nanmean(errors.distances)))
        print(movement, seed, *(f"{each:.2f}" for each in (*place, *outcome)), flush=True)
        yield outcome


def rank_correlation(first: np.ndarray, second: np.ndarray) -> float:
    """Spearman's."""
    return float(np.corrcoef(rankdata(first), rankdata(second))[0, 1])


def correlations(found: dict[str, list[Outcome]]) -> Iterator[Metric]:
    """Of ranks, movement by movement, and of the movements' means."""
    every = {name: np.array(of) for name, of in found.items()}
    every["all, in the mean"] = np.mean(list(every.values()), 0)
    for name, of in every.items():
        ranks = rank_correlation(of[:, 0], of[:, 2])
        yield Metric(f"{name}, rank correlation with errors", ranks, "")
        ranks = rank_correlation(of[:, 0], of[:, 1])
        yield Metric(f"{name}, rank correlation with stated", ranks, "")
        for column, what in enumerate(Outcome._fields):
            yield Metric(f"{name}, elbows, {what}", float(of[:, column].mean()), "cm")


def plot(path: str, found: dict[str, list[Outcome]]) -> None:
    """Errors found over deviations expected."""
    figure, axes = new_panels(1, 1, (5.0, 4.4))
    panel = axes[0, 0]
    for name, of in found.items():
        expected, _, error = np.array(of).T
        ranks = rank_correlation(expected, error)
        label = f"{name}, rank correlation {ranks:.2f}"
        panel.plot(expected, error, "o", color=COLOURS[name], label=label)
    panel.margins(0.05)
    panel.set_xlabel("expected deviation of the elbows [cm]")
    panel.set_ylabel("error found [cm]")
    panel.legend(frameon=False, fontsize="small")
    save_figure(figure, path, "")


def main() -> None:
    """Render, track, compare, print."""
    parser = command("bench.camera_plan", __doc__)
    add = parser.add_argument
    add("--seed", type=int, default=0, help="of places and people; default: %(default)s")
    add("--keep", metavar="DIR", help="keep rendered recordings here, rendered once")
    add("--picture", metavar="FILE", help="errors over expectations")
    options = parser.parse_args()
    keep_compiled()
    where, seed = places(options.seed), options.seed
    with kept(options.keep) as folder:
        found = {name: list(outcomes(folder, name, seed, where)) for name in MOVEMENTS}
    metrics = list(correlations(found))
    print(table(metrics))
    if options.picture:
        plot(options.picture, found)
    write_json(metrics, options.json)


if __name__ == "__main__":
    main()
