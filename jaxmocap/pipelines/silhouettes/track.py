"""A recording to a motion by silhouettes: no markers, one to four cameras.

Opens the videos, runs the passes over their frames, and reports how they went.

INPUTS: a Recording, where the person is at first. OUTPUTS: a Motion, and the level sets.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from time import perf_counter
from typing import NamedTuple

import jax
import numpy as np

from jaxmocap.body.model import marker_sites
from jaxmocap.body.motion import Motion, Report, Run, landmarks_over_time
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import ELBOWS, LANDMARKS, with_joints
from jaxmocap.body.surfaces.surface import Surface
from jaxmocap.body.tree import ROOT_DOF
from jaxmocap.capture.footage import forward_readers, open_footage
from jaxmocap.capture.markers import interpolate_markers
from jaxmocap.capture.photographs import read_empty_room
from jaxmocap.capture.timeline import bundle_frames
from jaxmocap.capture.video import FrameSource, check_size, open_video
from jaxmocap.evidence.terms import Measurements
from jaxmocap.formats.recordings.recording import Recording
from jaxmocap.images.background_model import Background
from jaxmocap.outputs.report import plain
from jaxmocap.pipelines.progress import Progress, progress_bar
from jaxmocap.pipelines.silhouettes.keypoints import (
    LOST,
    KeypointGuide,
    has_keypoints,
    keypoint_distances,
    keypoint_guide,
    lost_status,
)
from jaxmocap.pipelines.tracking.events import elbow_warnings
from jaxmocap.silhouette.keypoint_poses import LEAST_LINES
from jaxmocap.silhouette.passes import FrameBundle, PassResult, run_passes
from jaxmocap.silhouette.segmentation.background_models import background_of_picture
from jaxmocap.silhouette.settings import Settings
from jaxmocap.silhouette.state import StepReport
from jaxmocap.silhouette.surfaces.body_shape import determined_landmarks, moved_bones
from jaxmocap.silhouette.tracker import SilhouetteTracker

# A photographed surface's deviations by a generic one's: what was photographed needs less
# correction than what was guessed.
PHOTOGRAPHED_SHARE = 0.5

# The people on whose recordings the factors of the deviations were chosen.
CALIBRATED_ON = (
    "four rendered people (woman, broad man, slim woman, tall man) and a real person before four "
    "cameras; shown on two other rendered people"
)


class Masks(NamedTuple):
    """Level sets of one camera over F frames."""

    times: np.ndarray  # (F,) seconds
    phi: np.ndarray  # (F, S, S) int8, positive within the person
    origins: np.ndarray  # (F, 2) of the canvases' regions
    scales: np.ndarray  # (F,) of them


class SilhouetteResult(NamedTuple):
    """A recording, tracked by silhouettes, and the person's surface as the last pass had it."""

    motion: Motion
    masks: dict[str, Masks]
    surface: Surface


class _Footage(NamedTuple):
    """F instants: times, frames (F, C) of the cameras' videos, -1 for none; markers (F, M, 3).

    Those where they are followed, and where key points have the person.
    """

    videos: list[FrameSource]
    times: np.ndarray
    indices: np.ndarray
    positions_world: np.ndarray | None
    guide: KeypointGuide | None

    def bundles(self) -> Iterator[FrameBundle]:
        """All instants in order, decoded as they are asked for."""
        with forward_readers(self.videos, colour=True) as readers:
            for instant, (time, row) in enumerate(zip(self.times, self.indices, strict=True)):
                images = [reader.at(int(k)) for reader, k in zip(readers, row, strict=True)]
                yield FrameBundle(float(time), images, *self._beside(instant))

    def _beside(self, instant: int) -> tuple[Measurements, Pose | None]:
        """What was measured at an instant besides its images, and where that has the person."""
        measured = Measurements()
        if self.positions_world is not None:
            markers = self.positions_world[instant].astype(np.float32)
            measured = measured._replace(markers=markers)
        if self.guide is None:
            return measured, None
        lines = jax.tree.map(lambda part: part[instant], self.guide.lines)
        measured = measured._replace(sight_lines=lines)
        return measured, self.guide.pose_at(instant) if self.guide.is_detected[instant] else None


def make_silhouette_tracker(
    recording: Recording,
    settings: Settings | None = None,
    markers: bool = False,
    surface: Surface | None = None,
) -> SilhouetteTracker:
    """The tracker of a recording's person by its cameras, and by its markers where asked for.

    A surface is that of the person, around the recording's skeleton; a generic one without it.

    Raises:
        InputError: it has no video, or not the markers.
    """
    if not recording.videos:
        raise recording.error("no [[video]]: expected one or several")
    cameras = [source.camera for source in recording.videos]
    settings = settings or Settings()
    skeleton = with_joints(recording.skeleton, settings.body)
    sites = marker_sites(skeleton, recording.require_markers().places) if markers else None
    return SilhouetteTracker(skeleton, cameras, settings, surface, sites)


def track_silhouettes(
    recording: Recording,
    start: Pose | None = None,
    settings: Settings | None = None,
    *,
    passes: int | None = None,
    markers: bool = False,
    surface: Surface | None = None,
    lengths: bool = False,
    progress: Progress | bool | None = None,
    warnings_before: Sequence[str] = (),
) -> SilhouetteResult:
    """Track the person in a recording's videos.

    Args:
        recording: with one or several videos.
        start: where the person is in the first frames, a pose of the settings' body; where the key
            points say it without it.
        settings: of the tracker.
        passes: in 1 the backgrounds are what its frames so far showed, and the shape is generic;
            2 learn both first; 3 once more, the shape with the learned backgrounds. Limbs that
            explain more where the pass before found them are taken from it. None is 3; or 1 by
            one camera with key points, where more find no better poses, unless they are to correct
            lengths.
        markers: follow them too; without it they are ignored.
        surface: of the person's own model, around the recording's skeleton; without it a generic
            one, whose shape the passes correct.
        lengths: whether passes before the last correct the bones' lengths as well.
        progress: called with the frames done and their total; True shows a bar
            on stderr; None does so on a terminal.
        warnings_before: warnings of what was found beforehand.

    Returns:
        One pose per instant of the videos, and the level sets.

    Raises:
        InputError: no video, nobody in any frame, or nothing that says where the person begins.
    """
    settings = settings or Settings()
    recording, footage, warnings = _open(recording, settings, markers, start, surface)
    guide = footage.guide
    if passes is None:
        by_points = guide is not None and len(recording.videos) == 1
        passes = 1 if by_points and not lengths else 3
    tracker = make_silhouette_tracker(recording, settings, markers, surface)
    if start is None:
        if guide is None:
            expected = "expected --at X,Y,FACING of a person who stands upright, or key points"
            raise recording.error(f"nobody is detected in any frame, {expected}")
        start = guide.pose_at(int(np.argmax(guide.is_detected)))
    share = 1.0 if surface is None else PHOTOGRAPHED_SHARE
    # By the recording's pictures of empty rooms.
    backgrounds: list[Background | None] = [
        background_of_picture(read_empty_room(source.background, video.size))
        if source.background
        else None
        for source, video in zip(recording.videos, footage.videos, strict=True)
    ]
    began, label = perf_counter(), f"tracking, {passes} pass{'es' * (passes > 1)}"
    with progress_bar(label, progress, "compiling") as show:
        result = run_passes(
            tracker, start, footage.bundles, len(footage.times), backgrounds, passes, share,
            lengths, show,
        )  # fmt: skip
    if not result.is_anybody_visible:
        expected = "expected somebody where the markers' first samples, or --at, put the person"
        raise recording.error(f"no camera shows the person in any frame, {expected}")
    # Landmarks that the body does not move.
    still = ~determined_landmarks(tracker.body.model.skeleton.tree)
    listed = ", ".join(LANDMARKS[i] for i in np.flatnonzero(still))
    at_rest = [f"not tracked by this body, kept as at rest: {listed}"] if listed else []
    constants, names = tracker.constants, tuple(each.camera_name for each in recording.videos)
    tracked = perf_counter()
    shape, (poses, deviations) = result.body.shape, result.smooth(constants)
    run = Run(
        recording=str(recording.path or recording.name),
        cameras=names,
        markers=recording.marker_names if markers else (),
        warnings=(*warnings_before, *warnings, *at_rest),
        tracker=plain(constants.settings),
        deviations={"calibrated_on": CALIBRATED_ON},
        video_frames=len(footage.times),
        seconds={"passes": tracked - began, "smoothing": perf_counter() - tracked},
    )
    off = None
    if guide is not None:
        off = keypoint_distances(landmarks_over_time(shape.skeleton, poses), guide.lines)
    report = _report(result, deviations, run, off)
    motion = Motion(shape.skeleton, footage.times, poses, report, recording.origin_world)
    regions = [report.outlines.region for report in result.reports]
    origins, scales = (np.stack([region[k] for region in regions]) for k in (0, 1))
    phi, times = np.stack(result.level_sets), np.array(result.times)
    masks = {
        name: Masks(times, phi[:, c], origins[:, c], scales[:, c]) for c, name in enumerate(names)
    }
    return SilhouetteResult(motion, masks, shape.surface)


def _open(
    recording: Recording,
    settings: Settings,
    markers: bool,
    start: Pose | None,
    surface: Surface | None,
) -> tuple[Recording, _Footage, tuple[str, ...]]:
    """The recording, its bones as key points have them; its videos, which frames belong together.

    Followed markers on bones that the body's joints do not move are none. A person's own surface
    keeps its bones.
    """
    if not recording.videos:
        raise recording.error("no [[video]]: expected one or several")
    if markers:
        videos, about = open_footage(recording.require_markers())
        warnings = list(about)
    else:
        videos = [open_video(source) for source in recording.videos]
        sizes = (
            check_size(video.size, source.camera.size, video.name)
            for video, source in zip(videos, recording.videos, strict=True)
        )
        warnings = [*recording.warnings, *filter(None, sizes)]
    times, indices = bundle_frames([video.times for video in videos])
    guide = keypoint_guide(recording, videos, times, indices, start, settings)
    if guide is not None:
        warnings += guide.warnings
        recording = recording if surface else replace(recording, skeleton=guide.skeleton)
    elif has_keypoints(recording) and start is not None:
        problem = f"key points of fewer than {LEAST_LINES} landmarks in every frame"
        if len(videos) == 1 and not markers:
            raise recording.error(f"{problem}: one camera without more of them loses the person")
        warnings.append(f"{problem} are not used")
    positions = None
    if markers:
        sites = marker_sites(recording.skeleton, recording.places)
        positions = interpolate_markers(recording.times, recording.positions_world, times)
        tree = with_joints(recording.skeleton, settings.body).tree
        positions = np.where(moved_bones(tree)[sites.bones][:, None], positions, np.nan)
    return recording, _Footage(videos, times, indices, positions, guide), tuple(warnings)


def _report(
    result: PassResult,
    deviations: np.ndarray,
    run: Run,
    distances: np.ndarray | None,
) -> Report:
    """How well each frame's pose is determined, and its warnings."""
    count = len(result.times)
    none = np.full((count, 2), np.nan)
    joints = result.body.shape.skeleton.tree.joints
    off = np.full(count, np.nan) if distances is None else distances
    needs_points = distances is not None and len(run.cameras) == 1 and not run.markers
    statuses = tuple(
        (*lost_status(report.used, distance, needs_points), *_warnings(report, run.cameras, joints))
        for report, distance in zip(result.reports, off, strict=True)
    )
    # Nobody knows how far off a person is who is lost.
    lost = [any(status.startswith(LOST) for status in each) for each in statuses]
    deviations = np.where(np.array(lost)[:, None, None], np.nan, deviations)
    unsure = map(elbow_warnings, np.linalg.norm(deviations[:, ELBOWS], axis=-1))
    statuses = tuple((*own, *more) for own, more in zip(statuses, unsure, strict=True))
    milliseconds = {"frame": np.array(result.milliseconds)}
    return Report(
        (), np.zeros((count, 0)), none, none, deviations, np.full(deviations.shape[:2], np.nan),
        statuses, milliseconds, run,
    )  # fmt: skip


def _warnings(report: StepReport, names: Sequence[str], joints: Sequence[str]) -> tuple[str, ...]:
    """What a user must know of a frame."""
    left_out = [name for name, used in zip(names, report.used, strict=True) if not used]
    unseen = ~report.observed[ROOT_DOF:]
    held = [joint for joint, hidden in zip(joints, unseen, strict=True) if hidden]
    return (
        *(f"{name}: left out" for name in left_out),
        *(f"held, not visible: {joint}" for joint in held),
    )
