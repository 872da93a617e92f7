"""The public smoother by silhouettes: where it ends, and how that follows what was stated.

On a painted recording. Derivatives are in double precision, each difference taken between two
minima; the cells in which limbs meet are left out of them: they change hands in jumps.
"""

from dataclasses import replace
from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import double, in_double, on_device
from painted_motion import (
    CAMERAS,
    MODEL,
    PERSON,
    RATE,
    SETTINGS,
    disturbed,
    elbow_errors,
    limb_distances,
    measurements,
    problem,
    truth,
    views,
)

import jaxmocap
from jaxmocap.body.model import Model
from jaxmocap.body.pose import Pose
from jaxmocap.evidence.silhouettes import SilhouetteGrids
from jaxmocap.geometry.rotations import exp
from jaxmocap.hybrid.settings import Settings
from jaxmocap.images.silhouette_grid import blur_grid
from jaxmocap.smoothing.functions import SOFTNESS, Events, SmoothMotion
from jaxmocap.smoothing.linearise import smooth_poses
from jaxmocap.smoothing.settings import weigh_by_time

COUNT = 4
# Cells by which the second nearest limb is away where no two limbs meet, blurred as they are.
APART = 3.0
STEP, ROUNDS = 1e-4, 2
# As many steps as the recording of sure lengths may take: one program for all.
PATIENT = replace(SETTINGS, iterations=200)
CHOSEN = Settings(smoothing=PATIENT)
NUMBERS = (
    "upper arm", "trunk", "camera turned", "camera moved", "focal length", "marker moved",
)  # fmt: skip
WAY = np.array([1.0, -0.7, 0.4, 0.8, -0.3, 0.6])
smooth = jax.jit(jaxmocap.smooth)


@cache
def silhouettes(untied: bool = False) -> SilhouetteGrids:
    """Of both cameras (T, C, ...), with or without the cells in which limbs meet."""
    each = [views(COUNT, (camera,)).grids for camera in range(len(CAMERAS))]
    each = [grids.each_grid(partial(blur_grid, softness=SOFTNESS)) for grids in each]
    stacked = jax.tree.map(lambda *parts: np.stack(parts, 1), *each)
    if not untied:
        return stacked
    weight = np.ones_like(stacked.person.weight)
    for view in np.ndindex(weight.shape[:2]):
        grids = on_device(jax.tree.map(lambda part, view=view: part[view], stacked))
        pose = on_device(Pose(*(part[view[0]] for part in truth(COUNT))))
        # Where the second nearest limb is well away.
        weight[view] = np.asarray(limb_distances(pose, CAMERAS[view[1]], grids)[1]) > APART
    return stacked.each_grid(lambda grid: grid._replace(weight=weight))


def events(grids: SilhouetteGrids | None) -> Events:
    times = np.arange(COUNT) / RATE
    return Events(times, measurements(COUNT), disturbed(COUNT, 5.0).poses, grids)


def test_silhouettes_put_the_elbows_where_they_are():
    blind, sighted = (smooth(MODEL, CHOSEN, events(grids)) for grids in (None, silhouettes()))
    assert elbow_errors(blind.poses).max() > 0.03
    assert elbow_errors(sighted.poses).max() < 0.01


@pytest.mark.parametrize("degrees", [2.0, 3.0])
def test_the_minimum_is_that_of_a_recording_whose_lengths_are_sure(degrees):
    """Two valleys lie 0.8 mm apart at an elbow; from other starts each descent may take its own."""
    surely = replace(PATIENT, proportions=1e6)
    given = problem(COUNT, views(COUNT, (0, 1)))
    given = replace(given, settings=weigh_by_time(surely, given.times))
    start = disturbed(COUNT, degrees)
    ended = smooth_poses(given, start, (SOFTNESS,), 1e-7)
    expected = elbow_errors(ended.trajectory.poses)
    from_there = events(silhouettes())._replace(poses=start.poses)
    actual = smooth(MODEL, Settings(smoothing=surely), from_there)
    np.testing.assert_allclose(elbow_errors(actual.poses), expected, atol=5e-4)


def test_of_weight_0_they_are_no_evidence():
    nothing = silhouettes().each_grid(lambda grid: grid._replace(weight=0 * grid.weight))
    blind, empty = (smooth(MODEL, CHOSEN, events(grids)) for grids in (None, nothing))
    np.testing.assert_allclose(empty.points, blind.points, atol=1e-4)


def test_of_other_cameras_they_are_refused():
    one = jax.tree.map(lambda part: part[:, :1], silhouettes())
    with pytest.raises(ValueError, match=r"events.silhouettes: found shape \(4, 1\), expected"):
        jaxmocap.smooth(MODEL, CHOSEN, events(one))
    with pytest.raises(TypeError, match=r"events.silhouettes: found"):
        jaxmocap.smooth(MODEL, CHOSEN, events(one.person))


def stated(model: Model, numbers: jax.Array) -> Model:
    """A model by ``NUMBERS``: camera 0, turned about a slanted axis; the left wrist's marker."""
    skeleton, cameras = model.skeleton, model.cameras
    arm, trunk = (PERSON.tree.bone(name) for name in ("humerus_l", "spine2"))
    lengths = skeleton.lengths.at[arm].add(numbers[0]).at[trunk].add(numbers[1])
    T, slanted = cameras.T_cam_world, jnp.array([0.5, 0.6, 0.4])
    T = T.at[0, :3].set(exp(numbers[2] * slanted) @ T[0, :3]).at[0, 0, 3].add(numbers[3])
    matrix = cameras.matrix.at[0, :2, :2].multiply(1 + numbers[4], unique_indices=True)
    offsets = model.markers.offsets.at[1, 0].add(numbers[5])
    return replace(
        model,
        skeleton=replace(skeleton, lengths=lengths),
        cameras=replace(cameras, T_cam_world=T, matrix=matrix),
        markers=replace(model.markers, offsets=offsets),
    )


def test_landmarks_follow_as_differences_between_minima_say():
    """Along all numbers at once: a derivative that is wrong by one of them is wrong along it."""
    single = MODEL, Settings(smoothing=SETTINGS), events(silhouettes(untied=True))
    with double():
        model, chosen, given = in_double(single)
        model = jax.tree.map(jnp.asarray, model)

        # Traced once for both derivatives.
        @jax.jit
        def motion(start: Pose, numbers: jax.Array) -> SmoothMotion:
            return jaxmocap.smooth(stated(model, numbers), chosen, given._replace(poses=start))

        still, way = jnp.zeros(len(NUMBERS)), jnp.asarray(WAY)

        @jax.jit
        def along_way(numbers: jax.Array, start: Pose) -> tuple[SmoothMotion, SmoothMotion]:
            """A motion and its derivative, by one program: it is the compiler that takes long."""
            return jax.jvp(partial(motion, start), (numbers,), (way,))

        def settled(numbers: jax.Array, poses: Pose) -> SmoothMotion:
            """A descent ends where steps are short: some more, from there on."""
            for _ in range(ROUNDS):
                found, _ = along_way(numbers, poses)
                poses = found.poses
            return found

        found, change = along_way(still, given.poses)
        start, actual = found.poses, change.points
        ahead, behind = (settled(sign * STEP * way, start).points for sign in (1, -1))
        expected = np.asarray(ahead - behind) / (2 * STEP)

        # JAX turns the same derivative round.
        def points(numbers: jax.Array) -> jax.Array:
            return motion(start, numbers).points

        (back,) = jax.eval_shape(lambda pull: jax.vjp(points, still)[1](pull), actual)
    assert np.abs(expected).max() > 0.01
    np.testing.assert_allclose(actual, expected, atol=1e-4 * np.abs(expected).max())
    assert back.shape == way.shape
