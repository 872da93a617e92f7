"""The pure functions: their derivatives are those of finite differences; they follow what is asked.

Everything here is in double precision, with random directions over all numbers at once: bones,
markers' places, targets, cameras, settings, fields. A derivative that is wrong by one of them is
wrong along the direction.
"""

from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import LIMITS, double, in_double, on_device
from drawn_arms import arm_pose
from watched_arms import FRONT, MARKERS, PERSON, SIDE, SIZE, TRUTH, pictures

import jaxmocap
from jaxmocap import LANDMARKS
from jaxmocap.body.kinematics import forward, landmark_sites, site_positions
from jaxmocap.body.model import Model, on_unmarked_feet
from jaxmocap.body.pose import Pose
from jaxmocap.evidence.edges import EdgeEvidence
from jaxmocap.hybrid.paper.chamfer import Chamfer
from jaxmocap.hybrid.settings import Settings
from jaxmocap.smoothing.facing import references
from jaxmocap.smoothing.functions import Events
from jaxmocap.synthetic.movements.motions import table_tennis

NAMES = ("vertex", "wrist_l", "wrist_r")
ROWS = [LANDMARKS.index(name) for name in NAMES]
ELBOW_ROWS = [LANDMARKS.index(name) for name in ("elbow_l", "elbow_r")]
CHOSEN = Settings(region=SIZE)


def tracked_model(cameras=None) -> Model:
    return on_unmarked_feet(Model.create(PERSON, MARKERS, cameras))


def any_direction(tree: Any, seed: int) -> Any:
    """A random tangent of all floating-point leaves, as large as they are; float0 of the others."""
    rng = np.random.default_rng(seed)

    def tangent(leaf):
        array = np.asarray(leaf)
        if not np.issubdtype(array.dtype, np.floating):
            return np.zeros(array.shape, jax.dtypes.float0)
        size = np.where(np.isfinite(array), np.abs(array), 0)
        return jnp.asarray(rng.normal(size=array.shape) * size, float)

    return jax.tree.map(tangent, tree)


def moved(tree: Any, way: Any, by: float) -> Any:
    def step(leaf, tangent):
        return leaf if tangent.dtype == jax.dtypes.float0 else leaf + by * tangent

    return jax.tree.map(step, tree, way)


@partial(jax.jit, static_argnums=0)
def along(function, arguments, way):
    """A function's value and its derivative along a direction of its arguments.

    One program for both, since it is the compiler that takes long.
    """
    return jax.jvp(function, arguments, way)


def value(function, *arguments):
    """By the same program."""
    return along(function, arguments, still(arguments))[0]


def still(tree: Any) -> Any:
    """The tangent that goes nowhere."""

    def none(leaf):
        is_real = np.issubdtype(leaf.dtype, np.floating)
        return np.zeros(leaf.shape, leaf.dtype if is_real else jax.dtypes.float0)

    return jax.tree.map(none, tree)


def assert_is_its_finite_difference(
    function, arguments, seed: int, tolerance: float, along=along
) -> None:
    """A function's derivative along a random direction of all of its arguments."""
    way = any_direction(arguments, seed)
    # Values by the same program.
    ahead, behind = (
        np.asarray(along(function, moved(arguments, way, h), still(arguments))[0])
        for h in (1e-6, -1e-6)
    )
    expected = (ahead - behind) / 2e-6
    actual = np.asarray(along(function, arguments, way)[1])
    largest = np.abs(expected).max()
    assert largest > 1e-3 and np.isfinite(actual).all()
    np.testing.assert_allclose(actual, expected, atol=tolerance * largest)


# solve -------------------------------------------------------------------------------------------


SOLVE, POINTS = jax.jit(jaxmocap.solve), jax.jit(jaxmocap.landmarks)


def solved(*given):
    """Landmarks of a solve; one program for all that ask for the pose or for them."""
    return POINTS(given[0], SOLVE(*given))


MARKED = jax.jit(lambda pose: site_positions(PERSON, forward(PERSON, pose), MARKERS))


def random_markers(seed: int, kind: str) -> np.ndarray:
    """Of a pose anywhere within the limits, upright; or out of reach, or some of them lost."""
    rng = np.random.default_rng(seed)
    low, high = LIMITS.T
    angles = low + rng.uniform(0.1, 0.6, len(low)) * (high - low)
    turn = np.array([np.cos(seed), 0, 0, np.sin(seed)])
    pose = Pose(np.array([*rng.normal(size=2), 0.95]), turn, angles)
    markers = np.array(MARKED(on_device(pose, jnp.float32)), float)
    if kind == "straight arms":
        markers[1:] = markers[0] + 3 * (markers[1:] - markers[0])
    if kind == "a marker lost":
        markers[1 + seed % 2] = np.nan
    return markers


KINDS = ("within reach", "straight arms", "a marker lost")


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("kind", KINDS)
def test_a_solved_pose_moves_as_finite_differences_say(kind, seed):
    with double():
        model, chosen = in_double((tracked_model(), Settings()))
        arguments = model, chosen, jnp.asarray(random_markers(seed, kind))
        assert_is_its_finite_difference(solved, arguments, seed, 1e-4)


def test_forwards_and_backwards_are_the_same():
    with double():
        model, chosen = in_double((tracked_model(), Settings()))
        given = (model, chosen, jnp.asarray(random_markers(5, "straight arms")))
        way = any_direction(given, 0)
        points, change = map(np.asarray, along(solved, given, way))
        both = zip(jax.tree.leaves(SLOPES(*given)), jax.tree.leaves(way), strict=True)
        pulled = [float(jnp.sum(a * b)) for a, b in both if b.dtype != jax.dtypes.float0]
    assert sum(pulled) == pytest.approx(2 * np.sum(points * change), rel=1e-8)


def test_it_reaches_its_markers_and_keeps_its_limits():
    with double():
        model, chosen = in_double((tracked_model(), Settings()))
        near = np.asarray(solved(model, chosen, jnp.asarray(random_markers(1, "within reach"))))
        assert np.abs(near[ROWS] - random_markers(1, "within reach")).max() < 1e-3
        far = SOLVE(model, chosen, jnp.asarray(random_markers(1, "straight arms")))
        low, high = np.asarray(model.skeleton.limits).T
        angles = np.asarray(far.angles)
    assert (angles >= low - 1e-9).all() and (angles <= high + 1e-9).all()
    elbow = PERSON.tree.joint("elbow_flex_l")
    assert angles[elbow] == pytest.approx(low[elbow], abs=1e-9)


def test_a_start_is_gone_on_from_and_differentiated_by():
    with double():
        model, chosen = in_double((tracked_model(), Settings()))
        markers = jnp.asarray(random_markers(2, "a marker lost"))
        start = SOLVE(model, chosen, jnp.asarray(random_markers(2, "within reach")))
        assert_is_its_finite_difference(solved, (model, chosen, markers, start), 0, 1e-4)


@pytest.mark.parametrize("kind", ["all lost", "all in one place", "far away"])
def test_no_markers_answer_nan_and_none_raises(kind):
    markers = {
        "all lost": np.full((3, 3), np.nan),
        "all in one place": np.tile([0.0, 0.0, 1.5], (3, 1)),
        "far away": np.array([[0, 0, 1.7], [9, 0, 1], [0, -9, 1.0]]),
    }[kind]
    with double():
        gradient = SLOPES(*in_double((tracked_model(), Settings(), markers)))
    for leaf in jax.tree.leaves(gradient):
        if np.issubdtype(np.asarray(leaf).dtype, np.floating):
            assert np.isfinite(np.asarray(leaf)).all()


SLOPES = jax.jit(
    jax.grad(lambda *given: jnp.sum(solved(*given) ** 2), argnums=(0, 1, 2), allow_int=True)
)


def test_derivatives_are_right_in_single_precision():
    """By the whole gradient's error; far out of reach, single precision ends beside the minimum."""
    off = []
    for seed, kind in ((seed, kind) for seed in range(10) for kind in KINDS if "arms" not in kind):
        markers = random_markers(seed, kind)
        given = tracked_model(), Settings(), jnp.asarray(markers, jnp.float32)
        with double():
            exact = pieces(SLOPES(*in_double((*given[:2], markers))))
        single = pieces(SLOPES(*given))
        off.append(np.linalg.norm(single - exact) / np.linalg.norm(exact))
    assert np.median(off) < 0.01
    assert np.mean(np.array(off) < 0.05) >= 0.85, off


def pieces(slopes: tuple) -> np.ndarray:
    """Derivatives by bone lengths and by markers, in one vector."""
    by_markers = np.nan_to_num(np.asarray(slopes[2], float))
    return np.append(np.asarray(slopes[0].skeleton.lengths, float), by_markers)


def test_people_and_markers_go_side_by_side():
    with double():
        side_by_side(in_double(tracked_model()), in_double(Settings()))


def side_by_side(model, chosen):
    longer = jnp.linspace(0.95, 1.05, 4)
    several = replace(
        model, skeleton=replace(model.skeleton, lengths=jnp.outer(longer, model.skeleton.lengths))
    )
    axes = jax.tree.map(lambda _: None, model)
    axes = replace(axes, skeleton=replace(axes.skeleton, lengths=0))
    markers = np.stack([random_markers(seed, "within reach") for seed in range(4)])
    together = jax.jit(jax.vmap(solved, (axes, None, 0)))(several, chosen, jnp.asarray(markers))
    for i in range(4):
        person = replace(model.skeleton, lengths=several.skeleton.lengths[i])
        alone = solved(replace(model, skeleton=person), chosen, jnp.asarray(markers[i]))
        np.testing.assert_allclose(together[i], alone, atol=1e-8)


# observe, refine ---------------------------------------------------------------------------------


def refined(model, chosen, pose, observation):
    """Landmarks (L, 3) of a frame."""
    return jaxmocap.landmarks(model, jaxmocap.refine(model, chosen, pose, observation))


SIDE_BY_SIDE = jax.jit(jax.vmap(refined, (None, None, 0, 0)))


@jax.jit
def along_elbows(model, chosen, pose, observation, way):
    """Landmarks, and their derivative as the elbows that were expected move along ``way`` (2, 3).

    For the simplex: its program with tangents of all arguments takes longer to compile.
    """

    def points(elbows):
        return refined(model, chosen, pose, observation._replace(elbows=elbows))

    return jax.jvp(points, (observation.elbows,), (way,))


@pytest.fixture(scope="module")
def scene():
    """A model, poses that have the markers alone, what images show.

    Of two frames: the true arms before two cameras, and the same with no image.
    """
    markers = np.asarray(MARKED(on_device(TRUTH)), float)
    with double():
        model = in_double(tracked_model([FRONT, SIDE]))
        pose = SOLVE(model, in_double(CHOSEN), jnp.asarray(markers))
        poses = jax.tree.map(lambda part: jnp.stack([part, part]), pose)
        return model, poses, observed(model, CHOSEN, pose)


def observed(model, chosen, pose):
    """What both frames show about a pose."""
    shown = (pictures(FRONT, SIDE), [None, None])
    each = [jaxmocap.observe(model, chosen, pose, images) for images in shown]
    return jax.tree.map(lambda *parts: jnp.stack(parts), *each)


def refined_by(way: str, scene, frame: int = 0) -> tuple:
    """Arguments of ``refined`` for one of the frames; call it where float64 is enabled."""
    parts = jax.tree.map(lambda part: part[frame], scene[1:])
    return scene[0], in_double(replace(CHOSEN, refine=way)), *parts


@pytest.mark.parametrize("way", ["simplex", "gradient", "search"])
def test_images_bring_the_elbows_nearer_and_without_them_the_pose_stays(way, scene):
    model, poses, _ = scene
    with double():
        before = np.asarray(jax.vmap(POINTS, (None, 0))(model, poses))
        truth = np.asarray(POINTS(model, on_device(TRUTH)))[ELBOW_ROWS]
        if way == "search":
            chosen = in_double(replace(CHOSEN, refine=way))
            after = np.asarray(SIDE_BY_SIDE(model, chosen, *scene[1:]))
        else:
            each = [refined_by(way, scene, frame) for frame in range(2)]
            if way == "simplex":
                after = np.stack([along_elbows(*given, jnp.zeros((2, 3)))[0] for given in each])
            else:
                after = np.stack([value(refined, *given) for given in each])
    off = [
        np.linalg.norm(points[0, ELBOW_ROWS] - truth, axis=1).max() for points in (before, after)
    ]
    assert off[1] < 0.05 < off[0], off
    np.testing.assert_allclose(after[1], before[1], atol=1e-12)


# Another program as large as the outline's; what is its own, the derivative of its residuals, is
# among those of all terms.
AREA = pytest.param(Chamfer(drawn=False), marks=pytest.mark.slow)


@pytest.mark.parametrize("edges", [EdgeEvidence(), AREA], ids=["outline", "area"])
def test_a_refined_pose_moves_as_finite_differences_say(scene, edges):
    """On the drawn pictures' own fields, and without any."""
    chosen = replace(CHOSEN, refine="gradient", edges=edges)
    with double():
        model, poses, observation = scene
        if isinstance(edges, Chamfer):
            # One plain field: of two directions that are equally far none is the derivative's.
            chosen = replace(chosen, directions=1)
            observation = observed(model, chosen, jax.tree.map(lambda part: part[0], poses))
        for i in range(2):
            pose, shown = jax.tree.map(lambda part, i=i: part[i], (poses, observation))
            arguments = model, in_double(chosen), pose, shown
            assert_is_its_finite_difference(refined, arguments, i, 1e-3)


# The limb on its side, and towards the camera in front.
STRETCHED = {"arm_abduct": (90, 90)}, {"arm_flex": (90, 90)}


@pytest.mark.parametrize("degrees", STRETCHED, ids=["sideways", "end-on"])
def test_derivatives_are_finite_at_stretched_arms(degrees, scene):
    straight = dict.fromkeys(("arm_flex", "arm_abduct", "arm_rot", "elbow_flex"), (0, 0))
    with double():
        model, chosen, _, _ = refined_by("gradient", scene)
        pose = on_device(arm_pose(PERSON, straight | degrees))
        shown = jaxmocap.observe(model, CHOSEN, pose, pictures(FRONT, SIDE))
        arguments = model, chosen, pose, shown
        slope = np.asarray(along(refined, arguments, any_direction(arguments, 0))[1])
    assert np.isfinite(slope).all() and np.abs(slope).max() > 0


def test_the_simplex_moves_with_the_elbows_that_were_expected(scene):
    """By the cost's own curvature: along with them, and no farther."""
    with double():
        arguments = refined_by("simplex", scene)
        units = jnp.eye(6).reshape(6, 2, 3)
        slopes = [np.asarray(along_elbows(*arguments, unit)[1])[ELBOW_ROWS] for unit in units]
        turned = np.stack(slopes, -1).reshape(2, 3, 2, 3)
    for arm in range(2):
        gains = np.linalg.eigvals(turned[arm, :, arm])
        assert 0.05 < np.abs(gains).max() < 1.1
        np.testing.assert_allclose(turned[arm, :, 1 - arm], 0, atol=1e-9)


def test_as_many_images_as_cameras_are_asked_for(scene):
    model, poses, _ = scene
    pose = jax.tree.map(lambda part: part[0], poses)
    with pytest.raises(ValueError, match="found 1 images, expected one for each of the model's 2"):
        jaxmocap.observe(model, CHOSEN, pose, pictures(FRONT)[0])


def test_without_images_a_pose_is_observed_by_any_number_of_cameras(scene):
    model, poses, both = scene
    with double():
        pose, without = (jax.tree.map(lambda part: part[1], parts) for parts in (poses, both))
        jax.tree.map(
            np.testing.assert_array_equal, jaxmocap.observe(model, CHOSEN, pose, None), without
        )
    with pytest.raises(ValueError, match=r"model.cameras: found None"):
        jaxmocap.observe(tracked_model(), CHOSEN, pose, None)


# smooth ------------------------------------------------------------------------------------------


class Smoothed:
    """Points of ``smooth`` by all but the poses: where it starts from changes nothing."""

    def __init__(self, poses):
        self.poses = poses

    def __call__(self, model, chosen, times, measured):
        return jaxmocap.smooth(model, chosen, Events(times, measured, self.poses)).points


@partial(jax.jit, static_argnums=0)
def both_ways(smoothed, arguments, way, pull):
    """Points, their derivative along a direction, and a pull at them taken back to ``measured``.

    One program, whose descent is compiled once.
    """
    points, push = jax.linearize(smoothed, *arguments)
    *others, measured = arguments
    back = jax.linear_transpose(partial(push, *still(others)), measured)
    return points, push(*way), back(pull)[0]


def along_smoothed(smoothed, arguments, way):
    """Points, and their derivative along a direction."""
    pull = np.zeros((len(arguments[2]), len(LANDMARKS), 3))
    return both_ways(smoothed, arguments, way, pull)[:2]


def stroke(count: int = 8):
    """Some samples of a table-tennis stroke, its elbows roughly measured."""
    times = np.arange(count) / 30
    truth = table_tennis(2.0, seed=0).landmarks(times)
    markers = np.stack([truth[name] for name in NAMES], 1)
    markers[3, 1] = np.nan
    with double():
        model, chosen = in_double((tracked_model(), Settings()))
        each = [SOLVE(model, chosen, jnp.asarray(sample)) for sample in markers]
        poses = jax.tree.map(lambda *parts: np.stack(parts), *each)
        measured = references(model.skeleton, times, poses)
        elbows = np.stack([truth["elbow_l"], truth["elbow_r"]], 1)
        measured = measured._replace(markers=markers, elbows=elbows)
        return in_double((model, chosen, Events(times, measured, poses))), truth


@pytest.fixture(scope="module")
def moving():
    """``Smoothed``, its arguments and the truth."""
    (model, chosen, events), truth = stroke()
    return Smoothed(events.poses), (model, chosen, *events[:2]), truth


def test_a_smoothed_motion_moves_as_finite_differences_say(moving):
    smoothed, arguments, _ = moving
    with double():
        assert_is_its_finite_difference(smoothed, arguments, 1, 1e-3, along=along_smoothed)


def test_a_smoothed_motion_moves_backwards_as_forwards(moving):
    """By what was measured; with silhouettes it is the same function that goes backwards."""
    smoothed, arguments, _ = moving
    *others, measured = arguments
    with double():
        way = any_direction(measured, 3)
        pull = np.random.default_rng(3).normal(size=(len(arguments[2]), len(LANDMARKS), 3))
        _, change, pulled = both_ways(smoothed, arguments, (*still(tuple(others)), way), pull)
    each = map(np.vdot, jax.tree.leaves(pulled), jax.tree.leaves(way))
    assert sum(each) == pytest.approx(np.vdot(pull, change), rel=1e-7)


def test_a_smoothed_motion_is_near_the_truth(moving):
    smoothed, arguments, truth = moving
    with double():
        points = np.asarray(along_smoothed(smoothed, arguments, still(arguments))[0])
    assert points.shape == (len(arguments[2]), len(LANDMARKS), 3)
    off = np.linalg.norm(points[:, LANDMARKS.index("elbow_r")] - truth["elbow_r"], axis=-1)
    assert off.max() < 0.04


def test_single_precision_smooths_samples_that_come_as_fast_as_devices_send_them():
    """240 a second, two of them less than a millisecond apart."""
    times = np.sort(np.append(np.arange(24) / 240, 0.0503))
    truth = table_tennis(2.0, seed=0).landmarks(times)
    markers = np.stack([truth[name] for name in NAMES], 1)
    with double():
        pose = SOLVE(*in_double((tracked_model(), Settings())), jnp.asarray(markers[0]))
    start = [np.tile(np.asarray(part, np.float32), (len(times), 1)) for part in pose]
    model, poses = tracked_model(), Pose(*start)
    measured = references(model.skeleton, times, poses)
    unseen = np.full((len(times), 2, 3), np.nan)
    measured = measured._replace(markers=markers, elbows=unseen)
    measured = on_device(measured, jnp.float32)

    def smoothed(stretch):
        person = model.with_lengths(humerus_r=0.3 + stretch)
        return jaxmocap.smooth(person, CHOSEN, Events(times, measured, poses)).points

    points, slope = jax.jit(lambda: jax.jvp(smoothed, (0.0,), (1.0,)))()
    off = np.linalg.norm(points[:, ROWS] - markers, axis=-1)
    assert off.max() < 0.02 and np.isfinite(slope).all()


def test_landmarks_are_by_name():
    points = np.asarray(jaxmocap.landmarks(tracked_model(), on_device(TRUTH)))
    sites = landmark_sites(PERSON, ("knee_r",))
    knee = jax.jit(lambda pose: site_positions(PERSON, forward(PERSON, pose), sites))
    expected = knee(on_device(TRUTH))
    np.testing.assert_allclose(points[LANDMARKS.index("knee_r")], expected[0], atol=1e-6)


# All of them -------------------------------------------------------------------------------------


def test_a_float32_model_stays_in_float32_where_float64_is_on(scene, moving):
    """Whatever precision markers, settings and observations come in."""
    model, poses, observations = scene
    pose, observation = jax.tree.map(lambda part: part[0], (poses, observations))
    wide = (in_double(Settings()), in_double(replace(CHOSEN, refine="gradient")))
    events = Events(*moving[1][2:], moving[0].poses)
    with double():
        single = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float32), (model, tracked_model()))
        markers = jnp.zeros((3, 3))
        answers = [
            jax.eval_shape(jaxmocap.solve, single[1], wide[0], markers),
            jax.eval_shape(jaxmocap.refine, single[0], wide[1], pose, observation),
            jax.eval_shape(jaxmocap.smooth, single[1], wide[0], events),
        ]
        assert markers.dtype == pose.angles.dtype == events.times.dtype == jnp.float64
    assert {leaf.dtype for leaf in jax.tree.leaves(answers)} == {jnp.dtype("float32")}
