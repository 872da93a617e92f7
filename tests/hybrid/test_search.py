"""The search finds elbows that markers put elsewhere, doubts, remembers and forgets."""

from dataclasses import replace

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import on_device
from watched_arms import (
    FRONT,
    MODEL,
    SIDE,
    SIZE,
    TRUTH,
    elbow_errors,
    observed,
    picture_of,
    pictures,
    stacked,
    swivelled,
    true_arms,
    turned_by,
)

from jaxmocap.body.arms import TURNS, swivels, turn_between, turn_forearm
from jaxmocap.evidence.edges import EdgeFields
from jaxmocap.hybrid import elbow_search
from jaxmocap.hybrid.refine import search_elbows
from jaxmocap.hybrid.settings import Settings

pytestmark = pytest.mark.usefixtures("plainly_compiled")

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
    return elbow_search.believed_elbows(arms, turn)


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


def test_candidates_surround_the_markers_forearm_evenly():
    turns = np.degrees(TURNS)
    assert (np.linalg.norm(turns, axis=1) <= 75).all()
    assert np.linalg.norm(turns, axis=1).min() == 0
    np.testing.assert_array_equal(turns[:, 2], 0)
    apart = np.linalg.norm(turns[:, None] - turns, axis=-1) + 1e9 * np.eye(len(turns))
    np.testing.assert_allclose(apart.min(0), apart.min(), rtol=1e-6)
    np.testing.assert_allclose(turns.mean(0), 0, atol=1e-6)


def test_a_turned_forearm_keeps_its_grip_and_its_lengths():
    arm = jax.tree.map(lambda part: part[0], true_arms())
    same, slack = turn_forearm(arm, jnp.eye(3))
    np.testing.assert_allclose(same.elbow, arm.elbow, atol=1e-6)
    assert abs(float(slack)) < 1e-6
    angle = 0.4
    R = jnp.array(
        [[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]]
    )
    moved, slack = turn_forearm(arm, R.astype(jnp.float32))
    np.testing.assert_array_equal(moved.grip, arm.grip)

    def length(a, b):
        return np.linalg.norm(np.asarray(a) - np.asarray(b))

    assert length(moved.elbow, moved.grip) == pytest.approx(length(arm.elbow, arm.grip), abs=1e-6)
    assert length(moved.elbow, moved.shoulder) == pytest.approx(float(arm.humerus_length), abs=1e-6)
    assert length(moved.elbow, arm.shoulder) - float(arm.humerus_length) == pytest.approx(
        float(slack), abs=1e-6
    )


@pytest.mark.parametrize("angle", [-1.0, -0.2, 0.0, 0.7])
def test_the_reported_swivel_is_the_turn_about_shoulder_and_hand(angle):
    arms = turned_by(angle, -angle)
    np.testing.assert_allclose(swivels(true_arms(), arms), [angle, -angle], atol=1e-5)


def test_the_turn_between_two_arms_takes_one_elbow_to_the_other():
    arms, other = true_arms(), turned_by(0.7, -0.5)
    reached = elbows_of(arms, turn_between(arms, other))
    np.testing.assert_allclose(reached, other.elbow, atol=1e-5)
