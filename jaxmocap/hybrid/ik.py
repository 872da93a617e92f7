"""Inverse kinematics: markers to pose (section 4, algorithm 1).

INPUTS: a Skeleton, marker targets (world, metres) with a mask, the last pose and stance.
OUTPUTS: the pose that meets the markers, the stance, and how the solve ended.
"""

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.kinematics import Frames, Sites, forward, jacobian, site_positions
from jaxmocap.body.mass import augmented_bodies
from jaxmocap.body.pose import Pose, relaxed_pose, retract
from jaxmocap.body.skeleton import ROOT_DOF, Skeleton
from jaxmocap.geometry.rotations import HIGHEST, quaternion_to_matrix, rotate
from jaxmocap.solvers.sdls import clamp_lengths, clamp_max_abs, project_secondary, sdls_step

SIDES = ("l", "r")


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class IKSettings:
    """What a user may tune; all traced.

    Attributes:
        iterations: most iterations of algorithm 1 in a frame.
        settle: iterations that every frame makes, so that the secondary task acts while the
            markers are met.
        tolerance: distance at which an effector is at its target, metres.
        largest_step: Gamma of equation (8), in weighted radians.
        relaxation: gain of the secondary task (9).
        uprightness: gain of the pull of the pelvis to the upright, in the same projection.
        floor: height of the ground, metres.
        stance_radius: the head's farthest horizontal distance from the middle between the feet
            before they are planted anew, as a fraction of the leg's length.
        leg_overstretch: distance by which a held foot is missed before it is planted anew, metres.
    """

    iterations: Array
    settle: Array
    tolerance: Array
    largest_step: Array
    relaxation: Array
    uprightness: Array
    floor: Array
    stance_radius: Array
    leg_overstretch: Array

    @classmethod
    def create(
        cls,
        iterations: int = 30,
        settle: int = 4,
        tolerance: float = 1e-3,
        largest_step: float = np.pi / 4,
        relaxation: float = 0.9,
        uprightness: float = 0.1,
        floor: float = 0.0,
        stance_radius: float = 0.45,
        leg_overstretch: float = 0.03,
    ) -> "IKSettings":
        """Settings as arrays (a Python float in a pytree would trace anew)."""
        counts = (jnp.asarray(iterations, jnp.int32), jnp.asarray(settle, jnp.int32))
        numbers = (tolerance, largest_step, relaxation, uprightness, floor)
        rest = (stance_radius, leg_overstretch)
        return cls(*counts, *(jnp.asarray(value, float) for value in (*numbers, *rest)))


class Effectors(NamedTuple):
    """Everything that is held somewhere: M markers, then the feet that carry none.

    Attributes:
        sites: (M + F) points on bones.
        held: sides ("l", "r") of the F feet held where they stand.
    """

    sites: Sites
    held: tuple[str, ...]


class Stance(NamedTuple):
    """Where the feet stand.

    Attributes:
        ankles: (2, 3) left and right, world, metres.
        overstretched: () whether a held foot was missed in the last frame.
    """

    ankles: Array
    overstretched: Array


class IKResult(NamedTuple):
    """How a solve ended.

    Attributes:
        pose: that meets the targets.
        stance: of the feet.
        distances: (M + F,) metres from effector to target; 0 where there is no target.
        iterations: () made.
        planted: () whether the feet were planted anew in this frame.
    """

    pose: Pose
    stance: Stance
    distances: Array
    iterations: Array
    planted: Array


def effectors(skeleton: Skeleton, markers: Sites) -> Effectors:
    """Markers, and the ankles of those feet that carry no marker on tibia or foot."""
    bones = {skeleton.tree.bones[bone] for bone in markers.bones}
    held = tuple(s for s in SIDES if not bones & {f"tibia_{s}", f"foot_{s}"})
    feet = np.array([skeleton.tree.bone(f"foot_{side}") for side in held], int)
    zeros = jnp.zeros(len(held), markers.at.dtype)
    sites = Sites(
        np.concatenate([markers.bones, feet]),
        jnp.concatenate([markers.at, zeros]),
        jnp.concatenate([markers.offsets, jnp.zeros((len(held), 3), markers.at.dtype)]),
    )
    return Effectors(sites, held)


def secondary_task(skeleton: Skeleton, frames: Frames, pose: Pose, settings: IKSettings) -> Array:
    """The step (6 + D,), unweighted, towards the relaxed pose: equation (9), and to the upright.

    m_i h_i is normalised by its sum, so that the gain is below 1 in any units. The root has no
    relaxed angle; its lean from the vertical is turned back.
    """
    bodies = augmented_bodies(skeleton, frames)
    effort = bodies.masses * bodies.arms
    share = effort / jnp.sum(effort)
    relaxing = -2 * settings.relaxation * share * (pose.angles - skeleton.relaxed)
    up = quaternion_to_matrix(pose.quaternion)[:, 2]
    lean = jnp.cross(up, jnp.array([0.0, 0.0, 1.0], up.dtype))
    return jnp.concatenate([jnp.zeros(3, up.dtype), settings.uprightness * lean, relaxing])


def ik_step(
    skeleton: Skeleton, sites: Sites, settings: IKSettings, pose: Pose, targets: Array, mask: Array
) -> Pose:
    """One iteration of algorithm 1 from ``pose`` towards ``targets`` (M, 3) where ``mask`` (M,)."""
    frames = forward(skeleton, pose)
    points = site_positions(skeleton, frames, sites)
    arm = jnp.sum(skeleton.lengths[np.array(_arm(skeleton))])
    error = clamp_lengths(jnp.where(mask[:, None], targets - points, 0.0), 0.1 * arm)
    J = jacobian(skeleton, frames, sites.bones, points) / skeleton.costs
    J = jnp.where(mask[:, None, None], J, 0.0).reshape(-1, J.shape[-1])
    wanted = skeleton.costs * secondary_task(skeleton, frames, pose, settings)
    low, high = _room(skeleton, pose)

    def step(free: Array) -> Array:
        # Equation (1) in the weighted coordinates psi = mu * theta.
        solved = sdls_step(jnp.where(free, J, 0.0), error.ravel(), settings.largest_step)
        secondary = project_secondary(solved.row_space, jnp.where(free, wanted, 0.0))
        return solved.primary + clamp_max_abs(secondary, settings.largest_step)

    psi = step(jnp.ones_like(low, bool))
    # A degree of freedom that would leave its range leaves the problem, and the rest solve it.
    blocked = (psi < low - 1e-6) & (low > -1e-3) | (psi > high + 1e-6) & (high < 1e-3)
    psi = jax.lax.cond(jnp.any(blocked), lambda: step(~blocked), lambda: psi)
    return retract(pose, jnp.clip(psi, low, high) / skeleton.costs)


def _room(skeleton: Skeleton, pose: Pose) -> tuple[Array, Array]:
    """How far each degree of freedom (6 + D,) may still turn down and up, weighted."""
    free = jnp.full(ROOT_DOF, jnp.inf, pose.angles.dtype)
    low = jnp.minimum(skeleton.limits[:, 0] - pose.angles, 0.0)
    high = jnp.maximum(skeleton.limits[:, 1] - pose.angles, 0.0)
    weights = skeleton.costs
    return jnp.concatenate([-free, low]) * weights, jnp.concatenate([free, high]) * weights


def _arm(skeleton: Skeleton) -> list[int]:
    return [skeleton.tree.bone(name) for name in ("humerus_l", "radius_l", "hand_l")]


def solve_ik(
    skeleton: Skeleton,
    held: Effectors,
    settings: IKSettings,
    pose: Pose,
    stance: Stance,
    targets: Array,
    mask: Array,
) -> IKResult:
    """Algorithm 1: iterate from ``pose`` until the effectors are at their targets.

    Args:
        skeleton: D degrees of freedom.
        held: M markers and F held feet.
        settings: traced.
        pose: to start from.
        stance: of the feet in the last frame.
        targets: (M, 3) marker positions, world, metres; anything where missing.
        mask: (M,) which markers are seen.
    """
    stance, planted = _replant(skeleton, held, settings, pose, stance, targets, mask)
    feet = [SIDES.index(side) for side in held.held]
    goals = jnp.concatenate([targets, stance.ankles[np.array(feet, int)]])
    seen = jnp.concatenate([mask, jnp.ones(len(feet), bool)])

    def distances(pose: Pose) -> Array:
        points = site_positions(skeleton, forward(skeleton, pose), held.sites)
        return jnp.where(seen, jnp.linalg.norm(jnp.where(seen[:, None], goals - points, 1.0), axis=-1), 0.0)

    def unfinished(carry: tuple[Array, Pose, Array]) -> Array:
        count, _, misses = carry
        away = jnp.max(misses) > settings.tolerance
        return (count < settings.settle) | (away & (count < settings.iterations))

    def iterate(carry: tuple[Array, Pose, Array]) -> tuple[Array, Pose, Array]:
        count, pose, _ = carry
        pose = ik_step(skeleton, held.sites, settings, pose, goals, seen)
        return count + 1, pose, distances(pose)

    start = (jnp.zeros((), jnp.int32), pose, distances(pose))
    count, pose, misses = jax.lax.while_loop(unfinished, iterate, start)
    missed = jnp.max(misses[len(mask) :], initial=0.0) > settings.leg_overstretch
    return IKResult(pose, stance._replace(overstretched=missed), misses, count, planted)


def _replant(
    skeleton: Skeleton,
    held: Effectors,
    settings: IKSettings,
    pose: Pose,
    stance: Stance,
    targets: Array,
    mask: Array,
) -> tuple[Stance, Array]:
    """Plant the held feet below the head where it has left them, or a leg was overstretched."""
    if not held.held:
        return stance, jnp.zeros((), bool)
    above, known = _head_target(skeleton, held, targets, mask)
    middle = jnp.mean(stance.ankles, 0)
    leg = skeleton.lengths[skeleton.tree.bone("femur_l")] + skeleton.lengths[skeleton.tree.bone("tibia_l")]
    away = jnp.sum((above - middle)[:2] ** 2) > (settings.stance_radius * leg) ** 2
    planted = known & (away | stance.overstretched)
    anew = stand_below(skeleton, settings, above, quaternion_to_matrix(pose.quaternion)[:, 1])
    ankles = jnp.where(planted, anew, stance.ankles)
    return Stance(ankles, jnp.zeros((), bool)), planted


def _head_target(
    skeleton: Skeleton, held: Effectors, targets: Array, mask: Array
) -> tuple[Array, Array]:
    """Mean (3,) of the seen markers on head or neck, and whether there is one."""
    names = skeleton.tree.bones
    on_head = np.array([names[b] in ("head", "neck") for b in held.sites.bones[: len(mask)]])
    chosen = mask & on_head
    total = jnp.sum(jnp.where(chosen[:, None], targets, 0.0), 0)
    return total / jnp.maximum(jnp.sum(chosen), 1).astype(total.dtype), jnp.any(chosen)


def stand_below(skeleton: Skeleton, settings: IKSettings, above: Array, left: Array) -> Array:
    """Ankles (2, 3) on the ground, hip-width apart along ``left`` (3,), below a point."""
    level = left.at[2].set(0.0)
    level = level / jnp.maximum(jnp.linalg.norm(level), 1e-6)
    hip = skeleton.lengths[skeleton.tree.bone("hip_l")]
    ankle = skeleton.diameters[skeleton.tree.bone("foot_l"), 0]
    ground = above.at[2].set(settings.floor + ankle)
    return jnp.stack([ground + hip * level, ground - hip * level])


def place(
    skeleton: Skeleton, held: Effectors, settings: IKSettings, targets: Array, mask: Array
) -> tuple[Pose, Stance]:
    """The relaxed pose, placed by the markers in closed form.

    The body is shifted and turned about the vertical so that its effectors lie nearest to the
    markers in the least-squares sense (a planar Procrustes problem); of the two answers that a
    symmetric marker set may leave, rounding decides nothing: left and right are labelled. Without
    two markers apart from each other horizontally the heading stays +x.
    """
    pose = relaxed_pose(skeleton)
    sites = Sites(*(part[: len(mask)] for part in held.sites))
    points = site_positions(skeleton, forward(skeleton, pose), sites)
    weight = mask.astype(points.dtype)[:, None] / jnp.maximum(jnp.sum(mask), 1).astype(points.dtype)
    seen = jnp.where(mask[:, None], targets, 0.0)
    mean_body, mean_world = jnp.sum(weight * points, 0), jnp.sum(weight * seen, 0)
    a, b = points - mean_body, jnp.where(mask[:, None], seen - mean_world, 0.0)
    cosine = jnp.sum(weight[:, 0] * (a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1]))
    sine = jnp.sum(weight[:, 0] * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]))
    yaw = jnp.arctan2(sine, jnp.where(jnp.abs(cosine) + jnp.abs(sine) < 1e-6, 1.0, cosine))
    zero = jnp.zeros_like(yaw)
    quaternion = jnp.stack([jnp.cos(yaw / 2), zero, zero, jnp.sin(yaw / 2)])
    R = quaternion_to_matrix(quaternion)
    above, known = _head_target(skeleton, held, targets, mask)
    head = landmark_above(skeleton, pose)
    by_head = above - rotate(R, head)
    position = jnp.where(known, by_head, mean_world - rotate(R, mean_body))
    pose = Pose(position, quaternion, pose.angles)
    ankles = stand_below(skeleton, settings, position, R[:, 1])
    return pose, Stance(ankles, jnp.zeros((), bool))


def landmark_above(skeleton: Skeleton, pose: Pose) -> Array:
    """The head bone's far end (3,) of a pose."""
    frames = forward(skeleton, pose)
    head = skeleton.tree.bone("head")
    along = skeleton.lengths[head] * skeleton.directions[head]
    return frames.joints_world[head] + jnp.matmul(frames.R_world_bone[head], along, precision=HIGHEST)
