"""The benchmarks' measures of a tracker: acceleration, lag, wrong turns, interval coverage."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.evaluation import compare_tracks, lag, resampled_by_spline, wrong_turns
from jaxmocap.evaluation.errors import interval_coverage
from jaxmocap.evaluation.series import second_difference

TIMES = np.arange(540) / 90


def swing(times: np.ndarray) -> np.ndarray:
    """(T, 3) a smooth movement that never repeats within six seconds, metres."""
    t = np.asarray(times)[..., None]
    return 0.2 * np.sin(t * [3.0, 2.2, 4.1] + [0, 1, 2]) + 0.1 * np.sin(t * [7.3, 5.9, 6.7])


def calm_of(track: np.ndarray, times: np.ndarray = TIMES):
    return compare_tracks(times, track[:, None], TIMES, swing(TIMES)[:, None])


def test_a_circle_accelerates_by_its_radius_times_the_square_of_its_rate():
    turn = 2 * np.pi * TIMES
    circle = 0.3 * np.stack([np.cos(turn), np.sin(turn), 0 * turn], -1)
    size = np.linalg.norm(second_difference(TIMES, circle), axis=-1)
    np.testing.assert_allclose(size, 0.3 * (2 * np.pi) ** 2, rtol=1e-3)


@given(st.floats(-0.2, 0.2))
def test_a_delay_is_found_to_a_tenth_of_a_sample(delay):
    actual, likeness = lag(TIMES, swing(TIMES - delay), TIMES, swing(TIMES))
    assert actual == pytest.approx(delay, abs=0.1 / 90)
    assert likeness > 0.99


def test_a_reference_of_another_rate_is_matched_by_time():
    times = 0.4 + np.arange(200) / 60
    calm = calm_of(swing(times - 0.05), times)
    assert calm.worst_lag == pytest.approx(0.05, abs=0.001)
    assert calm.ratio == pytest.approx(1.0, abs=0.15)
    same = calm_of(swing(times), times)
    assert same.ratio == pytest.approx(1.0, abs=1e-3)


def test_white_noise_on_top_adds_its_own_acceleration():
    noise = np.random.default_rng(0).normal(scale=1e-3, size=(len(TIMES), 3))
    calm = calm_of(swing(TIMES) + noise)
    # Second differences of white noise have six times its variance, on each of three axes.
    added = np.sqrt(18) * 1e-3 * 90**2
    assert calm.track[0] == pytest.approx(np.hypot(calm.reference[0], added), rel=0.05)
    assert calm.ratio > 4


def test_a_frozen_joint_is_not_calm():
    frozen = np.broadcast_to(swing(TIMES[:1]), (len(TIMES), 3))
    calm = calm_of(frozen)
    assert calm.ratio == pytest.approx(0.0, abs=1e-9)
    assert np.isnan(calm.worst_lag)


def test_a_joint_that_moves_otherwise_has_no_lag():
    other = np.random.default_rng(0).normal(size=(len(TIMES), 3)).cumsum(0)
    actual, likeness = lag(TIMES, other, TIMES, swing(TIMES))
    assert np.isnan(actual) and likeness < 0.5


def test_missing_samples_are_left_out_of_both_accelerations():
    track = swing(TIMES)
    track[200:300] = np.nan
    calm = calm_of(track)
    assert calm.ratio == pytest.approx(1.0, abs=1e-9)
    nothing = calm_of(np.full((len(TIMES), 3), np.nan))
    assert np.isnan(nothing.ratio) and np.isnan(nothing.worst_lag)


def test_resampling_meets_the_samples_and_leaves_gaps_missing():
    values = swing(TIMES)
    np.testing.assert_allclose(resampled_by_spline(TIMES, values, TIMES), values, atol=1e-12)
    between = TIMES[:-1] + 0.004
    np.testing.assert_allclose(
        resampled_by_spline(TIMES, values, between), swing(between), atol=1e-4
    )
    values[50:60] = np.nan
    actual = resampled_by_spline(TIMES, values, between)
    assert np.isnan(actual[49:60]).all() and np.isfinite(actual[:49]).all()
    assert np.isnan(resampled_by_spline(TIMES, values, np.array([-0.1, 6.2]))).all()
    assert np.isnan(resampled_by_spline(TIMES[:1], values[:1], TIMES)).all()


def errors_of(*stretches: tuple[int, int], worse_by: float = 0.06) -> np.ndarray:
    """(540, 1) errors of 10 cm, larger from the first to before the second of some samples."""
    video = np.full((len(TIMES), 1), 0.1)
    for start, end in stretches:
        video[start:end] += worse_by
    return video


def test_wrong_turns_are_counted_and_the_longest_is_timed():
    turns = wrong_turns(TIMES, errors_of(), errors_of((10, 19), (100, 118)))
    assert turns.share[0] == pytest.approx(27 / 540)
    assert turns.longest[0] == pytest.approx(0.2)


def test_a_wrong_turn_lasts_through_unknown_samples_and_to_the_end():
    video = errors_of((10, 28), (531, 540))
    video[15:20] = np.nan
    turns = wrong_turns(TIMES, errors_of(), video)
    assert turns.longest[0] == pytest.approx(0.2)
    assert turns.share[0] == pytest.approx(22 / 535)
    tail = wrong_turns(TIMES, errors_of(), errors_of((531, 540)))
    assert tail.longest[0] == pytest.approx(0.1)


def test_each_elbow_turns_by_itself():
    video = np.concatenate([errors_of((0, 54)), errors_of(), np.full((540, 1), np.nan)], 1)
    turns = wrong_turns(TIMES, np.tile(errors_of(), 3), video)
    np.testing.assert_allclose(turns.share, [0.1, 0.0, np.nan])
    np.testing.assert_allclose(turns.longest, [0.6, 0.0, 0.0])


@given(st.floats(0.5, 2.0))
def test_right_deviations_cover_their_share_and_others_do_not(scale):
    rng = np.random.default_rng(0)
    deviation = scale * np.array([0.01, 0.03, 0.1])
    stated = np.broadcast_to(deviation, (20_000, 3))
    actual = interval_coverage(rng.normal(scale=stated), stated)
    np.testing.assert_allclose(actual.share, 0.9, atol=0.01)
    np.testing.assert_allclose(actual.ratio, 1.0, atol=0.03)
    half = interval_coverage(rng.normal(scale=2 * stated), stated)
    assert (half.share < 0.62).all()
    np.testing.assert_allclose(half.ratio, 0.5, atol=0.02)


def test_coverage_keeps_landmarks_and_coordinates_apart_and_leaves_out_the_unknown():
    deviation = np.full((100, 2, 3), 0.01)
    error = np.full((100, 2, 3), 0.005)
    error[:30, 0, 2] = 1.0
    error[:, 1, 0] = np.nan
    error[:50, 1, 1] = np.nan
    actual = interval_coverage(error, deviation)
    np.testing.assert_allclose(actual.share, [[1, 1, 0.7], [np.nan, 1, 1]])
    np.testing.assert_array_equal(actual.samples, [[100, 100, 100], [0, 50, 100]])
    np.testing.assert_allclose(actual.ratio[1], [np.nan, 2.0, 2.0])
