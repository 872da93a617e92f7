"""``python -m bench.silhouette RECORDINGS``: how well and how fast the silhouette tracker is.

With the options of ``silhouette track`` for its settings: which body, for example.

Rendered exercises by four, three, two cameras and one: how far elbows and knees are bent, against
the truth, where the joints are, and how much they shake. Feet that stand: how high the lowest node
of their skin is over the floor, how far toe and ankle are above or below the truth's, and how far
the toe slides against the truth's, in a second and from a step's first frame to its last. The real
recording by all its cameras. And what a frame takes, stage by stage. Bones have the lengths of the
truth's landmarks; the first pose is the truth's.

INPUTS: the folder of recordings, with ``person/person.npz`` and
``balancing/recording_all_cameras.toml`` in it.
OUTPUTS: tables, and Metrics as JSON.
"""

import argparse
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bench import add_rendered, command, kept
from bench.clips import REAL_LANDMARKS, Clip, exercises, true_skeleton
from bench.clock import STAGES, WHOLE_FRAME, stages_timed
from bench.evaluation import AccelerationAndLag, compare_tracks
from bench.figures import Metric, stage_metrics, table, write_json
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import LANDMARKS, Skeleton, with_joints
from jaxmocap.body.surfaces.surface import Surface, bones_over_time, nodes_over_time
from jaxmocap.cli.silhouette.track import add_settings, settings_of
from jaxmocap.evaluation.errors import Errors, position_errors
from jaxmocap.evaluation.series import match
from jaxmocap.evaluation.tables import align_columns
from jaxmocap.formats.recordings.recording import Recording
from jaxmocap.formats.time_series.tables import Markers
from jaxmocap.formats.time_series.trc import read_trc
from jaxmocap.pipelines.kept_programs import keep_compiled
from jaxmocap.pipelines.silhouettes.demo import JOINTS
from jaxmocap.pipelines.silhouettes.first_pose import start_pose
from jaxmocap.pipelines.silhouettes.track import SilhouetteResult, track_silhouettes
from jaxmocap.silhouette.first_pose import pose_at_landmarks
from jaxmocap.silhouette.settings import Settings
from jaxmocap.silhouette.surfaces.body_shape import determined_landmarks
from jaxmocap.synthetic.four_cameras import HINGES, flexion_angles
from jaxmocap.synthetic.movements.exercises import EXERCISES

KINDS = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
# Joints by which the real recording is evaluated.
REAL_KINDS = ("elbow", "shoulder", "hip", "knee")
REAL = "balancing"
# A foot stands within so much of its toe's lowest place; and the shortest step, frames.
STANDING_M, SHORTEST = 0.01, 3
FEET = {
    "sole over the floor, mean": "cm",
    "sole, RMS": "cm",
    "toe's height off, RMS": "cm",
    "ankle's height off, RMS": "cm",
    "toe slides": "cm/s",
    "over a step": "cm",
}


@dataclass(frozen=True)
class Result:
    """A recording tracked by some of its cameras.

    Attributes:
        name: of the recording.
        cameras: how many.
        errors: of the joints' places.
        bends_off: hinge -> (N,) absolute errors of how far it is bent, radians.
        calm: of the joints.
        feet: the figures of ``FEET``; none of the real recording and of bodies without feet.
    """

    name: str
    cameras: int
    errors: Errors
    bends_off: dict[str, np.ndarray]
    calm: AccelerationAndLag
    feet: Sequence[float] = ()

    def angle(self, kind: str) -> float:
        """Mean error of both elbows or both knees, degrees; NaN where the body has none."""
        both = [off for hinge, off in self.bends_off.items() if hinge.startswith(kind)]
        return float(np.degrees(np.nanmean(both))) if both else float("nan")

    def place(self, *kinds: str) -> float:
        """Mean error over joints of such kinds, left and right, centimetres; NaN without any."""
        of_kind = [name.split("_")[0] in kinds for name in self.errors.joints]
        means = self.errors.statistics()["mean"][of_kind]
        return float(100 * means.mean()) if len(means) else float("nan")

    def shaking(self) -> float:
        """Root mean square acceleration of all joints, by the truth's."""
        return float(np.sqrt(np.nanmean(self.calm.track**2) / np.nanmean(self.calm.reference**2)))


def track_exercise(clip: Clip, cameras: int, settings: Settings) -> Result:
    """A rendered recording by the first of its cameras, bones and first pose from the truth."""
    truth = read_trc(clip.truth).points()
    recording = Recording.load(clip.path)
    skeleton = true_skeleton(recording.skeleton, truth)
    recording = replace(recording, skeleton=skeleton, videos=recording.videos[:cameras])
    return evaluated(clip, recording, true_start(skeleton, truth, settings), settings)


def true_start(
    skeleton: Skeleton, truth: Mapping[str, np.ndarray], settings: Settings | None = None
) -> Pose:
    """The pose at a truth's first landmarks, of a body whose joints the tracker moves."""
    missing = np.full(3, np.nan)
    first = np.array([truth[name][0] if name in truth else missing for name in LANDMARKS])
    body = Settings.body if settings is None else settings.body
    return pose_at_landmarks(with_joints(skeleton, body), first)


def track_real(clip: Clip, settings: Settings) -> Result:
    """The real recording by all its cameras, begun where the markers say."""
    recording = Recording.load(clip.path)
    return evaluated(clip, recording, start_pose(recording, body=settings.body), settings)


def evaluated(
    clip: Clip,
    recording: Recording,
    start: Pose | None,
    settings: Settings | None = None,
    surface: Surface | None = None,
) -> Result:
    """Track, with a surface of the person where there is one, and compare with the truth.

    Joints that the body does not move are left out.
    """
    tracked_by = track_silhouettes(recording, start, settings, surface=surface, progress=True)
    motion, truth = tracked_by.motion, read_trc(clip.truth)
    joints = motion.joints()
    moved = determined_landmarks(motion.skeleton.tree)
    tracked = [name for name in JOINTS if moved[LANDMARKS.index(name)]]
    points = {mark: truth.points()[name] for mark, name in clip.landmarks.items() if mark in JOINTS}
    pairs = {name: name for name in tracked}
    errors = position_errors(motion.times, joints, truth.times, points, pairs)
    ours, theirs = match(motion.times, truth.times)
    actual, expected = flexion_angles(joints), flexion_angles(points)
    hinges = [hinge for hinge, ends in HINGES.items() if {hinge, *ends} <= set(tracked)]
    off = {hinge: np.abs(actual[hinge][ours] - expected[hinge][theirs]) for hinge in hinges}
    places = [np.stack([each[name] for name in tracked], 1) for each in (joints, points)]
    calm = compare_tracks(motion.times, places[0], truth.times, places[1])
    feet = () if clip.name == REAL else foot_figures(tracked_by, truth)
    return Result(clip.name, len(recording.videos), errors, off, calm, feet)


def foot_figures(result: SilhouetteResult, truth: Markers) -> list[float]:
    """``FEET``, of both feet together while they stand on the floor, z = 0."""
    motion = result.motion
    ours, theirs = match(motion.times, truth.times)
    turns, places = bones_over_time(motion.skeleton, motion.poses)
    nodes = nodes_over_time(result.surface.points, turns, places)[ours]
    joints, times, parts = motion.joints(), truth.times[theirs], []
    for patch in result.surface.patches:
        if patch.limb != "foot":
            continue
        true, found = (
            [each[f"{part}_{patch.side}"][rows] for part in ("toe", "ankle")]
            for each, rows in ((truth.points(), theirs), (joints, ours))
        )
        stands = true[0][:, 2] < true[0][:, 2].min() + STANDING_M
        off = np.array(found) - true
        sole = nodes[:, patch.nodes, 2].min(1)
        pairs = stands[1:] & stands[:-1]
        slides = np.linalg.norm(np.diff(off[0, :, :2], axis=0), axis=1) / np.diff(times)
        runs = np.split(np.arange(len(stands)), np.flatnonzero(~pairs) + 1)
        steps = [np.linalg.norm(off[0, run[-1], :2] - off[0, run[0], :2]) for run in runs
                 if len(run) >= SHORTEST]  # fmt: skip
        parts.append((sole[stands], off[0, stands, 2], off[1, stands, 2], slides[pairs], steps))
    if not parts:
        return []
    sole, toe, ankle, slides, steps = (
        100 * np.concatenate(each) for each in zip(*parts, strict=True)
    )
    squares = (float(np.sqrt(np.mean(each**2))) for each in (sole, toe, ankle))
    return [float(np.mean(sole)), *squares, float(np.mean(slides)), float(np.mean(steps))]


def exercise_rows(results: Sequence[Result]) -> list[list[str]]:
    """A row for each exercise by as many cameras, and their means."""
    kinds = [f"{kind}s" for kind in KINDS]
    rows = [["exercise", "elbows", "knees", "joints", *kinds, "acceleration"]]
    rows.append(["", "deg", "deg", "cm", *("cm" for _ in KINDS), "truth's"])
    figures = np.array([_figures(result) for result in results])
    for name, row in zip([r.name for r in results], figures, strict=True):
        rows.append([name, *map(_cell, row)])
    return [*rows, ["mean", *map(_cell, figures.mean(0))]]


def _cell(value: float) -> str:
    """A figure; a dash where the body has no such joints."""
    return "-" if np.isnan(value) else f"{value:.1f}"


def _figures(result: Result) -> list[float]:
    angles = [result.angle(kind) for kind in ("elbow", "knee")]
    places = [result.place(*KINDS), *(result.place(kind) for kind in KINDS)]
    return [*angles, *places, result.shaking()]


def camera_rows(results: Sequence[Result]) -> list[list[str]]:
    """A row for each exercise, with columns for each number of cameras."""
    counts = sorted({result.cameras for result in results}, reverse=True)
    rows = [["exercise", *(f"{n} cam." for n in counts), *(f"{n} cam." for n in counts)]]
    rows.append(["", *("deg" for _ in counts), *("cm" for _ in counts)])
    names, by = (
        list(dict.fromkeys(r.name for r in results)),
        {(r.name, r.cameras): r for r in results},
    )
    figures = np.array(
        [
            [np.nanmean([r.angle("elbow"), r.angle("knee")]) for r in (by[name, n] for n in counts)]
            + [by[name, n].place(*KINDS) for n in counts]
            for name in names
        ]
    )
    rows += [[n, *(f"{v:.1f}" for v in row)] for n, row in zip(names, figures, strict=True)]
    return [*rows, ["mean", *(f"{value:.1f}" for value in figures.mean(0))]]


def real_rows(result: Result) -> list[list[str]]:
    """The real recording, joint kind by joint kind."""
    kinds = [f"{kind}s" for kind in KINDS]
    rows = [["real, four cameras", *kinds, "all four kinds", "elbows", "acceleration"]]
    rows.append(["", *("cm" for _ in KINDS), "cm", "deg", "truth's"])
    places = [result.place(kind) for kind in KINDS] + [result.place(*REAL_KINDS)]
    others = [result.angle("elbow"), result.shaking()]
    return [*rows, [result.name, *(f"{value:.1f}" for value in (*places, *others))]]


def metrics(result: Result) -> Iterator[Metric]:
    """The figures that a baseline holds."""
    name = f"{result.name}, {result.cameras} cameras"
    yield Metric(f"{name}, joints", result.place(*KINDS), "cm", tolerance=0.1)
    if result.name == REAL:
        yield Metric(f"{name}, all four kinds", result.place(*REAL_KINDS), "cm", tolerance=0.05)
    yield Metric(f"{name}, acceleration", result.shaking(), "truth's", tolerance=0.1)
    for kind in ("elbow", "knee"):
        if np.isnan(result.angle(kind)):
            continue
        yield Metric(f"{name}, {kind}s bent", result.angle(kind), "deg", tolerance=0.1)
    for (figure, unit), value in zip(FEET.items(), result.feet, strict=False):
        yield Metric(f"{name}, feet: {figure}", abs(value), unit)


def speed(name: str, frames: Sequence[dict[str, float]]) -> list[Metric]:
    """What a frame takes, stage by stage; the very first, which compiles, apart."""
    first, usual = frames[0], frames[1:]
    result = [Metric(f"{name}, first call", first[WHOLE_FRAME] / 1e3, "s")]
    # A stage that a frame does without takes no time.
    for stage in dict.fromkeys([*STAGES, *first]):
        result += stage_metrics(f"{name}, {stage}", [frame.get(stage, 0.0) for frame in usual])
    rate = 1e3 / np.median([frame[WHOLE_FRAME] for frame in usual])
    return [*result, Metric(f"{name}, frames per second", float(rate), "1/s", "higher")]


def chosen(options: argparse.Namespace, keep: Path) -> list[Clip]:
    """The exercises asked for, rendered where they are not there yet."""
    names = [name for name in options.only if name != REAL]
    file = Path(options.recordings) / "person" / "person.npz"
    people = options.people.split(",")
    return exercises(file, names, options.seeds, people, options.seconds, keep)


def kinds(text: str) -> list[str]:
    """Such as ``push_ups,balancing``."""
    chosen = text.split(",")
    if unknown := [kind for kind in chosen if kind not in (*EXERCISES, REAL)]:
        names = ", ".join((*EXERCISES, REAL))
        raise argparse.ArgumentTypeError(f"{unknown[0]!r}: expected of {names}")
    return chosen


def counts(text: str) -> list[int]:
    """Such as ``4,2``."""
    chosen = text.split(",")
    if not set(chosen) <= set("1234"):
        raise argparse.ArgumentTypeError(f"{text!r}: expected of 4,3,2,1")
    return [int(part) for part in chosen]


def parser() -> argparse.ArgumentParser:
    """The command line."""
    result = command("bench.silhouette", __doc__)
    add = result.add_argument
    add("recordings", help="folder of the real recording and of the rigged meshes")
    choices = (*EXERCISES, REAL)
    add(
        "--only",
        type=kinds,
        default=list(choices),
        metavar="NAME,...",
        help=f"of {', '.join(choices)}",
    )
    add("--cameras", type=counts, default=counts("4,3,2,1"), metavar="4,3,...", help="how many")
    add_rendered(result)
    add_settings(result)
    return result


def main() -> None:
    """Render, track, compare, print."""
    options = parser().parse_args()
    keep_compiled()
    with kept(options.keep) as keep:
        results, timed = measured(options, keep)
    rendered = [result for result in results if result.name != REAL]
    most = [r for r in rendered if r.cameras == max(options.cameras)]
    parts = [exercise_rows(most)] if rendered else []
    parts += [camera_rows(rendered)] if len(options.cameras) > 1 and rendered else []
    standing = [[r.name, *(f"{value:.2f}" for value in r.feet)] for r in most if r.feet]
    if standing:
        parts.append([["feet", *(f"{name}, {unit}" for name, unit in FEET.items())], *standing])
    parts += [real_rows(result) for result in results if result.name == REAL]
    print("\n\n".join([*map(align_columns, parts), table(timed)]))
    write_json([*(m for result in results for m in metrics(result)), *timed], options.json)


def measured(options: argparse.Namespace, keep: Path) -> tuple[list[Result], list[Metric]]:
    """Everything that was asked for, and what a frame took by each number of cameras."""
    results: list[Result] = []
    timed: list[Metric] = []
    clips, settings = chosen(options, keep), settings_of(options)
    for number in options.cameras if clips else ():
        with stages_timed() as clock:
            for clip in clips:
                print(f"tracking {clip.name} by {number}", file=sys.stderr, flush=True)
                results.append(track_exercise(clip, number, settings))
        timed += speed(f"{number} cameras" if number > 1 else "1 camera", clock.frames)
    if REAL in options.only:
        path = Path(options.recordings) / REAL / "recording_all_cameras.toml"
        with stages_timed() as clock:
            results.append(track_real(Clip(REAL, REAL, path, REAL_LANDMARKS), settings))
        timed += speed("real, 4 cameras", clock.frames)
    return results, timed


if __name__ == "__main__":
    main()
