"""Smoothing with a fixed lag: calm, causal, and complete whatever is missing."""

from dataclasses import replace
from functools import cache

import jax
import numpy as np
import pytest
from conftest import on_device
from drawn_arms import SIZE
from drawn_body import paint, room
from hypothesis import given, settings
from hypothesis import strategies as st
from painted_motion import CAMERAS, ELBOWS, MARKERS, PERSON, RATE, elbow_errors, points_of, truth

from jaxmocap.body.kinematics import forward, site_positions
from jaxmocap.body.pose import Pose, difference, retract
from jaxmocap.body.proportions import PROPORTIONS
from jaxmocap.evidence.silhouettes import Sight
from jaxmocap.evidence.smoothness import smoothness
from jaxmocap.hybrid.settings import Settings, SmoothingSettings
from jaxmocap.hybrid.tracker import HybridTracker, StepReport
from jaxmocap.smoothing import fixed_lag, window
from jaxmocap.smoothing.fixed_lag import DELAY_FRAMES, FixedLagSmoother
from jaxmocap.smoothing.fixed_lag import Given as GivenOut
from jaxmocap.smoothing.levenberg_marquardt import Linearised, covariances, normal_equations, smooth
from jaxmocap.smoothing.levenberg_marquardt import Settings as Solve
from jaxmocap.smoothing.linearise import Problem, Sights, Trajectory, smooth_poses
from jaxmocap.smoothing.marginal_prior import condensed, improve, leaving, window_variances
from jaxmocap.solvers.arrow import Equations
from jaxmocap.solvers.fading import Fading

COUNT = 24
TIMES = np.arange(COUNT) / RATE


@cache
def images() -> list[np.ndarray]:
    """What camera 0 sees, with a sensor's noise."""
    wall, rng = room(SIZE), np.random.default_rng(3)
    poses = [Pose(*each) for each in zip(*truth(COUNT), strict=True)]
    painted = [paint(CAMERAS[0], PERSON, pose, wall).image for pose in poses]
    noise = [np.rint(rng.normal(0, 2, image.shape)) for image in painted]
    return [
        np.clip(image + each, 0, 255).astype(np.uint8)
        for image, each in zip(painted, noise, strict=True)
    ]


@cache
def markers() -> np.ndarray:
    """(T, M, 3) of head and wrists."""
    over = jax.vmap(lambda pose: site_positions(PERSON, forward(PERSON, pose), MARKERS))
    return np.asarray(over(on_device(truth(COUNT))), float)


@cache
def shaking() -> Pose:
    """What a first pass may have found: both arms off by another angle in every frame."""
    poses, rng = truth(COUNT), np.random.default_rng(5)
    angles = poses.angles.copy()
    for side in "lr":
        angles[:, PERSON.tree.joint(f"arm_abduct_{side}")] += rng.normal(0, np.radians(12), COUNT)
    return Pose(*(np.asarray(part, np.float32) for part in poses._replace(angles=angles)))


@cache
def tracker(**changed: float | int) -> HybridTracker:
    """Of the person and camera 0; nothing of it is compiled here."""
    over_time = SmoothingSettings.create(
        marker=0.004, silhouette=0.7, acceleration=3.0, redundancy=4.0, mismatch=1.0, **changed
    )
    return HybridTracker(PERSON, [CAMERAS[0]], replace(Settings(), over_time=over_time), MARKERS)


def at(poses: Pose, i: int) -> Pose:
    return jax.tree.map(lambda part: part[i], poses)


def report(i: int, placed: bool = False) -> StepReport:
    """Of a step that trusts its elbows little; markers alone would do as well."""
    nothing = dict.fromkeys(StepReport._fields, np.zeros(()))
    spread = np.full(2, 0.1)
    alone = at(shaking(), 0)._replace(position=shaking().position[i])
    return StepReport(**(nothing | {"pose": alone, "spread": spread, "placed": np.bool_(placed)}))


def steps(seen=None, held=None, smoother=None, placed=(), count=COUNT) -> list[list[GivenOut]]:
    """What each step gives out, and at last what is flushed."""
    smoother = smoother or FixedLagSmoother(tracker())
    seen, held = images() if seen is None else seen, markers() if held is None else held
    out = [
        smoother.step(TIMES[i], held[i], [seen[i]], at(shaking(), i), report(i, i in placed))
        for i in range(count)
    ]
    return [*out, smoother.flush()]


def joined(out: list[list[GivenOut]]) -> list[GivenOut]:
    return [each for given_out in out for each in given_out]


def poses_of(given_out: list[GivenOut]) -> Pose:
    return jax.tree.map(lambda *parts: np.stack(parts), *(each.pose for each in given_out))


def accelerations(poses: Pose) -> float:
    """Root mean square of the elbows', m/s^2."""
    second = np.diff(points_of(poses)[:, ELBOWS], 2, axis=0) * RATE**2
    return float(np.sqrt(np.mean(second**2)))


@pytest.fixture(scope="module")
def whole() -> list[list[GivenOut]]:
    return steps()


# What comes out ----------------------------------------------------------------------------------


def test_every_event_comes_out_once_in_order_at_its_own_time(whole):
    assert [each.number for each in joined(whole)] == list(range(COUNT))
    np.testing.assert_allclose([each.time for each in joined(whole)], TIMES)


def test_no_pose_waits_for_more_than_two_video_frames(whole):
    for i, given_out in enumerate(whole[:-1]):
        assert all(i - each.number <= DELAY_FRAMES for each in given_out)
    assert len(whole[-1]) == DELAY_FRAMES


def test_the_elbows_are_calm_and_nearer_than_the_first_pass(whole):
    found = poses_of(joined(whole))
    assert accelerations(found) < 0.15 * accelerations(shaking())
    before, after = elbow_errors(shaking()), elbow_errors(found)
    assert after[8:].mean() < 0.025 and after[8:].mean() < 0.7 * before[8:].mean()


def test_the_first_frames_are_no_worse_than_the_first_pass_though_no_background_is_known(whole):
    found = poses_of(joined(whole)[:6])
    assert elbow_errors(found).mean() < 1.2 * elbow_errors(shaking())[:6].mean()


def test_deviations_hold_the_truth_and_the_wrists_are_surer_than_the_elbows(whole):
    told = np.stack([each.deviations for each in joined(whole)])
    off = points_of(poses_of(joined(whole))) - points_of(truth(COUNT))
    assert np.isfinite(told).all() and (told > 0).all()
    within = np.abs(off[:, ELBOWS]) < 1.645 * told[:, ELBOWS]
    assert within.mean() > 0.8
    wrists = [points for points in range(told.shape[1]) if told[8, points].max() < 0.015]
    assert wrists and not set(wrists) & set(ELBOWS)


def test_what_comes_later_changes_nothing_that_was_given_out(whole):
    half = COUNT // 2
    other, moved = list(images()), markers().copy()
    other[half:] = [image[::-1].copy() for image in other[half:]]
    moved[half:] += 0.1
    again = steps(other, moved)
    for one, two in zip(whole[:half], again[:half], strict=True):
        assert [each.number for each in one] == [each.number for each in two]
        for a, b in zip(one, two, strict=True):
            np.testing.assert_array_equal(a.pose.angles, b.pose.angles)
            np.testing.assert_array_equal(a.deviations, b.deviations)
    late = [points_of(poses_of(joined(out)[half + 2 :])) for out in (whole, again)]
    assert np.abs(late[0] - late[1]).max() > 0.03


# What is missing ---------------------------------------------------------------------------------


def test_missing_markers_images_and_grey_images_are_bridged(whole):
    seen, held = list(images()), markers().copy()
    seen[5] = seen[6] = None
    seen[9] = np.zeros_like(seen[9])
    held[8:11, 1], held[13] = np.nan, np.nan
    out = joined(steps(seen, held))
    assert [each.number for each in out] == list(range(COUNT))
    assert all(np.isfinite(part).all() for part in poses_of(out))
    assert elbow_errors(poses_of(out))[8:].mean() < 0.04


def test_without_any_image_poses_come_out_all_the_same():
    out = steps([None] * COUNT)
    assert [each.number for each in joined(out)] == list(range(COUNT))
    assert all(each.from_prior[ELBOWS].all() for each in joined(out))
    # Not all of them at the end.
    assert len(joined(out[:-1])) > COUNT // 2


def test_grey_images_will_do():
    grey = [image.mean(-1).astype(np.uint8) for image in images()[:6]]
    out = joined(steps(grey, count=6))
    assert len(out) == 6 and all(np.isfinite(part).all() for part in poses_of(out))


def test_silhouettes_without_weight_tell_nothing():
    dark, blind = [np.zeros_like(image) for image in images()], tracker(person=0.0, forearms=0.0)
    seen, unseen = (
        poses_of(joined(steps(each, smoother=FixedLagSmoother(blind), count=8)))
        for each in (images(), dark)
    )
    for own, expected in zip(seen, unseen, strict=True):
        np.testing.assert_array_equal(own, expected)


def test_a_body_that_is_placed_anew_begins_a_new_motion():
    out = steps(placed=(6,), count=9)
    assert [each.number for each in joined(out)] == list(range(9))
    assert [each.number for each in out[6]] == [4, 5]


def test_it_needs_a_camera():
    with pytest.raises(ValueError, match="at least one camera"):
        FixedLagSmoother(HybridTracker(PERSON, None, Settings(), MARKERS))


# Against the whole recording ---------------------------------------------------------------------


def test_a_window_over_everything_agrees_with_the_second_pass(monkeypatch):
    count = 10
    for name, value in (("DELAY_FRAMES", 99), ("DELAY_S", 99.0), ("KEPT_FRAMES", 99)):
        monkeypatch.setattr(fixed_lag, name, value)
    smoother = FixedLagSmoother(tracker(proportions=1e9, iterations=60))
    for i in range(count):
        assert not smoother.step(TIMES[i], markers()[i], [images()[i]], at(shaking(), i), report(i))
    events = smoother._newest.events
    known = jax.tree.map(lambda *parts: np.stack(parts), *(e.known for e in events))
    sight = jax.tree.map(lambda *parts: np.stack(parts), *(e.looks[0][1].sight for e in events))
    start = jax.tree.map(lambda *parts: np.stack(parts), *(e.pose for e in events))
    own = smoother.tracker
    # These are as soft already as they are drawn.
    monkeypatch.setattr("jaxmocap.smoothing.linearise.softened", lambda problem, _: problem)
    sights = Sights(np.arange(count), np.zeros(count, int), Sight(*sight))
    problem = Problem(
        own.skeleton, own.cameras, MARKERS, own.settings.over_time, TIMES[:count], known, sights
    )
    usual = np.zeros(len(PROPORTIONS), np.float32)
    offline = smooth_poses(problem, Trajectory(start, usual), (window.SOFTNESS,))
    monkeypatch.setattr(window, "STEP", window.STEP._replace(iterations=30, relative=1e-7))
    online = poses_of(smoother.flush())
    off = points_of(online) - points_of(offline.trajectory.poses)
    assert np.abs(off).max() < 0.01


# The window --------------------------------------------------------------------------------------

N, T = 2, 9


def chain(rng: np.random.Generator):
    """Frames of N unknowns, straight-line problems: what is solved once is solved."""
    times = np.cumsum(rng.uniform(0.01, 0.05, T))
    A = rng.normal(size=(T, 3, N)) * rng.uniform(0.1, 3, (T, 1, 1))
    b, J = rng.normal(size=(T, 3)), rng.normal(size=(T, 2, N)) + 2 * np.eye(2)

    def linearise(rows: slice):
        def of(x: np.ndarray) -> Linearised:
            r = np.einsum("tij,tj->ti", A[rows], x) - b[rows]
            return Linearised(
                np.sum(r**2, 1),
                np.einsum("tia,tib->tab", A[rows], A[rows]),
                np.einsum("tia,ti->ta", A[rows], r),
                np.einsum("tij,tj->ti", J[rows], x),
                J[rows],
            )

        return of

    return times, linearise


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6))
def test_a_window_with_a_condensed_past_knows_what_the_whole_chain_knows(seed):
    times, linearise = chain(np.random.default_rng(seed))
    exact = Solve(iterations=20, damping=1e-12, relative=1e-14, floor=1e-12)
    deviations, every = np.full(2, 3.0), linearise(slice(None))
    prior = smoothness(times, deviations)

    full = smooth(every, lambda x, s, _: x + s, np.zeros((T, N)), prior, exact)
    spread = covariances(every(full.x), prior, exact).frames
    x, past, origin, first = np.zeros((4, N)), None, None, 0
    while True:
        rows = slice(first, first + len(x))
        window = smoothness(times[rows], deviations)
        offset = lambda x, o=origin: np.zeros(0) if o is None else (x[:2] - o).ravel()  # noqa: E731
        better = improve(linearise(rows), lambda x, s: x + s, offset, x, window, past, exact)
        if first + 4 == T:
            break
        three = smoothness(times[first : first + 3], deviations)
        past = condensed(leaving(better.linear, three), past, offset(better.x), exact)
        first, origin = first + 1, better.x[1:3]
        x = np.concatenate([better.x[1:], np.zeros((1, N))])
    np.testing.assert_allclose(better.x, full.x[-4:], atol=1e-6)
    jacobian = np.asarray(better.linear.jacobian)
    expected = np.einsum("tmi,tij,tmj->tm", jacobian, spread[-4:], jacobian)
    equations = normal_equations(better.linear, window)
    found = window_variances(equations, jacobian, past, np.arange(4), exact)
    np.testing.assert_allclose(found, expected, rtol=1e-4)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6))
def test_several_frames_are_condensed_at_once_as_one_after_the_other(seed):
    rng = np.random.default_rng(seed)
    times, linearise = chain(rng)
    x, floor = rng.normal(size=(T, N)), Solve(floor=0.0)
    linear, deviations = linearise(slice(None))(x), np.full(2, 3.0)

    def some(rows: slice) -> Equations:
        parts = Linearised(*(np.asarray(part)[rows] for part in linear[:5]))
        return leaving(parts, smoothness(times[rows], deviations))

    first = condensed(some(slice(0, 3)), None, np.zeros(0), floor)
    second = condensed(some(slice(1, 4)), first, np.zeros(2 * N), floor)
    both = condensed(some(slice(0, 4)), None, np.zeros(0), floor)
    for together, apart in zip(both, second, strict=True):
        np.testing.assert_allclose(together, apart, rtol=1e-8, atol=1e-8 * np.abs(apart).max())


def test_what_nothing_determines_has_no_finite_variance():
    nothing = np.zeros((1, 2, 2))
    linear = Linearised(np.zeros(1), nothing, nothing[:, 0], nothing[:, 0], np.eye(2)[None])
    prior = smoothness(np.zeros(1), np.full(2, 3.0))
    equations = normal_equations(linear, prior)
    found = window_variances(equations, linear.jacobian, None, np.arange(1), Solve(floor=0.0))
    assert np.isinf(found).all()


# Fading ------------------------------------------------------------------------------------------


def test_what_was_given_out_goes_on_without_a_jump_in_place_or_speed():
    still = Fading(np.zeros(1), np.zeros(1), 0.0).at(1.0, 0.05)
    left = still.corrected(np.array([0.3]), np.array([-2.0]))
    soon = left.at(1.0 + 1e-6, 0.05)
    np.testing.assert_allclose(soon.offset, 0.3, atol=1e-5)
    np.testing.assert_allclose((soon.offset - 0.3) / 1e-6, -2.0, rtol=1e-2)
    assert abs(float(left.at(1.5, 0.05).offset[0])) < 1e-3


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
