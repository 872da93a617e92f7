"""What the cameras saw: each arm's region of interest as distance fields of its edges.

INPUTS: the markers' pose (for the regions), video frames. OUTPUTS: an Observation.
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.geometry.cameras import Camera, project
from jaxmocap.hybrid.arms import Arms
from jaxmocap.images.edges import FARTHEST_PX, EdgeSettings, Thresholds, distance_fields, to_grey
from jaxmocap.images.regions import Region, crop, region_around


class Observation(NamedTuple):
    """Two arms in C cameras.

    Attributes:
        region: where the fields lie: origins (C, 2, 2), scales (C, 2).
        fields: (C, 2, K, S, S) distances to edges of K directions, samples of the region.
        seen: (C, 2) whether there is an image; the fields mean nothing where not.
    """

    region: Region
    fields: Array | np.ndarray
    seen: Array | np.ndarray

    def by_arm(self) -> "Observation":
        """The same with the arms' axis before the cameras'."""
        return jax.tree.map(lambda part: jnp.swapaxes(jnp.asarray(part), 0, 1), self)


def arm_regions(cameras: Camera, arms: Arms, size: int, margin: Array) -> Region:
    """Regions (C, 2) around each arm's shoulder, elbow and hand as C stacked cameras see them."""

    def of_camera(camera: Camera) -> Region:
        limbs = jnp.stack([arms.shoulder, arms.elbow, arms.tip], 1)
        return region_around(project(camera, limbs), size, margin)

    return jax.vmap(of_camera)(cameras)


class Observer:
    """The image chain of C cameras; remembers each region's thresholds from frame to frame."""

    def __init__(self, cameras: int, size: int, channels: int, edges: EdgeSettings):
        """Prepare for ``cameras`` cameras and regions of ``size`` samples.

        Args:
            cameras: how many.
            size: of the square regions, samples.
            channels: directions into which edges are sorted; 1 is the paper's plain field.
            edges: how edges are found.
        """
        self.size, self.channels, self.edges = size, channels, edges
        self.thresholds = [[Thresholds(), Thresholds()] for _ in range(cameras)]
        shape = (cameras, 2, channels, size, size)
        self._blank = np.full(shape, FARTHEST_PX, np.float32)
        self._pool = ThreadPoolExecutor(max_workers=2, thread_name_prefix="observe")
        # Already where jit wants it: a sample without an image costs no transfer.
        self._nothing = jnp.asarray(self._blank)

    def observe(self, images: Sequence[np.ndarray | None] | None, region: Region) -> Observation:
        """Fields of both arms in every camera that has an image, BGR or grey uint8."""
        if images is None or all(image is None for image in images):
            return Observation(region, self._nothing, np.zeros(self._blank.shape[:2], bool))
        origins, scales = np.asarray(region.origin), np.asarray(region.scale)
        fields, seen = self._blank.copy(), np.zeros(self._blank.shape[:2], bool)

        def look(camera: int, arm: int, image: np.ndarray) -> None:
            grey = to_grey(crop(image, origins[camera, arm], scales[camera, arm], self.size))
            fields[camera, arm], edges = distance_fields(
                grey, self.edges, self.thresholds[camera][arm], self.channels
            )
            # A black or featureless image is no evidence.
            seen[camera, arm] = bool(edges.any())

        jobs = [
            (camera, arm, image)
            for camera, image in enumerate(images)
            if image is not None
            for arm in range(2)
        ]
        # OpenCV lets go of the interpreter, so two regions take two cores.
        list(self._pool.map(lambda job: look(*job), jobs))
        return Observation(region, fields, seen)
