"""What is tracked: real recordings, rendered ones, one clip at several sizes, poses that are off.

INPUTS: the folder of real recordings and of people as rigged meshes; seeds, azimuths, names of
exercises and a folder to keep what is rendered in.
OUTPUTS: Clips; Footage, as a file and decoded; a DisplacedExerciser.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from itertools import product
from pathlib import Path

import cv2
import jax.numpy as jnp
import numpy as np

from jaxmocap.body.skeleton import LANDMARKS, Skeleton
from jaxmocap.body.subject import scale_to_landmarks
from jaxmocap.capture.video import open_video
from jaxmocap.formats.recordings.recording import Recording, VideoSource
from jaxmocap.geometry.cameras import Camera
from jaxmocap.pipelines.progress import progress_bar
from jaxmocap.synthetic.four_cameras import write_four_cameras
from jaxmocap.synthetic.movements.exerciser import Exerciser
from jaxmocap.synthetic.movements.exercises import exercise
from jaxmocap.synthetic.movements.motions import MOTIONS, Performance
from jaxmocap.synthetic.movements.splines import KeyStance
from jaxmocap.synthetic.people.figure import unit
from jaxmocap.synthetic.people.rigged_mesh import load_rig
from jaxmocap.synthetic.photographs import rest_height
from jaxmocap.synthetic.recording import write_performance, write_table_tennis, write_video

ELBOWS = ("elbow_l", "elbow_r")
# Landmark -> its marker in the reference.
REAL_LANDMARKS = {"neck": "Neck", "vertex": "Head"} | {
    f"{part}_{side}": f"{side.upper()}{'BigToe' if part == 'toe' else part.capitalize()}"
    for part in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle", "toe")
    for side in "lr"
}
# Where the cameras of synthetic recordings stand, degrees from frontal, seed by seed.
AZIMUTHS = (0.0, -60.0, 60.0, -30.0, 30.0)
SIZES = ((640, 480), (1280, 720), (1920, 1080))
# First channel and number of channels of each joint of an exerciser, which one error rotates.
JOINTS = ((3, 3), (6, 3), (9, 1), *((i, n) for s in (10, 14) for i, n in ((s, 3), (s + 3, 1))))
JOINTS += tuple((i, n) for s in (18, 23) for i, n in ((s, 3), (s + 3, 1), (s + 4, 1)))


@dataclass(frozen=True)
class Clip:
    """One recording with its reference.

    Attributes:
        group: recordings of one kind share one row of means.
        name: of the recording.
        path: of its ``recording.toml``; ``truth`` lies beside it.
        landmarks: landmark -> its marker in the reference.
        seed: of noise that is added to its markers.
        azimuth: of a synthetic recording's camera, degrees from frontal.
    """

    group: str
    name: str
    path: Path
    landmarks: dict[str, str]
    seed: int = 0
    azimuth: float = 0.0

    @property
    def truth(self) -> Path:
        """The reference."""
        return self.path.with_name("truth.trc")

    @property
    def pairs(self) -> dict[str, str]:
        """The elbows -> their markers in the reference."""
        return {name: self.landmarks[name] for name in ELBOWS}


def real(folder: Path) -> list[Clip]:
    """Each camera of the real recording by itself."""
    paths = sorted((folder / "balancing").glob("recording_cam_0*.toml"))
    names = [path.stem.removeprefix("recording_") for path in paths]
    return [
        Clip("balancing", name, path, REAL_LANDMARKS, seed)
        for seed, (name, path) in enumerate(zip(names, paths, strict=True))
    ]


def performed(motion: str, seconds: float, seed: int, azimuth: float) -> Performance:
    """A motion; a thrust goes at a camera at that azimuth, degrees from frontal."""
    return MOTIONS[motion](seconds, seed, **({"azimuth": azimuth} if motion == "thrust" else {}))


def synthetic(
    motion: str, seeds: Iterable[int], azimuths: Sequence[float], seconds: float, keep: Path
) -> list[Clip]:
    """A recording for each seed, rendered where ``keep`` does not hold it yet.

    Args:
        motion: of ``MOTIONS``.
        seeds: each of its own person, room and movement.
        azimuths: of the camera, degrees from frontal: seed s is seen from the (s mod n)-th.
        seconds: of each.
        keep: holds a folder for each, such as ``tennis_003_-30_6s``.
    """
    clips = []
    for seed in seeds:
        azimuth = azimuths[seed % len(azimuths)]
        name = f"{motion}_{seed:03d}_{azimuth:+03.0f}_{seconds:g}s"
        path = keep / name / "recording.toml"
        # Written last: where it is, all is.
        if not path.is_file():
            performance = performed(motion, seconds, seed, azimuth)
            write_performance(path.parent, performance, seconds, seed, azimuth=azimuth)
        clips.append(Clip(motion, name, path, {mark: mark for mark in LANDMARKS}, seed, azimuth))
    return clips


def exercises(
    file: Path,
    names: Iterable[str],
    seeds: Iterable[int],
    people: Sequence[str],
    seconds: float,
    keep: Path,
    girdle: bool = False,
) -> list[Clip]:
    """Rigged meshes at exercises, seen by four cameras, rendered where ``keep`` has them not yet.

    Args:
        file: of the people, ``person.npz``.
        names: of the exercises.
        seeds: each of its own clothes, rooms and movement.
        people: of the file.
        seconds: of each recording.
        keep: holds a folder for each, such as ``push_ups_000_man_1.748m_3s``.
        girdle: whether shoulders go with raised arms, or stay on the chest.
    """
    clips = []
    for kind, who, seed in product(names, people, seeds):
        rig = load_rig(file, who, seed)
        height = rest_height(rig)
        name = f"{kind}_{seed:03d}_{who}_{height:.3f}m_{seconds:g}s" + ("_girdle" if girdle else "")
        path = keep / name / "recording.toml"
        # Written last: where it is, all is.
        if not path.is_file():
            performer = exercise(rig, kind, seconds, seed, girdle)
            with progress_bar(f"rendering {name}", True) as show:
                write_four_cameras(path.parent, performer, seconds, seed, height, show)
        clips.append(Clip(kind, name, path, {mark: mark for mark in LANDMARKS}, seed))
    return clips


def true_skeleton(skeleton: Skeleton, truth: Mapping[str, np.ndarray]) -> Skeleton:
    """Bones as long as the truth's; how tall somebody is who never stands, limbs alone tell."""
    landmarks = dict(truth)
    try:
        return scale_to_landmarks(skeleton, landmarks)
    except ValueError:
        return scale_to_landmarks(skeleton, {k: v for k, v in landmarks.items() if k != "vertex"})


@dataclass(frozen=True)
class Footage:
    """A recording at one size.

    Attributes:
        recording: whose video is a file.
        times: (F,) of its frames, marker time.
        images: (F) decoded, BGR.
    """

    recording: Recording
    times: np.ndarray
    images: list[np.ndarray]

    @property
    def camera(self) -> Camera:
        """That took the frames."""
        return self.recording.videos[0].camera

    @property
    def decoded(self) -> Recording:
        """The recording with its frames in memory."""
        (source,) = self.recording.videos
        # The times in memory are marker time already.
        still = replace(source, path=None, offset=0.0, frames=(self.times, self.images))
        return replace(self.recording, videos=(still,))

    def first(self, frames: int) -> "Footage":
        """So many of its first frames, and the markers until the last of them."""
        kept = self.recording.times <= self.times[frames - 1]
        recording = replace(
            self.recording,
            times=self.recording.times[kept],
            positions_world=self.recording.positions_world[kept],
        )
        return Footage(recording, self.times[:frames], self.images[:frames])


def in_memory(source: VideoSource) -> VideoSource:
    """A video whose frames were all decoded."""
    times, images = zip(*open_video(source).frames(), strict=True)
    return replace(source, path=None, offset=0.0, frames=(np.array(times), list(images)))


def film(folder: Path, seconds: float) -> Footage:
    """Table tennis, 640 x 480 at 30 Hz, markers at 90 Hz."""
    recording = Recording.load(write_table_tennis(folder, seconds))
    video = open_video(recording.videos[0])
    images = [image for _, image in video.frames() if image is not None]
    return Footage(recording, video.times, images)


def at_size(footage: Footage, width: int, height: int) -> Footage:
    """The same scene by a camera of that many pixels: enlarged, and continued at the sides."""
    scale = height / footage.images[0].shape[0]
    left = round((width - scale * footage.images[0].shape[1]) / 2)
    images = [_enlarged(image, scale, left, width) for image in footage.images]
    camera, shift = footage.camera, np.array([[0, 0, left], [0, 0, 0], [0, 0, 0]])
    # Centres of pixels are at whole numbers: the image begins at -0.5.
    zoom = np.array([[scale, 0, (scale - 1) / 2], [0, scale, (scale - 1) / 2], [0, 0, 1]])
    larger = replace(
        camera,
        size=jnp.asarray([width, height], float),
        matrix=jnp.asarray(zoom @ np.asarray(camera.matrix, float) + shift, float),
    )
    (source,) = footage.recording.videos
    assert source.path is not None
    path = source.path.with_name(f"video_{width}x{height}.mp4")
    write_video(path, images)
    videos = (replace(source, path=path, camera=larger),)
    return Footage(replace(footage.recording, videos=videos), footage.times, images)


def _enlarged(image: np.ndarray, scale: float, left: int, width: int) -> np.ndarray:
    large = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
    right = width - left - large.shape[1]
    return cv2.copyMakeBorder(large, 0, 0, left, right, cv2.BORDER_REPLICATE)


@dataclass(frozen=True)
class DisplacedExerciser(Exerciser):
    """One whose joints are rotated, and whose body is moved, by the same at all times.

    Attributes:
        angle_errors: (28,) added to the channels, degrees.
        position_error: (3,) added to the position, metres.
    """

    angle_errors: np.ndarray | float = 0.0
    position_error: np.ndarray | float = 0.0

    def rig(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """As high above the floor as without the errors."""
        channels = self.curves(np.atleast_1d(times))
        places = self.places(channels) + self.position_error
        return self.rig_at(channels + self.angle_errors, places)


def displaced(
    person: Exerciser, rng: np.random.Generator, degrees: float = 5.0, metres: float = 0.03
) -> DisplacedExerciser:
    """The same, with every joint rotated by so much in some direction, and the body moved."""
    errors = np.zeros_like(KeyStance().channels())
    for first, count in JOINTS:
        direction = rng.standard_normal(count)
        errors[first : first + count] = degrees * direction / np.linalg.norm(direction)
    aside = metres * unit(rng.standard_normal(3))
    own = {field.name: getattr(person, field.name) for field in fields(Exerciser)}
    if person.hands is not None:
        own["hands"] = person.hands + aside
    return DisplacedExerciser(**own, angle_errors=errors, position_error=aside)
