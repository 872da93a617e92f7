"""The body's surface: generic, lofted around any skeleton; smoother, denser, kept in a file."""

import cv2
import jax
import numpy as np
import pytest
from conftest import RECORDINGS, complaint

from jaxmocap.body.kinematics import forward
from jaxmocap.body.model_files import bodies
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import LANDMARKS, Skeleton, with_joints
from jaxmocap.body.subject import rest_joints, scale_to_landmarks
from jaxmocap.body.surfaces.loft import generic_surface, lofted_parts, stature_of
from jaxmocap.body.surfaces.pieces import body_pieces
from jaxmocap.body.surfaces.surface import (
    Surface,
    low_pass,
    pose_points,
    resample_surface,
    rest_nodes,
)
from jaxmocap.cli.silhouette.track import BODIES
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.recordings.surface import load_surface, save_surface
from jaxmocap.geometry.fourier import cosine_matrix, fourier_matrix, linear_matrix
from jaxmocap.silhouette.first_pose import landmark_points, pose_at_landmarks, standing_pose_at
from jaxmocap.silhouette.recovery.limbs import limb_chains
from jaxmocap.silhouette.surfaces.body_shape import (
    determined_landmarks,
    moved_bones,
    surface_of_body,
)
from jaxmocap.synthetic.people.rigged_mesh import RIG_LANDMARKS

PEOPLE = RECORDINGS / "person" / "person.npz"
FORWARD, POSED = jax.jit(forward), jax.jit(pose_points)
TALL = with_joints(Skeleton.human(1.8), "whole.toml")


@pytest.fixture(scope="module")
def surface() -> Surface:
    return generic_surface(TALL)


def posed_by(skeleton, surface, degrees: dict[str, float]) -> np.ndarray:
    angles = np.zeros(len(skeleton.tree.joints), np.float32)
    for name, angle in degrees.items():
        angles[skeleton.tree.joint(name)] = np.radians(angle)
    still = np.zeros(3, np.float32), np.eye(4, dtype=np.float32)[0]
    pose: list = [*still, angles]
    return np.asarray(POSED(FORWARD(skeleton, Pose(*pose)), surface.points))


def grid(surface, nodes, name) -> np.ndarray:
    patch = next(patch for patch in surface.patches if patch.name == name)
    return nodes[patch.nodes].reshape(patch.along, patch.around, 3)


def test_nodes_at_rest_are_where_the_bones_carry_them(surface):
    rest = rest_nodes(surface, rest_joints(TALL))
    np.testing.assert_allclose(posed_by(TALL, surface, {}), rest, atol=1e-5)
    np.testing.assert_allclose(np.sum(surface.points.shares, 1), 1, atol=1e-6)


def test_the_patches_are_the_papers_with_about_as_many_knots(surface):
    assert [patch.name for patch in surface.patches] == [limb.name for limb in lofted_parts()]
    assert {"torso", "arm_l", "arm_r", "leg_l", "leg_r"} < {p.name for p in surface.patches}
    assert len(surface.patch_of()) == surface.patches[-1].nodes.stop == len(surface.points.bones)
    assert 3000 < len(surface.points.bones) < 4000


def test_a_person_is_as_tall_as_the_skeleton_says_wider_than_deep_and_symmetric(surface):
    nodes = posed_by(TALL, surface, {})
    assert stature_of(TALL) == pytest.approx(1.8, abs=0.01)
    height = np.ptp(nodes[:, 2])
    assert height == pytest.approx(1.8, abs=0.04)
    torso = grid(surface, nodes, "torso")
    belly = torso[np.abs(torso[:, :, 2].mean(1) - 0.15).argmin()]
    assert 1.2 < np.ptp(belly[:, 1]) / np.ptp(belly[:, 0]) < 1.8
    for limb in ("arm", "leg", "foot"):
        left, right = (grid(surface, nodes, f"{limb}_{side}") for side in "lr")
        np.testing.assert_allclose(left * [1, -1, 1], right, atol=1e-5)


def joint_list(tree, bones):
    """The joints that move a node which these bones carry, root first: J(phi1, phi2) of 3.2."""
    moving = {bone for each in bones for bone in tree.chain(tree.bones[each])}
    return tuple(
        name for name, bone in zip(tree.joints, tree.dof_bones, strict=True) if bone in moving
    )


def test_a_node_of_the_hand_has_the_arms_joints_in_order(surface):
    patch = surface.patches[1]
    bones = np.asarray(surface.points.bones)[patch.nodes][-1]
    names = [name for name in joint_list(TALL.tree, bones) if "back" not in name]
    assert set(names) == {
        *("clavicle_raise_l", "clavicle_protract_l", "arm_flex_l", "arm_abduct_l"),
        *("arm_rot_l", "elbow_flex_l", "elbow_twist_l"),
    }
    assert joint_list(TALL.tree, np.array([TALL.tree.bone("head")])) == ("back_flexion",)


def test_the_elbows_skin_neither_tears_nor_folds_into_nothing(surface):
    """Rings stay in order and keep their girth when the elbow bends by 90 degrees."""
    straight, bent = (
        grid(surface, posed_by(TALL, surface, {"elbow_flex_l": angle}), "arm_l")
        for angle in (0, 90)
    )
    gaps = np.linalg.norm(np.diff(bent, axis=0), axis=-1)
    assert gaps.max() < 2.5 * np.linalg.norm(np.diff(straight, axis=0), axis=-1).max()
    round_before, round_after = (
        np.linalg.norm(np.roll(each, 1, 1) - each, axis=-1).sum(1)[1:-1]
        for each in (straight, bent)
    )
    assert np.all(round_after > 0.6 * round_before)
    assert np.all(round_after < 1.6 * round_before)


def test_a_raised_shoulder_takes_the_chest_beside_it_along_and_leaves_the_head(surface):
    before, after = (posed_by(TALL, surface, {"clavicle_raise_l": angle}) for angle in (0, 20))
    moved = np.linalg.norm(after - before, axis=1)
    torso = surface.patches[0].nodes
    assert 0.01 < moved[torso].max() < 0.1
    assert np.all(moved[torso][before[torso][:, 1] <= 0] < 1e-5)
    assert moved[surface.patches[1].nodes].max() > 0.04


def test_girth_widens_trunk_and_limbs_and_hardly_the_head():
    thin, stout = (posed_by(TALL, generic_surface(TALL, girth), {}) for girth in (1.0, 1.2))
    surface = generic_surface(TALL)
    ratio = {}
    for part, rows in (("belly", slice(8, 12)), ("skull", slice(-6, -2))):
        wide = [np.ptp(grid(surface, each, "torso")[rows, :, 1], axis=1) for each in (thin, stout)]
        ratio[part] = np.mean(wide[1] / wide[0])
    assert 1.1 < ratio["belly"] < 1.5
    assert 0.98 < ratio["skull"] < 1.05


def test_a_denser_surface_is_the_same_surface(surface):
    joints = rest_joints(TALL)
    dense = resample_surface(surface, joints, 0.012)
    nodes, coarse = rest_nodes(dense, joints), rest_nodes(surface, joints)
    for patch in dense.patches:
        grid_ = grid(dense, nodes, patch.name)
        assert np.linalg.norm(np.roll(grid_, 1, 1) - grid_, axis=-1).max() < 0.024
        assert np.linalg.norm(np.diff(grid_, axis=0), axis=-1).max() < 0.024
    # Every old node lies by a new one.
    for node in coarse[:: len(coarse) // 40]:
        assert np.linalg.norm(nodes - node, axis=1).min() < 0.012


def test_a_low_pass_keeps_the_coarse_shape_and_drops_the_fine(surface):
    joints = rest_joints(TALL)
    rest = rest_nodes(surface, joints)
    coarse = rest_nodes(low_pass(surface, joints, harmonics=1, along=6), joints)
    all_of_it = rest_nodes(low_pass(surface, joints, harmonics=16, along=80), joints)
    np.testing.assert_allclose(all_of_it, rest, atol=1e-6)
    # With one harmonic around every ring is an ellipse about the same centre.
    rings = grid(surface, coarse, "torso")
    waves = np.abs(np.fft.fft(rings, axis=1))
    assert waves[:, 2:-1].max() < 1e-6
    assert 0.002 < np.linalg.norm(coarse - rest, axis=1).mean() < 0.03


def test_matrices_filter_as_numpys_transforms_do():
    rng = np.random.default_rng(0)
    for count in (9, 12):
        signal = rng.normal(size=count)
        spectrum = np.fft.fft(signal)
        kept = np.where(np.abs(np.fft.fftfreq(count, 1 / count)) <= 3, spectrum, 0)
        smooth = fourier_matrix(count, np.arange(count), 3) @ signal
        np.testing.assert_allclose(smooth, np.fft.ifft(kept).real, atol=1e-12)
        np.testing.assert_allclose(
            fourier_matrix(count, np.arange(count)), np.eye(count), atol=1e-12
        )
    ramp = np.arange(5.0)
    np.testing.assert_allclose(linear_matrix(5, np.array([0, 1.25, 4.0])) @ ramp, [0, 1.25, 4])
    np.testing.assert_allclose(linear_matrix(5, np.array([4.5]), True) @ ramp, [2.0])
    np.testing.assert_allclose(cosine_matrix(5, 0) @ ramp, np.full(5, 2.0))


def test_a_surface_comes_back_from_its_file(surface, tmp_path):
    save_surface(tmp_path / "skin.npz", surface, TALL.tree)
    again = load_surface(tmp_path / "skin.npz", TALL.tree)
    assert again.patches == surface.patches
    for mine, theirs in zip(again.points, surface.points, strict=True):
        np.testing.assert_array_equal(mine, theirs)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"bone_names": None}, "the array 'bone_names' is missing"),
        ({"shares": np.ones((7, 2))}, "shares"),
        ({"patch_sizes": np.array([[2, 3]] * 7)}, "expected 42 nodes by patch_sizes"),
        ({"bone_names": np.array(["tail"] * 21)}, "unknown bone 'tail'"),
        ({"patch_names": np.array(["tail"] * 7)}, "unknown patch 'tail'"),
        ({"bone_names": np.array(["head"])}, "expected an index below 1"),
        ({"points_bone": np.full((3576, 2, 3), np.nan)}, "found nan, expected numbers from -3"),
    ],
)
def test_bad_surface_files_are_refused_in_one_sentence(surface, tmp_path, change, message):
    save_surface(tmp_path / "skin.npz", surface, TALL.tree)
    with np.load(tmp_path / "skin.npz") as data:
        arrays = {name: data[name] for name in data} | change
    np.savez(tmp_path / "bad.npz", **{k: v for k, v in arrays.items() if v is not None})
    with pytest.raises(InputError, match=message):
        load_surface(tmp_path / "bad.npz", TALL.tree)
    assert "no such file" in complaint(load_surface, tmp_path / "none.npz", TALL.tree)


@pytest.mark.parametrize("who", ["man", "short_woman"])
def test_an_independent_persons_silhouette_is_covered_by_the_generic_one(who):
    """Legs and trunk, which stand alike at rest; arms are posed by their joints elsewhere."""
    if not PEOPLE.is_file():
        pytest.skip("the rigged people are not here (shared/recordings/person beside the checkout)")
    with np.load(PEOPLE) as data:
        i = data["people"].tolist().index(who)
        turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
        vertices = data["vertices"][i] @ turn.T
        names, joints = data["joint_names"].tolist(), data["joints"][i] @ turn.T
        quads = data["quads"]
    at = {name: joints[names.index(rig)][None] for name, rig in RIG_LANDMARKS.items()}
    at["neck"] = (at["shoulder_l"] + at["shoulder_r"]) / 2
    at["neck"] = at["neck"] + 0.5 * (joints[names.index("Neck")] - at["neck"])
    crown = np.append(joints[names.index("Head"), :2], vertices[:, 2].max())
    skeleton = scale_to_landmarks(Skeleton.human(), at | {"vertex": crown[None]})
    skeleton = with_joints(skeleton, "whole.toml")
    surface = generic_surface(skeleton)
    spread = {f"hip_abduction_{side}": 6.0 for side in "lr"}
    bent = {f"hip_flexion_{s}": 6.0 for s in "lr"} | {f"knee_flexion_{s}": 6.0 for s in "lr"}
    nodes = posed_by(skeleton, surface, spread | bent)
    pelvis = (at["hip_l"] + at["hip_r"])[0] / 2
    shares = []
    for way in ([0.0, 1, 0], [-0.7071, 0.7071, 0]):
        ours, theirs = (_below_chest(*each, np.array(way)) for each in (
            (nodes, _faces(surface)), (vertices - pelvis, quads)
        ))  # fmt: skip
        shares.append((ours & theirs).sum() / (ours | theirs).sum())
    assert min(shares) > 0.8


def _faces(surface) -> np.ndarray:
    faces = []
    for patch in surface.patches:
        if not patch.name.startswith("arm"):
            v, u = np.meshgrid(np.arange(patch.along - 1), np.arange(patch.around), indexing="ij")
            near, far = patch.start + v * patch.around, patch.start + (v + 1) * patch.around
            beside = (u + 1) % patch.around
            corners = np.stack([near + u, near + beside, far + beside, far + u], -1)
            faces.append(corners.reshape(-1, 4))
    return np.concatenate(faces)


def _below_chest(nodes, faces, across) -> np.ndarray:
    """A silhouette, 5 mm to a pixel, of what lies below the shoulders and inside of the arms."""
    inside = (np.abs(nodes[:, 1]) < 0.25) & (nodes[:, 2] < 0.15)
    pixels = np.stack([nodes @ across, -nodes[:, 2]], 1) / 0.005 + [120, 100]
    mask = np.zeros((320, 240), np.uint8)
    for face in faces[inside[faces].all(1)]:
        cv2.fillConvexPoly(mask, np.round(pixels[face] * 16).astype(np.int32), 1, shift=4)
    return mask.astype(bool)


def test_the_pieces_of_a_body_are_closed_and_meet_in_a_ball_about_each_joint():
    """Together they are the surface; what a bent joint shows is the round end of either."""
    pieces = body_pieces(TALL)
    joints, tree = rest_joints(TALL), TALL.tree
    bare = {bone for bone in tree.bones if bone.startswith(("clavicle", "hip"))}
    assert set(pieces) == set(tree.bones) - bare
    volume = 0.0
    for solid in pieces.values():
        corners = solid.vertices[solid.triangles]
        volume += np.linalg.det(corners).sum() / 6
        outward = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        shading = solid.normals[solid.triangles].mean(1)
        assert np.mean(np.sum(outward * shading, 1) >= -1e-12) > 0.99
    # Cubic metres; caps lie within the next piece.
    assert 0.07 < volume < 0.15
    for near, far in (("humerus_l", "radius_l"), ("femur_r", "tibia_r")):
        for bone in (near, far):
            joint = joints[tree.bone(far)] - joints[tree.bone(bone)]
            apart = np.linalg.norm(pieces[bone].vertices - joint, axis=1).min()
            assert 0.02 < apart < 0.09


# Parts --------------------------------------------------------------------------------------------


HUMAN = Skeleton.human(1.75)
SURFACE = generic_surface(HUMAN)
PATCHES = [patch.name for patch in SURFACE.patches]
ARMS, LEGS = {"arm_l", "arm_r"}, {"leg_l", "leg_r"}


def body(name: str) -> tuple[Skeleton, Surface]:
    skeleton = with_joints(HUMAN, f"{name}.toml")
    return skeleton, surface_of_body(SURFACE, skeleton, f"{name}.toml")


def test_the_options_bodies_are_those_that_there_are():
    assert {f"{name}.toml" for name in BODIES} == set(bodies())


@pytest.mark.parametrize(
    ("name", "patches", "limbs"),
    [
        ("torso", ["torso", "arm_l", "arm_r"], ARMS),
        ("legs", ["torso", "leg_l", "leg_r", "foot_l", "foot_r"], LEGS),
        *((name, PATCHES, ARMS | LEGS) for name in ("whole", "supple", "human")),
    ],
)
def test_a_body_has_the_papers_patches_and_searches_the_limbs_that_it_moves(name, patches, limbs):
    skeleton, surface = body(name)
    assert [patch.name for patch in surface.patches] == patches
    chains = limb_chains(skeleton, surface)
    assert set(chains) == limbs
    assert all(0.01 < radius < 0.12 for chain in chains.values() for radius in chain.radii)


@pytest.mark.parametrize("name", BODIES)
def test_no_node_lies_on_a_bone_that_stays(name):
    """But where the hip's skin begins to go over into the trunk."""
    skeleton, surface = body(name)
    moved = moved_bones(skeleton.tree)[surface.points.bones]
    assert np.sum(np.asarray(surface.points.shares) * moved, 1).min() > 0.5


def test_the_hip_is_the_torsos_lower_end_closed_at_the_waist():
    skeleton, surface = body("legs")
    joints = rest_joints(skeleton)
    hip, torso = surface.patches[0], SURFACE.patches[0]
    rings = hip.grid(rest_nodes(surface, joints))
    of_torso = torso.grid(rest_nodes(SURFACE, joints))
    np.testing.assert_allclose(rings[:-1], of_torso[: hip.along - 1], atol=1e-6)
    np.testing.assert_allclose(np.ptp(rings[-1], 0), 0, atol=1e-6)
    spine2 = joints[skeleton.tree.bone("spine2"), 2]
    assert abs(rings[-1, 0, 2] - spine2) < 0.05


def test_a_torso_begins_where_its_own_landmarks_are_however_the_legs_stand():
    skeleton = with_joints(HUMAN, "torso.toml")
    points = np.asarray(landmark_points(skeleton, standing_pose_at(skeleton, 0.3, 0.1, 0.5)), float)
    own = determined_landmarks(skeleton.tree)
    assert [LANDMARKS[i] for i in np.flatnonzero(~own)] == [
        f"{part}_{side}" for part in ("knee", "ankle", "toe") for side in "lr"
    ]
    kneeling = np.where(own[:, None], points, points + np.array([-0.3, 0.0, 0.2]))
    actual = landmark_points(skeleton, pose_at_landmarks(skeleton, kneeling))
    np.testing.assert_allclose(actual[own], points[own], atol=2e-3)
