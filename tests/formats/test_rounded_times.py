"""Times that a file rounds to a millisecond: every reader of them finds the true rate."""

import numpy as np
import pytest

from jaxmocap.evaluation.series import match, sample_step
from jaxmocap.formats.convert import convert_file
from jaxmocap.formats.time_series.c3d import read_c3d
from jaxmocap.formats.time_series.tables import is_even, usual_step
from jaxmocap.formats.time_series.trc import read_trc, write_trc


def rounded(rate: float, count: int = 600) -> np.ndarray:
    return np.round(12.34 + np.arange(count) / rate, 3)


@pytest.mark.parametrize("rate", [25.0, 30.0, 59.94, 60.0, 90.0, 119.88, 120.0, 144.0, 240.0])
def test_a_rate_in_whole_milliseconds_is_the_true_one(rate):
    assert 1 / usual_step(rounded(rate)) == pytest.approx(rate, rel=1e-3)
    assert sample_step(rounded(rate)) == usual_step(rounded(rate))
    assert is_even(rounded(rate))
    # A sample that is not there is one, and an unsteady clock is unsteady.
    assert not is_even(np.delete(rounded(rate), 100))
    noise = np.random.default_rng(0).uniform(-0.3, 0.3, 600) / rate
    assert not is_even(12.34 + np.arange(600) / rate + noise)


def test_steps_that_differ_are_not_taken_for_one_another():
    # 500 Hz with a fifth of the samples missing.
    times = np.delete(np.arange(1000) * 2e-3, np.arange(3, 1000, 5))
    assert usual_step(times) == pytest.approx(2e-3) and not is_even(times)


def test_a_converted_file_states_the_true_rate(tmp_path):
    points = {"A": np.ones((600, 3))}
    write_trc(tmp_path / "a.trc", rounded(120.0), points)
    assert read_trc(tmp_path / "a.trc").rate == pytest.approx(120.0, abs=0.02)
    convert_file(tmp_path / "a.trc", tmp_path / "a.c3d")
    times = read_c3d(tmp_path / "a.c3d").times
    np.testing.assert_allclose(np.diff(times), 1 / 120.0, rtol=1e-6)


def test_two_single_samples_are_a_pair_at_one_time_only():
    assert [len(part) for part in match(np.array([1.0]), np.array([1.0005]))] == [1, 1]
    assert [len(part) for part in match(np.array([0.0]), np.array([100.0]))] == [0, 0]
