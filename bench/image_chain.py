"""The yardstick: OpenCV's bare image chain on both arms' regions, one thread.

Nothing that looks for an arm's edges can do with less; so a tracker's step is reported as a
multiple of it, taken in the same run.

INPUTS: frames, and where the elbows are in them. OUTPUTS: crops; their distance transforms.
"""

from collections.abc import Sequence

import cv2
import jax.numpy as jnp
import numpy as np

from jaxmocap.capture.markers import interpolate_markers
from jaxmocap.formats.recordings.recording import Recording
from jaxmocap.formats.time_series.markers import read_markers
from jaxmocap.geometry.cameras import Camera, project
from jaxmocap.images.regions import crop

# Samples along a side of a region, and Canny's thresholds: usual ones.
SIDE, LOW, HIGH = 200, 50, 150
ELBOWS = ("elbow_l", "elbow_r")


def image_chain(regions_bgr: Sequence[np.ndarray]) -> list[np.ndarray]:
    """BGR to grey, 5 x 5 blur, equalise, Canny, L2 distance transform by a 3 x 3 mask."""
    fields = []
    for region in regions_bgr:
        grey = cv2.cvtColor(region, cv2.COLOR_BGR2GRAY)
        even = cv2.equalizeHist(cv2.GaussianBlur(grey, (5, 5), 0))
        edges = cv2.Canny(even, LOW, HIGH)
        fields.append(cv2.distanceTransform(cv2.bitwise_not(edges), cv2.DIST_L2, 3))
    return fields


def both_arms(
    recording: Recording, camera: Camera, times: np.ndarray, images: Sequence[np.ndarray]
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Of each BGR frame the two crops about the true elbows, for what a region would be."""
    assert recording.path is not None
    truth = read_markers(recording.path.with_name("truth.trc"))
    points = np.stack([truth.points()[name] for name in ELBOWS], 1)
    elbows = interpolate_markers(truth.times, points, times)
    origins = np.round(np.asarray(project(camera, jnp.asarray(elbows, float)))) - SIDE / 2 - 0.5
    return [
        (crop(image, at[0], 1.0, SIDE), crop(image, at[1], 1.0, SIDE))
        for image, at in zip(images, origins, strict=True)
    ]
