"""Pose from points on rays: screws, OpenCV, the naive system, outliers, limits, what is open."""

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import screws
from conftest import double, on_device, poses
from hypothesis import given, settings
from point_rays import on_rays
from references import rays as naive

from jaxmocap.body.kinematics import forward, jacobian
from jaxmocap.body.pose import Pose, difference, relaxed_pose, retract
from jaxmocap.body.surfaces.surface import BodyPoints, pose_points
from jaxmocap.geometry import twists
from jaxmocap.geometry.cameras import Camera, project
from jaxmocap.geometry.lines import Lines, camera_lines
from jaxmocap.geometry.rotations import quaternion_to_matrix
from jaxmocap.reference import kinematics as naive_kinematics
from jaxmocap.silhouette.points import linearised_rays
from jaxmocap.silhouette.pose import PoseSettings, Prior, solve_pose, standard_deviations
from jaxmocap.solvers.status import Status

# All solves of these tests have the same shapes, so that they compile once to a precision.
PAIRS = 240
SOLVE = jax.jit(solve_pose)
FORWARD, JACOBIAN, LINEARISED = jax.jit(forward), jax.jit(jacobian), jax.jit(linearised_rays)
POSED, RETRACT, EXP = jax.jit(pose_points), jax.jit(retract), jax.jit(twists.exp)
PROJECT, LINES = jax.jit(project), jax.jit(camera_lines)
PATIENT = PoseSettings(iterations=40)
WIDE = 1e6
# Tukey's constant so large that all count alike, as they do for OpenCV and for the reference.
ALIKE = PATIENT._replace(reach=WIDE, deviation=1.0, damping=WIDE)


def some_points(skeleton, rng, bones=None, number=PAIRS) -> BodyPoints:
    """Points about the middles of bones, each carried by two that follow each other."""
    tree = skeleton.tree
    first = rng.integers(0, len(tree.bones), number) if bones is None else np.full(number, bones)
    second = np.where(np.array(tree.parents)[first] >= 0, np.array(tree.parents)[first], first)
    second = second if bones is None else first
    frames = FORWARD(skeleton, at_rest(skeleton))
    R, joints = (np.asarray(part, float) for part in frames[1:3])
    reach = np.asarray(skeleton.lengths)[:, None] * np.asarray(skeleton.directions)
    x = joints[first] + 0.5 * reach[first] + rng.normal(0, 0.08, (number, 3))
    both = np.stack([first, second], 1).astype(np.int32)
    places = np.einsum("nkji,nkj->nki", R[both], x[:, None] - joints[both])
    share = rng.uniform(0.5, 1, number)
    return BodyPoints(both, *on_device((places, np.stack([share, 1 - share], 1))))


def at_rest(skeleton) -> Pose:
    pose = relaxed_pose(skeleton)
    return pose._replace(angles=jnp.zeros_like(pose.angles))


def ring(number: int) -> list[Camera]:
    """Cameras at 4 m around the person, 640 x 480, with a slight lens."""
    matrix = np.array([[560.0, 0, 318], [0, 560, 242], [0, 0, 1]])
    cameras = []
    for turn in np.arange(number) * np.pi / 2 + 0.4:
        z = -np.array([np.cos(turn), np.sin(turn), 0.1])
        z /= np.linalg.norm(z)
        x = np.cross(z, [0, 0, 1.0])
        x /= np.linalg.norm(x)
        R = np.stack([x, np.cross(z, x), z])
        cameras.append(Camera.create((640, 480), matrix, [-0.1, 0.02], R, R @ (4 * z)))
    return cameras


def rays_to(cameras, points_world, noise=0.0, rng=None) -> Lines:
    """Rays of all cameras in turn: the first sees the first points, and so on."""
    parts = np.array_split(np.arange(len(points_world)), len(cameras))
    rays = []
    for camera, part in zip(cameras, parts, strict=True):
        # Of all points, so that as many always are one program.
        pixels = np.array(PROJECT(camera, points_world))
        if rng is not None:
            pixels[part] += rng.normal(0, noise, (len(part), 2))
        rays.append(jax.tree.map(lambda field, p=part: field[p], LINES(camera, pixels)))
    return Lines(*map(np.concatenate, zip(*rays, strict=True)))


def solved(skeleton, pose, pairs, settings, prior=None, free=None):
    """One program for all: without a prior one that expects nothing, without a mask all move."""
    shape = skeleton.costs.shape
    prior = prior or Prior(pose, jnp.full(shape, jnp.inf, skeleton.costs.dtype))
    free = jnp.ones(shape, bool) if free is None else free
    # A number that JAX takes for a literal would be another type, and compile again.
    pose, pairs, prior = jax.tree.map(np.asarray, (pose, pairs, prior))
    return SOLVE(skeleton, pose, pairs, settings, prior, free)


def moved(pose: Pose, rng, size: float) -> Pose:
    step = rng.normal(0, size, 6 + len(pose.angles))
    return RETRACT(pose, on_device(step))


def bent(skeleton, rng) -> Pose:
    """A pose well within the limits."""
    low, high = np.asarray(skeleton.limits, float).T
    angles = low + rng.uniform(0.3, 0.7, len(low)) * (high - low)
    turn = rng.normal(size=4)
    return Pose(*on_device((rng.normal(0, 0.2, 3), turn / np.linalg.norm(turn), angles)))


def placed(skeleton, seed: int):
    """Generator, pose, points and where they are (N, 3)."""
    rng = np.random.default_rng(seed)
    pose = bent(skeleton, rng)
    points = some_points(skeleton, rng)
    return rng, pose, points, POSED(FORWARD(skeleton, pose), points)


@settings(max_examples=8)
@given(pose=poses())
def test_the_product_of_exponentials_of_screws_at_rest_is_forward_kinematics(skeleton64, pose):
    with double():
        rest = FORWARD(skeleton64, at_rest(skeleton64))
        frames = FORWARD(skeleton64, on_device(pose))
        tree = skeleton64.tree
        at_rest_screws = screws.screw(rest.joints_world[np.array(tree.dof_bones)], rest.axes_world)
        R_world_root = quaternion_to_matrix(on_device(pose.quaternion))
        body = np.asarray(twists.rigid(R_world_root, on_device(pose.position)))
        turns = np.asarray(EXP(on_device(pose.angles)[:, None] * at_rest_screws))
    for bone, name in enumerate(tree.bones):
        T = body
        for above in tree.chain(name):
            for dof in np.flatnonzero(np.array(tree.dof_bones) == above):
                T = T @ turns[dof]
        np.testing.assert_allclose(T[:3, :3], frames.R_world_bone[bone], atol=1e-11)
        x = T[:3, :3] @ np.asarray(rest.joints_world[bone]) + T[:3, 3]
        np.testing.assert_allclose(x, frames.joints_world[bone], atol=1e-11)


@settings(max_examples=8)
@given(pose=poses())
def test_columns_of_the_jacobian_are_the_joints_screws_applied_to_the_point(skeleton64, pose):
    """The screws at rest, carried along by (4.21), against the columns of equation (4)."""
    point = np.array([0.3, -0.2, 0.9])
    hand = skeleton64.tree.bone("hand_l")
    with double():
        frames = FORWARD(skeleton64, on_device(pose))
        J = np.asarray(JACOBIAN(skeleton64, frames, np.array([hand]), on_device(point[None])))[0]
        joints = frames.joints_world[np.array(skeleton64.tree.dof_bones)]
        joint_screws = np.asarray(screws.screw(joints, frames.axes_world))
    carrying = [
        d for d, b in enumerate(skeleton64.tree.dof_bones) if b in skeleton64.tree.chain("hand_l")
    ]
    assert len(carrying) == 7
    for dof in carrying:
        v, w = joint_screws[dof, :3], joint_screws[dof, 3:]
        np.testing.assert_allclose(J[:, 6 + dof], np.cross(w, point) + v, atol=1e-12)
        assert abs(v @ w) < 1e-12  # no pitch


def test_the_system_is_the_naive_one_without_its_empty_third(skeleton64):
    """Two rows to a pair, where the paper has three of rank two: the same squares and Hessian."""
    with double():
        _, pose, points, x = placed(skeleton64, 3)
        pairs = on_rays(points, rays_to(ring(2), x + 0.03))
        linearised = LINEARISED(skeleton64, FORWARD(skeleton64, pose), pairs)
        residuals, rows = (np.asarray(part) for part in linearised)
    own = naive_kinematics.forward(skeleton64, pose)
    np.testing.assert_allclose(naive.pose_points(own, points), x, atol=1e-12)
    b, A = naive.linearise_pairs(skeleton64, own, pairs)
    np.testing.assert_allclose((residuals**2).sum(-1), (b**2).sum(-1), atol=1e-12)
    H, slope = (np.einsum("nki,nk...->i...", A, each) for each in (A, b))
    np.testing.assert_allclose(np.einsum("nki,nkj->ij", rows, rows), H, atol=1e-9)
    np.testing.assert_allclose(np.einsum("nki,nk->i", rows, residuals), slope, atol=1e-9)


def test_rows_are_derivatives_of_the_residuals(skeleton64):
    with double():
        rng, pose, points, x = placed(skeleton64, 4)
        lines = rays_to(ring(2), x + 0.03)
        pairs = on_rays(points, lines)._replace(along_weights=on_device(rng.uniform(0, 1, PAIRS)))
        way, h = rng.normal(size=6 + len(pose.angles)), 1e-6
        ends = [FORWARD(skeleton64, RETRACT(pose, s * h * way)) for s in (1, -1)]
        after, before = (np.asarray(LINEARISED(skeleton64, end, pairs)[0]) for end in ends)
        rows = np.asarray(LINEARISED(skeleton64, FORWARD(skeleton64, pose), pairs)[1])
        np.testing.assert_allclose((after - before) / (2 * h), rows @ way, atol=1e-6)


@pytest.mark.parametrize("noise", [0.0, 0.5])
def test_a_rigid_body_gets_the_pose_that_opencv_finds(skeleton64, noise):
    """Without noise the same pose; with noise both are as near to the truth."""
    rng = np.random.default_rng(5)
    with double():
        points = some_points(skeleton64, rng, bones=0)
        (camera,) = ring(1)
        body_only = jnp.arange(6 + len(skeleton64.tree.joints)) < 6
        ours, theirs, across = [], [], []
        for _ in range(6 if noise else 2):
            truth = moved(at_rest(skeleton64), rng, 0.3)._replace(angles=at_rest(skeleton64).angles)
            x = np.asarray(POSED(FORWARD(skeleton64, truth), points))
            pixels = np.asarray(PROJECT(camera, on_device(x))) + rng.normal(0, noise, (PAIRS, 2))
            pairs = on_rays(points, LINES(camera, on_device(pixels)))
            actual = solved(skeleton64, at_rest(skeleton64), pairs, ALIKE, None, body_only)
            _, turn, shift = cv2.solvePnP(
                np.ascontiguousarray(np.asarray(points.points_bone)[:, 0]),
                pixels,
                np.asarray(camera.matrix),
                np.asarray(camera.distortion),
            )
            T = np.eye(4)
            T[:3, :3], T[:3, 3] = cv2.Rodrigues(turn)[0], shift[:, 0]
            T = np.linalg.inv(np.asarray(camera.T_cam_world)) @ T
            R = np.asarray(quaternion_to_matrix(actual.pose.quaternion))
            ours.append(np.linalg.norm(actual.pose.position - truth.position))
            theirs.append(np.linalg.norm(T[:3, 3] - np.asarray(truth.position)))
            across.append(
                max(np.abs(actual.pose.position - T[:3, 3]).max(), np.abs(R - T[:3, :3]).max())
            )
    if noise:
        assert np.mean(ours) < 1.5 * np.mean(theirs) + 1e-4
        assert np.mean(ours) < 0.05
    else:
        assert max(across) < 1e-4


@pytest.mark.parametrize("cameras", [1, 2, 4])
def test_points_of_the_whole_body_give_its_pose_back(skeleton, cameras):
    """Noise-free, from 0.15 rad and 15 cm off; float32. One camera does for points."""
    rng, truth, points, x = placed(skeleton, 6 + cameras)
    pairs = on_rays(points, rays_to(ring(cameras), x))
    actual = solved(skeleton, moved(truth, rng, 0.15), pairs, PATIENT)
    assert np.abs(difference(actual.pose, truth)).max() < 2e-3
    assert actual.distances.max() < 1e-4


def test_contours_outliers_a_prior_and_limits_lead_to_the_references_pose(skeleton64):
    """An elbow that would bend backwards, a sixth of wrong pairs, little grip along contours."""
    rng = np.random.default_rng(14)
    elbow = skeleton64.tree.joint("elbow_flex_l")
    with double():
        truth = bent(skeleton64, rng)
        truth = truth._replace(angles=truth.angles.at[elbow].set(-0.1))
        points = some_points(skeleton64, rng)
        x = np.array(POSED(FORWARD(skeleton64, truth), points))
        x[::6] += rng.normal(0, 0.3, (len(x[::6]), 3))
        pairs = on_rays(points, rays_to(ring(4), on_device(x), 1.0, rng))
        turn = rng.uniform(0, np.pi, (PAIRS, 1))
        along = np.cross(pairs.lines.directions, pairs.across)
        across = np.cos(turn) * pairs.across + np.sin(turn) * along
        weights = on_device(rng.uniform(0.2, 1.0, PAIRS) * (np.arange(PAIRS) % 7 > 0))
        pairs = pairs._replace(
            across=across, weights=weights, along_weights=on_device(np.full(PAIRS, 0.1))
        )
        start = moved(truth._replace(angles=truth.angles.at[elbow].set(0.1)), rng, 0.02)
        deviations = on_device(rng.uniform(0.1, 0.5, skeleton64.costs.shape))
        prior = Prior(moved(truth, rng, 0.05), deviations)
        how = PATIENT._replace(rest=1e-9)
        actual = solved(skeleton64, start, pairs, how, prior)
        theirs = naive.solve_pose(skeleton64, start, pairs, how._replace(iterations=15), prior)
        residuals, _ = naive.contour_rows(
            skeleton64, naive_kinematics.forward(skeleton64, theirs), pairs
        )
        share, spread = naive.shares(residuals, np.asarray(weights), how)
        assert np.abs(difference(Pose(*on_device(theirs)), actual.pose)).max() < 1e-5
    assert theirs.angles[elbow] == pytest.approx(0.0, abs=1e-9)
    assert actual.spread == pytest.approx(spread, rel=1e-4)
    counting = np.asarray(weights) > 0
    np.testing.assert_allclose(np.asarray(actual.shares)[counting], share[counting], atol=1e-4)
    assert np.mean(share[::6] == 0) > 0.5


def test_a_fifth_of_wrong_pairs_is_told_by_its_distance_in_space(skeleton):
    rng, truth, points, x = placed(skeleton, 8)
    x = np.array(x)
    wrong = rng.permutation(PAIRS) < PAIRS // 5
    x[wrong] += rng.normal(0, 0.3, (wrong.sum(), 3))
    pairs = on_rays(points, rays_to(ring(4), on_device(x), 0.5, rng))
    start = moved(truth, rng, 0.05)
    actual = solved(skeleton, start, pairs, PATIENT)
    all_alike = solved(skeleton, start, pairs, ALIKE)
    error, unguarded = (
        np.sqrt(np.mean(np.square(difference(each.pose, truth)))) for each in (actual, all_alike)
    )
    far = wrong & (np.asarray(actual.distances) > 0.05)
    assert np.all(np.asarray(actual.shares)[far] == 0)
    assert np.mean(np.asarray(actual.shares)[~wrong] > 0.3) > 0.95
    assert error < 0.02
    assert error < unguarded / 4


def test_padding_counts_for_nothing_whatever_it_holds(skeleton):
    rng, truth, points, x = placed(skeleton, 9)
    lines = rays_to(ring(2), x)
    empty = np.arange(PAIRS) >= 200
    lines = Lines(*(jnp.where(empty[:, None], jnp.nan, part) for part in lines))
    points = points._replace(points_bone=jnp.where(empty[:, None, None], 1e30, points.points_bone))
    pairs = on_rays(points, lines, jnp.where(empty, 0.0, 1.0))
    actual = solved(skeleton, moved(truth, rng, 0.05), pairs, PATIENT)
    assert np.abs(difference(actual.pose, truth)).max() < 2e-3
    nothing = solved(skeleton, truth, on_rays(points, lines, jnp.zeros(PAIRS)), PATIENT)
    assert nothing.status == Status.BROKEN
    assert np.abs(difference(nothing.pose, truth)).max() < 1e-6


def test_a_prior_holds_what_no_ray_tells_and_gives_way_to_what_rays_tell(skeleton):
    rng, truth, points, x = placed(skeleton, 11)
    arm = [skeleton.tree.bone(name) for name in ("humerus_l", "radius_l", "hand_l")]
    on_arm = np.isin(np.asarray(points.bones), arm).any(-1)
    lines = rays_to(ring(4), x)
    pairs = on_rays(points, lines, jnp.where(on_arm, 0.0, 1.0))
    expected = moved(truth, rng, 0.1)
    prior = Prior(expected, jnp.full(skeleton.costs.shape, 0.5))
    actual = solved(skeleton, truth, pairs, PATIENT, prior).pose
    of_arm = [6 + d for d, b in enumerate(skeleton.tree.dof_bones) if b in arm]
    off_truth, off_prior = (np.abs(difference(actual, each)) for each in (truth, expected))
    assert off_prior[of_arm].max() < 1e-3
    assert np.delete(off_truth, of_arm).max() < 5e-3


def test_the_hessian_tells_what_outlines_leave_open(skeleton):
    """Forearm along the line of sight: one camera's outline does not hold the elbow; two do."""
    deviations = []
    for cameras in (1, 2):
        pairs = _outlines(skeleton, ring(cameras))
        actual = solved(skeleton, relaxed_pose(skeleton), pairs, PATIENT._replace(iterations=0))
        deviations.append(standard_deviations(actual.information))
    one, two = deviations
    dof = 6 + skeleton.tree.joint("arm_flex_l")
    assert one[dof] > 3 * two[dof]
    assert one[:3].max() > 3 * two[:3].max()
    # Nothing measured leaves what was there before.
    np.testing.assert_allclose(standard_deviations(np.zeros((27, 27)), 0.7), 0.7)


def _outlines(skeleton, cameras):
    """Points at the sides of limbs as each camera sees them, measured across the outline only."""
    rng = np.random.default_rng(12)
    frames = FORWARD(skeleton, relaxed_pose(skeleton))
    points = some_points(skeleton, rng)
    first = np.asarray(points.bones)[:, 0]
    x = np.asarray(POSED(frames, points))
    along = np.einsum(
        "nij,nj->ni", np.asarray(frames.R_world_bone)[first], np.asarray(skeleton.directions)[first]
    )
    lines = rays_to(cameras, on_device(x))
    across = np.cross(np.asarray(lines.directions), along)
    length = np.linalg.norm(across, axis=-1, keepdims=True)
    pairs = on_rays(points, lines, on_device((length[:, 0] > 0.2).astype(float)))
    across = on_device(across / np.maximum(length, 0.1))
    return pairs._replace(across=across, along_weights=jnp.zeros(PAIRS))
