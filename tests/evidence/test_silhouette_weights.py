"""How much each silhouette counts is the settings' to say, for solves and candidates."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from painted_motion import SETTINGS, disturbed, elbow_errors, problem, views

from jaxmocap.body.pose import Pose
from jaxmocap.evidence.silhouettes import SilhouetteGrids
from jaxmocap.images.silhouette_grid import Grid
from jaxmocap.smoothing.elbow_viterbi import elbow_path
from jaxmocap.smoothing.linearise import smooth_poses
from jaxmocap.smoothing.problem import SmoothingProblem, Views

COUNT, SOFTNESS = 4, (1.5,)
PICTURES = ("person", "forearms")


def misled(picture: str) -> Views:
    """Of camera 0, but one of the pictures shows the opposite."""
    shown = views(COUNT)
    grid: Grid = getattr(shown.grids, picture)
    wrong = grid._replace(probability=1 - np.asarray(grid.probability))
    return shown._replace(grids=shown.grids._replace(**{picture: wrong}))


def without(picture: str) -> Views:
    """Of camera 0, but one of the pictures is empty."""
    shown = views(COUNT)
    grid: Grid = getattr(shown.grids, picture)
    empty = Grid(*(0 * part for part in grid))
    return shown._replace(grids=shown.grids._replace(**{picture: empty}))


def weighing(shown: Views, **weights: float) -> SmoothingProblem:
    """The painted motion in these views, with weights of the pictures."""
    numbers = {name: jnp.asarray(weight, float) for name, weight in weights.items()}
    silhouettes = replace(SETTINGS.silhouettes, **numbers)
    settings = replace(SETTINGS, silhouettes=silhouettes)
    return replace(problem(COUNT, shown), settings=settings)


def solved(given: SmoothingProblem) -> Pose:
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
    start = disturbed(COUNT, 40.0)
    usual = elbow_path(weighing(misled(picture)), start).goals
    led = elbow_path(weighing(misled(picture), **{picture: 0.0}), start).goals
    np.testing.assert_array_equal(led, elbow_path(weighing(without(picture)), start).goals)
    assert np.linalg.norm(usual - led, axis=-1).mean() > 0.05


def test_by_default_both_pictures_count_as_they_are():
    grids = views(COUNT).grids
    same, half = (
        weighing(views(COUNT), **weights).settings.silhouettes.weigh(grids)
        for weights in ({}, {"forearms": 0.5})
    )
    assert isinstance(half, SilhouetteGrids)
    for grid, own in zip(grids[1:3], same[1:3], strict=True):
        np.testing.assert_array_equal(own.weight, grid.weight)
        assert own.weight.dtype == np.asarray(grid.weight).dtype
    np.testing.assert_array_equal(half.forearms.weight, 0.5 * np.asarray(grids.forearms.weight))
    np.testing.assert_array_equal(half.person.weight, grids.person.weight)
