"""Refinement: each arm goes to its own edges, hands stay, and what has no image is left alone."""

from dataclasses import replace

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import LIMITS, double, on_device
from drawn_arms import camera_at, draw, limbs_of
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from watched_arms import (
    DOFS,
    FRONT,
    MODEL,
    PERSON,
    SIDE,
    SIZE,
    TRUTH,
    arms_in,
    elbow_errors,
    observed,
    pictures,
    pose_off_by,
    stacked,
    swung,
    true_arms,
    turned_by,
)

from jaxmocap.body.arms import arms_of
from jaxmocap.body.kinematics import Sites, forward
from jaxmocap.body.model import Model
from jaxmocap.evidence.edges import EdgeFields
from jaxmocap.geometry.cameras import project
from jaxmocap.hybrid.fit import refine_arms
from jaxmocap.hybrid.observe import arm_regions
from jaxmocap.hybrid.settings import Settings, SimplexSettings
from jaxmocap.images.edges import EdgeSettings, Thresholds, equalise_levels, to_grey
from jaxmocap.images.regions import to_region
from jaxmocap.reference.hybrid import pipeline as reference

CAMERAS, BOTH = stacked(FRONT), stacked(FRONT, SIDE)
ALONE = Settings(region=SIZE, search=False)


@jax.jit
def alone(cameras, fields, pose, targets, elbows):
    """By the edges alone, as in the paper."""
    return refine_arms(replace(MODEL, cameras=cameras), ALONE, fields, pose, targets, elbows)


@jax.jit
def near_searched(cameras, fields, pose, targets, elbows):
    """Near the elbows that a search has found."""
    model, chosen = replace(MODEL, cameras=cameras), Settings(region=SIZE)
    return refine_arms(model, chosen, fields, pose, targets, elbows)


def refined(pose, images=None, cameras=CAMERAS, way=alone, fields=None):
    arms = arms_in(pose)
    fields = observed(images or pictures(FRONT), cameras, arms) if fields is None else fields
    return way(cameras, fields, pose, true_arms().grip, arms.elbow)


moves_of_arms = arrays(float, (2, 4), elements=st.floats(-0.6, 0.6))


@settings(max_examples=40)
@given(moves=moves_of_arms)
def test_a_swung_arm_is_the_one_of_its_joint_angles(moves):
    start = on_device(TRUTH)
    arms, angles = swung(start, on_device(moves))
    same = arms_in(start._replace(angles=start.angles.at[DOFS].set(angles)))
    for part in ("shoulder", "elbow", "wrist", "tip", "grip", "R_world_radius"):
        np.testing.assert_allclose(getattr(arms, part), getattr(same, part), atol=2e-5)
    # The elbow's angle is the pose's own and what was added.
    expected = np.asarray(start.angles)[DOFS[:, 3]] + moves[:, 3]
    np.testing.assert_allclose(angles[:, 3], expected, atol=1e-5)


@given(left=st.floats(-1.5, 1.5), right=st.floats(-1.5, 1.5))
def test_the_swivel_moves_no_hand(left, right):
    moves = on_device(np.array([[left, 0, 0, 0], [right, 0, 0, 0]]))
    arms, angles = swung(on_device(TRUTH), moves)
    np.testing.assert_allclose(arms.grip, true_arms().grip, atol=1e-5)
    np.testing.assert_allclose(arms.elbow, turned_by(left, right).elbow, atol=1e-5)
    assert np.abs(angles).max() < 2 * np.pi


def test_the_papers_simplex_over_each_arm_is_the_references_in_double_precision():
    small = 16
    rng = np.random.default_rng(0)

    @jax.jit
    def arms_and_regions(body, cameras, start, grips):
        arms = arms_of(body, forward(body, start), grips)
        return arms, arm_regions(cameras, arms, small, Settings.paper().margin)

    with double():
        body = jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf), float), PERSON)
        camera = jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf), float), FRONT)
        sites = MODEL.markers
        sites = Sites(sites.bones, on_device(sites.at), on_device(sites.offsets))
        model = Model.create(body, sites, camera)
        chosen = replace(Settings.paper(), region=small, simplex=SimplexSettings(iterations=10))
        start, grips = on_device(TRUTH), model.grips
        arms, region = arms_and_regions(body, stacked(camera), start, grips)
        plain = cv2.GaussianBlur(rng.uniform(0, 20, (small, small, 2)), (0, 0), 2)
        fields = EdgeFields(
            region, on_device(plain.transpose(2, 0, 1))[None, :, None], np.ones((1, 2), bool)
        )
        targets = arms.grip + 0.01
        ours = jax.jit(refine_arms)(model, chosen, fields, start, targets, arms.elbow)
    plain_body, plain_camera = jax.tree.map(np.asarray, (body, camera))
    for i, side in enumerate("lr"):
        origin, scale = np.asarray(region.origin)[0, i], float(region.scale[0, i])
        view = reference.ArmView(plain_camera, origin, scale, plain[..., i])
        dofs, angles = reference.refine_arm(
            plain_body, chosen, TRUTH, side, view, jax.tree.map(np.asarray, grips),
            np.asarray(targets)[i],
        )  # fmt: skip
        assert dofs == DOFS[i].tolist()
        assert np.abs(angles - TRUTH.angles[dofs]).max() > 1e-3
        np.testing.assert_allclose(np.asarray(ours.angles)[dofs], angles, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("off", [(0.25, -0.25), (-0.3, -0.3), (0.2, 0.0)])
def test_each_arm_goes_to_its_own_edges(off):
    start = pose_off_by(*off)
    before = elbow_errors(arms_in(start).elbow)
    actual = arms_in(refined(start))
    after = elbow_errors(actual.elbow)
    moved = np.array(off) != 0
    assert (before[moved] > 0.035).all()
    assert (after < 0.02).all()
    assert np.linalg.norm(actual.grip - true_arms().grip, axis=1).max() < 0.02


def test_swapped_regions_would_be_noticed():
    """The right arm's edges in the left arm's place lead astray: nothing here is symmetric."""
    start = pose_off_by(-0.3, -0.3)
    fields = observed(pictures(FRONT), CAMERAS, arms_in(start))
    crossed = jax.tree.map(lambda part: np.asarray(part)[:, ::-1], fields)
    for wrong in (
        fields._replace(distances=crossed.distances),
        fields._replace(region=crossed.region),
    ):
        after = elbow_errors(arms_in(refined(start, fields=wrong)).elbow)
        assert (after > 0.03).any()


def test_an_image_is_equalised_whole_before_its_regions_are_cut():
    """So what is far from the arm counts too."""
    (picture,) = pictures(FRONT)
    picture = np.array(picture)
    picture[:40] = 255
    detection = EdgeSettings(equalise="image", blur_first=False, canny="thresholds", memory=0.0)
    both = {}
    for equalise, image in {
        "image": picture,
        "none": equalise_levels(to_grey(picture), detection, Thresholds())[0],
        "region": picture,
    }.items():
        chosen = Settings(region=SIZE, edge_detection=replace(detection, equalise=equalise))
        both[equalise] = observed([image], CAMERAS, true_arms(), chosen).distances
    np.testing.assert_array_equal(both["image"], both["none"])
    assert (both["image"] != both["region"]).any()


def test_the_region_of_an_arm_is_around_that_arm():
    arms = true_arms()
    regions = jax.jit(lambda arms: arm_regions(BOTH, arms, SIZE, jnp.asarray(0.35)))(arms)
    assert regions.origin.shape == (2, 2, 2) and regions.scale.shape == (2, 2)
    for c, camera in enumerate((FRONT, SIDE)):
        for arm in range(2):
            own = jax.tree.map(lambda part, at=(c, arm): part[at], regions)
            ends = jnp.stack([part[arm] for part in (arms.shoulder, arms.elbow, arms.tip)])
            inside = np.asarray(to_region(own, project(camera, ends)))
            assert (inside > 0).all() and (inside < SIZE - 1).all()
            middle = (inside.min(0) + inside.max(0)) / 2
            np.testing.assert_allclose(middle, (SIZE - 1) / 2, atol=1.5)


def test_the_fields_of_an_arm_hold_that_arms_edges():
    """Only the left arm is in the picture: its own region sees it, the right one's does not."""
    left_only = [draw(FRONT, list(limbs_of(PERSON, TRUTH))[:3])]
    near = observed(left_only, CAMERAS, true_arms())
    assert near.available.tolist() == [[True, False]]
    assert (np.asarray(near.distances)[0, 0] == 0).any()
    right_only = [draw(FRONT, list(limbs_of(PERSON, TRUTH))[3:])]
    assert observed(right_only, CAMERAS, true_arms()).available.tolist() == [[False, True]]


def test_each_camera_looks_into_its_own_picture():
    front, side = pictures(FRONT, SIDE)
    black = np.zeros_like(front)
    assert observed([front, black], BOTH, true_arms()).available.tolist() == [
        [True] * 2,
        [False] * 2,
    ]
    assert observed([None, side], BOTH, true_arms()).available.tolist() == [[False] * 2, [True] * 2]
    colour = np.repeat(front[..., None], 3, -1)
    by_colour = observed([colour, None], BOTH, true_arms())
    by_grey = observed([front, None], BOTH, true_arms())
    np.testing.assert_array_equal(by_colour.distances, by_grey.distances)


@pytest.mark.parametrize("flags", [(False, False), (True, False), (False, True)])
def test_an_arm_without_an_image_stays_as_it_is(flags):
    start = pose_off_by(0.25, -0.25)
    fields = observed(pictures(FRONT), CAMERAS, arms_in(start))._replace(
        available=np.array([flags])
    )
    after = refined(start, fields=fields)
    change = np.abs(np.asarray(after.angles - start.angles))
    for arm, watched in enumerate(flags):
        assert (change[DOFS[arm]].max() > 0.01) == watched
    np.testing.assert_array_equal(np.delete(change, DOFS.ravel()), 0)
    np.testing.assert_array_equal(after.position, start.position)
    np.testing.assert_array_equal(after.quaternion, start.quaternion)


@pytest.mark.parametrize("way", [alone, near_searched])
def test_hands_stay_and_limits_hold_whatever_the_picture(way):
    rng = np.random.default_rng(0)
    noise = rng.integers(0, 255, (480, 640)).astype(np.uint8)
    start = pose_off_by(0.1, 0.1)
    after = refined(start, [noise], way=way)
    assert np.isfinite(after.angles).all()
    angles = np.asarray(after.angles)
    assert (angles >= LIMITS[:, 0] - 1e-5).all() and (angles <= LIMITS[:, 1] + 1e-5).all()
    assert np.linalg.norm(arms_in(after).grip - true_arms().grip, axis=1).max() < 0.02


def test_hands_come_back_to_their_markers():
    """A hand that is off its marker by 3 cm is drawn to it."""
    start = pose_off_by(0.0, 0.0)
    bent = start._replace(angles=start.angles.at[DOFS[:, 3]].add(0.1))
    assert np.linalg.norm(arms_in(bent).grip - true_arms().grip, axis=1).min() > 0.02
    after = arms_in(refined(bent))
    assert np.linalg.norm(after.grip - true_arms().grip, axis=1).max() < 0.01


def test_the_searched_elbow_decides_where_edges_are_far():
    """A picture of somebody far away: the elbows that the search found decide."""
    start = pose_off_by(0.0, 0.0)
    far = camera_at((2.2, 0.3, 1.35), (0.0, 6.0, 1.15))
    fields = observed(pictures(FRONT), CAMERAS, true_arms())
    blind = fields._replace(distances=np.full_like(np.asarray(fields.distances), 20.0))
    wanted = turned_by(0.2, -0.2)
    after = arms_in(near_searched(stacked(far), blind, start, true_arms().grip, wanted.elbow))
    missed = np.linalg.norm(after.elbow - wanted.elbow, axis=1)
    assert missed.max() < 0.01
    assert np.linalg.norm(after.grip - true_arms().grip, axis=1).max() < 0.01


def test_two_cameras_find_more_than_one():
    start = pose_off_by(-0.3, 0.35)
    images = pictures(FRONT, SIDE)
    one = elbow_errors(arms_in(refined(start, images[:1])).elbow)
    two = elbow_errors(arms_in(refined(start, images, BOTH)).elbow)
    assert (two < 0.02).all()
    assert two[1] < one[1] + 0.002
