"""Gradient refinement: the whole body by least squares, as a rival to the simplex.

Both arms together, and with them the trunk that carries the shoulders: three markers leave that
uncertain too. Half the squared sum of the residuals means what the simplex's cost means, in nats.
The solution is differentiable by lengths, cameras and marker offsets (implicit differentiation);
how much each point of an outline counts is settled at the start.

INPUTS: a pose to start from, what it is to meet, an Observation. OUTPUTS: the refined pose.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.custom_derivatives import SymbolicZero

from jaxmocap.body.arms import SIDES, arms_of, flesh, limb_bones
from jaxmocap.body.kinematics import (
    Sites,
    forward,
    jacobian,
    joined_sites,
    landmark_sites,
    site_positions,
)
from jaxmocap.body.pose import Pose, beyond_limits, retract
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.body.surfaces.cones import Cones
from jaxmocap.evidence.edges import trace_outline
from jaxmocap.evidence.occlusion import blockers, hidden
from jaxmocap.geometry.cameras import Camera
from jaxmocap.geometry.rotations import (
    HIGHEST,
    quaternion_log,
    quaternion_multiply,
    quaternion_to_matrix,
)
from jaxmocap.hybrid.ik import Goals
from jaxmocap.hybrid.observe import Observation
from jaxmocap.hybrid.settings import GradientSettings, Settings
from jaxmocap.images.regions import Region
from jaxmocap.solvers.status import Status

# Degrees of freedom of Student's t, by which a searched elbow may be wrong.
TAILS = 4.0
# A degree of freedom that is held may move by this share of its prior.
HELD = 1e-3


class Aims(NamedTuple):
    """What the body is to meet beside the edges.

    Attributes:
        goals: markers and held feet.
        elbows: (2, 3) that the search believes in, world, metres.
        centre: the pose that the priors are about.
        free: (6 + D,) degrees of freedom that may move.
    """

    goals: Goals
    elbows: Array
    centre: Pose
    free: Array


class Refined(NamedTuple):
    """How a refinement ended.

    Attributes:
        pose: refined.
        cost: () nats.
        steps: () made.
        status: () int32, a ``Status``.
    """

    pose: Pose
    cost: Array
    steps: Array
    status: Array


def refine_body(
    settings: Settings,
    skeleton: Skeleton,
    cameras: Camera,
    observation: Observation,
    start: Pose,
    grip_sites: Sites,
    aims: Aims,
) -> Refined:
    """The most likely pose near ``start``; the start itself where no camera sees an arm.

    Args:
        settings: of the tracker.
        skeleton: D degrees of freedom.
        cameras: C, stacked.
        observation: of both arms.
        start: a pose; nothing is differentiated through it.
        grip_sites: the two points that the markers hold.
        aims: what else is to be met.
    """
    # Here, since optimistix takes half a second to import, which the simplex does not need.
    from jaxmocap.solvers.least_squares import least_squares

    descent = settings.descent
    start, centre = jax.lax.stop_gradient((start, aims.centre))
    aims = aims._replace(centre=centre)
    scale = prior_deviations(skeleton, descent) * jnp.where(aims.free, 1.0, HELD)
    watched = jnp.any(jnp.asarray(observation.seen))
    weights = _outline_weights(settings, skeleton, cameras, observation, start, grip_sites)

    sites = body_sites(skeleton, aims.goals)

    def residuals(point: Array, args: None) -> Array:
        pose = retract(start, scale * point)
        bones = tuple(sites.bones.tolist())
        points = points_on(bones, skeleton, pose, sites.at, sites.offsets)
        ends, held = points[:8].reshape(2, 4, 3), points[8:]
        parts = (
            weights * outline_residuals(settings, skeleton, cameras, observation, ends),
            marker_residuals(descent, held, aims.goals),
            elbow_residuals(descent, ends[:, 1], aims.elbows) * float(settings.search),
            prior_residuals(descent, skeleton, pose, aims),
            limit_residuals(descent, skeleton, pose),
        )
        return jnp.concatenate([part.ravel() for part in parts])

    def solved() -> Refined:
        point, cost, steps, status = least_squares(
            residuals,
            jnp.zeros_like(scale),
            method=descent.method,
            largest_steps=descent.steps,
            relative=descent.tolerance,
            absolute=descent.tolerance,
        )
        pose = retract(start, scale * point)
        low, high = skeleton.limits.T
        return Refined(pose._replace(angles=jnp.clip(pose.angles, low, high)), cost, steps, status)

    def unsolved() -> Refined:
        none = jnp.zeros((), jnp.int32)
        return Refined(start, jnp.zeros((), scale.dtype), none, none + int(Status.CONVERGED))

    # Between two images there is nothing to fit.
    return jax.lax.cond(watched, solved, unsolved)


def prior_deviations(skeleton: Skeleton, settings: GradientSettings) -> Array:
    """Standard deviations (6 + D,) about the markers' pose, metres and radians."""
    groups = {"spine": settings.spine, "head": settings.neck, "leg": settings.leg}
    # Arms, shoulders, and what else a body has.
    joints = [groups.get(group, settings.arm) for group in skeleton.tree.groups_of_joints]
    return jnp.stack([settings.shift] * 3 + [settings.turn] * 3 + joints)


def body_sites(skeleton: Skeleton, goals: Goals) -> Sites:
    """Shoulder, elbow, wrist and tip of the left and the right arm, then the goals' points."""
    names = [f"{name}_{side}" for side in SIDES for name in ("shoulder", "elbow", "wrist", "hand")]
    return joined_sites(landmark_sites(skeleton, tuple(names)), goals.sites)


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def points_on(
    bones: tuple[int, ...], skeleton: Skeleton, pose: Pose, at: Array, offsets: Array
) -> Array:
    """Points (M, 3) on bones in the world, metres, with the geometric Jacobian as derivative.

    The same as pushing tangents along the tree, at a fifth of the time.

    Args:
        bones: M indices (static).
        skeleton: of the body.
        pose: of the body.
        at: (M,) fractions of the bones' lengths.
        offsets: (M, 3) metres, in the bones' frames.
    """
    sites = Sites(np.array(bones, np.int32), at, offsets)
    return site_positions(skeleton, forward(skeleton, pose), sites)


def _points_on_jvp(bones: tuple[int, ...], primals: tuple, tangents: tuple) -> tuple[Array, Array]:
    skeleton, pose, at, offsets = primals
    on = np.array(bones, np.int32)
    frames = forward(skeleton, pose)
    points = site_positions(skeleton, frames, Sites(on, at, offsets))
    change = jnp.zeros_like(points)
    if not _is_zero(tangents[1]):
        shift, spin, turns = _filled(tangents[1])
        back = pose.quaternion * jnp.array([1.0, -1.0, -1.0, -1.0], spin.dtype)
        step = jnp.concatenate([shift, 2 * quaternion_multiply(spin, back)[1:], turns])
        J = jacobian(skeleton, frames, on, points)
        change = jnp.einsum("mij,j->mi", J, step, precision=HIGHEST)
    # Bodies and markers have tangents only where somebody differentiates a solution by them.
    others = (tangents[0], *tangents[2:])
    if not _is_zero(others):

        def along_the_tree(skeleton: Skeleton, at: Array, offsets: Array) -> Array:
            return site_positions(skeleton, forward(skeleton, pose), Sites(on, at, offsets))

        primal = (skeleton, at, offsets)
        change = change + jax.jvp(along_the_tree, primal, _filled(others))[1]
    return points, change


points_on.defjvp(_points_on_jvp, symbolic_zeros=True)


def _symbolic(leaf: Any) -> bool:
    return isinstance(leaf, SymbolicZero)


def _is_zero(tangents: Any) -> bool:
    return all(map(_symbolic, jax.tree.leaves(tangents, is_leaf=_symbolic)))


def _filled(tangents: Any) -> Any:
    """Tangents with symbolic zeros as arrays."""

    def fill(leaf: Any) -> Array:
        return jnp.zeros(leaf.shape, leaf.dtype) if _symbolic(leaf) else leaf

    return jax.tree.map(fill, tangents, is_leaf=_symbolic)


def marker_residuals(settings: GradientSettings, points: Array, goals: Goals) -> Array:
    """Misses (M, 3) of the goals by (M, 3) points, in standard deviations; 0 without a goal."""
    weights = goals.weights[:, None]
    return jnp.where(weights > 0, weights * (goals.targets - points), 0.0) / settings.marker


def elbow_residuals(settings: GradientSettings, elbows: Array, believed: Array) -> Array:
    """Distances (2, 3) from the searched elbows, with the tails of Student's t."""
    away = (elbows - believed) / settings.elbow
    squared = jnp.sum(away**2, -1, keepdims=True) / TAILS
    near = squared < 1e-4
    slow = jnp.log1p(squared) / jnp.where(near, 1.0, squared)
    return away * jnp.sqrt(jnp.where(near, 1 - squared / 2, slow))


def prior_residuals(
    settings: GradientSettings, skeleton: Skeleton, pose: Pose, aims: Aims
) -> Array:
    """Distance (6 + D + 2,) from the centre and of the pelvis from the vertical."""
    back = aims.centre.quaternion * jnp.array([1.0, -1.0, -1.0, -1.0], pose.quaternion.dtype)
    moved = jnp.concatenate(
        [
            pose.position - aims.centre.position,
            quaternion_log(quaternion_multiply(pose.quaternion, back)),
            pose.angles - aims.centre.angles,
        ]
    )
    up = quaternion_to_matrix(pose.quaternion)[:2, 2]
    return jnp.concatenate([moved / prior_deviations(skeleton, settings), up / settings.lean])


def limit_residuals(settings: GradientSettings, skeleton: Skeleton, pose: Pose) -> Array:
    """By how much (D,) each joint is beyond its range."""
    return beyond_limits(skeleton.limits, pose.angles) / settings.limit


def outline_residuals(
    settings: Settings, skeleton: Skeleton, cameras: Camera, observation: Observation, ends: Array
) -> Array:
    """Root (2, C, 3, K) of twice the price of each outline point's distance from its edge.

    A distance d costs d^2 / (sqrt(d^2 + b^2) + b): square near the edge, then straight, and it
    levels out towards the truncation.

    Args:
        settings: of the tracker.
        skeleton: for the limbs' radii.
        cameras: C, stacked.
        observation: of both arms.
        ends: (2, 4, 3) shoulder, elbow, wrist and tip of both arms, world, metres.
    """
    bend, truncation = settings.descent.bend, settings.fit.truncation
    radii = skeleton.diameters[limb_bones(skeleton.tree)] / 2

    def of_camera(camera: Camera, region: Region, fields: Array, limbs: Cones) -> Array:
        traced = trace_outline(camera, region, fields, limbs)
        d = traced.distances_px * traced.metres_per_px
        steep = jnp.sqrt(d**2 + bend**2) + bend
        return d * jnp.sqrt(2 / (steep + d**2 / truncation) / settings.fit.edge_scale)

    return _each(of_camera, cameras, observation, Cones(ends[:, :3], ends[:, 1:], radii))


def _outline_weights(
    settings: Settings,
    skeleton: Skeleton,
    cameras: Camera,
    observation: Observation,
    start: Pose,
    grip_sites: Sites,
) -> Array:
    """Roots (2, C, 3, K) of the points' shares of their outline; 0 where one cannot be seen."""
    frames = forward(skeleton, start)
    arms = arms_of(skeleton, frames, grip_sites)

    def of_camera(
        camera: Camera, region: Region, fields: Array, limbs: tuple[Cones, Cones]
    ) -> Array:
        own, others = limbs
        traced = trace_outline(camera, region, fields, own)
        share = traced.weights / jnp.maximum(jnp.sum(traced.weights), 1e-6)
        return jnp.where(hidden(camera, own, traced.points, others), 0.0, share)

    limbs = (flesh(arms), blockers(skeleton, frames, arms))
    shares = _each(of_camera, cameras, observation, limbs)
    seen = jnp.asarray(observation.seen).T[..., None, None] & (shares > 0)
    return jnp.where(seen, jnp.sqrt(jnp.where(seen, shares, 1.0)), 0.0)


def _each(function, cameras: Camera, observation: Observation, limbs) -> Array:
    """A function of camera, region, fields and limbs, for each arm (2) in each camera (C)."""
    by_camera = jax.vmap(function, (0, 0, 0, None))
    by_arm = jax.vmap(by_camera, (None, 0, 0, 0))
    seen = observation.by_arm()
    return by_arm(cameras, seen.region, jnp.asarray(seen.fields), limbs)
