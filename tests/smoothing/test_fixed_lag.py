"""Smoothing with a fixed lag: calm, causal, and complete whatever is missing."""

from dataclasses import replace
from functools import cache, partial, wraps
from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import double, on_device
from drawn_arms import SIZE
from drawn_body import paint, room, with_noise
from hypothesis import given, settings
from hypothesis import strategies as st
from painted_motion import (
    CAMERAS,
    ELBOWS,
    MARKERS,
    PERSON,
    RATE,
    SETTINGS,
    elbow_errors,
    places_of,
    points_of,
    pose_at,
    truth,
    views,
)
from products import coarse_products
from scipy.linalg import block_diag

from jaxmocap.body.arms import ELBOW, GRIP, SHOULDER
from jaxmocap.body.model import Model
from jaxmocap.body.pose import Pose, difference, retract, unpack
from jaxmocap.body.proportions import PROPORTIONS
from jaxmocap.body.skeleton import LANDMARKS, landmark_rows
from jaxmocap.evidence.keypoints import lines_of_sight
from jaxmocap.evidence.markers import MarkerPositions
from jaxmocap.evidence.silhouettes import SilhouetteGrids, Silhouettes
from jaxmocap.geometry.cameras import project
from jaxmocap.hybrid.refine import StepReport
from jaxmocap.smoothing.fixed_lag import FixedLagSmoother, SmoothedPose
from jaxmocap.smoothing.linearise import smooth_poses
from jaxmocap.smoothing.problem import SmoothingProblem, Trajectory, Views
from jaxmocap.smoothing.settings import SmoothingSettings
from jaxmocap.smoothing.window import advance as advancing
from jaxmocap.smoothing.window import solving
from jaxmocap.smoothing.window.advance import DELAY_FRAMES, DELAY_S, advance
from jaxmocap.smoothing.window.arm_search import ArmSearch, search_arms, with_arm_there
from jaxmocap.smoothing.window.elimination import (
    FLOOR,
    Evidence,
    MarginalPrior,
    eliminate,
    point_variances,
    steps_of,
)
from jaxmocap.smoothing.window.state import PLACES, Drawn, init
from jaxmocap.smoothing.window.track import (
    LONGEST_INTERVAL_S,
    STRAY_M,
    Sample,
    markers_at,
    move_near_markers,
)
from jaxmocap.smoothing.window.unmarked import MarkerGaps, add_drift
from jaxmocap.solvers.fading import Fading

COUNT = 24
TIMES = np.arange(COUNT) / RATE


@cache
def images() -> list[np.ndarray]:
    """Of camera 0."""
    wall, poses = room(SIZE), [Pose(*each) for each in zip(*truth(COUNT), strict=True)]
    return with_noise([paint(CAMERAS[0], PERSON, pose, wall).image for pose in poses], 3)


def marked(pose: Pose) -> np.ndarray:
    """Markers (M, 3)."""
    return np.asarray(places_of(jax.tree.map(lambda part: np.asarray(part)[None], pose)))[0]


@cache
def markers() -> np.ndarray:
    """(T, M, 3) of head and wrists."""
    return np.asarray(places_of(on_device(truth(COUNT))), float)


@cache
def shaking() -> Pose:
    """What a first pass may have found: both arms off by another angle in every frame."""
    poses, rng = truth(COUNT), np.random.default_rng(5)
    angles = poses.angles.copy()
    for side in "lr":
        angles[:, PERSON.tree.joint(f"arm_abduct_{side}")] += rng.normal(0, np.radians(12), COUNT)
    return Pose(*(np.asarray(part, np.float32) for part in poses._replace(angles=angles)))


def smoother_of(silhouettes: dict | None = None, **changed: float | int) -> FixedLagSmoother:
    """Of the person and camera 0; other settings of the silhouettes, and of all else."""
    weights = {"deviation": 0.7, "redundancy": 4.0} | (silhouettes or {})
    chosen = SmoothingSettings(
        markers=MarkerPositions(deviation=0.004), silhouettes=Silhouettes(**weights),
        acceleration=3.0,
        mismatch=1.0, **changed,
    )  # fmt: skip
    return FixedLagSmoother(Model.create(PERSON, MARKERS, CAMERAS[0]), chosen)


def at(poses: Pose, i: int) -> Pose:
    return jax.tree.map(lambda part: part[i], poses)


def report(i: int, placed: bool = False) -> StepReport:
    """Of the markers alone."""
    nothing = dict.fromkeys(StepReport._fields, np.zeros(()))
    alone = at(shaking(), 0)._replace(position=shaking().position[i])
    actual = {"marker_pose": alone, "placed": np.bool_(placed)}
    return StepReport(**(nothing | actual))


def steps(
    shown=None, targets=None, smoother=None, placed=(), count=COUNT
) -> list[list[SmoothedPose]]:
    """What is final after each step, and at last what is flushed."""
    smoother = smoother or smoother_of()
    shown = images() if shown is None else shown
    targets = markers() if targets is None else targets
    final = [
        smoother.step(TIMES[i], targets[i], [shown[i]], report(i, i in placed))
        for i in range(count)
    ]
    return [*final, smoother.flush()]


def joined(final: list[list[SmoothedPose]]) -> list[SmoothedPose]:
    return [each for step in final for each in step]


def poses_of(final: list[SmoothedPose]) -> Pose:
    return jax.tree.map(lambda *parts: np.stack(parts), *(each.pose for each in final))


def accelerations(poses: Pose) -> float:
    """Root mean square of the elbows', m/s^2."""
    second = np.diff(points_of(poses)[:, ELBOWS], 2, axis=0) * RATE**2
    return float(np.sqrt(np.mean(second**2)))


@pytest.fixture(scope="module")
def smoothed() -> list[list[SmoothedPose]]:
    return steps()


# What comes out ----------------------------------------------------------------------------------


def test_every_event_comes_out_once_in_order_after_two_video_frames_at_most(smoothed):
    assert [each.number for each in joined(smoothed)] == list(range(COUNT))
    np.testing.assert_allclose([each.time for each in joined(smoothed)], TIMES)
    for i, final in enumerate(smoothed[:-1]):
        assert all(i - each.number <= DELAY_FRAMES for each in final)
    assert len(smoothed[-1]) == DELAY_FRAMES


def test_the_elbows_are_calm_and_nearer_than_the_first_pass_and_at_first_no_worse(smoothed):
    actual = poses_of(joined(smoothed))
    assert accelerations(actual) < 0.15 * accelerations(shaking())
    before, after = elbow_errors(shaking()), elbow_errors(actual)
    assert after[8:].mean() < 0.025 and after[8:].mean() < 0.7 * before[8:].mean()
    actual = poses_of(joined(smoothed)[:6])
    assert elbow_errors(actual).mean() < 1.2 * elbow_errors(shaking())[:6].mean()


def test_deviations_hold_the_truth_and_the_wrists_are_surer_than_the_elbows(smoothed):
    deviations = np.stack([each.deviations for each in joined(smoothed)])
    off = points_of(poses_of(joined(smoothed))) - points_of(truth(COUNT))
    assert np.isfinite(deviations).all() and (deviations > 0).all()
    within = np.abs(off[:, ELBOWS]) < 1.645 * deviations[:, ELBOWS]
    assert within.mean() > 0.8
    points = range(deviations.shape[1])
    wrists = [point for point in points if deviations[8, point].max() < 0.015]
    assert wrists and not set(wrists) & set(ELBOWS)


def test_what_comes_later_changes_nothing_that_is_final(smoothed):
    half = COUNT // 2
    other, moved = list(images()), markers().copy()
    other[half:] = [image[::-1].copy() for image in other[half:]]
    moved[half:] += 0.1
    again = steps(other, moved)
    for one, two in zip(smoothed[:half], again[:half], strict=True):
        assert [each.number for each in one] == [each.number for each in two]
        for a, b in zip(one, two, strict=True):
            np.testing.assert_array_equal(a.pose.angles, b.pose.angles)
            np.testing.assert_array_equal(a.deviations, b.deviations)
    late = [points_of(poses_of(joined(out)[half + 2 :])) for out in (smoothed, again)]
    assert np.abs(late[0] - late[1]).max() > 0.03


# Without markers ---------------------------------------------------------------------------------

# The first frame without.
LEFT_OUT = 8


def away_from_camera(points: np.ndarray) -> np.ndarray:
    """Distances (...) along the axis of camera 0, metres."""
    return points @ np.asarray(CAMERAS[0].T_cam_world)[2, :3]


@pytest.fixture(scope="module")
def unmarked() -> list[SmoothedPose]:
    """Somebody a fifth thicker than is drawn, half a second without any marker."""
    wall, clothed = room(SIZE), replace(PERSON, diameters=PERSON.diameters * 1.2)
    poses = [at(truth(COUNT), i) for i in range(COUNT)]
    frames = with_noise([paint(CAMERAS[0], clothed, pose, wall).image for pose in poses], 3)
    targets = markers().copy()
    targets[LEFT_OUT:] = np.nan
    return joined(steps(shown=frames, targets=targets))


def test_without_markers_the_distance_stays_and_is_less_and_less_sure(unmarked):
    off = away_from_camera(points_of(poses_of(unmarked)) - points_of(truth(COUNT)))
    trunk = landmark_rows(("pelvis", "neck", "vertex"))
    assert np.abs(off[LEFT_OUT:, trunk]).max() < 0.1
    deviations = np.stack([each.deviations for each in unmarked])
    ahead = np.asarray(CAMERAS[0].T_cam_world)[2, :3]
    along = np.linalg.norm(deviations * ahead, axis=-1)
    neck = LANDMARKS.index("neck")
    assert along[-1, neck] > along[LEFT_OUT, neck] + 0.1
    off = np.abs(points_of(poses_of(unmarked)) - points_of(truth(COUNT)))[LEFT_OUT:]
    assert (off < 1.645 * deviations[LEFT_OUT:]).mean() > 0.8


def test_an_arm_is_less_and_less_sure_after_its_own_last_marker():
    gaps, points = MarkerGaps(Model.create(PERSON, MARKERS)), markers()[0].copy()
    gaps.step(0.0, points)
    points[1] = np.nan
    seconds = gaps.step(0.6, points)
    np.testing.assert_allclose(seconds, [0.6, 0, 0])
    before, camera = np.full((len(LANDMARKS), 3), 0.05), np.array([3.0, 0.0, 0.0])
    after = add_drift(before, seconds, np.zeros(3), camera)
    is_wider = after > before + 0.1
    wider = [f"{part}_l" for part in ("elbow", "wrist", "hand")]
    assert [name for name, each in zip(LANDMARKS, is_wider[:, 0], strict=True) if each] == wider
    # Along the line of sight alone.
    np.testing.assert_array_equal(after[:, 1:], before[:, 1:])
    points[:] = np.nan
    assert (add_drift(before, gaps.step(1.2, points), np.zeros(3), camera) > before)[:, 0].all()


# The search --------------------------------------------------------------------------------------


turned = jax.jit(with_arm_there)
SEARCH = jax.jit(partial(search_arms, lines=None))


def with_right_arm_turned(i: int, turn, pivot: int, unmarked: bool = True) -> Pose:
    """The truth, but for the right arm."""
    pose = np.concatenate(at(truth(COUNT), i)).astype(np.float32)
    model, pivots = Model.create(PERSON, MARKERS), np.array([GRIP, pivot], np.int32)
    none = on_device((0.0, 0.0, np.zeros((2, 3, 3))))
    found = ArmSearch(np.int32(1), np.array(turn, np.float32), *none, pivots)
    there = turned(model, on_device(pose[None]), found, np.full((1, 2), unmarked))
    return unpack(np.asarray(there)[0])


def lost(i: int) -> StepReport:
    """The truth, but for the right forearm: turned about its hand by a radian."""
    return report(i)._replace(marker_pose=with_right_arm_turned(i, (-1.0, 0.0, 0.0), GRIP, False))


@pytest.mark.parametrize("pivot", [SHOULDER, ELBOW])
def test_an_arm_without_a_marker_is_searched_for_about_its_joints(pivot):
    away = with_right_arm_turned(4, (0.0, -0.8, 0.0), pivot)
    model, both = Model.create(PERSON, MARKERS, CAMERAS), np.ones(2, bool)
    grids = on_device(views(COUNT, (0, 1), [4]).grids, jnp.float32)
    at_joint = np.array([GRIP, pivot], np.int32)
    found = SEARCH(model, SETTINGS, on_device(away, jnp.float32), both, grids, pivots=at_joint)
    end = LANDMARKS.index("wrist_r")

    def off(pose: Pose) -> float:
        points = points_of(jax.tree.map(lambda part: np.asarray(part)[None], pose))[0]
        return float(np.linalg.norm(points[end] - points_of(truth(COUNT))[4, end]))

    def there(unmarked: bool) -> Pose:
        packed = np.concatenate(away).astype(np.float32)[None]
        return unpack(np.asarray(turned(model, packed, found, np.full((1, 2), unmarked)))[0])

    assert int(found.side) == 1 and float(found.gain) > 10
    assert off(there(True)) < 0.3 * off(away)
    # Where a marker holds the hand, no joint is turned.
    assert off(there(False)) == pytest.approx(off(away), abs=1e-5)


def test_an_arm_that_is_lost_is_found_again():
    smoother, final = smoother_of(), []
    for i in range(COUNT):
        final += smoother.step(TIMES[i], markers()[i], [images()[i]], lost(i))
    begun = jax.tree.map(lambda *parts: np.stack(parts), *(lost(i).marker_pose for i in range(8)))
    assert elbow_errors(begun).max(1).min() > 0.15
    found = elbow_errors(poses_of([*final, *smoother.flush()]))
    assert found[-8:].max() < 0.05


def test_a_body_whose_arm_is_elsewhere_stays_where_it_was_before(monkeypatch):
    """While no marker is measured nothing else holds it."""
    smoother = smoother_of()
    for i in range(8):
        smoother.step(TIMES[i], markers()[i], [images()[i]], report(i))
    none, far = np.zeros((2, 3, 3), np.float32), np.float32(1.0)
    turn, pivots = np.zeros(3, np.float32), np.full(2, GRIP, np.int32)
    found = ArmSearch(np.int32(0), turn, far, far, none, pivots)
    monkeypatch.setattr(advancing, "search_arms", lambda *_: jax.tree.map(jnp.asarray, found))
    monkeypatch.setattr(advancing, "RIVAL_GAIN", -1e9)
    state = smoother._state
    measured = state.events.measured
    measured = measured._replace(markers=np.full_like(measured.markers, np.nan))
    events = state.events._replace(measured=measured)
    within = smoother.model, smoother.settings
    solved = jax.jit(partial(advancing._solve_window, *within))
    own, rival = (
        solved(state._replace(events=events, searched=np.int32(searched)))[1].poses
        for searched in (0, advancing.SEARCH_EVERY - 1)
    )
    count = int(events.filled)
    own, rival = (points_of(unpack(np.asarray(poses)[:count])) for poses in (own, rival))
    np.testing.assert_allclose(rival, own, atol=0.02)


@pytest.mark.parametrize("seed", range(4))
def test_a_window_that_begins_far_off_does_not_diverge(seed):
    """Derivatives tell little of a step of half a radian."""
    smoother, rng, count = smoother_of(), np.random.default_rng(seed), 8
    for i in range(count):
        smoother.step(TIMES[i], markers()[i], [images()[i]], report(i))
    state, numbers = smoother._state, [event.number for event in smoother._events]
    offset = rng.normal(0, 0.5, 6 + PERSON.limits.shape[0]).astype(np.float32)
    far = np.concatenate(retract(on_device(unpack(np.asarray(state.events.poses))), offset), 1)
    size = len(offset)
    state = state._replace(
        events=state.events._replace(poses=far),
        drawn=Drawn.never(PLACES, size, np.float32), marginal=MarginalPrior.none(size, np.float32),
    )  # fmt: skip
    there = np.full((PLACES, *markers().shape[1:]), np.nan, np.float32)
    there[: len(numbers)] = markers()[numbers]
    (device,) = smoother.model.skeleton.lengths.devices()
    for _ in range(6):
        # No event leaves. On the smoother's device: else all would compile once more.
        now = jax.device_put(state._replace(given=np.int32(0), stated=np.int32(1)), device)
        after, found = smoother._advance(now, nothing_new(smoother), there, np.bool_(False))
        assert int(found.left) == 0
        state = after
    poses = unpack(np.asarray(found.poses)[: len(numbers)])
    off = np.linalg.norm(np.asarray(places_of(on_device(poses))) - markers()[numbers], axis=-1)
    assert off.max() < 0.2


def test_products_run_at_full_precision():
    smoother = smoother_of()
    smoother.step(TIMES[0], markers()[0], [images()[0]], report(0))
    there = np.zeros((PLACES, *markers().shape[1:]), np.float32)
    within = smoother.model, smoother.settings, smoother._state
    count, coarse = coarse_products(advance, *within, nothing_new(smoother), there, np.bool_(False))
    assert count > 10 and coarse == []


def test_images_of_another_room_are_stated_and_tell_nothing():
    rng = np.random.default_rng(0)
    shown = [*images()[:12], *rng.integers(0, 255, (6, *images()[0].shape), dtype=np.uint8)]
    final = joined(steps(shown=shown, count=18))
    assert [each.unrecognised for each in final[6:]] == [()] * 6 + [(0,)] * 6
    elbows = [np.linalg.norm(each.deviations[ELBOWS], axis=-1).max() for each in final]
    assert elbows[-1] > 1.5 * elbows[9]


@pytest.mark.parametrize("rate", [30, 120])
def test_a_second_of_video_tells_as_much_at_any_rate(rate):
    """Frames err alike: four times as many make nobody surer."""
    smoother = smoother_of()
    smoother.step(TIMES[0], markers()[0], [images()[0]], report(0))
    events = smoother._state.events
    filled = np.zeros(events.since.shape, bool)
    filled[:6] = True
    events = events._replace(
        since=np.where(filled, 1 / rate, 0).astype(np.float32),
        shown=np.broadcast_to(filled[:, None], events.shown.shape),
        filled=np.int32(6),
    )
    share = float(advancing._shares(smoother.settings, events)[0])
    redundancy = float(smoother.settings.silhouettes.redundancy)
    assert share * redundancy == pytest.approx(30 / rate, rel=1e-4)


def nothing_new(smoother: FixedLagSmoother):
    return smoother._news._replace(filled=np.int32(0))


def test_an_arm_that_cameras_do_not_show_may_be_anywhere():
    hidden = smoother_of({"person": 0.0, "forearms": 0.0})
    shown, unseen = (joined(steps(smoother=own, count=14)) for own in (smoother_of(), hidden))
    elbows = [np.linalg.norm(each[11].deviations[ELBOWS], axis=-1) for each in (shown, unseen)]
    assert (elbows[0] < 0.5 * elbows[1]).all() and elbows[1].min() > 0.1


def test_samples_that_follow_a_frame_closely_lie_on_the_track_beside_their_markers():
    smoother, shown, out, count = smoother_of(), images(), [], 12
    between = (markers()[:-1] + markers()[1:]) / 2
    for i in range(count):
        assert not smoother.lies_between(TIMES[i], [shown[i]], markers()[i])
        out += smoother.step(TIMES[i], markers()[i], [shown[i]], report(i))
        later = TIMES[i] + 0.4 / RATE
        assert smoother.lies_between(later, None, between[i])
        assert not smoother.lies_between(later, None, between[i] + 1.5)
        out += smoother.step(later, between[i], None, None)
    out += smoother.flush()
    assert [each.number for each in out] == list(range(2 * count))
    assert (np.diff([each.time for each in out]) > 0).all()
    poses = poses_of(out)
    points = places_of(poses)
    # The last one has no event after it.
    off = np.linalg.norm(np.asarray(points)[1:-1:2] - between[: count - 1], axis=-1)
    assert off.max() < STRAY_M + 1e-3
    elbows = points_of(poses)[:, ELBOWS]
    ways = elbows[:-2:2], elbows[1:-1:2], elbows[2::2]
    before, there, after = (np.asarray(each) for each in ways)
    longest = np.linalg.norm(after - before, axis=-1) + 0.01
    assert (np.linalg.norm(there - before, axis=-1) < longest).all()
    assert (np.linalg.norm(there - after, axis=-1) < longest).all()


def test_a_frame_between_two_samples_has_the_markers_that_lie_there():
    smoother, shown, count = smoother_of(), images(), 12
    nothing = np.full_like(markers()[0], np.nan)
    for i in range(1, count):
        if i > 1:
            middle = (markers()[i - 1] + markers()[i]) / 2
            smoother.step(TIMES[i] - 0.5 / RATE, middle, None, None)
        smoother.step(TIMES[i], nothing, [shown[i]], report(i))
    events = smoother._events
    for event in events[:-1]:
        there = markers()[np.searchsorted(TIMES, event.time - 1e-9)]
        assert np.abs(event.markers_world - there).max() < 5e-3
    # Beyond the last sample they go straight on.
    assert np.abs(events[-1].markers_world - markers()[count - 1]).max() < 0.02


@given(st.floats(0, 0.11), st.integers(0, 3))
def test_markers_of_a_straight_motion_are_where_they_go(time, missing):
    at = np.arange(4) * 0.03
    samples = [Sample(i, t, np.array([[t, 2 * t, 1.0], [0, 0, t]])) for i, t in enumerate(at)]
    assert np.allclose(
        markers_at(samples, np.array([time]))[0], [[time, 2 * time, 1.0], [0, 0, time]], atol=1e-6
    )
    samples[missing].markers_world[0] = np.nan
    found = markers_at(samples, np.array([time]))[0]
    assert np.allclose(found[1], [0, 0, time], atol=1e-6)
    # By its other samples, unless the last two of them are too long ago.
    newest, before = np.delete(at, missing)[[-1, -2]]
    expected = [time, 2 * time, 1.0] if time <= 2 * newest - before else [np.nan] * 3
    assert np.allclose(found[0], expected, atol=1e-6, equal_nan=True)


@pytest.mark.parametrize(("before", "is_known"), [(0.02, True), (0.05, False), (0.3, False)])
def test_a_marker_that_comes_again_is_not_followed_backwards(before, is_known):
    rng, at = np.random.default_rng(2), 1 + np.arange(12) * 0.03
    path = np.cumsum(rng.normal(0, 0.005, (12, 1, 3)), 0)
    samples = [Sample(i, t, own) for i, (t, own) in enumerate(zip(at, path, strict=True))]
    (found,) = markers_at(samples, np.array([1 - before]))
    if is_known:
        assert np.abs(found[0] - path[0]).max() < 0.02
    else:
        assert np.isnan(found).all()


@pytest.mark.parametrize("rate", [100, 120])
def test_samples_that_lie_between_come_out_at_a_flush(rate):
    """Of a camera that has brought nothing yet."""
    smoother, out, count = smoother_of(), [], 20
    for i in range(count):
        out += smoother.step((i + 1) / rate, markers()[0], [None], report(0))
    out += smoother.flush()
    assert [each.number for each in out] == list(range(count))


def test_devices_that_send_in_turn_have_their_own_samples():
    nothing = np.full(3, np.nan)
    rows = [[[t, 0, 0], nothing] if i % 2 else [nothing, [0, t, 0]] for i, t in enumerate(TIMES)]
    samples = [Sample(i, TIMES[i], np.array(row)) for i, row in enumerate(rows)]
    time = (TIMES[-3] + TIMES[-2]) / 2
    assert np.allclose(
        markers_at(samples, np.array([time]))[0], [[time, 0, 0], [0, time, 0]], atol=1e-6
    )


def test_markers_at_many_times_are_those_at_each():
    rng = np.random.default_rng(0)
    points = rng.normal(size=(12, 2, 3))
    points[rng.uniform(size=(12, 2)) < 0.2] = np.nan
    at = np.cumsum(rng.choice([0.01, 0.03, 0.15], 12))
    samples = [Sample(i, time, each) for i, (time, each) in enumerate(zip(at, points, strict=True))]
    times = np.linspace(at[0], at[-1] + 0.1, 40)
    each = np.concatenate([markers_at(samples, times[i : i + 1]) for i in range(len(times))])
    np.testing.assert_array_equal(markers_at(samples, times), each)
    assert np.isfinite(each).all(-1).any() and np.isnan(each).any()


def test_markers_beyond_a_gap_are_unknown():
    far = [Sample(i, t, np.zeros((1, 3))) for i, t in enumerate((0.0, 2 * LONGEST_INTERVAL_S))]
    assert np.isnan(markers_at(far, np.array([LONGEST_INTERVAL_S]))[0]).all()
    near = [Sample(i, t, np.zeros((1, 3))) for i, t in enumerate((0.0, 0.01))]
    assert (
        np.isnan(markers_at(near, np.array([0.03]))[0]).all()
        and np.isfinite(markers_at(near, np.array([0.015]))[0]).all()
    )


@pytest.mark.parametrize("x", [2.3, 2.59, 2.6, 2.61, 3.5, 90.0, -90.0, 1e6])
def test_a_body_that_is_put_into_the_camera_or_far_away_is_looked_at(x):
    """As a device's absurd position puts it."""
    measured, pose = smoother_of()._appearances[0], unpack(np.concatenate(pose_at(0.0)))
    for y in (0.4, 90.0):
        away = pose._replace(position=np.array([x, y, 0.9], np.float32))
        frame = measured.measure(images()[0], away, 0.8)
        assert all(np.isfinite(part).all() for part in jax.tree.leaves(frame.grids))
        measured.learn(frame, SIZE, away)


# What is missing ---------------------------------------------------------------------------------


def test_missing_markers_images_and_grey_images_are_bridged(smoothed):
    shown, targets = list(images()), markers().copy()
    shown[5] = shown[6] = None
    shown[9] = np.zeros_like(shown[9])
    targets[8:11, 1], targets[13] = np.nan, np.nan
    out = joined(steps(shown, targets))
    assert [each.number for each in out] == list(range(COUNT))
    assert all(np.isfinite(part).all() for part in poses_of(out))
    assert elbow_errors(poses_of(out))[8:].mean() < 0.04


def test_without_any_image_or_with_black_ones_poses_come_out_all_the_same(smoothed):
    out = steps([None] * COUNT)
    assert [each.number for each in joined(out)] == list(range(COUNT))
    assert all(each.from_prior[ELBOWS].all() for each in joined(out))
    # Not all of them at the end.
    assert len(joined(out[:-1])) > COUNT // 2
    black = steps([np.full_like(image, 5) for image in images()])
    for own, expected in zip(poses_of(joined(black)), poses_of(joined(out)), strict=True):
        np.testing.assert_array_equal(own, expected)
    unlit, lit = (joined(each)[-1].deviations[ELBOWS] for each in (black, smoothed))
    assert (unlit > 1.5 * lit).all()


def test_grey_images_will_do():
    grey = [image.mean(-1).astype(np.uint8) for image in images()[:6]]
    out = joined(steps(grey, count=6))
    assert len(out) == 6 and all(np.isfinite(part).all() for part in poses_of(out))


def test_silhouettes_without_weight_change_nothing():
    weights = {"person": 0.0, "forearms": 0.0}
    upright, turned = (
        poses_of(joined(steps(each, smoother=smoother_of(weights), count=8)))
        for each in (images(), [image[::-1] for image in images()])
    )
    for own, expected in zip(upright, turned, strict=True):
        np.testing.assert_array_equal(own, expected)


def test_key_points_say_where_legs_and_elbows_are():
    """One frame has none; the silhouettes have no weight."""
    points, weights = points_of(truth(COUNT)), {"person": 0.0, "forearms": 0.0}
    pixels = np.asarray(project(CAMERAS[0], jnp.asarray(points)), float)
    lines = lines_of_sight(CAMERAS[0], LANDMARKS, pixels, np.full(pixels.shape[:2], 0.9))
    elbows_and_knees = landmark_rows(("elbow_l", "elbow_r", "knee_l", "knee_r"))

    def off_and_stated(cameras: int) -> tuple[float, float]:
        smoother, final = smoother_of(weights), []
        smoother = FixedLagSmoother(smoother.model, smoother.settings, cameras)
        for i in range(COUNT):
            own = at(lines, i) if cameras and i != 5 else None
            final += smoother.step(TIMES[i], markers()[i], [images()[i]], report(i), own)
        final += smoother.flush()
        assert [each.number for each in final] == list(range(COUNT))
        off = np.linalg.norm(points_of(poses_of(final)) - points, axis=-1)[8:, elbows_and_knees]
        return off.mean(), np.linalg.norm(final[-1].deviations[elbows_and_knees], axis=-1).mean()

    (without, unsure), (with_them, sure) = off_and_stated(0), off_and_stated(1)
    assert with_them < 0.5 * without and sure < 0.8 * unsure
    assert with_them < 1.5 * sure


def test_a_body_that_is_placed_again_begins_a_new_motion():
    out = steps(placed=(6,), count=9)
    assert [each.number for each in joined(out)] == list(range(9))
    assert [each.number for each in out[6]] == [4, 5]


def test_without_a_camera_poses_are_smoothed_a_tenth_of_a_second_late():
    """All samples come out, in order and in time; the elbows shake less, and are stated."""
    smoother = FixedLagSmoother(Model.create(PERSON, MARKERS), SmoothingSettings())
    out = []
    for i in range(COUNT):
        given = smoother.step(TIMES[i], markers()[i], None, report(i))
        assert all(TIMES[i] - each.time <= DELAY_S + 1e-3 for each in given)
        out += given
    assert len(out) > COUNT // 2
    out += smoother.flush()
    assert [each.number for each in out] == list(range(COUNT))
    poses = poses_of(out)
    assert accelerations(poses) < 0.1 * accelerations(shaking())
    off = np.linalg.norm(np.asarray(places_of(poses)) - markers(), axis=-1)
    assert off.max() < STRAY_M + 1e-3
    deviations = np.stack([each.deviations for each in out])
    assert np.isfinite(deviations).all() and (deviations[:, ELBOWS].max(-1) > 0.02).all()


def test_noisy_markers_are_stated_to_be_so():
    """Of somebody who stands still."""

    def smooth(noise: float) -> tuple[float, float]:
        """How far wrists are off, root mean square of the last 40 samples, and are stated to be."""
        rng, out = np.random.default_rng(0), []
        smoother = FixedLagSmoother(Model.create(PERSON, MARKERS), SmoothingSettings())
        for i in range(120):
            there = markers()[0] + rng.normal(0, noise, markers()[0].shape)
            out += smoother.step(i / RATE, there, None, report(0))
        points, wrists = points_of(poses_of(out[-40:])), landmark_rows(["wrist_l", "wrist_r"])
        off = points[:, wrists] - points_of(truth(COUNT))[0, wrists]
        stated = np.stack([each.deviations[wrists] for each in out[-40:]])
        return tuple(float(np.sqrt(np.mean(each**2))) for each in (off, stated))

    off, stated = smooth(0.02)
    assert 0.7 * off < stated and stated > 1.5 * smooth(0.001)[1]


@pytest.mark.parametrize("camera", [None, 0])
def test_samples_that_jump_hundreds_of_times_a_second_find_room(camera):
    """Each is an event, and a window has room for few: what comes is never refused."""
    smoother, count, shown = smoother_of(), 40, images()
    if camera is None:
        smoother = FixedLagSmoother(Model.create(PERSON, MARKERS), SmoothingSettings())
    out = []
    for i in range(count):
        there, image = markers()[0] + np.array([0.0, 0.4 * (i % 2), 0.0]), shown[i % 8]
        # With a camera the first events have frames, and then none has.
        images_now = None if camera is None else [image if i < 20 else None]
        out += smoother.step(i * 0.002, there, images_now, report(i % COUNT))
    out += smoother.flush()
    assert [each.number for each in out] == list(range(count))
    assert all(np.isfinite(part).all() for part in poses_of(out))


# Against the whole recording ---------------------------------------------------------------------


def test_a_window_over_everything_agrees_with_the_second_pass(monkeypatch):
    count = 10
    for name, value in (("DELAY_FRAMES", 99), ("DELAY_S", 99.0), ("KEPT_FRAMES", 99)):
        monkeypatch.setattr(advancing, name, value)
    # What is drawn once is not drawn again for centimetres; here it is to the millimetre.
    monkeypatch.setattr(solving, "NEAR_M", 0.001)
    smoother = smoother_of(proportions=1e9, iterations=60)
    smoother._advance = own = jax.jit(partial(as_it_is, smoother.model, smoother.settings))
    for i in range(count):
        assert not smoother.step(TIMES[i], markers()[i], [images()[i]], report(i))
    events = smoother._events
    grids, start = (
        jax.tree.map(lambda *parts: np.stack(parts), *each)
        for each in zip(*((e.frames[0][1].grids, e.pose) for e in events), strict=True)
    )
    measured = jax.tree.map(lambda part: np.asarray(part[:count]), smoother._state.events.measured)
    # These are as soft already as they are drawn.
    monkeypatch.setattr("jaxmocap.smoothing.linearise.soften_grids", lambda problem, _: problem)
    views = Views(np.arange(count), np.zeros(count, int), SilhouetteGrids(*grids))
    problem = SmoothingProblem(smoother.model, smoother.settings, TIMES[:count], measured, views)
    usual = np.zeros(len(PROPORTIONS), np.float32)
    offline = smooth_poses(problem, Trajectory(start, usual), (solving.SOFTNESS,))
    there = np.full((PLACES, *markers().shape[1:]), np.nan, np.float32)
    there[:count] = markers()[:count]
    for _ in range(30):
        smoother._state, _ = own(smoother._state, nothing_new(smoother), there, np.bool_(False))
    online = poses_of(smoother.flush())
    off = points_of(online) - points_of(offline.trajectory.poses)
    assert np.abs(off).max() < 0.01


# The function itself -----------------------------------------------------------------------------

as_it_is = advance.jitted.__wrapped__


def stacked(*trees):
    return jax.tree.map(lambda *parts: np.stack(parts), *trees)


def test_several_people_go_through_a_scan_at_once_as_each_does_alone():
    people, inputs, states, found = (smoother_of(), smoother_of()), [], [], []
    for away, smoother in enumerate(people):
        own, taken, out = smoother._advance, [], []

        def kept(state, *rest, own=own, taken=taken, out=out):
            after, advanced = own(state, *rest)
            taken.append(rest)
            out.append(np.asarray(advanced.poses[rest[0].filled - 1]))
            return after, advanced

        smoother._advance = kept
        for i in range(6):
            smoother.step(TIMES[i], markers()[i] + 0.02 * away, [images()[i]], report(i))
        inputs.append(stacked(*taken))
        states.append(init(smoother.model, taken[0][0]))
        found.append(np.stack(out))
    both, starts = (
        jax.tree.map(lambda *parts: np.stack(parts), *each) for each in (inputs, states)
    )

    @jax.jit
    @jax.vmap
    def together(state, each):
        def step(state, rest):
            after, advanced = as_it_is(people[0].model, people[0].settings, state, *rest)
            return after, advanced.poses[rest[0].filled - 1]

        return jax.lax.scan(step, state, each)[1]

    poses = np.asarray(together(starts, both))
    np.testing.assert_allclose(poses, np.stack(found), atol=2e-3)
    assert np.abs(poses[0] - poses[1]).max() > 0.01


# The window --------------------------------------------------------------------------------------

N, T, ACCELERATION = 2, 14, 3.0
NO_PRIOR = MarginalPrior(np.zeros((2 * N, 2 * N)), np.zeros(2 * N))


def in_float64(test):
    @wraps(test)
    def run(*arguments, **named):
        with double():
            return test(*arguments, **named)

    return run


def chain(rng: np.random.Generator) -> Evidence:
    """Events of N unknowns, straight-line problems: what is solved once is solved."""
    times = np.cumsum(rng.uniform(0.01, 0.05, T))
    A = rng.normal(size=(T, 6, N)) * rng.uniform(0.1, 3, (T, 1, 1))
    b, J = rng.normal(size=(T, 6)), rng.normal(size=(T, 2, N)) + 2 * np.eye(2)
    hessian, gradient = A.swapaxes(1, 2) @ A, np.einsum("tkn,tk->tn", A, b)
    stencil = np.zeros((T, 3))
    for t, (h1, h2) in enumerate(pairwise(np.diff(times))):
        mean = np.array([1 / h1, -1 / h1 - 1 / h2, 1 / h2]) / ((h1 + h2) / 2)
        stencil[t] = mean * np.sqrt((h1 + h2) / 2) / ACCELERATION
    return Evidence(hessian, gradient, rng.normal(size=(T, 2)), J, stencil)


def dense(evidence: Evidence) -> tuple[np.ndarray, np.ndarray]:
    """Steps (T, N) of the whole chain and variances (T, M) of its points, one by one.

    With the curvature that the window gives every unknown.
    """
    own, slopes, points, jacobians, stencil = map(np.asarray, evidence)
    J, second = block_diag(*jacobians), np.zeros((T - 2, T))
    for t in range(T - 2):
        second[t, t : t + 3] = stencil[t]
    second = np.kron(second, np.eye(2))
    hessian = block_diag(*own) + (second @ J).T @ second @ J + FLOOR * np.eye(T * N)
    gradient = np.ravel(slopes) + (second @ J).T @ second @ np.ravel(points)
    variances = np.diag(J @ np.linalg.inv(hessian) @ J.T)
    return -np.linalg.solve(hessian, gradient).reshape(T, N), variances.reshape(T, 2)


def from_event(evidence: Evidence, first: int) -> Evidence:
    """Without the first so many; what fills up is never looked at."""
    return Evidence(*(np.roll(np.asarray(part), -first, 0) for part in evidence))


eliminated = jax.jit(eliminate)
stepped = jax.jit(steps_of)


@jax.jit
def all_variances(found, jacobian, count):
    """(T, M) of all events."""
    each = jax.vmap(partial(point_variances, found), (0, None, 0))
    return each(jacobian, count, np.arange(T, dtype=np.int32))


def no_ridge() -> np.ndarray:
    return np.zeros(N)


@in_float64
@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6), st.lists(st.integers(0, 4), max_size=4))
def test_a_window_with_a_marginal_prior_is_as_good_as_the_dense_chain(seed, leaving):
    """Some leave at a time; states and variances of those that stay, and what moved in between."""
    evidence = chain(np.random.default_rng(seed))
    expected, sure = dense(evidence)
    marginal, first = NO_PRIOR, 0
    for count in leaving:
        if first + count > T - 3:
            break
        window = from_event(evidence, first)
        marginal = eliminated(window, marginal, no_ridge(), np.int32(count)).rest
        first += count
    window, count = from_event(evidence, first), np.int32(T - first)
    found = eliminated(window, marginal, no_ridge(), count)
    np.testing.assert_allclose(stepped(found, count)[:count], expected[first:], atol=1e-6)
    variances = all_variances(found, window.jacobian, count)[:count]
    np.testing.assert_allclose(variances, sure[first:], rtol=1e-5)


def cost_of(evidence: Evidence, steps: np.ndarray) -> float:
    own, slopes, *_ = map(np.asarray, evidence)
    rises = np.sum(steps * (np.einsum("tij,tj->ti", own, steps) + 2 * slopes))
    return float(rises + np.sum(np.asarray(evidence.accelerations(steps)) ** 2))


@in_float64
@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6))
def test_steps_lead_to_the_least_cost_and_damping_makes_them_shorter(seed):
    rng = np.random.default_rng(seed)
    evidence = chain(rng)

    def steps(ridge: float) -> np.ndarray:
        found = eliminated(evidence, NO_PRIOR, np.full(N, ridge), np.int32(T))
        return np.asarray(stepped(found, np.int32(T)))

    best, damped = steps(0.0), steps(10.0)
    least = cost_of(evidence, best)
    assert all(cost_of(evidence, best + rng.normal(0, 0.1, (T, N))) > least for _ in range(5))
    assert np.linalg.norm(damped) < np.linalg.norm(best)
    assert least < cost_of(evidence, damped) < cost_of(evidence, 0 * best)


@in_float64
@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6))
def test_a_marginal_prior_goes_along_with_the_poses_that_it_is_about(seed):
    rng = np.random.default_rng(seed)
    evidence = chain(rng)
    marginal = eliminated(evidence, NO_PRIOR, no_ridge(), np.int32(3)).rest

    def cost(prior: MarginalPrior, steps: np.ndarray) -> float:
        x = steps.ravel()
        return float(x @ (np.asarray(prior.hessian) @ x + 2 * np.asarray(prior.gradient)))

    there, further = rng.normal(size=(2, 2, N))
    both = cost(marginal, there + further) - cost(marginal, there)
    assert cost(marginal.about(there), further) == pytest.approx(both, rel=1e-9, abs=1e-9)


@in_float64
def test_an_event_without_curvature_of_its_own_is_solved_all_the_same():
    """Rounding may leave less than nothing; then more holds it back."""
    evidence = chain(np.random.default_rng(0))
    hessian = evidence.hessian.copy()
    hessian[4] = -1e-5 * np.eye(N)
    loose = evidence._replace(hessian=hessian, stencil=np.zeros((T, 3)))
    found = eliminated(loose, NO_PRIOR, no_ridge(), np.int32(T))
    assert np.isfinite(np.asarray(stepped(found, np.int32(T)))).all()


# Fading ------------------------------------------------------------------------------------------


def test_final_poses_go_on_without_a_jump():
    still = Fading(np.zeros(1), np.zeros(1), 0.0).at(1.0, 0.05)
    left = still.correct(np.array([0.3]))
    np.testing.assert_allclose(left.at(1.0 + 1e-6, 0.05).offset, 0.3, atol=1e-5)
    assert abs(float(left.at(1.5, 0.05).offset[0])) < 1e-3


def test_corrections_fade_in_beside_the_markers():
    """Those of a third of a radian in every joint: an elbow moves, head and hands hardly."""
    model, rng = Model.create(PERSON, MARKERS), np.random.default_rng(4)
    near = jax.jit(move_near_markers)
    for i in range(4):
        pose = np.concatenate(at(truth(COUNT), 3 * i)).astype(np.float32)
        offset = rng.uniform(-0.3, 0.3, 6 + PERSON.limits.shape[0]).astype(np.float32)
        offset[:6] = 0
        goals = marked(unpack(pose))
        moved = near(model, unpack(pose), offset, goals)
        free = near(model, unpack(pose), offset, np.nan * goals)
        off, away = (np.linalg.norm(marked(each) - goals, axis=-1) for each in (moved, free))
        assert off.max() < 2 * STRAY_M < away.max()
        assert np.abs(moved.angles - unpack(pose).angles).max() > 0.1


def off_moved_markers(by) -> np.ndarray:
    """Distances (M,) from markers that lie elsewhere by so much, of a pose moved near them."""
    pose = unpack(np.concatenate(at(truth(COUNT), 3)).astype(np.float32))
    markers, still = marked(pose) + by, np.zeros(6 + PERSON.limits.shape[0], np.float32)
    moved = jax.jit(move_near_markers)(Model.create(PERSON, MARKERS), pose, still, markers)
    return np.linalg.norm(marked(moved) - markers, axis=-1)


def test_points_that_smoothing_takes_off_their_markers_come_back():
    """Two centimetres, which the motion prior would rather have than a fast turn."""
    assert off_moved_markers(np.array([0.0, 0.0, -0.02])).max() < STRAY_M + 1e-3


@pytest.mark.parametrize("away", [0.6, 0.9, 1.2])
def test_a_hand_that_is_back_from_elsewhere_leaves_the_head_where_it_is(away):
    off = off_moved_markers(np.array([[0.0, 0, 0], [0, 0, 0], [-0.2, 0.0, away]]))
    assert off[:2].max() < 0.02 and off[2] < 0.7 * np.hypot(0.2, away)


@given(st.floats(-1, 1), st.floats(-9, 9), st.floats(0.001, 0.2), st.floats(0.001, 0.2))
def test_fading_in_two_steps_is_fading_in_one(offset, rate, first, second):
    start = Fading(np.array([offset]), np.array([rate]), 0.0)
    once, twice = start.at(first + second, 0.06), start.at(first, 0.06).at(first + second, 0.06)
    for a, b in zip(once, twice, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-9)


def test_difference_undoes_retract():
    rng = np.random.default_rng(2)
    origin = at(truth(1), 0)
    step = rng.normal(0, 0.5, 6 + len(origin.angles)).astype(np.float32)
    device = on_device(origin)
    moved = retract(device, jax.numpy.asarray(step))
    np.testing.assert_allclose(difference(moved, device), step, atol=1e-5)
    np.testing.assert_allclose(difference(device, device), 0, atol=1e-6)
