"""Devices that repeat the last place of what they have lost, or exchange two labels."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from played_markers import NAMES, played

from jaxmocap.body.skeleton import Skeleton
from jaxmocap.capture.filters import filter_markers
from jaxmocap.capture.frozen_markers import FROZEN_S, find_frozen, frozen_step, initial_state
from jaxmocap.capture.streams.osc import MarkerMessage
from jaxmocap.capture.streams.sample_assembly import MarkerSample, SampleAssembler
from jaxmocap.formats.recordings.marker_places import MarkerPlace
from jaxmocap.formats.recordings.recording import Recording, load_recording, write_recording
from jaxmocap.formats.time_series.csv import write_csv
from jaxmocap.formats.time_series.exchanged import undo_exchanges
from jaxmocap.formats.time_series.markers import read_markers
from jaxmocap.formats.time_series.tables import Markers

RATE = 90.0
LEFT, RIGHT = 1, 2


# Frozen ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(5))
def test_who_repeats_the_last_place_is_frozen_from_the_first_repeat_on(seed):
    times, points = played(seed)
    first, after = 200 + 20 * seed, 380
    points[first:after, RIGHT] = points[first, RIGHT]
    # A device may also leave some of these out.
    points[first + 10 : first + 13, RIGHT] = np.nan
    expected = np.zeros(points.shape[:2], bool)
    expected[first + 1 : after, RIGHT] = True
    expected[first + 10 : first + 13] = False
    np.testing.assert_array_equal(find_frozen(times, points), expected)


@pytest.mark.parametrize("seed", range(3))
def test_sample_by_sample_it_is_frozen_once_it_has_repeated_for_long_enough(seed):
    times, points = played(seed)
    points[200:380, RIGHT] = points[200, RIGHT]
    state, found = initial_state(3), []
    for time, sample in zip(times, points, strict=True):
        state, is_frozen = frozen_step(state, time, sample)
        found.append(is_frozen)
    frozen = np.array(found)
    np.testing.assert_array_equal(find_frozen(times, points, causal=True), frozen)
    rows = np.flatnonzero(frozen[:, RIGHT])
    assert rows[-1] == 379 and FROZEN_S <= times[rows[0]] - times[200] < FROZEN_S + 2 / RATE
    assert not frozen[:, :RIGHT].any()


def test_an_animation_that_comes_to_rest_and_one_that_never_moves_are_not_frozen():
    times = np.arange(360) / RATE
    share = np.clip(times - 1, 0, 1)
    eased = (3 * share**2 - 2 * share**3)[:, None, None] * np.array([[[0.5, 0.3, 0.1]]])
    assert not find_frozen(times, eased).any()
    assert not find_frozen(times, np.full((360, 2, 3), 1.5)).any()


def test_a_marker_that_was_never_measured_is_not_frozen():
    points = np.random.default_rng(0).normal(size=(40, 2, 3))
    points[:, 1] = np.nan
    assert not find_frozen(np.arange(40) / RATE, points).any()


@pytest.mark.parametrize("step", [1e-3, 1e-4])
def test_coarse_coordinates_repeat_at_rest_and_are_not_frozen(step):
    times, points = played(0, noise=False)
    points[300:] = points[300]
    points = np.round(points / step) * step
    assert not find_frozen(times, points).any()


@given(st.integers(0, 5), st.floats(0.0, 1.0))
@settings(max_examples=20, deadline=None)
def test_what_was_measured_is_never_frozen(seed, share_missing):
    times, points = played(seed)
    rng = np.random.default_rng(seed)
    points[rng.random(points.shape[:2]) < 0.9 * share_missing] = np.nan
    assert not find_frozen(times, points).any()


def test_frozen_samples_are_missing_afterwards_and_the_report_counts_them():
    times, points = played(1)
    points[200:380, RIGHT] = points[200, RIGHT]
    bones = ("head", "hand_l", "hand_r")
    places = tuple(MarkerPlace(n, b) for n, b in zip(NAMES, bones, strict=True))
    recording = Recording(Skeleton.human(), times, points, places)
    after, cleaning = filter_markers(recording)
    assert np.isnan(after.positions_world[201:380, RIGHT]).all()
    assert np.isfinite(after.positions_world).all(-1).sum() == 540 * 3 - 179
    assert cleaning.figures()["samples"]["wrist_r"]["frozen"] == 179
    assert cleaning.statuses(300) == ("marker wrist_r was frozen",)
    assert "wrist_r repeats its last place in 179 samples" in cleaning.warnings[0]
    clean, cleaning = filter_markers(replace(recording, positions_world=played(1)[1]))
    assert cleaning.warnings == () and cleaning.figures() == {"on": {}}
    assert np.isfinite(clean.positions_world).all()


def test_a_live_stream_measures_no_point_where_a_marker_is_frozen():
    times, points = played(2)
    points[200:380, RIGHT] = points[200, RIGHT]
    samples: list[MarkerSample] = []
    gathers = SampleAssembler(NAMES, {}, np.eye(3), samples.append)
    listed = []
    for time, sample in zip(times, points, strict=True):
        messages = [
            MarkerMessage((name,), tuple(place), None)
            for name, place in zip(NAMES, sample.tolist(), strict=True)
        ]
        gathers.add(messages, float(time), float(time), is_complete=True)
        listed.append(gathers.frozen_markers())
    gone = ~np.isfinite([sample.positions_world for sample in samples]).all(-1)
    np.testing.assert_array_equal(gone, find_frozen(times, points, causal=True))
    assert listed[300] == ["wrist_r"] and listed[199] == listed[400] == []
    # What is recorded is what came.
    measured = samples[300].measurements
    assert measured is not None
    np.testing.assert_allclose(measured.positions_world, points[300])


# Exchanged ---------------------------------------------------------------------------------------


def exchanged(points: np.ndarray, *rows: int) -> np.ndarray:
    """The same, of which both hands' labels change at rows."""
    result = points.copy()
    for row in rows:
        result[row:, [LEFT, RIGHT]] = result[row:, [RIGHT, LEFT]]
    return result


@pytest.mark.parametrize("seed", range(5))
def test_labels_that_change_places_are_those_of_most_samples(seed):
    times, points = played(seed)
    turned = np.linspace(0, 1, 540 * 9).reshape(540, 1, 3, 3) + np.arange(3)[None, :, None, None]
    apart = np.linalg.norm(points[:, LEFT] - points[:, RIGHT], axis=-1)
    rows = [r for r in (120, 350, 351, 400) if apart[r] > 0.25]
    wrong = Markers(times, NAMES, exchanged(points, *rows), orientations=exchanged(turned, *rows))
    starts, ends = [0, *rows], [*rows, 540]
    right = sum(end - start for start, end in zip(starts[::2], ends[::2], strict=True))
    is_right = 2 * right > 540
    mended, sentences = undo_exchanges(wrong)
    for found, true in ((mended.positions, points), (mended.orientations, turned)):
        assert found is not None
        np.testing.assert_array_equal(found, true if is_right else exchanged(true, 0))
    assert len(sentences) == 1 and f"{len(rows)} times" in sentences[0]
    assert "wrist_l and wrist_r exchange" in sentences[0]


def test_labels_may_change_while_both_are_missing_for_a_moment():
    times, points = played(3)
    wrong = exchanged(points, 350)
    wrong[347:352, LEFT] = wrong[348:350, RIGHT] = np.nan
    mended, sentences = undo_exchanges(Markers(times, NAMES, wrong))
    assert len(sentences) == 1
    is_there = np.isfinite(mended.positions)
    np.testing.assert_array_equal(mended.positions[is_there], points[is_there])


@pytest.mark.parametrize("seed", range(3))
def test_hands_that_move_fast_jump_alone_or_cross_are_not_exchanged(seed):
    times, points = played(seed)
    spiked = points.copy()
    spiked[300, RIGHT] += 0.5
    # Both leap, to elsewhere.
    spiked[350:, [LEFT, RIGHT]] += 0.6
    crossing = points.copy()
    share = np.clip(times - 2, 0, 1)[:, None]
    crossing[:, LEFT] = (1 - share) * points[:, LEFT] + share * points[:, RIGHT]
    crossing[:, RIGHT] = (1 - share) * points[:, RIGHT] + share * points[:, LEFT]
    for positions in (points, spiked, crossing):
        markers = Markers(times, NAMES, positions)
        mended, sentences = undo_exchanges(markers)
        assert mended is markers and sentences == ()


def test_real_markers_are_neither_frozen_nor_exchanged(recordings):
    files = [recordings / "motions" / "tennis_serve.c3d", recordings / "balancing" / "markers.trc"]
    files += sorted((recordings / "people").glob("person_*/*.trc"))
    assert len(files) > 10
    for file in files:
        markers = read_markers(file)
        assert not find_frozen(markers.times, markers.positions).any(), file
        assert undo_exchanges(markers)[1] == (), file


def test_a_recording_names_the_labels_that_change(tmp_path):
    times, points = played(0)
    wrong = exchanged(points, 350)
    write_csv(tmp_path / "m.csv", times, dict(zip(NAMES, np.moveaxis(wrong, 1, 0), strict=True)))
    on = {"vertex": {"bone": "head"}, "wrist_l": {"bone": "hand_l"}, "wrist_r": {"bone": "hand_r"}}
    recording = load_recording(write_recording(tmp_path, "m.csv", on))
    np.testing.assert_allclose(recording.positions_world, points, atol=1e-5)
    warning = next(each for each in recording.warnings if "exchange" in each)
    assert "recording.toml: markers wrist_l and wrist_r exchange" in warning
    assert f"first at {times[350]:.2f} s" in warning
