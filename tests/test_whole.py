"""A whole recording in two scans: what the steps find one by one, alone and side by side."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from watched_arms import FRONT, MARKERS, PERSON
from waving_arms import RATE, frames, image_of, markers_of, waving

from jaxmocap.hybrid.settings import Settings
from jaxmocap.hybrid.tracker import HybridTracker
from jaxmocap.hybrid.whole import Views, WholeTracker

EVENTS = 9
TIMES = np.arange(EVENTS) / RATE


@pytest.fixture(scope="module")
def tracker():
    return HybridTracker(PERSON, [FRONT], Settings(region=64), MARKERS)


@pytest.fixture(scope="module")
def whole(tracker):
    return WholeTracker(tracker)


@pytest.fixture(scope="module")
def markers_only():
    return WholeTracker(HybridTracker(PERSON, settings=Settings(balance=False), markers=MARKERS))


def clip(first=0):
    """Markers, of which one is lost for two frames, and images at two of three events."""
    markers, images = [], []
    for i, (_, truth, there) in enumerate(frames(EVENTS, first)):
        if i in (4, 5):
            there[1] = np.nan
        markers.append(there)
        images.append(None if i % 3 == 2 else [image_of(truth)])
    return np.stack(markers), images


def stepped(tracker, first=0):
    """State and packed results of the steps one by one."""
    state = tracker.init(markers_of(waving(first / RATE)))
    # Thresholds are remembered from frame to frame.
    tracker.observer = tracker.observer.fresh()
    found = []
    for time, markers, images in zip(TIMES, *clip(first), strict=True):
        state, pose, report = jax.device_get(tracker.step(state, time, markers, images))
        found.append((pose, report))
    return state, jax.tree.map(lambda *parts: np.stack(parts), *found)


def assert_same(found, expected):
    """To float32's tolerance, which iterations that end by a threshold may spread a little."""
    for own, other in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(own, other, atol=2e-3, rtol=2e-3)


def test_two_scans_find_what_the_steps_find(tracker, whole):
    last, expected = stepped(tracker)
    state = tracker.init(markers_of(waving(0)))
    end, poses, reports = whole.run(state, TIMES, *clip())
    assert_same((poses, reports), expected)
    assert_same(end, last)
    # Lost markers are told, and what video found is carried to events without a frame.
    np.testing.assert_array_equal(np.isnan(reports.distances), np.isnan(clip()[0]).any(-1))
    assert np.isnan(reports.arm_costs[2]).all() and np.abs(reports.swivels[2]).max() > 0.01


def test_recordings_side_by_side_are_solved_as_each_by_itself(markers_only):
    tracker, starts = markers_only.tracker, (0, 7)
    shared = tracker.skeleton, None, tracker.settings
    states = [tracker.init(markers_of(waving(first / RATE))) for first in starts]
    begun = jax.tree.map(lambda *parts: jnp.stack(parts), *[(s.pose, s.stance) for s in states])
    markers = np.stack([clip(first)[0] for first in starts]).astype(np.float32)
    over = jax.jit(jax.vmap(markers_only.solved_over_time, (None, None, None, 0, 0)))
    _, together = over(*shared, begun, markers)
    for row, (state, own) in enumerate(zip(states, markers, strict=True)):
        _, alone = markers_only.solve_all(*shared, (state.pose, state.stance), own)
        assert_same(jax.tree.map(lambda part, r=row: part[r], together), alone)


def test_without_cameras_there_is_nothing_to_observe(markers_only):
    state, markers = markers_only.tracker.init(markers_of(waving(0))), clip()[0]
    _, poses, reports = markers_only.run(state, TIMES, markers)
    assert poses.angles.shape[0] == EVENTS
    assert np.nanmax(reports.distances) < 0.02


def test_what_is_seen_is_kept_once(tracker, whole):
    state = tracker.init(markers_of(waving(0)))
    markers, images = clip()
    shared = tracker.skeleton, tracker.cameras, tracker.settings
    _, solved = whole.solve_all(*shared, (state.pose, state.stance), markers.astype(np.float32))
    views = whole.observe_all(images, solved.region)
    assert isinstance(views, Views)
    np.testing.assert_array_equal(views.which, [1, 2, 0, 3, 4, 0, 5, 6, 0])
    assert len(views.fields) == 7 and not views.seen[0].any() and views.seen[1:].all()
