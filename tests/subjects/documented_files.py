"""The files that a recording file on a page names, so that it can be read."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from small_recording import CAMERA, FRAMES, VIDEO_RATE, image

from jaxmocap.body.kinematics import forward, landmarks
from jaxmocap.body.pose import relaxed_pose
from jaxmocap.body.skeleton import LANDMARKS, Skeleton
from jaxmocap.cli.program import main
from jaxmocap.formats.cameras.calibration import write_calibration
from jaxmocap.formats.marker_sets.sets import set_file
from jaxmocap.formats.time_series.c3d import write_c3d
from jaxmocap.formats.time_series.tables import Markers
from jaxmocap.formats.time_series.trc import write_trc
from jaxmocap.synthetic.recording import write_video

RATE, SAMPLES = 60, 24


def write_files_named_by(table: dict[str, Any], folder: Path) -> None:
    """Markers, videos, calibration and person, each as its table has it."""
    videos = table.get("video", [])
    for video in videos:
        if "file" in video:
            write_video(folder / video["file"], (image(i) for i in range(FRAMES)), VIDEO_RATE)
        if "background" in video:
            cv2.imwrite(str(folder / video["background"]), image(0))
        if "keypoints" in video:
            (folder / video["keypoints"]).mkdir(parents=True)
    if "calibration" in table:
        cameras = {video["camera"]: CAMERA for video in videos}
        write_calibration(folder / table["calibration"]["file"], cameras)
    markers, subject = table.get("markers", {}), table.get("subject", {})
    rigid = [name for names in markers.get("rigid", {}).values() for name in names]
    alone = [name for name in markers.get("on", {}) if name not in markers.get("rigid", {})]
    if "set" in markers:
        alone += set_file(markers["set"])[0]
    if "file" in markers:
        times, points = _standing([*alone, *rigid])
        if markers["file"].endswith(".c3d"):
            positions = np.stack(list(points.values()), 1)
            write_c3d(folder / markers["file"], Markers(times, tuple(points), positions))
        else:
            write_trc(folder / markers["file"], times, points)
    if "static" in subject:
        write_static(folder / subject["static"], subject.get("landmarks", {}))
    if "file" in subject:
        assert main(["scale", "--height", "1.8", "--out", str(folder / subject["file"])]) == 0


def write_static(path: Path, names: dict[str, str]) -> None:
    """Somebody who stands still, with markers on landmarks."""
    person = Skeleton.human(1.75)
    points = np.asarray(landmarks(person, relaxed_pose(person))) + np.array([0, 0, 1.0])
    still = {
        mark: np.tile(points[LANDMARKS.index(name)], (SAMPLES, 1)) for name, mark in names.items()
    }
    write_trc(path, np.arange(SAMPLES) / RATE, still)


def _standing(names: list[str]) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Markers at places of their own."""
    person = Skeleton.human(1.75)
    middle = np.asarray(forward(person, relaxed_pose(person)).joints_world).mean(0) + np.array(
        [0, 0, 1.0]
    )
    rng = np.random.default_rng(0)
    points = {name: middle + rng.normal(0, 0.2, 3) + np.zeros((SAMPLES, 3)) for name in names}
    return np.arange(SAMPLES) / RATE, points
