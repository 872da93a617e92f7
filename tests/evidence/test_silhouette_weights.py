"""How much each silhouette counts is the settings' to say, for solves and candidates."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from painted_motion import MARKERS, PERSON, SETTINGS, disturbed, elbow_errors, problem, sights

from jaxmocap.body.arms import grips
from jaxmocap.body.pose import Pose
from jaxmocap.evidence.silhouettes import Sight, weighed
from jaxmocap.images.silhouette_grid import Grid
from jaxmocap.smoothing.elbow_viterbi import elbow_goals
from jaxmocap.smoothing.linearise import Problem, Sights, smooth_poses

COUNT, SOFTNESS = 6, (3.0, 0.8)
PICTURES = ("person", "forearms")


def misled(picture: str) -> Sights:
    """What camera 0 saw, but one of the pictures shows the opposite."""
    seen = sights(COUNT)
    grid: Grid = getattr(seen.sight, picture)
    wrong = grid._replace(probability=1 - np.asarray(grid.probability))
    return seen._replace(sight=seen.sight._replace(**{picture: wrong}))


def without(picture: str) -> Sights:
    """What camera 0 saw, but nothing is known of one of the pictures."""
    seen = sights(COUNT)
    grid: Grid = getattr(seen.sight, picture)
    return seen._replace(sight=seen.sight._replace(**{picture: Grid(*(0 * p for p in grid))}))


def weighing(seen: Sights, **weights: float) -> Problem:
    """The painted motion as seen, with weights of the pictures."""
    numbers = {name: jnp.asarray(weight, float) for name, weight in weights.items()}
    return replace(problem(COUNT, seen), settings=replace(SETTINGS, **numbers))


def solved(given: Problem) -> Pose:
    return smooth_poses(given, disturbed(COUNT), SOFTNESS).trajectory.poses


@pytest.mark.parametrize("picture", PICTURES)
def test_a_picture_without_weight_misleads_no_solve(picture):
    blind = solved(weighing(without(picture)))
    led = solved(weighing(misled(picture), **{picture: 0.0}))
    for own, expected in zip(led, blind, strict=True):
        np.testing.assert_array_equal(own, expected)
    # With its usual weight it does.
    assert elbow_errors(solved(weighing(misled(picture)))).mean() > elbow_errors(led).mean() + 0.02


@pytest.mark.parametrize("picture", PICTURES)
def test_a_picture_without_weight_prices_no_candidate(picture):
    start, held = disturbed(COUNT, 40.0), grips(PERSON, MARKERS)
    usual = elbow_goals(weighing(misled(picture)), start, held)
    led = elbow_goals(weighing(misled(picture), **{picture: 0.0}), start, held)
    np.testing.assert_array_equal(led, elbow_goals(weighing(without(picture)), start, held))
    assert np.linalg.norm(usual - led, axis=-1).mean() > 0.05


def test_by_default_both_pictures_count_as_they_were_seen():
    sight = sights(COUNT).sight
    same, half = (
        weighed(sight, weighing(sights(COUNT), **weights).settings)
        for weights in ({}, {"forearms": 0.5})
    )
    assert isinstance(half, Sight)
    for grid, own in zip(sight[1:3], same[1:3], strict=True):
        np.testing.assert_array_equal(own.weight, grid.weight)
        assert own.weight.dtype == np.asarray(grid.weight).dtype
    np.testing.assert_array_equal(half.forearms.weight, 0.5 * np.asarray(sight.forearms.weight))
    np.testing.assert_array_equal(half.person.weight, sight.person.weight)
