"""How the segmentation's benchmark evaluates masks."""

import numpy as np
import pytest

from bench.segmentation import Look, Scored, contour_distance, grabbed, metrics, overlap, scored


def square(left: int, top: int, side: int = 20) -> np.ndarray:
    mask = np.zeros((60, 80), bool)
    mask[top : top + side, left : left + side] = True
    return mask


def test_overlap_and_distance_of_squares():
    assert overlap(square(10, 10), square(10, 10)) == 1
    assert overlap(square(10, 10), square(20, 10)) == pytest.approx(1 / 3)
    assert contour_distance(square(10, 10), square(10, 10)) == 0
    # Each side of the larger one is a pixel farther out, its corners by the root of two.
    assert contour_distance(square(10, 10), square(9, 9, 22)) == pytest.approx(1, abs=0.03)
    assert np.isnan(contour_distance(square(10, 10), np.zeros((60, 80), bool)))


def test_every_image_is_scored_and_medians_are_reported():
    look = Look([np.zeros((60, 80, 3), np.uint8)] * 2, [square(10, 10), square(30, 10)], [])
    actual = scored(lambda _: [square(10, 10), square(40, 10)], [look])
    assert [each.overlap for each in actual] == [1, pytest.approx(1 / 3)]
    rows = {"ours": [Scored(0.5, 1.0, 9.0), Scored(0.7, 3.0, 9.0), Scored(0.9, np.nan, 6.0)]}
    named = {metric.name: metric.value for metric in metrics(rows)}
    assert named["overlap, ours"] == pytest.approx(70)
    assert named["outlines apart, ours"] == 2 and named["four images, ours"] == 9


def test_grabcut_finds_a_square_of_another_colour():
    truth = square(30, 20)
    image = np.where(truth[..., None], 200, 60) + np.random.default_rng(0).normal(0, 4, (60, 80, 3))
    actual = grabbed(Look([image.astype(np.uint8)], [truth], [square(34, 23)]))
    assert overlap(actual[0], truth) > 0.9
