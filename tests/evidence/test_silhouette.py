"""Silhouettes: soft coverage against grids, its derivatives, drawn hulls, parts by colour."""

from functools import partial

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import double, on_device
from drawn_arms import SIZE, arm_pose, camera_at
from drawn_body import SHIRT, SKIN, paint, room
from hypothesis import given
from hypothesis import strategies as st
from watched_arms import FRONT, PERSON, TRUTH

from jaxmocap.body.kinematics import forward
from jaxmocap.body.pose import retract
from jaxmocap.body.proportions import PROPORTIONS, scale_skeleton
from jaxmocap.body.surfaces.cones import cones, project_cones
from jaxmocap.body.tree import ROOT_DOF
from jaxmocap.evidence.appearance.hulls import BENEFIT, draw_hulls, part_odds
from jaxmocap.evidence.silhouettes import (
    LegGrid,
    SilhouetteGrids,
    forearms,
    project_flesh,
    project_limbs,
    silhouette_fit,
)
from jaxmocap.geometry.cameras import focal_length, turn_camera
from jaxmocap.geometry.outlines import Discs, signed_distance
from jaxmocap.images.colours import Colours, colour_bins, learn_colours
from jaxmocap.images.regions import Region, in_other_region
from jaxmocap.images.silhouette_grid import (
    Grid,
    blur_grid,
    cells,
    coverage_fit,
    distances,
    frontmost,
)
from jaxmocap.reference.hybrid import raster as reference

CELLS, LIMBS, SOFTNESS = 16, 4, 1.3
# Silhouettes of the whole body.
BODY_CELLS, BODY_REGION = 32, Region(np.array([111.5, 31.5]), np.array(13.0))
LEGS_REGION = Region(np.array([190.5, 330.5]), np.array(17.0))
# Pixels of a metre at the person.
PER_METRE = np.array(float(focal_length(FRONT)) / 2.2)


def residuals(limbs: Discs, grid: Grid, softness, visible=1.0):
    """Of all cells, each owned by the limb that reaches farthest over it."""
    points = jnp.stack(cells(grid.probability.shape[-1], limbs.near.dtype), -1)
    each = Discs(*(part[:, None] for part in limbs))
    covered = jax.nn.sigmoid(-jnp.min(signed_distance(each, points), 0) / softness)
    return grid.weight.ravel() * (covered * visible - grid.probability.ravel())


def coverage_cost(limbs: Discs, grid: Grid, softness, visible=1.0):
    """What ``coverage_fit`` is the Gauss-Newton form of."""
    return jnp.sum(residuals(limbs, grid, softness, visible) ** 2)


COST, FIT = jax.jit(coverage_cost), jax.jit(coverage_fit)


def random_limbs(rng: np.random.Generator) -> Discs:
    """Limbs about a grid, the first of them seen end-on."""
    near = rng.uniform(0, CELLS, (LIMBS, 2))
    turn, length = rng.uniform(0, 2 * np.pi, LIMBS), rng.uniform(4, 12, LIMBS)
    length[0] = 0.3
    far = near + length[:, None] * np.stack([np.cos(turn), np.sin(turn)], 1)
    radii = rng.uniform(1, 3, (LIMBS, 2))
    radii[0] = [3.0, 1.5]
    return Discs(near, far, radii)


def random_grid(rng: np.random.Generator, size: int) -> Grid:
    """Probabilities, and weights of which a third is zero."""
    weight = np.maximum(rng.uniform(-0.5, 1, (size, size)), 0)
    return Grid(rng.uniform(0, 1, (size, size)), weight)


def example(seed: int) -> tuple[Discs, Grid, np.ndarray]:
    """Limbs, a grid, and how visible they are."""
    rng = np.random.default_rng(seed)
    return random_limbs(rng), random_grid(rng, CELLS), rng.uniform(0, 1, CELLS**2)


# Coverage ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(4))
def test_the_cost_is_the_references_cell_by_cell(seed):
    limbs, grid, visible = example(seed)
    expected = 0.0
    for i, (row, column) in enumerate(np.ndindex(CELLS, CELLS)):
        cell = np.array([column, row], float)
        deepest = min(reference.signed_distance(cell, *limb) for limb in zip(*limbs, strict=True))
        covered = 1 / (1 + np.exp(np.clip(deepest / SOFTNESS, -700, 700)))
        probability, weight = (part[row, column] for part in grid)
        expected += (weight * (covered * visible[i] - probability)) ** 2
    with double():
        arguments = on_device((limbs, grid, SOFTNESS, visible))
        assert float(COST(*arguments)) == pytest.approx(expected, rel=1e-9)
        assert float(FIT(*arguments).cost) == pytest.approx(expected, rel=1e-9)
    single = on_device((limbs, grid, SOFTNESS, visible), jnp.float32)
    assert float(FIT(*single).cost) == pytest.approx(expected, rel=1e-4)


def by_limb(derivatives: Discs) -> np.ndarray:
    """Derivatives (..., K, 6) by near x, y; far x, y; near and far radius."""
    return np.concatenate([np.asarray(part) for part in derivatives], -1)


GRADIENT, ROWS = jax.jit(jax.grad(coverage_cost)), jax.jit(jax.jacfwd(residuals))


@given(st.integers(0, 10_000))
def test_the_fits_gradient_is_half_the_costs(seed):
    with double():
        arguments = on_device((*example(seed)[:2], SOFTNESS, example(seed)[2]))
        actual, expected = FIT(*arguments).gradient, by_limb(GRADIENT(*arguments)) / 2
    np.testing.assert_allclose(actual, expected, atol=1e-9 * max(1, np.abs(expected).max()))
    assert np.abs(expected).max() > 0.01


@given(st.integers(0, 10_000))
def test_the_fits_hessian_is_that_of_the_rows_of_each_limb(seed):
    with double():
        arguments = on_device((*example(seed)[:2], SOFTNESS, example(seed)[2]))
        actual, rows = np.asarray(FIT(*arguments).hessian), by_limb(ROWS(*arguments))
    np.testing.assert_allclose(actual, np.einsum("cki,ckj->kij", rows, rows), atol=1e-9)
    # Limbs do not share cells.
    between = np.einsum("cki,clj->klij", rows, rows)
    assert not between[~np.eye(LIMBS, dtype=bool)].any()


def test_cells_without_weight_do_not_count():
    limbs, grid, visible = example(0)
    blind = grid._replace(weight=np.zeros_like(grid.weight))
    fit = FIT(*on_device((limbs, blind, SOFTNESS, visible)))
    assert not any(np.asarray(part).any() for part in fit)


# Blurred grids ------------------------------------------------------------------------------------


def test_blurring_keeps_what_is_unknown_without_weight():
    rng = np.random.default_rng(3)
    probability, weight = rng.uniform(0, 1, (2, 2, 40, 40)).astype(np.float32)
    weight[:, :, :20] = 0
    soft = blur_grid(Grid(probability, weight), 1.0)
    # The blur reaches a few cells into the unknown half.
    assert not soft.weight[:, :, :14].any() and not soft.probability[:, :, :14].any()
    assert (soft.weight[:, :, 26:] > 0.05).all()
    assert (soft.probability >= 0).all() and (soft.probability <= 1).all()


def test_blurring_averages_by_weight():
    ones = np.ones((1, 30, 30), np.float32)
    left = np.arange(30) < 15
    # Where nothing was measured a wild guess stands; it must not spread.
    grid = Grid(np.where(left, ones, 0.3 * ones), np.where(left, 0 * ones, ones))
    soft = blur_grid(grid, 2.0)
    weighted = soft.weight > 0.01
    np.testing.assert_allclose(soft.probability[weighted], 0.3, atol=0.03)
    even = blur_grid(Grid(ones * left, ones), 2.0)
    expected = cv2.GaussianBlur((ones * left)[0], (0, 0), 2.0, borderType=cv2.BORDER_REPLICATE)
    np.testing.assert_allclose(even.probability[0], expected, atol=2e-3)
    np.testing.assert_allclose(even.weight, 1, atol=1e-6)


def test_each_grid_of_a_batch_is_blurred_by_itself():
    rng = np.random.default_rng(4)
    probability, weight = rng.uniform(0, 1, (2, 3, 20, 20)).astype(np.float32)
    together = blur_grid(Grid(probability, weight), 1.5)
    alone = blur_grid(Grid(probability[1:2], weight[1:2]), 1.5)
    np.testing.assert_array_equal(together.probability[1:2], alone.probability)
    np.testing.assert_array_equal(together.weight[1:2], alone.weight)


# Drawn hulls -------------------------------------------------------------------------------------


@given(st.integers(0, 10_000))
def test_drawn_hulls_are_where_the_signed_distance_is_negative(seed):
    rng = np.random.default_rng(seed)
    near, far = rng.uniform(-20, 100, (2, 3, 2))
    limbs = Discs(near, far, rng.uniform(3, 25, (3, 2)))
    mask = draw_hulls(limbs, (80, 60))
    assert mask.shape == (60, 80) and mask.dtype == bool
    points = np.stack(np.meshgrid(np.arange(80.0), np.arange(60.0)), -1)
    with double():
        each = on_device(Discs(*(part[:, None, None] for part in limbs)))
        distance = np.asarray(signed_distance(each, on_device(points))).min(0)
    # Corners lie on whole pixels, and 24 of them make a circle.
    assert mask[distance < -1.5].all() and not mask[distance > 1.5].any()


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e9])
def test_hulls_that_are_nowhere_are_left_out(value):
    good = Discs(np.array([[20.0, 20]]), np.array([[40.0, 30]]), np.array([[6.0, 4]]))
    for field in range(3):
        bad = [part.copy() for part in good]
        bad[field][0, 0] = value
        both = Discs(*(np.concatenate(pair) for pair in zip(good, bad, strict=True)))
        np.testing.assert_array_equal(draw_hulls(both, (64, 48)), draw_hulls(good, (64, 48)))
        assert not draw_hulls(Discs(*bad), (64, 48)).any()


def test_hulls_outside_the_image_draw_nothing():
    beside = Discs(np.array([[-90.0, 20]]), np.array([[-40.0, 30]]), np.array([[6.0, 4]]))
    assert not draw_hulls(beside, (64, 48)).any()


# Parts by colour ---------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def painted():
    """The body as it is painted, and colours of its forearms against the rest of it."""
    picture = paint(FRONT, PERSON, TRUTH, room(SIZE))
    fore, body = picture.forearms > 0.9, picture.person > 0.9
    return picture, learn_colours(picture.image[None], fore[None], ~(body & ~fore)[None])


def test_a_part_is_found_by_its_colours_on_the_person(painted):
    picture, colours = painted
    person = np.where(picture.person > 0.5, np.float32(3), np.float32(-3))
    nowhere = np.zeros(person.shape, bool)
    odds = part_odds(picture.image, person, colours, nowhere)
    inner = cv2.erode((picture.forearms > 0.9).astype(np.uint8), np.ones((5, 5))) > 0
    # Half-covered pixels at the border of trousers and wall have colours of their own.
    shirt = (np.abs(picture.image.astype(int) - SHIRT).max(-1) < 2) & (picture.person == 1)
    shirt = cv2.erode(shirt.astype(np.uint8), np.ones((7, 7))) > 0
    assert inner.sum() > 100 and shirt.sum() > 1000
    assert (odds[inner] > 1).all() and (odds[shirt] < -1).all()
    away = cv2.dilate((picture.person > 0).astype(np.uint8), np.ones((9, 9))) == 0
    assert (odds[away] < 0).all()


def test_a_part_is_hardly_surer_than_the_person_and_unknown_elsewhere(painted):
    picture, colours = painted
    elsewhere = np.zeros(picture.person.shape, bool)
    elsewhere[:100] = True
    for doubt in (-2.0, 0.0):
        odds = part_odds(
            picture.image, np.full(elsewhere.shape, np.float32(doubt)), colours, elsewhere
        )
        assert odds[100:].max() <= doubt + BENEFIT + 1e-4
        assert not odds[:100].any() and odds[100:].any()


def test_the_parts_colours_are_told_from_the_rest_of_the_body(painted):
    _, colours = painted
    assert isinstance(colours, Colours)
    bins = colour_bins(np.array([[SKIN, SHIRT]], np.uint8))[0]
    ratio = colours.body[bins] / colours.rest[bins]
    assert ratio[0] > 5 and ratio[1] < 0.2


# The body's silhouette ---------------------------------------------------------------------------


def silhouette_cost(skeleton, frames, camera, grids: SilhouetteGrids, softness):
    """What ``silhouette_fit`` is the Gauss-Newton form of."""
    _, discs, visible = project_limbs(skeleton, frames, camera, grids)
    arms = Discs(*(part[forearms(skeleton.tree)] for part in discs))
    cost = coverage_cost(discs, grids.person, softness)
    cost += coverage_cost(arms, grids.forearms, softness, visible)
    if grids.legs is not None:
        below = in_other_region(discs, grids.region, grids.legs.region)
        cost += coverage_cost(below, grids.legs.person, softness)
    return cost


def moved_cost(step, skeleton, proportions, pose, camera, grids, softness):
    """The silhouette's cost of pose, proportions and camera moved by a tangent vector."""
    count = step.shape[0] - proportions.shape[0] - 3
    of_pose, lengths, turn = jnp.split(step, [count, step.shape[0] - 3])
    person = scale_skeleton(skeleton, proportions + lengths)
    frames = forward(person, retract(pose, of_pose))
    return silhouette_cost(person, frames, turn_camera(camera, turn), grids, softness)


FITTED, COSTED = jax.jit(silhouette_fit), jax.jit(moved_cost)
STEPPED = jax.jit(jax.value_and_grad(moved_cost))
AT_REST = np.zeros(ROOT_DOF + len(PERSON.tree.joints) + len(PROPORTIONS) + 3)


def random_grids(seed: int, of_forearms: float = 1.0, legs: bool = False) -> SilhouetteGrids:
    """Random grids of the body; smooth, as those of images."""
    rng = np.random.default_rng(seed)
    blur = partial(cv2.GaussianBlur, ksize=(0, 0), sigmaX=2.0)
    probability, weight = (
        [blur(rng.uniform(low, 1, (BODY_CELLS, BODY_CELLS))) for _ in range(2)] for low in (0, 0.5)
    )
    below = Grid(blur(rng.uniform(0, 1, (16, 16))), blur(rng.uniform(0.5, 1, (16, 16))))
    return SilhouetteGrids(
        BODY_REGION,
        Grid(probability[0], weight[0]),
        Grid(probability[1], of_forearms * weight[1]),
        PER_METRE,
        LegGrid(LEGS_REGION, below) if legs else None,
    )


def body_arguments(grids: SilhouetteGrids, camera=FRONT, pose=TRUTH, softness: float = 1.0):
    proportions = np.linspace(-0.1, 0.05, len(PROPORTIONS))
    return on_device((PERSON, proportions, pose, camera, grids, softness), float)


@pytest.mark.parametrize(
    ("legs", "unmarked"), [(False, None), (True, None), (False, np.zeros(())), (False, np.ones(()))]
)
def test_the_silhouettes_gradient_is_half_its_costs_without_distortion(legs, unmarked):
    """What hides a forearm has no derivative, in either."""
    with double():
        grids = random_grids(1, legs=legs)._replace(unmarked=unmarked)
        arguments = body_arguments(grids)
        cost, _, gradient = FITTED(*arguments)
        expected_cost, slope = STEPPED(on_device(AT_REST), *arguments)
        expected = np.asarray(slope) / 2
        assert float(cost) == pytest.approx(float(expected_cost), rel=1e-9)
    np.testing.assert_allclose(gradient, expected, atol=1e-6 * np.abs(expected).max())
    assert (np.abs(expected[-len(PROPORTIONS) - 3 :]) > 0.01).all()


def test_the_whole_persons_gradient_is_that_of_finite_differences():
    with double():
        arguments = body_arguments(random_grids(2, of_forearms=0.0))
        _, _, gradient = FITTED(*arguments)
        up, down = (
            np.array([COSTED(on_device(step), *arguments) for step in sign * np.eye(len(AT_REST))])
            for sign in (1e-6, -1e-6)
        )
    expected = (up - down) / 2e-6 / 2
    # A cell that changes its limb within the step errs a little.
    np.testing.assert_allclose(gradient, expected, atol=1e-3 * np.abs(expected).max())


def test_of_a_body_as_stated_there_is_the_same_without_what_it_shares():
    skeleton, _, *rest = body_arguments(random_grids(7, legs=True))
    shared = FITTED(skeleton, jnp.zeros(len(PROPORTIONS)), *rest)
    cost, hessian, gradient = (np.asarray(part) for part in FITTED(skeleton, None, *rest))
    own = slice(len(AT_REST) - len(PROPORTIONS) - 3)
    assert float(shared[0]) == pytest.approx(float(cost), rel=1e-6)
    atol = 1e-5 * np.abs(hessian).max()
    np.testing.assert_allclose(shared[1][own, own], hessian, atol=atol)
    np.testing.assert_allclose(shared[2][own], gradient, atol=atol)


def test_trunk_and_legs_that_come_nearer_look_no_thicker():
    """Nor thinner: what one wears is thicker than drawn, by more than depth makes of it.

    The head's distance is no matter of theirs either: a broad trunk brought it nearer.
    """
    tree = PERSON.tree
    by_distance = np.isin(tree.drawn, tree.bones_in("arm", "head"))
    for pose in (TRUTH, TRUTH._replace(position=TRUTH.position + np.array([0.5, 0.0, 0.0]))):
        flesh = cones(PERSON, forward(PERSON, on_device(pose)), tree.drawn)
        actual, plain = project_flesh(tree, FRONT, flesh, PER_METRE), project_cones(FRONT, flesh)
        sizes = np.asarray(actual.radii) / np.asarray(flesh.radii)
        np.testing.assert_allclose(sizes[~by_distance], float(PER_METRE), rtol=1e-4)
        assert np.ptp((np.asarray(plain.radii) / flesh.radii)[~by_distance]) > 10
        np.testing.assert_allclose(actual.radii[by_distance], plain.radii[by_distance], rtol=1e-6)
        # Without a marker, nor do arms and head.
        alike = project_flesh(tree, FRONT, flesh, PER_METRE, unmarked=np.ones(()))
        np.testing.assert_allclose(alike.radii / flesh.radii, float(PER_METRE), rtol=1e-4)
        for end in ("near", "far"):
            np.testing.assert_allclose(getattr(actual, end), getattr(plain, end))


def test_a_mild_distortion_hardly_turns_the_gradient():
    camera = camera_at((2.2, 0.3, 1.35), (0.0, 0.0, 1.15), distortion=(-0.08, 0.02))
    with double():
        arguments = body_arguments(random_grids(3), camera)
        gradient = np.asarray(FITTED(*arguments)[2])
        expected = np.asarray(STEPPED(on_device(AT_REST), *arguments)[1]) / 2
    cosine = gradient @ expected / np.linalg.norm(gradient) / np.linalg.norm(expected)
    assert cosine > 0.99


def test_the_silhouettes_hessian_is_symmetric_and_nowhere_negative():
    cost, hessian, gradient = FITTED(*body_arguments(random_grids(4)))
    hessian = np.asarray(hessian, float)
    np.testing.assert_allclose(hessian, hessian.T, atol=1e-5 * np.abs(hessian).max())
    values = np.linalg.eigvalsh(hessian)
    assert values.min() > -1e-5 * values.max()
    assert float(cost) > 0 and np.isfinite(np.asarray(gradient)).all()


def test_the_silhouettes_hessian_is_the_costs_where_all_is_as_drawn():
    """Where nothing differs the residuals vanish, and J^T J is half of the cost's Hessian."""
    with double():
        empty = random_grids(5, of_forearms=0.0)
        skeleton, proportions, pose, camera, grids, softness = body_arguments(empty)
        ones = on_device(np.ones((BODY_CELLS, BODY_CELLS)))

        def covered(probability):
            observed = grids._replace(person=Grid(probability, ones))
            return silhouette_cost(
                scale_skeleton(skeleton, proportions),
                forward(scale_skeleton(skeleton, proportions), pose),
                camera, observed, softness,
            )  # fmt: skip

        # Of the sum of (c - p)^2 about p = 0 the derivative by p is -2 c.
        as_drawn = jax.jit(jax.grad(covered))(0 * ones) / -2
        drawn = grids._replace(person=Grid(as_drawn, ones))
        arguments = (skeleton, proportions, pose, camera, drawn, softness)
        cost, hessian, gradient = (np.asarray(part) for part in FITTED(*arguments))
        assert cost < 1e-20 and np.abs(gradient).max() < 1e-9
        direction = np.random.default_rng(6).normal(size=len(AT_REST))
        there = 1e-5 * direction
        pulls = [np.asarray(STEPPED(on_device(s * there), *arguments)[1]) / 2 for s in (1, -1)]
    expected = (pulls[0] - pulls[1]) / 2e-5
    actual = hessian @ direction
    np.testing.assert_allclose(actual, expected, atol=2e-3 * np.abs(actual).max())


ACROSS = {"arm_flex": (25, 25), "arm_rot": (80, 80), "elbow_flex": (100, 100)}


def forearms_cost(forearms, skeleton, pose, camera, grids, softness):
    """The cost of a grids with other forearms (S, S)."""
    observed = grids._replace(forearms=grids.forearms._replace(probability=forearms))
    return silhouette_cost(skeleton, forward(skeleton, pose), camera, observed, softness)


def expected_forearms(camera, pose) -> np.ndarray:
    """Visible share (S, S) of forearms: of (c - p)^2 about p = 0 the derivative is -2 c."""
    nothing = np.zeros((BODY_CELLS, BODY_CELLS))
    grids = SilhouetteGrids(
        BODY_REGION, Grid(nothing, nothing), Grid(nothing, nothing + 1), PER_METRE
    )
    skeleton, _, *rest = body_arguments(grids, camera, pose, 0.3)
    slope = jax.jit(jax.grad(forearms_cost))(jnp.asarray(nothing, float), skeleton, *rest)
    return np.asarray(slope) / -2


def painted_forearms(camera, pose) -> np.ndarray:
    """The same as it is painted; the region's corner lies on the pixels' edges."""
    share = paint(camera, PERSON, pose, room(SIZE)).forearms
    x, y = (int(value + 0.5) for value in BODY_REGION.origin)
    side = BODY_CELLS * int(BODY_REGION.scale)
    return cv2.resize(
        share[y:, x : x + side][:side], (BODY_CELLS,) * 2, interpolation=cv2.INTER_AREA
    )


def test_forearms_before_the_torso_are_expected_and_behind_it_they_are_not():
    pose, torso = arm_pose(PERSON, ACROSS), np.s_[:, 14:18]
    before, behind = (camera_at((x, 0.0, 1.3), (0.0, 0.0, 1.1)) for x in (2.2, -2.2))
    crossing = painted_forearms(before, pose)[torso].sum()
    assert crossing > 3 and painted_forearms(behind, pose)[torso].sum() == 0
    assert expected_forearms(before, pose)[torso].sum() == pytest.approx(crossing, rel=0.2)
    assert expected_forearms(behind, pose)[torso].sum() < 0.05 * crossing
    # Beside the torso they are visible from behind as well.
    beside = painted_forearms(behind, pose).sum()
    assert beside > 3 and expected_forearms(behind, pose).sum() == pytest.approx(beside, rel=0.5)


@pytest.mark.parametrize("count", [5, 32, 40, 70])
def test_the_limb_of_a_cell_is_the_one_that_reaches_farthest_over_it(count):
    rng, size = np.random.default_rng(count), 16
    ends = rng.uniform(0, size, (2, count, 2)).astype(np.float32)
    limbs = Discs(*ends, rng.uniform(0.5, 1.5, (count, 2)).astype(np.float32))
    limbs = on_device(limbs)
    away = np.asarray(jax.jit(distances, static_argnums=1)(limbs, size))
    nearest, _ = jax.jit(frontmost, static_argnums=1)(limbs, size)
    np.testing.assert_array_equal(np.asarray(nearest), away.argmin(0))
