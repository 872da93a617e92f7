"""Photographs of a test person, what a tape would measure, and the person before a sheet."""

import cv2
import numpy as np
import pytest
from conftest import read_calibration
from photograph_masks import true_person_mask

from bench.modelling import MeasuredPerson
from jaxmocap.geometry.cameras import depth, on_host, project
from jaxmocap.silhouette.modelling.measurements import girth_section
from jaxmocap.silhouette.modelling.pictures.backdrop import PhotographError, person_mask
from jaxmocap.synthetic.people.rigged_mesh import load_rig
from jaxmocap.synthetic.photographs import (
    PHOTOGRAPHS,
    SIZE,
    backdrop,
    camera_of,
    person_in_stance,
)


@pytest.fixture(scope="module")
def front(shots):
    return cv2.imread(str(shots / "front.png"))


def painted(radius=150, colour=(60, 60, 200)):
    """A person as far as colours go: a disc before the sheet."""
    image = backdrop(np.random.default_rng(0))
    cv2.circle(image, (SIZE[0] // 2, 400), radius, colour, -1)
    return image


def test_the_four_photographs_have_their_sections_in_the_calibration(shots, slim_woman):
    cameras = read_calibration(shots / "calibration.toml")
    assert list(cameras) == list(PHOTOGRAPHS)
    for name, camera in cameras.items():
        image = cv2.imread(str(shots / f"{name}.png"))
        assert image is not None and image.shape == (SIZE[1], SIZE[0], 3)
        here = np.asarray(camera_of(slim_woman, name).position_world)
        assert np.abs(np.asarray(camera.position_world) - here).max() < 1e-3


@pytest.mark.parametrize("name", PHOTOGRAPHS)
def test_everybody_fits_into_every_photograph_but_for_the_legs(recordings, name):
    for who in ("tall_man", "short_woman", "broad_man"):
        person = load_rig(recordings / "person" / "person.npz", who)
        pixels = project(
            on_host(camera_of(person, name)),
            person_in_stance(person, name).vertices(np.zeros(1))[0],
        )
        assert pixels[:, 0].min() > 10 and pixels[:, 0].max() < SIZE[0] - 10
        assert pixels[:, 1].min() > 10 and pixels[:, 1].max() > SIZE[1]


def test_a_section_of_the_trunk_is_as_wide_as_the_person_is_seen(slim_woman):
    body, lens = (
        MeasuredPerson.of(person_in_stance(slim_woman, "front")),
        on_host(camera_of(slim_woman, "front")),
    )
    landmarks = body.landmarks()
    waist = (0.6 * landmarks["pelvis"] + 0.4 * landmarks["neck"])[2]
    row, column = np.rint(project(lens, np.array([0.0, 0.0, waist])))[::-1].astype(int)
    line = true_person_mask(slim_woman, "front")[row]
    left, right = (np.flatnonzero(~half)[0] for half in (line[column::-1], line[column:]))
    width = (left + right - 1) * depth(lens, np.zeros(3)) / lens.matrix[0, 0]
    assert abs(body.trunk(waist).width - width) < 0.006


def test_a_tape_goes_straight_over_hollows():
    angle = np.linspace(0, 2 * np.pi, 400)
    hollow = 1 - 0.3 * np.exp(-(((angle - np.pi) / 0.3) ** 2))
    kidney = np.stack([2 * hollow * np.cos(angle), hollow * np.sin(angle)], 1)
    girth = girth_section(np.stack([2 * np.cos(angle), np.sin(angle)], 1))
    assert girth.width == pytest.approx(4, abs=1e-3)
    assert girth.depth == pytest.approx(2, abs=1e-3)
    assert girth.girth == pytest.approx(9.688, abs=5e-3)
    assert girth_section(kidney).girth < girth.girth


def test_an_arm_is_measured_alike_however_it_is_held(slim_woman):
    lifted, bent = (
        MeasuredPerson.of(person_in_stance(slim_woman, name)) for name in ("front", "joint")
    )
    for bone, at in (("humerus", 0.6), ("radius", 0.5)):
        a, b = (np.array(body.arm(bone, "l", at)) for body in (lifted, bent))
        assert np.abs(a - b).max() < 0.012


def test_the_person_is_separated_from_the_sheet(front, slim_woman):
    mask, truth = person_mask(front), true_person_mask(slim_woman, "front")
    assert (mask & truth).sum() / (mask | truth).sum() > 0.97


def test_a_shadow_on_the_sheet_is_no_part_of_the_person():
    image = painted()
    shadow = cv2.circle(np.ones(image.shape[:2], np.float32), (700, 500), 90, 0.75, -1)
    darker = (image * cv2.GaussianBlur(shadow, (0, 0), 9)[..., None]).astype(np.uint8)
    plain, shaded = person_mask(image), person_mask(darker)
    assert abs(plain.sum() / (np.pi * 150**2) - 1) < 0.02
    assert (plain ^ shaded).sum() < 0.01 * plain.sum()


def test_a_figure_of_the_sheets_own_chromaticity_is_seen_by_its_brightness():
    image = backdrop(np.random.default_rng(1))
    cv2.circle(image, (480, 400), 150, (30, 38, 24), -1)
    assert abs(person_mask(image).sum() / (np.pi * 150**2) - 1) < 0.02


def striped(image):
    for column in range(3):
        image[:, column::40] //= 2
    return image


def reaching_out(image):
    return cv2.rectangle(image, (400, 300), (SIZE[0], 330), (60, 60, 200), -1)


def noise(image):
    return np.random.default_rng(2).integers(0, 255, image.shape, np.uint8)


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        (striped, "the background is not uniform"),
        (noise, "the background is not uniform"),
        (lambda _: backdrop(np.random.default_rng(3)), "found nobody"),
        (reaching_out, "the person is cut off at the right side"),
    ],
)
def test_a_photograph_that_shows_no_person_before_a_sheet_is_refused(changed, says):
    """And drawn: as large as the image, with something in it."""
    image = changed(painted())
    with pytest.raises(PhotographError) as caught:
        person_mask(image)
    assert str(caught.value).startswith(says)
    assert caught.value.picture.shape == image.shape and caught.value.picture.std() > 1
