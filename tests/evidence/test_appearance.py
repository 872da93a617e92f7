"""The body as poses put it into shrunk images, however many poses there are."""

import numpy as np
import pytest
from drawn_arms import SIZE
from drawn_body import paint, room
from painted_motion import CAMERAS, PERSON, truth

from jaxmocap.body.pose import Pose
from jaxmocap.evidence.appearance import learned
from jaxmocap.evidence.appearance.learned import POSES_A_CALL, ROWS, Drawing
from jaxmocap.images.foreground import shrink

COUNT = POSES_A_CALL + 3


def drawing(poses: Pose) -> Drawing:
    """By camera 0."""
    return Drawing.of(PERSON, CAMERAS[0], SIZE, poses)


def first(count: int) -> Pose:
    return Pose(*(part[:count] for part in truth(COUNT)))


def test_poses_are_drawn_where_a_camera_sees_them():
    there = drawing(first(2))
    assert there.size[1] == ROWS and there.ratio == pytest.approx(ROWS / SIZE[1])
    pose = Pose(*(part[1] for part in truth(COUNT)))
    painted = shrink(paint(CAMERAS[0], PERSON, pose, room(SIZE)).person, ROWS) > 0.5
    covered = there.mask(1, 1.0, without=("foot",))
    assert painted.sum() > 3000 and (covered & painted).sum() > 0.97 * (covered | painted).sum()


def test_legs_that_no_marker_holds_may_be_a_stride_aside():
    """Learned as furniture otherwise, if they never move."""
    there = first(1)
    aside = there._replace(angles=there.angles.copy())
    for name in ("hip_abduction_l", "hip_abduction_r"):
        aside.angles[:, PERSON.tree.joints.index(name)] += 0.3
    legs = drawing(there).mask(0, 1.0, only=("thigh", "shank"))
    held, astray = (drawing(aside).wherever(0, free) for free in (False, True))
    assert (legs & astray).sum() > 0.97 * legs.sum() > 1.5 * (legs & held).sum()


def test_any_number_of_poses_compiles_once():
    drawing(first(2))
    compiled = learned._all_in_image.kinds
    few, many = drawing(first(3)), drawing(first(COUNT))
    assert learned._all_in_image.kinds == compiled
    assert len(many.per_metre) == COUNT
    for own, expected in zip(few.discs, many.discs, strict=True):
        np.testing.assert_array_equal(own, expected[:3])
