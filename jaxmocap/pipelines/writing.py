"""Everything that ``track`` writes, each file moved into place when it is whole.

INPUTS: a Motion, its Recording, a folder.
OUTPUTS: joints.trc, angles.mot, angles_isb.mot, motion.npz, motion.bvh, motion.glb, report.json,
recording.rrd, and overlay.mp4 where there is video.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from jaxmocap.body.motion import Motion
from jaxmocap.body.surfaces.surface import Surface
from jaxmocap.capture.footage import open_footage
from jaxmocap.capture.video import FrameSource, TimedImage
from jaxmocap.formats.animation.export import write_animation
from jaxmocap.formats.files.output_folder import OutputFolder
from jaxmocap.formats.motion_npz import save_motion
from jaxmocap.formats.recordings.recording import Recording, VideoSource
from jaxmocap.formats.recordings.recording_files import input_files
from jaxmocap.formats.time_series.mot import write_isb, write_mot
from jaxmocap.formats.time_series.trc import write_trc
from jaxmocap.geometry.cameras import Camera, turned
from jaxmocap.hybrid.settings import Settings
from jaxmocap.images.edges import Thresholds, edge_image, gradients
from jaxmocap.images.regions import Region, crop, region_around
from jaxmocap.outputs.overlay import write_overlay
from jaxmocap.outputs.report import write_report
from jaxmocap.outputs.scene import ARM_BONES, make_scene, pixels
from jaxmocap.outputs.viewer import Footage, write_rerun
from jaxmocap.pipelines.progress import Progress, progress_bar

# The viewer's recording holds at most so many frames of a camera.
MOST_VIEWED = 300
# Runs that write a motion into a folder replace each other's files.
MOTION = "motion"
# What holds a motion, in the order in which it is written.
MOTION_FILES = (
    "joints.trc",
    "angles.mot",
    "angles_isb.mot",
    "motion.npz",
    "motion.bvh",
    "motion.glb",
)


# Takes a sentence that a user must know.
Warn = Callable[[str], None]


def no_warning(sentence: str) -> None:
    """Where nobody asks."""


def tracked_folder(
    directory: str | Path, recording: Recording, others: Iterable[str] = ()
) -> OutputFolder:
    """The folder for a tracked recording's files, looked at before any work.

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
    warn: Warn = no_warning,
) -> list[Path]:
    """Write all files of a tracked recording, drawn by its cameras as they were found.

    Args:
        motion: tracked from the recording.
        recording: with its videos.
        directory: is made where missing; it changes when everything is whole.
        settings: of the tracker, for the edges that the viewer shows.
        progress: called with the frames drawn and their total; True shows a bar on stderr.
        warn: called with a sentence for each file that cannot hold the motion and is left out.

    Returns:
        The files, in the order in which they were written.

    Raises:
        InputError: see ``tracked_folder``.
        OutputError: the disk is full; what was there is as it was.
    """
    return tracked_folder(directory, recording).write(
        lambda stage: write_tracked(motion, recording, stage, settings, progress, warn)
    )


def write_tracked(
    motion: Motion,
    recording: Recording,
    folder: Path,
    settings: Settings | None = None,
    progress: Progress | bool | None = None,
    warn: Warn = no_warning,
) -> list[Path]:
    """The same into a folder that is there, of which nothing is asked."""
    videos, warnings = open_footage(recording)
    recording = as_found(recording, motion)
    left_out: list[str] = []
    files = write_motion(motion, folder, warn=left_out.append)
    files.append(folder / "report.json")
    warnings = [*warnings, *left_out]
    extra = {"recording": recording.path or recording.name, "warnings": warnings}
    write_report(files[-1], motion, extra)
    for sentence in left_out:
        warn(sentence)
    targets = marker_tracks(recording)
    with progress_bar("drawing", progress) as show:
        total = sum(len(video) + viewed(video) for video in videos)
        counter = Counter(show, total)
        files += write_overlays(motion, recording, videos, folder, targets, counter)
        files.append(folder / "recording.rrd")
        footage = {
            source.camera_name: Footage(
                source.camera,
                counter.over(thinned(video)),
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
    warn: Warn = no_warning,
) -> list[Path]:
    """The motion in every format that others read.

    Args:
        motion: to be written.
        folder: that is there.
        surface: motion.glb's skin.
        picture: its colours.
        warn: called with a sentence for each file that cannot hold the motion and is left out.

    Returns:
        The files that were written.
    """
    files = [folder / name for name in MOTION_FILES]
    write_trc(files[0], motion.times, motion.joints())
    write_mot(files[1], motion)
    write_isb(files[2], motion)
    save_motion(files[3], motion)
    for path in files[4:]:
        if (sentence := write_animation(path, motion, surface, picture)) is not None:
            warn(sentence)
            files.remove(path)
    return files


def as_found(recording: Recording, motion: Motion) -> Recording:
    """The recording with its cameras turned by what the motion's report says of them."""
    told = {} if motion.report is None else motion.report.settings.get("camera_turns_deg", {})

    def found(source: VideoSource) -> VideoSource:
        if source.camera_name not in told:
            return source
        camera = jax.tree.map(jnp.asarray, source.camera)
        turn_cam = jnp.asarray(np.radians(told[source.camera_name]), camera.T_cam_world.dtype)
        return replace(source, camera=turned(camera, turn_cam))

    return replace(recording, videos=tuple(map(found, recording.videos)))


def overlay_names(recording: Recording, kind: str = "overlay") -> list[str]:
    """overlay.mp4 of the first camera, overlay_NAME.mp4 of the others."""
    return [
        f"{kind}_{source.camera_name}.mp4" if i else f"{kind}.mp4"
        for i, source in enumerate(recording.videos)
    ]


def write_overlays(
    motion: Motion,
    recording: Recording,
    videos: list[FrameSource],
    folder: Path,
    targets: Mapping[str, np.ndarray],
    counter: "Counter",
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


class Counter:
    """Tells a progress bar of every frame that goes by."""

    def __init__(self, show: Progress, total: int):
        self.show, self.total, self.done = show, total, 0

    def over(self, frames: Iterator[TimedImage]) -> Iterator[TimedImage]:
        """The same frames, counted."""
        for frame in frames:
            yield frame
            self.done += 1
            self.show(self.done, self.total)


def thinned(video: FrameSource, luma: bool = False) -> Iterator[TimedImage]:
    """At most ``MOST_VIEWED`` frames, evenly over the video."""
    for i, frame in enumerate(video.frames(luma)):
        if i % _stride(video) == 0:
            yield frame


def viewed(video: FrameSource) -> int:
    """How many frames ``thinned`` gives."""
    return -(-len(video) // _stride(video))


def _stride(video: FrameSource) -> int:
    return -(-len(video) // MOST_VIEWED)


def arm_edges(
    video: FrameSource, camera: Camera, motion: Motion, settings: Settings
) -> dict[str, list[tuple[float, np.ndarray]]]:
    """Canny's edges in both arms' regions of interest, at the frames of ``thinned``.

    Returns:
        Name -> time and edges (S, S), uint8, 255 on edges.
    """
    chains = {"edges, left arm": Thresholds(), "edges, right arm": Thresholds()}
    images: dict[str, list[tuple[float, np.ndarray]]] = {name: [] for name in chains}
    regions = arm_regions_over_time(camera, motion, video.times, settings)
    origins, scales = np.asarray(regions.origin), np.asarray(regions.scale)
    times = {float(time): i for i, time in enumerate(video.times)}
    for time, image in thinned(video, luma=True):
        i = times[time]
        for arm, (name, thresholds) in enumerate(list(chains.items())):
            if image is None or not np.isfinite(origins[i, arm]).all():
                continue
            part = crop(image, origins[i, arm], scales[i, arm], settings.region)
            dx, dy = gradients(part, settings.edge_detection)
            edges, chains[name] = edge_image(dx, dy, settings.edge_detection, thresholds)
            images[name].append((time, edges))
    return images


def arm_regions_over_time(
    camera: Camera, motion: Motion, times: np.ndarray, settings: Settings
) -> Region:
    """Regions (F, 2) around shoulder, elbow and hand of each arm at (F,) seconds; NaN unseen."""
    scene = make_scene(motion)
    bones = np.array([scene.bones.index(bone) for bone in ARM_BONES]).reshape(2, 3)
    unknown = np.full((2, len(scene.bones), 3), np.nan)
    ends = np.array([unknown if (pair := scene.at(t)) is None else pair for t in times])
    near, far = ends[:, 0, bones], ends[:, 1, bones[:, 2:]]
    points = np.concatenate([near[:, :, :2], far], 2)
    margin = float(settings.margin)
    return region_around(jnp.asarray(pixels(camera, points)), settings.region, margin)
