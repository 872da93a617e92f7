"""How long a frame takes, stage by stage, and how the inverse kinematics compares with NumPy's.

INPUTS: a synthetic table-tennis clip, 640 x 480 at 30 Hz, markers at 90 Hz, made on the spot.
OUTPUTS: Metrics and a table. Decoding is left out: the frames are in memory, grey.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter

import jax
import jax.numpy as jnp
import numpy as np

from bench.metrics import Metric, aligned, stage_metrics
from jaxmocap.body.motion import Report
from jaxmocap.body.pose import Pose
from jaxmocap.capture.markers import interpolate
from jaxmocap.capture.timeline import build_timeline
from jaxmocap.capture.video import open_video
from jaxmocap.formats.recording import Recording
from jaxmocap.hybrid import ik
from jaxmocap.hybrid.tracker import HybridTracker
from jaxmocap.reference import ik as reference
from jaxmocap.run.recording import make_tracker, settled, track
from jaxmocap.synthetic.recording import write_table_tennis

# Stage of the report -> what the table calls it.
STAGES = {
    "solve": "solve (markers to pose)",
    "observe": "observe (edges, distance fields)",
    "refine": "refine (search, simplex)",
    "frame": "whole step with a frame",
    "carry": "refine without a frame",
    "sample": "whole step without a frame",
}


@dataclass(frozen=True)
class Rivals:
    """The same solves by us and by the reference, milliseconds each, and how far they differ."""

    ours: list[float]
    reference: list[float]
    farthest_rad: float

    @property
    def ratio(self) -> float:
        """How many times as long the reference takes."""
        return float(np.median(self.reference) / np.median(self.ours))


def clip(folder: Path, seconds: float) -> Recording:
    """The recording, its frames decoded beforehand."""
    recording = Recording.load(write_table_tennis(folder, seconds))
    (source,) = recording.videos
    video = open_video(source)
    images = [image for _, image in video.frames(luma=True)]
    # The times in memory are marker time already.
    still = replace(source, path=None, offset=0.0, frames=(video.times, images))
    return replace(recording, videos=(still,))


def measure(folder: Path, seconds: float, solves: int) -> tuple[list[Metric], str]:
    """All figures of this part, and their table.

    Args:
        folder: to put the clip in.
        seconds: of the clip.
        solves: by the reference, which takes its time.
    """
    recording = clip(folder, seconds)
    began = perf_counter()
    tracker = make_tracker(recording)
    build = perf_counter() - began
    report = track(recording, tracker=tracker).report
    assert report is not None
    first = build + report.milliseconds["first_call"][0] / 1e3
    # The stages above wait for each other to be timed; a user waits once, for the pose.
    report = replace(report, milliseconds=report.milliseconds | step_times(tracker, recording))
    rivals = race(tracker, recording, solves)
    return metrics(report, first, rivals), table(report, first, rivals)


def step_times(tracker: HybridTracker, recording: Recording) -> dict[str, np.ndarray]:
    """Milliseconds of ``tracker.step`` as a user calls it, with a frame and without one."""
    video = open_video(recording.videos[0])
    images = [image for _, image in video.frames(luma=True)]
    line = build_timeline(recording.times, [video.times])
    markers = interpolate(recording.times, recording.positions_world, line.event_times)
    state = settled(tracker, recording.positions_world[0])
    spent: dict[str, list[float]] = {"frame": [], "sample": []}
    for i, time in enumerate(line.event_times):
        frame = line.frame_index[i, 0]
        seen = None if frame < 0 else [images[frame]]
        took, (state, _, _) = _timed(tracker.step, state, time, markers[i], seen)
        spent["sample" if seen is None else "frame"].append(took)
    return {stage: np.array(times) for stage, times in spent.items()}


def race(tracker: HybridTracker, recording: Recording, solves: int) -> Rivals:
    """Algorithm 1 from the same start to the same goals, jitted in float32 and in NumPy."""

    @jax.jit
    def solve(skeleton, goals, settings, pose):
        # Which bones carry the goals is static.
        sites = goals.sites._replace(bones=tracker.held.sites.bones)
        return ik.reach(skeleton, goals._replace(sites=sites), settings, pose)

    state = settled(tracker, recording.positions_world[0])
    ours, theirs, farthest = [], [], 0.0
    for markers in recording.positions_world[1 : solves + 2]:
        targets = jnp.asarray(markers, tracker.dtype)
        mask = jnp.all(jnp.isfinite(targets), -1)
        goals = ik.goals_of(
            tracker.skeleton, tracker.held, tracker.settings.ik, state.stance, targets, mask
        )
        problem = (tracker.skeleton, goals, tracker.settings.ik, state.pose)
        time, (pose, _) = _timed(solve, *problem)
        ours.append(time)
        # As NumPy arrays: fetching each of its numbers from JAX would take most of its time.
        time, (expected, _) = _timed(reference.reach, *jax.tree.map(np.asarray, problem))
        theirs.append(time)
        farthest = max(farthest, _apart(pose, expected))
        state = state._replace(pose=pose)
    # The first of ours compiles.
    return Rivals(ours[1:], theirs[1:], farthest)


def _timed(function: Callable, *arguments) -> tuple[float, tuple]:
    began = perf_counter()
    result = jax.block_until_ready(function(*arguments))
    return 1e3 * (perf_counter() - began), result


def _apart(pose: Pose, expected: reference.Pose) -> float:
    return float(np.abs(np.asarray(pose.angles, float) - expected.angles).max())


def metrics(report: Report, first: float, rivals: Rivals) -> list[Metric]:
    """The figures that a baseline holds."""
    found = [
        metric
        for stage, name in STAGES.items()
        for metric in stage_metrics(name, report.milliseconds[stage])
    ]
    rate = 1e3 / float(np.median(report.milliseconds["frame"]))
    return [
        *found,
        Metric("frame rate", rate, "1/s", "higher"),
        Metric("first call, compilation included", first, "s", tolerance=0.5),
        *stage_metrics("inverse kinematics", rivals.ours),
        *stage_metrics("inverse kinematics, NumPy reference", rivals.reference),
        Metric("inverse kinematics, reference / ours", rivals.ratio, "x", "higher"),
    ]


def table(report: Report, first: float, rivals: Rivals) -> str:
    """The same to read."""
    times = {name: report.milliseconds[stage] for stage, name in STAGES.items()}
    times["inverse kinematics alone"] = np.array(rivals.ours)
    times["the same, NumPy reference"] = np.array(rivals.reference)
    rows = [["stage", "median ms", "99 % ms", "calls"]]
    for name, spent in times.items():
        median, p99 = np.percentile(spent, [50, 99])
        rows.append([name, f"{median:.2f}", f"{p99:.2f}", str(len(spent))])
    rate = 1e3 / np.median(report.milliseconds["frame"])
    return (
        f"{aligned(rows)}\n\n"
        f"{rate:.0f} frames per second; first call {first:.1f} s, compilation included\n"
        f"inverse kinematics: {rivals.ratio:.0f} times as fast as the reference, "
        f"joint angles within {rivals.farthest_rad:.1e} rad of it"
    )
