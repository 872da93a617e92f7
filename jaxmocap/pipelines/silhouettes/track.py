"""A recording to a motion by silhouettes: no markers, one to four cameras.

A first pass learns the rooms, frame by frame, where the person is not, and the person's shape; the
second knows them.

INPUTS: a Recording, where the person is at first. OUTPUTS: a Motion, and the level sets.
"""

from collections.abc import Callable, Sequence
from time import perf_counter
from typing import NamedTuple

import jax
import numpy as np

from jaxmocap.body.motion import Motion, Report
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import ELBOWS, LANDMARKS, Skeleton, with_joints
from jaxmocap.body.surfaces.surface import Surface
from jaxmocap.capture.background_pictures import read_empty_room
from jaxmocap.capture.footage import forward_readers
from jaxmocap.capture.markers import interpolate_markers
from jaxmocap.capture.timeline import bundle_frames
from jaxmocap.capture.video import FrameSource, check_video_size, open_video
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.recordings.recording import Recording
from jaxmocap.hybrid.elbow_search import confidence_of
from jaxmocap.images.background_model import Background
from jaxmocap.images.regions import Region
from jaxmocap.outputs.report import plain
from jaxmocap.pipelines.progress import Progress, progress_bar
from jaxmocap.pipelines.silhouettes.reports import Reports
from jaxmocap.pipelines.tracking.track import marker_sites
from jaxmocap.silhouette.device_functions import landmark_slopes
from jaxmocap.silhouette.segmentation.room_models import RoomLearner, RunningRoom, pictured
from jaxmocap.silhouette.settings import Settings
from jaxmocap.silhouette.smoothing import Told, smoothed
from jaxmocap.silhouette.state import Moving, State, StepReport
from jaxmocap.silhouette.surfaces.shape import ShapeFinder
from jaxmocap.silhouette.tracker import SilhouetteTracker

MODEL = "supple.toml"
# A photographed surface's deviations by a generic one's.
PHOTOGRAPHED = 0.5
ELSEWHERE = "expected somebody where the markers' first samples, or --at, put the person"


class Masks(NamedTuple):
    """Level sets of one camera over F frames.

    Attributes:
        times: (F,) seconds.
        phi: (F, S, S) int8, positive within the person.
        origins: (F, 2) of the canvases' regions.
        scales: (F,) of them.
    """

    times: np.ndarray
    phi: np.ndarray
    origins: np.ndarray
    scales: np.ndarray


class Followed(NamedTuple):
    """What silhouettes tell.

    Attributes:
        motion: with a report.
        masks: camera -> what was segmented.
        surface: of the person, as the last pass wore it.
    """

    motion: Motion
    masks: dict[str, Masks]
    surface: Surface


class _Frames(NamedTuple):
    """F instants: times, frames (F, C) of the cameras' videos, -1 for none; markers (F, M, 3)."""

    videos: list[FrameSource]
    times: np.ndarray
    indices: np.ndarray
    positions_world: np.ndarray


def whole_body(skeleton: Skeleton) -> Skeleton:
    """The person, moved by the second paper's joints, and by wrists and neck beyond them."""
    return with_joints(skeleton, MODEL)


def make_tracker(
    recording: Recording,
    settings: Settings | None = None,
    markers: bool = False,
    surface: Surface | None = None,
) -> SilhouetteTracker:
    """The tracker of a recording's person by its cameras, and by its markers where asked for.

    Args:
        recording: with one or several videos.
        settings: of the tracker.
        markers: follow them too.
        surface: of the person, around the recording's skeleton; a generic one without it.

    Raises:
        InputError: it has no video, or not the markers.
    """
    if not recording.videos:
        raise InputError(recording.path or recording.name, "no [[video]]: expected one or several")
    cameras = [source.camera for source in recording.videos]
    skeleton = whole_body(recording.skeleton)
    sites = marker_sites(skeleton, recording.require_markers().places) if markers else None
    rooms = empty_rooms(recording)
    return SilhouetteTracker(skeleton, cameras, settings, surface, rooms, sites)


def empty_rooms(recording: Recording) -> list[Background | None]:
    """What the recording's pictures of empty rooms show, for each video; None without one."""
    return [
        pictured(read_empty_room(source.background, open_video(source).size))
        if source.background
        else None
        for source in recording.videos
    ]


def follow(
    recording: Recording,
    start: Pose,
    settings: Settings | None = None,
    *,
    passes: int = 3,
    markers: bool = False,
    surface: Surface | None = None,
    lengths: bool = False,
    progress: Progress | bool | None = None,
) -> Followed:
    """Track the person in a recording's videos.

    Args:
        recording: with one or several videos.
        start: where the person is in the first frames, a pose of ``whole_body``.
        settings: of the tracker.
        passes: 1 knows of the rooms what its frames so far showed, and nothing of the person's
            shape; 2 learns both first; 3 once more, the shape where the rooms are known. Limbs that
            explain more where the pass before found them are taken from it.
        markers: follow them too; without it they are not looked at.
        surface: of the person's own model, around the recording's skeleton; without it a generic
            one, whose shape the passes correct.
        lengths: whether passes before the last correct the bones' lengths as well.
        progress: called with the frames done and their total; True shows a bar on stderr.

    Returns:
        One pose per instant of the videos, and the level sets.

    Raises:
        InputError: no video, or nobody in any frame.
    """
    tracker = make_tracker(recording, settings, markers, surface)
    frames, warnings = _open(recording, markers)
    empty = tracker.rooms
    # What was photographed needs less correction than what was guessed.
    unknown = 1.0 if surface is None else PHOTOGRAPHED
    shape = ShapeFinder(tracker.finder.surface, tracker.skeleton, unknown, lengths)
    run = _Pass(tracker, frames, shape if passes > 1 else None)
    with progress_bar("tracking", progress) as show:
        for number in range(passes):
            earlier = run.found if number else None
            if number:
                learned = zip(empty, run.learners, strict=True)
                tracker.rooms = [room or learner.learned() for room, learner in learned]
                tracker.become(*shape.fitted())
                run = _Pass(tracker, frames, shape if number + 1 < passes else None)
            run.through(start, _shifted(show, number * run.count, passes * run.count), earlier)
            if not run.seen:
                where = recording.path or recording.name
                raise InputError(where, f"no camera shows the person in any frame, {ELSEWHERE}")
    names = [source.camera_name for source in recording.videos]
    told = {
        "recording": recording.path or recording.name,
        "cameras": names,
        "markers": recording.marker_names if markers else (),
        "warnings": warnings,
        "tracker": tracker.settings,
    }
    report, origin = run.report(names, plain(told)), recording.origin_world
    motion = Motion(tracker.skeleton, frames.times, run.smoothed(), report, origin)
    return Followed(motion, run.masks(names), tracker.finder.surface)


def _open(recording: Recording, markers: bool) -> tuple[_Frames, tuple[str, ...]]:
    """The videos and which of their frames belong together."""
    videos, warnings = [open_video(source) for source in recording.videos], list(recording.warnings)
    for video, source in zip(videos, recording.videos, strict=True):
        warning = check_video_size(video, source.camera, video.name)
        warnings += [warning] if warning else []
    times, indices = bundle_frames([video.times for video in videos])
    places = np.empty((len(times), 0, 3))
    if markers:
        places = interpolate_markers(recording.times, recording.positions_world, times)
    return _Frames(videos, times, indices, places), tuple(warnings)


def _shifted(show: Progress, before: int, total: int) -> Callable[[int], None]:
    """What to call with the frames of a pass done."""
    return lambda done: show(before + done, total)


class _Pass:
    """One pass over all frames; with a shape to tell of, it learns the rooms as well."""

    def __init__(
        self, tracker: SilhouetteTracker, frames: _Frames, shape: ShapeFinder | None = None
    ):
        self.tracker, self.frames, self.count = tracker, frames, len(frames.times)
        count = self.count
        self.shape = shape
        self.learners = [RoomLearner(count) for _ in frames.videos] if shape else []
        # Who knows nothing of a room learns it frame by frame.
        self._running = {c: RunningRoom() for c, room in enumerate(tracker.rooms) if room is None}
        self.milliseconds: dict[str, list[float]] = {}
        self.found: list[Moving] = []
        self._reports = Reports(tracker)
        self._phi: list[np.ndarray] = []

    def through(
        self, start: Pose, show: Callable[[int], None], earlier: Sequence[Moving] | None = None
    ) -> None:
        """All frames, from a pose; the first is looked at until the pose rests.

        Args:
            start: in the first frame.
            show: called with the frames done.
            earlier: what an earlier pass found, frame by frame.
        """
        state = self.tracker.init(start)
        with forward_readers(self.frames.videos, colour=True) as readers:
            for i, (time, row) in enumerate(
                zip(self.frames.times, self.frames.indices, strict=True)
            ):
                images = [reader.at(int(k)) for reader, k in zip(readers, row, strict=True)]
                shown = float(time), images, self.frames.positions_world[i]
                if not i:
                    state = self._settled(state, *shown)
                began = perf_counter()
                before = None if earlier is None else earlier[i]
                state, pose, report = self.tracker.step(state, *shown, before)
                self.milliseconds.setdefault("frame", []).append(1e3 * (perf_counter() - began))
                self.found.append(Moving(jax.tree.map(np.asarray, pose), state.velocity))
                self._reports.add(report, pose, shown[2])
                self._keep(pose, report, images)
                show(i + 1)

    def _settled(
        self,
        state: State,
        time: float,
        images: Sequence[np.ndarray | None],
        positions_world: np.ndarray,
    ) -> State:
        for _ in range(self.tracker.settings.settling):
            state = self.tracker.step(state, time, images, positions_world)[0]._replace(time=None)
        return state

    def _keep(self, pose: Pose, report: StepReport, images: Sequence[np.ndarray | None]) -> None:
        phi, region = np.asarray(report.outlines.segmented.phi), report.outlines.region
        pixels, rooms = self.tracker.covering(pose), list(self.tracker.rooms)
        for camera, image in enumerate(images):
            if image is None or not report.used[camera]:
                continue
            here = Region(*(part[camera] for part in region))
            shown = image, phi[camera], here, pixels[camera]
            if self.learners:
                self.learners[camera].tell(*shown)
            if camera in self._running:
                rooms[camera] = self._running[camera].told(*shown)
        self.tracker.rooms = rooms
        self._phi.append(np.clip(np.round(8 * phi), -127, 127).astype(np.int8))
        # What hides a part draws the outlines of others along.
        if self.shape is not None and not report.hidden.any():
            tracker = self.tracker
            morph = tracker.finder.morph
            self.shape.tell(tracker.skeleton, tracker.cameras, pose, report.pairs, morph)

    @property
    def seen(self) -> bool:
        """Whether any camera counted in any frame."""
        return any(report.used.any() for report in self._reports.kept)

    def poses(self) -> Pose:
        """(T, ...) as they were found."""
        return jax.tree.map(lambda *parts: np.stack(parts), *(each.pose for each in self.found))

    def smoothed(self) -> Pose:
        """(T, ...) as all frames together have them."""
        tracker = self.tracker
        if tracker.settings.smoothing is None:
            return self.poses()
        told = Told(
            self.poses(),
            np.stack([report.information for report in self._reports.kept]),
            np.stack([report.slope for report in self._reports.kept]),
        )
        how = tracker.settings.smoothing
        times, morph, began = self.frames.times, tracker.finder.morph, perf_counter()
        poses = smoothed(tracker.skeleton, times, told, tracker.rest, how, morph)
        self.milliseconds["smooth"] = [1e3 * (perf_counter() - began)]
        return poses

    def masks(self, names: Sequence[str]) -> dict[str, Masks]:
        """Camera -> level sets."""
        origins, scales = (
            np.stack([report.outlines.region[k] for report in self._reports.kept]) for k in (0, 1)
        )
        phi = np.stack(self._phi)
        return {
            name: Masks(self.frames.times, phi[:, c], origins[:, c], scales[:, c])
            for c, name in enumerate(names)
        }

    def report(self, names: Sequence[str], settings: dict) -> Report:
        """How far to trust each frame."""
        count, none = self.count, np.full((self.count, 2), np.nan)
        deviations = np.stack([self._landmarks_std(i) for i in range(count)])
        spread = np.sqrt(np.sum(deviations[:, ELBOWS] ** 2, -1))
        confidence = np.asarray(confidence_of(spread))
        unsaid = np.full((count, len(LANDMARKS)), np.nan)
        statuses = tuple(self._said(report, names) for report in self._reports.kept)
        return Report(
            (), np.zeros((count, 0)), none, none, confidence, deviations, unsaid, statuses,
            {stage: np.array(spent) for stage, spent in self.milliseconds.items()}, settings,
        )  # fmt: skip

    def _landmarks_std(self, frame: int) -> np.ndarray:
        """(L, 3) metres, by the covariance of what the rays tell."""
        report, blind = self._reports.kept[frame], self.tracker.settings.blind
        H = np.asarray(report.information, float)
        covariance = np.linalg.inv((H + H.T) / 2 + np.eye(len(H)) / blind**2)
        J = np.asarray(landmark_slopes(self.tracker.skeleton, self.found[frame].pose), float)
        return np.sqrt(np.einsum("lai,ij,laj->la", J, covariance, J))

    def _said(self, report: StepReport, names: Sequence[str]) -> tuple[str, ...]:
        """What a user should know of a frame."""
        left_out = (f"{name}: left out" for name, used in zip(names, report.used, strict=True)
                    if not used)  # fmt: skip
        joints = self.tracker.skeleton.tree.joints
        unseen = [joint for joint, seen in zip(joints, report.seen[6:], strict=True) if not seen]
        held = [f"held, not seen: {joint}" for joint in unseen]
        return (*left_out, *held)
