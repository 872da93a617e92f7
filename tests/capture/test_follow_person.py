"""Whose key points they are where nothing but the images says so."""

import numpy as np
import pytest

from jaxmocap.capture.keypoints import follow_person
from jaxmocap.formats.recordings.keypoints import Detections

NAMES = ("shoulder_l", "shoulder_r", "hip_l", "hip_r")
SHAPE = np.array([[-1.0, -2], [1, -2], [-1, 2], [1, 2]])
FRAMES = 6


def two_people(swapped=(3,)) -> Detections:
    """A large person walks to the right past a small one; some frames list them the other way."""
    large = 200 + 30 * SHAPE + np.arange(FRAMES)[:, None, None] * np.array([8.0, 0.0])
    small = np.tile(np.array([260.0, 180]) + 10 * SHAPE, (FRAMES, 1, 1))
    pixels = np.stack([large, small], 1)
    for frame in swapped:
        pixels[frame] = pixels[frame, ::-1]
    return Detections(np.arange(FRAMES), NAMES, pixels, np.ones(pixels.shape[:3]))


def test_the_largest_person_is_followed_whatever_the_order():
    person = follow_person(two_people())
    assert person.pixels_xy.shape == (FRAMES, 1, 4, 2)
    np.testing.assert_allclose(person.pixels_xy[:, 0, 0, 0], 170 + 8 * np.arange(FRAMES))


def test_somebody_at_a_stated_place_is_followed_instead():
    person = follow_person(two_people(), np.array([260.0, 180]) + 10 * SHAPE)
    np.testing.assert_allclose(person.pixels_xy[:, 0, 0, 0], 250)


def test_who_is_suddenly_elsewhere_is_somebody_else():
    people = two_people(swapped=())
    pixels = people.pixels_xy[:, :1].copy()
    pixels[4] += 300.0
    alone = Detections(people.numbers, NAMES, pixels, np.ones(pixels.shape[:3]))
    person = follow_person(alone)
    assert person.confidences[4].max() == 0 and np.isnan(person.pixels_xy[4]).all()
    assert (person.confidences[[0, 1, 2, 3, 5]] == 1).all()


@pytest.mark.parametrize("begins", [None, 0])
def test_whose_left_and_right_are_suddenly_swapped_is_followed_on(begins):
    people = two_people()
    pixels = people.pixels_xy.copy()
    pixels[2:5] = pixels[2:5][:, :, [1, 0, 3, 2]]
    first = None if begins is None else pixels[0, 0]
    person = follow_person(Detections(people.numbers, NAMES, pixels, people.confidences), first)
    there = np.where(np.isin(np.arange(FRAMES), (2, 3, 4)), 230, 170)
    np.testing.assert_allclose(person.pixels_xy[:, 0, 0, 0], there + 8 * np.arange(FRAMES))


@pytest.mark.parametrize("missing", [0, 2])
def test_a_point_that_is_missing_once_is_remembered(missing):
    people = two_people(swapped=())
    sure = people.confidences.copy()
    sure[2, 0, missing] = 0.0
    person = follow_person(Detections(people.numbers, NAMES, people.pixels_xy, sure))
    assert person.confidences[2, 0, missing] == 0 and (person.confidences[3] == 1).all()
