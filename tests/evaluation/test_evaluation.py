"""Errors against a reference: what the figures mean, and what bad input is answered."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from conftest import complaint
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxmocap.evaluation.errors import Errors, evaluate_directory, position_errors
from jaxmocap.evaluation.plots import plot_elbow_errors
from jaxmocap.evaluation.reliability import (
    by_joint,
    plot_reliability,
    reliability_curve,
    risk_curve,
    stated_and_found,
)
from jaxmocap.evaluation.series import high_pass, match
from jaxmocap.evaluation.tables import format_table
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.time_series.trc import write_trc

TIMES = np.arange(120) / 60


def circle(times: np.ndarray) -> np.ndarray:
    """(T, 3) a point that circles at 1 Hz, radius 0.3 m, 1.2 m above the ground."""
    turn = 2 * np.pi * times
    return np.stack([0.3 * np.cos(turn), 0.3 * np.sin(turn), np.full_like(times, 1.2)], -1)


def shifted_by(offset: np.ndarray, times: np.ndarray = TIMES) -> Errors:
    joints = {"elbow_l": circle(times) + offset}
    return position_errors(times, joints, times, {"LElbow": circle(times)}, {"elbow_l": "LElbow"})


def test_a_constant_offset_is_the_whole_error_and_does_not_shake():
    errors = shifted_by(np.array([0.03, 0.0, 0.04]))
    figures = errors.statistics()
    for name in ("mean", "median", "p95", "rms"):
        np.testing.assert_allclose(figures[name], [0.05], atol=1e-12)
    assert figures["high_pass_rms"][0] < 1e-12
    assert figures["jitter"][0] < 1e-8
    assert errors.mean == pytest.approx(0.05)


def test_statistics_are_those_of_a_known_row_of_distances():
    offsets = np.zeros((101, 1, 3))
    offsets[:, 0, 1] = np.arange(101) / 100
    figures = Errors(("elbow_r",), np.arange(101) / 50, offsets).statistics()
    assert figures["mean"][0] == pytest.approx(0.5)
    assert figures["median"][0] == pytest.approx(0.5)
    assert figures["p95"][0] == pytest.approx(0.95)
    assert figures["rms"][0] == pytest.approx(np.sqrt(np.mean(np.linspace(0, 1, 101) ** 2)))


def test_a_millimetre_of_white_noise_at_60_hertz_shakes_by_fifteen_metres_per_second_squared():
    times = np.arange(6000) / 60
    noise = np.random.default_rng(0).normal(scale=1e-3, size=(6000, 3))
    assert shifted_by(noise, times).statistics()["jitter"][0] == pytest.approx(15.3, rel=0.03)


def test_jitter_leaves_out_differences_across_a_gap():
    times = np.concatenate([TIMES[:40], TIMES[80:]])
    ramp = 0.1 * times[:, None] * np.array([1.0, 0.0, 0.0])
    assert shifted_by(ramp, times).statistics()["jitter"][0] < 1e-8


def test_missing_samples_are_left_out_and_a_joint_without_data_has_no_figure():
    offsets = np.full((10, 2, 3), 0.1)
    offsets[3:5, 0] = np.nan
    offsets[:, 1] = np.nan
    errors = Errors(("elbow_l", "elbow_r"), np.arange(10) / 60, offsets)
    figures = errors.as_dict()
    assert figures["joints"]["elbow_l"]["samples"] == 8
    assert figures["joints"]["elbow_l"]["mean_m"] == pytest.approx(0.1 * np.sqrt(3))
    assert figures["joints"]["elbow_r"]["mean_m"] is None
    assert figures["mean_over_joints"]["mean_m"] == pytest.approx(0.1 * np.sqrt(3))
    assert json.loads(json.dumps(figures, allow_nan=False)) == figures


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.floats(0, 3), min_size=1, max_size=30, unique=True),
    st.lists(st.floats(0, 3), min_size=1, max_size=30, unique=True),
    st.floats(0.001, 0.5),
)
def test_matched_samples_are_near_and_each_the_others_nearest(first, second, tolerance):
    a, b = np.sort(first), np.sort(second)
    i, j = match(a, b, tolerance)
    gaps = np.abs(a[:, None] - b[None])
    assert (gaps[i, j] <= tolerance + 2e-6).all()
    assert (gaps[i, j] == gaps[i].min(1)).all()
    assert (gaps[i, j] == gaps[:, j].min(0)).all()
    assert len(set(i)) == len(i) and len(set(j)) == len(j)
    if gaps.min() <= tolerance:
        assert len(i)


def test_a_shifted_series_of_another_rate_is_matched_by_time_and_not_by_row():
    reference_times = 0.5 + np.arange(200) / 100
    errors = position_errors(
        TIMES,
        {"elbow_r": circle(TIMES)},
        reference_times,
        {"R": circle(reference_times)},
        {"elbow_r": "R"},
    )
    assert errors.times[0] == pytest.approx(0.5)
    # At 1.9 m/s half a sample of the finer series, 5 ms, is one centimetre.
    assert errors.distances.max() < 0.0095


def test_high_pass_keeps_fast_changes_and_drops_slow_ones():
    times = np.arange(60 * 60) / 60
    slow, fast = np.sin(2 * np.pi * 0.03 * times), np.sin(2 * np.pi * 3.0 * times)
    filtered = high_pass(times, 5 + slow + 0.2 * fast)
    inner = slice(300, -300)
    np.testing.assert_allclose(filtered[inner], 0.2 * fast[inner], atol=2e-3)


def test_high_pass_halves_the_amplitude_at_its_cut_off():
    times = np.arange(100 * 60) / 60
    wave = np.cos(2 * np.pi * 0.3 * times)
    inner = slice(300, -300)
    np.testing.assert_allclose(high_pass(times, wave)[inner], wave[inner] / 2, atol=1e-3)


def test_high_pass_bridges_gaps_and_leaves_them_missing():
    wave = np.sin(2 * np.pi * 2.0 * TIMES)
    wave[10:13] = np.nan
    filtered = high_pass(TIMES, wave)
    assert np.isnan(filtered[10:13]).all()
    assert np.isfinite(np.delete(filtered, [10, 11, 12])).all()


def write_directory(folder: Path, times: np.ndarray = TIMES) -> Path:
    write_trc(folder / "joints.trc", times, {"elbow_l": circle(times), "head": circle(times) + 0.4})
    return folder


def test_a_reference_with_y_up_is_turned_into_the_world(tmp_path):
    write_directory(tmp_path)
    # The file's axes are the world's y, z, x.
    write_trc(tmp_path / "truth.trc", TIMES, {"LElbow": circle(TIMES)[:, [1, 2, 0]]})
    errors = evaluate_directory(tmp_path, tmp_path / "truth.trc", {"elbow_l": "LElbow"}, up="y")
    assert errors.distances.max() < 2e-6
    turned = evaluate_directory(tmp_path, tmp_path / "truth.trc", {"elbow_l": "LElbow"})
    assert turned.distances.min() > 0.1


def test_without_pairs_joints_of_the_same_name_are_compared(tmp_path):
    write_directory(tmp_path)
    points = {"elbow_l": circle(TIMES) + np.array([0, 0, 0.02]), "Nose": circle(TIMES)}
    write_trc(tmp_path / "truth.trc", TIMES, points)
    errors = evaluate_directory(tmp_path, tmp_path / "truth.trc")
    assert errors.joints == ("elbow_l",)
    np.testing.assert_allclose(errors.distances, 0.02, atol=1e-5)
    write_trc(tmp_path / "other.trc", TIMES, {"Nose": circle(TIMES)})
    with pytest.raises(InputError, match=r"other\.trc: no joint of the same name; state --match"):
        evaluate_directory(tmp_path, tmp_path / "other.trc")


@pytest.mark.parametrize(
    ("pairs", "actual", "listed"),
    [
        ({"elbow": "LElbow"}, "elbow", "elbow_l, head"),
        ({"elbow_l": "LElbo"}, "LElbo", "LElbow"),
        ({}, "nothing", "elbow_r=RElbow"),
    ],
)
def test_an_unknown_name_is_reported_with_the_file_and_the_names_that_are_there(
    tmp_path, pairs, actual, listed
):
    write_directory(tmp_path)
    write_trc(tmp_path / "truth.trc", TIMES, {"LElbow": circle(TIMES)})
    message = complaint(evaluate_directory, tmp_path, tmp_path / "truth.trc", pairs)
    assert actual in message and listed in message and ".trc" in message


def test_no_common_time_is_an_input_error_with_both_spans(tmp_path):
    write_directory(tmp_path)
    write_trc(tmp_path / "truth.trc", TIMES + 100, {"LElbow": circle(TIMES)})
    with pytest.raises(InputError, match=r"0\.000 to 1\.983 s .* 100\.000 to 101\.983 s"):
        evaluate_directory(tmp_path, tmp_path / "truth.trc", {"elbow_l": "LElbow"})


def test_a_file_in_place_of_its_folder_is_evaluated(tmp_path):
    write_trc(tmp_path / "joints.trc", TIMES, {"LElbow": circle(TIMES)})
    (tmp_path / "motion.npz").write_bytes(b"no motion")
    errors = evaluate_directory(tmp_path / "joints.trc", tmp_path / "joints.trc")
    assert errors.joints == ("LElbow",) and errors.mean == 0.0
    for path in (tmp_path, tmp_path / "motion.npz"):
        with pytest.raises(InputError, match=r"motion\.npz"):
            evaluate_directory(path, tmp_path / "joints.trc")


def test_a_directory_without_joints_is_an_input_error(tmp_path):
    write_trc(tmp_path / "truth.trc", TIMES, {"LElbow": circle(TIMES)})
    with pytest.raises(InputError, match=r"joints\.trc"):
        evaluate_directory(tmp_path, tmp_path / "truth.trc", {"elbow_l": "LElbow"})


def test_the_reference_of_the_real_recording_matches_its_own_markers(recordings, tmp_path):
    truth = recordings / "balancing" / "truth.trc"
    (tmp_path / "joints.trc").write_bytes(truth.read_bytes())
    errors = evaluate_directory(tmp_path, truth, {"LElbow": "LElbow", "RElbow": "RElbow"})
    assert len(errors.times) == 60
    assert errors.mean == 0.0
    apart = evaluate_directory(tmp_path, truth, {"LElbow": "LWrist"})
    assert 0.15 < apart.mean < 0.4


def test_the_table_has_a_row_per_joint_and_one_for_their_mean():
    after, before = shifted_by(np.array([0.03, 0.0, 0.0])), shifted_by(np.array([0.06, 0.0, 0.0]))
    head, units, elbow, mean = (line.split() for line in format_table(after, before).splitlines())
    assert head[0] == "joint" and head[-1] == "improved"
    assert units[-2:] == ["cm", "%"]
    assert elbow[:3] == ["elbow_l", "120", "3.00"]
    assert mean[0] == "mean" and mean[-2:] == ["6.00", "50"]


def test_the_table_leaves_a_dash_where_there_is_no_figure():
    table = format_table(shifted_by(np.full(3, np.nan)))
    assert table.splitlines()[2].split() == ["elbow_l", "0", "-", "-", "-", "-", "-", "-"]


def scattered(stated: float, times_too_sure: float = 1.0) -> Errors:
    """Errors of a joint that are those stated, or so many times larger, from sample to sample."""
    rng = np.random.default_rng(0)
    deviations = stated * rng.uniform(0.5, 2.0, (4000, 1, 1)) * np.ones(3)
    offsets = times_too_sure * rng.normal(scale=deviations)
    return Errors(("elbow_l",), np.arange(4000) / 60, offsets, deviations)


def test_right_deviations_hold_nine_tenths_and_too_small_ones_fewer():
    figures = scattered(0.04).as_dict()["joints"]["elbow_l"]
    assert figures["within_90_share"] == pytest.approx(0.9, abs=0.01)
    assert figures["stated_m"] == pytest.approx(0.05 * np.sqrt(3), rel=0.05)
    surely = scattered(0.04, 3.0).as_dict()["joints"]["elbow_l"]
    assert surely["within_90_share"] < 0.5
    assert surely["error_over_stated"] == pytest.approx(3 * figures["error_over_stated"])


def test_the_table_states_deviations_only_where_there_are_some():
    assert "in 90 %" in format_table(scattered(0.04))
    assert "in 90 %" not in format_table(replace(scattered(0.04), deviations=None))


def test_groups_of_right_deviations_lie_on_the_line_and_the_surest_err_least():
    stated, found = stated_and_found(scattered(0.04))
    x, y = reliability_curve(stated, found)
    np.testing.assert_allclose(y, x, rtol=0.1)
    share, error = risk_curve(stated, found)
    assert share[-1] == 1 and error[-1] == pytest.approx(found.mean())
    assert error[len(error) // 4] < 0.7 * error[-1]


def test_the_reliability_plot_is_a_picture_and_wants_deviations(tmp_path):
    plot_reliability(tmp_path / "plot.png", by_joint(scattered(0.04)))
    picture = cv2.imread(str(tmp_path / "plot.png"))
    assert picture is not None and (picture != 255).any()
    # A joint that the reference never shows is left out.
    hidden = scattered(0.04)
    hidden.offsets[:, 0] = np.nan
    assert set(by_joint(hidden)) == set(hidden.joints[1:])
    # So is one of which nothing is stated where others have something, as with ``--paper``.
    one = scattered(0.04)
    stated = np.concatenate([one.deviations, np.nan * one.deviations], 1)
    both = Errors(("elbow_l", "hip_l"), one.times, np.repeat(one.offsets, 2, 1), stated)
    assert set(by_joint(both)) == {"elbow_l"}
    with pytest.raises(ValueError, match="no joint could be compared"):
        plot_reliability(
            tmp_path / "none.png", by_joint(replace(hidden, offsets=np.nan * hidden.offsets))
        )
    with pytest.raises(ValueError, match="nothing states how sure"):
        plot_reliability(tmp_path / "none.png", {"run": replace(scattered(0.04), deviations=None)})


@pytest.mark.parametrize("rate", [60.0, 100.0, 119.88])
def test_a_track_at_another_rate_than_its_reference_has_no_error_of_that(rate):
    def arm(times: np.ndarray) -> np.ndarray:
        return np.stack([0.3 * np.sin(5 * times), 0.2 * np.cos(4 * times), 0 * times], 1)

    own, found = np.arange(300) / 60, np.arange(round(5 * rate)) / rate
    errors = position_errors(own, {"a": arm(own)}, found, {"a": arm(found)}, {"a": "a"})
    assert errors.distances.max() < 8e-4 and len(errors.times) > 290
    # Stamps that a file rounds are of the samples themselves, and within a gap there is nothing.
    errors = position_errors(own, {"a": arm(own)}, own.round(3), {"a": arm(own)}, {"a": "a"})
    np.testing.assert_array_equal(errors.offsets, 0)


def test_the_plot_of_errors_shows_both_curves_in_their_colours(tmp_path):
    wave = 0.1 + 0.05 * np.sin(2 * np.pi * TIMES)
    both = {"elbow_l": wave, "elbow_r": wave}
    plot_elbow_errors(tmp_path / "a.png", TIMES, both, {k: v / 2 for k, v in both.items()}, "Serve")
    image = cv2.imread(str(tmp_path / "a.png"))
    assert image is not None and min(image.shape[:2]) > 500
    red = (image == np.array([0x28, 0x28, 0xC6])).all(-1).sum()
    blue = (image == np.array([0xB0, 0x57, 0x15])).all(-1).sum()
    assert red > 500 and blue > 200
