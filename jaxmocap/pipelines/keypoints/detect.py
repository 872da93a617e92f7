"""Key points of every video of a recording, and the lines that make ``track`` use them.

    video ── frames ── detector (a process or a model of its own) ── keypoints/CAMERA.json

INPUTS: a recording, a detector. OUTPUTS: one JSON file for each video, in MMPose's layout of a
video; lines for the recording's file.
"""

import json
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxmocap.body.motion import landmarks_over_time
from jaxmocap.capture.video import FrameSource, open_video
from jaxmocap.formats.cameras.toml_sections import replace_entries_of_each, rewrite_toml
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.files.output_folder import OutputFolder
from jaxmocap.formats.files.writing import write_text
from jaxmocap.formats.recordings.keypoint_models import MODELS
from jaxmocap.formats.recordings.recording import Recording
from jaxmocap.formats.time_series.resampling import LONGEST_BRIDGED_S
from jaxmocap.formats.time_series.tables import nearest_times
from jaxmocap.geometry.cameras import Camera, depth, on_host, project
from jaxmocap.hybrid.settings import Settings
from jaxmocap.pipelines.progress import Progress, progress_bar
from jaxmocap.pipelines.tracking.track import track

# A person is asked for within the box of the landmarks, wider by this share of its longer side.
MARGIN = 0.2
# Decimals of pixels, confidences and metres.
DECIMALS = 2, 3, 3

# An image (H, W, 3) BGR uint8, and the box [left, top, right, bottom] of the person in it, pixels,
# to (K, 3) pixels and confidences, or (K, 6) with joints as ``keypoint_files`` has them; None where
# nobody is.
Detect = Callable[[np.ndarray, np.ndarray], np.ndarray | None]


class Detector(NamedTuple):
    """What finds key points."""

    model: str  # whose points they are, of ``keypoint_models.MODELS``
    # Gives the function for one video; what it took is given back at the end.
    opened: Callable[[], AbstractContextManager[Detect]]


class DetectedVideo(NamedTuple):
    """In how many frames of a camera's video somebody was found; the file, None without any."""

    camera: str
    file: Path | None
    frames: int
    found: int


def detect_keypoints(
    recording: Recording, detector: Detector, folder: Path, progress: Progress | bool | None = None
) -> list[DetectedVideo]:
    """Detect in every frame of every video, and write what was found.

    With markers the person is looked for where the markers' pose is in the image.

    Raises:
        InputError: no videos, or a detector that does not work.
    """
    if not recording.videos:
        raise recording.error("found no [[video]], expected one")
    cameras = [source.camera_name for source in recording.videos]
    # Runs over other cameras leave one another's files alone.
    kind = f"keypoints of {', '.join(sorted(cameras))}"
    out = OutputFolder(folder, kind, [f"{name}.json" for name in cameras])
    videos = [open_video(source) for source in recording.videos]
    boxes = [
        _boxes(recording, source.camera, video)
        for source, video in zip(recording.videos, videos, strict=True)
    ]
    total, done, results = sum(map(len, videos)), 0, []
    with out.writing() as stage, progress_bar("detecting", progress) as show:
        for source, video, around in zip(recording.videos, videos, boxes, strict=True):
            people = []
            with detector.opened() as detect:
                for (_, image), box in zip(video.frames(), around, strict=True):
                    people.append(None if image is None else detect(image, box))
                    done += 1
                    show(done, total)
            found = sum(person is not None for person in people)
            name = f"{source.camera_name}.json"
            if found:
                write_text(stage / name, _text(people, detector.model))
            file = out.path / name if found else None
            results.append(DetectedVideo(source.camera_name, file, len(people), found))
    return results


def _boxes(recording: Recording, camera: Camera, video: FrameSource) -> np.ndarray:
    """(F, 4) where the markers' pose is in each frame; all of the image far from any marker."""
    width, height = video.size
    whole = np.array([0.0, 0.0, width, height])
    boxes = np.tile(whole, (len(video), 1))
    if not recording.places:
        return boxes
    # By markers alone: whatever key points there were before are not read.
    motion = track(
        replace(recording, videos=()), Settings(refine="none", smooth=False), progress=False
    )
    # As the camera, about the local origin.
    points = landmarks_over_time(motion.skeleton, motion.poses)
    marked = np.flatnonzero(np.isfinite(recording.positions_world).all(-1).any(-1))
    nearest, away = nearest_times(motion.times[marked], video.times)
    camera, there = on_host(camera), np.asarray(points[marked[nearest]], float)
    pixels = project(camera, there)
    visible = (away <= LONGEST_BRIDGED_S) & (depth(camera, there) > 0).all(1)
    low, high = pixels.min(1), pixels.max(1)
    wider = MARGIN * (high - low).max(1, keepdims=True)
    around = np.clip(np.hstack([low - wider, high + wider]), 0, np.tile([width, height], 2))
    in_image = visible & (around[:, 2:] - around[:, :2] > 1).all(1)
    boxes[in_image] = around[in_image]
    return boxes


def _text(people: list[np.ndarray | None], model: str) -> str:
    """The key points of a video's frames as JSON, with the names of the points."""
    names = {str(i): name for i, name in enumerate(MODELS[model])}
    entries = []
    for number, person in enumerate(people):
        instances = []
        if person is not None:
            parts = {"keypoints": person[:, :2], "keypoint_scores": person[:, 2]}
            if person.shape[1] > 3:
                parts["keypoints_3d"] = person[:, 3:]
            each = zip(parts.items(), DECIMALS, strict=False)
            instances = [{name: np.round(own, n).tolist() for (name, own), n in each}]
        entries.append({"frame_id": number, "instances": instances})
    return json.dumps({"meta_info": {"keypoint_id2name": names}, "instance_info": entries})


def keypoint_entries(results: list[DetectedVideo], recording: Path) -> dict[str, str]:
    """Camera -> what ``keypoints`` of its ``[[video]]`` has to be, in that recording's file."""
    parent = recording.resolve().parent
    entries = {}
    for result in results:
        if result.file is not None:
            file = result.file.resolve()
            inside = file.relative_to(parent) if file.is_relative_to(parent) else file
            entries[result.camera] = inside.as_posix()
    return entries


def put_into(recording: Path, entries: dict[str, str], model: str) -> None:
    """Write them into the recording's file; comments, line ends and all other keys stay.

    Where a video states whose points its key points are, or their first number, that changes too.

    Raises:
        InputError: its videos are not written as tables of their own.
        OutputError: the file cannot be written.
    """

    def keypoints(video: Mapping[str, Any]) -> dict[str, Any]:
        entry = entries.get(video.get("camera", ""))
        stated = {"keypoints_model": model, "keypoints_first": 0}
        kept = {key: value for key, value in stated.items() if key in video}
        return {} if entry is None else {"keypoints": entry, **kept}

    def change(text: str) -> str:
        try:
            return replace_entries_of_each(text, "video", keypoints)
        except ValueError as error:
            raise InputError(recording, f"[[video]] {error}: put the lines in by hand") from None

    rewrite_toml(recording, change)
