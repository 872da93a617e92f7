"""How noisy markers are, by themselves."""

import numpy as np
import pytest
from played_markers import played

from jaxmocap.evidence.markers import MarkerPositions, measured_noise
from jaxmocap.formats.time_series.markers import read_markers
from jaxmocap.smoothing.settings import SmoothingSettings, allow_for_noise


def shaken(rate: float, noise: float) -> tuple[np.ndarray, np.ndarray]:
    """Times and the head and wrists of a table-tennis player, with white noise, metres."""
    times, points = played(0, rate=rate, noise=False)
    return times, points + np.random.default_rng(0).normal(0, noise, points.shape)


@pytest.mark.parametrize("rate", [30.0, 90.0, 240.0])
@pytest.mark.parametrize("noise", [0.002, 0.01, 0.03])
def test_noise_shows_beside_the_strokes_of_a_player(rate, noise):
    assert measured_noise(*shaken(rate, noise)) == pytest.approx(noise, rel=0.12)


def test_strokes_alone_are_no_noise():
    for rate, most in ((30.0, 5e-4), (90.0, 1e-5)):
        assert measured_noise(*shaken(rate, 0.0)) < most


def test_samples_that_are_missing_or_come_late_take_no_part():
    times, points = shaken(90.0, 0.01)
    rng = np.random.default_rng(1)
    points[rng.random(points.shape[:2]) < 0.03] = np.nan
    assert measured_noise(times, points) == pytest.approx(0.01, rel=0.15)
    kept = np.sort(rng.choice(len(times), 500, replace=False))
    assert measured_noise(times[kept], points[kept]) == pytest.approx(0.01, rel=0.25)


@pytest.mark.parametrize("count", [0, 1, 6, 12])
def test_of_a_few_samples_it_is_unclear(count):
    times, points = shaken(90.0, 0.01)
    assert measured_noise(times[:count], points[:count]) == 0
    assert measured_noise(times, np.full_like(points, np.nan)) == 0


def test_one_noisy_marker_of_three_counts_for_a_third():
    times, points = shaken(90.0, 0.0)
    points[:, 1] += np.random.default_rng(0).normal(0, 0.03, points[:, 1].shape)
    assert measured_noise(times, points) == pytest.approx(0.03 / 3**0.5, rel=0.12)


def test_real_markers_are_less_noisy_than_what_is_allowed_for(recordings):
    files = [recordings / "motions" / "tennis_serve.c3d", recordings / "balancing" / "markers.trc"]
    files += sorted((recordings / "people").glob("person_*/*.trc"))
    for file in files:
        markers = read_markers(file)
        assert measured_noise(markers.times, markers.positions) < 0.001, file


def test_settings_allow_for_noise_from_what_they_state_on():
    stated = SmoothingSettings()
    assert allow_for_noise(stated, 0.003) is stated
    noisy = allow_for_noise(stated, 0.02)
    assert float(noisy.markers.deviation) == pytest.approx(0.02)
    assert noisy.markers.deviation.dtype == stated.markers.deviation.dtype
    assert float(MarkerPositions().deviation) == pytest.approx(0.004)
