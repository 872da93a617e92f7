"""A video of one camera, and nothing else, to a recording: lens, tilt, floor, key points.

INPUTS: a video, the person's height, a detector. OUTPUTS: in a folder ``recording.toml``,
``calibration.toml`` and ``keypoints/camera.json``, to be refined by hand; warnings.
"""

import os
from pathlib import Path

import numpy as np

from jaxmocap.body.skeleton import Skeleton
from jaxmocap.calibration.standing_person import StandingCamera, camera_by_person
from jaxmocap.calibration.vertical_lines import USUAL_TILT, CameraTilt, tilt_by_lines
from jaxmocap.capture.keypoints import follow_person, open_keypoints
from jaxmocap.capture.video import FrameSource, Video, open_video
from jaxmocap.formats.cameras.calibration import write_calibration
from jaxmocap.formats.cameras.video_sources import VideoSource
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.files.output_folder import OutputFolder
from jaxmocap.formats.recordings.recording import Recording, write_recording
from jaxmocap.geometry.cameras import Camera, camera_of_fov
from jaxmocap.pipelines.keypoints.detect import Detector, detect_keypoints
from jaxmocap.pipelines.progress import Progress

CAMERA = "camera"
RECORDING, CALIBRATION, KEYPOINTS = "recording.toml", "calibration.toml", "keypoints"
# What phones and webcams show along the longer side, degrees.
USUAL_FOV_DEG = 62.0
# A picture on film is so wide, millimetres: what focal lengths "as of 35 mm film" refer to.
FILM_MM = 36.0
# The room is the median of so many frames.
ROOM_FRAMES = 15
# Until the person shows where the camera is.
SOMEWHERE = StandingCamera(1.3, 0.0, 0.0, np.zeros(3))


def unmade_recording() -> Recording:
    """What stands for the recording until it is made: no markers, and a video of its camera."""
    video = VideoSource(CAMERA, camera_of_fov((640, 480), USUAL_FOV_DEG))
    return Recording(Skeleton.human(1.75), np.zeros(0), np.zeros((0, 0, 3)), (), (video,))


def recording_of_video(
    video: str | Path,
    height: float,
    fov_deg: float | None,
    detector: Detector,
    folder: str | Path,
    progress: Progress | bool | None = None,
) -> tuple[Recording, tuple[str, ...]]:
    """Find key points in a video, place its camera above the floor, and write the recording.

    The height is in metres; the field of view in degrees along the longer side, None takes the
    file's, or else ``USUAL_FOV_DEG``.

    Returns:
        The recording, with key points, and warnings for the user.

    Raises:
        InputError: no video, nobody's height, no field of view, a detector that does not work, or
            nobody in any frame.
    """
    opened = Video(video)
    try:
        skeleton = Skeleton.human(height)
    except ValueError as error:
        raise InputError("--height", str(error)) from None
    lens, warnings = _lens(opened, fov_deg)
    out = OutputFolder(folder, "recording of a video", [RECORDING, CALIBRATION], [Path(video)])
    path = out.path / RECORDING

    def write(place: StandingCamera, keypoints: bool) -> None:
        with out.writing() as stage:
            write_calibration(stage / CALIBRATION, {CAMERA: place.stand_camera(lens)})
            # Through no symbolic link: ``..`` leads elsewhere from behind one.
            there, here = (os.path.realpath(path) for path in (video, out.path))
            entry = {"file": os.path.relpath(there, here), "camera": CAMERA}
            entry |= {"keypoints": f"{KEYPOINTS}/{CAMERA}.json"} if keypoints else {}
            write_recording(stage / RECORDING, None, {}, [entry], CALIBRATION, {"height": height})

    write(SOMEWHERE, keypoints=False)
    detected = detect_keypoints(Recording.load(path), detector, out.path / KEYPOINTS, progress)
    if not detected[0].found:
        raise InputError(video, "found nobody in any frame, expected a person")
    write(SOMEWHERE, keypoints=True)
    place, more = _place(Recording.load(path), lens, skeleton)
    write(place, keypoints=True)
    return Recording.load(path), (*warnings, *more)


def _lens(video: Video, fov_deg: float | None) -> tuple[Camera, list[str]]:
    """The lens of a field of view, stated, the file's or usual; and a warning where that."""
    warnings, stated = [], fov_deg if fov_deg is not None else file_fov_deg(video)
    if stated is None:
        stated = USUAL_FOV_DEG
        usual = f"a field of view of {stated:g} degrees along the longer side was taken"
        warnings.append(f"{video.name} states no lens: {usual}, --fov states another")
    try:
        return camera_of_fov(video.size, stated), warnings
    except ValueError as error:
        raise InputError("--fov", str(error)) from None


def file_fov_deg(video: Video) -> float | None:
    """The field of view along the longer side that a phone states in its file; None without it."""
    for key, value in video.metadata.items():
        if key.lower().endswith("focal_length.35mm_equivalent"):
            try:
                focal_mm = float(value)
            except ValueError:
                continue
            if focal_mm > 0:
                return float(np.degrees(2 * np.arctan(FILM_MM / 2 / focal_mm)))
    return None


def _place(
    recording: Recording, lens: Camera, skeleton: Skeleton
) -> tuple[StandingCamera, list[str]]:
    """Where the camera is by the room and the person, and what a user should know of it."""
    (source,) = recording.videos
    video = open_video(source)
    detections = open_keypoints(source, video)
    assert detections is not None
    person = follow_person(detections)
    joints = None if person.joints_cam is None else person.joints_cam[:, 0]
    pixels_xy, confidences = person.pixels_xy[:, 0], person.confidences[:, 0]
    tilt = _tilt(video, lens, np.where(confidences[..., None] > 0, pixels_xy, np.nan))
    place = camera_by_person(lens, person.landmarks, pixels_xy, confidences, skeleton, joints, tilt)
    if place is None:
        taken = f"a camera {SOMEWHERE.height:g} m above the floor was taken"
        upright = "hips, shoulders and ankles of somebody upright"
        warning = f"hardly any frame shows {upright}: {taken}"
        return SOMEWHERE._replace(pitch=tilt.pitch, roll=tilt.roll), [warning]
    (height, pitch, roll), turns = place.deviations, np.degrees([place.pitch, place.roll])
    found = (
        "by the room and the person the camera is "
        f"{place.height:.2f} ± {height:.2f} m above the floor, looks "
        f"{turns[0]:.0f} ± {np.degrees(pitch):.0f} degrees downwards "
        f"and rolls by {turns[1]:.0f} ± {np.degrees(roll):.0f} degrees"
    )
    return place, [f"{found}; {CALIBRATION} beside the recording can be refined"]


def _tilt(video: FrameSource, lens: Camera, pixels_xy: np.ndarray) -> CameraTilt:
    """The camera's tilt by the room's vertical lines; the person's points are (F, P, 2), or NaN."""
    frames = set(np.linspace(0, len(video) - 1, ROOM_FRAMES).astype(int))
    chosen = (image for i, (_, image) in enumerate(video.frames(luma=True)) if i in frames)
    images = [image for image in chosen if image is not None]
    if not images:
        return USUAL_TILT
    return tilt_by_lines(np.median(images, 0).astype(np.uint8), lens, pixels_xy)
