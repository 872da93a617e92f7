"""Everything that ``track`` writes, each file moved into place when it is complete.

INPUTS: a Motion, its Recording, a folder.
OUTPUTS: joints.trc, angles.mot, angles_isb.mot, motion.npz, motion.bvh, motion.glb, report.json,
recording.rrd, overlay_NAME.mp4 of each camera, angles_opensim.mot where it is asked for.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from jaxmocap.body.arms import limb_bones
from jaxmocap.body.motion import Motion
from jaxmocap.body.surfaces.surface import Surface
from jaxmocap.capture.footage import open_footage
from jaxmocap.capture.video import FrameSource, TimedImage
from jaxmocap.formats.animation.export import write_animation
from jaxmocap.formats.files.output_folder import OutputFolder
from jaxmocap.formats.motion_npz import save_motion
from jaxmocap.formats.opensim.coordinates import OPENSIM, write_opensim
from jaxmocap.formats.recordings.recording import Recording, VideoSource
from jaxmocap.formats.recordings.recording_files import input_files
from jaxmocap.formats.time_series.axes import R_WORLD_OF_UP, Z_UP, to_world
from jaxmocap.formats.time_series.mot import write_isb, write_mot
from jaxmocap.formats.time_series.trc import write_trc
from jaxmocap.geometry.cameras import Camera, turned
from jaxmocap.hybrid.settings import Settings
from jaxmocap.images.edges import Thresholds, edge_image, gradients
from jaxmocap.images.regions import Region, crop, region_around
from jaxmocap.outputs.overlay import write_overlay
from jaxmocap.outputs.report import write_report
from jaxmocap.outputs.scene import make_scene, pixels
from jaxmocap.outputs.viewer import Footage, write_rerun
from jaxmocap.pipelines.progress import Progress, progress_bar

# Frames of a camera in the viewer's recording, at most.
MOST_VIEWER_FRAMES = 300
# Runs that write a motion into a folder replace each other's files.
MOTION = "motion"
# The files of a motion, in the order in which they are written.
MOTION_FILES = (
    "joints.trc",
    "angles.mot",
    "angles_isb.mot",
    "motion.npz",
    "motion.bvh",
    "motion.glb",
)


OPENSIM_FILE = "angles_opensim.mot"


@dataclass(frozen=True)
class MotionFormats:
    """How a motion's files are written.

    Attributes:
        up: vertical axis of joints.trc, "z" or "y".
        names: "opensim" writes the coordinates of OpenSim's model as well; None does not.
    """

    up: str = Z_UP
    names: str | None = None

    @property
    def more_files(self) -> tuple[str, ...]:
        """Names of files besides ``MOTION_FILES``."""
        return (OPENSIM_FILE,) if self.names == OPENSIM else ()


USUAL_FORMATS = MotionFormats()
# Called with a warning.
Warn = Callable[[str], None]


def ignore_warning(sentence: str) -> None:
    """A ``Warn`` that does nothing."""


def tracked_folder(
    directory: str | Path, recording: Recording, others: Iterable[str] = ()
) -> OutputFolder:
    """The folder for a tracked recording's files, checked before any work.

    Args:
        directory: of the outputs.
        recording: that is tracked.
        others: names of files that are written besides.

    Raises:
        InputError: it cannot be written to, holds a file that is read, or a file that no earlier
            run wrote where one of ours would go.
    """
    names = [*MOTION_FILES, "report.json", "recording.rrd", *overlay_names(recording), *others]
    return OutputFolder(directory, MOTION, names, inputs_of(recording))


def inputs_of(recording: Recording) -> list[Path]:
    """The files that a recording was read from; none where it was made in memory."""
    return [] if recording.path is None else input_files(recording.path)


def write_outputs(
    motion: Motion,
    recording: Recording,
    directory: str | Path,
    settings: Settings | None = None,
    progress: Progress | bool | None = None,
    warn: Warn = ignore_warning,
    formats: MotionFormats = USUAL_FORMATS,
) -> list[Path]:
    """Write all files of a tracked recording, drawn with its cameras as they were refined.

    Args:
        motion: tracked from the recording.
        recording: with its videos.
        directory: is made where missing; it changes when everything is complete.
        settings: of the tracker, for the edges that the viewer shows.
        progress: called with the frames drawn and their total; True shows a bar
            on stderr; None does so on a terminal.
        warn: called with a sentence for each file that cannot hold the motion and is left out.
        formats: how the motion's files are written.

    Returns:
        The files, in the order in which they were written.

    Raises:
        InputError: see ``tracked_folder``.
        OutputError: the disk is full; what was there is as it was.
    """
    return tracked_folder(directory, recording, formats.more_files).write(
        lambda stage: write_tracked(motion, recording, stage, settings, progress, warn, formats)
    )


def write_tracked(
    motion: Motion,
    recording: Recording,
    folder: Path,
    settings: Settings | None = None,
    progress: Progress | bool | None = None,
    warn: Warn = ignore_warning,
    formats: MotionFormats = USUAL_FORMATS,
) -> list[Path]:
    """The same into an existing folder, without any check of it."""
    videos, warnings = open_footage(recording)
    recording = with_refined_cameras(recording, motion)
    motion_warnings: list[str] = []
    files = write_motion(motion, folder, warn=motion_warnings.append, formats=formats)
    files.append(folder / "report.json")
    warnings = [*warnings, *motion_warnings]
    extra = {"recording": recording.path or recording.name, "warnings": warnings}
    write_report(files[-1], motion, extra)
    for sentence in motion_warnings:
        warn(sentence)
    targets = marker_tracks(recording)
    with progress_bar("drawing", progress) as show:
        total = sum(len(video) + viewer_frame_count(video) for video in videos)
        counter = FrameCounter(show, total)
        files += write_overlays(motion, recording, videos, folder, targets, counter)
        files.append(folder / "recording.rrd")
        footage = {
            source.camera_name: Footage(
                source.camera,
                counter.over(viewer_frames(video)),
                arm_edges(video, source.camera, motion, settings or Settings()),
            )
            for source, video in zip(recording.videos, videos, strict=True)
        }
        write_rerun(files[-1], motion, footage, targets)
    return files


def write_motion(
    motion: Motion,
    folder: Path,
    surface: Surface | None = None,
    picture: bytes | None = None,
    warn: Warn = ignore_warning,
    formats: MotionFormats = USUAL_FORMATS,
) -> list[Path]:
    """The motion in every format that others read.

    Args:
        motion: to be written.
        folder: that is there.
        surface: motion.glb's skin.
        picture: its colours.
        warn: called with a sentence for each file that cannot hold the motion and is left out, or
            whose angles step.
        formats: how the files are written.

    Returns:
        The files that were written.
    """
    files = [folder / name for name in MOTION_FILES]
    R_file_world = R_WORLD_OF_UP[formats.up].T
    joints = {name: to_world(R_file_world, points) for name, points in motion.joints().items()}
    write_trc(files[0], motion.times, joints)
    sentences = {files[1]: write_mot(files[1], motion), files[2]: write_isb(files[2], motion)}
    save_motion(files[3], motion)
    for path in files[4:]:
        if (sentence := write_animation(path, motion, surface, picture)) is not None:
            warn(sentence)
            files.remove(path)
    if formats.names == OPENSIM:
        files.append(folder / OPENSIM_FILE)
        sentences[files[-1]] = write_opensim(files[-1], motion)
    for path, of_file in sentences.items():
        for sentence in of_file:
            warn(f"{path.name}: {sentence}")
    return files


def with_refined_cameras(recording: Recording, motion: Motion) -> Recording:
    """The recording with its cameras rotated as the motion's report states."""
    turns_deg = {} if motion.report is None else motion.report.settings.get("camera_turns_deg", {})

    def refined(source: VideoSource) -> VideoSource:
        if source.camera_name not in turns_deg:
            return source
        camera = jax.tree.map(jnp.asarray, source.camera)
        turn_cam = jnp.asarray(np.radians(turns_deg[source.camera_name]), camera.T_cam_world.dtype)
        return replace(source, camera=turned(camera, turn_cam))

    return replace(recording, videos=tuple(map(refined, recording.videos)))


def overlay_names(recording: Recording, kind: str = "overlay") -> list[str]:
    """overlay_NAME.mp4 of each camera."""
    return [f"{kind}_{source.camera_name}.mp4" for source in recording.videos]


def write_overlays(
    motion: Motion,
    recording: Recording,
    videos: list[FrameSource],
    folder: Path,
    targets: Mapping[str, np.ndarray],
    counter: "FrameCounter",
) -> list[Path]:
    """A video of each camera."""
    files = []
    names = overlay_names(recording)
    for name, source, video in zip(names, recording.videos, videos, strict=True):
        path = folder / name
        frames = counter.over(video.frames())
        write_overlay(path, frames, source.camera, motion, targets, video.fps or 30.0)
        files.append(path)
    return files


def marker_tracks(recording: Recording) -> dict[str, np.ndarray]:
    """Marker -> (T, 3) measured positions, world, metres."""
    columns = np.moveaxis(recording.positions_world, 1, 0)
    return dict(zip(recording.marker_names, columns, strict=True))


class FrameCounter:
    """Shows every frame that is taken on a progress bar."""

    def __init__(self, show: Progress, total: int):
        self.show, self.total, self.done = show, total, 0

    def over(self, frames: Iterator[TimedImage]) -> Iterator[TimedImage]:
        """The same frames, counted."""
        for frame in frames:
            yield frame
            self.done += 1
            self.show(self.done, self.total)


def viewer_frames(video: FrameSource, luma: bool = False) -> Iterator[TimedImage]:
    """At most ``MOST_VIEWER_FRAMES`` frames, evenly over the video."""
    for i, frame in enumerate(video.frames(luma)):
        if i % _stride(video) == 0:
            yield frame


def viewer_frame_count(video: FrameSource) -> int:
    """The number of frames of ``viewer_frames``."""
    return -(-len(video) // _stride(video))


def _stride(video: FrameSource) -> int:
    return -(-len(video) // MOST_VIEWER_FRAMES)


def arm_edges(
    video: FrameSource, camera: Camera, motion: Motion, settings: Settings
) -> dict[str, list[tuple[float, np.ndarray]]]:
    """Canny's edges in both arms' regions of interest, at the frames of ``viewer_frames``.

    Returns:
        Name -> time and edges (S, S), uint8, 255 on edges.
    """
    thresholds_of = {"edges, left arm": Thresholds(), "edges, right arm": Thresholds()}
    images: dict[str, list[tuple[float, np.ndarray]]] = {name: [] for name in thresholds_of}
    regions = arm_regions_over_time(camera, motion, video.times, settings)
    origins, scales = np.asarray(regions.origin), np.asarray(regions.scale)
    times = {float(time): i for i, time in enumerate(video.times)}
    for time, image in viewer_frames(video, luma=True):
        i = times[time]
        for arm, (name, thresholds) in enumerate(list(thresholds_of.items())):
            if image is None or not np.isfinite(origins[i, arm]).all():
                continue
            part = crop(image, origins[i, arm], scales[i, arm], settings.region)
            dx, dy = gradients(part, settings.edge_detection)
            edges, thresholds_of[name] = edge_image(dx, dy, settings.edge_detection, thresholds)
            images[name].append((time, edges))
    return images


def arm_regions_over_time(
    camera: Camera, motion: Motion, times: np.ndarray, settings: Settings
) -> Region:
    """Regions (F, 2) around shoulder, elbow and hand of each arm at (F,) seconds; NaN unseen."""
    scene = make_scene(motion)
    bones = limb_bones(scene.tree)
    missing = np.full((2, len(scene.tree.bones), 3), np.nan)
    ends = np.array([missing if (pair := scene.at(t)) is None else pair for t in times])
    near, far = ends[:, 0, bones], ends[:, 1, bones[:, 2:]]
    points = np.concatenate([near[:, :, :2], far], 2)
    margin = float(settings.margin)
    return region_around(jnp.asarray(pixels(camera, points)), settings.region, margin)
