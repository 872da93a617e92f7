"""A whole recording in two scans: what the steps find one by one, alone and side by side."""

from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxmocap.hybrid.first_state import settled, settled_at_once
from jaxmocap.hybrid.scan import EVENTS, Views, solved_over_time
from jaxmocap.pipelines.tracking.scan_events import scanned
from jaxmocap.pipelines.tracking.step_events import stepped
from watched_arms import FRONT, MARKERS, PERSON
from waving_arms import RATE, image_of, markers_of, waving

from jaxmocap.capture.footage import forward_readers, open_footage
from jaxmocap.formats.recordings.recording import MarkerPlace, Recording, VideoSource
from jaxmocap.hybrid.observe import Observation
from jaxmocap.hybrid.settings import RefineSettings, Settings
from jaxmocap.hybrid.tracker import HybridTracker
from jaxmocap.images.regions import Region
from jaxmocap.pipelines.tracking.events import Plan
from jaxmocap.pipelines.tracking.track import make_tracker

SAMPLES = EVENTS + 4
PLACES = (
    MarkerPlace("Head", "head"),
    MarkerPlace("LWrist", "radius_l"),
    MarkerPlace("RWrist", "radius_r"),
)


@pytest.fixture(scope="module")
def recording():
    """Longer than a chunk; a marker is lost for two samples, and one frame cannot be read."""
    times = np.arange(SAMPLES) / RATE
    truth = [waving(time) for time in times]
    positions = np.stack([markers_of(pose) for pose in truth])
    positions[4:6, 1] = np.nan
    shown = [i for i in range(SAMPLES) if i % 3 < 2]
    images: list[Any] = [None if i == 10 else image_of(truth[i]) for i in shown]
    video = VideoSource("front", FRONT, frames=(times[shown], images))
    return Recording(PERSON, times, positions, PLACES, (video,), "waving")


@pytest.fixture(scope="module")
def tracker(recording):
    # Few steps of the simplex: where its minimum is flat, many spread a rounding to millimetres.
    few = replace(Settings(region=64), polish=RefineSettings.create(iterations=5))
    return make_tracker(recording, few)


@pytest.fixture(scope="module")
def both_ways(recording, tracker):
    def gone_through(way, *more):
        videos, _ = open_footage(recording)
        plan, shown = Plan.of(recording, videos, "own"), []
        with forward_readers(videos) as readers:
            found = way(plan, tracker, readers, *more, lambda *call: shown.append(call))
        return found, shown

    return gone_through(scanned), gone_through(stepped, None)


def assert_same(found, expected):
    """To float32's tolerance, over many iterations."""
    for own, other in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(own, other, atol=1e-3, rtol=1e-3)


def test_two_scans_find_what_the_steps_find(both_ways):
    (found, shown), (expected, _) = both_ways
    assert_same((found.refined, found.reports), (expected.refined, expected.reports))
    assert shown == [(EVENTS, SAMPLES), (SAMPLES, SAMPLES)]
    # Lost markers are told, and what video found is carried to events without a frame.
    lost = np.isnan(found.plan.markers_world).any(-1)
    np.testing.assert_array_equal(np.isnan(found.reports.distances), lost)
    assert np.isnan(found.reports.arm_costs[2]).all() and abs(found.reports.swivels[2]).max() > 0.01


def test_two_scans_say_what_the_steps_say(both_ways):
    (found, _), (expected, _) = both_ways
    assert found.said == expected.said
    unread = [i for i, said in enumerate(found.said) if any("cannot be read" in s for s in said)]
    assert unread == [10]


def test_the_body_rests_on_its_first_markers_either_way(recording, tracker, both_ways):
    first = recording.positions_world[0]
    shared = tracker.skeleton, tracker.cameras, tracker.settings
    solving, _ = tracker.scans.compiling((), lambda solved: ())
    found = settled_at_once(tracker, solving(), first)
    assert_same(found, settled(tracker, first))
    again = tracker.solve(*shared, found.pose, found.stance, first.astype(np.float32))
    assert np.abs(again.ik.pose.angles - found.pose.angles).max() < 0.01


def test_recordings_side_by_side_are_solved_as_each_by_itself():
    tracker = HybridTracker(PERSON, settings=Settings(balance=False), markers=MARKERS)
    starts, shared = (0, 7), (tracker.skeleton, None, tracker.settings)
    states = [tracker.init(markers_of(waving(first / RATE))) for first in starts]
    begun = jax.tree.map(lambda *parts: jnp.stack(parts), *[(s.pose, s.stance) for s in states])
    markers = np.stack(
        [[markers_of(waving((first + i) / RATE)) for i in range(9)] for first in starts]
    ).astype(np.float32)
    markers[:, 4:6, 1] = np.nan
    scan = partial(solved_over_time, tracker.solve)
    _, together = jax.jit(jax.vmap(scan, (None, None, None, 0, 0)))(*shared, begun, markers)
    for row, (state, own) in enumerate(zip(states, markers, strict=True)):
        _, alone = tracker.scans.solve_all(*shared, (state.pose, state.stance), own)
        assert_same(jax.tree.map(lambda part, r=row: part[r], together), alone)


def test_what_is_seen_is_kept_once():
    nowhere = Region(np.zeros((1, 2, 2)), np.ones((1, 2)))

    def seen(value):
        return Observation(nowhere, np.full((1, 2, 1, 4, 4), value), np.full((1, 2), value > 0))

    views = Views.of(seen(0.0), [seen(1.0), None, seen(2.0), None])
    np.testing.assert_array_equal(views.which, [1, 0, 2, 0])
    assert views.fields.shape == (5, 1, 2, 1, 4, 4)
    np.testing.assert_array_equal(views.fields[views.which][:, 0, 0, 0, 0, 0], [1, 0, 2, 0])
    np.testing.assert_array_equal(views.seen[views.which][:, 0, 0], [True, False, True, False])
