"""A person's own skeleton and surface of a model: node for node the generic one, as measured."""

from functools import cache

import cv2
import jax
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxmocap.body.kinematics import forward, landmarks
from jaxmocap.body.skeleton import LANDMARKS
from jaxmocap.body.subject import rest_joints
from jaxmocap.body.surfaces.loft import generic_surface
from jaxmocap.body.surfaces.surface import rest_nodes
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.recordings.recording import Recording
from jaxmocap.pipelines.silhouettes.person import with_model
from jaxmocap.silhouette.modelling.arm_joints import ArmPixels, lift_arms
from jaxmocap.silhouette.modelling.arm_surface import (
    ArmBones,
    arm_rings,
    arm_thickness,
    slice_positions,
    slice_stations,
    without_elbow_fold,
)
from jaxmocap.silhouette.modelling.person import PersonModel, arm_on_axis
from jaxmocap.silhouette.modelling.personal import arm_angles, personal_model
from jaxmocap.silhouette.modelling.pictures.views import PhotographView
from jaxmocap.silhouette.modelling.separation import FrontLandmarks
from jaxmocap.silhouette.modelling.slices import BodySlices, fitted_grid
from jaxmocap.silhouette.modelling.trunk import RINGS, Thighs, Trunk, find_thighs
from jaxmocap.synthetic.drawing_camera import look_at

PLACED, FRAMES = jax.jit(landmarks), jax.jit(forward)
PHI = 2 * np.pi * np.arange(48) / 48
# Half depth and half width of the trunk, and what an arm reaches ahead, back, out and in, metres.
DEEP, WIDE, ARM = 0.11, 0.16, (0.052, 0.034, 0.041, 0.037)
SHOULDER, LENGTHS = np.array([0.02, 0.17, 1.42]), np.array([0.3, 0.25, 0.18])
NOTHING = Thighs(np.zeros(0), np.zeros((0, 2, 2)), np.zeros((0, 2)))


def mirrored(points: np.ndarray) -> np.ndarray:
    return points * np.array([1.0, -1.0, 1.0])


def bones(upper: np.ndarray, lower: np.ndarray, side: int) -> ArmBones:
    """An arm along two directions; of the right side, mirrored."""
    ends = [SHOULDER]
    for way, length in zip((upper, lower, lower), LENGTHS, strict=True):
        ends.append(ends[-1] + length * way / np.linalg.norm(way))
    shoulder, elbow, wrist, tip = ends if side > 0 else map(mirrored, ends)
    return ArmBones(shoulder, elbow, wrist, tip)


def flat(arm: ArmBones) -> ArmBones:
    """In the plane x = 0."""
    return arm._replace(**{name: at * [0, 1, 1] for name, at in arm._asdict().items()})


def both(upper, lower) -> tuple[ArmBones, ...]:
    return tuple(bones(np.array(upper), np.array(lower), side) for side in (1, -1))


@cache
def somebody() -> PersonModel:
    """A person of one trunk's ellipse, and arms as thick everywhere."""
    levels = np.linspace(0.8, 1.72, RINGS)
    ring = np.stack([DEEP * np.cos(PHI), WIDE * np.sin(PHI)], 1)
    rings = np.concatenate(
        [np.tile(ring, (RINGS, 1, 1)), np.repeat(levels[:, None, None], 48, 1)], -1
    )
    middles = np.stack([np.zeros(RINGS), np.zeros(RINGS), levels], 1)
    pits = np.array([[0.0, WIDE, 1.33], [0.0, -WIDE, 1.33]])
    bend, hinge = (np.tile(pair, (len(slice_positions()), 1)) for pair in (ARM[:2], ARM[2:]))
    starts, nowhere = (SHOULDER, mirrored(SHOULDER)), np.zeros(2)
    return PersonModel(
        FrontLandmarks(0, 0, 0.0, np.zeros((2, 2)), 0, 0.0),
        Trunk(rings, middles, pits),
        (ArmPixels(nowhere, nowhere, nowhere, nowhere, nowhere, nowhere[None]),) * 2,
        both([0, 1, 0.0], [0, -0.2, 1]),
        both([0, 1, -0.1], [0, 1, -0.1]),
        both([0, 0.6, -1], [0, 0.6, -1]),
        tuple(arm_rings(bend, hinge, start, start[1], LENGTHS) for start in starts),
        NOTHING,
        {"front": np.zeros(3), "side": np.zeros(3), "joint": np.array([0.0, 0.03, 0.01])},
    )


def test_an_arm_is_the_same_wherever_the_person_stands():
    bend, hinge = (np.tile(pair, (len(slice_positions()), 1)) for pair in (ARM[:2], ARM[2:]))
    for side in (1, -1):
        start, moved = SHOULDER * [1, side, 1], np.array([1.0, 2.0, 0.0])
        here, there = (
            arm_rings(bend, hinge, at, start[1], LENGTHS) for at in (start, start + moved)
        )
        np.testing.assert_allclose(there, here + moved, atol=1e-12)


@pytest.fixture(scope="module")
def person():
    return personal_model(somebody())


def grid(person, name: str) -> np.ndarray:
    nodes = rest_nodes(person.surface, rest_joints(person.skeleton))
    patch = next(patch for patch in person.surface.patches if patch.name == name)
    return nodes[patch.nodes].reshape(patch.along, patch.around, 3)


def test_the_surface_is_the_generic_one_node_for_node(person):
    usual = generic_surface(person.skeleton)
    assert person.surface.patches == usual.patches
    np.testing.assert_array_equal(person.surface.points.bones, usual.points.bones)
    np.testing.assert_array_equal(person.surface.points.shares, usual.points.shares)
    assert np.isfinite(person.surface.points.points_bone).all()


def test_bones_are_as_long_as_the_models(person):
    tree, length = person.skeleton.tree, np.asarray(person.skeleton.lengths)
    for side in "lr":
        actual = [length[tree.bone(f"{bone}_{side}")] for bone in ("humerus", "radius", "hand")]
        np.testing.assert_allclose(actual, LENGTHS, atol=1e-5)
    joints = rest_joints(person.skeleton)
    across = joints[tree.bone("humerus_l")] - joints[tree.bone("humerus_r")]
    np.testing.assert_allclose(across, [0, 2 * SHOULDER[1], 0], atol=1e-5)


def test_a_hanging_arm_is_as_thick_as_the_stretched_one_was_and_the_same_way_round(person):
    ahead, back, out, in_ = ARM
    for side, sign in (("l", 1), ("r", -1)):
        shoulder = rest_joints(person.skeleton)[person.skeleton.tree.bone(f"humerus_{side}")]
        rings = grid(person, f"arm_{side}") - shoulder
        at = -rings[:, 0, 2] / LENGTHS[0]
        for ring in rings[(at > 0.4) & (at < 1.7)]:
            assert ring[:, 0].max() == pytest.approx(ahead, abs=2e-3)
            assert ring[:, 0].min() == pytest.approx(-back, abs=2e-3)
            assert (sign * ring[:, 1]).max() == pytest.approx(out, abs=2e-3)
            assert (sign * ring[:, 1]).min() == pytest.approx(-in_, abs=2e-3)
        # The fingertip is where it was measured.
        assert -rings[-1, 0, 2] == pytest.approx(LENGTHS.sum(), abs=1e-5)


def test_the_trunk_is_as_wide_and_deep_as_measured_up_to_the_vertex(person):
    torso = grid(person, "torso")
    chest = torso[(torso[:, 0, 2] > 0.02) & (np.arange(len(torso)) < len(torso) - 1)]
    np.testing.assert_allclose(np.ptp(chest[..., 0], 1), 2 * DEEP, atol=2e-3)
    np.testing.assert_allclose(np.ptp(chest[..., 1], 1), 2 * WIDE, atol=2e-3)
    pelvis = 0.8 + 0.0506 * somebody().stature
    assert torso[-1, 0, 2] == pytest.approx(1.72 - pelvis, abs=2e-3)


def test_thighs_are_as_they_were_seen_and_what_is_below_goes_over_into_the_usual_leg():
    heights = np.linspace(0.75, 0.58, 8)
    across = np.tile([[0.02, 0.2], [-0.2, -0.02]], (8, 1, 1))
    wide, plain = (
        personal_model(somebody()._replace(legs=legs))
        for legs in (Thighs(heights, across, np.tile([-0.1, 0.09], (8, 1))), NOTHING)
    )
    leg, usual = grid(wide, "leg_l"), grid(plain, "leg_l")
    pelvis = 0.8 + 0.0506 * somebody().stature
    measured = (leg[:, 0, 2] + pelvis < 0.74) & (leg[:, 0, 2] + pelvis > 0.6)
    assert measured.sum() >= 3
    np.testing.assert_allclose(np.ptp(leg[measured][..., 0], 1), 0.19, atol=3e-3)
    np.testing.assert_allclose(np.ptp(leg[measured][..., 1], 1), 0.18, atol=4e-3)
    assert np.ptp(leg[..., 1], 1)[1:-1].max() < 0.2
    ankles = np.ptp(leg[-3], 0)[1] / np.ptp(usual[-3], 0)[1]
    assert 0.9 < ankles < 1.3


def test_poses_put_the_arms_where_the_photographs_have_them(person):
    model = somebody()
    names = list(LANDMARKS)
    for photograph, arms in (("joint", model.bent), ("side", model.stretched)):
        points = np.asarray(PLACED(person.skeleton, person.poses[photograph]))
        points = points - model.shifts[photograph]
        for side, actual in zip("lr", arms, strict=True):
            for name in ("shoulder", "elbow", "wrist"):
                at = points[names.index(f"{name}_{side}")]
                np.testing.assert_allclose(at, getattr(actual, name), atol=2e-3)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("upper", [[0.0, 1.0, 0.0], [0.3, 0.8, -0.4], [0.0, 0.5, -1.0]])
def test_an_arms_angles_turn_its_bones_there(person, sign, upper):
    side = "l" if sign > 0 else "r"
    arm = bones(np.array(upper), np.array([0.5, -0.1, 1.0]), int(sign))
    angles = np.zeros(len(person.skeleton.tree.joints), np.float32)
    for joint, angle in arm_angles(arm, sign, straight=False).items():
        angles[person.skeleton.tree.joint(f"{joint}_{side}")] = angle
    R = np.asarray(FRAMES(person.skeleton, person.poses["side"]._replace(angles=angles))[1])
    for bone, near, far in (("humerus", 0, 1), ("radius", 1, 2)):
        down = R[person.skeleton.tree.bone(f"{bone}_{side}")] @ [0, 0, -1]
        way = arm[far] - arm[near]
        np.testing.assert_allclose(down, way / np.linalg.norm(way), atol=1e-5)


def test_a_bent_arms_stations_lie_on_its_bones_but_about_the_elbow():
    arm = both([0, 1, 0], [0, 0, 1])[0]
    points, across = slice_stations(arm, arm.shoulder + arm.wrist - 2 * arm.elbow)
    at = slice_positions()
    along = np.linalg.norm(points[at <= 0.6] - arm.shoulder, axis=1)
    np.testing.assert_allclose(along, LENGTHS[0] * at[at <= 0.6], atol=1e-9)
    np.testing.assert_allclose(across[at <= 0.6], [[0, 0, 1]] * (at <= 0.6).sum(), atol=1e-9)
    np.testing.assert_allclose(across[at >= 1.4], [[0, -1, 0]] * (at >= 1.4).sum(), atol=1e-9)
    halving = np.array([0, -1, 1]) / np.sqrt(2)
    np.testing.assert_allclose(across[np.argmin(np.abs(at - 1))], halving, atol=1e-9)


def test_a_round_arm_is_as_thick_bent_as_it_is_stretched():
    camera = look_at((8.0, 0.0, 1.4), (0.0, 0.4, 1.4), (720, 720), 3000.0, (0.0,) * 4)
    radius, actual = 0.04, []
    for lower in ([0, 1, 0], [0, -0.15, 1]):
        arm = flat(bones(np.array([0, 1, 0.0]), np.array(lower), 1))
        image = np.zeros((720, 720), np.uint8)
        view = PhotographView(image, camera)
        ends = np.rint(view.pixels(np.array(arm))).astype(int)
        cv2.polylines(image, [ends], False, 1, round(2 * radius * 3000 / 8))
        inner = arm.shoulder + arm.wrist - 2 * arm.elbow
        towards = inner if np.linalg.norm(inner) > 0.1 else np.array([0, 0, 1.0])
        actual.append(
            without_elbow_fold(
                arm_thickness(PhotographView(image.astype(bool), camera), arm, towards)
            )
        )
    about = (slice_positions() > 0.7) & (slice_positions() < 1.3)
    np.testing.assert_allclose(actual[0][about], radius, atol=2e-3)
    # Its flesh is not squeezed in the fold, as a person's is.
    np.testing.assert_allclose(actual[1][about].sum(1), 2 * radius, rtol=0.2)


def test_a_stretched_arms_bones_are_as_long_as_they_were_bent_though_its_flesh_hangs_lower():
    bent = both([0, 1, 0], [0, 0, 1])[0]
    side = np.arange(-0.1, 0.8, 0.001)[:, None] * [0.0, 1.0, 0.0]
    way = SHOULDER + side - np.array([0.0, 0.0, 0.06])
    actual = arm_on_axis(way, bent)
    np.testing.assert_allclose(actual.lengths[:2], LENGTHS[:2], atol=2e-3)
    np.testing.assert_allclose(actual.tip, way[-1])
    with pytest.raises(ValueError, match="shorter than its 55 cm"):
        arm_on_axis(way[:550], bent)


def test_beyond_what_was_measured_a_ring_keeps_its_ratio_until_it_fades():
    phi = 2 * np.pi * np.arange(16) / 16
    circle = np.stack([np.cos(phi), np.sin(phi)], 1)
    levels = np.linspace(1, 0, 11)
    rings = np.concatenate(
        [np.tile(0.05 * circle, (11, 1, 1)), np.repeat(levels[:, None, None], 16, 1)], -1
    )
    fine = 2 * np.pi * np.arange(64) / 64
    outline = 0.1 * np.stack([np.cos(fine), np.sin(fine)], 1) + [0.01, 0]
    measured = BodySlices(np.array([0.65, 0.35]), np.stack([outline] * 2), (np.inf, 0.2))
    actual = fitted_grid(rings, 1.0, measured)
    sizes = np.ptp(actual[..., 0], 1) / 2
    np.testing.assert_allclose(sizes[:7], 0.1, rtol=1e-3)
    np.testing.assert_allclose(actual[..., 0].mean(1)[:7], 0.01, atol=1e-6)
    assert 0.05 < sizes[7] < 0.1
    np.testing.assert_allclose(sizes[9:], 0.05, rtol=1e-9)
    np.testing.assert_array_equal(actual[..., 2], rings[..., 2])


def drawn(points: list[np.ndarray], azimuth: float) -> PhotographView:
    """Limbs of rectangles, seen from afar: (K, 2) corners (y, z) each for the front, in x = 0."""

    turn = np.radians(azimuth)
    camera = look_at((8 * np.cos(turn), 8 * np.sin(turn), 1.0), (0.0, 0.0, 1.0), (640, 480), 1500)
    view = PhotographView(np.zeros((480, 640), bool), camera)
    mask = np.zeros((480, 640), np.uint8)
    for corners in points:
        cv2.fillConvexPoly(mask, np.rint(view.pixels(corners)).astype(np.int32), 1)
    return PhotographView(mask.astype(bool), camera)


def test_lifted_arms_and_thighs_are_found_where_they_are_drawn():
    turn = Rotation.from_euler("x", 30, degrees=True)
    down = bones(turn.apply([0, 0, -1.0]), turn.apply([0, 0, -1.0]), 1)
    down = flat(down)
    across = turn.apply([0, 0.04, 0])
    arm = np.array([down.shoulder + across, down.shoulder - across,
                    down.tip - across, down.tip + across])  # fmt: skip
    trunk = np.array([[0, -0.13, 1.45], [0, 0.13, 1.45], [0, 0.13, 0.9], [0, -0.13, 0.9]])
    leg = np.array([[0, 0.02, 1.0], [0, 0.13, 1.0], [0, 0.15, 0.5], [0, 0.04, 0.5]])
    front = drawn([trunk, leg, mirrored(leg), arm, mirrored(arm)], 0.0)
    side = drawn([np.array([[-0.08, 0, 1.5], [0.1, 0, 1.5], [0.1, 0, 0.4], [-0.08, 0, 0.4]])], 90.0)
    pit = front.pixels(np.array([[0.0, 0.135, 1.28], [0.0, -0.135, 1.28]]))
    bottom = front.pixels(np.array([0.0, 0.0, 0.9]))
    marks = FrontLandmarks(0, 0, 0.0, pit, round(bottom[1]), float(bottom[0]))
    bent = (down, down._replace(**{k: mirrored(v) for k, v in down._asdict().items()}))
    for actual, true in zip(lift_arms(front, marks, bent), bent, strict=True):
        for name in ("elbow", "wrist"):
            np.testing.assert_allclose(getattr(actual, name), getattr(true, name), atol=0.012)
    thighs = find_thighs(front, side, marks, np.array([0.0, 0.0, 1.0]))
    assert len(thighs.heights) >= 4
    inner = 0.02 + 0.02 * (1.0 - thighs.heights) / 0.5
    for k, sign in ((0, 1), (1, -1)):
        edges = np.sort(sign * thighs.across[:, k], 1)
        np.testing.assert_allclose(edges[:, 0], inner, atol=0.006)
        np.testing.assert_allclose(edges[:, 1], inner + 0.11, atol=0.006)
    np.testing.assert_allclose(
        thighs.deep, np.tile([-0.08, 0.1], (len(thighs.deep), 1)), atol=0.006
    )


def test_without_a_model_a_recording_stays_as_it_is():
    recording = object()
    assert with_model(recording, None) == (recording, None)  # type: ignore[arg-type]


@pytest.mark.parametrize("names", [(), ("subject.toml",)])
def test_a_folder_without_a_model_is_refused_in_one_sentence(tmp_path, names):
    for name in names:
        (tmp_path / name).write_text("height = 1.7\n")
    missing = "surface.npz" if names else "subject.toml"
    with pytest.raises(InputError, match=f"found no {missing}, expected what 'silhouette model'"):
        with_model(Recording.load, tmp_path)  # type: ignore[arg-type]


def test_a_height_tells_how_long_the_legs_are():
    short, tall = (personal_model(somebody(), height).skeleton for height in (1.7, 1.8))
    grown = np.asarray(tall.lengths - short.lengths)
    of_leg = np.array([bone.startswith(("femur", "tibia")) for bone in short.tree.bones])
    # Ankles are the rest of ten centimetres.
    assert 0.16 < grown[of_leg].sum() < 0.2
    np.testing.assert_allclose(grown[~of_leg], 0, atol=1e-6)


def test_a_height_that_suits_no_such_trunk_is_refused():
    with pytest.raises(ValueError, match=r"found a height of 3 m, expected 1\.\d\d to 2\.\d\d m"):
        personal_model(somebody(), 3.0)
