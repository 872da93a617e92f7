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

INPUTS: a Morphing, of a file or made by hand; a skeleton, its surface; angles.
OUTPUTS: a Morph, the same as arrays; angles with and without what follows; moved points.
"""

import tomllib
from dataclasses import dataclass, field
from importlib import resources
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.body.surfaces.surface import BodyPoints, Skin, Surface
from jaxmocap.body.tree import ROOT_DOF, Tree
from jaxmocap.geometry.rotations import HIGHEST


class Driver(NamedTuple):
    """What drives others: one joint by its angle, or two that swing a bone by how far it is raised.

    Attributes:
        joints: names. One gives its angle, radians. Two hinges at right angles, flexion and
            abduction, give (1 - cos cos) / 2: 0 with the arm hanging, 1 upright; it is smooth
            everywhere, as the angle of elevation itself is not.
        weighting: omega of (4.26), a name of ``WEIGHTINGS``; others than linear are for drivers
            from 0 to 1.
    """

    joints: tuple[str, ...]
    weighting: str = "linear"


class Follower(NamedTuple):
    """A joint that goes along.

    Attributes:
        joint: its name.
        driver: by which.
        gain: radians, by a driver of 1.
    """

    joint: str
    driver: Driver
    gain: float


class Swelling(NamedTuple):
    """A place of the skin that goes along: equations (4.27) and (4.28).

    Attributes:
        patch: of the surface.
        driver: by which.
        centre: phi1, radians around the limb, and phi2, share of the way along it.
        radii: the same; the function falls to 1/e there.
        gain: lambda, metres by a driver of 1.
        direction: in the body's frame at rest; None for each node's own normal.
    """

    patch: str
    driver: Driver
    centre: tuple[float, float]
    radii: tuple[float, float]
    gain: float
    direction: tuple[float, float, float] | None = None


@dataclass(frozen=True)
class Transition:
    """Another surface that the body's own goes over into: equation (4.26).

    Attributes:
        driver: at 0 the body has its own surface, at 1 the other.
        to: of the same patches, node for node, around the same joints.
        patches: that go over; all of them without any.
    """

    driver: Driver
    to: Surface = field(repr=False, compare=False)
    patches: tuple[str, ...] = ()


@dataclass(frozen=True)
class Morphing:
    """All that goes along; nothing by default.

    Attributes:
        followers: joints.
        swellings: places of the skin.
        transitions: whole surfaces.
    """

    followers: tuple[Follower, ...] = ()
    swellings: tuple[Swelling, ...] = ()
    transitions: tuple[Transition, ...] = ()

    @property
    def drivers(self) -> tuple[Driver, ...]:
        """All drivers, each once."""
        every = [each.driver for each in (*self.followers, *self.swellings, *self.transitions)]
        return tuple(dict.fromkeys(every))


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Morph:
    """A morphing of one skeleton with D joints and one surface of N nodes, by S drivers.

    Attributes:
        drivers: with indices of joints for names (static).
        follower_gains: (D, S) radians by drivers of 1; no driver is itself driven.
        moves: (N, 3, S) metres by drivers of 1, in the bones' frames; None: no skin goes along.
    """

    drivers: tuple[tuple[tuple[int, ...], str], ...] = field(metadata={"static": True})
    follower_gains: Array
    moves: Array | None


def _square_root(t: Array) -> Array:
    """Steep at 0, where its derivative is given as 0."""
    above = t > 0
    return jnp.where(above, jnp.sqrt(jnp.where(above, t, 1.0)), 0.0)


# omega(t) of (4.26): 0 at 0, 1 at 1. The root begins fast and ends slowly, the square vice versa.
WEIGHTINGS = {"linear": lambda t: t, "square_root": _square_root, "squared": lambda t: t * t}


def morph_of(morphing: Morphing, tree: Tree, moves: np.ndarray | None = None) -> Morph:
    """A morphing with arrays for names.

    Args:
        morphing: what goes along.
        tree: of the skeleton.
        moves: (N, 3, S) of the nodes, in the order of ``morphing.drivers``, if skin goes along.

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
    return pose._replace(angles=pose.angles - _followed(morph, pose.angles))


def with_followers(morph: Morph, free: Pose, skeleton: Skeleton) -> Pose:
    """The pose with what follows, within the limits: the inverse of ``without_followers``."""
    angles = free.angles + _followed(morph, free.angles)
    low, high = skeleton.limits[:, 0], skeleton.limits[:, 1]
    return free._replace(angles=jnp.clip(angles, low, high))


def _followed(morph: Morph, angles: Array) -> Array:
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


def shoulders() -> Morphing:
    """What goes along with raised arms: ``data/shoulder.toml``."""
    file = resources.files("jaxmocap.body").joinpath("data", "shoulder.toml")
    return morphing_of(tomllib.loads(file.read_text("utf-8")))


def morphing_of(table: dict) -> Morphing:
    """A morphing of both sides from a table like ``data/shoulder.toml``'s."""
    followers, swellings = [], []
    for side, sign in (("l", 1.0), ("r", -1.0)):
        for row in table.get("joint", []):
            followers.append(Follower(f"{row['name']}_{side}", _driver(row, side), row["gain"]))
        for row in table.get("swelling", []):
            # Limbs have a patch on each side, whose angles are counted outwards; a trunk has one.
            single = row.get("single", False)
            patch = row["patch"] if single else f"{row['patch']}_{side}"
            phi, wide = np.radians([row["centre"][0], row["radii"][0]])
            centre = float(sign * phi if single else phi), row["centre"][1]
            radii = float(wide), row["radii"][1]
            swellings.append(Swelling(patch, _driver(row, side), centre, radii, row["gain"]))
    return Morphing(tuple(followers), tuple(swellings))


def _driver(row: dict, side: str) -> Driver:
    joints = tuple(f"{joint}_{side}" for joint in row["steered_by"])
    return Driver(joints, row.get("weighting", "linear"))
