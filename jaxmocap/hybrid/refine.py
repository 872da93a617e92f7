"""Refinement of the markers' pose by the video (section 5).

The search says where each elbow is; the body follows it by inverse kinematics, with the markers
held, so that a shoulder that three markers placed wrongly moves as well; then a downhill simplex
over each arm's four degrees of freedom brings the outlines to the edges (section 5.2: the arms are
problems of their own, solved side by side).

INPUTS: the pose of ``solve``, its goals, an Observation, the belief.
OUTPUTS: the refined pose, the belief.
"""

import jax
import jax.numpy as jnp
from jax import Array

from jaxmocap.body.arms import Arms, arm_dofs, flesh, hang, limb_bones, swing
from jaxmocap.body.kinematics import Sites
from jaxmocap.body.pose import Pose, beyond_limits
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.evidence.edges import arm_cost
from jaxmocap.geometry.cameras import Camera
from jaxmocap.geometry.rotations import quaternion_log, rotate
from jaxmocap.hybrid.elbow_search import (
    Belief,
    believed_elbows,
    carried,
    search,
)
from jaxmocap.hybrid.ik import Goals
from jaxmocap.hybrid.observe import Observation
from jaxmocap.hybrid.settings import Settings
from jaxmocap.solvers.simplex import downhill_simplex, initial_simplex


def look_for_elbows(
    settings: Settings,
    cameras: Camera,
    arms: Arms,
    seen: Observation,
    belief: Belief,
    time: Array,
) -> tuple[Belief, Array]:
    """The belief after the video and the (2, 3) elbows to follow.

    A new image is searched; without one the last belief is carried on. Without the search, the
    elbows are those of the markers' pose.
    """

    def look() -> tuple[Belief, Array]:
        if not settings.search:
            return belief._replace(time=time), jnp.zeros_like(belief.turn)
        new = search(settings, cameras, seen, arms, belief, time)
        return new, new.turn

    def carry() -> tuple[Belief, Array]:
        return belief, carried(settings.look, belief, time)[0]

    belief, turn = jax.lax.cond(jnp.any(jnp.asarray(seen.seen)), look, carry)
    return belief, believed_elbows(arms, turn)


def elbow_wishes(skeleton: Skeleton, elbows: Array) -> Goals:
    """The (2, 3) elbows as goals of the second rank."""
    bones = limb_bones(skeleton.tree)[:, 1]
    sites = Sites(bones, jnp.zeros(2, elbows.dtype), jnp.zeros((2, 3), elbows.dtype))
    return Goals(sites, elbows, jnp.ones(2, elbows.dtype))


def refine_arms(
    settings: Settings,
    skeleton: Skeleton,
    cameras: Camera,
    observation: Observation,
    pose: Pose,
    grip_sites: Sites,
    grip_targets: Array,
    elbows: Array,
) -> Pose:
    """Minimise equation (14) over each arm's four degrees of freedom by the downhill simplex.

    An arm that no camera sees stays as it is.

    Args:
        settings: of the tracker.
        skeleton: D degrees of freedom.
        cameras: C, stacked.
        observation: of both arms.
        pose: to start from.
        grip_sites: the two points that the markers hold.
        grip_targets: (2, 3) t of equation (14), world, metres.
        elbows: (2, 3) that the search believes in.
    """
    fit, polish = settings.fit, settings.polish
    dofs = arm_dofs(skeleton.tree)
    by_arm = observation.by_arm()
    limits = skeleton.limits[dofs]
    hung = hang(skeleton, pose, grip_sites)

    def cost(moves: Array) -> Array:
        arms, angles = swing(hung, moves)
        seen = jax.vmap(lambda o, limbs: arm_cost(settings.evidence, fit, cameras, o, limbs))(
            by_arm, flesh(arms)
        )
        held = fit.hold * jnp.sqrt(jnp.sum((grip_targets - arms.grip) ** 2, -1) + 1e-12)
        beyond = jnp.sum(beyond_limits(limits, angles), -1)
        total = seen + held + polish.limit * beyond
        if not settings.search:
            return total
        return total + jnp.sum((arms.elbow - elbows) ** 2, -1) / polish.trust**2 / 2

    still = jnp.zeros_like(hung.angles)
    watched = jnp.any(by_arm.seen, -1)[:, None]

    def fitted() -> Array:
        lengths = jnp.full(4, polish.other_edge).at[0].set(polish.swivel_edge)
        first = initial_simplex(still, jnp.diag(lengths))
        moves = downhill_simplex(cost, first, polish.iterations).points
        angles = swing(hung, jnp.where(watched, moves, still))[1]
        return jnp.where(watched, jnp.clip(angles, limits[..., 0], limits[..., 1]), hung.angles)

    # Between two images there is nothing to fit.
    angles = jax.lax.cond(jnp.any(watched), fitted, lambda: hung.angles)
    return pose._replace(angles=pose.angles.at[dofs].set(angles))


def remember(belief: Belief, arms: Arms, found: Arms, seen: Observation, pose: Pose) -> Belief:
    """The belief with the turns from the markers' forearms to those found in a new image."""
    watched = jnp.any(jnp.asarray(seen.seen))
    turn = jnp.where(watched, turn_between(arms, found), belief.turn)
    return belief._replace(turn=turn, pose=pose)


def turn_between(arms: Arms, refined: Arms) -> Array:
    """Rotation vectors (2, 3) between two arms' forearms, in the frame of the first."""
    R = arms.R_world_radius
    a = rotate(R.swapaxes(1, 2), arms.elbow - arms.grip)
    b = rotate(R.swapaxes(1, 2), refined.elbow - refined.grip)
    return _shortest_turn(a, b)


def _shortest_turn(a: Array, b: Array) -> Array:
    """Rotation vectors (..., 3) of the shortest turns from (..., 3) ``a`` to ``b``."""
    a = a / jnp.sqrt(jnp.sum(a**2, -1, keepdims=True) + 1e-12)
    b = b / jnp.sqrt(jnp.sum(b**2, -1, keepdims=True) + 1e-12)
    half = jnp.concatenate([1 + jnp.sum(a * b, -1, keepdims=True), jnp.cross(a, b)], -1)
    norm = jnp.sqrt(jnp.sum(half**2, -1, keepdims=True) + 1e-12)
    return quaternion_log(half / norm)


def swivels(arms: Arms, refined: Arms) -> Array:
    """Turns (2,) of the elbows about the axis from shoulder to grip, radians."""
    axis = refined.grip - refined.shoulder
    axis = axis / jnp.sqrt(jnp.sum(axis**2, -1, keepdims=True) + 1e-12)

    def across(points: Array) -> Array:
        return points - jnp.sum(points * axis, -1, keepdims=True) * axis

    a, b = across(arms.elbow - arms.shoulder), across(refined.elbow - refined.shoulder)
    sine = jnp.sum(jnp.cross(a, b) * axis, -1)
    cosine = jnp.sum(a * b, -1)
    still = jnp.abs(sine) + jnp.abs(cosine) < 1e-9
    return jnp.where(still, 0.0, jnp.arctan2(sine, jnp.where(still, 1.0, cosine)))
