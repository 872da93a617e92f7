"""The body as poses put it into shrunk images, however many poses there are."""

import numpy as np
import pytest
from drawn_arms import SIZE
from drawn_body import paint, room, with_noise
from painted_motion import CAMERAS, PERSON, truth

from jaxmocap.body.pose import Pose
from jaxmocap.evidence.appearance import learned
from jaxmocap.evidence.appearance.learned import (
    POSES_A_CALL,
    ROWS,
    Drawing,
    Regions,
    learn_appearance,
    silhouette_grids,
)
from jaxmocap.evidence.appearance.running import SHARE_MEMORY, RunningAppearance
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


@pytest.fixture(scope="module")
def walk() -> Pose:
    """Poses of somebody who walks across the image, so that all of the room is visible at times."""
    poses = first(2 * SHARE_MEMORY)
    aside = np.zeros_like(poses.position)
    aside[:, 1] = np.linspace(-0.7, 0.7, len(aside))
    return poses._replace(position=poses.position + aside)


@pytest.fixture(scope="module", params=[True, False], ids=["the person", "the room alone"])
def filmed(request, walk: Pose) -> tuple[bool, list[np.ndarray]]:
    """Whether a person walks in a room, and its images."""
    images = [room(SIZE)] * len(walk.angles)
    if request.param:
        poses = [Pose(*parts) for parts in zip(*walk, strict=True)]
        images = [paint(CAMERAS[0], PERSON, pose, room(SIZE)).image for pose in poses]
    return request.param, with_noise(images, 1)


def test_a_camera_that_films_another_room_tells_nothing(walk, filmed):
    """Or films at another time. Else the room where the arms must be would push them away."""
    is_there, images = filmed
    small, there = [shrink(each, ROWS) for each in images], drawing(walk)
    appearance = learn_appearance(there, np.arange(len(small)), small, True)
    grids = silhouette_grids(small, appearance, there, Regions.around(PERSON, CAMERAS[0], walk))
    assert (grids.recognised == is_there).all()


def test_live_a_camera_that_films_another_room_soon_tells_nothing(walk, filmed):
    is_there, images = filmed
    running, recognised = RunningAppearance(PERSON, CAMERAS[0], True), []
    for image, pose in zip(
        images, (Pose(*parts) for parts in zip(*walk, strict=True)), strict=True
    ):
        frame = running.measure(image, pose, 0.8)
        recognised.append(bool(frame.grids.recognised))
        running.learn(frame, SIZE, pose)
    assert all(recognised[-10:]) if is_there else not any(recognised[-10:])
