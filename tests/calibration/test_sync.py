"""Offsets between clocks: found where the motion determines them, and only there."""

import json
from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from jaxmocap.body.skeleton import Skeleton
from jaxmocap.calibration import sync as synced
from jaxmocap.calibration.clock_check import check_clocks
from jaxmocap.calibration.hand_flow import MAX_SIDE_PX, HandFlow, MarkerPath, flow_fields
from jaxmocap.calibration.sync import (
    StretchLag,
    combine_lags,
    estimate_video_offsets,
    hand_paths,
)
from jaxmocap.capture.video import open_video
from jaxmocap.cli.program import main
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.recordings.recording import MarkerPlace, Recording, VideoSource
from jaxmocap.geometry.cameras import visible_pixels
from jaxmocap.pipelines.check import check
from jaxmocap.synthetic.drawing_camera import look_at

SIZE, FPS, RATE, SECONDS = (160, 120), 30, 90, 3.0
CAMERA = look_at((2.2, 0.0, 1.2), (0.0, 0.0, 1.2), size=SIZE, focal=190.0, distortion=())
PLACES = (MarkerPlace("Left", "hand_l", 0.6), MarkerPlace("Right", "hand_r", 0.6))
FIVE_MS = 0.005


def waving(seed: int, speed: float = 1.0) -> CubicSpline:
    """Two hands that wave before the camera, (T, 6) metres over seconds."""
    rng = np.random.default_rng(seed)
    keys = np.arange(-1.0, SECONDS + 1.0, 0.3)
    spread = speed * np.array([0.05, 0.2, 0.3] * 2)
    rest = np.array([0.0, 0.35, 1.2, 0.0, -0.35, 1.2])
    return CubicSpline(keys, rest + spread * rng.uniform(-1, 1, (len(keys), 6)))


@cache
def texture(seed: int, side: int) -> np.ndarray:
    grain = np.random.default_rng(seed).uniform(0, 255, (side, side)).astype(np.float32)
    return cv2.normalize(cv2.GaussianBlur(grain, None, 1.5), None, 20, 235, cv2.NORM_MINMAX)


def filmed(hands, times: np.ndarray) -> list[np.ndarray]:
    """Grey frames: textured balls, 10 cm across, where the hands are, before a textured wall."""
    wall = texture(9, max(SIZE))[: SIZE[1], : SIZE[0]] / 2
    columns, rows = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]))
    frames = []
    for positions in hands(times).reshape(-1, 2, 3):
        image = wall.copy()
        for seed, (x, y) in enumerate(visible_pixels(CAMERA, positions)):
            patch = np.float32([[1, 0, x - 20], [0, 1, y - 20]])
            ball = cv2.warpAffine(texture(seed, 41), patch, SIZE, flags=cv2.INTER_LINEAR)
            near = np.hypot(columns - x, rows - y)
            image += (ball - image) * np.clip(9.5 - near, 0, 1)
        frames.append(np.rint(image).astype(np.uint8))
    return frames


def recorded(hands, offset: float, seed: int = 0, film=None) -> Recording:
    """A recording of the hands, a millimetre of jitter on them, that says an offset of 0."""
    times = np.arange(SECONDS * RATE) / RATE
    positions = hands(times).reshape(-1, 2, 3)
    positions = positions + np.random.default_rng(seed).normal(0, 0.001, positions.shape)
    video_times = np.arange((SECONDS - 1) * FPS) / FPS
    frames = (video_times, filmed(film or hands, video_times + offset))
    video = VideoSource("webcam", CAMERA, frames=frames)
    return Recording(Skeleton.human(1.75), times, positions, PLACES, (video,), "waving")


# What is found -----------------------------------------------------------------------------------


@pytest.mark.parametrize(("seed", "offset"), [(0, 0.5), (1, -0.5), (3, 0.0041)])
def test_an_offset_is_found_within_five_milliseconds(seed, offset):
    (actual,) = estimate_video_offsets(recorded(waving(seed), offset, seed), search=0.6)
    assert actual.is_found and actual.reason == "" and actual.stated_offset_s == 0.0
    assert abs(actual.offset_s - offset) < FIVE_MS
    assert abs(actual.offset_s - offset) < 4 * actual.std_s < 4 * FIVE_MS
    assert actual.correlation > 0.6 and np.isnan(actual.drift_s_per_s)


def checked(recording: Recording) -> tuple[float, tuple[str, ...]]:
    """The offset to take, and the warnings."""
    actual, sentences = check_clocks(recording, [open_video(recording.videos[0])])
    return actual.videos[0].offset, sentences


def stating(recording: Recording, offset: float) -> Recording:
    return replace(recording, videos=(replace(recording.videos[0], offset=offset),))


@pytest.mark.parametrize("offset", [0.06, -0.12])
def test_an_offset_that_is_surely_wrong_is_corrected_and_a_right_one_stays(offset):
    recording = recorded(waving(1), offset)
    actual, (sentence,) = checked(recording)
    assert abs(actual - offset) < FIVE_MS
    assert f"webcam: the image moves with the hands at offset = {actual:.4f} (± " in sentence
    assert "where the recording states 0: write it into the file" in sentence
    assert check(recording).warnings == (sentence,)
    assert checked(stating(recording, actual)) == (actual, ())
    near = actual + FIVE_MS
    assert checked(stating(recording, near)) == (near, ()), "less than what is surely wrong"


def test_half_a_second_determines_no_offset():
    recording = recorded(waving(1), 0.06)
    times, images = recording.videos[0].frames
    short = replace(recording.videos[0], frames=(times[:16], images[:16]))
    recording = replace(recording, videos=(short,))
    (actual,) = estimate_video_offsets(recording, search=0.2)
    assert actual.reason == "not identifiable: 0.5 s long, expected 1.5 at least"
    assert checked(recording) == (0.0, ())


def test_without_sure_evidence_a_stated_offset_stays():
    unseen = recorded(waving(1), 0.06)
    unseen.positions_world[3:] = np.nan
    away = recorded(waving(1), 0.06)
    away.positions_world[...] += [0.0, 50.0, 0.0]
    for recording in (recorded(still, 0.06), unseen, away):
        assert checked(recording) == (0.0, ())
    offset, (sentence,) = checked(recorded(waving(6), 0.0, film=waving(7)))
    assert offset == 0.0 and "where the hands are the image does not move as they do" in sentence


def test_an_offset_that_is_stated_is_where_the_search_begins():
    recording = recorded(waving(1), 0.4)
    (source,) = recording.videos
    recording = replace(recording, videos=(replace(source, offset=0.35),))
    (actual,) = estimate_video_offsets(recording, search=0.1)
    assert actual.stated_offset_s == 0.35 and abs(actual.offset_s - 0.4) < FIVE_MS
    (actual,) = estimate_video_offsets(
        replace(recording, videos=(replace(source, offset=0.2),)), search=0.1
    )
    assert np.isnan(actual.offset_s) and actual.reason and not actual.is_found


def test_the_result_does_not_follow_the_markers_sample_clock():
    """Jitter from sample to sample is no acceleration; if it were, lags would stick to samples."""
    recording = recorded(waving(4), 0.1)
    actual = [
        estimate_video_offsets(replace(recording, times=recording.times + shift), search=0.2)[
            0
        ].offset_s
        - shift
        for shift in (0.0, 0.4 / RATE)
    ]
    assert np.ptp(actual) < 1e-3


@pytest.mark.parametrize("seed", [1, 3, 4])
def test_a_stated_offset_that_is_far_off_is_a_warning_of_check(seed):
    for offset, count in ((0.0, 0), (0.01, 0), (0.4, 1), (-0.5, 1)):
        warnings = check(recorded(waving(seed), offset, seed)).warnings
        assert len(warnings) == count
        assert all("webcam: where the hands are" in each for each in warnings)


def test_hands_that_stand_still_show_no_wrong_offset():
    assert not check(recorded(still, 0.4)).warnings
    assert not check(recorded(waving(1, speed=0.05), 0.4)).warnings


# What cannot be found ----------------------------------------------------------------------------


def still(times: np.ndarray) -> np.ndarray:
    return np.tile([0.0, 0.35, 1.2, 0.0, -0.35, 1.2], (len(times), 1))


def circling(times: np.ndarray) -> np.ndarray:
    turn = 2 * np.pi * times / 0.6
    y, z = 0.15 * np.cos(turn), 0.15 * np.sin(turn)
    return still(times) + np.stack([0 * y, y, z, 0 * y, y, z], -1)


@pytest.mark.parametrize(
    ("hands", "film", "search", "says"),
    [
        (still, None, 0.2, "not identifiable: move the hands faster"),
        (waving(5, speed=0.02), None, 0.2, "not identifiable: move the hands faster"),
        (waving(6), waving(7), 0.3, "not identifiable"),
        (circling, None, 1.0, "not identifiable: the motion repeats itself"),
    ],
    ids=["at rest", "slow", "other motion in the image", "repeated"],
)
def test_hands_that_tell_no_offset_are_asked_for_what_would(hands, film, search, says):
    (actual,) = estimate_video_offsets(recorded(hands, 0.1, film=film), search)
    assert np.isnan(actual.offset_s) and np.isnan(actual.std_s)
    assert actual.reason.startswith(says)


def test_an_offset_beyond_the_search_is_answered_with_a_wider_one():
    (actual,) = estimate_video_offsets(recorded(waving(1), 0.5), search=0.1)
    assert "search wider (--search)" in actual.reason


def test_hands_out_of_the_image_are_told():
    recording = recorded(waving(0), 0.1)
    away = replace(recording, positions_world=recording.positions_world + 9.0)
    (actual,) = estimate_video_offsets(away, search=0.2)
    assert actual.reason == "not identifiable: the image does not show the hands"


def test_a_recording_without_video_or_markers_is_refused():
    recording = recorded(still, 0.0)
    with pytest.raises(InputError, match=r"\[\[video\]\] is missing"):
        estimate_video_offsets(replace(recording, videos=()))
    gone = recording.positions_world.copy()
    gone[2:] = np.nan
    with pytest.raises(InputError, match="no hand's marker is present in four samples"):
        estimate_video_offsets(replace(recording, positions_world=gone))


# Several stretches -------------------------------------------------------------------------------


def test_stretches_are_put_together_by_their_weights_and_tell_the_drift():
    middles, stds = np.array([5.0, 40.0, 100.0, 170.0]), np.array([1.0, 2.0, 1.0, 3.0]) / 1e3
    lags = 0.02 + 1e-4 * middles
    lost = StretchLag(200.0, np.nan, np.nan, 0.1, "not identifiable")
    rows = [*map(StretchLag, middles, lags, stds, [0.9, 0.8, 0.7, 0.6]), lost]
    source = recorded(still, 0.0).videos[0]
    actual = combine_lags(replace(source, offset=1.0), rows)
    fitted, covariance = np.polyfit(middles, lags, 1, w=1 / stds, cov="unscaled")
    assert actual.drift_s_per_s == pytest.approx(fitted[0]) == pytest.approx(1e-4)
    assert actual.drift_std_s_per_s == pytest.approx(covariance[0, 0] ** 0.5)
    assert actual.offset_s == pytest.approx(1.0 + np.average(lags, weights=stds**-2))
    assert actual.correlation == 0.9
    assert "gains 100 ±" in synced.sync_text([actual]), "microseconds a second"
    near = combine_lags(source, rows[:2])
    assert np.isnan(near.drift_s_per_s) and near.std_s > (1e-6 + 4e-6) ** 0.5 / 4, "they disagree"
    assert combine_lags(source, [lost]).reason == "not identifiable"


def test_a_long_video_is_looked_at_where_the_hands_are_liveliest(monkeypatch):
    monkeypatch.setattr(synced, "STRETCH_S", 0.3)
    recording = recorded(still, 0.0)
    lively = recording.positions_world.copy()
    lively[97:120, 0, 1] += 0.2 * np.sin(np.arange(23))
    video = synced.open_video(recording.videos[0])
    paths = hand_paths(replace(recording, positions_world=lively))
    stretches = synced._stretches(video.times, paths)
    assert len(stretches) == 6 and all(count == 9 for _, count in stretches)
    assert [first // 10 for first, _ in stretches] == [0, 1, 2, 3, 4, 5], "one in each sixth"
    assert stretches[3] == (31, 9), "frames 32 to 39 move"


# What it stands on -------------------------------------------------------------------------------


def test_a_path_goes_through_smooth_motion_and_not_across_gaps():
    times = np.arange(180) / RATE
    wave = np.stack([np.sin(5 * times), np.cos(5 * times), times], -1)
    wave[80:90] = np.nan
    path = MarkerPath.through(times, wave)
    assert path is not None
    at = np.array([-0.1, 0.4047, 0.95, 1.5031, 2.1])
    expected = np.stack([np.sin(5 * at), np.cos(5 * at), at], -1)
    expected[[0, 2, 4]] = np.nan
    np.testing.assert_allclose(path.at(at), expected, atol=1e-3)
    assert MarkerPath.through(times[:3], wave[:3]) is None


def test_terms_are_the_flow_at_the_hands_and_the_markers_own_motion():
    recording = recorded(waving(0), 0.0)
    times = np.arange(10) / FPS + 1
    height, width = SIZE[1] // 2, SIZE[0] // 2
    columns, rows = np.meshgrid(np.arange(width), np.arange(height))
    field = np.stack([2.0 * columns, -2.0 * rows], -1)
    flow = HandFlow(times, np.tile(field, (9, 1, 1, 1)), 2.0, CAMERA, hand_paths(recording))
    terms = flow.flow_pair(0.02)
    xy = np.stack([visible_pixels(CAMERA, path.at(times + 0.02)) for path in flow.paths], 1)
    np.testing.assert_allclose(terms.predicted, np.diff(xy, axis=0))
    np.testing.assert_allclose(terms.measured, xy[:-1] * [1, -1], atol=2.0)
    later = flow.flow_pair(0.02, place_lag=0.02 + 1 / FPS)
    np.testing.assert_allclose(later.measured[:-1], terms.measured[1:])
    np.testing.assert_allclose(later.predicted, terms.predicted)
    off = replace(CAMERA, size=CAMERA.size)
    outside = HandFlow(times, np.zeros((9, 5, 5, 2)), 2.0, off, flow.paths).flow_pair(0.0)
    assert np.isnan(outside.measured).all() and np.isnan(outside.predicted).all()


def test_flow_is_in_pixels_of_the_image_however_large():
    wall = np.tile(texture(3, 400), (2, 3))[:800, :1200]
    frames = [np.rint(np.roll(wall, (2 * i, 4 * i), (0, 1))).astype(np.uint8) for i in range(3)]
    frames.append(None)
    video = VideoSource("v", CAMERA, frames=(np.arange(4) / 30, frames))
    fields, spacing = flow_fields(synced.open_video(video), 1, 3)
    assert spacing == pytest.approx(2 * 1200 / MAX_SIDE_PX)
    assert fields.shape[0] == 2 and np.isnan(fields[1].astype(float)).all()
    middle = fields[0, 40:-40, 40:-40].astype(float)
    np.testing.assert_allclose(np.median(middle, (0, 1)), [4, 2], atol=0.2)


def test_without_hands_all_markers_are_looked_at():
    places = (MarkerPlace("Head", "head"), MarkerPlace("Foot", "foot_l"))
    assert len(hand_paths(replace(recorded(still, 0.0), places=places))) == 2
    wrist = (MarkerPlace("Head", "head"), MarkerPlace("Wrist", "radius_r"))
    assert len(hand_paths(replace(recorded(still, 0.0), places=wrist))) == 1


# The command -------------------------------------------------------------------------------------


def test_the_command_prints_the_line_to_put_into_the_file(tmp_path, capsys, refusal, monkeypatch):
    recording = recorded(waving(2), 0.137)
    read = "jaxmocap.formats.recordings.recording.load_recording"
    monkeypatch.setattr(read, lambda *_: recording)
    file = tmp_path / "sync.json"
    assert main(["sync", "r.toml", "--search", "0.2", "--json", str(file)]) == 0
    (figures,) = json.loads(file.read_text())["videos"]
    assert f"webcam: offset = {figures['offset_s']:.4f}  (± {figures['std_s']:.4f} s" in (
        capsys.readouterr().out
    )
    assert abs(figures["offset_s"] - 0.137) < FIVE_MS and figures["drift_s_per_s"] is None
    assert "no [[video]] of camera 'other'" in refusal("sync", "r.toml", "--cameras", "other")
