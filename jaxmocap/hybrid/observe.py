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

from jaxmocap.body.arms import Arms
from jaxmocap.geometry.cameras import Camera, project
from jaxmocap.images.edges import FARTHEST_PX, EdgeSettings, Thresholds, distance_fields
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


def arm_regions(
    cameras: Camera, arms: Arms, size: int, margin: Array, finest: float = 1.0
) -> Region:
    """Regions (C, 2) around each arm's shoulder, elbow and hand as C stacked cameras see them."""

    def of_camera(camera: Camera) -> Region:
        limbs = jnp.stack([arms.shoulder, arms.elbow, arms.tip], 1)
        return region_around(project(camera, limbs), size, margin, finest)

    return jax.vmap(of_camera)(cameras)


class Observer:
    """The image chain of C cameras; remembers each region's thresholds from frame to frame."""

    def __init__(
        self, cameras: int, size: int, channels: int, edges: EdgeSettings, spacing: int = 1
    ):
        """Prepare for ``cameras`` cameras and regions of ``size`` samples.

        Args:
            cameras: how many.
            size: of the square regions, samples of the fields.
            channels: directions into which edges are sorted; 1 is the paper's plain field.
            edges: how edges are found.
            spacing: pixels of the crop, in which edges are found, per sample of the fields.
        """
        self.size, self.channels, self.edges, self.spacing = size, channels, edges, spacing
        self.thresholds = [[Thresholds(), Thresholds()] for _ in range(cameras)]
        self._shape = (cameras, 2, channels, size, size)
        # OpenCV lets go of the interpreter, so several cameras take several cores; two arms of one
        # would mostly wait for each other.
        self._pool = ThreadPoolExecutor(cameras, "observe") if cameras > 1 else None
        # Already where jit wants it: a sample without an image costs no transfer.
        nothing = np.full(self._shape, FARTHEST_PX / spacing, np.float32)
        self._nothing = jnp.asarray(nothing, jnp.float32)
        self._unseen = jnp.asarray(np.zeros(self._shape[:2], bool), bool)

    def fresh(self) -> "Observer":
        """The same for another recording: nothing is remembered."""
        return Observer(len(self.thresholds), self.size, self.channels, self.edges, self.spacing)

    def observe(self, images: Sequence[np.ndarray | None] | None, region: Region) -> Observation:
        """Fields of both arms in every camera that has an image, BGR or grey uint8."""
        if images is None or all(image is None for image in images):
            return Observation(region, self._nothing, self._unseen)
        origins, scales = np.asarray(region.origin), np.asarray(region.scale)
        fields, seen = np.empty(self._shape, np.float32), np.zeros(self._shape[:2], bool)

        def look(camera: int, image: np.ndarray | None) -> None:
            if image is None:
                fields[camera] = FARTHEST_PX / self.spacing
                return
            for arm in range(2):
                finer = scales[camera, arm] / self.spacing
                grey = crop(image, origins[camera, arm], finer, self.size * self.spacing, True)
                _, edges = distance_fields(
                    grey, self.edges, self.thresholds[camera][arm], self.channels, self.spacing,
                    fields[camera, arm],
                )  # fmt: skip
                # A black or featureless image is no evidence.
                seen[camera, arm] = bool(edges.any())

        every = map if self._pool is None else self._pool.map
        list(every(look, range(len(images)), images))
        return Observation(region, fields, seen)
