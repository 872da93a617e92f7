"""Segmentation and pose in turn: when they have settled, and low-passes cycle by cycle."""

from types import SimpleNamespace

import numpy as np
import pytest
from test_rim import BODY

from jaxmocap.body.pose import relaxed_pose
from jaxmocap.silhouette.fit.correspond import Contour
from jaxmocap.silhouette.fit.cycles import contours_apart, has_settled
from jaxmocap.silhouette.settings import FAR_OFF, Cycle, Settings, progressive
from jaxmocap.silhouette.surfaces.body_shape import FULL

NOTHING = Contour(np.zeros((0, 2)), np.zeros((0, 2)))


def circle(radius: float, points: int, phase: float = 0.0) -> Contour:
    """About the origin."""
    phi = 2 * np.pi * np.arange(points) / points + phase
    outwards = np.stack([np.cos(phi), np.sin(phi)], 1)
    return Contour(radius * outwards, outwards)


def test_contours_are_apart_by_what_they_moved_across_however_they_were_sampled():
    one = [circle(50.0, 400), NOTHING]
    scales, moved = (2.0, 1.0), [circle(52.0, 300, 0.1), NOTHING]
    assert contours_apart(one, [circle(50.0, 300, 0.1), NOTHING], scales) < 0.01
    assert contours_apart(one, moved, scales) == pytest.approx(1.0, abs=0.01)
    assert contours_apart(one, [circle(50.0, 300), circle(9.0, 50)], scales) == np.inf
    assert contours_apart([NOTHING], [NOTHING], (1.0,)) == 0


def test_a_round_has_settled_where_neither_pose_nor_contour_moved():
    pose = relaxed_pose(BODY)
    turned = pose._replace(angles=pose.angles.at[BODY.tree.joint("elbow_flex_l")].add(0.1))
    region = SimpleNamespace(scale=(2.0,))
    near, far = (
        SimpleNamespace(contours=[circle(radius, 400)], region=region) for radius in (50.0, 51.0)
    )
    assert has_settled(BODY, (pose, pose), (near, near))
    assert not has_settled(BODY, (pose, turned), (near, near))
    assert not has_settled(BODY, (pose, pose), (near, far))


@pytest.mark.parametrize(
    ("count", "levels", "deviations"),
    [
        (0, [FULL, FULL, FULL], [0.03, 0.008, 0.004]),
        (2, [1, 2, FULL], [0.03, 0.008, 0.004]),
        (3, [0, 1, 2, FULL], [0.03, 0.03, 0.008, 0.004]),
    ],
)
def test_frequencies_are_added_cycle_by_cycle_and_the_last_has_them_all(count, levels, deviations):
    cycles = progressive(Settings().cycles, count, available=3)
    assert [cycle.level for cycle in cycles] == levels
    assert [cycle.deviation for cycle in cycles] == deviations
    assert [cycle.segments for cycle in cycles] == [True] + [False] * (len(cycles) - 1)


def test_more_levels_than_there_are_are_refused():
    with pytest.raises(ValueError, match="found 4 levels, expected 3 at most"):
        progressive((Cycle(0.01),), 4, len(Settings().rim.levels))
    assert {cycle.level for cycle in FAR_OFF} == {0}
