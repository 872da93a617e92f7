"""A torso without legs and legs without arms: what a body's joints move."""

import numpy as np
import pytest

from jaxmocap.body.model_files import bodies
from jaxmocap.body.skeleton import LANDMARKS, Skeleton, with_joints
from jaxmocap.body.subject import rest_joints
from jaxmocap.body.surfaces.loft import generic_surface
from jaxmocap.body.surfaces.surface import Surface, rest_nodes
from jaxmocap.cli.silhouette.track import BODIES
from jaxmocap.silhouette.first_pose import landmark_points, pose_at_landmarks, standing_pose_at
from jaxmocap.silhouette.recovery.limbs import limb_chains
from jaxmocap.silhouette.surfaces.body_shape import (
    determined_landmarks,
    moved_bones,
    surface_of_body,
)

HUMAN = Skeleton.human(1.75)
SURFACE = generic_surface(HUMAN)
PATCHES = [patch.name for patch in SURFACE.patches]
ARMS, LEGS = {"arm_l", "arm_r"}, {"leg_l", "leg_r"}


def body(name: str) -> tuple[Skeleton, Surface]:
    skeleton = with_joints(HUMAN, f"{name}.toml")
    return skeleton, surface_of_body(SURFACE, skeleton, f"{name}.toml")


def test_the_options_bodies_are_those_that_there_are():
    assert {f"{name}.toml" for name in BODIES} == set(bodies())


@pytest.mark.parametrize(
    ("name", "patches", "limbs"),
    [
        ("torso", ["torso", "arm_l", "arm_r"], ARMS),
        ("legs", ["torso", "leg_l", "leg_r", "foot_l", "foot_r"], LEGS),
        *((name, PATCHES, ARMS | LEGS) for name in ("whole", "supple", "human")),
    ],
)
def test_a_body_has_the_papers_patches_and_searches_the_limbs_that_it_moves(name, patches, limbs):
    skeleton, surface = body(name)
    assert [patch.name for patch in surface.patches] == patches
    chains = limb_chains(skeleton, surface)
    assert set(chains) == limbs
    assert all(0.01 < radius < 0.12 for chain in chains.values() for radius in chain.radii)


@pytest.mark.parametrize("name", BODIES)
def test_no_node_lies_on_a_bone_that_stays(name):
    """But where the hip's skin begins to go over into the trunk."""
    skeleton, surface = body(name)
    moved = moved_bones(skeleton.tree)[surface.points.bones]
    assert np.sum(np.asarray(surface.points.shares) * moved, 1).min() > 0.5


def test_the_hip_is_the_torsos_lower_end_closed_at_the_waist():
    skeleton, surface = body("legs")
    joints = rest_joints(skeleton)
    hip, torso = surface.patches[0], SURFACE.patches[0]
    rings = hip.grid(rest_nodes(surface, joints))
    of_torso = torso.grid(rest_nodes(SURFACE, joints))
    np.testing.assert_allclose(rings[:-1], of_torso[: hip.along - 1], atol=1e-6)
    np.testing.assert_allclose(np.ptp(rings[-1], 0), 0, atol=1e-6)
    spine2 = joints[skeleton.tree.bone("spine2"), 2]
    assert abs(rings[-1, 0, 2] - spine2) < 0.05


def test_a_torso_begins_where_its_own_landmarks_are_however_the_legs_stand():
    skeleton = with_joints(HUMAN, "torso.toml")
    points = np.asarray(landmark_points(skeleton, standing_pose_at(skeleton, 0.3, 0.1, 0.5)), float)
    own = determined_landmarks(skeleton.tree)
    assert [LANDMARKS[i] for i in np.flatnonzero(~own)] == [
        f"{part}_{side}" for part in ("knee", "ankle", "toe") for side in "lr"
    ]
    kneeling = np.where(own[:, None], points, points + np.array([-0.3, 0.0, 0.2]))
    actual = landmark_points(skeleton, pose_at_landmarks(skeleton, kneeling))
    np.testing.assert_allclose(actual[own], points[own], atol=2e-3)
