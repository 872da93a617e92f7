"""The protocol's command: its options, what it keeps, what it demands."""

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest
from small_recording import small_recording

from bench import accuracy
from bench.accuracy import covered, criteria
from bench.clips import REAL_LANDMARKS, Clip, real, synthetic
from bench.evaluation import AccelerationAndLag, Result, Sureness, shaken, sureness_of, wrong_turns
from jaxmocap.body.skeleton import LANDMARKS
from jaxmocap.evaluation.errors import Errors
from jaxmocap.formats.time_series.markers import read_markers
from jaxmocap.formats.time_series.trc import write_trc
from jaxmocap.synthetic.movements.motions import MOTIONS

TIMES = np.arange(90) / 90


def errors(size: float) -> Errors:
    """Both elbows off by so much, metres."""
    offsets = np.zeros((len(TIMES), 2, 3))
    offsets[..., 0] = size
    return Errors(("elbow_l", "elbow_r"), TIMES, offsets)


def result(group: str, name: str, alone: float, video: float, azimuth: float = 0.0) -> Result:
    clip = Clip(group, name, Path("recording.toml"), REAL_LANDMARKS, 0, azimuth)
    before, after = errors(alone), errors(video)
    calm = AccelerationAndLag(np.full(2, 6.0), np.full(2, 6.0), np.full(2, 0.01), np.ones(2))
    turns = wrong_turns(TIMES, before.distances, after.distances)
    off = np.full((len(TIMES), 3), 0.001)
    return Result(clip, before, after, off, turns, calm, calm, 1 / 30, None)


def verdicts(results: list[Result], causal: bool = False) -> dict[str, bool]:
    return {
        criterion.name: criterion.met
        for criterion in criteria({results[0].clip.group: results}, causal)
    }


def test_a_tracker_that_does_it_all_meets_every_criterion():
    cameras = [result("balancing", f"cam_0{i}", 0.0815, 0.045) for i in (1, 2, 3, 4)]
    assert all(verdicts(cameras).values()) and len(verdicts(cameras)) == 9
    thrusts = [result("thrust", "a", 0.15, 0.035)]
    assert all(verdicts(thrusts).values())


def test_one_bad_placement_misses_though_the_mean_is_good():
    good = [result("tennis", f"{i}", 0.15, 0.01, azimuth=0.0) for i in range(9)]
    far = result("tennis", "far", 0.15, 0.03, azimuth=60.0)
    assert verdicts(good)["tennis, mean of each placement"]
    assert not verdicts([*good, far])["tennis, mean of each placement"]


def test_shaking_lateness_and_a_lag_that_is_unknown_each_miss():
    good = result("tennis", "a", 0.15, 0.01)
    shaking = replace(good, calm=replace(good.calm, track=np.full(2, 8.0)))
    assert not verdicts([good, shaking])["tennis, acceleration / reference"]
    assert verdicts([shaking], causal=True)["tennis, acceleration / reference"]
    frozen = replace(good, calm=replace(good.calm, track=np.full(2, 0.6)))
    assert not verdicts([frozen])["tennis, acceleration / reference"]
    for lag in (0.04, -0.04, np.nan):
        late = replace(good, calm=replace(good.calm, lags=np.array([0.0, lag])))
        assert not verdicts([good, late])["tennis, lag"]
    assert verdicts([good])["tennis, lag"]


def test_wrong_turns_miss_by_their_share_and_by_their_length():
    after = errors(0.01)
    after.offsets[10:50, 0, 0] = 0.3
    bad = replace(
        result("tennis", "a", 0.15, 0.01),
        turns=wrong_turns(TIMES, errors(0.15).distances, after.distances),
    )
    actual = verdicts([bad])
    assert not actual["tennis, wrong turns"] and not actual["tennis, recovery"]


def test_an_elbow_astray_is_stated_only_by_a_deviation_that_covers_it():
    off = result("across", "a", 0.15, 0.01)
    off.video.offsets[10:40, 0, 0] = 0.3
    assert off.astray == (0.0, pytest.approx(30 / 90))
    deviations = np.full(off.video.offsets.shape, 0.01)
    deviations[10:20, 0, 0] = 0.2
    sure = Sureness(off.video.joints, off.video.offsets, deviations, np.zeros((90, 2), bool))
    off = replace(off, sureness=sure)
    assert off.astray == (pytest.approx(10 / 90), pytest.approx(20 / 90))
    results = [result("across", "b", 0.2, 0.01), off, off]
    text = accuracy.report({"across": results}, causal=False)
    rows = [line.split() for line in text.splitlines() if line.startswith("across, worst")]
    assert rows[0][2] == "15.0"
    sums = [line.split() for line in text.splitlines() if line.startswith("across, all")]
    assert sums[0][2:] == ["0.22", "0.44"]


def test_confidence_is_demanded_of_each_coordinate_by_itself():
    rng = np.random.default_rng(0)
    offsets = rng.normal(scale=0.01, size=(5000, 2, 3))
    honest = np.full(offsets.shape, 0.01)
    sure = Sureness(("elbow_l", "elbow_r"), offsets, honest, np.zeros((5000, 2), bool))
    results = [replace(result("tennis", "a", 0.15, 0.01), sureness=sure)]
    name = "tennis, truths in the 90 % interval"
    assert verdicts(results)[name]
    narrow = honest.copy()
    narrow[:, 1, 2] = 0.005
    assert not verdicts([replace(results[0], sureness=sure._replace(deviations=narrow))])[name]
    wide = verdicts([replace(results[0], sureness=sure._replace(deviations=2 * honest))])
    assert not wide["tennis, deviation / RMS error"]
    pooled = covered(results * 3)
    assert pooled is not None and (pooled.samples == 15_000).all()
    assert covered([result("tennis", "a", 0.15, 0.01)]) is None


def test_seeds_and_kinds_are_read_as_people_write_them(capsys):
    assert accuracy.seeds("0-3,7") == [0, 1, 2, 3, 7]
    options = accuracy.parser().parse_args(["--only", "tennis,thrust", "--azimuths=-60,60"])
    assert options.only == ["tennis", "thrust"] and options.azimuths == [-60.0, 60.0]
    assert options.seeds == list(range(10))
    with pytest.raises(SystemExit):
        accuracy.parser().parse_args(["--only", "golf"])
    assert accuracy.parser().parse_args([]).only == ["real", *MOTIONS]
    assert "expected of real, tennis" in capsys.readouterr().err


def test_what_was_rendered_is_not_rendered_again(tmp_path):
    (first,) = synthetic("squat", [1], [0.0, 45.0], 0.1, tmp_path)
    assert first.azimuth == 45.0 and first.truth.is_file()
    before = first.path.with_name("video.mp4").stat().st_mtime_ns
    (again,) = synthetic("squat", [1], [0.0, 45.0], 0.1, tmp_path)
    assert again == first
    assert first.path.with_name("video.mp4").stat().st_mtime_ns == before
    assert set(first.landmarks) == set(LANDMARKS) == set(read_markers(first.truth).points())


def test_the_real_references_landmarks_are_in_its_file(recordings):
    clips = real(recordings)
    assert [clip.name for clip in clips] == [f"cam_0{i}" for i in (1, 2, 3, 4)]
    assert set(REAL_LANDMARKS.values()) <= set(read_markers(clips[0].truth).points())
    assert set(REAL_LANDMARKS) <= set(LANDMARKS)
    assert clips[0].pairs == {"elbow_l": "LElbow", "elbow_r": "RElbow"}


def test_noise_shakes_every_coordinate_and_differs_between_seeds():
    recording = small_recording()
    away = shaken(recording, 0.005, 1).positions_world - recording.positions_world
    assert away.std() == pytest.approx(0.005, rel=0.1)
    assert (
        np.abs(shaken(recording, 0.005, 2).positions_world - recording.positions_world - away).max()
        > 0
    )
    assert shaken(recording, 0.0, 1) is recording


@dataclass
class Moved:
    """A motion that is off by a centimetre, with a report of how sure it is."""

    times: np.ndarray
    points: dict[str, np.ndarray]
    report: "Deviations | None"

    def joints(self) -> dict[str, np.ndarray]:
        return self.points

    def deviations(self) -> dict[str, np.ndarray] | None:
        if self.report is None:
            return None
        stated = self.report.landmarks_std
        return {name: stated[:, i] for i, name in enumerate(LANDMARKS)}


@dataclass
class Deviations:
    """What a report says of deviations."""

    landmarks_std: np.ndarray
    from_prior: np.ndarray = field(default_factory=lambda: np.zeros((90, len(LANDMARKS)), bool))


def test_deviations_are_paired_with_their_landmark_and_time(tmp_path):
    truth = {name: np.full((60, 3), float(i)) for i, name in enumerate(LANDMARKS)}
    write_trc(tmp_path / "truth.trc", TIMES[30:], truth)
    points = {name: np.full((90, 3), i + 0.01) for i, name in enumerate(LANDMARKS)}
    deviations = np.arange(90)[:, None, None] + 0.001 * np.arange(len(LANDMARKS))[:, None]
    sureness = Deviations(np.broadcast_to(deviations, (90, len(LANDMARKS), 3)))
    sureness.from_prior[40, 2] = True
    clip = Clip("a", "a", tmp_path / "recording.toml", {"elbow_r": "elbow_r", "head": "head"})
    actual = sureness_of(Moved(TIMES, points, sureness), clip)
    assert actual is not None and actual.landmarks == ("elbow_r", "head")
    np.testing.assert_allclose(actual.offsets, 0.01, atol=1e-6)
    assert actual.deviations[0, 0, 0] == pytest.approx(30 + 0.001 * LANDMARKS.index("elbow_r"))
    assert actual.deviations[5, 1, 2] == pytest.approx(35 + 0.001 * LANDMARKS.index("head"))
    assert np.flatnonzero(actual.from_prior[:, 1]).tolist() == [10]
    assert sureness_of(Moved(TIMES, points, None), clip) is None
