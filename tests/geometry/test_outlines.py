"""Outlines and signed distances of projected limbs, against brute force and the reference."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import double, on_device, vectors
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy import optimize
from scipy.spatial import ConvexHull

from jaxmocap.geometry import outlines
from jaxmocap.geometry.outlines import Discs
from jaxmocap.reference.hybrid import raster as reference

DISTANCE = jax.jit(outlines.signed_distance)
ALONG, AROUND = 12, 5
radii = st.floats(0.02, 0.3)


def outline(limb: Discs, open_ends) -> tuple:
    """Points (..., K, 2) of limbs' outlines, what each weighs (..., K), and normals (..., K, 2)."""
    x, y = jnp.moveaxis(jnp.stack([limb.near, limb.far]), -1, 0)
    half_sizes = jnp.moveaxis(limb.radii, -1, 0)
    ends = jnp.moveaxis(jnp.broadcast_to(open_ends, limb.radii.shape), -1, 0)
    both = outlines.outline_pieces(x, y, half_sizes, ALONG, AROUND, ends)

    def row(name: str):
        parts = [jnp.broadcast_to(getattr(part, name), part.x.shape) for part in both]
        flat = [part.reshape(-1, *part.shape[2:]) for part in parts]
        return jnp.moveaxis(jnp.concatenate(flat), 0, -1)

    points, normals = (
        jnp.stack([row(x), row(y)], -1) for x, y in (("x", "y"), ("normal_x", "normal_y"))
    )
    return points, row("weights"), normals


OUTLINE = jax.jit(outline)


def discs(near, far, near_radius, far_radius) -> Discs:
    return Discs(np.asarray(near), np.asarray(far), np.array([near_radius, far_radius]))


def distance_to_swept_disc(limb: Discs, points: np.ndarray) -> np.ndarray:
    """The hull is the union of all discs between the two; the nearest one decides (convex)."""

    def from_disc(t, point):
        centre = (1 - t) * limb.near + t * limb.far
        radius = (1 - t) * limb.radii[0] + t * limb.radii[1]
        return np.linalg.norm(centre - point) - radius

    def nearest(point):
        inner = optimize.minimize_scalar(
            from_disc, bounds=(0, 1), args=(point,), method="bounded", options={"xatol": 1e-11}
        )
        return min(inner.fun, from_disc(0, point), from_disc(1, point))

    return np.array([nearest(point) for point in points])


def exceeds(limb: Discs) -> float:
    """By how much the centres' distance exceeds the difference of the radii: below 0 end-on."""
    return np.linalg.norm(limb.near - limb.far) - abs(limb.radii[0] - limb.radii[1])


LIMBS = st.builds(discs, vectors(2), vectors(2), radii, radii)
# Where one disc only just holds the other the tangents end; that border has a test of its own.
OFF_THE_BORDER = LIMBS.filter(
    lambda limb: abs(exceeds(limb)) > 2e-3 and np.linalg.norm(limb.near - limb.far) > 1e-5
)
SIDE_ON = LIMBS.filter(lambda limb: exceeds(limb) > 0.01)
SEEDS = st.integers(0, 1000)


def scattered(seed: int, count: int, most: float = 1.5) -> np.ndarray:
    """Points (K, 2) anywhere about the origin."""
    return np.random.default_rng(seed).uniform(-most, most, (count, 2))


def nested(near: np.ndarray, turn: float, share: float) -> list[Discs]:
    """A small disc within a large one, either of them near; ``share`` 1 lets them touch."""
    far = near + share * 0.2 * np.array([np.cos(turn), np.sin(turn)])
    return [discs(near, far, *pair) for pair in ((0.3, 0.1), (0.1, 0.3))]


def hull_points(limb: Discs, count=4000) -> np.ndarray:
    turn = np.linspace(0, 2 * np.pi, count, endpoint=False)
    circle = np.stack([np.cos(turn), np.sin(turn)], 1)
    return np.vstack([limb.near + limb.radii[0] * circle, limb.far + limb.radii[1] * circle])


@given(OFF_THE_BORDER, SEEDS)
def test_signed_distance_is_that_to_the_discs_hull(limb, seed):
    points = scattered(seed, 12)
    with double():
        ours = DISTANCE(on_device(limb), on_device(points))
    np.testing.assert_allclose(ours, distance_to_swept_disc(limb, points), atol=2e-6)
    by_point = [reference.signed_distance(p, *limb) for p in points]
    np.testing.assert_allclose(ours, by_point, rtol=1e-9, atol=1e-9)


@given(vectors(2, 0.5), st.floats(-np.pi, np.pi), st.floats(0.0, 0.95), SEEDS)
def test_a_limb_seen_end_on_is_its_larger_disc(near, turn, share, seed):
    for limb in nested(near, turn, share):
        ahead = limb.far + np.outer([0.05, 0.31, 0.8], limb.far - near + 1e-9)
        points = np.vstack([scattered(seed, 6, 1.0), ahead])
        with double():
            ours = DISTANCE(on_device(limb), on_device(points))
        centre = near if limb.radii[0] > limb.radii[1] else limb.far
        expected = np.linalg.norm(points - centre, axis=1) - 0.3
        np.testing.assert_allclose(ours, expected, atol=1e-5)


TOUCH = jax.jit(outlines.touch)


def touched(limb: Discs, points: np.ndarray) -> outlines.Touch:
    with double():
        actual = TOUCH(on_device(limb), *on_device((points[:, 0], points[:, 1])))
    return outlines.Touch(*(np.asarray(part) for part in actual))


@given(OFF_THE_BORDER, SEEDS)
def test_the_nearest_disc_along_the_axis_is_the_one_that_touches(limb, seed):
    points, (near, far, (a, b)) = scattered(seed, 12), limb
    actual = touched(limb, points)
    share = np.linspace(0, 1, 2001)[:, None]
    family = np.linalg.norm(points - ((1 - share) * near + share * far)[:, None], axis=-1)
    family = family - ((1 - share) * a + share * b)
    # The step between two discs of the family, squared, bounds what the finer one gains.
    np.testing.assert_allclose(actual.distance, family.min(0), atol=2e-3)
    assert (actual.distance <= family.min(0) + 1e-9).all()
    along = actual.along[:, None]
    centre, radius = (1 - along) * near + along * far, (1 - along) * a + along * b
    normal = np.stack([actual.normal_x, actual.normal_y], 1)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1, atol=1e-6)
    np.testing.assert_allclose(
        centre + (radius + actual.distance[:, None]) * normal, points, atol=1e-5
    )


def numbers_of(limb: Discs) -> np.ndarray:
    """Near x, y; far x, y; near and far radius."""
    return np.concatenate([np.asarray(part, float) for part in limb])


def by_finite_differences(limb: Discs, points: np.ndarray, step: float = 1e-6) -> np.ndarray:
    """Derivatives (K, 6) of the points' signed distances."""

    def distances(numbers: np.ndarray) -> np.ndarray:
        with double():
            return np.asarray(
                DISTANCE(
                    on_device(Discs(numbers[:2], numbers[2:4], numbers[4:])), on_device(points)
                )
            )

    middle = numbers_of(limb)
    columns = [(distances(middle + d) - distances(middle - d)) for d in step * np.eye(6)]
    return np.stack(columns, 1) / (2 * step)


def by_the_touching_circle(actual: outlines.Touch) -> np.ndarray:
    """The same by the envelope theorem."""
    near, far = 1 - actual.along, actual.along
    x, y = actual.normal_x, actual.normal_y
    return -np.stack([near * x, near * y, far * x, far * y, near, far], 1)


def off_the_medial_axis(limb: Discs, points: np.ndarray) -> np.ndarray:
    """The points at which the distance has a derivative, well away from those where it has none."""
    axis = limb.far - limb.near
    away = points - limb.near
    aside = np.abs(axis[0] * away[:, 1] - axis[1] * away[:, 0]) / np.linalg.norm(axis)
    centres = np.stack([limb.near, limb.far])[:, None]
    return points[(aside > 0.03) & (np.linalg.norm(points - centres, axis=-1) > 0.03).all(0)]


@given(LIMBS, SEEDS)
def test_derivatives_by_the_discs_are_those_of_the_touching_circle(limb, seed):
    assume(exceeds(limb) > abs(limb.radii[0] - limb.radii[1]) / 99 + 0.02)
    points = off_the_medial_axis(limb, scattered(seed, 16))
    expected = by_finite_differences(limb, points)
    np.testing.assert_allclose(by_the_touching_circle(touched(limb, points)), expected, atol=2e-4)


@given(vectors(2, 0.5), st.floats(-np.pi, np.pi), st.floats(0.05, 0.9), SEEDS)
def test_a_nested_disc_has_no_say_in_the_distance(near, turn, share, seed):
    for limb in nested(near, turn, share):
        points = off_the_medial_axis(limb, scattered(seed, 8, 1.0))
        actual = by_the_touching_circle(touched(limb, points))
        np.testing.assert_allclose(actual, by_finite_differences(limb, points), atol=2e-4)
        inner = [2, 3, 5] if limb.radii[0] > limb.radii[1] else [0, 1, 4]
        assert not actual[:, inner].any()


@given(SIDE_ON)
def test_outline_points_lie_on_the_outline_and_weigh_its_length(limb):
    with double():
        points, weights, _ = OUTLINE(on_device(limb), jnp.ones(2))
        distances = DISTANCE(on_device(limb), points)
    assert points.shape == (2 * ALONG + 2 * AROUND, 2)
    np.testing.assert_allclose(distances, 0, atol=1e-6)
    # In two dimensions SciPy calls the hull's perimeter its area.
    assert np.sum(np.asarray(weights)) == pytest.approx(
        ConvexHull(hull_points(limb)).area, rel=1e-5
    )


@given(SIDE_ON)
def test_normals_point_outwards_from_the_outline(limb):
    with double():
        points, _, normals = OUTLINE(on_device(limb), jnp.ones(2))
        farther = DISTANCE(on_device(limb), points + 0.01 * normals)
    np.testing.assert_allclose(farther, 0.01, atol=1e-6)


@given(LIMBS, st.integers(0, 1))
def test_closed_ends_do_not_count_on_a_limb_seen_from_the_side(limb, end):
    length, (a, b) = np.linalg.norm(limb.near - limb.far), limb.radii
    assume(length > a + b)
    side = np.sqrt(length**2 - (a - b) ** 2)
    with double():
        closed, opened = (
            OUTLINE(on_device(limb), ends)[1] for ends in (jnp.zeros(2), jnp.eye(2)[end])
        )
    assert np.sum(np.asarray(closed)) == pytest.approx(2 * side, rel=1e-9)
    half = np.arccos((a - b) / length)
    arc = 2 * half * b if end else 2 * (np.pi - half) * a
    assert np.sum(np.asarray(opened)) == pytest.approx(2 * side + arc, rel=1e-9)
    assert (np.asarray(opened) >= 0).all()


def test_a_closed_limb_seen_end_on_still_has_an_outline():
    end_on = discs([0.2, 0.1], [0.2, 0.1], 0.1, 0.08)
    weights = OUTLINE(on_device(end_on), jnp.zeros(2))[1]
    assert np.sum(np.asarray(weights)) == pytest.approx(2 * np.pi * 0.1, rel=0.03)


def spheres_to_everything(near_cam, far_cam, radii):
    limb = outlines.project_limb(near_cam, far_cam, radii)
    points, weights, _ = OUTLINE(limb, jnp.array([0.0, 1.0]))
    inside = outlines.signed_distance(limb, jnp.array([[0.05, -0.02], [0.0, 0.0], [0.4, 0.3]]))
    return jnp.sum(points * weights[:, None]), jnp.sum(inside)


DERIVATIVES = jax.jit(jax.jacrev(spheres_to_everything, argnums=(0, 1, 2)))


@pytest.mark.parametrize(
    ("near", "far"),
    [
        ([0.0, 0.0, 2.0], [0.0, 0.0, 2.3]),  # end-on, on the optical axis
        ([0.1, 0.2, 2.0], [0.115, 0.23, 2.3]),  # end-on, off the axis
        ([0.1, 0.2, 2.0], [0.1, 0.2, 2.0]),  # no length
        ([0.0, 0.0, 2.0], [0.3, 0.0, 2.0]),  # from the side
        ([0.1, 0.0, 0.3], [0.1, 0.0, -0.3]),  # through the camera's plane
        ([0.1, 0.0, -2.0], [0.1, 0.3, -2.0]),  # behind the camera
        ([0.0, 0.0, 0.0], [0.0, 0.0, 0.0]),  # in the camera
    ],
)
def test_values_and_gradients_are_finite_from_every_side(near, far):
    arguments = (jnp.array(near), jnp.array(far), jnp.array([0.05, 0.04]))
    assert all(np.isfinite(value) for value in spheres_to_everything(*arguments))
    gradients = DERIVATIVES(*arguments)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(gradients))


@given(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3), st.floats(0.2, 1.2))
def test_a_projected_limb_covers_the_points_inside_it(x, y, tilt):
    """Points of the cone, projected, are inside of the hull of its two discs."""
    near = np.array([x, y, 3.0])
    far = near + 0.3 * np.array([np.cos(tilt), 0.2, np.sin(tilt)])
    widths = np.array([0.06, 0.04])
    rng = np.random.default_rng(0)
    t = rng.uniform(0, 1, (200, 1))
    aside = rng.normal(size=(200, 3))
    aside[:, 2] = 0
    aside /= np.linalg.norm(aside, axis=1, keepdims=True)
    points = (1 - t) * near + t * far + aside * (0.99 * ((1 - t) * widths[0] + t * widths[1]))
    with double():
        limb = outlines.project_limb(*(on_device(part) for part in (near, far, widths)))
        distances = DISTANCE(limb, on_device(points[:, :2] / points[:, 2:]))
    assert (np.asarray(distances) < 0).all()


def test_batched_limbs_are_limbs_side_by_side():
    rng = np.random.default_rng(1)
    many = Discs(
        rng.normal(size=(3, 2, 2)), rng.normal(size=(3, 2, 2)), rng.uniform(0.1, 0.2, (3, 2, 2))
    )
    single = on_device(many)
    together = OUTLINE(single, jnp.array([0.0, 1.0]))
    assert together[0].shape == (3, 2, 2 * ALONG + 2 * AROUND, 2)
    alone = OUTLINE(jax.tree.map(lambda part: part[1, 0], single), jnp.array([0.0, 1.0]))
    for every, one in zip(together, alone, strict=True):
        np.testing.assert_allclose(every[1, 0], one, atol=1e-6)
