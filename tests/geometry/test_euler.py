"""Euler angles over time: the rotations that they make, their steps, and their ranges."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from jaxmocap.geometry.euler import FREE, continuous_euler, ease_near_lock

# OpenSim's shoulder: flexion, adduction, rotation.
SHOULDER = ((-90, 90), (-120, 90), (-90, 90))
RATE = 50.0


def rotations(angles_deg: np.ndarray, order: str = "ZXY") -> np.ndarray:
    return Rotation.from_euler(order, angles_deg, degrees=True).as_matrix()


def angles_of(R: np.ndarray, order: str = "ZXY", ranges=SHOULDER) -> np.ndarray:
    """Angles (T, 3), degrees, of one joint's (T, 3, 3); they make the same rotations."""
    times = np.arange(len(R)) / RATE
    angles = continuous_euler(R[:, None], order, np.radians([ranges]), times)[:, 0]
    np.testing.assert_allclose(rotations(np.degrees(angles), order), R, atol=3e-6)
    return np.degrees(angles)


def swinging(seed: int, least: tuple, most: tuple, seconds: float = 2.0) -> np.ndarray:
    """Angles (T, 3) that swing smoothly through all of their ranges, degrees."""
    rng = np.random.default_rng(seed)
    t = np.arange(0, seconds, 1 / RATE)[:, None]
    waves = np.sin(rng.uniform(1, 4, 3) * t + rng.uniform(0, 6, 3))
    low, high = np.array(least), np.array(most)
    return low + (high - low) * (0.5 + 0.5 * waves)


@given(st.integers(0, 10**6))
def test_a_smooth_motion_within_the_ranges_keeps_its_angles_through_the_singularity(seed):
    """An arm raised beyond level passes -90 degrees of adduction, where flexion is undetermined."""
    expected = swinging(seed, (-85, -115, -85), (85, 85, 85))
    np.testing.assert_allclose(angles_of(rotations(expected)), expected, atol=1e-3)


@given(st.integers(0, 10**6))
def test_no_angle_is_a_turn_away_from_its_range_whatever_the_motion(seed):
    rng = np.random.default_rng(seed)
    path = np.cumsum(rng.normal(size=(200, 3)) * rng.uniform(1, 40), 0)
    actual, (low, high) = angles_of(rotations(path)), np.array(SHOULDER).T
    assert (np.maximum(low - actual, actual - high) < 360 - (high - low) / 2).all()


@pytest.mark.parametrize("turns", [1, 3, -2])
def test_an_arm_that_circles_does_not_gather_whole_turns(turns):
    hanging = np.zeros((50, 3))
    circling = np.linspace(0, 360 * turns, abs(turns) * 60)[:, None] * [1.0, 0.0, 0.0]
    actual = angles_of(rotations(np.concatenate([hanging, circling, hanging])))
    assert np.abs(actual[:50]).max() < 1e-3 and np.abs(actual[-50:]).max() < 1e-3
    assert np.abs(actual).max() < 300


def test_what_happens_later_does_not_turn_the_beginning():
    """A serve: arms that hang at first are near 0 there, however long they circle afterwards."""
    hanging = np.tile([-3.5, -10.9, 42.7], (40, 1))
    overhead = np.tile([176.5, -169.1 + 360, 222.7 - 360], (400, 1)) + swinging(
        3, (-30, -30, -30), (30, 30, 30), 8.0
    )
    actual = angles_of(rotations(np.concatenate([hanging, overhead])))
    np.testing.assert_allclose(actual[:40], hanging, atol=1e-3)


def test_a_free_angle_goes_on_past_half_a_turn():
    turning = np.linspace(0, 900, 200)[:, None] * [0.0, 0.0, 1.0]
    ranges = (FREE, (-90, 90), FREE)
    np.testing.assert_allclose(angles_of(rotations(turning), ranges=ranges), turning, atol=1e-6)


def test_in_gimbal_lock_the_first_angle_goes_evenly_to_what_it_will_be():
    before = np.array([[10.0, -80.0, 0.0], [10.0, -85.0, 0.0]])
    locked = np.tile([0.0, -90.0, 30.0], (3, 1))
    after = np.array([[50.0, -85.0, 0.0], [50.0, -80.0, 0.0]])
    actual = angles_of(rotations(np.concatenate([before, locked, after])))
    np.testing.assert_allclose(actual[1:6, 0], [10, 20, 30, 40, 50], atol=1e-3)


def test_missing_samples_are_passed_over():
    expected = swinging(7, (-85, -80, -85), (85, 80, 85))
    R = rotations(expected)
    R[30:35] = np.nan
    actual = np.degrees(continuous_euler(R[:, None], "ZXY", np.radians([SHOULDER]))[:, 0])
    assert np.isnan(actual[30:35]).all()
    there = np.r_[0:30, 35 : len(R)]
    np.testing.assert_allclose(actual[there], expected[there], atol=1e-3)


@pytest.mark.parametrize("order", ["ZXY", "YXY", "ZYX"])
@pytest.mark.parametrize("side", [-1, 1])
def test_an_arm_that_passes_lock_three_degrees_aside_steps_by_sixty_at_most(order, side):
    """A stroke of 4 degrees a sample; the rotation errs by less than a degree, and only there."""
    first, middle = (np.eye(3)["XYZ".index(axis)] for axis in order[:2])
    lock = 0.0 if order[0] == order[2] else np.pi / 2 * side
    aside = Rotation.from_rotvec(np.radians(3.2) * np.cross(first, middle))
    swing = Rotation.from_rotvec(np.radians(np.arange(-80, 80, 4.1))[:, None] * middle)
    R = (swing * aside * Rotation.from_rotvec(lock * middle)).as_matrix()
    angles = continuous_euler(R[:, None], order)
    eased = ease_near_lock(angles.copy(), order)[:, 0]
    assert np.degrees(np.abs(np.diff(angles[:, 0], axis=0))).max() > 60
    assert np.degrees(np.abs(np.diff(eased, axis=0))).max() < 60
    error = np.degrees(
        (Rotation.from_matrix(R).inv() * Rotation.from_euler(order, eased)).magnitude()
    )
    assert error.max() < 1
    assert error[np.abs(np.arange(-80, 80, 4.1)) > 16].max() < 1e-3
