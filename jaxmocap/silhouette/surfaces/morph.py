"""Morphing: joints and skin that go along with the joints' angles (second paper, section 4.2).

    drivers     how far an arm is raised, or a joint's angle: numbers that all else follows
    joints      a shoulder's place on the chest follows its arm's elevation: the collar bone turns,
                and its motion carries the shoulder's three hinges along (4.21)
    skin        moves with the drivers: from one surface into another in correspondence (4.26), or
                about a place of a patch, by a radial basis function (4.28); all that one driver
                moves adds up to one field over the nodes

What follows is added to what moves freely: a collar bone's angle is that of its follower plus its
own, which the tracker holds about 0. Held firmly the joint goes where the paper puts it; loosely,
the images count too. A Pose has all angles, so that only the tracker depends on it.

INPUTS: a Morphing (``body.surfaces.morphing``); a skeleton, its surface; angles.
OUTPUTS: a Morph, the same as arrays; angles with and without what follows; moved points.
"""

from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.body.surfaces.morphing import WEIGHTINGS, Morphing
from jaxmocap.body.surfaces.surface import BodyPoints, Skin
from jaxmocap.body.tree import ROOT_DOF, Tree
from jaxmocap.geometry.rotations import HIGHEST


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Morph:
    """A morphing of one skeleton with D joints and one surface of N nodes, by S drivers."""

    # With indices of joints for names (static).
    drivers: tuple[tuple[tuple[int, ...], str], ...] = field(metadata={"static": True})
    follower_gains: Array  # (D, S) radians by drivers of 1; no driver is itself driven
    # (N, 3, S) metres by drivers of 1, in the bones' frames; None: no skin goes along.
    moves: Array | None


def morph_of(morphing: Morphing, tree: Tree, moves: np.ndarray | None = None) -> Morph:
    """A morphing with arrays for names.

    ``moves`` (N, 3, S) are of the nodes, in the order of ``morphing.drivers``, if skin goes along.

    Raises:
        KeyError: no such joint, or no such weighting; the message lists the valid ones.
        ValueError: a joint drives and follows.
    """
    drivers = morphing.drivers
    if unknown := [s.weighting for s in drivers if s.weighting not in WEIGHTINGS]:
        raise KeyError(f"unknown weighting {unknown[0]!r}; expected of {', '.join(WEIGHTINGS)}")
    follows = np.zeros((len(tree.joints), len(drivers)), np.float32)
    for each in morphing.followers:
        follows[tree.joint(each.joint), drivers.index(each.driver)] += each.gain
    rows = tuple((tuple(tree.joint(name) for name in s.joints), s.weighting) for s in drivers)
    for joint in {joint for joints, _ in rows for joint in joints}:
        if follows[joint].any():
            raise ValueError(f"{tree.joints[joint]} drives and follows: expected one of the two")
    skin = None if moves is None else jnp.asarray(moves, jnp.float32)
    return Morph(rows, jnp.asarray(follows), skin)


def driver_values(morph: Morph, angles: Array) -> Array:
    """The drivers' values (S,) at angles (D,), whole or free: drivers do not follow."""
    values = [
        WEIGHTINGS[weighting](
            angles[joints[0]]
            if len(joints) == 1
            else (1 - jnp.cos(angles[joints[0]]) * jnp.cos(angles[joints[1]])) / 2
        )
        for joints, weighting in morph.drivers
    ]
    return jnp.stack(values) if values else jnp.zeros(0, angles.dtype)


def driver_jacobian(morph: Morph, angles: Array) -> Array:
    """(S, 6 + D) derivatives of the drivers by the tangent vector of ``retract``."""
    by_angles = jax.jacfwd(lambda a: driver_values(morph, a))(angles)
    return jnp.pad(by_angles, ((0, 0), (ROOT_DOF, 0)))


def without_followers(morph: Morph, pose: Pose) -> Pose:
    """The pose without what follows: joints that do so keep their own angles."""
    return pose._replace(angles=pose.angles - _follow_angles(morph, pose.angles))


def with_followers(morph: Morph, free: Pose, skeleton: Skeleton) -> Pose:
    """The pose with what follows, within the limits: the inverse of ``without_followers``."""
    angles = free.angles + _follow_angles(morph, free.angles)
    return free._replace(angles=jnp.clip(angles, *skeleton.limits.T))


def _follow_angles(morph: Morph, angles: Array) -> Array:
    follows = morph.follower_gains.astype(angles.dtype)
    return jnp.matmul(follows, driver_values(morph, angles), precision=HIGHEST)


def followed_jacobian(morph: Morph, angles: Array) -> Array:
    """(6 + D, 6 + D) derivatives of a whole pose's tangent vector by the free one's."""
    slopes = driver_jacobian(morph, angles)
    follows = jnp.pad(morph.follower_gains.astype(angles.dtype), ((ROOT_DOF, 0), (0, 0)))
    return jnp.eye(len(follows), dtype=angles.dtype) + jnp.matmul(
        follows, slopes, precision=HIGHEST
    )


def moved_points(points: BodyPoints, moves: Array | np.ndarray, values: Array) -> BodyPoints:
    """Points that have gone along with the drivers' values (S,), by their moves (N, 3, S)."""
    gone = jnp.sum(jnp.asarray(moves) * values, -1)
    return points._replace(points_bone=jnp.asarray(points.points_bone) + gone[:, None])


def morphed_skin(skin: Skin, morph: Morph, angles: Array) -> Skin:
    """A skin that has gone along with a pose's angles."""
    if morph.moves is None:
        return skin
    gone = jnp.einsum("nas,s->an", morph.moves, driver_values(morph, angles), precision=HIGHEST)
    return skin._replace(rest=skin.rest + gone)
