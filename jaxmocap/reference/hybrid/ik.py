"""Inverse kinematics: algorithm 1, with every matrix written out.

INPUTS: a skeleton, goals, settings (anything with their attributes), the last pose and stance.
OUTPUTS: poses; float64.
"""

from typing import Any, NamedTuple

import numpy as np

from jaxmocap.reference.hybrid import sdls
from jaxmocap.reference.hybrid.mass import augmented_bodies
from jaxmocap.reference.kinematics import forward, jacobian, quaternion_matrix, site_positions

# Singular values below this fraction of the largest count as zero.
RANK_TOLERANCE = 1e-5
# A degree of freedom this near to its limit (weighted radians) is at it.
AT_LIMIT = 1e-3


class Pose(NamedTuple):
    """Position (3,), quaternion (4,) wxyz and angles (D,) of a body."""

    position: np.ndarray
    quaternion: np.ndarray
    angles: np.ndarray


class Goals(NamedTuple):
    """Points on bones (sites), where they are to go (M, 3), and how much each counts (M,)."""

    sites: Any
    targets: np.ndarray
    weights: np.ndarray


def as_pose(pose: Any) -> Pose:
    """A pose in float64."""
    return Pose(*(np.asarray(part, float) for part in pose))


def as_goals(goals: Any) -> Goals:
    """Goals in float64."""
    return Goals(goals.sites, np.asarray(goals.targets, float), np.asarray(goals.weights, float))


def retract(pose: Any, step: np.ndarray) -> Pose:
    """Move a pose by a tangent vector (6 + D,): metres, a rotation vector, angles."""
    position, quaternion, angles = as_pose(pose)
    angle = np.linalg.norm(step[3:6])
    w, xyz = np.cos(angle / 2), 0.5 * np.sinc(angle / 2 / np.pi) * step[3:6]
    v, xyz2 = quaternion[0], quaternion[1:]
    turned = np.append(w * v - xyz @ xyz2, w * xyz2 + v * xyz + np.cross(xyz, xyz2))
    return Pose(position + step[:3], turned / np.linalg.norm(turned), angles + step[6:])


def secondary_task(skeleton: Any, frames: Any, pose: Any, settings: Any) -> np.ndarray:
    """Equation (9) for the joints; the root leans back to the upright."""
    bodies = augmented_bodies(skeleton, frames, settings.augmented_body == "proximal")
    relaxing = sdls.secondary_task(
        bodies.masses,
        bodies.arms,
        np.asarray(pose.angles, float),
        np.asarray(skeleton.relaxed, float),
        float(settings.relaxation),
    )
    up = quaternion_matrix(np.asarray(pose.quaternion, float))[:, 2]
    lean = np.cross(up, [0.0, 0.0, 1.0])
    return np.concatenate([np.zeros(3), float(settings.uprightness) * lean, relaxing])


def arm_length(skeleton: Any) -> float:
    """Of the left arm with the hand, metres."""
    bones = [skeleton.tree.bone(name) for name in ("humerus_l", "radius_l", "hand_l")]
    return sum(float(skeleton.lengths[bone]) for bone in bones)


def linearise_goals(skeleton: Any, frames: Any, goals: Any) -> tuple[np.ndarray, np.ndarray, float]:
    """Weighted Jacobian (4), clamped displacements (4.1) and the farthest weighted miss."""
    points = site_positions(skeleton, frames, goals.sites)
    J = jacobian(skeleton, frames, goals.sites.bones, points) / np.asarray(skeleton.costs, float)
    away = np.zeros_like(points)
    for i, weight in enumerate(goals.weights):
        if weight > 0:
            away[i] = goals.targets[i] - points[i]
        J[i] *= weight
    away = away * goals.weights[:, None]
    error = sdls.clamp_targets(away, 0.1 * arm_length(skeleton))
    farthest = float(np.max(np.linalg.norm(away, axis=1)))
    return J.reshape(-1, J.shape[-1]), error.ravel(), farthest


def ik_step(
    skeleton: Any,
    goals: Any,
    settings: Any,
    pose: Any,
    free: np.ndarray,
    secondary: Any = None,
    gain: float = 1.0,
) -> tuple[Pose, float, float]:
    """One iteration: the new pose, the largest weighted angle of the step, the old pose's miss.

    Args:
        skeleton: D degrees of freedom.
        goals: what is to be reached.
        settings: of inverse kinematics.
        pose: to start from.
        free: (6 + D,) degrees of freedom that may move.
        secondary: goals that are approached as far as the first hold.
        gain: factor on the secondary task and the secondary goals.
    """
    goals, free = as_goals(goals), np.asarray(free, bool)
    costs, gamma = np.asarray(skeleton.costs, float), float(settings.largest_step)
    frames = forward(skeleton, pose)
    J, error, missed = linearise_goals(skeleton, frames, goals)
    wanted = gain * costs * secondary_task(skeleton, frames, pose, settings)
    low, high = room(skeleton, pose)

    def step(moving: np.ndarray) -> np.ndarray:
        primary, projector = sdls.step(J * moving, error, gamma, RANK_TOLERANCE)
        beside = projector @ (wanted * moving)
        if secondary is not None:
            A, away, _ = linearise_goals(skeleton, frames, as_goals(secondary))
            A = (A * moving) @ projector
            rest = gain * away - A @ beside
            ridge = float(settings.elbows.deviation) ** 2 * np.eye(len(rest))
            beside = beside + A.T @ np.linalg.solve(A @ A.T + ridge, rest)
        return primary + sdls.clamp_max_abs(beside, gamma)

    psi = step(free)
    leaving = np.array(
        [
            f and ((p < lo and lo > -AT_LIMIT) or (p > hi and hi < AT_LIMIT))
            for f, p, lo, hi in zip(free, psi, low, high, strict=True)
        ]
    )
    if leaving.any():
        psi = step(free & ~leaving)
    psi = np.where(free, np.clip(psi, low, high), 0.0)
    return retract(pose, psi / costs), float(np.max(np.abs(psi))), missed


def room(skeleton: Any, pose: Any) -> tuple[np.ndarray, np.ndarray]:
    """How far each degree of freedom (6 + D,) may still turn down and up, weighted."""
    angles, limits = np.asarray(pose.angles, float), np.asarray(skeleton.limits, float)
    low = [-np.inf] * 6 + [min(lo - a, 0.0) for a, lo in zip(angles, limits[:, 0], strict=True)]
    high = [np.inf] * 6 + [max(hi - a, 0.0) for a, hi in zip(angles, limits[:, 1], strict=True)]
    costs = np.asarray(skeleton.costs, float)
    return np.array(low) * costs, np.array(high) * costs


def reach(
    skeleton: Any,
    goals: Any,
    settings: Any,
    pose: Any,
    free: np.ndarray | None = None,
    secondary: Any = None,
) -> tuple[Pose, int]:
    """Iterate until the goals are met, or the body rests; the pose and how often."""
    moving = np.ones(len(skeleton.costs), bool) if free is None else np.asarray(free, bool)
    following = int(settings.following)
    least = int(settings.settle) if secondary is None else following
    count, moved, pose = 0, np.inf, as_pose(pose)
    while count < least or (moved > float(settings.rest) and count < int(settings.iterations)):
        missed = linearise_goals(skeleton, forward(skeleton, pose), as_goals(goals))[2]
        if count >= least and missed <= float(settings.tolerance):
            break
        gain = 1.0 if secondary is None or count < following else 0.0
        pose, moved, _ = ik_step(skeleton, goals, settings, pose, moving, secondary, gain)
        count += 1
    return pose, count
