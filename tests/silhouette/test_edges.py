"""Boundaries between limbs by their colours, and joints that are held at rest."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxmocap.body.pose import relaxed_pose
from jaxmocap.body.skeleton import Skeleton, with_joints
from jaxmocap.body.tree import ROOT_DOF
from jaxmocap.images.regions import Region
from jaxmocap.silhouette.fit.correspond import Matches
from jaxmocap.silhouette.fit.cycles import combined_prior
from jaxmocap.silhouette.segmentation.inner_edges import (
    colour_boundary,
    colour_profiles,
    concatenate_pairs,
    inner_edge_pairs,
)
from jaxmocap.silhouette.surfaces.rim import Rim

SKIN, SHIRT = np.array([120, 150, 200]), np.array([150, 70, 60])
ROWS = np.arange(20, 60, 2)


def picture(left: np.ndarray, right: np.ndarray, at: int, noise: float = 6.0) -> np.ndarray:
    """Two colours, one to either side of a column's left edge."""
    image = np.empty((80, 80, 3))
    image[:, :at], image[:, at:] = left, right
    image += np.random.default_rng(0).normal(0, noise, image.shape)
    return np.clip(image, 0, 255).astype(np.uint8)


def rim_at(column: float, cameras: int = 1) -> Rim:
    """A rim of one outer point and an upright boundary, whose limb lies on the left."""
    count = len(ROWS) + 1
    pixels = np.stack([np.full(count, column), np.append(0, ROWS)], 1)
    row = (
        np.arange(count), pixels.astype(np.float32),
        np.tile(np.float32([1, 0]), (count, 1)), np.arange(count) > 0, np.ones(count, bool),
    )  # fmt: skip
    fields = [np.stack([part] * cameras) for part in row]
    masks = np.zeros((cameras, 4, 4), np.uint8)
    region = Region(np.zeros((cameras, 2)), np.full(cameras, 2.0))  # type: ignore[arg-type]
    return Rim(*fields, masks, region)


def edges_of(image: np.ndarray | None, column: float) -> Matches:
    return inner_edge_pairs([image], rim_at(column), np.zeros(len(ROWS) + 1, int))


@pytest.mark.parametrize("off", [-4.0, -1.3, 0.0, 2.6, 4.0])
def test_an_edge_is_found_from_a_place_beside_it(off):
    pairs = edges_of(picture(SKIN, SHIRT, 40), 39.5 + off)
    assert pairs.nodes.shape == (1, len(ROWS)) and pairs.valid.mean() > 0.9
    np.testing.assert_allclose(pairs.pixels_xy[pairs.valid][:, 0], 39.5, atol=1.0)
    np.testing.assert_array_equal(pairs.pixels_xy[0, :, 1], ROWS)
    np.testing.assert_allclose(pairs.distances[pairs.valid], abs(off), atol=1.0)


def test_one_and_the_same_shirt_has_no_edge_however_patterned():
    stripes = picture(SHIRT, SHIRT, 40)
    stripes[::6] = np.clip(stripes[::6] * 1.4, 0, 255)
    stripes[:, ::7] = np.clip(stripes[:, ::7] * 0.7, 0, 255)
    assert not edges_of(stripes, 40).valid.any()


def test_where_there_is_no_image_or_no_edge_within_reach_there_are_no_pairs():
    assert not edges_of(None, 40).valid.any()
    assert not edges_of(picture(SKIN, SHIRT, 60), 40).valid.any()


def test_too_few_points_of_a_bone_say_nothing_of_its_colours():
    image, rim = picture(SKIN, SHIRT, 40), rim_at(40)
    each_its_own = np.arange(len(ROWS) + 1)
    assert not inner_edge_pairs([image], rim, each_its_own).valid.any()


def test_profiles_run_along_the_normals():
    ramp = np.broadcast_to(np.arange(80, dtype=np.uint8)[None, :, None], (80, 80, 3))
    offsets = np.linspace(-4, 4, 9)
    profiles = colour_profiles(ramp, np.array([[30.0, 20.0]]), np.array([[-1.0, 0.0]]), offsets)
    np.testing.assert_allclose(profiles[0], (30 - offsets)[:, None] * np.ones(3), atol=0.1)


def test_a_boundary_lies_between_the_last_sample_of_one_colour_and_the_first_of_the_other():
    profiles = np.where(np.arange(21)[:, None] < 13, SKIN, SHIRT)[None].repeat(5, 0).astype(float)
    place, apart = colour_boundary(profiles)
    np.testing.assert_array_equal(place, 12.5)
    assert apart > 5


def test_edges_are_further_pairs():
    edges = edges_of(picture(SKIN, SHIRT, 40), 40)
    both = concatenate_pairs(edges, edges)
    assert both.valid.shape == (1, 2 * len(ROWS)) and both.pixels_xy.dtype == np.float32
    np.testing.assert_array_equal(both.nodes[:, len(ROWS) :], edges.nodes)


BODY = with_joints(Skeleton.human(1.75, proportions="winter"), "supple.toml")


def test_the_bodys_file_says_which_joints_are_held_at_rest():
    rest = np.asarray(BODY.rest_deviations)
    held = {name: value for name, value in zip(BODY.tree.joints, rest, strict=True) if value < 1}
    assert {name.removesuffix("_l").removesuffix("_r") for name in held} == {
        "clavicle_raise", "clavicle_protract", "elbow_twist", "wrist_deviate", "ankle_invert",
        "neck_flexion", "neck_bending", "neck_rotation",
    }  # fmt: skip
    assert held["clavicle_raise_l"] == np.float32(0.026)


def test_what_the_motion_and_rest_say_is_weighed_by_how_sure_they_are():
    pose = relaxed_pose(BODY)
    pose = pose._replace(angles=jnp.full_like(pose.angles, 0.3))
    neck = BODY.tree.joint("neck_flexion")
    rest = np.full(len(BODY.tree.joints), np.inf)
    rest[neck] = 0.1
    prior = combined_prior(pose, np.full(len(BODY.costs), 0.2), rest)
    angles, deviations = np.asarray(prior.pose.angles), np.asarray(prior.deviations)
    # One part of the motion's precision to four of rest's.
    assert angles[neck] == pytest.approx(0.3 / 5, rel=1e-5)
    assert deviations[ROOT_DOF + neck] == pytest.approx(0.2 / np.sqrt(5), rel=1e-5)
    others = np.delete(angles, neck)
    np.testing.assert_allclose(others, 0.3, rtol=1e-6)
    np.testing.assert_allclose(np.delete(deviations, ROOT_DOF + neck), 0.2, rtol=1e-6)
