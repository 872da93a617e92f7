"""Settings of smoothing: what lasts counts by the second, not by the sample."""

import numpy as np
import pytest

from jaxmocap.smoothing.settings import LASTING_HZ, SmoothingSettings, weigh_by_time

STATED = SmoothingSettings()


@pytest.mark.parametrize("rate", [25, 60, 300])
def test_a_second_of_what_is_usual_weighs_the_same_however_often_was_measured(rate):
    weighed = weigh_by_time(STATED, np.arange(10) / rate)
    for name in ("ease", "bearing"):
        stated, deviation = (float(getattr(s.posture, name)) for s in (STATED, weighed))
        assert rate / deviation**2 == pytest.approx(LASTING_HZ / stated**2, rel=1e-5)
    assert float(weighed.pelvis.lean) == pytest.approx(
        float(STATED.pelvis.lean) * np.sqrt(rate / LASTING_HZ), rel=1e-5
    )
    # A slope is no deviation.
    assert weighed.posture.hips == STATED.posture.hips
    # What was measured counts in each sample.
    assert float(weighed.markers.deviation) == float(STATED.markers.deviation)
    assert float(weighed.silhouettes.deviation) == float(STATED.silhouettes.deviation)


def test_a_gap_is_no_slower_rate():
    """Nor are a frame and a sample that nearly coincide a faster one."""
    of_samples, of_frames = np.arange(900) / 90, np.arange(300) / 30 + 1e-4
    both = np.sort(np.concatenate([of_samples, of_frames]))
    later = np.concatenate([both, both + 600])
    expected = float(STATED.posture.ease) * np.sqrt(120 / LASTING_HZ)
    for times in (both, later):
        assert float(weigh_by_time(STATED, times).posture.ease) == pytest.approx(expected, rel=0.02)


def test_one_event_counts_as_it_is():
    assert weigh_by_time(STATED, np.zeros(1)) is STATED
