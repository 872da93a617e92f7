"""The search finds elbows that markers put elsewhere, warnings_before, remembers and forgets."""

from dataclasses import replace

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import double, in_double, on_device
from references import elbow_search as reference
from watched_arms import (
    FRONT,
    GRIPS,
    MODEL,
    PERSON,
    SIDE,
    SIZE,
    TRUTH,
    arms_in,
    elbow_errors,
    observed,
    picture_of,
    pictures,
    stacked,
    swivelled,
    true_arms,
    turned_by,
)
from waving_arms import BODY, image_of, waving

from jaxmocap.body.arms import arms_of, swivels, turn_between
from jaxmocap.body.kinematics import forward
from jaxmocap.evidence.edges import EdgeFields
from jaxmocap.hybrid import elbow_search
from jaxmocap.hybrid.refine import search_elbows
from jaxmocap.hybrid.settings import Settings
from jaxmocap.reference.hybrid import pipeline

SETTINGS = Settings(region=SIZE)
SEARCH = SETTINGS.elbow_search
ONE, BOTH = stacked(FRONT), stacked(FRONT, SIDE)
FRAME_S = 1 / 30


@jax.jit
def step(cameras, fields, arms, belief):
    """The belief after an image that comes a frame later."""
    waiting = belief._replace(age=belief.age + jnp.asarray(FRAME_S, belief.age.dtype))
    return elbow_search.search(SETTINGS, cameras, fields, arms, waiting)


@jax.jit
def elbows_of(arms, turn):
    return elbow_search.expected_elbows(arms, turn)


@jax.jit
def searched(cameras, arms, fields, belief):
    return search_elbows(replace(MODEL, cameras=cameras), SETTINGS, arms, fields, belief)


def prior_belief():
    return elbow_search.no_belief(SEARCH, on_device(TRUTH))


def believed(images, cameras, arms, frames=5, belief=None):
    """The belief after some frames of the same pictures."""
    belief = prior_belief() if belief is None else belief
    fields = observed(images, cameras, arms)
    for _ in range(frames):
        belief = step(cameras, fields, arms, belief)
    return belief


@pytest.mark.parametrize("turn", [(0.9, -0.9), (-0.9, -0.9)])
def test_it_finds_elbows_that_the_markers_miss_by_15_cm(turn):
    arms = turned_by(*turn)
    assert (elbow_errors(arms.elbow) > 0.145).all()
    belief = believed(pictures(FRONT), ONE, arms)
    assert (elbow_errors(elbows_of(arms, belief.turn)) < 0.03).all()
    assert (np.asarray(belief.deviation) < 0.05).all()


def test_where_markers_are_right_it_leaves_them_alone():
    belief = believed(pictures(FRONT), ONE, true_arms())
    assert (elbow_errors(elbows_of(true_arms(), belief.turn)) < 0.02).all()


def test_a_second_camera_sees_what_one_cannot():
    """From the front the right elbow swivels along the line of sight."""
    arms = turned_by(-0.9, 1.0)
    alone = believed(pictures(FRONT), ONE, arms)
    together = believed(pictures(FRONT, SIDE), BOTH, arms)
    error = elbow_errors(elbows_of(arms, alone.turn))
    error_of_both = elbow_errors(elbows_of(arms, together.turn))
    assert error[1] > 0.05 > error_of_both[1]
    assert together.deviation[1] < alone.deviation[1]


# Against the reference ---------------------------------------------------------------------------

GRIPS_64 = jax.tree.map(np.asarray, GRIPS)


def markers_pose_at(time: float):
    """Somebody waves; markers alone have the elbows astray, and the hands where they are."""
    truth = waving(time)
    angles = truth.angles.copy()
    for side, swivel in (("l", 0.7), ("r", -0.5)):
        moves = np.array([swivel, 0.0, 0.0, 0.0])
        dofs = pipeline.arm_dofs(BODY, side)
        angles[dofs] = pipeline.swing(BODY, truth, side, GRIPS_64, moves)[2]
    return truth._replace(angles=angles)


def test_over_some_frames_the_search_is_the_references_in_double_precision():
    """Costs of all candidates, the weights that frames hand on, the elbows; a frame is lost."""
    small = Settings(region=32)
    times = np.delete(np.arange(5) * 0.2, 2)
    weights = np.zeros((2, len(reference.forearm_turns())))
    with double():
        chosen, person, camera = in_double((small, PERSON, FRONT))
        cameras = stacked(camera)
        filtered = jax.jit(elbow_search.search)
        arms_at = jax.jit(lambda pose: arms_of(person, forward(person, pose), in_double(GRIPS)))
        belief = elbow_search.no_belief(chosen.elbow_search, on_device(TRUTH))
    for before, time in zip([-0.2, *times], times, strict=False):
        pose = markers_pose_at(time)
        fields = observed([image_of(waving(time))], ONE, arms_in(on_device(pose)), small)
        origin, scale = (np.asarray(part, float)[0] for part in fields.region)
        with double():
            arms = arms_at(on_device(pose))
            waiting = belief._replace(age=jnp.asarray(time - before))
            belief = filtered(chosen, cameras, in_double(fields), arms, waiting)
            elbows = elbow_search.expected_elbows(arms, belief.turn)
        for i, side in enumerate("lr"):
            distances = np.asarray(fields.distances, float)[0, i]
            view = reference.EdgeView(camera, origin[i], scale[i], distances)
            arm = reference.arm_of(BODY, pose, GRIPS_64, side)
            expected = reference.filter_weights(small, view, arm, weights[i], time - before)
            weights[i] = expected.log_weights
            np.testing.assert_allclose(belief.log_weights[i], weights[i], rtol=1e-7, atol=1e-7)
            np.testing.assert_allclose(belief.turn[i], expected.turn, atol=1e-8)
            assert belief.deviation[i] == pytest.approx(expected.deviation, rel=1e-6)
            elbow = reference.turn_forearm(arm, expected.turn)[0][1]
            np.testing.assert_allclose(elbows[i], elbow, atol=1e-8)


def stripes() -> np.ndarray:
    """Edges everywhere and in all directions: they fit any arm."""
    noise = np.random.default_rng(0).integers(0, 255, (160, 214)).astype(np.uint8)
    return cv2.resize(noise, (640, 480), interpolation=cv2.INTER_NEAREST)


def test_an_image_that_fits_everything_leaves_the_doubt():
    arms = turned_by(0.6, -0.6)
    clear = believed(pictures(FRONT), ONE, arms, 3)
    vague = believed([stripes()], ONE, arms, 3)
    assert (np.asarray(vague.deviation) > 2 * np.asarray(clear.deviation)).all()
    assert (np.asarray(vague.deviation) > 0.08).all()


def test_two_answers_stay_alive_until_a_clear_image_decides():
    """The arm and its double, drawn into one picture."""
    arms = true_arms()
    other = picture_of(turned_by(-0.9, -0.9))
    double = np.maximum(pictures(FRONT)[0], other)
    middle = swivelled(arms, jnp.full(2, -0.45, jnp.float32))
    torn = believed([double], ONE, middle, 3)
    sure = believed(pictures(FRONT), ONE, middle, 3)
    assert (np.asarray(torn.deviation) > 1.3 * np.asarray(sure.deviation)).all()
    decided = believed(pictures(FRONT), ONE, middle, 4, torn)
    assert (elbow_errors(elbows_of(middle, decided.turn)) < 0.04).all()


def test_the_picture_of_arms_is_the_picture_of_their_pose():
    apart = picture_of(true_arms()).astype(int) - pictures(FRONT)[0]
    assert np.abs(apart).max() < 60


def test_memory_outlives_a_bad_image():
    arms = turned_by(0.8, -0.8)
    actual = believed(pictures(FRONT), ONE, arms)
    after = believed([stripes()], ONE, arms, 1, actual)
    assert (elbow_errors(elbows_of(arms, after.turn)) < 0.06).all()
    assert (np.asarray(after.deviation) > np.asarray(actual.deviation)).all()


def test_a_blind_arm_drifts_back_to_the_markers():
    arms = turned_by(0.8, -0.8)
    actual = believed(pictures(FRONT), ONE, arms)
    fields = observed(pictures(FRONT), ONE, arms)
    left_only = fields._replace(available=np.array([[True, False]]))
    belief = actual
    for _ in range(20):
        belief = step(ONE, left_only, arms, belief)
    left, right = elbow_errors(elbows_of(arms, belief.turn))
    assert left < 0.03
    assert right > 0.08
    assert belief.deviation[1] > 2 * actual.deviation[1]


def test_without_images_the_turn_fades_and_the_doubt_grows():
    arms = turned_by(0.8, -0.8)
    actual = believed(pictures(FRONT), ONE, arms)
    ages = [0.0, 0.1, 0.3, 0.6, 1.0, 2.0, 10.0]
    turns, spreads = [], []
    for age in ages:
        turn, spread = elbow_search.without_image(
            SEARCH, actual._replace(age=jnp.asarray(age, float))
        )
        turns.append(np.linalg.norm(turn, axis=1))
        spreads.append(np.asarray(spread))
    np.testing.assert_allclose(turns[0], np.linalg.norm(actual.turn, axis=1), rtol=1e-5)
    assert (np.diff(turns, axis=0) < 0).all() and (turns[-1] < 1e-3).all()
    assert (np.diff(spreads, axis=0) >= 0).all()
    np.testing.assert_allclose(spreads[-1], SEARCH.elbow_prior, rtol=1e-5)


def test_a_frame_without_an_image_changes_no_belief():
    arms = turned_by(0.5, -0.5)
    actual = believed(pictures(FRONT), ONE, arms)
    nothing = observed([None], ONE, arms)
    later = actual._replace(age=jnp.asarray(0.1, jnp.float32))
    kept, elbows = searched(ONE, arms, nothing, later)
    for part, before in zip(jax.tree.leaves(kept), jax.tree.leaves(later), strict=True):
        np.testing.assert_array_equal(part, before)
    carried = elbow_search.without_image(SEARCH, later)[0]
    np.testing.assert_allclose(elbows, elbows_of(arms, carried), atol=1e-6)


@pytest.mark.parametrize("grey", [0, 255])
def test_a_black_or_white_image_is_no_image(grey):
    nothing = observed([np.full((480, 640, 3), grey, np.uint8)], ONE, true_arms())
    assert not nothing.available.any()
    assert np.isfinite(nothing.distances).all()


def test_before_the_first_image_the_markers_pose_is_expected():
    belief = prior_belief()
    np.testing.assert_allclose(elbows_of(true_arms(), belief.turn), true_arms().elbow, atol=1e-6)
    np.testing.assert_allclose(belief.deviation, SEARCH.elbow_prior)
    assert (np.asarray(belief.deviation) > 0.1).all()


def test_fields_of_a_camera_without_an_image_may_hold_anything():
    arms = turned_by(0.5, -0.5)
    fields = observed(pictures(FRONT, SIDE), BOTH, arms)
    spoilt = np.array(fields.distances)
    spoilt[1] = np.nan
    half = EdgeFields(fields.region, spoilt, np.array([[True, True], [False, False]]))
    belief = step(BOTH, half, arms, prior_belief())
    alone = step(ONE, observed(pictures(FRONT), ONE, arms), arms, prior_belief())
    np.testing.assert_allclose(belief.turn, alone.turn, atol=1e-5)


@pytest.mark.parametrize("angle", [-1.0, -0.2, 0.0, 0.7])
def test_the_reported_swivel_is_the_turn_about_shoulder_and_hand(angle):
    arms = turned_by(angle, -angle)
    np.testing.assert_allclose(swivels(true_arms(), arms), [angle, -angle], atol=1e-5)


def test_the_turn_between_two_arms_takes_one_elbow_to_the_other():
    arms, other = true_arms(), turned_by(0.7, -0.5)
    reached = elbows_of(arms, turn_between(arms, other))
    np.testing.assert_allclose(reached, other.elbow, atol=1e-5)
