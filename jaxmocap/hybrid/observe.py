"""What the cameras measure of the arms: regions of interest as distance fields of their edges.

INPUTS: the markers' pose (for the regions), video frames. OUTPUTS: EdgeFields.
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.arms import Arms
from jaxmocap.evidence.edges import EdgeFields
from jaxmocap.geometry.cameras import SIZE_TOLERANCE, Camera, project
from jaxmocap.hybrid.settings import Settings
from jaxmocap.images.edges import Thresholds, distance_fields, equalise_levels, to_grey
from jaxmocap.images.regions import Region, crop, region_around

# Canny's thresholds of both arms in each camera, which the next frame begins with.
ArmThresholds = tuple[tuple[Thresholds, Thresholds], ...]


def no_thresholds(cameras: int) -> ArmThresholds:
    """Before the first frame of so many cameras."""
    return tuple((Thresholds(), Thresholds()) for _ in range(cameras))


def images_of(cameras: Camera | None, images: Any) -> list[np.ndarray | None] | None:
    """Images of each of the cameras, a single one for one camera; None where there are none.

    Raises:
        ValueError: as many as the cameras are expected, BGR or grey uint8, of the calibrated size.
    """
    if images is None:
        return None
    each: list[np.ndarray | None] = [
        image if image is None else np.asarray(image)
        for image in ([images] if hasattr(images, "ndim") else images)
    ]
    sizes = np.zeros((0, 2)) if cameras is None else np.asarray(cameras.size, float)
    if len(each) != len(sizes):
        raise ValueError(f"found {len(each)} images, expected one for each of the model's "
                         f"{len(sizes)} cameras, None where there is none")  # fmt: skip
    for image, size in zip(each, sizes, strict=True):
        if image is None:
            continue
        found = image.shape
        if image.dtype != np.uint8 or found[2:] not in ((), (3,)):
            problem = f"found an image of shape {found} and {image.dtype}"
            raise ValueError(f"{problem}, expected (H, W) or (H, W, 3) of uint8")
        if (np.abs(np.array(found[1::-1]) - size) > SIZE_TOLERANCE * size).any():
            width, height = size
            problem = f"found an image of {found[1]} × {found[0]} pixels"
            raise ValueError(f"{problem}, calibrated for {width:g} × {height:g}")
    return each


def arm_regions(
    cameras: Camera, arms: Arms, size: int, margin: Array, finest: float = 1.0
) -> Region:
    """Regions (C, 2) around each arm's shoulder, elbow and hand as C stacked cameras see them."""

    def of_camera(camera: Camera) -> Region:
        limbs = jnp.stack([arms.shoulder, arms.elbow, arms.tip], 1)
        return region_around(project(camera, limbs), size, margin, finest)

    return jax.vmap(of_camera)(cameras)


def edge_fields(
    settings: Settings,
    thresholds: ArmThresholds,
    images: Sequence[np.ndarray | None] | None,
    region: Region,
) -> tuple[EdgeFields, ArmThresholds]:
    """Fields of both arms in every camera that has an image, BGR or grey uint8.

    Args:
        settings: of the tracker.
        thresholds: after the last frame.
        images: of C cameras, None where there is none.
        region: (C, 2) of the arms.

    Returns:
        The fields, and the thresholds after these images.
    """
    cameras, size, spacing = len(thresholds), settings.samples, settings.spacing
    shape = (cameras, 2, settings.directions, size, size)
    detection, farthest = settings.edge_detection, settings.edge_detection.farthest / spacing
    if images is None or all(image is None for image in images):
        return EdgeFields(region, *_nothing(shape, farthest)), thresholds
    origins, scales = np.asarray(region.origin), np.asarray(region.scale)
    distances, available = np.empty(shape, np.float32), np.zeros(shape[:2], bool)

    def of_camera(camera: int) -> tuple[Thresholds, Thresholds]:
        if (image := images[camera]) is None:
            distances[camera] = farthest
            return thresholds[camera]
        each, before = [], thresholds[camera]
        if detection.equalise == "image":
            image, first = equalise_levels(to_grey(image), detection, before[0])
            before = (first, before[1])
        for arm in range(2):
            finer = scales[camera, arm] / spacing
            grey = crop(image, origins[camera, arm], finer, size * spacing, True)
            _, edges, after = distance_fields(
                grey, detection, before[arm], settings.directions, spacing, distances[camera, arm],
            )  # fmt: skip
            # A black or featureless image is no evidence.
            available[camera, arm] = bool(edges.any())
            each.append(after)
        return each[0], each[1]

    # OpenCV lets go of the interpreter, so several cameras take several cores; two arms of one
    # would mostly wait for each other.
    over = map if cameras < 2 else _pool(cameras).map
    after = tuple(over(of_camera, range(cameras)))
    return EdgeFields(region, distances, available), after


@lru_cache
def _pool(cameras: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(cameras, "observe")


@lru_cache
def _nothing(shape: tuple[int, ...], farthest: float) -> tuple[Array, Array]:
    """Already where jit wants it: a sample without an image costs no transfer."""
    distances = jnp.asarray(np.full(shape, farthest, np.float32), jnp.float32)
    return distances, jnp.asarray(np.zeros(shape[:2], bool), bool)
