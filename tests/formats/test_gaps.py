"""Gaps are gaps: no file slides through them, and none grows by them."""

import numpy as np
import pytest
from conftest import complaint
from moving_body import RATE, SAMPLES, moving_body, with_parts

from jaxmocap.formats.animation.export import write_animation
from jaxmocap.formats.animation.gltf_in import read_gltf
from jaxmocap.formats.armatures.body_armature import armature_of
from jaxmocap.formats.convert import ConversionOptions, convert_file
from jaxmocap.formats.motion_npz import save_motion
from jaxmocap.formats.time_series import resampling
from jaxmocap.formats.time_series.markers import read_markers
from jaxmocap.formats.time_series.resampling import LONGEST_BRIDGED_S, even_times, is_gap
from jaxmocap.formats.time_series.trc import write_trc

HOURS = 7200.0
MIDDLE = SAMPLES // 2


def with_gap(seconds: float):
    """The moving body, its second half later by so much."""
    times = moving_body().times.copy()
    times[MIDDLE:] += seconds
    return with_parts(moving_body(), times=times)


@pytest.mark.parametrize(
    ("times", "expected"),
    [
        ([0.0], []),
        ([0.0, 100.0], [False]),
        ([0.0, 0.1, 0.2, 0.2 + LONGEST_BRIDGED_S, 1.2], [False, False, False, False]),
        ([0.0, 0.1, 0.2, 0.8, 0.9], [False, False, True, False]),
        ([0.0, 1.0, 2.0, 6.5, 7.5], [False, False, False, False]),
        ([0.0, 1.0, 2.0, 7.5, 8.5], [False, False, True, False]),
    ],
)
def test_a_gap_is_longer_than_half_a_second_and_five_samples(times, expected):
    assert is_gap(np.array(times)).tolist() == expected


def test_poses_without_a_measurement_lie_between_their_neighbours_or_repeat_the_end():
    motion, is_measured = with_gap(HOURS), np.ones(SAMPLES, bool)
    is_measured[[0, 1, -1]] = is_measured[MIDDLE - 2 : MIDDLE + 3] = False
    poses = resampling.bridge_poses(motion.times, motion.poses, is_measured)
    for before, after in zip(motion.poses, poses, strict=True):
        np.testing.assert_array_equal(after[is_measured], before[is_measured])
        np.testing.assert_allclose(after[[0, 1, -1]], before[[2, 2, -2]], atol=1e-6)
    ends = motion.poses.position[[MIDDLE - 3, MIDDLE + 3]]
    share = (motion.times - motion.times[MIDDLE - 3]) / np.ptp(
        motion.times[[MIDDLE - 3, MIDDLE + 3]]
    )
    expected = ends[0] + share[MIDDLE, None] * (ends[1] - ends[0])
    np.testing.assert_allclose(poses.position[MIDDLE], expected, atol=1e-5)


def test_a_viewer_stands_still_through_two_hours_and_then_jumps(tmp_path):
    motion = with_gap(HOURS)
    assert write_animation(tmp_path / "a.glb", motion) is None
    back = read_gltf(tmp_path / "a.glb")
    before, after = motion.times[MIDDLE - 1], motion.times[MIDDLE]
    in_gap = (back.times > before) & (back.times < after)
    assert in_gap.sum() == 1 and after - back.times[in_gap][0] < 2 / RATE + 1e-3
    last = back.positions[back.times <= before][-1]
    np.testing.assert_array_equal(back.positions[in_gap][0], last)
    np.testing.assert_array_equal(back.rotations[in_gap][0], back.rotations[MIDDLE - 1])
    assert len(back.times) == SAMPLES + 1


def test_a_pose_that_is_unknown_for_long_is_held_as_well(tmp_path):
    position = np.array(moving_body().poses.position)
    position[10 : SAMPLES - 5] = np.nan
    write_animation(tmp_path / "a.glb", with_parts(moving_body(), position=position))
    back = read_gltf(tmp_path / "a.glb")
    assert len(back.times) == 15 + 1
    np.testing.assert_array_equal(back.positions[10], back.positions[9])


def test_samples_that_single_precision_throws_together_leave_the_glb_file_out(tmp_path):
    message = write_animation(tmp_path / "a.glb", with_gap(1e9))
    assert message and message.startswith("a.glb is left out: glTF holds times in single precision")
    assert not list(tmp_path.iterdir())


def test_a_bvh_file_with_a_gap_of_hours_is_left_out_and_says_why(tmp_path):
    message = write_animation(tmp_path / "motion.bvh", with_gap(HOURS))
    assert message and message.startswith(
        "motion.bvh is left out: BVH has one rate only, and its 60"
    )
    assert "432" in message and "7200" in message and "\n" not in message
    assert not list(tmp_path.iterdir())


def test_a_bvh_file_holds_its_poses_through_a_short_gap(tmp_path):
    assert write_animation(tmp_path / "a.bvh", with_gap(2.0)) is None
    back = read_markers(tmp_path / "a.bvh").positions
    complete = tmp_path / "whole.bvh"
    write_animation(complete, moving_body())
    measured = read_markers(complete).positions
    within = back[MIDDLE:-MIDDLE]
    assert len(within) == 2 * RATE
    near = [np.abs(within - measured[i]).max((1, 2)) < 2e-6 for i in (MIDDLE - 1, MIDDLE)]
    assert (near[0] | near[1]).all() and near[0][0] and near[1][-1]


def test_a_bvh_file_of_more_orientations_than_fit_into_memory_at_once_is_written(
    tmp_path, monkeypatch
):
    """Of uneven samples: they are computed as they are written."""
    columns = 9 * len(armature_of(moving_body()).names)
    monkeypatch.setattr(resampling, "ALWAYS_ALLOWED_NUMBERS", 0)
    monkeypatch.setattr(resampling, "MAX_NUMBERS", columns * SAMPLES // 2)
    assert write_animation(tmp_path / "a.bvh", with_gap(0.01)) is None
    assert len(read_markers(tmp_path / "a.bvh").times) == SAMPLES


@pytest.mark.parametrize("target", ["b.trc", "b.csv"])
def test_markers_at_another_rate_are_missing_within_gaps(tmp_path, target):
    times = np.array([0.0, 0.1, 0.2, 2.0, 2.1])
    write_trc(tmp_path / "a.trc", times, {"Head": np.outer(times, [1, 2, 3])})
    convert_file(tmp_path / "a.trc", tmp_path / target, ConversionOptions(rate=20))
    back = read_markers(tmp_path / target)
    missing = np.isnan(back.positions).all((1, 2))
    assert missing.tolist() == [bool(0.21 < t < 1.99) for t in back.times]
    np.testing.assert_allclose(back.positions[~missing, 0, 0], back.times[~missing], atol=1e-6)


@pytest.mark.parametrize("target", ["b.bvh", "b.glb", "b.npz", "b.mot", "b.trc"])
@pytest.mark.parametrize(("rate", "gap"), [(1e9, 0.0), (60.0, 1e9), (1e300, 1e9)])
def test_more_samples_than_any_recording_are_refused_before_they_are_made(
    tmp_path, target, rate, gap
):
    save_motion(tmp_path / "a.npz", with_gap(gap))
    files = tmp_path / "a.npz", tmp_path / target
    message = complaint(convert_file, *files, ConversionOptions(rate=rate))
    assert f"a.npz: {rate:g} samples per second would be" in message
    assert "expected at most" in message
    assert not (tmp_path / target).exists()


@pytest.mark.parametrize("rate", [0.0, -1.0, np.nan, np.inf])
def test_a_rate_that_is_none_is_refused(rate):
    with pytest.raises(ValueError, match="expected a positive number"):
        even_times(np.arange(3.0), rate)


def test_a_motion_that_a_target_cannot_hold_is_refused_in_one_sentence(tmp_path):
    save_motion(tmp_path / "a.npz", with_gap(1e9))
    for target, message in (("b.glb", "single precision"), ("b.bvh", "one rate only")):
        assert message in complaint(convert_file, tmp_path / "a.npz", tmp_path / target)
        assert not (tmp_path / target).exists()
