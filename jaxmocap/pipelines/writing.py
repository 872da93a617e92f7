"""Everything that ``track`` writes, each file moved into place when it is complete.

INPUTS: a Motion, its Recording, a folder.
OUTPUTS: joints.trc, angles.mot, angles_isb.mot, motion.npz, motion.bvh, motion.glb, report.json,
recording.rrd, overlay_NAME.mp4 of each camera, angles_opensim.mot where it is asked for.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np

from jaxmocap.body.motion import Motion
from jaxmocap.body.skeleton import LANDMARKS
from jaxmocap.body.surfaces.surface import Surface
from jaxmocap.capture.footage import open_footage
from jaxmocap.capture.video import FrameSource, TimedImage
from jaxmocap.compilation.freed_memory import give_back
from jaxmocap.formats.animation.export import write_animation
from jaxmocap.formats.files.output_folder import OutputFolder
from jaxmocap.formats.motion_npz import save_motion
from jaxmocap.formats.opensim.coordinates import write_opensim
from jaxmocap.formats.recordings.recording import Recording, VideoSource
from jaxmocap.formats.recordings.recording_files import input_files
from jaxmocap.formats.time_series.axes import R_WORLD_OF_UP, Z_UP, to_world
from jaxmocap.formats.time_series.mot import write_isb, write_mot
from jaxmocap.formats.time_series.trc import write_trc
from jaxmocap.geometry.cameras import stack_cameras
from jaxmocap.geometry.rows import ComputedRows
from jaxmocap.hybrid.settings import Settings
from jaxmocap.outputs.overlay import write_overlay
from jaxmocap.outputs.report import summarise, write_figures
from jaxmocap.outputs.viewer import Footage, shown_every, write_rerun
from jaxmocap.pipelines.progress import Progress, progress_bar
from jaxmocap.pipelines.viewer_frames import (
    FrameCounter,
    arm_edges,
    viewer_frame_count,
    viewer_frames,
)
from jaxmocap.smoothing.problem import all_turned

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


# Called with a warning.
Warn = Callable[[str], None]


def ignore_warning(sentence: str) -> None:
    """A ``Warn`` that does nothing."""


def tracked_folder(
    directory: str | Path,
    recording: Recording,
    others: Iterable[str] = (),
    inputs: Iterable[Path] = (),
) -> OutputFolder:
    """The folder for a tracked recording's files, and others, checked before any work.

    ``inputs`` are files that are read besides the recording's.

    Raises:
        InputError: it cannot be written to, holds a file that is read, or a file that no earlier
            run wrote where one of ours would go.
    """
    names = [*MOTION_FILES, "report.json", "recording.rrd", *overlay_names(recording), *others]
    # None where the recording was made in memory.
    own = [] if recording.path is None else input_files(recording.path)
    return OutputFolder(directory, MOTION, names, [*own, *inputs])


def write_outputs(
    motion: Motion,
    recording: Recording,
    directory: str | Path,
    settings: Settings | None = None,
    progress: Progress | bool | None = None,
    warn: Warn = ignore_warning,
    up: str = Z_UP,
    opensim: bool = False,
) -> list[Path]:
    """Write all files of a tracked recording, drawn with its cameras as they were refined.

    Args:
        motion: tracked from the recording.
        recording: with its videos.
        directory: is made where missing. The motion's files and the report move into place
            before any picture is drawn; what an earlier run drew goes with them.
        settings: of the tracker, for the edges that the viewer shows.
        progress: called with the frames drawn and their total; True shows a bar
            on stderr; None does so on a terminal.
        warn: called with a sentence for each file that cannot hold the motion and is left out.
        up: vertical axis of joints.trc, "z" or "y".
        opensim: write the coordinates of OpenSim's model as well.

    Returns:
        The files, in the order in which they were written.

    Raises:
        InputError: see ``tracked_folder``.
        OutputError: the disk is full; every file that is there is complete.
    """
    folder = tracked_folder(directory, recording, [OPENSIM_FILE] if opensim else [])
    videos, warnings = open_footage(recording)
    give_back()
    files = folder.write(
        lambda stage: write_motion(
            motion, stage, None, None, warn, recording, warnings, up=up, opensim=opensim
        ),
        more_follows=True,
    )
    give_back()
    return files + folder.write(
        lambda stage: _write_pictures(motion, recording, videos, stage, settings, progress)
    )


def write_tracked(
    motion: Motion,
    recording: Recording,
    folder: Path,
    settings: Settings | None = None,
    progress: Progress | bool | None = None,
) -> list[Path]:
    """The same into an existing folder, without any check of it."""
    videos, warnings = open_footage(recording)
    files = write_motion(motion, folder, recording=recording, warnings=warnings)
    return files + _write_pictures(motion, recording, videos, folder, settings, progress)


def _write_pictures(
    motion: Motion,
    recording: Recording,
    videos: list[FrameSource],
    folder: Path,
    settings: Settings | None,
    progress: Progress | bool | None,
) -> list[Path]:
    """The overlays and the viewer's recording."""
    recording = with_refined_cameras(recording, motion)
    columns = np.moveaxis(recording.positions_world, 1, 0)
    targets = dict(zip(recording.marker_names, columns, strict=True))
    with progress_bar("drawing", progress) as show:
        total = sum(len(video) + viewer_frame_count(video) for video in videos)
        counter = FrameCounter(show, total)
        files = write_overlays(motion, recording, videos, folder, targets, counter)
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
    recording: Recording | None = None,
    warnings: Iterable[str] = (),
    up: str = Z_UP,
    opensim: bool = False,
) -> list[Path]:
    """The motion in every format that others read; the files that were written.

    Of a recording the report as well, with ``warnings`` about it. ``warn`` is called with a
    sentence for each file that cannot hold the motion and is left out, or whose angles step, and
    where recording.rrd will not show every sample.
    """
    problems: list[str] = []
    files = [folder / name for name in MOTION_FILES]
    _write_joints(files[0], motion, up)
    sentences = {files[1]: write_mot(files[1], motion), files[2]: write_isb(files[2], motion)}
    save_motion(files[3], motion)
    for path in files[4:]:
        if (sentence := write_animation(path, motion, surface, picture)) is not None:
            problems.append(sentence)
            files.remove(path)
    if opensim:
        files.append(folder / OPENSIM_FILE)
        sentences[files[-1]] = write_opensim(files[-1], motion)
    for path, of_file in sentences.items():
        problems += [f"{path.name}: {sentence}" for sentence in of_file]
    if (step := shown_every(motion)) > 1:
        problems.append(f"recording.rrd: one sample in {step}, the other files have all")
    for sentence in problems:
        warn(sentence)
    if recording is not None:
        files.append(folder / "report.json")
        recorded = {"recording": recording.path or recording.name}
        recorded |= {"warnings": [*warnings, *problems]}
        write_figures(summarise(motion) | recorded, files[-1])
    return files


def _write_joints(path: Path, motion: Motion, up: str) -> None:
    """The landmarks over time, which nothing else needs."""
    R_file_world = R_WORLD_OF_UP[up].T
    points = motion.joint_positions()
    joints = {
        name: ComputedRows(
            (len(points), 3), lambda rows, i=i: to_world(R_file_world, points[rows, i])
        )
        for i, name in enumerate(LANDMARKS)
    }
    write_trc(path, motion.times, joints)


def with_refined_cameras(recording: Recording, motion: Motion) -> Recording:
    """The recording with its cameras rotated as the motion's report states."""
    turns_deg = {} if motion.report is None else motion.report.run.camera_turns_deg

    def refined(source: VideoSource) -> VideoSource:
        if source.camera_name not in turns_deg:
            return source
        turns_cam = np.radians([turns_deg[source.camera_name]])
        cameras = all_turned(stack_cameras([source.camera]), turns_cam)
        return replace(source, camera=jax.tree.map(lambda part: np.asarray(part)[0], cameras))

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
    counter: FrameCounter,
    kind: str = "overlay",
    changed: Callable[[str, Iterable[TimedImage]], Iterable[TimedImage]] = lambda _, frames: frames,
) -> list[Path]:
    """A video of each camera; ``changed`` makes its frames of those that its name's camera took."""
    files = [folder / name for name in overlay_names(recording, kind)]
    for path, source, video in zip(files, recording.videos, videos, strict=True):
        frames = changed(source.camera_name, counter.over(video.frames()))
        write_overlay(path, frames, source.camera, motion, targets, video.fps or 30.0)
    return files
