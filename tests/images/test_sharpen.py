"""Sharpening: where a silhouette ends, to a pixel, and where it has none."""

import cv2
import numpy as np
import pytest

from jaxmocap.images.background_model import Background
from jaxmocap.images.canvases import full_mask
from jaxmocap.images.regions import Region
from jaxmocap.silhouette.segmentation.sharpen import SilhouettePatch, sharpen_silhouette

SIZE = 64
Y, X = np.mgrid[:SIZE, :SIZE].astype(np.float32)


def circle(x: float, y: float, radius: float) -> np.ndarray:
    """Signed distance (SIZE, SIZE) to a circle, cells."""
    return np.clip(radius - np.hypot(X - x, Y - y), -8, 8).astype(np.float32)


def overlap(a: np.ndarray, b: np.ndarray) -> float:
    return (a & b).sum() / (a | b).sum()


def pixels_of(patch: SilhouettePatch, shape: tuple[int, ...]) -> np.ndarray:
    """(H, W) bool on the image of that shape."""
    image = Region(np.array([-0.5, -0.5], np.float32), np.array(1, np.float32))
    return patch.phi(image, max(shape))[: shape[0], : shape[1]] > 0


@pytest.mark.parametrize("learned", [True, False], ids=["room", "no room"])
@pytest.mark.parametrize("larger", [1, 4])
def test_pixels_correct_a_contour_that_is_some_pixels_off(learned, larger):
    y, x = np.mgrid[: 200 * larger, : 240 * larger] / larger
    truth = np.hypot(x - 110.3, y - 90.6) < 50.2
    room = np.stack([120 + 0.3 * x, 150 - 0.2 * y, 90 + 0 * x], -1)
    sharp = np.where(truth[..., None], np.array([60.0, 60.0, 200.0]), 0.8 * room)
    image = cv2.GaussianBlur(sharp, (0, 0), larger) + np.random.default_rng(0).normal(
        0, 3, sharp.shape
    )
    behind = Background(room.astype(np.float32), 3 + 0 * x, learned * np.ones_like(x, np.float32))
    region = Region(np.array([29.5, 19.5], np.float32) * larger, np.array(2.5 * larger, np.float32))
    middle = (np.array([110.3, 90.6]) + 0.5) / 2.5 - np.array([29.5, 19.5]) / 2.5 - 0.5
    off = np.clip(50.2 / 2.5 + 0.8 * np.cos(3 * np.arctan2(Y - middle[1], X - middle[0]))
                  - np.hypot(X - middle[0], Y - middle[1]), -8, 8).astype(np.float32)  # fmt: skip
    actual = sharpen_silhouette(np.clip(image, 0, 255).astype(np.uint8), off, region, behind)
    before = full_mask(off, region, truth.shape)
    assert overlap(before, truth) < 0.96
    assert overlap(pixels_of(actual, truth.shape), truth) > 0.985
    again = full_mask(actual.phi(region, SIZE), region, truth.shape)
    assert overlap(again, truth) > 0.98


def test_a_contour_is_found_to_a_pixel_in_a_video_whose_colours_are_stored_coarsely():
    y, x = np.mgrid[:200, :240].astype(float)
    angle = np.arctan2(y - 90.6, x - 110.3)
    truth = np.hypot(x - 110.3, y - 90.6) < 50.2 + 2.5 * np.cos(8 * angle)
    room = np.stack([120 + 0.3 * x, 150 - 0.2 * y, 90 + 0 * x], -1)
    striped = (np.cos(6 * angle) > 0)[..., None]
    body = np.where(striped, np.array([60.0, 60.0, 200.0]), np.array([150.0, 130.0, 60.0]))
    light = cv2.GaussianBlur(np.where(truth[..., None], body, room), (0, 0), 0.6)
    noise = np.random.default_rng(0).normal(0, 4, light.shape)
    stored = cv2.cvtColor(np.clip(light + noise, 0, 255).astype(np.uint8), cv2.COLOR_BGR2YCrCb)
    for channel in (1, 2):
        half = cv2.resize(stored[..., channel], (120, 100), interpolation=cv2.INTER_AREA)
        stored[..., channel] = cv2.resize(half, (240, 200), interpolation=cv2.INTER_LINEAR)
    image = cv2.cvtColor(stored, cv2.COLOR_YCrCb2BGR)
    background = Background(room.astype(np.float32), *np.float32([3 + 0 * x, 1 + 0 * x]))
    region = Region(np.array([29.5, 19.5], np.float32), np.array(2.5, np.float32))
    start = circle(31.62, 27.74, 20.68)
    actual = pixels_of(sharpen_silhouette(image, start, region, background), truth.shape)
    assert overlap(full_mask(start, region, truth.shape), truth) < 0.94
    assert overlap(actual, truth) > 0.974


def test_nothing_and_what_lies_beyond_the_image_has_no_pixels():
    image = np.full((40, 60, 3), 90, np.uint8)
    region = Region(np.array([-200.5, -0.5], np.float32), np.array(1, np.float32))
    for phi in (np.full((SIZE, SIZE), -8, np.float32), circle(31.0, 30.0, 15.0)):
        patch = sharpen_silhouette(image, phi, region)
        assert not pixels_of(patch, (40, 60)).any() and (patch.phi(region, SIZE) < 0).all()
