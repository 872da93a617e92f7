"""One synthetic recording at several sizes, as a file and decoded beforehand.

INPUTS: a folder, a duration. OUTPUTS: Footage.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import jax.numpy as jnp
import numpy as np

from jaxmocap.capture.video import open_video
from jaxmocap.formats.recordings.recording import Recording
from jaxmocap.geometry.cameras import Camera
from jaxmocap.synthetic.recording import write_table_tennis, write_video

SIZES = ((640, 480), (1280, 720), (1920, 1080))


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
