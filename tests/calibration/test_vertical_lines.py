"""A camera's pitch and roll by the vertical lines of a drawn room."""

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmocap.calibration.standing_person import StandingCamera
from jaxmocap.calibration.vertical_lines import USUAL_TILT, tilt_by_lines
from jaxmocap.geometry.cameras import Camera, project

SIZE, FOCAL = (960, 720), 700.0
LENS = Camera.create(SIZE, np.array([[FOCAL, 0, 479.5], [0, FOCAL, 359.5], [0, 0, 1]]))
NOBODY = np.zeros((0, 1, 2))
PROJECT = jax.jit(project)


def drawn(lines_world: np.ndarray, place: StandingCamera, image: np.ndarray) -> None:
    """Lines (N, 2, 3) of a room, as a camera has them, into the image."""
    ends = np.asarray(PROJECT(place.stand_camera(LENS), jnp.asarray(lines_world, jnp.float32)))
    for start, end in ends.round().astype(int).tolist():
        cv2.line(image, start, end, (30,), 2, cv2.LINE_AA)


def room(place: StandingCamera, *, vertical: bool) -> np.ndarray:
    """A wall and a floor of boards, with or without what is vertical, and clutter."""
    rng = np.random.default_rng(1)
    image = np.full(SIZE[::-1], 200, np.uint8)
    across = [[[5.0, -3.0, z], [5.0, 3.0, z]] for z in (0.0, 1.0, 2.4)]
    boards = [[[2.5, y, 0.0], [5.0, y, 0.0]] for y in np.linspace(-2, 2, 9)]
    drawn(np.array(across + boards), place, image)
    clutter = rng.uniform([3.0, -2.0, 0.2], [5.0, 2.0, 2.0], (12, 3))
    drawn(np.stack([clutter, clutter + rng.normal(0, 0.3, clutter.shape)], 1), place, image)
    if vertical:
        walls = [[[5.0, y, 0.0], [5.0, y, 2.4]] for y in (-2.2, -1.4, -0.6, 0.5, 1.3, 2.1)]
        shelf = [[[3.5, y, 0.3], [3.5, y, 1.6]] for y in (-1.1, 1.0)]
        drawn(np.array(walls + shelf), place, image)
    return image


@pytest.mark.parametrize(
    ("pitch_deg", "roll_deg"), [(0.0, 0.0), (8.0, -4.0), (22.0, 13.0), (20.0, -26.0), (-6.0, 5.0)]
)
def test_the_tilt_follows_from_what_is_vertical(pitch_deg, roll_deg):
    place = StandingCamera(1.5, np.radians(pitch_deg), np.radians(roll_deg), np.zeros(3))
    tilt = tilt_by_lines(room(place, vertical=True), LENS, NOBODY)
    assert np.degrees(tilt.pitch) == pytest.approx(pitch_deg, abs=2.0)
    assert np.degrees(tilt.roll) == pytest.approx(roll_deg, abs=1.0)
    off = np.abs(np.subtract(tilt[:2], place[1:3]))
    assert (off < 3 * tilt.deviations).all()
    assert (tilt.deviations < USUAL_TILT.deviations / 2).all()


def test_without_vertical_lines_the_tilt_is_as_unsure_as_before():
    blank = tilt_by_lines(np.full(SIZE[::-1], 90, np.uint8), LENS, NOBODY)
    assert np.abs(np.subtract(blank[:2], USUAL_TILT[:2])).max() < np.radians(0.5)
    np.testing.assert_allclose(blank.deviations, USUAL_TILT.deviations, rtol=0.1)
    place = StandingCamera(1.5, np.radians(8.0), 0.0, np.zeros(3))
    cluttered = tilt_by_lines(room(place, vertical=False), LENS, NOBODY)
    assert (np.abs(np.subtract(cluttered[:2], place[1:3])) < 2 * cluttered.deviations).all()


def test_the_persons_own_limbs_are_no_verticals():
    """Somebody who leans all the time, in many lines; in one frame of ten nobody is found."""
    place = StandingCamera(1.5, np.radians(8.0), 0.0, np.zeros(3))
    image = room(place, vertical=False)
    for column in range(466, 506, 6):
        cv2.line(image, (column, 600), (column + 90, 250), (30,), 2, cv2.LINE_AA)
    joints_xy = np.stack(
        [[500.0, 575.0] - np.array([-65.0, 350.0]) * t for t in np.linspace(0, 1, 5)]
    )
    person_xy = np.stack([joints_xy] * 9 + [np.full((5, 2), np.nan)])
    counted = tilt_by_lines(image, LENS, NOBODY)
    left_out = tilt_by_lines(image, LENS, person_xy)
    assert np.degrees(abs(counted.roll)) > 8.0
    assert abs(left_out.roll) < 2 * left_out.deviations[1]
