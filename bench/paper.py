"""``python -m bench.paper [RECORDINGS] [--only loop|times|low-pass]``: what the papers report.

The first paper's loop, live, and what its simplex is worth: table tennis as in the paper, the
camera in front, in a bare and in a furnished room. Every video frame is one step: inverse
kinematics by SDLS, regions and edges, the chamfer sum (13) minimised from the markers' pose,
balance. The sum is drawn as a raster, or integrated over points. The simplex over both arms stands
beside least squares over the whole body, which always integrate.

The times that both papers state: the balance of a squat (first paper, 5.3), the pose of 100 points
on rays, from 20 degrees and 5 cm off (second paper, 3.1.3), and the pose of a free-form contour and
of a surface (3.1.4, 3.1.5), of which the paper says 10 iterations: here as many as it takes from 30
degrees and 5 cm off, and ten alone. All programs are compiled before. For one core: ``taskset -c 0
python -m bench.paper --only times``.

A low-pass on poses that are found frame by frame, which the first paper's section 7 proposes
against oscillations that video brings: table tennis from five sides, and the four cameras of the
real recording, by ``--paper`` and by our own way without smoothing. The elbows' mean error, its
part above 0.3 Hz, and their acceleration by the truth's.

INPUTS: seeds of players; for the low-pass the folder of recordings, without which there are the
synthetic ones alone.
OUTPUTS: a table, and Metrics.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from bench import command, kept, seeds
from bench.clips import AZIMUTHS, Clip, real, synthetic
from bench.clock import interleaved
from bench.contour_pose import camera_at, surface_trial, trial
from bench.evaluation import calm_of
from bench.figures import Metric, stage_metrics, write_json
from jaxmocap.body.kinematics import forward, landmarks
from jaxmocap.body.motion import Motion
from jaxmocap.body.pose import relaxed_pose, retract
from jaxmocap.body.skeleton import LANDMARKS, Skeleton
from jaxmocap.body.surfaces.surface import BodyPoints, pose_points
from jaxmocap.capture.markers import interpolate_markers
from jaxmocap.capture.video import open_video
from jaxmocap.evaluation.errors import evaluate
from jaxmocap.evaluation.tables import align_columns
from jaxmocap.formats.recordings.recording import Recording
from jaxmocap.formats.time_series.markers import read_markers
from jaxmocap.geometry.cameras import project
from jaxmocap.hybrid.balance import bow_factors, bow_on_feet
from jaxmocap.hybrid.paper.chamfer import Chamfer
from jaxmocap.hybrid.settings import IKSettings, Settings
from jaxmocap.hybrid.tracker import HybridTracker
from jaxmocap.pipelines.kept_programs import keep_compiled
from jaxmocap.pipelines.tracking.motions import low_pass_poses
from jaxmocap.pipelines.tracking.track import track
from jaxmocap.silhouette import ContourPoseSettings, solve_contour_pose
from jaxmocap.silhouette.points import PointRays, contour_rays
from jaxmocap.silhouette.pose import PoseSettings, solve_pose
from jaxmocap.synthetic.recording import write_table_tennis

PAPER = Settings.paper()
INTEGRATED = replace(PAPER, edges=Chamfer(drawn=False))
WAYS = {
    "markers": replace(PAPER, refine="none"),
    "simplex, drawn": PAPER,
    "simplex, integrated": INTEGRATED,
    "least squares, integrated": replace(INTEGRATED, refine="gradient"),
}
ELBOWS = [LANDMARKS.index(f"elbow_{side}") for side in "lr"]
# Steps that compile, or wait for memory.
WARM = 5
HEADINGS = [["room", "way", "left", "right", "against", "ms a step", "", "frames"],
            ["", "", "cm", "cm", "markers", "median", "99 %", "per s"]]  # fmt: skip
CUTOFFS = (0.0, 1.0, 2.0, 4.0, 6.0)
FIGURES = {"mean": "cm", "above 0.3 Hz": "cm", "acceleration": "truth's"}
POINTS = 100
# Degrees and metres by which a contour's start is off.
OFF = 30.0, 0.05
# All that a contour needs; and one cycle and three times three, ten: the paper's number.
CYCLES = {
    "": ContourPoseSettings(),
    ", 10 cycles": ContourPoseSettings(harmonics=(8,), low_cycles=1, cycles=3, rest=0.0),
}
_LANDMARKS = jax.jit(landmarks)


def steps(path: Path, settings: Settings) -> tuple[np.ndarray, np.ndarray]:
    """Elbows' distances (F, 2) from the truth, cm, and what the F steps took, ms."""
    recording = Recording.load(path)
    tracker, truth = (
        HybridTracker.from_recording(recording, settings),
        read_markers(path.parent / "truth.trc"),
    )
    true = np.stack([truth.points()[name] for name in ("elbow_l", "elbow_r")], 1)
    frames = list(open_video(recording.videos[0]).frames())
    times = np.array([time for time, _ in frames])
    markers = interpolate_markers(recording.times, recording.positions_world, times)
    there = interpolate_markers(truth.times, true, times)
    state, off, spent = tracker.init(markers[0]), [], []
    images = [[image] if tracker.model.camera_count else None for _, image in frames]
    for time, points, elbows, image in zip(times, markers, there, images, strict=True):
        began = perf_counter()
        state, pose, _ = jax.block_until_ready(tracker.step(state, time, points, image))
        spent.append(1e3 * (perf_counter() - began))
        found = np.asarray(_LANDMARKS(tracker.model.skeleton, pose))[ELBOWS]
        off.append(100 * np.linalg.norm(found - elbows, axis=-1))
    return np.array(off), np.array(spent)


def loop(players: list[int], seconds: float, folder: Path) -> Iterator[Metric]:
    """A row and its metrics, for each room and way."""
    cells = [*HEADINGS]
    for room in ("bare", "furnished"):
        paths = [
            write_table_tennis(
                folder / room / str(seed), seconds, seed=seed, furnished=room == "furnished"
            )
            for seed in players
        ]
        alone = np.nan
        for way, settings in WAYS.items():
            each = [steps(path, settings) for path in paths]
            left, right = np.mean([np.nanmean(off, 0) for off, _ in each], 0)
            alone = right if way == "markers" else alone
            spent = np.concatenate([times[WARM:] for _, times in each])
            median, late = np.percentile(spent, [50, 99])
            name = f"paper, {room}, {way}"
            times = (f"{median:.1f}", f"{late:.1f}", f"{1e3 / median:.0f}")
            errors = (f"{left:.1f}", f"{right:.1f}", f"{right / alone - 1:+.0%}")
            cells.append([room, way, *errors, *times])
            yield Metric(f"{name}, right elbow", float(right), "cm")
            yield Metric(f"{name}, left elbow", float(left), "cm")
            yield from stage_metrics(f"{name}, step", spent)
    print(align_columns(cells))


def balance() -> Callable[[], Any]:
    """The bow of a squat."""
    skeleton, settings = Skeleton.human(), IKSettings()
    pose = relaxed_pose(skeleton)
    squat = pose._replace(position=pose.position.at[2].set(0.6))
    return partial(jax.jit(bow_on_feet), skeleton, settings, squat, bow_factors(skeleton, settings))


def points_on_rays() -> Callable[[], Any]:
    """A rigid body of points before one camera, until it rests."""
    skeleton, rng = Skeleton.human(), np.random.default_rng(0)
    places = rng.normal(0, 0.15, (POINTS, 1, 3)).astype(np.float32)
    one = np.ones((POINTS, 1), np.float32)
    points, truth = BodyPoints(np.zeros((POINTS, 1), np.int32), places, one), relaxed_pose(skeleton)
    camera = camera_at(0.0)
    pixels = project(camera, pose_points(forward(skeleton, truth), points))
    lines, across = contour_rays(camera, pixels, jnp.tile(jnp.asarray([1.0, 0.0]), (POINTS, 1)))
    pairs = PointRays(points, lines, across, jnp.ones(POINTS), jnp.ones(POINTS))
    free = jnp.arange(len(skeleton.costs)) < 6
    step = jnp.zeros(len(free)).at[:6].set(jnp.asarray([0.03, 0.03, -0.03, 0.2, -0.2, 0.2]))
    solve = jax.jit(lambda start: solve_pose(skeleton, start, pairs, PoseSettings(), free=free))
    return partial(solve, retract(truth, step))


def contours(number: int) -> Iterator[tuple[str, Callable[[], Any]]]:
    """Of a wire and of a surface before so many cameras."""
    cameras = [camera_at(0.8 * k) for k in range(number)]
    for form, make in (("contour", trial), ("surface", surface_trial)):
        each = make(cameras, (1, number), False, OFF)
        solve = partial(solve_contour_pose, each.shape, cameras, each.outlines, each.start)
        for way, settings in CYCLES.items():
            yield f"{form}, {number} cameras{way}", partial(solve, settings)


def stated_times(rounds: int) -> Iterator[Metric]:
    """Ours beside those that the papers state."""
    functions = {"balance": balance(), f"{POINTS} points": points_on_rays()}
    functions |= {name: each for number in (1, 2) for name, each in contours(number)}
    paper = {"balance": "< 1", f"{POINTS} points": "2", "contour, 1 cameras, 10 cycles": "40"}
    cells = [["ms", "paper", "ours, median", "processor", "99 %"]]
    for name, spans in interleaved(functions, rounds).items():
        (wall, busy), late = np.median(spans, 0), np.percentile(spans[:, 0], 99)
        figures = (f"{value:.2f}" for value in (wall, busy, late))
        cells.append([name, paper.get(name, ""), *figures])
        yield from stage_metrics(f"paper's times, {name}", spans[:, 0])
    print(align_columns(cells))


def filtered(motion: Motion, clip: Clip, cutoff: float) -> tuple[float, float, float]:
    """The ``FIGURES`` of both elbows below a cut-off, Hz; 0 is none."""
    if cutoff:
        poses = low_pass_poses(motion.times, motion.poses, motion.skeleton, cutoff)
        motion = replace(motion, poses=poses)
    errors = evaluate(motion, clip.truth, clip.pairs)
    fast = float(np.sqrt(np.nanmean(errors.high_passed**2)))
    return 100 * errors.mean, 100 * fast, calm_of(motion, clip).ratio


def low_pass(groups: dict[str, list[Clip]]) -> Iterator[Metric]:
    """Group by group and way by way the mean figures over all clips."""
    cells = [["", "Hz", *(f"{name}, {unit}" for name, unit in FIGURES.items())]]
    for group, clips in groups.items():
        for way, settings in (("--paper", PAPER), ("ours", Settings(smooth=False))):
            mode = "nearest" if way == "--paper" else "own"
            motions = [track(Recording.load(clip.path), settings, mode=mode) for clip in clips]
            pairs = list(zip(motions, clips, strict=True))
            for cutoff in CUTOFFS:
                row = np.mean([filtered(*pair, cutoff) for pair in pairs], 0)
                hertz = f"{cutoff:g}" if cutoff else "-"
                cells.append([f"{group}, {way}", hertz, *(f"{v:.1f}" for v in row)])
                for (name, unit), v in zip(FIGURES.items(), row, strict=True):
                    title = f"low-pass, {group}, {way}, {hertz} Hz, {name}"
                    yield Metric(title, float(v), unit)
    print(align_columns(cells))


def main() -> None:
    """Measure, print."""
    parser = command("bench.paper", __doc__)
    add = parser.add_argument
    add("recordings", nargs="?", help="folder of the real recordings, for the low-pass")
    add("--only", choices=("loop", "times", "low-pass"), default="loop", help="default: loop")
    add("--seeds", type=seeds, default=seeds("0-4"), metavar="0-4", help="of the players")
    add("--seconds", type=float, default=6.0, help="of each clip; default: %(default)s")
    add("--rounds", type=int, default=50, help="of each time; default: %(default)s")
    add("--keep", metavar="DIR", help="keep rendered recordings here")
    options = parser.parse_args()
    keep_compiled()
    with kept(options.keep) as keep:
        if options.only == "loop":
            found = list(loop(options.seeds, options.seconds, keep))
        elif options.only == "times":
            found = list(stated_times(options.rounds))
        else:
            players = synthetic("tennis", options.seeds, AZIMUTHS, options.seconds, keep)
            groups = {"tennis": players}
            if options.recordings:
                groups["balancing"] = real(Path(options.recordings))
            found = list(low_pass(groups))
    write_json(found, options.json)


if __name__ == "__main__":
    main()
