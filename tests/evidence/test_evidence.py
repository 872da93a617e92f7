"""Equations (12) to (14) against the reference, and where the outline's distance is least."""

from dataclasses import replace

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import double, on_device
from drawn_arms import camera_at
from hypothesis import given, settings
from hypothesis import strategies as st
from watched_arms import (
    FRONT,
    GRIPS,
    PERSON,
    SIDE,
    SIZE,
    TRUTH,
    arms_in,
    observed,
    pictures,
    stacked,
    true_arms,
    turned_by,
)

from jaxmocap.body.arms import arms_of, flesh
from jaxmocap.body.kinematics import forward
from jaxmocap.body.surfaces.cones import Cones
from jaxmocap.evidence.edges import EdgeFields
from jaxmocap.evidence.outlines.traced import outline_distance
from jaxmocap.geometry.outlines import Discs
from jaxmocap.hybrid.paper.chamfer import (
    Chamfer,
    chamfer_sum,
    draw_distance,
    integrate_distance,
    soft_coverage,
)
from jaxmocap.hybrid.settings import Settings, SimplexSettings
from jaxmocap.images.regions import Region
from jaxmocap.reference import cameras as reference_cameras
from jaxmocap.reference.hybrid import raster as reference

GRID = 20
COVERAGE = jax.jit(soft_coverage, static_argnums=1)
CHAMFER = jax.jit(chamfer_sum)
DRAWN, INTEGRATED = jax.jit(draw_distance), jax.jit(integrate_distance)
OUTLINE = jax.jit(outline_distance)
ARM_COST = jax.jit(Chamfer.arm_cost)
# Of coverage, 0 to 1, and of costs, relative.
FLOAT32_COVERAGE, FLOAT32_COST = 2e-4, 1e-4


def random_discs(seed, count=3):
    rng = np.random.default_rng(seed)
    return Discs(*rng.uniform(2, GRID - 2, (2, count, 2)), rng.uniform(1, 4, (count, 2)))


@settings(max_examples=10)
@given(st.integers(0, 2**20), st.floats(0.3, 2.0))
def test_the_soft_silhouette_is_the_references(seed, softness):
    limbs = random_discs(seed)
    expected = reference.coverage((GRID, GRID), *limbs, softness)
    with double():
        np.testing.assert_allclose(
            COVERAGE(on_device(limbs), GRID, softness), expected, rtol=1e-9, atol=1e-9
        )
    single = COVERAGE(on_device(limbs), GRID, softness)
    assert single.dtype == jnp.float32
    assert np.abs(single - expected).max() < FLOAT32_COVERAGE


def test_a_hard_silhouette_is_the_binary_image():
    """Equation (12): b_ij is 1 inside of the limb and 0 outside."""
    limb = Discs(np.array([[5.0, 6]]), np.array([[14.0, 12]]), np.array([[3.0, 2]]))
    image = np.asarray(COVERAGE(on_device(limb), GRID, 1e-3))
    rows, columns = np.indices(image.shape)
    inside = np.vectorize(
        lambda x, y: reference.signed_distance(np.array([x, y]), *(part[0] for part in limb))
    )(columns, rows)
    np.testing.assert_array_equal(image[inside < -0.01], 1)
    np.testing.assert_array_equal(image[inside > 0.01], 0)


def scene(seed):
    """Three limbs before a distorting camera, and the fields of their region."""
    rng = np.random.default_rng(seed)
    camera = camera_at((2.0, 0.2, 1.2), distortion=(-0.1, 0.05, 1e-3, -1e-3))
    joints = rng.uniform(-0.25, 0.25, (4, 3)) + np.array([0, 0, 1.1])
    limbs = Cones(joints[:3], joints[1:], rng.uniform(0.03, 0.06, (3, 2)))
    fields = rng.uniform(0, 20, (2, GRID, GRID))
    region = Region(np.array([200.5, 120.5]), np.array(11.0))
    return camera, region, fields, limbs


def magnification(camera, points_world):
    """By how much the lens scales small discs about points, by central differences."""
    plane = reference_cameras.normalise(reference_cameras.to_camera(camera, points_world))
    ends = [
        reference_cameras.distort(camera, plane + sign * step)
        for step in 1e-5 * np.eye(2)
        for sign in (1, -1)
    ]
    J = np.stack([ends[0] - ends[1], ends[2] - ends[3]], -1) / 2e-5
    return np.sqrt(np.linalg.det(J))


def reference_chamfer(camera, region, fields, limbs, softness):
    """(13) by the reference's own projection; also the coverage and the plain field."""

    def placed(points):
        return (reference_cameras.project(camera, points) - region.origin) / region.scale - 0.5

    depths = [reference_cameras.to_camera(camera, end)[:, 2] for end in (limbs.near, limbs.far)]
    focal = (float(camera.matrix[0, 0]) + float(camera.matrix[1, 1])) / 2
    scales = np.stack([magnification(camera, end) for end in (limbs.near, limbs.far)], -1)
    radii = limbs.radii / np.stack(depths, -1) * scales * focal / region.scale
    coverage = reference.coverage(
        (GRID, GRID), placed(limbs.near), placed(limbs.far), radii, softness
    )
    return coverage, fields.min(0)


@settings(max_examples=10)
@given(st.integers(0, 2**20))
def test_the_chamfer_sum_is_equation_13(seed):
    with double():
        camera, region, fields, limbs = scene(seed)
        expected = reference.chamfer(*reference_chamfer(camera, region, fields, limbs, 0.8))
        arguments = (on_device(region), on_device(fields), on_device(limbs), 0.8)
        assert float(CHAMFER(camera, *arguments)) == pytest.approx(expected, rel=1e-9)
    camera, region, fields, limbs = scene(seed)
    single = CHAMFER(camera, on_device(region), on_device(fields), on_device(limbs), 0.8)
    assert single.dtype == jnp.float32
    assert float(single) == pytest.approx(expected, rel=FLOAT32_COST)


@settings(max_examples=5)
@given(st.integers(0, 2**20))
def test_the_raster_cost_with_its_hold_is_equation_14_in_another_unit(seed):
    """Both divided by what no move of the limbs changes, the resolution at the start's depth."""
    rng = np.random.default_rng(seed)
    targets, positions = rng.normal(size=(2, 1, 3))
    with double():
        camera, region, fields, limbs = scene(seed)
        chosen, weight = replace(Chamfer(), softness=0.8), SimplexSettings().hold
        one = EdgeFields(
            jax.tree.map(lambda part: on_device(part)[None], region),
            on_device(fields)[None],
            np.array([True]),
        )
        start = limbs._replace(near=limbs.near + rng.normal(size=3) / 10)
        cost = ARM_COST(chosen, stacked(camera), one, on_device(limbs), on_device(start))
        on_edges = float(cost)
        depth = np.mean(reference_cameras.to_camera(camera, start.near)[:, 2])
        samples_per_metre = 560.0 / depth / float(region.scale)
        lengths = np.linalg.norm(limbs.far - limbs.near, axis=1)
        area = np.sum(lengths * limbs.radii.sum(1)) * samples_per_metre**2
        unit = area * samples_per_metre * float(chosen.scale)
        hold = float(weight) * np.linalg.norm(targets - positions)
        coverage, field = reference_chamfer(camera, region, fields, limbs, 0.8)
    expected = reference.cost(coverage, field, float(weight) * unit, targets, positions)
    assert (on_edges + hold) * unit == pytest.approx(expected, rel=1e-9)


SIDE_SAMPLES = 96


def arm_before_lines(seed):
    """An arm in any pose, and the distances to a dozen lines across its region."""
    rng = np.random.default_rng(seed)
    camera = camera_at((2.0, 0.2, 1.2), distortion=(-0.1, 0.05, 1e-3, -1e-3))
    ways = rng.normal(size=(3, 3))
    ways *= np.array([[0.3], [0.26], [0.1]]) / np.linalg.norm(ways, axis=1, keepdims=True)
    joints = np.array([0, 0, 1.3]) + np.cumsum(np.vstack([np.zeros(3), ways]), 0)
    radii = np.array([[0.05, 0.045], [0.045, 0.03], [0.03, 0.025]])
    pixels = reference_cameras.project(camera, joints)
    low, high = pixels.min(0), pixels.max(0)
    scale = 1.8 * (high - low).max() / SIDE_SAMPLES
    region = Region((low + high) / 2 - scale * SIDE_SAMPLES / 2, np.array(scale))
    lines = np.full((SIDE_SAMPLES, SIDE_SAMPLES), 255, np.uint8)
    for start, end in rng.integers(0, SIDE_SAMPLES, (12, 2, 2)).tolist():
        cv2.line(lines, start, end, 0)
    field = np.minimum(cv2.distanceTransform(lines, cv2.DIST_L2, 5), 20)
    return camera, *on_device((region, field[None], Cones(joints[:3], joints[1:], radii)))


def test_integrated_coverage_is_the_drawn_one():
    """By 84 points an arm instead of 9,216 samples, ends and limbs before limbs included."""
    arms = [arm_before_lines(seed) for seed in range(60)]
    sums = np.array([[float(way(*arm, 0.3, 2.0)) for way in (INTEGRATED, DRAWN)] for arm in arms])
    ratios = sums[:, 0] / sums[:, 1]
    assert np.ptp(sums[:, 1]) > 0.01 and np.corrcoef(sums.T)[0, 1] > 0.99
    assert abs(ratios.mean() - 1) < 0.02 and ratios.std() < 0.05
    # What an arm covers, every place once: the sum over a field of ones.
    covered = []
    for camera, region, field, limbs in arms:
        ones = jnp.ones_like(field)
        covered.append(
            [float(way(camera, region, ones, limbs, 0.3, 2.0)) for way in (INTEGRATED, DRAWN)]
        )
    np.testing.assert_allclose(*np.transpose(covered), rtol=0.04)


def test_integrated_coverage_of_many_places_is_that_of_each():
    camera, region, field, limbs = arm_before_lines(0)
    other = jax.tree.map(lambda part: part + 0.01, limbs)
    both = jax.tree.map(lambda *parts: jnp.stack(parts), limbs, other)
    together = INTEGRATED(camera, region, field, both, 0.3, 2.0)
    alone = [INTEGRATED(camera, region, field, each, 0.3, 2.0) for each in (limbs, other)]
    np.testing.assert_allclose(together, alone, rtol=1e-5)


CAMERAS = stacked(FRONT)
CHOSEN = Settings(region=SIZE).edges


@jax.jit
def outline_costs(cameras, fields, arms):
    def of_arm(own, limbs):
        return CHOSEN.arm_cost(cameras, own, limbs, limbs)

    return jax.vmap(of_arm)(fields.by_arm(), flesh(arms))


def test_the_outline_fits_best_where_the_arm_was_drawn():
    fields = observed(pictures(FRONT), CAMERAS, true_arms())
    costs = np.array(
        [outline_costs(CAMERAS, fields, turned_by(t, t)) for t in np.linspace(-0.4, 0.4, 9)]
    )
    np.testing.assert_array_equal(np.argmin(costs, 0), [4, 4])
    # Either way the elbow swivels, it rises; and at the truth it is within a pixel's worth.
    assert (np.diff(costs[4:], axis=0) > 0).all() and (np.diff(costs[:5], axis=0) < 0).all()
    depth_m_per_px = 2.2 / 560
    assert (costs[4] * float(CHOSEN.scale) < 1.2 * depth_m_per_px).all()


def test_edges_that_run_another_way_do_not_count():
    """Of the six fields only those of the outline's own direction are looked at."""
    fields = observed(pictures(FRONT), CAMERAS, true_arms())
    by_normal = np.asarray(outline_costs(CAMERAS, fields, true_arms()))
    turned = fields._replace(distances=np.roll(np.asarray(fields.distances), 3, axis=2))
    across = np.asarray(outline_costs(CAMERAS, turned, true_arms()))
    assert (across > 3 * by_normal).all()


@pytest.mark.parametrize("angle", [0, 20, 45, 80, 90, 120, 160])
def test_an_outline_looks_into_the_channel_of_its_normal(angle):
    """One field after the other is set to 0: the limb's two sides find theirs, and no other."""
    way = np.array([0, np.cos(np.radians(angle)), -np.sin(np.radians(angle))]) * 0.25
    camera, middle = camera_at((2.0, 0, 1.1)), np.array([0, 0, 1.1])
    limb = Cones(*(jnp.asarray(np.tile(p, (3, 1)), float) for p in (middle - way, middle + way)),
                 jnp.full((3, 2), 0.03))  # fmt: skip
    region = Region(jnp.array([200.0, 120.0]), jnp.array(240 / SIZE))
    actual = []
    for channel in range(6):
        fields = np.full((6, SIZE, SIZE), 20.0)
        fields[channel] = 0
        actual.append(float(OUTLINE(camera, region, on_device(fields), limb, 0.05)[0]))
    normal = (angle + 90) % 180
    # A normal on the border of two channels may take either.
    own = {int(normal // 30), int((normal - 1) % 180 // 30), int((normal + 1) % 180 // 30)}
    assert int(np.argmin(actual)) in own
    assert sorted(actual)[0] < 0.02 < sorted(actual)[1]


def shifted(arms, offset):
    return arms._replace(
        **{
            name: getattr(arms, name) + jnp.asarray(offset, jnp.float32)
            for name in ("shoulder", "elbow", "wrist", "tip", "grip")
        }
    )


@pytest.mark.parametrize(
    "offset",
    [(0, 5.0, 0), (0, 0, -3.0), (4.0, 0, 0), (2.2, 0.3, 0.2), (2.1, 0, 0), (-500.0, 0, 0)],
    ids=["beside", "below", "behind", "around the lens", "before the lens", "far"],
)
def test_an_arm_out_of_the_picture_costs_something_finite(offset):
    fields = observed(pictures(FRONT), CAMERAS, true_arms())
    moved = shifted(true_arms(), offset)
    costs = np.asarray(outline_costs(CAMERAS, fields, moved))
    assert np.isfinite(costs).all() and (costs >= 0).all()
    limit = float(CHOSEN.truncation / CHOSEN.scale)
    assert (costs <= limit + 1e-3).all()
    gradient = GRADIENT(CAMERAS, fields, moved)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(gradient))


GRADIENT = jax.jit(
    jax.grad(lambda cameras, fields, arms: jnp.sum(outline_costs(cameras, fields, arms)), 2)
)
PIXELS = jax.jit(lambda cameras, fields, arms: CHOSEN.outline_px(cameras, fields, arms))


def test_pixels_are_reported_where_an_arm_has_an_image_and_nan_where_not():
    fields = observed(pictures(FRONT), CAMERAS, true_arms())
    distances = np.asarray(PIXELS(CAMERAS, fields, true_arms()))
    assert (distances < 1.5).all() and (distances > 0).all()
    left_only = fields._replace(available=np.array([[True, False]]))
    np.testing.assert_array_equal(
        np.isfinite(PIXELS(CAMERAS, left_only, true_arms())), [True, False]
    )
    beside = shifted(true_arms(), (0, 5.0, 0))
    assert np.isnan(PIXELS(CAMERAS, fields, beside)).all()


def test_the_costs_of_two_cameras_add_and_one_without_an_image_costs_nothing():
    both = stacked(FRONT, SIDE)
    arms = turned_by(0.2, -0.2)
    fields = observed(pictures(FRONT, SIDE), both, true_arms())

    def costs(*flags):
        return np.asarray(outline_costs(both, fields._replace(available=np.array(flags)), arms))

    yes, no = [True, True], [False, False]
    together, front, side = costs(yes, yes), costs(yes, no), costs(no, yes)
    np.testing.assert_allclose(together, front + side, rtol=1e-5)
    assert (front > 0.1).all() and (side > 0.1).all()
    np.testing.assert_array_equal(costs(no, no), 0)
    crossed = costs([True, False], [False, True])
    np.testing.assert_allclose(crossed, [front[0], side[1]], rtol=1e-5)


def test_gradients_reach_lengths_and_angles():
    fields = observed(pictures(FRONT), CAMERAS, true_arms())

    def cost(skeleton, pose):
        return jnp.sum(
            outline_costs(CAMERAS, fields, arms_of(skeleton, forward(skeleton, pose), GRIPS))
        )

    tilted = on_device(TRUTH._replace(angles=TRUTH.angles + 0.05))
    by_body, by_pose = jax.jit(jax.grad(cost, (0, 1)))(PERSON, tilted)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves((by_body, by_pose)))
    bones, joints = PERSON.tree.bone, PERSON.tree.joint
    for side in "lr":
        assert by_body.lengths[bones(f"humerus_{side}")] != 0
        assert by_body.lengths[bones(f"radius_{side}")] != 0
        assert np.abs(by_body.diameters[bones(f"radius_{side}")]).max() > 0
        assert by_pose.angles[joints(f"arm_rot_{side}")] != 0
        assert by_pose.angles[joints(f"elbow_flex_{side}")] != 0
        assert by_pose.angles[joints(f"knee_flexion_{side}")] == 0


def test_the_gradient_is_the_difference_of_the_costs():
    with double():
        camera, region, fields, limbs = scene(4)
        chosen = (on_device(region), on_device(fields), on_device(limbs), jnp.asarray(9.0))
        slope = jax.jit(jax.grad(lambda *a: outline_distance(*a)[0], 3))(camera, *chosen)
        rng, h = np.random.default_rng(0), 1e-7
        for part, name in zip(slope, limbs._fields, strict=True):
            way = rng.normal(size=part.shape)
            moved = [limbs._replace(**{name: getattr(limbs, name) + s * way}) for s in (h, -h)]
            ahead, behind = (
                float(OUTLINE(camera, *chosen[:2], on_device(each), chosen[3])[0]) for each in moved
            )
            along = np.sum(np.asarray(part) * way)
            assert along == pytest.approx((ahead - behind) / 2 / h, rel=1e-3)


def test_the_true_pose_of_the_drawing_is_the_bodys_own():
    """The drawing's kinematics are the reference's; the arms' are the tracker's."""
    arms = arms_in(on_device(TRUTH))
    assert float(jnp.linalg.norm(arms.grip - arms.wrist)) < 1e-5
    reach = np.linalg.norm(np.asarray(arms.elbow - arms.shoulder), axis=1)
    np.testing.assert_allclose(reach, arms.humerus_length, atol=1e-5)
