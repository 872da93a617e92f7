"""The tracker over many frames: one trace, what is lost and found, and the reference's answers."""

from dataclasses import replace
from functools import partial, update_wrapper
from time import time_ns

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import LIMITS, on_device
from watched_arms import FRONT, MARKERS, MODEL, PERSON, TRUTH, arms_in
from waving_arms import RATE, frames, image_of, markers_of, waving

from jaxmocap.body.kinematics import landmarks
from jaxmocap.body.model import Model, on_unmarked_feet
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.compilation.programs import Program
from jaxmocap.hybrid import tracker as tracker_module
from jaxmocap.hybrid.balance import spine_dofs, squat_goals
from jaxmocap.hybrid.ik import goals_of
from jaxmocap.hybrid.observe import edge_fields
from jaxmocap.hybrid.settings import IKSettings, Settings, SimplexSettings
from jaxmocap.hybrid.step import SOLVE, refine_one, solve_event
from jaxmocap.hybrid.tracker import HybridTracker
from jaxmocap.reference import kinematics as reference
from jaxmocap.reference.hybrid import ik as reference_ik
from jaxmocap.reference.hybrid import pipeline as reference_pipeline

BLACK = np.zeros((480, 640, 3), np.uint8)
MISSING = np.full((3, 3), np.nan)


class CountedTracker(HybridTracker):
    """Counts how often each of the two functions is traced, with its cameras or without."""

    def __init__(self, *arguments, **options):
        super().__init__(*arguments, **options)
        self.traced = TRACED[self.model.cameras is not None]


TRACED: dict[bool, list[str]] = {True: [], False: []}


def counting(function, model, *rest):
    TRACED[model.cameras is not None].append(function.__name__.partition("_")[0])
    return function(model, *rest)


@pytest.fixture(scope="module", autouse=True)
def counted():
    """From now on both programs count how often they are traced."""
    with pytest.MonkeyPatch.context() as patched:
        for name, function in {"solve": solve_event, "refine": refine_one}.items():
            own = update_wrapper(partial(counting, function), function)
            # Of this run: what an earlier one kept would not be traced.
            program = Program(own, name, static=time_ns())
            patched.setattr(tracker_module, name.upper(), program)
        yield


@pytest.fixture(scope="module")
def tracker():
    return CountedTracker(PERSON, [FRONT], Settings(refine="simplex", region=64), MARKERS)


@pytest.fixture(scope="module")
def markers_only():
    return CountedTracker(PERSON, settings=Settings(balance=False))


def elbow_errors(pose, truth):
    apart = arms_in(pose).elbow - arms_in(on_device(truth)).elbow
    return np.linalg.norm(apart, axis=1)


def followed(tracker, count, state=None, first=0):
    """The state after some frames with video, and each frame's poses and report."""
    state = tracker.init(markers_of(waving(first / RATE))) if state is None else state
    tracked = []
    for time, truth, markers in frames(count, first):
        state, pose, report = tracker.step(state, time, markers, [image_of(truth)])
        tracked.append((truth, pose, report))
    return state, tracked


def test_both_functions_are_traced_once_whatever_comes(tracker):
    """Moving regions, lost markers, black and missing images, a leap: 20 frames, one trace each."""
    state = tracker.init(markers_of(waving(0)))
    regions = []
    for i, (time, truth, markers) in enumerate(frames(20)):
        image = {3: BLACK, 4: BLACK[..., 0], 7: None, 12: None}.get(i, image_of(truth))
        if i in (5, 6, 7):
            markers[i - 5] = np.nan
        if i == 9:
            markers[:] = np.nan
        if i > 15:
            markers = markers + np.array([0, 1.5, 0])
        images = None if i == 13 else [image]
        state, pose, report = tracker.step(state, time, markers, images)
        solved = SOLVE(tracker.model, tracker.settings, state.pose, state.feet,
                       np.asarray(markers, np.float32))  # fmt: skip
        regions.append(np.asarray(solved.region.origin))
        assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves((state, pose)))
        np.testing.assert_array_equal(np.isnan(report.marker_errors), np.isnan(markers).any(1))
        assert bool(report.placed) == (i == 16)
    assert tracker.traced == ["solve", "refine"]
    assert len(np.unique(np.array(regions).reshape(20, -1), axis=0)) > 10


def test_other_numbers_do_not_trace_again(tracker):
    """Another person, other settings: arrays all of them."""
    state = tracker.init(markers_of(TRUTH))
    tracker.step(state, 0.0, markers_of(TRUTH), [image_of(TRUTH)])
    before = len(tracker.traced)
    model, settings = tracker.model, tracker.settings
    try:
        other = Model.create(Skeleton.human(1.6, 50.0), MARKERS, FRONT)
        tracker.model = on_unmarked_feet(other)
        tracker.settings = replace(settings, ik=IKSettings(memory=0.7, floor=0.1))
        state, _, _ = tracker.step(state, 0.1, markers_of(TRUTH), [image_of(TRUTH)])
    finally:
        tracker.model, tracker.settings = model, settings
    assert len(tracker.traced) == before


def test_a_later_step_makes_no_first_pose_again(tracker, monkeypatch):
    """Live it would take a fifth of every sample's time."""
    markers = markers_of(TRUTH)
    state, _, _ = tracker.step(tracker.init(markers), 0.0, markers, [image_of(TRUTH)])
    monkeypatch.delattr(tracker_module, "nowhere")
    tracker.step(state, 0.1, markers, [image_of(TRUTH)])


def test_video_finds_the_elbows_that_markers_alone_miss(tracker):
    _, tracked = followed(tracker, 16)
    errors = np.array([elbow_errors(pose, truth) for truth, pose, _ in tracked])
    without = np.array([elbow_errors(report.marker_pose, truth) for truth, _, report in tracked])
    assert without.max(1).min() > 0.15
    assert errors[4:].max() < 0.03
    assert errors[4:].mean() < 0.3 * without.mean()
    for _, _, report in tracked[4:]:
        assert (np.asarray(report.outline_px) < 3).all()
        assert (np.asarray(report.elbow_deviations) < 0.05).all()
        assert np.abs(report.swivels).max() > 0.5


def test_markers_are_met_within_2_cm_in_every_frame(tracker):
    _, tracked = followed(tracker, 16)
    for truth, pose, report in tracked:
        assert np.asarray(report.marker_errors).max() < 0.02
        apart = np.linalg.norm(markers_in(pose) - markers_of(truth), axis=1)
        np.testing.assert_allclose(report.marker_errors, apart, atol=1e-4)
        angles = np.asarray(pose.angles)
        assert (angles >= LIMITS[:, 0] - 1e-4).all() and (angles <= LIMITS[:, 1] + 1e-4).all()


def markers_in(pose):
    return markers_of(jax.tree.map(np.asarray, pose))


def test_what_video_found_is_carried_to_samples_without_a_frame(tracker):
    state, _ = followed(tracker, 8)
    for time, truth, markers in frames(6, 8):
        state, pose, report = tracker.step(state, time, markers, None)
        assert elbow_errors(pose, truth).max() < 0.06
        assert elbow_errors(report.marker_pose, truth).max() > 0.15
        assert np.isnan(report.outline_px).all()
        assert np.asarray(report.marker_errors).max() < 0.02


def test_without_images_it_ends_at_the_markers_pose_and_grows_unsure(tracker):
    state, tracked = followed(tracker, 8)
    deviations = np.asarray(tracked[-1][2].elbow_deviations)
    for i in range(8, 8 + 4 * RATE, 6):
        truth = waving(8 / RATE)
        state, pose, report = tracker.step(state, i / RATE, markers_of(truth), [BLACK])
        assert (np.asarray(report.elbow_deviations) >= deviations - 1e-6).all()
        deviations = np.asarray(report.elbow_deviations)
    assert (deviations > 0.1).all()
    np.testing.assert_allclose(arms_in(pose).elbow, arms_in(report.marker_pose).elbow, atol=0.05)


def test_events_may_be_solved_by_their_markers_and_refined_when_asked_for(tracker):
    """Solving alone leaves what the video taught as it is, and counts its age on."""
    state, _ = followed(tracker, 6)
    later, markers = state, markers_of(TRUTH)
    for _ in range(3):
        later, pose, report = tracker.solve(later, markers)
        assert np.isnan(np.asarray(report.elbow_deviations)).all()
        np.testing.assert_array_equal(pose.angles, report.marker_pose.angles)
    assert later.belief is state.belief and later.time == state.time
    alone = state
    for i in range(3):
        alone, _, report = tracker.step(alone, state.time + (i + 1) / RATE, markers)
    np.testing.assert_allclose(report.marker_pose.angles, pose.angles, atol=1e-6)
    ages = [
        float(tracker.step(each, state.time + 1.0, markers)[0].belief.age)
        for each in (later, alone)
    ]
    assert ages[0] == pytest.approx(ages[1], abs=1e-5) and ages[0] >= 1.0


def test_elbows_come_back_after_a_gap(tracker):
    state, _ = followed(tracker, 6)
    for i in range(6, 12):
        state, pose, _ = tracker.step(state, i / RATE, MISSING, [BLACK])
        assert all(np.isfinite(leaf).all() for leaf in pose)
    _, tracked = followed(tracker, 8, state, 12)
    assert elbow_errors(tracked[-1][1], tracked[-1][0]).max() < 0.03
    assert np.asarray(tracked[-1][2].marker_errors).max() < 0.02


def test_a_leap_places_the_body_again(tracker):
    state, _ = followed(tracker, 4)
    truth = waving(4 / RATE)
    away = markers_of(truth) + np.array([3.0, -2.0, 0.0])
    state, pose, report = tracker.step(state, 4 / RATE, away, None)
    assert bool(report.placed)
    np.testing.assert_allclose(pose.position[:2], truth.position[:2] + np.array([3, -2]), atol=0.3)
    for i in range(5, 8):
        state, pose, report = tracker.step(state, i / RATE, away, None)
        assert not report.placed
    assert np.asarray(report.marker_errors).max() < 0.02


def test_solve_does_not_depend_on_what_refine_found(tracker, markers_only):
    """The markers' poses are the same with and without video."""
    _, tracked = followed(tracker, 5)
    state = markers_only.init(markers_of(waving(0)))
    for (time, _, markers), (_, _, report) in zip(frames(5), tracked, strict=True):
        state, _, alone = markers_only.step(state, time, markers)
        for part, other in zip(alone.marker_pose, report.marker_pose, strict=True):
            np.testing.assert_allclose(part, other, atol=1e-5)


def test_markers_alone_are_tracked_without_a_camera(markers_only):
    state = markers_only.init(markers_of(waving(0)))
    for time, _, markers in frames(10):
        state, pose, report = markers_only.step(state, time, markers)
        assert np.asarray(report.marker_errors).max() < (0.02 if time > 0.1 else 1)
        assert np.isnan(report.outline_px).all()
        for part, other in zip(pose, report.marker_pose, strict=True):
            np.testing.assert_array_equal(part, other)
    assert markers_only.traced == ["solve", "refine"]


def test_the_papers_markers_are_the_default(markers_only):
    actual = markers_only.model
    assert actual.markers.bone_indices == MARKERS.bone_indices
    np.testing.assert_array_equal(actual.markers.at, MARKERS.at)
    np.testing.assert_array_equal(actual.markers.offsets, MARKERS.offsets)
    assert actual.unmarked_feet == ("l", "r")


SUNK = jax.jit(lambda depth: squat_goals(PERSON, depth).targets)


def squatting(depth):
    """The markers of a squat, on the ground."""
    targets = np.asarray(SUNK(depth))
    foot = float(PERSON.diameters[PERSON.tree.bone("foot_l"), 0])
    return targets[:3] + np.array([0, 0, foot - targets[3, 2]])


@pytest.mark.parametrize("images", [None, [BLACK]])
def test_a_squat_is_balanced_and_its_bow_does_not_pile_up(tracker, images):
    state = tracker.init(squatting(0.0))
    depths = np.concatenate([np.linspace(0, 0.3, 12), np.full(20, 0.3)])
    dofs, spines = spine_dofs(PERSON), []
    for i, depth in enumerate(depths):
        state, pose, report = tracker.step(state, i / RATE, squatting(depth), images)
        spines.append(np.asarray(pose.angles)[dofs])
        assert np.asarray(report.marker_errors).max() < 0.02 or i < 2
    assert bool(report.balanced)
    change = np.degrees(np.abs(np.array(spines[-1]) - spines[13]))
    assert change.max() < 1.5


def test_balance_can_be_switched_off(markers_only):
    state = markers_only.init(squatting(0.0))
    for i in range(6):
        state, _, report = markers_only.step(state, i / RATE, squatting(0.05 * i))
        assert not report.balanced


# The reference takes its time: small regions, few steps.
SMALL = 16
LANDMARKS_OF = jax.jit(landmarks)


@pytest.fixture(scope="module")
def paper_tracker():
    """The paper's way: plain edges, its sum, the simplex alone, no memory."""
    few = SimplexSettings(iterations=12, other_edge=0.002)
    chosen = replace(Settings.paper(), region=SMALL, simplex=few)
    return HybridTracker(PERSON, [FRONT], chosen, MARKERS)


def of_reference(tracker, state, markers, image, start):
    """One frame by the reference from its own last pose; regions and feet are the tracker's."""
    model, settings = tracker.model, tracker.settings
    targets = np.asarray(markers, np.float32)
    solved = SOLVE(model, settings, state.pose, state.feet, targets)
    goals = goals_of(model, settings.ik, solved.ik.feet, jnp.asarray(targets))
    body, camera = jax.tree.map(np.asarray, (model.skeleton, FRONT))
    by_markers, _ = reference_ik.reach(body, goals, settings.ik, start)
    fields, _ = edge_fields(settings, state.thresholds, [image], solved.region)
    origin, scale = (np.asarray(part, float)[0] for part in solved.region)
    distances = np.asarray(fields.distances)[0, :, 0]
    views = [
        reference_pipeline.ArmView(camera, origin[arm], scale[arm], distances[arm])
        for arm in range(2)
    ]
    refined = reference_pipeline.refine(
        body, settings, tracker.bow_factors, by_markers, views,
        jax.tree.map(np.asarray, MODEL.grips),
    )  # fmt: skip
    return by_markers, refined


def apart(tracker, pose, expected):
    ours = np.asarray(LANDMARKS_OF(tracker.model.skeleton, pose))
    return np.linalg.norm(
        ours - reference.landmarks(jax.tree.map(np.asarray, tracker.model.skeleton), expected),
        axis=1,
    ).max()


def test_frame_by_frame_float32_is_within_a_millimetre_of_the_reference(paper_tracker):
    tracker = paper_tracker
    state = tracker.init(markers_of(waving(0)))
    for i, (time, truth, markers) in enumerate(frames(5)):
        image = image_of(truth)
        if i >= 3:
            by_markers, refined = of_reference(tracker, state, markers, image, state.pose)
        state, pose, report = tracker.step(state, time, markers, [image])
        if i >= 3:
            assert apart(tracker, report.marker_pose, by_markers) < 1e-3
            assert apart(tracker, pose, refined) < 1e-3
            assert apart(tracker, pose, by_markers) > 2e-3


def test_the_papers_search_begins_at_the_markers_pose_in_every_frame(paper_tracker):
    """What an earlier frame has shown is forgotten: pose, thresholds, beliefs."""
    tracker, first, now = paper_tracker, markers_of(waving(0)), markers_of(waving(0.4))
    begun, image = tracker.init(first), image_of(waving(0.4))
    _, expected, _ = tracker.step(begun, 0.4, now, [image])
    noise = np.random.default_rng(0).integers(0, 255, image.shape).astype(np.uint8)
    after, astray, _ = tracker.step(begun, 0.0, first, [noise])
    assert apart(tracker, astray, begun.pose) > 0.01
    same_markers = after._replace(pose=begun.pose, feet=begun.feet)
    _, actual, _ = tracker.step(same_markers, 0.4, now, [image])
    np.testing.assert_allclose(actual.angles, expected.angles, atol=1e-6)


def test_the_papers_feet_stand_where_they_began(paper_tracker):
    tracker = paper_tracker
    state = tracker.init(markers_of(waving(0)))
    far = np.add(markers_of(waving(0)), [0.5, 0, 0])
    after, _, report = tracker.step(state, 0.1, far, [None])
    np.testing.assert_array_equal(after.feet.ankles, state.feet.ankles)
    assert not report.planted


def test_the_papers_balance_comes_last_and_bows_the_spine_alone(paper_tracker):
    """Arms and pelvis stay as the video step leaves them, so the markers are left."""
    tracker = paper_tracker
    state = tracker.init(squatting(0.0))
    for i in range(8):
        state, pose, report = tracker.step(state, i / RATE, squatting(0.05 * i))
    assert report.balanced
    moved = np.flatnonzero(np.abs(np.asarray(pose.angles - report.marker_pose.angles)) > 1e-6)
    assert {PERSON.tree.bones[PERSON.tree.dof_bones[dof]] for dof in moved} == {
        "spine1", "spine2", "spine3",
    }  # fmt: skip
    np.testing.assert_array_equal(pose.position, report.marker_pose.position)


@pytest.mark.slow
def test_over_100_frames_the_references_elbow_error_is_the_same(paper_tracker, request):
    """A simplex may take another branch now and then; over the sequence it evens out."""
    if "slow" not in request.config.option.markexpr:
        pytest.skip("takes minutes, so it runs by name only: python -m pytest -m slow")
    tracker, errors = paper_tracker, []
    state = tracker.init(markers_of(waving(0)))
    start = state.pose
    for time, truth, markers in frames(100):
        image = image_of(truth)
        start, last = of_reference(tracker, state, markers, image, start)
        state, pose, _ = tracker.step(state, time, markers, [image])
        theirs = elbow_errors(on_device(Pose(*last)), truth)
        errors.append([elbow_errors(pose, truth), theirs])
    ours, theirs = np.mean(errors, (0, 2))
    assert abs(ours - theirs) < 0.002
