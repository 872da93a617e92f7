"""Edges, distance fields, regions and look-ups against brute force, SciPy and given pixels."""

from dataclasses import replace

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import double, on_device
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import ndimage

from jaxmocap.geometry.outlines import Discs
from jaxmocap.images import edges, regions, sampling
from jaxmocap.images.edges import EdgeSettings, Thresholds

SIZE, FARTHEST_PX = 64, EdgeSettings().farthest


def look_up(fields, channels, points_xy):
    return sampling.look_up(fields, channels, points_xy[..., 0], points_xy[..., 1])


LOOK = jax.jit(look_up)
SLOPE = jax.jit(jax.jacfwd(look_up, argnums=2))


def bar(angle_degrees: float, size: int = SIZE) -> np.ndarray:
    """A bright bar through the middle of a dark image, along a direction (x right, y down)."""
    image = np.full((size, size), 30, np.uint8)
    way = np.array([np.cos(np.radians(angle_degrees)), np.sin(np.radians(angle_degrees))])
    ends = [tuple(int(v) for v in size / 2 + sign * size * way) for sign in (-1, 1)]
    return cv2.line(image, *ends, 220, 15)


def fields_of(grey, channels=1, settings=EdgeSettings()):  # noqa: B008
    return edges.distance_fields(grey, settings, Thresholds(), channels)[:2]


@given(st.integers(0, 1000), st.floats(0.001, 0.2))
def test_distances_are_those_to_the_nearest_edge(seed, density):
    marks = np.random.default_rng(seed).uniform(size=(40, 50)) < density
    marks[7, 9] = True
    field = edges.distance_field(np.where(marks, 255, 0).astype(np.uint8), FARTHEST_PX)
    exact = np.minimum(ndimage.distance_transform_edt(~marks), FARTHEST_PX)
    # OpenCV's 5 x 5 mask approximates Euclid's distance to 2 %.
    np.testing.assert_allclose(field, exact, rtol=0.02, atol=1e-5)
    assert field.dtype == np.float32
    assert (field[marks] == 0).all()


@pytest.mark.parametrize("channels", [1, 6])
@pytest.mark.parametrize("grey", [0, 128, 255])
def test_without_any_edge_everything_is_as_far_as_can_be(grey, channels):
    fields, actual = fields_of(np.full((SIZE, SIZE), grey, np.uint8), channels)
    np.testing.assert_array_equal(fields, np.full((channels, SIZE, SIZE), FARTHEST_PX, np.float32))
    assert not actual.any()


def test_the_sensors_noise_alone_makes_no_edges():
    rng = np.random.default_rng(0)
    noisy = np.clip(rng.normal(90, 2, (SIZE, SIZE)), 0, 255).astype(np.uint8)
    assert not fields_of(noisy)[1].any()


def test_edges_lie_where_the_brightness_changes():
    _, actual = fields_of(bar(90))
    rows, columns = np.nonzero(actual[4:-4])
    assert len(np.unique(rows)) == SIZE - 8
    # The bar is 15 pixels wide about column 32.
    assert set(np.unique(columns)) <= {22, 23, 24, 25, 39, 40, 41}


@pytest.mark.parametrize("blur_first", [True, False])
@pytest.mark.parametrize("equalise", ["none", "region"])
def test_a_dim_and_a_bright_image_have_the_same_edges(equalise, blur_first):
    settings = EdgeSettings(equalise=equalise, blur_first=blur_first)
    bright, dim = (fields_of(image, settings=settings)[0] for image in (bar(70), (bar(70) // 3)))
    # To the pixel: rounding the grey may move an edge to the next.
    assert np.abs(bright - dim)[:, 3:-3].max() <= 1.5


def test_equalising_is_opencvs():
    rng = np.random.default_rng(1)
    grey = np.clip(rng.normal(90, 20, (SIZE, SIZE)), 0, 255).astype(np.uint8)
    settings = EdgeSettings(equalise="image", blur_first=False)
    actual, _ = edges.equalise_levels(grey, settings, Thresholds())
    assert np.abs(actual.astype(int) - cv2.equalizeHist(grey)).max() <= 1
    first = replace(settings, blur_first=True, blur=1.5)
    expected = cv2.equalizeHist(cv2.GaussianBlur(grey, (0, 0), 1.5))
    assert (
        np.abs(edges.equalise_levels(grey, first, Thresholds())[0].astype(int) - expected).max()
        <= 1
    )
    plain = np.full((SIZE, SIZE), 77, np.uint8)
    np.testing.assert_array_equal(edges.equalise_levels(plain, settings, Thresholds())[0], plain)


def test_a_recording_is_equalised_by_its_first_frame_where_that_is_remembered():
    """So the same grey stays the same, whatever else comes into the picture."""
    settings = EdgeSettings(blur=0.0, equalise="image", memory=1.0)
    room = bar(90)
    once, after = edges.equalise_levels(room, settings, Thresholds())
    crowded = room.copy()
    crowded[:, :20] = 255
    again, _ = edges.equalise_levels(crowded, settings, after)
    np.testing.assert_array_equal(again[:, 20:], once[:, 20:])
    fresh, _ = edges.equalise_levels(crowded, replace(settings, memory=0.0), after)
    assert (fresh[:, 20:] != once[:, 20:]).any()


def test_thresholds_of_ones_own_hold_whatever_the_image():
    settings = EdgeSettings(canny="thresholds", blur=0.0)
    dim, bright = (fields_of(image, settings=settings)[1] for image in (bar(70) // 8, bar(70)))
    assert bright.any() and not dim.any()
    *_, after = edges.distance_fields(bar(70), settings, Thresholds(), 1)
    assert after == Thresholds()


def test_thresholds_follow_the_images_slowly():
    settings, dark = EdgeSettings(memory=0.8), np.zeros((SIZE, SIZE), np.uint8)
    *_, first = edges.distance_fields(bar(40), settings, Thresholds(), 1)
    *_, second = edges.distance_fields(dark, settings, first, 1)
    floor = np.array([settings.floor / 2, settings.floor])
    np.testing.assert_allclose(second.low_high, 0.8 * first.low_high + 0.2 * floor)


@pytest.mark.parametrize("channels", [2, 4, 6])
@pytest.mark.parametrize("angle", [0, 15, 37, 45, 75, 90, 105, 120, 150, 178])
def test_edges_go_to_the_channels_of_their_normals(angle, channels):
    """The line's normal is 90 degrees on; the two channels whose middles are nearest hold it."""
    fields, actual = fields_of(bar(angle), channels)
    normal = (angle + 90) % 180
    middles = (np.arange(channels) + 0.5) * 180 / channels
    apart = np.abs((middles - normal + 90) % 180 - 90)
    inner = np.zeros((SIZE, SIZE), bool)
    inner[8:-8, 8:-8] = actual[8:-8, 8:-8] > 0
    within = [(fields[k][inner] == 0).mean() for k in range(channels)]
    nearest = int(np.argmin(apart))
    assert inner.sum() > 50
    assert within[nearest] > 0.9 or np.sort(apart)[1] - apart[nearest] < 12
    for k in range(channels):
        # A normal is never in a channel whose middle is farther off than the overlap reaches.
        if apart[k] > 180 / channels + 12:
            assert within[k] < 0.2
    assert max(within) > 0.9


def test_each_edge_pixel_is_in_two_neighbouring_channels():
    rng = np.random.default_rng(3)
    marks = np.where(rng.uniform(size=(30, 30)) < 0.4, 255, 0).astype(np.uint8)
    dx, dy = (rng.integers(-300, 300, (30, 30)).astype(np.int16) for _ in range(2))
    sorted_edges = edges.by_direction(marks, dx, dy, 6)
    assert (np.sum(sorted_edges > 0, 0)[marks > 0] == 2).all()
    assert (sorted_edges[:, marks == 0] == 0).all()
    ring = sorted_edges[:, marks > 0] > 0
    assert (ring & (np.roll(ring, 1, 0) | np.roll(ring, -1, 0)) == ring).all()
    normal = np.arctan2(dy, dx)[marks > 0] % np.pi
    own = np.minimum((normal / np.pi * 6).astype(int), 5)
    assert ring[own, np.arange(len(own))].all()


def test_one_channel_is_the_plain_edge_image():
    marks = np.where(np.random.default_rng(0).uniform(size=(9, 9)) < 0.4, 255, 0).astype(np.uint8)
    zero = np.zeros((9, 9), np.int16)
    np.testing.assert_array_equal(edges.by_direction(marks, zero, zero, 1), marks[None])


def test_opposite_normals_share_a_channel():
    marks = np.full((1, 2), 255, np.uint8)
    dx, dy = np.array([[200, -200]], np.int16), np.array([[90, -90]], np.int16)
    sorted_edges = edges.by_direction(marks, dx, dy, 6)
    np.testing.assert_array_equal(sorted_edges[..., 0], sorted_edges[..., 1])


def window(corner, scale) -> regions.Region:
    """A region whose first pixel is ``corner``."""
    return regions.Region(on_device(np.array(corner) - 0.5), on_device(np.array(scale)))


def cropped(image, region, size=SIZE):
    return regions.crop(image, np.asarray(region.origin), float(region.scale), size)


@pytest.mark.parametrize("scale", [1.0, 1.7, 3.0])
@pytest.mark.parametrize("dot", [(130, 90), (171, 95), (139, 133), (150, 100), (119, 81)])
def test_a_bright_dot_is_found_where_its_pixel_is_mapped_to(scale, dot):
    image = np.zeros((240, 320), np.float32)
    image[dot[1] - 1 : dot[1] + 2, dot[0] - 1 : dot[0] + 2] = 1000
    region = window((117, 79), scale)
    small = cropped(image, region).astype(float)
    expected = np.asarray(regions.to_region(region, on_device(np.array([dot], float))))[0]
    rows, columns = np.indices(small.shape)
    actual = [np.sum(axis * small) / np.sum(small) for axis in (columns, rows)]
    np.testing.assert_allclose(actual, expected, atol=0.5)


def test_limbs_in_one_region_are_the_same_limbs_in_another():
    rng = np.random.default_rng(4)
    limbs = Discs(*(on_device(rng.uniform(0, 300, (3, 2))) for _ in range(3)))
    here, there = window((40, 20), 3.0), window((100, 7), 7.5)
    actual = regions.in_other_region(regions.discs_in_region(here, limbs), here, there)
    for own, expected in zip(actual, regions.discs_in_region(there, limbs), strict=True):
        np.testing.assert_allclose(own, expected, atol=1e-4)


def test_at_scale_1_a_region_is_a_plain_cut():
    image = np.random.default_rng(0).integers(0, 255, (200, 300)).astype(np.uint8)
    np.testing.assert_array_equal(
        cropped(image, window((40, 60), 1.0)), image[60 : 60 + SIZE, 40 : 40 + SIZE]
    )


@pytest.mark.parametrize("corner", [(-20, -10), (280, 30), (40, 190), (-40, 150), (290, 195)])
@pytest.mark.parametrize("scale", [1.0, 1.7, 3.0])
def test_beyond_the_border_the_image_is_continued(corner, scale):
    image = np.random.default_rng(0).integers(0, 255, (200, 300, 3)).astype(np.uint8)
    wide = cv2.copyMakeBorder(image, 300, 300, 300, 300, cv2.BORDER_REPLICATE)
    moved = window((corner[0] + 300, corner[1] + 300), scale)
    expected = cropped(wide, moved)
    small = cropped(image, window(corner, scale))
    assert small.shape == (SIZE, SIZE, 3)
    np.testing.assert_array_equal(small, expected)


def test_the_image_border_makes_no_edge():
    rows = np.linspace(40, 200, 200).astype(np.uint8)[:, None]
    image = np.broadcast_to(rows, (200, 300)).copy()
    assert not fields_of(cropped(image, window((-30, 20), 1.0)))[1].any()


@pytest.mark.parametrize("corner", [(-500, 20), (20, -500), (1000, 1000), (310, 0)])
def test_a_region_wholly_outside_is_featureless(corner):
    image = np.random.default_rng(0).integers(0, 255, (200, 300)).astype(np.uint8)
    small = cropped(image, window(corner, 1.3))
    assert small.shape == (SIZE, SIZE)
    assert not fields_of(small)[1].any()


def test_an_arm_beside_the_lens_asks_for_no_gigantic_region():
    """Points in the camera's plane project to tens of thousands of pixels."""
    image = np.random.default_rng(0).integers(0, 255, (200, 300)).astype(np.uint8)
    small = cropped(image, window((-40000, -40000), 1500.0))
    assert small.shape == (SIZE, SIZE)


@given(arrays(float, (3, 2), elements=st.floats(-50, 700)), st.floats(0.0, 0.6))
def test_a_region_holds_its_points_with_the_margin(points, margin):
    region = regions.region_around(on_device(points), SIZE, margin)
    inside = np.asarray(regions.to_region(region, on_device(points)))
    extent = np.ptp(points, axis=0).max() / float(region.scale)
    room = margin * extent - 1.0
    assert (inside >= -0.5 + room - 1e-3).all()
    assert (inside <= SIZE - 0.5 - room + 1e-3).all()
    assert float(region.scale) >= 1
    first_pixel = np.asarray(region.origin) + 0.5
    np.testing.assert_allclose(first_pixel, np.round(first_pixel), atol=1e-3)


def test_someone_far_away_is_not_enlarged():
    close = on_device(np.array([[100.0, 100.0], [104.0, 103.0]]))
    assert regions.region_around(close, SIZE, 0.3).scale == 1
    assert regions.region_around(close, SIZE, 0.3, finest=0.5).scale == 0.5


FIELDS = np.random.default_rng(5).normal(size=(3, 17, 23))


@given(st.integers(0, 2), st.floats(0, 22), st.floats(0, 16))
def test_a_look_up_is_scipys(channel, x, y):
    with double():
        value = LOOK(on_device(FIELDS), jnp.array([channel], jnp.int32), jnp.array([[x, y]]))
    expected = ndimage.map_coordinates(FIELDS[channel], [[y], [x]], order=1)
    # The last thousandth of a sample before the border is taken for the border.
    np.testing.assert_allclose(value, expected, atol=1e-9 if x < 21.999 and y < 15.999 else 1e-2)


@given(st.integers(0, 2), st.floats(-9, 32), st.floats(-9, 26))
def test_outside_a_look_up_is_the_borders(channel, x, y):
    with double():
        value = LOOK(on_device(FIELDS), jnp.array([channel], jnp.int32), jnp.array([[x, y]]))
    at = [[np.clip(y, 0, 16)], [np.clip(x, 0, 22)]]
    expected = ndimage.map_coordinates(FIELDS[channel], at, order=1)
    np.testing.assert_allclose(value, expected, atol=1e-2)


@given(st.integers(0, 2), st.floats(0.1, 21.9), st.floats(0.1, 15.9))
def test_the_slope_of_a_look_up_is_the_difference_of_its_values(channel, x, y):
    h = 1e-6
    if min(x % 1, y % 1) < 2 * h or max(x % 1, y % 1) > 1 - 2 * h:
        return
    with double():
        channels, point = jnp.array(channel, jnp.int32), jnp.array([x, y])
        slope = SLOPE(on_device(FIELDS), channels, point)
        steps = h * jnp.eye(2)
        ahead = LOOK(on_device(FIELDS), channels, point + steps)
        behind = LOOK(on_device(FIELDS), channels, point - steps)
    np.testing.assert_allclose(slope, (ahead - behind) / (2 * h), atol=1e-6)


def test_colour_becomes_grey_and_grey_stays():
    colour = np.zeros((4, 5, 3), np.uint8)
    colour[..., 1] = 100
    assert edges.to_grey(colour).shape == (4, 5)
    np.testing.assert_array_equal(edges.to_grey(colour), np.full((4, 5), 59, np.uint8))
    grey = np.arange(20, dtype=np.uint8).reshape(4, 5)
    assert edges.to_grey(grey) is grey


def test_fields_of_fewer_samples_have_the_same_distances_to_a_sample():
    grey = bar(70)
    fine, *_ = edges.distance_fields(grey, EdgeSettings(), Thresholds(), 6)
    coarse, *_ = edges.distance_fields(grey, EdgeSettings(), Thresholds(), 6, spacing=2)
    assert coarse.shape == (6, SIZE // 2, SIZE // 2)
    middles = fine.reshape(6, SIZE // 2, 2, SIZE // 2, 2).mean((2, 4))
    assert np.abs(2 * coarse - middles).max() <= 2


@pytest.mark.parametrize("count", [1, 2, 50])
def test_percentiles_are_numpys(count):
    values = np.random.default_rng(count).integers(0, 900, count).astype(np.int16)
    actual = edges.percentiles(values, (75.0, 90.0))
    np.testing.assert_allclose(actual, np.percentile(values, (75.0, 90.0)))
