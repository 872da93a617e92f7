"""All poses of a recording at once, against dense solves and true motions."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmocap.body.kinematics import landmarks
from jaxmocap.body.pose import Pose, relaxed_pose, retract
from jaxmocap.body.skeleton import LANDMARKS, Skeleton, load_skeleton
from jaxmocap.body.surfaces.morphing import Morphing, shoulders
from jaxmocap.silhouette.settings import Settings
from jaxmocap.silhouette.smoothing import FrameInformation, PoseSmoothingSettings, smoothed_poses
from jaxmocap.silhouette.surfaces.morph import morph_of, with_followers

FRAMES = 40
TIMES = np.arange(FRAMES) / 30
# Information of a sharp pose, and of none at all.
SURE, UNSURE = 1e8, 1e-6
# Scatter of pairs, metres.
SPREAD = 0.01


@pytest.fixture(scope="module")
def skeleton() -> Skeleton:
    return load_skeleton(Settings.body)


PLACES, RETRACT = jax.jit(jax.vmap(landmarks, (None, 0))), jax.jit(retract)


def moving(skeleton: Skeleton, wave: np.ndarray) -> tuple[Pose, np.ndarray]:
    """The relaxed pose moved by tangent vectors (T, 6 + D), and those."""
    rest = jax.tree.map(lambda part: np.stack([part] * len(wave)), relaxed_pose(skeleton))
    return jax.tree.map(np.asarray, RETRACT(rest, np.asarray(wave, np.float32))), wave


def swinging(skeleton: Skeleton) -> Pose:
    """The body goes ahead while arms and a knee swing slowly."""
    wave = np.zeros((FRAMES, 6 + len(skeleton.tree.joints)))
    wave[:, 0] = 0.8 * TIMES
    for joint, amount in (("arm_flex_l", 0.5), ("elbow_flex_l", 0.4), ("knee_flexion_r", 0.3)):
        wave[:, 6 + skeleton.tree.joints.index(joint)] = amount * (1 - np.cos(4 * TIMES))
    return moving(skeleton, wave)[0]


def information_of(poses: Pose, sureness: np.ndarray | float) -> FrameInformation:
    """Frames of which each tells all directions alike; (T,) how surely."""
    size = 6 + poses.angles.shape[1]
    each = np.broadcast_to(sureness, len(poses.angles))
    return frames_of(poses, each[:, None, None] * np.eye(size), np.zeros((len(each), size)))


def frames_of(poses: Pose, information: np.ndarray, slope: np.ndarray) -> FrameInformation:
    """By four cameras whose pairs scatter by a centimetre."""
    count = len(slope)
    spread, cameras = np.full(count, SPREAD), np.full(count, 4)
    return FrameInformation(poses, information, slope, spread, cameras, np.full(count, np.inf))


def smooth(
    skeleton: Skeleton, measured: FrameInformation, rest=None, morph=None, **changed
) -> Pose:
    """No joint is held at rest unless that is stated."""
    times, settings = TIMES[: len(measured.slope)], PoseSmoothingSettings(**changed)
    rest = free(skeleton) if rest is None else rest
    return smoothed_poses(skeleton, times, measured, rest, settings, morph)[0]


def free(skeleton: Skeleton) -> np.ndarray:
    return np.full(len(skeleton.tree.joints), np.inf)


def places(skeleton: Skeleton, poses: Pose) -> np.ndarray:
    return np.asarray(PLACES(skeleton, poses))


def test_what_frames_are_sure_of_stays(skeleton):
    truth = swinging(skeleton)
    actual = smooth(skeleton, information_of(truth, SURE))
    np.testing.assert_allclose(places(skeleton, actual), places(skeleton, truth), atol=1e-3)


def test_frames_that_show_nothing_lie_between_the_others(skeleton):
    """Their own poses are those of the last visible one, as the tracker leaves them."""
    truth, unseen = swinging(skeleton), np.arange(15, 20)
    actual = jax.tree.map(np.copy, truth)
    for part in actual:
        part[unseen] = part[14]
    sureness = np.full(FRAMES, SURE)
    sureness[unseen] = 0.0
    bridged = smooth(skeleton, information_of(actual, sureness), pose_deviation=10.0)
    before, after = (
        np.linalg.norm(places(skeleton, each) - places(skeleton, truth), axis=-1)[unseen].max()
        for each in (actual, bridged)
    )
    assert before > 0.1
    assert after < 0.02


def test_noise_is_taken_out_and_the_motion_left(skeleton):
    rng, truth = np.random.default_rng(3), swinging(skeleton)
    noise = rng.normal(0, 0.02, (FRAMES, 6 + truth.angles.shape[1])).astype(np.float32)
    shaken = jax.tree.map(np.asarray, RETRACT(truth, noise))
    calm = smooth(skeleton, information_of(shaken, 1 / 0.02**2))
    exact = places(skeleton, truth)
    before, after = (
        np.linalg.norm(places(skeleton, each) - exact, axis=-1).mean() for each in (shaken, calm)
    )
    assert after < 0.6 * before

    def accelerations(poses: Pose) -> float:
        return float(np.linalg.norm(np.diff(places(skeleton, poses), 2, axis=0), axis=-1).mean())

    assert accelerations(calm) < 0.2 * accelerations(shaken)


def test_who_stands_still_does_so_beside_what_swings(skeleton):
    """Accelerations are a landmark's own: one number for all lets feet shake, or arms lag."""
    rng, truth = np.random.default_rng(3), swinging(skeleton)
    truth = jax.tree.map(np.copy, truth)
    truth.position[:] = truth.position[0]
    noise = rng.normal(0, 0.01, (FRAMES, 6 + truth.angles.shape[1])).astype(np.float32)
    shaken = jax.tree.map(np.asarray, RETRACT(truth, noise))
    measured, exact = information_of(shaken, 1 / 0.01**2), places(skeleton, truth)
    foot, hand = (LANDMARKS.index(name) for name in ("ankle_l", "wrist_l"))
    alike, own = (
        places(skeleton, smooth(skeleton, measured, **changed))
        for changed in ({"rounds": 0}, {"own_share": 1.0})
    )

    def shaking(actual: np.ndarray) -> float:
        return float(np.linalg.norm(np.diff(actual[:, foot], 2, axis=0), axis=-1).mean())

    def off(actual: np.ndarray) -> float:
        return float(np.linalg.norm(actual - exact, axis=-1)[:, hand].mean())

    assert shaking(own) < 0.3 * shaking(alike)
    assert off(own) < 1.1 * off(alike)


def test_slopes_lead_from_where_prediction_dragged(skeleton):
    """Poses lag by 5 cm; their pairs say by how much."""
    truth = swinging(skeleton)
    behind = np.zeros((FRAMES, 6 + truth.angles.shape[1]), np.float32)
    behind[:, 0] = -0.05
    lagging = jax.tree.map(np.asarray, retract(truth, jnp.asarray(behind)))
    size = behind.shape[1]
    measured = frames_of(
        lagging, np.broadcast_to(SURE * np.eye(size), (FRAMES, size, size)), SURE * behind
    )
    actual = smooth(skeleton, measured)
    np.testing.assert_allclose(places(skeleton, actual), places(skeleton, truth), atol=1e-3)


def test_a_body_that_is_only_shifted_is_smoothed_as_a_dense_solve_says(skeleton):
    """All landmarks go along with the pelvis: second differences of its place alone."""
    rng, size = np.random.default_rng(0), 6 + len(skeleton.tree.joints)
    wave = np.zeros((FRAMES, size))
    wave[:, :3] = rng.normal(0, 0.03, (FRAMES, 3))
    shaken, _ = moving(skeleton, wave)
    weights = np.full(size, 1e9)
    weights[:3] = 400.0
    settings = PoseSmoothingSettings(acceleration=2.0, rounds=0, pose_deviation=1e3)
    measured = frames_of(shaken, np.stack([np.diag(weights)] * FRAMES), np.zeros((FRAMES, size)))
    actual, deviations = smoothed_poses(skeleton, TIMES, measured, free(skeleton), settings)
    h = TIMES[1]
    second = (np.eye(FRAMES)[:-2] - 2 * np.eye(FRAMES)[1:-1] + np.eye(FRAMES)[2:]) / h**1.5
    stiff = len(LANDMARKS) / settings.acceleration**2 * second.T @ second
    dense = np.linalg.solve(400.0 * np.eye(FRAMES) + stiff, 400.0 * shaken.position)
    np.testing.assert_allclose(actual.position, dense, atol=2e-4)
    counted = np.diag(np.linalg.inv(400.0 * np.eye(FRAMES) + stiff))
    expected = np.hypot(10 * np.sqrt(counted), 2.5 * 2**0.5 * SPREAD)
    pelvis = deviations[:, LANDMARKS.index("pelvis")]
    np.testing.assert_allclose(pelvis, np.tile(expected[:, None], 3), rtol=1e-3)


def test_fewer_cameras_are_less_sure(skeleton):
    four = information_of(swinging(skeleton), SURE)
    two = four._replace(cameras=np.full(FRAMES, 2))
    stated = [
        smoothed_poses(skeleton, TIMES, each, free(skeleton), PoseSmoothingSettings())[1]
        for each in (four, two)
    ]
    assert (stated[1] > 1.15 * stated[0]).all()


def test_one_camera_is_less_sure_of_arms(skeleton):
    """How far off they are."""
    frames = information_of(swinging(skeleton), 1e9)._replace(cameras=np.full(FRAMES, 1))
    _, one = smoothed_poses(skeleton, TIMES, frames, free(skeleton), PoseSmoothingSettings())
    pelvis, elbow, wrist, knee = (
        one[:, LANDMARKS.index(name)] for name in ("pelvis", "elbow_l", "wrist_r", "knee_l")
    )
    for part, times in ((elbow, 1.4), (wrist, 1.5), (knee, 1.2)):
        np.testing.assert_allclose(part, times * pelvis, rtol=1e-2)


def test_pairs_do_not_draw_the_pelvis_from_where_key_points_have_it(skeleton):
    """As they do without them: a body that is too wide seems nearer."""
    truth = swinging(skeleton)
    slope = np.zeros((FRAMES, 6 + truth.angles.shape[1]))
    slope[:, 1] = 1e3 * 0.05
    drawn = information_of(truth, 1e3)._replace(slope=slope)
    held = drawn._replace(place_deviations=np.full(FRAMES, 0.01))
    off = [np.abs(smooth(skeleton, each).position - truth.position)[:, 1] for each in (drawn, held)]
    assert off[0].mean() > 0.03 and off[1].mean() < 0.01


def test_no_joint_leaves_its_range(skeleton):
    truth = swinging(skeleton)
    elbow = skeleton.tree.joints.index("elbow_flex_l")
    slope = np.zeros((FRAMES, 6 + truth.angles.shape[1]))
    # Pairs that would stretch it beyond.
    slope[:, 6 + elbow] = 10 * 400.0
    measured = information_of(truth, 400.0)._replace(slope=slope)
    actual = smooth(skeleton, measured, pose_deviation=10.0)
    low, high = np.asarray(skeleton.limits, float).T
    assert (actual.angles >= low - 1e-6).all()
    assert (actual.angles <= high + 1e-6).all()
    assert (actual.angles[:, elbow] < truth.angles[:, elbow] - 0.05).any()


def test_joints_held_at_rest_are_drawn_there_where_pairs_say_nothing(skeleton):
    truth, rest = swinging(skeleton), free(skeleton)
    elbow = skeleton.tree.joints.index("elbow_flex_l")
    rest[elbow] = 1e-3
    actual = smooth(skeleton, information_of(truth, UNSURE), rest, pose_deviation=10.0)
    low = float(skeleton.limits[elbow, 0])
    assert np.abs(actual.angles[:, elbow] - max(low, 0.0)).max() < 0.02


def test_joints_that_go_along_are_held_where_they_go(skeleton):
    """Arms are raised, and the collar bones with them: nothing draws these back."""
    morph = morph_of(Morphing(shoulders().followers), skeleton.tree)
    wave = np.zeros((FRAMES, 6 + len(skeleton.tree.joints)))
    wave[:, 6 + skeleton.tree.joints.index("arm_flex_l")] = 1 - np.cos(2 * TIMES)
    alone = moving(skeleton, wave)[0]
    truth = jax.tree.map(
        np.asarray, jax.vmap(partial(with_followers, morph, skeleton=skeleton))(alone)
    )
    clavicles = [name.startswith("clavicle") for name in skeleton.tree.joints]
    rest = np.where(clavicles, 1e-3, np.inf)
    followers = morph.follower_gains.any(1) & np.isfinite(rest)
    went = np.abs(truth.angles - alone.angles)[:, followers].max(0)
    assert (went > 0.1).any()
    sureness = 1e4
    actual, without = (
        smooth(skeleton, information_of(truth, sureness), rest, goes) for goes in (morph, None)
    )
    off, drawn = (
        np.abs(each.angles - truth.angles)[:, followers].max() for each in (actual, without)
    )
    assert off < 0.01
    assert drawn > 0.1


def test_two_frames_have_no_acceleration_and_stay(skeleton):
    two = jax.tree.map(lambda part: part[:2], swinging(skeleton))
    actual = smooth(skeleton, information_of(two, SURE))
    np.testing.assert_array_equal(actual.angles, two.angles)
