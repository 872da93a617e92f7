"""Filters of markers: each next to an independent oracle; zero phase; NaN where it belongs."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from conftest import complaint
from hypothesis import given
from hypothesis import strategies as st
from played_markers import played
from small_recording import SAMPLES, small_recording, with_outlier_and_gap

from jaxmocap.capture import filters
from jaxmocap.capture.filters import (
    butterworth_low_pass,
    fill_gaps,
    filter_markers,
    filter_one_euro,
    find_outliers,
)
from jaxmocap.capture.one_euro import FORGET_AFTER_S, SPEED_CUTOFF_HZ, filter_step, initial_state
from jaxmocap.formats.recordings.filters import Filters, OneEuroSettings
from jaxmocap.formats.recordings.recording import Recording, load_recording
from jaxmocap.formats.time_series.markers import read_markers
from jaxmocap.formats.time_series.trc import write_trc

RATE = 90.0
SIX_HZ = 6.0


def one(path: np.ndarray) -> np.ndarray:
    """A path (T,) as the x of one marker (T, 1, 3)."""
    return np.stack([path, 0 * path, 0 * path], -1)[:, None]


# Hampel ------------------------------------------------------------------------------------------


def hampel_by_hand(path: np.ndarray, half: int) -> list[bool]:
    """Hampel's identifier of one coordinate, sample by sample."""
    actual = []
    for i, value in enumerate(path):
        window = sorted(v for v in path[max(0, i - half) : i + half + 1] if v == v)
        if value != value:
            actual.append(False)
            continue
        n = len(window)
        middle = (window[(n - 1) // 2] + window[n // 2]) / 2
        away = sorted(abs(v - middle) for v in window)
        spread = 1.4826 * (away[(n - 1) // 2] + away[n // 2]) / 2
        actual.append(abs(value - middle) > max(3 * spread, 0.02))
    return actual


@given(st.integers(0, 10_000))
def test_outliers_are_those_of_hampels_definition(seed):
    rng = np.random.default_rng(seed)
    path = np.cumsum(rng.normal(0, 0.01, 60))
    path[rng.random(60) < 0.1] += 0.3
    path[rng.random(60) < 0.2] = np.nan
    actual = find_outliers(np.arange(60) / 60, one(path))
    assert actual[:, 0].tolist() == hampel_by_hand(path, 3)


def test_the_window_is_a_twentieth_of_a_second_at_high_rates():
    path = np.zeros(400)
    path[200:209] = 1.0
    assert find_outliers(np.arange(400) / 200, one(path)).sum() == 9
    assert find_outliers(np.arange(400) / 60, one(path)).sum() == 0


@pytest.mark.parametrize("seed", range(4))
def test_no_stroke_is_an_outlier_and_most_jumps_are(seed):
    times, points = played(seed)
    assert not find_outliers(times, points).any()
    rng = np.random.default_rng(seed)
    rows = rng.choice(len(times), 25, replace=False)
    points[rows, 2] += rng.choice([-0.3, 0.3], (25, 3))
    actual = find_outliers(times, points)
    assert actual[rows, 2].mean() > 0.85 and actual.sum() == actual[rows, 2].sum()


def test_real_recordings_have_hardly_an_outlier(recordings):
    balancing = read_markers(recordings / "balancing" / "truth.trc")
    assert not find_outliers(balancing.times, balancing.positions).any()
    serve = read_markers(recordings / "motions" / "tennis_serve.c3d")
    assert find_outliers(serve.times, serve.positions).sum() <= 2


# Gaps --------------------------------------------------------------------------------------------


@given(st.integers(0, 10_000), st.integers(1, 9))
def test_a_gap_in_a_thrown_balls_path_is_filled_exactly(seed, length):
    times = np.arange(40) / RATE
    a, v, x = np.random.default_rng(seed).normal(0, 3, (3, 1, 3))
    path = (x + v * times[:, None] + a * times[:, None] ** 2)[:, None]
    broken = path.copy()
    broken[15 : 15 + length] = np.nan
    filled = fill_gaps(times, broken, length / RATE)
    np.testing.assert_allclose(filled, path, atol=1e-9)
    np.testing.assert_array_equal(fill_gaps(times, broken, (length - 0.5) / RATE), broken)


def test_only_the_gaps_that_are_short_enough_are_filled():
    times, points = played(0, 2.0)
    points[:4, 0] = np.nan
    points[30:39, 0] = np.nan
    points[60:70, 0] = np.nan
    points[-3:, 0] = np.nan
    filled = fill_gaps(times, points, 0.1)
    missing = np.flatnonzero(np.isnan(filled[:, 0, 0]))
    expected = [*range(4), *range(60, 70), *range(177, 180)]
    assert missing.tolist() == expected, "nine samples are 0.1 s, ten are more"
    np.testing.assert_array_equal(filled[:, 1:], points[:, 1:])


def test_next_to_single_samples_a_gap_is_a_straight_line():
    path = np.array([np.nan, 1.0, np.nan, 3.0, np.nan, np.nan])
    filled = fill_gaps(np.arange(6) / 10, one(path), 0.2)[:, 0, 0]
    np.testing.assert_allclose(filled, [np.nan, 1, 2, 3, np.nan, np.nan])


def test_a_tenth_of_a_second_of_a_stroke_is_filled_to_millimetres():
    errors = []
    for seed in range(4):
        times, points = played(seed)
        for start in range(40, 500, 45):
            broken = points.copy()
            broken[start : start + 9, 2] = np.nan
            filled = fill_gaps(times, broken, 0.1)
            errors.append(np.linalg.norm(filled - points, axis=-1)[start : start + 9, 2])
    assert np.mean(errors) < 0.005 and np.percentile(errors, 95) < 0.01


# Butterworth -------------------------------------------------------------------------------------


def gain(frequency: float, cutoff: float, rate: float) -> float:
    """What two passes of the second-order filter let through, by the bilinear transform."""
    pass_cutoff = cutoff / (np.sqrt(2) - 1) ** 0.25
    warped = np.tan(np.pi * frequency / rate) / np.tan(np.pi * pass_cutoff / rate)
    return 1 / (1 + warped**4)


@pytest.mark.parametrize("frequency", [1.0, 4.0, 6.0, 9.0, 20.0])
def test_the_low_pass_has_butterworths_gain_and_no_delay(frequency):
    times = np.arange(2000) / RATE
    wave = np.sin(2 * np.pi * frequency * times)
    passed = butterworth_low_pass(times, one(wave), SIX_HZ)[:, 0, 0]
    inside = slice(300, -300)
    expected = gain(frequency, SIX_HZ, RATE)
    np.testing.assert_allclose(passed[inside], expected * wave[inside], atol=2e-3)
    if frequency == SIX_HZ:
        assert expected == pytest.approx(1 / np.sqrt(2), abs=0.01)


@given(st.integers(0, 10_000))
def test_the_low_pass_has_no_direction_in_time(seed):
    times = np.arange(200) / RATE
    path = one(np.cumsum(np.random.default_rng(seed).normal(0, 0.01, 200)))
    forward = butterworth_low_pass(times, path, 10.0)
    backward = butterworth_low_pass(times, path[::-1], 10.0)[::-1]
    np.testing.assert_allclose(forward[40:-40], backward[40:-40], atol=1e-4)


def test_runs_between_gaps_are_filtered_by_themselves():
    times, points = played(1, 3.0)
    points[100:130, 1] = np.nan
    points[140, 1] = np.nan
    passed = butterworth_low_pass(times, points, 13.0)
    assert np.isnan(passed[100:130, 1]).all() and np.isnan(passed).sum() == 31 * 3
    for run in (slice(0, 100), slice(130, 140), slice(141, None)):
        alone = butterworth_low_pass(times[run], points[run], 13.0)
        np.testing.assert_allclose(passed[run, 1], alone[:, 1])
    late = np.concatenate([times[:50], times[50:] + 1.0])
    np.testing.assert_allclose(
        butterworth_low_pass(late, points, 13.0)[:50],
        butterworth_low_pass(times[:50], points[:50], 13.0),
    )


def test_the_gait_labs_six_hertz_flatten_a_serve_and_the_default_does_not(recordings):
    serve = read_markers(recordings / "motions" / "tennis_serve.c3d")
    hand = [serve.names.index("RFIN")]

    def fastest(positions: np.ndarray) -> float:
        velocity = np.gradient(positions[:, 0], serve.times, axis=0)
        return float(np.linalg.norm(velocity, axis=-1).max())

    path = serve.positions[:, hand]
    assert fastest(butterworth_low_pass(serve.times, path, SIX_HZ)) < 0.96 * fastest(path)
    assert fastest(butterworth_low_pass(serve.times, path, 15.0)) > 0.995 * fastest(path)
    recording = replace(small_recording(), times=serve.times[:SAMPLES])
    after, cleaning = filter_markers(recording)
    np.testing.assert_array_equal(after.positions_world, recording.positions_world)
    assert cleaning.figures() == {"on": {}}


# One Euro ----------------------------------------------------------------------------------------


class Published:
    """The filter as its authors published it, for one number, with exact time steps."""

    def __init__(self, mincutoff: float, beta: float, dcutoff: float):
        self.mincutoff, self.beta, self.dcutoff = mincutoff, beta, dcutoff
        self.last: tuple[float, float, float] | None = None

    def __call__(self, t: float, x: float) -> float:
        if self.last is None:
            self.last = (t, x, 0.0)
            return x
        before, x_before, dx_before = self.last
        te = t - before
        dx = (x - x_before) / te
        edx = self.alpha(self.dcutoff, te) * dx + (1 - self.alpha(self.dcutoff, te)) * dx_before
        a = self.alpha(self.mincutoff + self.beta * abs(edx), te)
        self.last = (t, a * x + (1 - a) * x_before, edx)
        return self.last[1]

    @staticmethod
    def alpha(cutoff: float, te: float) -> float:
        return 1.0 / (1.0 + (1.0 / (2 * np.pi * cutoff)) / te)


@given(st.integers(0, 10_000), st.floats(0.5, 10), st.floats(0.5, 100))
def test_along_one_axis_it_is_the_published_filter(seed, cutoff, beta):
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.uniform(0.005, 0.03, 50))
    path = np.cumsum(rng.normal(0, 0.02, 50))
    ours = filter_one_euro(times, one(path), OneEuroSettings(cutoff, beta))[:, 0, 0]
    theirs = Published(cutoff, beta, SPEED_CUTOFF_HZ)
    expected = [theirs(t, x) for t, x in zip(times, path, strict=True)]
    np.testing.assert_allclose(ours, expected, atol=1e-12)


@given(st.integers(0, 10_000))
def test_it_does_not_depend_on_the_axes(seed):
    rng = np.random.default_rng(seed)
    times, points = np.arange(40) / RATE, np.cumsum(rng.normal(0, 0.01, (40, 2, 3)), 0)
    R = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    rotated = filter_one_euro(times, points @ R.T, OneEuroSettings())
    np.testing.assert_allclose(
        rotated, filter_one_euro(times, points, OneEuroSettings()) @ R.T, atol=1e-12
    )


def test_a_marker_that_was_lost_for_long_begins_anew_and_for_short_goes_on():
    step, still = partial(filter_step, OneEuroSettings()), np.zeros((1, 3))
    state, _ = step(initial_state(1), 0.0, still)
    state, lost = step(state, 0.01, np.full((1, 3), np.nan))
    assert np.isnan(lost).all()
    _, soon = step(state, 0.02, still + 0.01)
    assert (np.abs(soon) < 0.01).all()
    _, later = step(state, 2 * FORGET_AFTER_S, still + 0.01)
    np.testing.assert_array_equal(later, still + 0.01)
    _, again = step(state, 0.0, still + 0.01)
    np.testing.assert_array_equal(again, still + 0.01)


def test_it_calms_a_hand_at_rest_and_hardly_delays_a_stroke():
    rng = np.random.default_rng(0)
    rest = rng.normal(0, 0.001, (540, 1, 3))
    times, points = played(2)
    assert filter_one_euro(times, rest, OneEuroSettings())[90:].std() < 0.5 * rest.std()
    behind = np.linalg.norm(filter_one_euro(times, points, OneEuroSettings()) - points, axis=-1)
    assert np.percentile(behind, 99) < 0.005


# In a recording ----------------------------------------------------------------------------------

FIELDS = '[markers]\nfile = "m.trc"\n[markers.on]\nHead = { bone = "head" }\n[markers.filters]\n'


def load(folder: Path, filters_text: str) -> Recording:
    write_trc(folder / "m.trc", np.arange(3) / 60, {"Head": np.ones((3, 3))})
    (folder / "r.toml").write_text(FIELDS + filters_text + "\n[subject]\nheight = 1.7\n")
    return load_recording(folder / "r.toml")


def test_a_recording_names_its_filters(tmp_path):
    assert load(tmp_path, "").filters == Filters()
    text = "hampel = true\ngaps = 0.1\nbutterworth = 12\none_euro = { beta = 20.0 }"
    expected = Filters(True, 0.1, 12.0, OneEuroSettings(beta=20.0))
    assert load(tmp_path, text).filters == expected
    assert load(tmp_path, "one_euro = true").filters.one_euro == OneEuroSettings()
    assert load(tmp_path, "one_euro = false\nhampel = false").filters == Filters()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("hampel = 3", " hampel: found 3, expected true or false"),
        ("gaps = -0.1", " gaps: found -0.1, expected a positive number"),
        ("butterworth = 0", " butterworth: found 0, expected a positive number"),
        ("one_euro = 4.0", " one_euro: found 4.0, expected a table"),
        ("one_euro = { dcutoff = 1.0 }", " one_euro: unknown key 'dcutoff', expected cutoff, beta"),
        ("median = true", ": unknown key 'median', expected hampel, gaps, butterworth, one_euro"),
    ],
)
def test_a_field_that_does_not_fit_is_refused(tmp_path, text, message):
    assert f"[markers.filters]{message}" in complaint(load, tmp_path, text)


def test_a_cut_off_that_the_samples_cannot_hold_is_refused():
    recording = replace(small_recording(), filters=Filters(butterworth=25.0))
    says = "butterworth: found 25 Hz, expected less than 24.1 Hz"
    assert says in complaint(filter_markers, recording)


def spoilt() -> Recording:
    """The small recording with an outlier, a short gap and a long one."""
    recording = with_outlier_and_gap()
    recording.positions_world[12:20, 0] = np.nan
    return recording


def test_filters_work_one_after_the_other_and_say_what_they_did():
    recording = spoilt()
    after, cleaning = filter_markers(replace(recording, filters=Filters(True, 0.06, 12.0)))
    clean = small_recording().positions_world
    assert cleaning.outliers.sum() == 1 and cleaning.outliers[5, 1]
    assert cleaning.filled.sum() == 4 and cleaning.missing.sum() == 8
    is_present = ~cleaning.missing
    assert np.abs(after.positions_world - clean)[is_present].max() < 0.002
    assert cleaning.figures()["on"] == {"hampel": True, "gaps": 0.06, "butterworth": 12.0}
    assert cleaning.figures()["samples"]["LWrist"] == {
        "frozen": 0,
        "outliers": 1,
        "filled": 1,
        "missing": 0,
    }
    assert cleaning.statuses(5) == ("marker LWrist was an outlier", "marker LWrist was filled in")
    assert cleaning.statuses(0) == () == cleaning.warnings
    assert after.filters == Filters(), "nothing is filtered twice"


def test_what_looks_ahead_is_left_out_where_nothing_later_may_be_used():
    wanted = Filters(True, 0.1, 12.0, OneEuroSettings())
    recording = replace(spoilt(), filters=wanted)
    after, cleaning = filter_markers(recording, causal=True)
    assert list(cleaning.applied) == ["one_euro"]
    assert "hampel, gaps, butterworth: not used, look ahead" in cleaning.warnings[0]
    cut = replace(
        recording, times=recording.times[:9], positions_world=recording.positions_world[:9]
    )
    np.testing.assert_array_equal(
        filter_markers(cut, causal=True)[0].positions_world, after.positions_world[:9]
    )
    _, cleaning = filter_markers(recording)
    assert "one_euro: not used, is for live and --causal" in cleaning.warnings[0]


def test_unevenly_spaced_samples_are_told(monkeypatch):
    recording = replace(small_recording(), filters=Filters(butterworth=10.0))
    times = recording.times + np.random.default_rng(0).uniform(0, 0.004, SAMPLES)
    _, cleaning = filter_markers(replace(recording, times=times))
    assert "unevenly spaced" in cleaning.warnings[0]
    monkeypatch.setattr(filters, "is_even", lambda _: True)
    assert filter_markers(replace(recording, times=times))[1].warnings == ()
