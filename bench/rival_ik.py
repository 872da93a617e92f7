"""Inverse kinematics against others: the same body, the same targets, to the same millimetre.

Head, wrists and ankles (five bones' joints) follow a moving body at 30 Hz. Everybody starts each
frame from its own last pose and iterates until the farthest target is met within a millimetre, or
for a while. Ours, the paper's algorithm 1, minds limits and draws the body to a relaxed pose on the
way; by itself it makes some steps in any case, so that this goes on while a person stands: that is
"ours_settling". The tracker's default is beside others in ``bench.functions``.

INPUTS: a skeleton, a made-up motion. OUTPUTS: Metrics.
"""

import logging
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from scipy.optimize import least_squares

from bench.clock import Span, ratio, timed
from bench.metrics import OF_OTHERS, Metric, stage_metrics
from bench.rival_bodies import PinocchioBody, limited_mujoco, mujoco_points, mujoco_vector
from jaxmocap.body.kinematics import Sites, forward
from jaxmocap.body.model import Model
from jaxmocap.body.pose import Pose, relaxed_pose
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.evidence.markers import Goals
from jaxmocap.hybrid import ik
from jaxmocap.hybrid.settings import IKSettings

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
        measured = {"goals": Goals(sites, targets, weights)}
        pose = ik.reach(Model.create(skeleton), settings, measured, pose)
        return pose, forward(skeleton, pose).joints_world[bones]

    last = [start]

    def follow(targets: np.ndarray) -> np.ndarray:
        last[0], points = solve(skeleton, settings, last[0], np.asarray(targets, np.float32))
        return np.asarray(points)

    return follow


def damped_steps(skeleton: Skeleton, start: Pose) -> Follower:
    """MuJoCo's kinematics and a damped step in NumPy: neither limits nor posture."""
    body = limited_mujoco(skeleton)
    model, data = body.model, body.data
    rows, ids = (
        [skeleton.tree.bone(name) for name in REACHING],
        [model.body(n).id for n in REACHING],
    )
    q, ridge = mujoco_vector(body, start), STEP_DAMPING_M**2 * np.eye(3 * len(ids))
    J = np.zeros((len(ids), 3, model.nv))

    def follow(targets: np.ndarray) -> np.ndarray:
        points = mujoco_points(body, q)[rows]
        for _ in range(MOST_STEPS):
            away = targets - points
            if np.linalg.norm(away, axis=1).max() < TOLERANCE_M:
                break
            mujoco.mj_comPos(model, data)
            for i, bone in enumerate(ids):
                mujoco.mj_jac(model, data, J[i], None, points[i], bone)
            flat = J.reshape(-1, model.nv)
            step = flat.T @ np.linalg.solve(flat @ flat.T + ridge, away.ravel())
            mujoco.mj_integratePos(model, q, step, 1.0)
            points = mujoco_points(body, q)[rows]
        return points

    return follow


def by_scipy(skeleton: Skeleton, start: Pose, limits: bool) -> Follower:
    """``scipy.optimize.least_squares`` on MuJoCo's kinematics and Jacobian, about the last pose."""
    body = limited_mujoco(skeleton)
    model, data = body.model, body.data
    rows, ids = (
        [skeleton.tree.bone(name) for name in REACHING],
        [model.body(n).id for n in REACHING],
    )
    q, relaxed = mujoco_vector(body, start), np.asarray(skeleton.relaxed, float)
    low, high = np.asarray(skeleton.limits, float).T
    pull = np.zeros((len(relaxed), model.nv))
    pull[np.arange(len(relaxed)), body.velocities] = POSTURE

    def moved(step: np.ndarray) -> np.ndarray:
        there = q.copy()
        mujoco.mj_integratePos(model, there, step, 1.0)
        return there

    def follow(targets: np.ndarray) -> np.ndarray:
        def residuals(step: np.ndarray) -> np.ndarray:
            there = moved(step)
            away = mujoco_points(body, there)[rows] - targets
            return np.append(away, POSTURE * (there[body.positions] - relaxed))

        def slopes(step: np.ndarray) -> np.ndarray:
            points = mujoco_points(body, moved(step))[rows]
            mujoco.mj_comPos(model, data)
            J = np.zeros((len(ids), 3, model.nv))
            for i, bone in enumerate(ids):
                mujoco.mj_jac(model, data, J[i], None, points[i], bone)
            return np.vstack([J.reshape(-1, model.nv), pull])

        bounds = np.full((2, model.nv), np.inf) * [[-1], [1]]
        if limits:
            angles = q[body.positions]
            bounds[:, body.velocities] = (np.minimum(low - angles, -1e-9), high - angles + 1e-9)
        solution = least_squares(
            residuals, np.zeros(model.nv), slopes, bounds, method="trf", xtol=1e-4, ftol=1e-6
        )
        q[:] = moved(solution.x)
        return mujoco_points(body, q)[rows]

    return follow


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

    def follow(targets: np.ndarray) -> np.ndarray:
        for task, target in zip(tasks, targets, strict=True):
            task.set_target(mink.SE3.from_translation(target))
        for _ in range(MOST_STEPS):
            points = configuration.data.xpos[ids]
            if np.linalg.norm(targets - points, axis=1).max() < TOLERANCE_M:
                break
            velocity = mink.solve_ik(
                configuration, [*tasks, posture], 1.0, SOLVER, DAMPING, limits=bounds
            )
            configuration.integrate_inplace(velocity, 1.0)
        return configuration.data.xpos[ids]

    return follow


def by_pink(skeleton: Skeleton, start: Pose, limits: bool) -> Follower:
    """A quadratic programme for each step, by pink."""
    import pink
    import pinocchio as pin
    from pink.limits import ConfigurationLimit
    from pink.tasks import FrameTask, PostureTask

    body = PinocchioBody.of(skeleton)
    configuration = pink.Configuration(body.model, body.data, body.vector(start))
    tasks = [FrameTask(name, 1.0, 0.0) for name in REACHING]
    posture = PostureTask(POSTURE)
    posture.set_target(body.vector(relaxed_pose(skeleton)))
    bounds = [ConfigurationLimit(body.model)] if limits else []
    frames = [body.model.getFrameId(name) for name in REACHING]

    def here() -> np.ndarray:
        return np.array([configuration.data.oMf[frame].translation for frame in frames])

    def follow(targets: np.ndarray) -> np.ndarray:
        for task, target in zip(tasks, targets, strict=True):
            task.set_target(pin.SE3(np.eye(3), target))
        for _ in range(MOST_STEPS):
            if np.linalg.norm(targets - here(), axis=1).max() < TOLERANCE_M:
                break
            velocity = pink.solve_ik(
                configuration, [*tasks, posture], 1.0, SOLVER, DAMPING, bounds, safety_break=False
            )
            configuration.integrate_inplace(velocity, 1.0)
        return here()

    return follow
