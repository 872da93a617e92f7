"""A recording that no camera shows: smoothed by its markers, in stretches where it is long."""

import re
from dataclasses import replace

import numpy as np
import pytest
from painted_motion import PERSON, places_of, points_of, truth

from bench.people import FIGURES, learned, measure, walks
from jaxmocap.body.motion import Motion
from jaxmocap.body.skeleton import landmark_rows
from jaxmocap.evaluation.series import second_difference
from jaxmocap.formats.recordings.recording import MarkerPlace, Recording
from jaxmocap.hybrid.settings import Settings
from jaxmocap.pipelines.tracking.track import track, track_both
from jaxmocap.smoothing import markers_alone

COUNT, RATE, NOISE_M = 90, 30, 0.001
PLACES = {"Head": "head", "LWrist": "radius_l", "RWrist": "radius_r"}


@pytest.fixture(scope="module")
def recording() -> Recording:
    """Head and wrists of somebody whose arms are busy, and who is lost for half a second."""
    noise = np.random.default_rng(0).normal(0, NOISE_M, (COUNT, 3, 3))
    positions = np.asarray(places_of(truth(COUNT))) + noise
    positions[40:55, 1] = np.nan
    places = tuple(MarkerPlace(name, bone) for name, bone in PLACES.items())
    return Recording(PERSON, np.arange(COUNT) / RATE, positions, places)


def test_markers_alone_are_smoothed_and_say_how_sure_they_are(recording):
    smoothed, raw = (track(recording, Settings(smooth=smooth)) for smooth in (True, False))
    assert shaking(smoothed) < 0.7 * shaking(raw)
    wrists = landmark_rows(("wrist_l", "wrist_r"))
    expected = points_of(truth(COUNT))[:, wrists]
    deviations = smoothed.report.landmarks_std
    assert np.isfinite(deviations).all() and np.isnan(raw.report.from_prior).all()
    found = np.stack([smoothed.joints()[f"wrist_{side}"] for side in "lr"], 1)
    off, stated = (np.linalg.norm(v, axis=-1) for v in (found - expected, deviations[:, wrists]))
    # Where a marker is there it holds its wrist, and where it is gone the deviation says so.
    assert off[:40].max() < 0.01 and stated[:40].max() < 0.02
    assert stated[47, 0] > 0.05 and off[40:55, 0].max() < 3 * stated[47, 0]


def test_who_goes_on_while_no_marker_is_there_is_followed_through_the_gap(recording):
    way = np.array([[[1.0, 0.0, 0.0]]]) * recording.times[:, None, None]
    positions, gap = recording.positions_world + way, slice(36, 60)
    positions[gap] = np.nan
    found = track(replace(recording, positions_world=positions))
    rows = landmark_rows(("pelvis", "vertex"))
    expected = (points_of(truth(COUNT)) + way)[gap, rows]
    joints = np.stack([found.joints()[name][gap] for name in ("pelvis", "vertex")], 1)
    off = np.linalg.norm(joints - expected, axis=-1)
    assert off.max() < 0.15


def shaking(motion: Motion) -> float:
    """Root mean square of an elbow's acceleration, m/s^2."""
    accelerations = second_difference(motion.times, motion.joints()["elbow_r"])
    return float(np.sqrt(np.mean(accelerations**2)))


def test_long_recordings_are_solved_in_stretches_as_if_at_once(recording, monkeypatch):
    whole = track(recording)
    monkeypatch.setattr(markers_alone, "STRETCH", 30)
    monkeypatch.setattr(markers_alone, "REACH_S", 0.7)
    parts = track(recording)
    # Proportions are of every third sample.
    np.testing.assert_allclose(parts.skeleton.lengths, whole.skeleton.lengths, rtol=0.01)
    joints = [np.stack(list(motion.joints().values())) for motion in (whole, parts)]
    apart = np.linalg.norm(joints[0] - joints[1], axis=-1)
    assert np.median(apart) < 0.003 and np.max(apart) < 0.03
    ratio = parts.report.landmarks_std / whole.report.landmarks_std
    assert 0.8 < np.median(ratio) < 1.25


def test_why_of_a_long_recording_says_what_is_stated(recording, monkeypatch):
    """Of every fifth sample."""
    monkeypatch.setattr(markers_alone, "STRETCH", 18)
    monkeypatch.setattr(markers_alone, "REACH_S", 0.7)
    report = track_both(recording, why=True).motion.report
    rows = landmark_rows(("pelvis", "elbow_r", "knee_l"))
    stated = np.median(np.linalg.norm(report.landmarks_std, axis=-1), 0)[rows]
    left_out = report.run.deviations_without_m
    nothing = [left_out[name]["nothing"] for name in ("pelvis", "elbow_r", "knee_l")]
    np.testing.assert_allclose(nothing, stated, rtol=0.25)


@pytest.mark.parametrize("count", [1, 2, 4])
def test_why_of_a_few_samples_leaves_out_what_determines_nothing(recording, count):
    few = replace(recording, times=recording.times[:count],
                  positions_world=recording.positions_world[:count])  # fmt: skip
    report = track_both(few, why=True).motion.report
    assert np.isfinite(report.landmarks_std).all()
    left_out = report.run.deviations_without_m
    assert all(np.isfinite(own["nothing"]) for own in left_out.values())


# Centimetres of one person by habits of the five others; without habits elbows are 6.6 off.
MOST = {"elbow": 5.5, "shoulder": 5.0, "hip": 6.0, "knee": 9.5}


def test_a_walker_is_tracked_by_what_five_others_do(recordings):
    """Plug-in Gait's joint centres."""
    people = sorted((recordings / "people").glob("person_*"))
    habits = learned([walks(folder) for folder in people if folder.name != "person_03"])
    file = recordings / "people" / "person_03" / "recording_straight_three_height.toml"
    figures = dict(zip(FIGURES, measure(file, habits), strict=True))
    assert figures["acceleration, x"] < 1.3
    for joint, most in MOST.items():
        assert figures[f"{joint}, cm"] < most, joint
        assert figures[f"{joint} within, %"] > 65, joint


def test_live_a_walkers_elbows_shake_hardly_more_than_they_do(recordings):
    """Each solve of the newest samples begins where the last one ended, and as fast."""
    file = recordings / "people" / "person_11" / "recording_turn_three_height.toml"
    figures = dict(zip(FIGURES, measure(file, mode="causal"), strict=True))
    assert figures["acceleration, x"] < 1.5


def test_noisy_markers_are_stated_to_be_so(recording):
    noise = np.random.default_rng(1).normal(0, 0.02, (COUNT, 3, 3))
    motion = track(replace(recording, positions_world=recording.positions_world + noise))
    rows = landmark_rows(("wrist_l", "wrist_r"))
    off = np.stack([motion.joints()[f"wrist_{side}"] for side in "lr"], 1)
    off -= points_of(truth(COUNT))[:, rows]
    stated = motion.report.landmarks_std[:, rows]
    assert np.mean(np.abs(off) < 1.645 * stated) > 0.8
    # Still they are smoothed.
    assert np.sqrt(np.mean(off**2)) < 0.015
    (warning,) = motion.report.run.warnings
    shake = re.fullmatch(r"the markers shake by (\d+) mm, .*; deviations allow for that", warning)
    assert shake and 17 <= int(shake[1]) <= 23
