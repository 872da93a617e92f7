"""Chromaticities of a body's points, learned where they are visible."""

import numpy as np
import pytest

from jaxmocap.images.regions import Region
from jaxmocap.silhouette.recovery.chromaticity import (
    LARGEST_COST,
    BodyAppearance,
    PointCells,
    chromaticity,
    chromaticity_at,
    chromaticity_canvases,
)

SIZE = 16
SHIRT, SKIN = np.array([150, 60, 40], np.uint8), np.array([90, 120, 180], np.uint8)
REGION = Region(np.array([[-0.5, -0.5]], np.float32), np.array([1.0], np.float32))


def grid(low: int, high: int) -> np.ndarray:
    """(N, 2) pixels of a square."""
    return np.stack(np.meshgrid(np.arange(low, high), np.arange(low, high)), -1).reshape(-1, 2)


@pytest.fixture
def trunk_and_arm() -> tuple[PointCells, np.ndarray]:
    """A trunk, a smaller arm half a metre before it, and which points are the arm's."""
    trunk, arm = grid(2, 14), grid(6, 10)
    pixels = np.concatenate([trunk, arm])[None].astype(float)
    on_arm = np.arange(len(pixels[0])) >= len(trunk)
    depths = np.where(on_arm, 2.5, 3.0)[None].astype(np.float32)
    return PointCells.of(pixels, depths, REGION, SIZE), on_arm


def test_what_an_arm_hides_is_not_seen_and_the_arm_is(trunk_and_arm):
    cells, on_arm = trunk_and_arm
    depth = cells.nearest_depths(np.ones(len(on_arm), bool))
    assert depth[0, 8, 8] == 2.5 and depth[0, 3, 3] == 3.0 and np.isinf(depth[0, 0, 15])
    visible = cells.visible(depth)[0]
    rows_columns = np.stack(np.divmod(cells.cells[0], SIZE))
    behind = ~on_arm & ((rows_columns >= 6) & (rows_columns < 10)).all(0)
    assert visible[on_arm].all() and not visible[behind].any() and visible[~on_arm].sum() > 60


def test_points_beside_the_canvas_are_not_seen():
    pixels = np.array([[[3.0, 3.0], [40.0, 3.0], [-9.0, np.nan]]])
    cells = PointCells.of(pixels, np.ones((1, 3), np.float32), REGION, SIZE)
    np.testing.assert_array_equal(
        cells.visible(cells.nearest_depths(np.ones(3, bool))), [[True, False, False]]
    )


def test_a_chromaticity_is_learned_where_it_is_visible_and_brightness_ignored():
    appearance, visible = (
        BodyAppearance.empty(3),
        np.array([[True, True, False], [False, True, False]]),
    )
    shades = np.stack([SKIN, SKIN // 2, SHIRT])[None].repeat(2, 0)
    for _ in range(3):
        appearance = appearance.update(chromaticity(shades), visible)
    np.testing.assert_array_equal(appearance.frames, [3, 3, 0])
    np.testing.assert_allclose(
        appearance.chromaticities[:2], np.stack([SKIN / SKIN.sum()] * 2), atol=0.01
    )
    means = appearance.means(np.array([1, 1, 0]), 3)
    np.testing.assert_allclose(means[1], SKIN / SKIN.sum(), atol=0.01)
    assert (means[[0, 2]] == -1).all()
    assert np.isnan(chromaticity(np.array([[5, 9, 12]], np.uint8))).all()


def test_cells_that_look_like_the_arm_are_unlike_the_trunk_behind_it(trunk_and_arm):
    cells, on_arm = trunk_and_arm
    colours = np.where(on_arm[:, None], SKIN / SKIN.sum(), SHIRT / SHIRT.sum()).astype(np.float32)
    appearance = BodyAppearance(colours, np.ones(len(colours), int))
    image = np.tile(SHIRT, (SIZE, SIZE, 1))
    image[6:10, 6:10] = SKIN
    shown = chromaticity_canvases([image], [Region(*(part[0] for part in REGION))], SIZE)
    trunk = cells.visible(cells.nearest_depths(~on_arm)) & ~on_arm
    cost = cells.appearance_cost(shown, appearance, trunk)[0]
    assert cost[8, 8] == LARGEST_COST and cost[4, 4] < 0.1
    assert not cells.appearance_cost(shown, BodyAppearance.empty(len(colours)), trunk).any()
    assert not cells.appearance_cost(
        chromaticity_canvases([None], [REGION], SIZE), appearance, trunk
    ).any()


def test_pixels_beside_the_image_have_no_chromaticity():
    image = np.tile(SKIN, (4, 4, 1))
    colours = chromaticity_at(
        [image, None], np.array([[[1.0, 1.0], [9.0, 1.0]], [[1.0, 1.0], [2.0, 2.0]]])
    )
    np.testing.assert_allclose(colours[0, 0], SKIN / SKIN.sum(), rtol=1e-5)
    assert np.isnan(colours[0, 1]).all() and np.isnan(colours[1]).all()
