"""A whole recording in two scans: the steps' own results, alone and side by side."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from small_recording import (
    FRAMES,
    SAMPLES,
    VIDEO_RATE,
    compiled,
    image,
    small_recording,
    with_frames,
)
from watched_arms import MARKERS, PERSON
from waving_arms import RATE, markers_of, waving

from jaxmocap.capture.footage import forward_readers, open_footage
from jaxmocap.compilation.clock import Clock
from jaxmocap.evidence.edges import EdgeFields
from jaxmocap.hybrid.settings import Settings
from jaxmocap.hybrid.step import EVENTS, SOLVE, EventFields, solve_events
from jaxmocap.hybrid.tracker import HybridTracker
from jaxmocap.images.regions import Region
from jaxmocap.pipelines.tracking.events import RecordingEvents
from jaxmocap.pipelines.tracking.first_pass import scan_events, step_events

# The frame that cannot be read.
UNREAD = 5


@pytest.fixture(scope="module")
def recording():
    """Longer than a chunk; a marker is lost for two samples, and one frame cannot be read."""
    whole = small_recording()
    positions = whole.positions_world.copy()
    positions[4:6, 1] = np.nan
    images = [None if i == UNREAD else image(i) for i in range(FRAMES)]
    times = np.arange(FRAMES) / VIDEO_RATE
    return with_frames(replace(whole, positions_world=positions), times, images)


@pytest.fixture(scope="module")
def tracker():
    return compiled()


@pytest.fixture(scope="module")
def both_ways(recording, tracker):
    def gone_through(way):
        videos, _ = open_footage(recording)
        events, shown = RecordingEvents.of(recording, videos, "own"), []
        with forward_readers(videos) as readers:
            actual = way(events, tracker, readers, lambda *call: shown.append(call), Clock())
        return actual, shown

    def step_by_step(events, tracker, readers, show, clock):
        return step_events(events, tracker, readers, None, show, clock)[0]

    return gone_through(scan_events), gone_through(step_by_step)


def assert_same(actual, expected):
    """To float32's tolerance, over many iterations."""
    for own, other in zip(jax.tree.leaves(actual), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(own, other, atol=1e-3, rtol=1e-3)


def test_two_scans_find_what_the_steps_find(both_ways):
    (actual, shown), (expected, _) = both_ways
    # Of an arm that hangs straight the swivel is anything: poses tell where video has the elbow.
    reports = [way.reports._replace(swivels=None) for way in (actual, expected)]
    assert_same((actual.poses, reports[0]), (expected.poses, reports[1]))
    total = len(actual.markers_world)
    # Then backwards by the markers alone, event by event.
    done = [EVENTS, *range(total, 2 * total + 1)]
    assert shown == [(count, 2 * total) for count in done] and total > SAMPLES
    # Lost markers are reported, and what video found is carried to events without a frame.
    lost = np.isnan(actual.markers_world).any(-1)
    np.testing.assert_array_equal(np.isnan(actual.reports.marker_errors), lost)
    blind = np.isnan(actual.reports.outline_px).all(1)
    assert blind.any() and not blind.all() and abs(actual.reports.swivels[blind]).max() > 0.01


def test_two_scans_warn_of_what_the_steps_warn_of(both_ways):
    (actual, _), (expected, _) = both_ways
    assert actual.warnings == expected.warnings
    unread = [i for i, own in enumerate(actual.warnings) if any("cannot be read" in s for s in own)]
    # Every other sample comes before it, and the frames.
    assert unread == [2 * UNREAD + 1 + UNREAD]


def test_the_body_rests_on_its_first_markers(recording, tracker):
    first = recording.positions_world[0]
    actual = tracker.init(first)
    again = SOLVE(
        tracker.model, tracker.settings, actual.pose, actual.feet, first.astype(np.float32)
    )
    assert np.abs(again.ik.pose.angles - actual.pose.angles).max() < 0.01


def test_recordings_side_by_side_are_solved_as_each_by_itself():
    tracker = HybridTracker(PERSON, settings=Settings(balance=False), markers=MARKERS)
    starts, shared = (0, 7), (tracker.model, tracker.settings)
    states = [tracker.init(markers_of(waving(first / RATE))) for first in starts]
    begun = jax.tree.map(lambda *parts: jnp.stack(parts), *[(s.pose, s.feet) for s in states])
    markers = np.stack(
        [[markers_of(waving((first + i) / RATE)) for i in range(9)] for first in starts]
    ).astype(np.float32)
    markers[:, 4:6, 1] = np.nan
    side_by_side = jax.jit(jax.vmap(solve_events, (None, None, 0, 0)))
    _, together = side_by_side(*shared, begun, markers)
    for row in range(len(starts)):
        # Beside nobody else but itself.
        only, own = jax.tree.map(lambda part, r=row: jnp.stack([part[r]] * 2), (begun, markers))
        _, alone = side_by_side(*shared, only, own)
        assert_same(*(jax.tree.map(lambda part, r=r: part[r], each)
                      for each, r in ((together, row), (alone, 0))))  # fmt: skip


def test_the_fields_of_an_image_are_kept_once():
    nowhere = Region(np.zeros((1, 2, 2)), np.ones((1, 2)))

    def fields(value):
        return EdgeFields(nowhere, np.full((1, 2, 1, 4, 4), value), np.full((1, 2), value > 0))

    kept = EventFields.of(fields(0.0), [fields(1.0), None, fields(2.0), None])
    np.testing.assert_array_equal(kept.which, [1, 0, 2, 0])
    assert kept.distances.shape == (5, 1, 2, 1, 4, 4)
    np.testing.assert_array_equal(kept.distances[kept.which][:, 0, 0, 0, 0, 0], [1, 0, 2, 0])
    np.testing.assert_array_equal(kept.available[kept.which][:, 0, 0], [True, False, True, False])
