"""The offline loop: every sample gets its pose, whatever is missing, and the report says so."""

import json
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from small_recording import (
    FRAMES,
    PLACES,
    SAMPLES,
    VIDEO_RATE,
    compiled,
    image,
    small_recording,
    with_frames,
    with_outlier_and_gap,
    write_small_recording,
)

from jaxmocap.body.model import Model
from jaxmocap.body.motion import SAMPLED, Motion
from jaxmocap.body.pose import Pose
from jaxmocap.capture.video import open_video
from jaxmocap.cli.recording_options import select_cameras
from jaxmocap.evaluation.errors import evaluate
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.files.output_folder import OutputFolder
from jaxmocap.formats.motion_npz import load_motion
from jaxmocap.formats.recordings.filters import Filters
from jaxmocap.formats.recordings.recording import Recording, load_recording
from jaxmocap.formats.time_series.markers import read_markers
from jaxmocap.formats.time_series.tables import Markers
from jaxmocap.geometry.cameras import turn_camera
from jaxmocap.hybrid.settings import Settings
from jaxmocap.hybrid.step import EVENTS
from jaxmocap.hybrid.tracker import HybridTracker
from jaxmocap.outputs import viewer
from jaxmocap.outputs.report import MISFIT_M
from jaxmocap.pipelines import writing
from jaxmocap.pipelines.summary import figures, frames_per_second, misfit, summary
from jaxmocap.pipelines.tracking import events
from jaxmocap.pipelines.tracking.events import elbow_warnings, without_video
from jaxmocap.pipelines.tracking.motions import low_pass_poses
from jaxmocap.pipelines.tracking.track import track, track_both
from jaxmocap.pipelines.viewer_frames import arm_edges, viewer_frames
from jaxmocap.pipelines.writing import MOTION, write_outputs
from jaxmocap.smoothing.window.advance import DELAY_S

WRISTS = {"wrist_l": "LWrist", "wrist_r": "RWrist"}


@pytest.fixture(scope="module")
def tracked():
    """The small recording, tracked with markers only and with video."""
    return track_both(small_recording(), tracker=compiled(), why=True)


@pytest.fixture(scope="module")
def again():
    """The same once more, and what its progress was called with."""
    calls: list[tuple[int, int]] = []
    return track(small_recording(), tracker=compiled(), progress=lambda *c: calls.append(c)), calls


@pytest.fixture(scope="module")
def causal():
    """The small recording as a live run has it, and what its progress was called with."""
    calls: list[tuple[int, int]] = []
    keep = lambda *c: calls.append(c)  # noqa: E731
    return track(small_recording(), mode="causal", tracker=compiled(), progress=keep), calls


def samples_with(motion, sentence: str) -> list[int]:
    """Which samples have a warning."""
    return [i for i, lines in enumerate(motion.report.statuses) if sentence in lines]


def test_recording_model_and_motion_say_what_they_are_in_a_line(tracked):
    recording = small_recording()
    for thing in (recording, Model.of(recording), tracked.motion):
        assert len(repr(thing)) < 240 and "\n" not in repr(thing)
    assert f"{len(tracked.motion.times)} poses" in repr(tracked.motion)
    assert all(name in repr(recording) for name in recording.marker_names)


def test_a_tracker_takes_its_recordings_markers_and_no_others():
    recording = small_recording()
    tracker, count = HybridTracker.from_recording(recording), len(recording.places)
    assert repr(tracker.model) == repr(Model.of(recording))
    with pytest.raises(ValueError, match=rf"found shape \({count - 1}, 3\), expected \({count}, 3"):
        tracker.init(recording.positions_world[0, 1:])


def test_why_a_landmark_is_where_it_is_is_stated(tracked, again):
    listed = tracked.motion.report.run.deviations_without_m
    elbow = listed["elbow_l"]
    assert elbow["marker LWrist"] > 1.2 * elbow["nothing"]
    median = float(np.median(tracked.motion.report.elbow_deviations[:, 0]))
    assert elbow["nothing"] == pytest.approx(median, rel=0.3)
    assert "why" in summary(tracked.motion) and "marker LWrist ± " in summary(tracked.motion)
    assert not again[0].report.run.deviations_without_m and "why" not in summary(again[0])
    with pytest.raises(InputError, match="found --why, which is of poses that are smoothed"):
        track_both(small_recording(), mode="causal", tracker=compiled(), why=True)


def test_a_clock_that_is_surely_wrong_is_corrected_in_the_motion_and_for_the_outputs(
    tracked, monkeypatch
):
    (right,) = small_recording().videos

    def corrected(recording, videos):
        sources = (replace(recording.videos[0], offset=right.offset),)
        return replace(recording, videos=sources), ("cam: another offset",)

    monkeypatch.setattr(events, "check_clocks", corrected)
    wrong = replace(small_recording(), videos=(replace(right, offset=0.07),))
    found = track_both(wrong, tracker=compiled())
    assert "cam: another offset" in found.motion.report.run.warnings
    assert found.recording.videos[0].offset == right.offset
    np.testing.assert_array_equal(found.motion.poses.angles, tracked.motion.poses.angles)
    # A live run has no later frames.
    unchanged = track_both(wrong, mode="causal", tracker=compiled())
    assert unchanged.recording.videos[0].offset == 0.07
    assert "cam: another offset" in unchanged.motion.report.run.warnings


# What comes out ----------------------------------------------------------------------------------


def test_every_marker_sample_has_a_pose_on_its_markers(tracked):
    motion, recording = tracked.motion, small_recording()
    np.testing.assert_array_equal(motion.times, recording.times)
    joints = motion.joints()
    for i, (name, (_, landmark)) in enumerate(PLACES.items()):
        away = np.linalg.norm(joints[landmark] - recording.positions_world[:, i], axis=1)
        assert away.max() < 0.02, name
        np.testing.assert_allclose(motion.report.marker_errors[:, i], away, atol=1e-4)


def test_the_first_row_is_settled_already(tracked):
    errors = tracked.motion.report.marker_errors
    assert errors[0].max() < errors.max() + 0.002
    turned = np.abs(np.diff(tracked.markers_only.poses.angles, axis=0))
    assert turned[0].max() < 2 * turned.max(1)[1:].max()


def test_filters_are_reported():
    spoilt = replace(with_outlier_and_gap(), filters=Filters(hampel=True, gaps=0.06))
    motion = track(spoilt, tracker=compiled())
    assert motion.report.run.filters["on"] == {"hampel": True, "gaps": 0.06}
    assert samples_with(motion, "marker LWrist was an outlier") == [5]
    assert samples_with(motion, "marker RWrist was filled in") == [10, 11, 12]
    assert not samples_with(motion, "marker RWrist is missing")
    assert "hampel = True, gaps = 0.06" in summary(motion)
    assert motion.report.marker_errors.max() < 0.03, "nothing followed the outlier"


def test_the_markers_only_motion_has_the_same_times_and_other_elbows(tracked):
    motion, before, _ = tracked
    np.testing.assert_array_equal(before.times, motion.times)
    moved = np.linalg.norm(motion.joints()["elbow_l"] - before.joints()["elbow_l"], axis=1)
    assert 0.001 < moved.max() < 0.5
    assert before.report is None


def test_stages_are_timed_apart_and_the_first_call_by_itself(tracked):
    times = tracked.motion.report.milliseconds
    assert len(times["first_call"]) == 1
    # The last frame lies after the last sample; the first event is a sample without a frame.
    frames = int((small_recording().videos[0].frames[0] + 0.004 <= 23 / 60).sum())
    assert {len(times[stage]) for stage in ("decode", "observe")} == {frames}
    # Chunk by chunk; a frame has every stage, or waits for those beside it.
    chunks = -(-(SAMPLES + frames) // EVENTS)
    assert {len(times[stage]) for stage in ("solve", "refine", "frame")} == {chunks}
    assert times["frame"].max() > max(times["observe"].min(), times["refine"].min())
    report = tracked.motion.report
    seconds = report.run.seconds
    assert report.run.video_frames == frames
    assert seconds["first pass"] > times["first_call"][0] / 1e3
    assert seconds["second pass"] >= times["smooth"][0] / 1e3
    assert frames_per_second(report) == pytest.approx(frames / sum(seconds.values()))


def test_the_stages_of_live_steps_are_timed_event_by_event(causal):
    times = causal[0].report.milliseconds
    frames = len(times["frame"])
    assert len(times["first_call"]) == 1
    assert {len(times[stage]) for stage in ("decode", "smooth")} == {frames}
    # Smoothed, the frames are the smoother's alone.
    assert not {"observe", "refine"} & set(times)
    assert len(times["sample"]) == len(times["solve"]) - frames and "carry" not in times
    assert (times["frame"] >= times["decode"] + times["solve"].min()).all()


def test_what_is_kept_of_each_sample_is_in_single_precision(tracked, spoilt):
    """A million samples would else take more memory than they may, and no file could be read."""
    for motion in (tracked.motion, tracked.markers_only, spoilt[1]):
        report = motion.report
        kept = [*motion.poses, *(getattr(report, name) for name in SAMPLED if report is not None)]
        assert {np.asarray(part).dtype for part in kept} == {np.dtype(np.float32)}


def test_the_report_holds_the_trackers_settings(tracked):
    used = tracked.motion.report.run
    assert used.recording == "small" and used.mode == "own" and used.cameras == ("cam",)
    assert used.markers == tuple(PLACES) and used.warnings == ()
    assert used.tracker["refine"] == "search"
    assert used.tracker["simplex"]["iterations"] > 0


def test_tracking_twice_with_one_tracker_gives_the_same(tracked, again):
    np.testing.assert_array_equal(again[0].poses.angles, tracked.motion.poses.angles)


def test_progress_is_shown_chunk_by_chunk(again):
    calls = again[1]
    total = calls[0][1]
    # In time and, by the markers alone, backwards.
    events = total // 2
    assert SAMPLES < events <= SAMPLES + FRAMES
    chunks = -(-events // EVENTS)
    ends = [min(EVENTS * (i + 1), events) for i in range(chunks)]
    assert calls[:chunks] == [(end, total) for end in ends]
    back = calls[chunks : chunks + events]
    assert back == [(events + i, total) for i in range(1, events + 1)]
    # The second pass counts for itself, in percent.
    rest = calls[chunks + events :]
    percents = [done for done, _ in rest]
    assert {most for _, most in rest} == {100}
    assert percents == sorted(percents) and percents[-1] == 100


def test_progress_of_live_steps_is_shown_event_by_event(causal):
    calls = causal[1]
    assert calls == [(i, calls[0][1]) for i in range(1, calls[0][1] + 1)]


def test_nearest_looks_at_a_frame_at_every_sample():
    motion = track(small_recording(), mode="nearest", tracker=compiled())
    assert "sample" not in motion.report.milliseconds
    assert len(motion.report.milliseconds["observe"]) == SAMPLES
    assert motion.report.run.mode == "nearest"


def test_causal_rows_do_not_depend_on_what_comes_later(causal):
    recording = small_recording()
    half = SAMPLES // 2
    positions = recording.positions_world.copy()
    positions[half:] += 0.05
    times, images = recording.videos[0].frames
    is_before = np.array(times) + 0.004 < recording.times[half]
    later = [im if early else im[::-1] for early, im in zip(is_before, images, strict=True)]
    other = with_frames(replace(recording, positions_world=positions), times, later)
    changed = track(other, mode="causal", tracker=compiled())
    first, second = (motion.poses.angles for motion in (causal[0], changed))
    # What waits for two more frames, or a tenth of a second, may still change.
    final = int(np.flatnonzero(recording.times <= recording.times[half - 1] - DELAY_S)[-1])
    np.testing.assert_array_equal(first[:final], second[:final])
    assert np.abs(first[half:] - second[half:]).max() > 1e-3


def test_causal_poses_without_video_are_smoothed_and_stated():
    recording = replace(small_recording(), videos=())
    half = SAMPLES // 2
    moved = recording.positions_world.copy()
    moved[half:] += 0.05
    motion, changed = (
        track(replace(recording, positions_world=positions), mode="causal")
        for positions in (recording.positions_world, moved)
    )
    assert motion.report.run.latency == {"seconds": DELAY_S}
    assert np.isfinite(motion.report.landmarks_std).all()
    assert motion.report.marker_errors.max() < 0.02
    final = int(np.flatnonzero(recording.times <= recording.times[half - 1] - DELAY_S)[-1])
    first, second = (each.poses.angles for each in (motion, changed))
    np.testing.assert_array_equal(first[:final], second[:final])


def test_without_video_the_markers_are_tracked_alone():
    recording = replace(small_recording(), videos=())
    motion = track(recording, Settings())
    assert np.isnan(motion.report.arm_costs).all()
    assert motion.report.marker_errors.max() < 0.02
    assert set(motion.report.milliseconds) == {"first_call", "solve", "refine", "sample", "smooth"}
    # Three points say little of the elbows, and the report says so.
    unsure = {f"{side} elbow: not determined within 15 cm" for side in ("left", "right")}
    assert {sentence for each in motion.report.statuses for sentence in each} <= unsure
    counts = np.array([len(each) for each in motion.report.statuses])
    np.testing.assert_array_equal(counts, (motion.report.elbow_deviations > 0.15).sum(1))


# What is missing ---------------------------------------------------------------------------------


# Frames that the video has, the black one and the one that cannot be read.
LEFT, BLACK, UNREAD = 9, 3, 6


@pytest.fixture(scope="module")
def spoilt():
    """A recording that lacks markers, at first all, and frames; and as it is tracked."""
    recording = small_recording()
    positions = recording.positions_world.copy()
    positions[:3] = np.nan
    positions[5:9, 1] = np.nan
    positions[12, :] = np.nan
    images = [image(i) for i in range(LEFT)]
    images[BLACK], images[UNREAD] = np.full_like(image(0), 2), None
    short = with_frames(recording, np.arange(LEFT) / VIDEO_RATE, images)
    short = replace(short, positions_world=positions)
    return short, track(short, tracker=compiled())


def test_gaps_in_the_markers_are_tracked_through_with_warnings(spoilt):
    recording, motion = spoilt
    assert all(np.isfinite(part[3:]).all() for part in motion.poses)
    assert samples_with(motion, "marker LWrist is missing") == [5, 6, 7, 8, 12]
    assert samples_with(motion, "marker Head is missing") == [12]
    missing = np.isnan(motion.report.marker_errors)
    np.testing.assert_array_equal(missing, np.isnan(recording.positions_world).any(-1))
    off = motion.joints()["wrist_l"] - small_recording().positions_world[:, 1]
    assert np.linalg.norm(off[3:], axis=1).max() < 0.15


def test_samples_before_the_first_marker_are_unknown_with_a_warning(spoilt):
    _, motion = spoilt
    assert np.isnan(motion.poses.position[:3]).all() and np.isnan(motion.joints()["head"][:3]).all()
    assert samples_with(motion, "no marker has been measured yet") == [0, 1, 2]


def test_a_video_that_ends_early_is_tracked_through_with_warnings(spoilt):
    _, motion = spoilt
    last = (LEFT - 1) / VIDEO_RATE + 0.004
    late = np.flatnonzero(motion.times > last + 1.5 / VIDEO_RATE).tolist()
    assert late and samples_with(motion, "cam: no video frame near this sample") == late
    assert (motion.report.elbow_deviations[-1] > motion.report.elbow_deviations[10]).all()


def test_black_and_unreadable_frames_are_tracked_through_with_warnings(spoilt):
    recording, motion = spoilt
    # The sentence goes to the first sample after the frame.
    after = np.searchsorted(motion.times, np.array(recording.videos[0].frames[0]) + 0.004)
    assert samples_with(motion, "cam: the video frame is black or blank") == [after[BLACK]]
    assert samples_with(motion, "cam: the video frame cannot be read") == [after[UNREAD]]


def test_a_black_video_tells_nothing_of_the_elbows(tracked, causal):
    times = np.arange(FRAMES) / VIDEO_RATE
    black = with_frames(small_recording(), times, [np.full_like(image(0), 2)] * FRAMES)
    for mode, lit in (("own", tracked.motion), ("causal", causal[0])):
        motion = track(black, mode=mode, tracker=compiled())
        unsure, sure = (each.report.elbow_deviations[-1] for each in (motion, lit))
        assert (unsure > 1.5 * sure).all(), mode
        assert motion.report.marker_errors.max() < 0.03
        assert not samples_with(motion, "cam: nothing of the person is recognised")


def test_a_jump_of_the_body_has_a_warning():
    recording = small_recording()
    positions = recording.positions_world.copy()
    positions[10:] += [1.5, 0.0, 0.0]
    motion = track(replace(recording, positions_world=positions), tracker=compiled())
    placed = samples_with(motion, "the body was placed again")
    # The frame between the samples 9 and 10 may see the body half-way.
    assert placed and set(placed) <= {10, 11}
    errors = np.nanmax(motion.report.marker_errors, axis=1)
    # Smoothing joins what lies before and after: a tenth of a second pays for it.
    assert errors[:5].max() < 0.03 and errors[16:].max() < 0.03
    causal = track(replace(recording, positions_world=positions), mode="causal", tracker=compiled())
    assert np.nanmax(causal.report.marker_errors[10:]) < 0.02


def test_sentences_about_samples_and_video_times():
    times, video = np.arange(10) / 10, np.array([0.2, 0.3, 0.4])
    assert np.flatnonzero(~without_video(times, video)).tolist() == [1, 2, 3, 4, 5]
    causal = without_video(times, video, causal=True)
    assert np.flatnonzero(~causal).tolist() == [2, 3, 4, 5]
    unsure = ["right elbow: not determined within 15 cm"]
    assert list(elbow_warnings(np.array([0.02, 0.2]))) == unsure


# Choices -----------------------------------------------------------------------------------------


def test_cameras_are_chosen_by_name_and_a_wrong_name_lists_them():
    recording = small_recording()
    two = replace(
        recording, videos=(*recording.videos, replace(recording.videos[0], camera_name="b"))
    )
    assert [v.camera_name for v in select_cameras(two, ["b"]).videos] == ["b"]
    with pytest.raises(InputError, match=r"small: no \[\[video\]\] of camera 'c', found cam, b"):
        select_cameras(two, ["c"])


def test_a_height_replaces_the_subject_and_a_wrong_one_is_refused(tmp_path):
    path = write_small_recording(tmp_path)
    taller, smaller = (load_recording(path, {"height": each}).skeleton for each in (1.9, 1.5))
    np.testing.assert_allclose(taller.lengths, smaller.lengths * (1.9 / 1.5), rtol=1e-5)
    with pytest.raises(InputError, match=r"recording.toml: \[subject\]: height = 40"):
        load_recording(path, {"height": 40.0})


def test_what_only_fits_frame_by_frame_is_refused_where_poses_are_smoothed():
    alone = HybridTracker.from_recording(small_recording(), Settings(refine="none"))
    assert alone.model.cameras is None
    for refine in ("simplex", "gradient"):
        with pytest.raises(ValueError, match=f'found refine = "{refine}".*expected "search"'):
            track(small_recording(), Settings(refine=refine))


def test_a_low_pass_over_poses_found_frame_by_frame_keeps_what_is_slow():
    """The pelvis moves at 0.5 Hz and trembles at 10, sample by sample; opposite quaternions are one
    turn; angles stay within their ranges."""
    skeleton, times = compiled().model.skeleton, np.arange(300) / 60
    slow, fast = np.sin(np.pi * times), 0.2 * np.sin(20 * np.pi * times)
    turn = np.stack([np.cos((slow + fast) / 4), 0 * times, 0 * times, np.sin((slow + fast) / 4)], 1)
    turn[::7] *= -1
    high = np.asarray(skeleton.limits)[:, 1]
    angles = np.broadcast_to(high, (300, len(high))) + fast[:, None]
    place = np.stack([slow + fast, 0 * times, 0 * times], 1)
    poses = low_pass_poses(times, Pose(place, turn, angles), skeleton, 2.0)  # type: ignore[arg-type]
    inner = slice(60, -60)
    np.testing.assert_allclose(np.asarray(poses.position)[inner, 0], slow[inner], atol=0.01)
    half = np.arctan2(*np.asarray(poses.quaternion).T[[3, 0]])
    np.testing.assert_allclose(np.tan(half)[inner], np.tan(slow / 4)[inner], atol=0.01)
    assert (np.asarray(poses.angles) <= high + 1e-6).all()


def test_a_refinement_that_there_is_not_is_refused():
    for smooth in (True, False):
        with pytest.raises(ValueError, match="found refine = 'simplx', expected one of simplex"):
            track(small_recording(), Settings(refine="simplx", smooth=smooth))  # type: ignore[arg-type]


def test_a_low_pass_is_refused_where_it_takes_no_part():
    chosen = replace(Settings(smooth=False), low_pass=2.0)
    for settings, mode, says in (
        (replace(chosen, smooth=True), "own", "low_pass = 2, which has no part in smoothed poses"),
        (chosen, "causal", "low_pass = 2, which looks ahead"),
        (replace(chosen, low_pass=500.0), "own", "low_pass: found 500 Hz, expected less than"),
    ):
        with pytest.raises((ValueError, InputError), match=says):
            track(small_recording(), settings, mode=mode)


@pytest.mark.parametrize("mode", ["own", "causal"])
def test_the_papers_way_takes_the_nearest_frame_and_no_other(mode):
    with pytest.raises(InputError, match=r"search = false \(--paper\), which takes no frame"):
        track(small_recording(), Settings.paper(), mode=mode)


def test_a_low_pass_acts_on_the_samples_of_an_unsmoothed_run():
    plain, low = (
        track(small_recording(), Settings(refine="none", smooth=False, low_pass=cutoff))  # type: ignore[arg-type]
        for cutoff in (0.0, 2.0)
    )
    assert np.isnan(plain.report.from_prior).all()
    expected = low_pass_poses(plain.times, plain.poses, plain.skeleton, 2.0)
    for ours, theirs in zip(low.poses, expected, strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-6)
    assert np.abs(np.asarray(low.poses.angles) - np.asarray(plain.poses.angles)).max() > 1e-3


# Files -------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def written(tracked, tmp_path_factory):
    """The folder that the small recording's outputs are written to."""
    folder = tmp_path_factory.mktemp("written")
    write_outputs(tracked.motion, small_recording(), folder, compiled().settings)
    return folder


def test_the_motion_is_in_place_before_the_first_picture_is_drawn(tracked, tmp_path, monkeypatch):
    def killed(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(writing, "write_overlay", killed)
    monkeypatch.setattr(viewer, "MOST_SAMPLES", 10)
    sentences: list[str] = []
    with pytest.raises(KeyboardInterrupt):
        write_outputs(tracked.motion, small_recording(), tmp_path, warn=sentences.append)
    assert sentences[-1] == "recording.rrd: one sample in 3, the other files have all"
    names = {*writing.MOTION_FILES, "report.json", "outputs.json"}
    assert {path.name for path in tmp_path.iterdir()} == names
    assert OutputFolder(tmp_path, writing.MOTION).is_complete()
    monkeypatch.undo()
    write_outputs(tracked.motion, small_recording(), tmp_path, compiled().settings)
    assert (tmp_path / "recording.rrd").exists()


def test_joints_and_motion_read_back_as_they_were(written, tracked):
    joints, markers = tracked.motion.joints(), read_markers(written / "joints.trc")
    assert set(markers.names) == set(joints)
    np.testing.assert_allclose(markers.times, tracked.motion.times, atol=1e-8)
    for name, positions in markers.points().items():
        np.testing.assert_allclose(positions, joints[name], atol=1e-6)
    loaded = load_motion(written / "motion.npz")
    np.testing.assert_array_equal(loaded.poses.angles, tracked.motion.poses.angles)
    assert loaded.report.statuses == tracked.motion.report.statuses


def test_the_report_counts_warnings(written, spoilt, tmp_path):
    report = json.loads((written / "report.json").read_text())
    assert report["frames"] == SAMPLES and report["recording"] == "small"
    assert report["milliseconds"]["frame"]["count"] > 0
    recording, motion = spoilt
    write_outputs(motion, recording, tmp_path)
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["statuses"]["marker LWrist is missing"]["count"] == 5
    assert report["statuses"]["no marker has been measured yet"]["count"] == 3
    assert np.isnan(read_markers(tmp_path / "joints.trc").points()["head"][:3]).all()


def test_the_overlay_is_drawn_by_the_camera_as_it_was_found(written, tracked, tmp_path):
    """As by a camera that is calibrated there: eight pixels beside where this one is."""
    import av

    def drawn(folder) -> np.ndarray:
        with av.open(str(folder / "overlay_cam.mp4")) as video:
            return np.stack([frame.to_ndarray(format="gray") for frame in video.decode(video=0)])

    def with_turns(turns) -> Motion:
        run = replace(tracked.motion.report.run, camera_turns_deg=turns)
        return replace(tracked.motion, report=replace(tracked.motion.report, run=run))

    turn, recording = [0.0, 5.0, 0.0], small_recording()
    (source,) = recording.videos
    away = turn_camera(source.camera, jnp.radians(jnp.array(turn)))
    elsewhere = replace(recording, videos=(replace(source, camera=away),))
    write_outputs(with_turns({"cam": turn}), recording, tmp_path / "found")
    write_outputs(with_turns({}), elsewhere, tmp_path / "calibrated")
    expected = drawn(tmp_path / "calibrated")
    np.testing.assert_array_equal(drawn(tmp_path / "found"), expected)
    assert (np.abs(drawn(written).astype(int) - expected) > 50).any(0).sum() > 200


def test_with_two_cameras_each_has_its_overlay(tracked, tmp_path):
    recording = small_recording()
    second = replace(recording.videos[0], camera_name="side")
    two = replace(recording, videos=(*recording.videos, second))
    write_outputs(tracked.motion, two, tmp_path)
    assert {path.name for path in tmp_path.glob("*.mp4")} == {"overlay_cam.mp4", "overlay_side.mp4"}


def test_an_earlier_runs_files_of_other_names_are_removed(tracked, tmp_path):
    """Up to version 0.1 the first camera's overlay had no camera in its name."""
    with OutputFolder(tmp_path, MOTION).writing() as stage:
        (stage / "overlay.mp4").write_bytes(b"earlier")
    (tmp_path / "own.mp4").write_bytes(b"own")
    write_outputs(tracked.motion, small_recording(), tmp_path)
    assert {path.name for path in tmp_path.glob("*.mp4")} == {"overlay_cam.mp4", "own.mp4"}


def test_the_viewer_gets_edges_of_both_arms_and_no_more_frames_than_it_can_hold(tracked):
    video, settings = open_video(small_recording().videos[0]), compiled().settings
    edges = arm_edges(video, small_recording().videos[0].camera, tracked.motion, settings)
    assert list(edges) == ["edges, left arm", "edges, right arm"]
    shape = (settings.region, settings.region)
    for images in edges.values():
        assert len(images) == FRAMES
        assert all(set(np.unique(im)) <= {0, 255} and im.shape == shape for _, im in images)
    assert any(im.any() for _, im in edges["edges, left arm"])
    many = with_frames(small_recording(), np.arange(700) / 30, [image(0)] * 700)
    kept = [time for time, _ in viewer_frames(open_video(many.videos[0]))]
    assert len(kept) == 234 and np.ptp(np.diff(kept)) < 1e-9


def test_the_summary_names_passes_deviations_and_files(written, tracked):
    text, report = summary(tracked.motion, [written / "joints.trc"]), tracked.motion.report
    total = sum(report.run.seconds.values())
    assert f"{total:.1f} s for {report.run.video_frames} video frames: first pass" in text
    left = 100 * np.nanmedian(report.elbow_deviations[:, 0])
    for words in ("samples", "second pass", "Head", f"left ± {left:.1f} cm", "joints.trc"):
        assert words in text


def test_the_summary_has_a_line_for_each_kind_of_status(tracked):
    """25 joints that are hidden for moments would be 25 lines, and hide what matters."""
    statuses = [("lost",), ("held: a", "held: b"), ("held: b",), ("lost", "b: far")]
    found = summary(
        replace(tracked.motion, report=replace(tracked.motion.report, statuses=statuses))
    )
    lines = [line for line in found.splitlines() if line.startswith("status")]
    expected = ("lost (2 samples)", "held: b (2 samples), a (1)", "b: far (1 samples)")
    assert [line.split(maxsplit=1)[1] for line in lines] == list(expected)


def off_by(motion: Motion, metres: float, share: float) -> Motion:
    """The motion, as if its body were so far off the head's marker in a share of the samples."""
    errors = motion.report.marker_errors.copy()
    errors[: int(share * len(errors)), 0] = metres
    return replace(motion, report=replace(motion.report, marker_errors=errors))


def test_a_body_far_off_its_markers_is_reported(tracked):
    lost = off_by(tracked.motion, 1.59, 0.8)
    sentence = "the position error of marker 'Head' is 159 cm in the median, so the body was not"
    assert f"warning  {sentence}" in summary(lost)
    assert misfit(lost) == figures(lost)["misfit"] and misfit(lost).startswith(sentence)


@pytest.mark.parametrize(("metres", "share"), [(0.0, 0.0), (0.04, 1.0), (1.59, 0.4), (np.nan, 1.0)])
def test_a_body_near_its_markers_most_of_the_time_is_not(tracked, metres, share):
    motion = off_by(tracked.motion, metres, share)
    assert misfit(motion) is None and figures(motion)["misfit"] is None
    assert "in the median" not in summary(motion)


def test_a_marker_that_is_off_in_half_of_the_samples_is_named(tracked):
    motion = off_by(tracked.motion, 0.2, 0.8)
    assert "half of the samples: Head (20 cm)" in summary(motion)
    assert misfit(motion, MISFIT_M) is None


# Judging -----------------------------------------------------------------------------------------


def test_a_motion_is_evaluated_against_points_in_memory_and_in_a_file(written, tracked):
    recording = small_recording()
    truth = Markers(recording.times, tuple(PLACES), recording.positions_world)
    errors = evaluate(tracked.motion, truth, WRISTS)
    assert len(errors.times) == SAMPLES and errors.mean < 0.02
    turned = Markers(recording.times, tuple(PLACES), recording.positions_world[..., [1, 2, 0]])
    assert evaluate(tracked.motion, turned, WRISTS, up="y").mean == pytest.approx(errors.mean)
    own = evaluate(tracked.motion, written / "joints.trc", {"wrist_l": "wrist_l"})
    assert own.mean < 1e-5
    with pytest.raises(InputError, match="no marker 'Nose', expected one of Head"):
        evaluate(tracked.motion, truth, {"wrist_l": "Nose"})
    with pytest.raises(ValueError, match="up = 'x'"):
        evaluate(tracked.motion, truth, WRISTS, up="x")


def test_a_real_recording_is_tracked_from_memory(recordings):
    complete = Recording.load(recordings / "balancing" / "recording_cam_01.toml")
    video, count = open_video(complete.videos[0]), 12
    images = [frame for _, (_, frame) in zip(range(count), video.frames(), strict=False)]
    source = replace(complete.videos[0], path=None, frames=(video.times[:count], images))
    recording = replace(
        complete,
        times=complete.times[:count],
        positions_world=complete.positions_world[:count],
        videos=(source,),
    )
    motion = track(recording)
    assert "calibration 1088" in motion.report.run.warnings[0]
    truth = read_markers(recordings / "balancing" / "truth.trc")
    pairs = WRISTS | {"vertex": "Head"}
    distances = evaluate(motion, truth, pairs).distances
    assert distances.shape == (count, 3) and distances.max() < 0.02
    elbows = evaluate(motion, truth, {"elbow_l": "LElbow", "elbow_r": "RElbow"})
    assert elbows.mean < 0.2
    assert np.isfinite(motion.report.arm_costs).all()
