"""A person's own model from four silhouettes: skeletons, corners, joints, slices, surfaces."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from photograph_masks import true_person_mask
from scipy.spatial import Delaunay

from bench.modelling import MeasuredPerson
from jaxmocap.geometry.cameras import project
from jaxmocap.silhouette.modelling.arm_joints import evenly_spaced, turning_angles
from jaxmocap.silhouette.modelling.arm_surface import INNER_RINGS, SLICES
from jaxmocap.silhouette.modelling.measurements import girth_section
from jaxmocap.silhouette.modelling.person import StanceError, person_model
from jaxmocap.silhouette.modelling.pictures.drawing import closed_mesh, joined_meshes
from jaxmocap.silhouette.modelling.pictures.medial_axis import medial_axis, path, rim_distance
from jaxmocap.silhouette.modelling.pictures.views import PhotographView
from jaxmocap.silhouette.modelling.readings import PAPER, spline_ring, superellipse_ring
from jaxmocap.silhouette.modelling.separation import find_landmarks
from jaxmocap.synthetic.people.rigged_mesh import load_rig
from jaxmocap.synthetic.photographs import PHOTOGRAPHS, camera_of, person_in_stance


def blank():
    return np.zeros((400, 500), np.uint8)


def figure(arms_out=90):
    """A figure of plain shapes: head, neck, trunk, legs apart, arms lifted off the trunk."""
    image = blank()
    cv2.circle(image, (250, 60), 35, 1, -1)
    cv2.rectangle(image, (232, 80), (268, 130), 1, -1)
    cv2.rectangle(image, (190, 120), (310, 300), 1, -1)
    for side in (-1, 1):
        hand = (250 + side * (60 + arms_out), 260)
        cv2.line(image, (250 + side * 50, 135), hand, 1, 25)
        cv2.line(image, (250 + side * 35, 280), (250 + side * 60, 420), 1, 45)
    return image.astype(bool)


def test_the_axis_of_a_bar_runs_along_its_middle():
    image = blank()
    cv2.rectangle(image, (50, 100), (450, 140), 1, -1)
    actual = medial_axis(image.astype(bool))
    inner = (actual.pixels_xy[:, 0] > 80) & (actual.pixels_xy[:, 0] < 420)
    assert np.abs(actual.pixels_xy[inner, 1] - 120).max() <= 1
    assert np.abs(actual.radii[inner] - 20.5).max() < 1.5


def test_a_broken_axis_is_closed_so_that_a_way_leads_everywhere():
    image = blank()
    for left in (50, 180, 310):
        cv2.rectangle(image, (left, 100), (left + 100, 130), 1, -1)
    actual = medial_axis(image.astype(bool))
    way = actual.pixels_xy[path(actual, np.array([60, 115]), np.array([400, 115]))]
    assert way[0, 0] < 80 and way[-1, 0] > 380
    gaps = np.linalg.norm(np.diff(way, axis=0), axis=1)
    assert np.sum(gaps > 10) == 2


def test_beyond_the_lower_edge_a_person_goes_on():
    image = blank()
    image[200:, 200:300] = 1
    assert rim_distance(image.astype(bool))[-1, 250] > 45


@given(angle=st.floats(25, 155), at=st.integers(60, 140))
def test_the_sharpest_corner_is_where_two_lines_meet(angle, at):
    turn = np.deg2rad(angle)
    corner = np.array([float(at), 0.0])
    far = corner + 120 * np.array([np.cos(turn), np.sin(turn)])
    turned = turning_angles(evenly_spaced(np.array([[0.0, 0.0], corner, far])), 20)
    assert abs(int(np.argmax(turned)) - at) <= 1
    assert np.degrees(turned.max()) == pytest.approx(angle, abs=4)


def test_a_figure_is_separated_at_pits_neck_and_crotch():
    actual = find_landmarks(figure())
    assert 80 < actual.neck < 120 and actual.neck_x == pytest.approx(250, abs=1)
    assert np.abs(actual.pits[:, 0] - [310, 190]).max() < 4
    assert np.ptp(actual.pits[:, 1]) <= 2 and 150 < actual.pits[0, 1] < 190
    assert actual.top == 25 and 290 < actual.bottom < 330
    assert find_landmarks(figure(), bottom=280).bottom == 280


def test_arms_against_the_body_are_refused():
    with pytest.raises(ValueError, match="no gap between the left arm and the trunk"):
        find_landmarks(figure(arms_out=-10))


def test_closed_legs_are_refused_unless_the_bottom_line_is_given():
    image = figure()
    image[300:, 190:310] = True
    with pytest.raises(ValueError, match="no gap between the legs"):
        find_landmarks(image)
    assert find_landmarks(image, bottom=290).bottom == 290
    with pytest.raises(ValueError, match=r"found row \d+ as the trunk's bottom line, expected one"):
        find_landmarks(image, bottom=len(image))


@given(
    half=st.tuples(st.floats(0.05, 0.3), st.floats(0.05, 0.3)),
    fullness=st.floats(1.8, 3.2),
    lean=st.floats(-0.02, 0.02),
)
def test_a_slice_touches_the_four_lines_that_it_is_seen_by(half, fullness, lean):
    x, y = half
    corners = np.array([[x, y], [-x, y + lean], [-x, -y + lean], [x, -y]])
    outline = superellipse_ring(corners, fullness, 240)
    assert outline[:, 0].max() == pytest.approx(x, rel=0.02)
    assert outline[:, 0].min() == pytest.approx(-x, rel=0.02)
    slope = outline[:, 1] - lean / 2 * (1 - outline[:, 0] / x)
    assert slope.max() == pytest.approx(y, rel=0.02)


def test_four_control_points_make_a_slice_that_touches_all_sides_in_their_middles():
    corners = np.array([[0.12, 0.2], [-0.1, 0.21], [-0.11, -0.19], [0.13, -0.2]])
    outline = spline_ring(corners, 48)
    middles = (corners + np.roll(corners, 1, 0)) / 2
    np.testing.assert_allclose(outline[::12], middles, atol=1e-12)
    # De Boor's recursion a third of the way from one middle to the next.
    first = (np.roll(corners, 1, 0) + 2 * corners) / 3
    second = (5 * corners + np.roll(corners, -1, 0)) / 6
    np.testing.assert_allclose(outline[4::12], (2 * first + second) / 3, atol=1e-12)


def test_a_full_slice_is_longer_around_than_an_ellipse():
    corners = np.array([[1.0, 2.0], [-1.0, 2.0], [-1.0, -2.0], [1.0, -2.0]])
    girths = [
        girth_section(superellipse_ring(corners, fullness, 400)).girth for fullness in (2.0, 3.0)
    ]
    assert girths[0] == pytest.approx(9.688, rel=5e-3)
    assert girths[0] < 0.96 * girths[1] < 0.96 * 12


def test_rings_become_a_watertight_mesh_of_the_right_volume():
    angle = 2 * np.pi * np.arange(60) / 60
    rings = np.stack(
        [np.stack([np.cos(angle), np.sin(angle), np.full(60, z)], 1) for z in np.linspace(0, 3, 7)]
    )
    for patch in (rings, rings[:, ::-1]):
        mesh = trimesh.Trimesh(*closed_mesh(patch), process=False)
        assert mesh.is_watertight and mesh.is_winding_consistent
        assert mesh.volume == pytest.approx(3 * np.pi, rel=0.01)


def true_views(rig) -> dict[str, PhotographView]:
    """A person's true silhouettes in all photographs."""
    masks = {name: true_person_mask(rig, name) for name in PHOTOGRAPHS}
    return {name: PhotographView(mask, camera_of(rig, name)) for name, mask in masks.items()}


@pytest.fixture(scope="module", params=["short_woman", "broad_man"])
def subject(request, recordings):
    """A person as they stand, and their model from true silhouettes."""
    rig = load_rig(recordings / "person" / "person.npz", request.param)
    views = true_views(rig)
    return rig, views, person_model(views)


def test_a_view_in_numpy_is_the_camera(subject):
    rig, views, _ = subject
    points = person_in_stance(rig, "front").vertices(np.zeros(1))[0][::500]
    pixels = views["side"].pixels(points)
    assert np.abs(pixels - np.asarray(project(views["side"].camera, points))).max() < 1e-3
    back = views["front"].plane_points(pixels, np.array([0.2, 0.0, 0.0]))
    np.testing.assert_allclose(back[:, 0], 0.2, atol=1e-9)
    assert np.abs(views["front"].pixels(back) - pixels).max() < 1e-3


def test_joints_lie_where_they_are(subject):
    rig, _, model = subject
    truth = MeasuredPerson.of(person_in_stance(rig, "joint")).landmarks()
    for bones, side in zip(model.bent, "lr", strict=True):
        for name in ("shoulder", "elbow", "wrist"):
            assert np.linalg.norm(getattr(bones, name) - truth[f"{name}_{side}"]) < 0.015


def test_hands_reach_to_the_longest_fingers_tip(subject):
    rig, _, model = subject
    body = MeasuredPerson.of(person_in_stance(rig, "joint"))
    at = body.landmarks()
    for bones, side in zip(model.bent, "lr", strict=True):
        wrist = at[f"wrist_{side}"]
        ahead = wrist - at[f"elbow_{side}"]
        beyond = (body.vertices - wrist) @ ahead / np.linalg.norm(ahead)
        hand = beyond[np.linalg.norm(body.vertices - wrist, axis=1) < 0.3].max()
        reached = (bones.tip - wrist) @ ahead / np.linalg.norm(ahead)
        # The axis ends within the fingertip.
        assert 0 < hand - reached < 0.01


@pytest.mark.parametrize("aside", [25, -25])
def test_who_stands_aside_for_the_arms_is_no_taller(subject, aside):
    _, views, model = subject
    moved = dict(views)
    for name in ("joint", "arm_side"):
        moved[name] = replace(views[name], mask=np.roll(views[name].mask, aside, 1))
    again = person_model(moved)
    assert again.shifts["joint"][1] * aside > 0.03 * abs(aside)
    assert abs(again.shifts["joint"][2] - model.shifts["joint"][2]) < 0.003
    for ours, theirs in zip(again.bent, model.bent, strict=True):
        assert abs(ours.shoulder[2] - theirs.shoulder[2]) < 0.004


def test_the_paper_s_elbow_is_half_way_between_the_axis_corner_and_the_rim(subject):
    _, views, own = subject
    paper = person_model(views, reading=PAPER)
    covered = views["joint"].mask
    for arm, ours in zip(paper.arm_pixels, own.arm_pixels, strict=True):
        away = arm.elbow - arm.corner
        for share, inside in ((1.85, True), (2.15, False)):
            column, row = np.rint(arm.corner + share * away).astype(int)
            assert covered[row, column] == inside
        assert np.linalg.norm(away) > 1.5 * np.linalg.norm(ours.elbow - ours.corner)
    ring, other = (model.trunk.rings[20][:, :2] for model in (paper, own))
    np.testing.assert_allclose(np.ptp(ring, axis=0), np.ptp(other, axis=0), rtol=0.02)
    assert np.abs(paper.trunk.rings - own.trunk.rings).max() > 0.002


def test_bones_are_as_long_as_they_are(subject):
    rig, _, model = subject
    truth, lengths = MeasuredPerson.of(person_in_stance(rig, "front")).landmarks(), model.lengths()
    off = [
        lengths[f"{bone}_{side}"] - np.linalg.norm(truth[f"{near}_{side}"] - truth[f"{far}_{side}"])
        for bone, near, far in (("humerus", "shoulder", "elbow"), ("radius", "elbow", "wrist"))
        for side in "lr"
    ]
    assert np.mean(np.abs(off)) < 0.012 and np.abs(off).max() < 0.02


def check_sizes(pairs) -> None:
    """Pairs of sections as they are found and as they are: metres of width and depth, and girth."""
    off = np.abs(
        [
            (found.width - true.width, found.depth - true.depth, found.girth / true.girth - 1)
            for found, true in pairs
        ]
    )
    assert off[:, :2].mean() < 0.01 and off[:, :2].max() < 0.02
    assert off[:, 2].mean() < 0.03 and off[:, 2].max() < 0.06


def test_the_trunk_is_as_wide_deep_and_stout_as_it_is(subject):
    rig, _, model = subject
    body, rings = MeasuredPerson.of(person_in_stance(rig, "front")), model.trunk.rings
    levels = rings[:, 0, 2]
    low, pits = levels[0], model.trunk.pits[:, 2].mean()
    shares = np.linspace(0.1, 0.9, 7)
    at = [int(np.argmin(np.abs(levels - low - share * (pits - low)))) for share in shares]
    check_sizes([(girth_section(rings[k][:, [1, 0]]), body.trunk(levels[k])) for k in at])


def test_arms_are_as_thick_as_they_are(subject):
    rig, _, model = subject
    body, pairs = MeasuredPerson.of(person_in_stance(rig, "front")), []
    for rings, side in zip(model.arms, "lr", strict=True):
        for bone, first in (("humerus", 0), ("radius", SLICES[0])):
            for share in (0.375, 0.5, 0.75):
                k = INNER_RINGS + first + round(share * SLICES[0])
                pairs.append((girth_section(rings[k][:, [2, 0]]), body.arm(bone, side, share)))
    check_sizes(pairs)


def test_every_patch_of_the_surface_is_watertight_and_arms_begin_within_the_trunk(subject):
    _, _, model = subject
    patches = [model.trunk.rings, *model.arms]
    parts = trimesh.Trimesh(*joined_meshes(patches), process=False).split()
    assert len(parts) == 3 and all(part.is_watertight and part.volume > 0 for part in parts)
    for arm in model.arms:
        level = np.argmin(np.abs(model.trunk.rings[:, 0, 2] - arm[0, :, 2].mean()))
        slice_ = Delaunay(model.trunk.rings[level][:, :2])
        assert (slice_.find_simplex(arm[0][:, :2]) >= 0).all()


def test_a_view_of_another_stance_is_refused_by_its_name(recordings):
    views = true_views(load_rig(recordings / "person" / "person.npz", "slim_woman"))
    for name, other in (("front", "joint"), ("joint", "arm_side"), ("arm_side", "joint")):
        with pytest.raises(StanceError) as caught:
            person_model(views | {name: views[other]})
        assert caught.value.view == name
