"""Inverse kinematics against others: the same body, the same targets, to the same millimetre.

Our skeleton is modelled for MuJoCo (and mink) and for Pinocchio (and pink). Head, wrists and ankles
(five bones' joints) follow a moving body at 30 Hz. Everybody starts each frame from its own last
pose and iterates until the farthest target is met within a millimetre, or for a while. Ours, the
paper's algorithm 1, minds limits and draws the body to a relaxed pose on the way; by itself it
makes some steps in any case, so that this goes on while a person stands: that is "ours_settling".
The tracker's default is beside others in ``bench.functions``.

INPUTS: a skeleton, a made-up motion. OUTPUTS: Metrics.
"""

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from scipy.optimize import least_squares

from bench.clock import Span, ratio, timed
from bench.figures import OF_OTHERS, Metric, stage_metrics
from bench.rivals import PinocchioBody
from jaxmocap.body.kinematics import Sites, forward
from jaxmocap.body.model import Model
from jaxmocap.body.pose import Pose, relaxed_pose
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.evidence.markers import Goals
from jaxmocap.evidence.terms import Measurements
from jaxmocap.hybrid import ik
from jaxmocap.hybrid.settings import IKSettings
from tests.subjects.mujoco_body import MujocoBody

REACHING = ("head", "hand_l", "hand_r", "foot_l", "foot_r")
RATE, FRAMES = 30, {True: 60, False: 200}
TOLERANCE_M, MOST_STEPS = 1e-3, 30
# Frames at a time, where everybody is to be at home in the caches.
BLOCK = 20
# Weight of the pull to the relaxed pose against a metre off a target, and others' damping.
POSTURE, DAMPING = 1e-2, 1e-6
STEP_DAMPING_M = 0.03
SOLVER = "daqp"
# Takes targets (5, 3), goes on from its last pose, and returns its points (5, 3).
Follower = Callable[[np.ndarray], np.ndarray]


def limited_mujoco(skeleton: Skeleton) -> MujocoBody:
    """MuJoCo's body, with our limits on its hinges."""
    body = MujocoBody(skeleton)
    body.model.jnt_limited[body.joint_ids] = 1
    body.model.jnt_range[body.joint_ids] = np.asarray(skeleton.limits, float)
    return body


def mujoco_vector(body: MujocoBody, pose: Pose) -> np.ndarray:
    """A pose as MuJoCo's qpos."""
    q = np.zeros(body.model.nq)
    q[:3], q[3:7], q[body.positions] = (np.asarray(part, float) for part in pose)
    return q


def mujoco_points(body: MujocoBody, q: np.ndarray) -> np.ndarray:
    """Positions (B, 3) of our bones' joints, world."""
    body.data.qpos[:] = q
    mujoco.mj_kinematics(body.model, body.data)
    return body.data.xpos[body.ids]


def motion(skeleton: Skeleton, frames: int) -> tuple[Pose, np.ndarray]:
    """The pose before the first frame, and targets (F, 5, 3) of a body that sways and waves."""
    start, rng = relaxed_pose(skeleton), np.random.default_rng(1)
    low, high = np.asarray(skeleton.limits, float).T
    relaxed, dofs = np.asarray(start.angles, float), len(low)
    phase, rate = rng.uniform(0, 2 * np.pi, (2, dofs))
    times = np.arange(frames + 1)[:, None] / RATE
    swing = np.sin(2 * np.pi * (0.2 + 0.1 * rate) * times + phase) - np.sin(phase)
    # Within the limits and within a tenth of the joint's range to either side.
    angles = np.clip(relaxed + 0.1 * (high - low) * swing, low + 0.02, high - 0.02)
    shift = 0.1 * np.sin(2 * np.pi * 0.3 * times) * np.array([[1.0, 0.5, 0.2]])
    quaternions = np.tile(np.asarray(start.quaternion), (frames + 1, 1))
    poses = Pose(*(jnp.asarray(part, jnp.float32) for part in (shift, quaternions, angles)))
    joints = jax.vmap(lambda pose: forward(skeleton, pose).joints_world)(poses)
    rows = [skeleton.tree.bone(name) for name in REACHING]
    first = jax.tree.map(lambda part: part[0], poses)
    return first, np.asarray(joints, float)[1:, rows]


def measure(quick: bool, without: set[str]) -> Iterator[Metric]:
    """Everybody in turn, frame by frame, and many frames at a time.

    Who comes after eight others finds its code and numbers gone from the processor's caches.
    """
    # Without limits mink and pink warn at every step that leaves them, which takes its time.
    logging.disable(logging.WARNING)
    skeleton = Skeleton.human(1.75)
    start, targets = motion(skeleton, FRAMES[quick])
    for block, label, suffix in ((1, "", ""), (BLOCK, f", {BLOCK} at a time", "_at_a_time")):
        durations, misses = followed(everybody(skeleton, start, without), targets, block)
        for name, times in durations.items():
            yield from stage_metrics(f"IK, {name}{label}", times[:, 0])
            if block == 1:
                met = 100 * float(np.mean(misses[name] < 1.05 * TOLERANCE_M))
                yield Metric(f"IK, {name}, met within 1 mm", met, "%", "higher")
        for name, times in durations.items():
            if name != "ours":
                faster = ratio(times, durations["ours"])
                yield Metric(f"ik_{name}_over_ours{suffix}", faster, "x", "higher", OF_OTHERS)
    logging.disable(logging.NOTSET)


def followed(
    followers: Mapping[str, Follower], targets: np.ndarray, block: int
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Spans (F - 1, 2) and misses (F - 1,) of everybody, in turn every ``block`` frames.

    Without the first frame, in which ours compiles.
    """
    spans: dict[str, list[Span]] = {name: [] for name in followers}
    misses: dict[str, list[float]] = {name: [] for name in followers}
    for first in range(0, len(targets), block):
        for name, follow in followers.items():
            for goal in targets[first : first + block]:
                span, points = timed(follow, goal)
                spans[name].append(span)
                misses[name].append(float(np.linalg.norm(points - goal, axis=1).max()))
    return (
        {name: np.array(times)[1:] for name, times in spans.items()},
        {name: np.array(each)[1:] for name, each in misses.items()},
    )


def everybody(skeleton: Skeleton, start: Pose, without: set[str]) -> Mapping[str, Follower]:
    """Name -> who follows, each with limits minded and not, where it can do both."""
    algorithm_1 = IKSettings(solver="sdls")
    followers = {
        "ours": ours(skeleton, start, replace(algorithm_1, settle=jnp.asarray(1))),
        "ours_settling": ours(skeleton, start, algorithm_1),
        "mujoco_and_numpy": damped_steps(skeleton, start),
        "scipy": by_scipy(skeleton, start, limits=False),
        "scipy_limits": by_scipy(skeleton, start, limits=True),
    }
    for name, make in {"mink": by_mink, "pink": by_pink}.items():
        if name not in without:
            followers[name] = make(skeleton, start, limits=False)
            followers[f"{name}_limits"] = make(skeleton, start, limits=True)
    return followers


def ours(skeleton: Skeleton, start: Pose, settings: IKSettings) -> Follower:
    """The paper's way or the tracker's, with limits and secondary task; NumPy in, NumPy out."""
    bones = np.array([skeleton.tree.bone(name) for name in REACHING], np.int32)
    sites = Sites(bones, jnp.zeros(len(bones)), jnp.zeros((len(bones), 3)))
    weights = jnp.ones(len(bones))

    @jax.jit
    def solve(skeleton, settings, pose, targets):
        measured = Measurements(goals=Goals(sites, targets, weights))
        pose = ik.reach(Model.create(skeleton), settings, measured, pose)
        return pose, forward(skeleton, pose).joints_world[bones]

    last = [start]

    def follow(targets: np.ndarray) -> np.ndarray:
        last[0], points = solve(skeleton, settings, last[0], np.asarray(targets, np.float32))
        return np.asarray(points)

    return follow


def mujoco_slopes(body: MujocoBody, rows: Sequence[int], points: np.ndarray) -> np.ndarray:
    """(3 K, V) of K bones' points (K, 3) by MuJoCo's velocities, where ``mujoco_points`` was."""
    mujoco.mj_comPos(body.model, body.data)
    J = np.empty((len(rows), 3, body.model.nv))
    for own, row, point in zip(J, rows, points, strict=True):
        mujoco.mj_jac(body.model, body.data, own, None, point, body.ids[row])
    return J.reshape(-1, body.model.nv)


def damped_steps(skeleton: Skeleton, start: Pose) -> Follower:
    """MuJoCo's kinematics and a damped step in NumPy: neither limits nor posture."""
    body, rows = limited_mujoco(skeleton), [skeleton.tree.bone(name) for name in REACHING]
    q, ridge = mujoco_vector(body, start), STEP_DAMPING_M**2 * np.eye(3 * len(rows))

    def follow(targets: np.ndarray) -> np.ndarray:
        points = mujoco_points(body, q)[rows]
        for _ in range(MOST_STEPS):
            away = targets - points
            if np.linalg.norm(away, axis=1).max() < TOLERANCE_M:
                break
            J = mujoco_slopes(body, rows, points)
            step = J.T @ np.linalg.solve(J @ J.T + ridge, away.ravel())
            mujoco.mj_integratePos(body.model, q, step, 1.0)
            points = mujoco_points(body, q)[rows]
        return points

    return follow


def by_scipy(skeleton: Skeleton, start: Pose, limits: bool) -> Follower:
    """``scipy.optimize.least_squares`` on MuJoCo's kinematics and Jacobian, about the last pose."""
    body, rows = limited_mujoco(skeleton), [skeleton.tree.bone(name) for name in REACHING]
    q, relaxed, size = (
        mujoco_vector(body, start),
        np.asarray(skeleton.relaxed, float),
        body.model.nv,
    )
    low, high = np.asarray(skeleton.limits, float).T
    pull = np.zeros((len(relaxed), size))
    pull[np.arange(len(relaxed)), body.velocities] = POSTURE

    def moved(step: np.ndarray) -> np.ndarray:
        there = q.copy()
        mujoco.mj_integratePos(body.model, there, step, 1.0)
        return there

    def follow(targets: np.ndarray) -> np.ndarray:
        def residuals(step: np.ndarray) -> np.ndarray:
            there = moved(step)
            away = mujoco_points(body, there)[rows] - targets
            return np.append(away, POSTURE * (there[body.positions] - relaxed))

        def slopes(step: np.ndarray) -> np.ndarray:
            points = mujoco_points(body, moved(step))[rows]
            return np.vstack([mujoco_slopes(body, rows, points), pull])

        bounds = np.full((2, size), np.inf) * [[-1], [1]]
        if limits:
            angles = q[body.positions]
            bounds[:, body.velocities] = (np.minimum(low - angles, -1e-9), high - angles + 1e-9)
        solution = least_squares(
            residuals, np.zeros(size), slopes, bounds, method="trf", xtol=1e-4, ftol=1e-6
        )
        q[:] = moved(solution.x)
        return mujoco_points(body, q)[rows]

    return follow


def until_met(
    targets: np.ndarray, here: Callable[[], np.ndarray], step: Callable[[], None]
) -> np.ndarray:
    """Points (5, 3) after as many steps as the farthest target wants, within a while."""
    for _ in range(MOST_STEPS):
        if np.linalg.norm(targets - here(), axis=1).max() < TOLERANCE_M:
            break
        step()
    return here()


def by_mink(skeleton: Skeleton, start: Pose, limits: bool) -> Follower:
    """A quadratic programme for each step, by mink."""
    import mink

    body = limited_mujoco(skeleton)
    configuration = mink.Configuration(body.model, mujoco_vector(body, start))
    tasks = [mink.FrameTask(name, "body", 1.0, 0.0) for name in REACHING]
    posture = mink.PostureTask(body.model, POSTURE)
    posture.set_target(mujoco_vector(body, relaxed_pose(skeleton)))
    bounds = [mink.ConfigurationLimit(body.model)] if limits else []
    ids = [body.model.body(name).id for name in REACHING]

    def step() -> None:
        every = [*tasks, posture]
        velocity = mink.solve_ik(configuration, every, 1.0, SOLVER, DAMPING, limits=bounds)
        configuration.integrate_inplace(velocity, 1.0)

    def follow(targets: np.ndarray) -> np.ndarray:
        for task, target in zip(tasks, targets, strict=True):
            task.set_target(mink.SE3.from_translation(target))
        return until_met(targets, lambda: configuration.data.xpos[ids], step)

    return follow


def by_pink(skeleton: Skeleton, start: Pose, limits: bool) -> Follower:
    """A quadratic programme for each step, by pink."""
    import pink
    import pinocchio as pin

    body = PinocchioBody.of(skeleton)
    configuration = pink.Configuration(body.model, body.data, body.vector(start))
    tasks = [pink.tasks.FrameTask(name, 1.0, 0.0) for name in REACHING]
    posture = pink.tasks.PostureTask(POSTURE)
    posture.set_target(body.vector(relaxed_pose(skeleton)))
    bounds = [pink.limits.ConfigurationLimit(body.model)] if limits else []
    frames = [body.model.getFrameId(name) for name in REACHING]

    def here() -> np.ndarray:
        return np.array([configuration.data.oMf[frame].translation for frame in frames])

    def step() -> None:
        velocity = pink.solve_ik(
            configuration, [*tasks, posture], 1.0, SOLVER, DAMPING, bounds, safety_break=False
        )
        configuration.integrate_inplace(velocity, 1.0)

    def follow(targets: np.ndarray) -> np.ndarray:
        for task, target in zip(tasks, targets, strict=True):
            task.set_target(pin.SE3(np.eye(3), target))
        return until_met(targets, here, step)

    return follow
