"""The frames of a camera that the viewer's recording has, and the edges found in them.

INPUTS: a video, a camera, a Motion. OUTPUTS: some of the frames, counted; edges in the arms'
regions of interest.
"""

from collections.abc import Iterator
from itertools import islice

import numpy as np

from jaxmocap.body.arms import limb_bones
from jaxmocap.body.motion import Motion
from jaxmocap.capture.video import FrameSource, TimedImage
from jaxmocap.geometry.cameras import Camera, visible_pixels
from jaxmocap.hybrid.settings import Settings
from jaxmocap.images.edges import Thresholds, equalise_levels, find_edges
from jaxmocap.images.regions import Region, crop, region_around
from jaxmocap.outputs.scene import make_scene
from jaxmocap.pipelines.progress import Progress

# Frames of a camera in the viewer's recording, at most.
MOST_VIEWER_FRAMES = 300


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
    return islice(video.frames(luma), None, None, _stride(video))


def viewer_frame_count(video: FrameSource) -> int:
    """The number of frames of ``viewer_frames``."""
    return -(-len(video) // _stride(video))


def _stride(video: FrameSource) -> int:
    return -(-len(video) // MOST_VIEWER_FRAMES) or 1


def arm_edges(
    video: FrameSource, camera: Camera, motion: Motion, settings: Settings
) -> dict[str, list[tuple[float, np.ndarray]]]:
    """Canny's edges in both arms' regions of interest, at the frames of ``viewer_frames``.

    Returns:
        Name -> time and edges (S, S), uint8, 255 on edges.
    """
    detection, levels = settings.edge_detection, Thresholds()
    thresholds_of = {"edges, left arm": Thresholds(), "edges, right arm": Thresholds()}
    images: dict[str, list[tuple[float, np.ndarray]]] = {name: [] for name in thresholds_of}
    regions = arm_regions_over_time(camera, motion, video.times, settings)
    origins, scales = np.asarray(regions.origin), np.asarray(regions.scale)
    times = {float(time): i for i, time in enumerate(video.times)}
    for time, image in viewer_frames(video, luma=True):
        i = times[time]
        if image is not None and detection.equalise == "image":
            image, levels = equalise_levels(image, detection, levels)
        for arm, (name, thresholds) in enumerate(list(thresholds_of.items())):
            if image is None or not np.isfinite(origins[i, arm]).all():
                continue
            part = crop(image, origins[i, arm], scales[i, arm], settings.region)
            edges, thresholds_of[name] = find_edges(part, detection, thresholds)
            images[name].append((time, edges.image))
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
    return region_around(visible_pixels(camera, points), settings.region, margin)
