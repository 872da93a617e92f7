"""The smoothed trajectory's derivative: by lengths, cameras and marker offsets, as differences say.

In double precision, on a painted recording; each difference is taken between two minima, solved
anew. The cells in which limbs meet are left out: they change hands in jumps.
"""

from dataclasses import replace
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import double, on_device
from hypothesis import given, settings
from hypothesis import strategies as st
from painted_motion import (
    CAMERAS,
    CELLS,
    PERSON,
    disturbed,
    problem,
    truth,
    views,
)

from jaxmocap.body.kinematics import forward
from jaxmocap.body.model import Model
from jaxmocap.body.pose import Pose
from jaxmocap.calibration.fitting import sensitivity
from jaxmocap.calibration.fitting.sensitivity import Sensitivity
from jaxmocap.evidence.silhouettes import project_limbs
from jaxmocap.geometry.outlines import Discs, touch
from jaxmocap.geometry.rotations import exp
from jaxmocap.images.silhouette_grid import cells
from jaxmocap.smoothing.linearise import smooth_poses
from jaxmocap.smoothing.problem import SmoothingProblem, Trajectory, Views, all_turned

COUNT, SOFTNESS = 4, 0.6
# Cells by which the second nearest limb is away where no two limbs meet, blurred as they are.
APART = 3.0
STEP = 1e-5
# Newton steps to the solution.
SETTLED = 4


@pytest.fixture(autouse=True, scope="module")
def small_batches():
    """As many frames in a call as there are: none is worked through that only fills it up."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sensitivity, "A_CALL", COUNT)
        yield


@jax.jit
def second_nearest(pose, camera, grids):
    """Distance (S, S) of each cell to the limb that is second nearest to it."""
    discs, _ = project_limbs(PERSON, forward(PERSON, pose), camera, grids)
    each = Discs(*(part[:, None] for part in discs))
    distances = touch(each, *cells(CELLS, discs.near.dtype)).distance
    return jnp.sort(distances, 0)[1].reshape(CELLS, CELLS)


def untied(shown: Views) -> Views:
    """Views without the cells in which limbs meet."""
    poses, kept = truth(COUNT), []
    for row, (frame, camera) in enumerate(zip(shown.frame, shown.camera, strict=True)):
        grids = on_device(jax.tree.map(lambda part, row=row: part[row], shown.grids))
        pose = on_device(Pose(*(part[frame] for part in poses)))
        kept.append(np.asarray(second_nearest(pose, CAMERAS[camera], grids)) > APART)
    weight = np.stack(kept).astype(np.float32)
    return shown._replace(grids=shown.grids.each_grid(lambda grid: grid._replace(weight=weight)))


def in_double(tree):
    """Floats in double precision, indices as they are."""

    def wide(leaf):
        is_integer = np.asarray(leaf).dtype.kind in "iu"
        return leaf if is_integer else np.asarray(leaf, np.float64)

    return jax.tree.map(wide, tree)


@cache
def recording(blind: bool = False) -> tuple[SmoothingProblem, Trajectory]:
    """A painted recording, or one without any view, and, nearly, its solution."""
    with jax.enable_x64(False):
        shown = untied(views(COUNT, (0, 1)))
        single = problem(COUNT, shown.none if blind else shown)
        actual = smooth_poses(single, disturbed(COUNT, 5.0), (SOFTNESS,))
    parts = {
        name: in_double(getattr(single, name))
        for name in ("model", "settings", "measured", "views")
    }
    return replace(single, **parts), in_double(actual.trajectory)


@cache
def solution() -> Sensitivity:
    return Sensitivity.at(*recording(), SOFTNESS).settled(SETTLED)


NUMBERS = (
    "upper arm", "trunk", "camera turned", "camera moved", "focal length", "marker moved",
)  # fmt: skip


def state(numbers: jax.Array) -> Model:
    """A model by ``NUMBERS``: camera 0, turned about a slanted axis; the left wrist's marker."""
    stated = jax.tree.map(jnp.asarray, recording()[0].model)
    skeleton, cameras = stated.skeleton, stated.cameras
    arm, trunk = (PERSON.tree.bone(name) for name in ("humerus_l", "spine2"))
    lengths = skeleton.lengths.at[arm].add(numbers[0]).at[trunk].add(numbers[1])
    T, slanted = cameras.T_cam_world, jnp.array([0.5, 0.6, 0.4])
    T = T.at[0, :3].set(exp(numbers[2] * slanted) @ T[0, :3]).at[0, 0, 3].add(numbers[3])
    matrix = cameras.matrix.at[0, :2, :2].multiply(1 + numbers[4], unique_indices=True)
    offsets = stated.markers.offsets.at[1, 0].add(numbers[5])
    moved = replace(
        stated,
        skeleton=replace(skeleton, lengths=lengths),
        cameras=replace(cameras, T_cam_world=T, matrix=matrix),
    )
    return replace(moved, markers=replace(moved.markers, offsets=offsets))


def stated_by(given: SmoothingProblem, numbers: jax.Array) -> SmoothingProblem:
    """The recording with its model by ``NUMBERS``."""
    return replace(given, model=state(numbers))


def resolved(numbers: np.ndarray) -> np.ndarray:
    """Landmarks (T, L, 3) of the minimum with this stated."""
    given, there = stated_by(recording()[0], jnp.asarray(numbers)), solution().trajectory
    return Sensitivity.at(given, there, SOFTNESS).settled(2).landmarks


def test_landmarks_follow_as_differences_between_minima_say():
    """Along all numbers at once: a derivative that is wrong by one of them is wrong along it."""
    with double():
        still, way = jnp.zeros(len(NUMBERS)), jnp.array([1.0, -0.7, 0.4, 0.8, -0.3, 0.6])
        change = jax.jvp(state, (still,), (way,))[1]
        ahead, behind = (resolved(sign * STEP * np.asarray(way)) for sign in (1, -1))
        expected = (ahead - behind) / (2 * STEP)
        actual = solution().forwards(change)
    assert np.abs(expected).max() > 0.01
    np.testing.assert_allclose(actual, expected, atol=1e-5 * np.abs(expected).max())


def test_cameras_that_were_found_turned_belong_to_the_model():
    with double():
        given, there = recording()
        turns = np.array([[2e-3, -5e-3, 1e-3], [0.0, 4e-3, -2e-3]])
        cameras = in_double(all_turned(given.model.cameras, turns))
        wrong = replace(given, model=replace(given.model, cameras=cameras))
        back = np.asarray(all_turned(cameras, -turns).T_cam_world)
        np.testing.assert_allclose(back, given.model.cameras.T_cam_world, atol=1e-12)
        actual = Sensitivity.at(wrong, there._replace(turns_cam=-turns), SOFTNESS)
        expected = Sensitivity.at(given, there, SOFTNESS).slopes.equations.gradient
        unaware = Sensitivity.at(wrong, there, SOFTNESS).slopes.equations.gradient
    scale = np.abs(expected).max()
    np.testing.assert_allclose(actual.slopes.equations.gradient, expected, atol=1e-9 * scale)
    assert np.abs(unaware - expected).max() > 0.01 * scale


def test_without_silhouettes_the_markers_alone_move_the_body():
    with double():
        blind, there = recording(blind=True)
        here = Sensitivity.at(blind, there, SOFTNESS).settled(SETTLED)
        assert here.slopes.exact and here.slopes.equations.step(0.0, 0.0).largest() < 1e-9
        still = jnp.zeros(len(NUMBERS))
        ways = {name: jnp.eye(len(NUMBERS))[i] for i, name in enumerate(NUMBERS)}
        actual = {
            name: here.forwards(jax.jvp(state, (still,), (way,))[1]) for name, way in ways.items()
        }
        moved = STEP * ways["marker moved"]
        ahead, behind = (
            Sensitivity.at(stated_by(blind, at), here.trajectory, SOFTNESS).settled(3)
            for at in (moved, -moved)
        )
    expected = (ahead.landmarks - behind.landmarks) / (2 * STEP)
    assert np.abs(expected).max() > 0.5
    np.testing.assert_allclose(actual["marker moved"], expected, atol=1e-5)
    # No camera has a view.
    assert not actual["camera turned"].any() and not actual["focal length"].any()


@settings(max_examples=4)
@given(st.integers(0, 2**31))
def test_backwards_is_the_transpose_of_forwards(seed):
    """By the whole model, whatever the direction and whatever the loss."""
    rng = np.random.default_rng(seed)
    with double():
        here = solution()
        change = jax.tree.map(
            lambda part: jnp.asarray(rng.normal(size=np.shape(part))), here.problem.model
        )
        by_landmarks = rng.normal(size=here.landmarks.shape)
        passed = jax.tree.leaves(here.backwards(by_landmarks))
        expected = np.sum(here.forwards(change) * by_landmarks)
        pairs = zip(passed, jax.tree.leaves(change), strict=True)
        actual = sum(float(jnp.sum(own * way)) for own, way in pairs)
    assert actual == pytest.approx(expected, rel=1e-7, abs=1e-6)


def test_newtons_steps_end_at_the_minimum():
    with double():
        begun, here = Sensitivity.at(*recording(), SOFTNESS), solution()
        sizes = [at.slopes.equations.step(0.0, 0.0).largest() for at in (begun, here)]
    assert sizes[0] > 1e-6 and sizes[1] < 1e-10
    assert here.slopes.exact
