"""``python -m bench.evidence [RECORDINGS]``: kinds of evidence, one against another.

First frame by frame, by the outlines alone, also with the learned background made flat, so that
only what differs from it has edges; then over the whole recording, what the second pass makes of
silhouettes against a learned background, of the forearms' colours and of 2-D key points. Synthetic
recordings get key points made from the truth, with noise and some false ones. A real recording's
are read from ``keypoints/CAMERA`` beside it, where there are any; if its reference was triangulated
from them, as that of "balancing" was, that row praises itself.

INPUTS: the folder of real recordings; without one the synthetic recordings alone.
OUTPUTS: a table of the elbows' distances from the truth, and Metrics as JSON.
"""

import argparse
import json
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import cv2
import jax
import jax.numpy as jnp
import numpy as np

from bench import command, kept, seeds
from bench.clips import AZIMUTHS, Clip, real, synthetic
from bench.figures import Metric, write_json
from jaxmocap.body.model import Model, marker_sites
from jaxmocap.body.motion import Motion, Run
from jaxmocap.capture.footage import forward_readers, open_footage
from jaxmocap.capture.keypoints import open_keypoints
from jaxmocap.capture.markers import interpolate_markers
from jaxmocap.capture.video import FrameSource
from jaxmocap.compilation.clock import Clock
from jaxmocap.evaluation.errors import evaluate
from jaxmocap.evaluation.tables import align_columns
from jaxmocap.evidence.appearance.learned import ROWS, Drawing, learn_appearance
from jaxmocap.evidence.edges import EdgeEvidence
from jaxmocap.formats.recordings.keypoint_models import LANDMARK_OF, MODELS
from jaxmocap.formats.recordings.recording import Recording
from jaxmocap.formats.time_series.markers import read_markers
from jaxmocap.geometry.cameras import Camera, project
from jaxmocap.hybrid.paper.chamfer import Chamfer
from jaxmocap.hybrid.settings import Settings
from jaxmocap.hybrid.tracker import HybridTracker
from jaxmocap.images.background_model import Background, exposure, spread, undo_gains
from jaxmocap.images.foreground import shrink
from jaxmocap.pipelines.kept_programs import keep_compiled
from jaxmocap.pipelines.keypoints.lines import lines_at_events
from jaxmocap.pipelines.progress import Progress, progress_bar
from jaxmocap.pipelines.tracking.events import RecordingEvents
from jaxmocap.pipelines.tracking.first_pass import scan_events
from jaxmocap.pipelines.tracking.motions import motions, steps_as_trajectory
from jaxmocap.pipelines.tracking.track import track
from jaxmocap.smoothing.batch import CameraFrames, smooth_recording
from jaxmocap.smoothing.problem import FirstPass, Trajectory

# Differences, in deviations of the sensor's noise, from which a pixel begins to differ, and does.
ALIKE, DIFFERENT = 2.0, 5.0
# Pixels of the shrunk images by which the background is blurred, and the difference.
FLAT_PX, SOFT_PX = 12.0, 1.5
SECONDS = 6.0
# Of key points made from the truth: pixels; how many are false, how far off; their confidences.
MODEL, NOISE_PX, FALSE, ASTRAY_PX = "BODY_25B", 3.0, 0.05, 150.0
SURE, UNSURE = (0.6, 1.0), (0.2, 0.8)


def flattened(
    recording: Recording, videos: Sequence[FrameSource], first_pass: FirstPass
) -> Recording:
    """The recording with videos whose backgrounds are flat; one that tells none is left as it is.

    Args:
        recording: to be tracked again.
        videos: its own.
        first_pass: whose poses tell where the person covers the background.
    """
    sources = []
    for camera, (source, video) in enumerate(zip(recording.videos, videos, strict=True)):
        background = learned(recording, source.camera, camera, video, first_pass)
        if background is not None:
            frames = video.times, list(_flat_frames(video, background))
            source = replace(source, path=None, frames=frames, offset=0.0)
        sources.append(source)
    return replace(recording, videos=tuple(sources))


def learned(
    recording: Recording, lens: Camera, camera: int, video: FrameSource, first_pass: FirstPass
) -> Background | None:
    """What a camera sees without the person, in its shrunk frames; as the second pass learns it."""
    column = first_pass.frame_index[:, camera]
    events = np.flatnonzero(column >= 0)
    if not len(events):
        return None
    own, chosen = CameraFrames(camera, events, column[events], video), spread(len(events))
    poses = jax.tree.map(lambda part: np.asarray(part)[events], first_pass.poses)
    drawing = Drawing.of(recording.skeleton, lens, video.size, poses)
    sites = marker_sites(recording.skeleton, recording.places)
    feet_astray = Model.create(recording.skeleton, sites).no_foot_is_marked
    appearance = learn_appearance(drawing, chosen, own.images(chosen), feet_astray)
    return None if appearance is None else appearance.background


def _flat_frames(video: FrameSource, background: Background) -> Iterator[np.ndarray | None]:
    """Grey (H, W) uint8."""
    for _, image in video.frames():
        yield None if image is None else flat_frame(image, background)


def flat_frame(image: np.ndarray, background: Background) -> np.ndarray:
    """One frame (H, W, 3) uint8, grey, before its background (h, w) made flat."""
    small = shrink(image, ROWS)
    # The body may be anywhere.
    gains, agreement = exposure(small, background, np.zeros(small.shape[:2], bool))
    away = (
        np.abs(undo_gains(small, gains).astype(np.float32) - background.colour).max(-1)
        / background.noise
    )
    differs = np.clip((away - ALIKE) / (DIFFERENT - ALIKE), 0, 1)
    # Where the background was not learned, or this is not that room, nothing is alike.
    share = 1 - agreement * background.certainty * (1 - differs)
    size, grey = image.shape[1::-1], cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    share = cv2.resize(cv2.GaussianBlur(share, (0, 0), SOFT_PX), size)
    flat = cv2.cvtColor(cv2.GaussianBlur(background.colour, (0, 0), FLAT_PX), cv2.COLOR_BGR2GRAY)
    mixed = share * grey + (1 - share) * cv2.resize(flat, size)
    return np.rint(mixed).astype(np.uint8)


class Kind(NamedTuple):
    """Evidence that the second pass takes.

    Attributes:
        person: the silhouettes' weight.
        forearms: that of the forearms' colours.
        points: whether key points take part.
    """

    person: float
    forearms: float
    points: bool


USUAL = "edges by direction"
BEFORE = "edges by direction, before a learned background"
PAPER = "the paper's way"
FRAME_BY_FRAME = {
    PAPER: Settings.paper(),
    "areas on plain edges": Settings(smooth=False, directions=1, edges=Chamfer(drawn=False)),
    "plain edges": replace(Settings(), smooth=False, directions=1),
    "edges by direction, not truncated": replace(
        Settings(), smooth=False, edges=replace(EdgeEvidence(), truncation=1.0)
    ),
}
OVER_TIME = {
    "silhouettes": Kind(1, 0, False),
    "silhouettes, colours": Kind(1, 1, False),
    "silhouettes, colours, key points": Kind(1, 1, True),
    "key points alone": Kind(0, 0, True),
}
# What --quick leaves.
QUICK, QUICK_SECONDS = ("silhouettes, colours, key points",), 0.5


@dataclass(frozen=True)
class FirstRun:
    """A recording, tracked frame by frame in the usual way."""

    recording: Recording
    tracker: HybridTracker
    videos: list[FrameSource]
    events: RecordingEvents
    first_pass: FirstPass

    @classmethod
    def through(cls, recording: Recording) -> "FirstRun":
        """Track it."""
        videos, _ = open_footage(recording)
        tracker = HybridTracker.from_recording(recording)
        events = RecordingEvents.of(recording, videos, "own")
        with forward_readers(videos) as readers:
            first = scan_events(events, tracker, readers, lambda done, total: None, Clock())
        return cls(recording, tracker, videos, events, first)

    def smoothed(self, kind: Kind) -> Motion:
        """What the second pass makes of some kind of evidence."""
        first, model = self.first_pass, self.tracker.model
        if kind.points:
            points = tuple(map(open_keypoints, self.recording.videos, self.videos))
            line = self.events.timeline
            lines = lines_at_events(self.recording, points, line, first.reports.marker_pose)
            first = first._replace(sight_lines=lines)
        usual = self.tracker.settings.smoothing
        silhouettes = replace(usual.silhouettes, person=kind.person, forearms=kind.forearms)
        chosen = replace(usual, silhouettes=silhouettes)
        second_pass = smooth_recording(model, chosen, first, self.videos, lambda _: None)
        return self.tracked(second_pass)[0]

    def tracked(self, smoothed: Trajectory | None = None) -> tuple[Motion, Motion]:
        """By what a second pass estimated, or by the first pass alone; and without the video."""
        trajectory = smoothed or steps_as_trajectory(self.first_pass)
        return motions(self.tracker.model, self.events, self.first_pass, trajectory, {}, Run())


def measure(clip: Clip, quick: bool, folder: Path) -> Iterator[tuple[str, np.ndarray]]:
    """Kinds of evidence, and the elbows' distances (N, 2) from the truth, metres.

    Args:
        clip: the recording.
        quick: few kinds.
        folder: for key points that are made.
    """

    def errors(motion: Motion) -> np.ndarray:
        return evaluate(motion, clip.truth, clip.pairs).distances

    recording = with_keypoints(clip, folder)
    own = FirstRun.through(recording)
    motion, markers_only = own.tracked()
    yield "markers alone", errors(markers_only)
    for name, settings in {} if quick else FRAME_BY_FRAME.items():
        yield name, errors(track(recording, settings, mode="nearest" if name == PAPER else "own"))
    yield USUAL, errors(motion)
    if not quick:
        before = flattened(recording, own.videos, own.first_pass)
        yield BEFORE, errors(track(before, replace(Settings(), smooth=False)))
    has_points = any(source.keypoints is not None for source in recording.videos)
    for name, kind in OVER_TIME.items():
        if (quick and name not in QUICK) or (kind.points and not has_points):
            continue
        yield name, errors(own.smoothed(kind))


def with_keypoints(clip: Clip, folder: Path) -> Recording:
    """The recording with key points: its own, those that lie beside it, or made ones."""
    recording = Recording.load(clip.path)
    sources = []
    for source in recording.videos:
        beside = clip.path.parent / "keypoints" / source.camera_name
        if source.keypoints is None and clip.group != "balancing":
            made = folder / clip.name / source.camera_name
            (video,), _ = open_footage(replace(recording, videos=(source,)))
            write_keypoints(made, clip, source.camera, video.times)
            beside = made
        if source.keypoints is None and beside.is_dir():
            source = replace(source, keypoints=beside, keypoints_model=MODEL)
        sources.append(source)
    return replace(recording, videos=tuple(sources))


def write_keypoints(folder: Path, clip: Clip, camera: Camera, times: np.ndarray) -> None:
    """OpenPose's files, one per frame, of somebody detected where the truth has him."""
    truth, rng = read_markers(clip.truth), np.random.default_rng([clip.seed, 25])
    at_frames = interpolate_markers(truth.times, truth.positions, times)
    table = np.zeros((len(times), len(MODELS[MODEL]), 3))
    for column, point in enumerate(MODELS[MODEL]):
        marker = clip.landmarks.get(LANDMARK_OF.get(point, ""))
        if marker in truth.names:
            points = jnp.asarray(at_frames[:, truth.names.index(marker)], float)
            table[:, column, :2] = project(camera, points)
            table[:, column, 2] = rng.uniform(*SURE, len(times))
    there = table[..., 2] > 0
    table[there, :2] += rng.normal(0, NOISE_PX, (there.sum(), 2))
    false = there & (rng.random(there.shape) < FALSE)
    table[false, :2] += rng.uniform(-ASTRAY_PX, ASTRAY_PX, (false.sum(), 2))
    table[false, 2] = rng.uniform(*UNSURE, false.sum())
    # A false point may be beyond the world of the truth.
    table[~np.isfinite(table).all(-1)] = 0.0
    folder.mkdir(parents=True, exist_ok=True)
    for frame, points in enumerate(table):
        person = {"pose_keypoints_2d": points.ravel().round(3).tolist()}
        name = f"{clip.name}_{frame:012d}_keypoints.json"
        (folder / name).write_text(json.dumps({"people": [person]}))


def centimetres(distances: np.ndarray) -> list[float]:
    """Mean, median and 95th percentile over both elbows, centimetres."""
    finite = 100 * distances[np.isfinite(distances)]
    return [float(v) for v in (finite.mean(), np.median(finite), np.percentile(finite, 95))]


def table(distances: dict[str, dict[str, np.ndarray]]) -> str:
    """One group's table: kinds down; means over the recordings, then each one's mean, across.

    Args:
        distances: recording -> kind -> (N, 2) metres.
    """
    rows = [["", "mean", "median", "95 %", *distances]]
    for kind in next(iter(distances.values())):
        each = [centimetres(kinds[kind]) for kinds in distances.values() if kind in kinds]
        cells = [*np.mean(each, 0), *(values[0] for values in each)]
        rows.append([kind, *(f"{value:.1f}" for value in cells)])
    return align_columns(rows)


def chosen_clips(options: argparse.Namespace, keep: Path) -> list[Clip]:
    """The recordings asked for, rendered where they are not there yet."""
    if options.quick:
        return synthetic("tennis", options.seeds[:1], AZIMUTHS, QUICK_SECONDS, keep)
    own = real(Path(options.recordings)) if options.recordings else []
    return [*own, *synthetic("tennis", options.seeds, AZIMUTHS, SECONDS, keep)]


def measure_all(
    clips: list[Clip], quick: bool, show: Progress
) -> dict[str, dict[str, dict[str, np.ndarray]]]:
    """Group -> recording -> kind -> (N, 2) distances, metres."""
    kinds = 2 + (len(QUICK) if quick else 1 + len(FRAME_BY_FRAME) + len(OVER_TIME))
    result: dict[str, dict[str, dict[str, np.ndarray]]] = {}
    with tempfile.TemporaryDirectory() as folder:
        for i, clip in enumerate(clips):
            own = result.setdefault(clip.group, {}).setdefault(clip.name, {})
            for name, distances in measure(clip, quick, Path(folder)):
                own[name] = distances
                show(i * kinds + len(own), len(clips) * kinds)
            show((i + 1) * kinds, len(clips) * kinds)
    return result


def main() -> None:
    """Track, compare, print."""
    parser = command("bench.evidence", __doc__)
    add = parser.add_argument
    add("recordings", nargs="?", help="folder of the real recordings")
    add("--seeds", type=seeds, default=seeds("0-2"), metavar="0-2", help="of table tennis")
    add("--keep", metavar="DIR", help="keep synthetic recordings here, rendered once")
    add("--quick", action="store_true", help="half a second of one seed, few kinds of evidence")
    options = parser.parse_args()
    keep_compiled()
    with kept(options.keep) as keep, progress_bar("measuring", True) as show:
        clips = chosen_clips(options, keep)
        measured = measure_all(clips, options.quick, show)
    print("elbows: distance from the truth, cm; of each recording the mean")
    for group, of_group in measured.items():
        print(f"\n{group}\n{table(of_group)}")
    write_json(
        (
            Metric(f"{name}, {kind}", centimetres(distances)[0], "cm", tolerance=0.05)
            for of_group in measured.values()
            for name, kinds in of_group.items()
            for kind, distances in kinds.items()
        ),
        options.json,
    )


if __name__ == "__main__":
    main()
