"""What goes along with a body's joints: other joints, places of the skin (second paper, 4.2).

INPUTS: a table like ``data/shoulder.toml``'s, or records made by hand. OUTPUTS: a Morphing.

The tracker makes arrays of it: ``silhouette.surfaces.morph``.
"""

import tomllib
from dataclasses import dataclass, field
from importlib import resources
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.surfaces.surface import Surface

# The patch that a body has once, not on each side.
TRUNK_PATCH = "torso"


def _square_root(t: Array) -> Array:
    """Steep at 0, where its derivative is given as 0."""
    above = t > 0
    return jnp.where(above, jnp.sqrt(jnp.where(above, t, 1.0)), 0.0)


# omega(t) of (4.26): 0 at 0, 1 at 1, as (4.24) has it; (4.25) as printed has it the other way. The
# root begins fast and ends slowly, the square vice versa.
WEIGHTINGS = {"linear": lambda t: t, "square_root": _square_root, "squared": lambda t: t * t}


class Driver(NamedTuple):
    """What drives others: the angle of a joint, or how far two joints raise the bone they swing."""

    # Names. One gives its angle, radians. Two hinges at right angles, flexion and abduction, give
    # (1 - cos cos) / 2: 0 with the arm hanging, 1 upright; it is smooth everywhere, as the angle of
    # elevation itself is not.
    joints: tuple[str, ...]
    # The omega of (4.26), a name of ``WEIGHTINGS``; others than linear are for drivers from 0 to 1.
    weighting: str = "linear"


class Follower(NamedTuple):
    """A joint that goes along."""

    joint: str  # its name
    driver: Driver  # by which
    gain: float  # radians, by a driver of 1


class Swelling(NamedTuple):
    """A place of the skin that goes along: equations (4.27) and (4.28)."""

    patch: str  # of the surface
    driver: Driver  # by which
    # (phi1, phi2): radians around the limb, and share of the way along it.
    centre: tuple[float, float]
    radii: tuple[float, float]  # the same; the function falls to 1/e there
    gain: float  # lambda, metres by a driver of 1
    # In the body's frame at rest; None for each node's own normal.
    direction: tuple[float, float, float] | None = None


@dataclass(frozen=True)
class Transition:
    """Another surface that the body's own goes over into: equation (4.26)."""

    driver: Driver  # at 0 the body has its own surface, at 1 the other
    # Of the same patches, node for node, around the same joints.
    to: Surface = field(repr=False, compare=False)
    patches: tuple[str, ...] = ()  # that go over; all of them without any


@dataclass(frozen=True)
class Morphing:
    """All that goes along; nothing by default."""

    followers: tuple[Follower, ...] = ()  # joints
    swellings: tuple[Swelling, ...] = ()  # places of the skin
    transitions: tuple[Transition, ...] = ()  # whole surfaces

    @property
    def drivers(self) -> tuple[Driver, ...]:
        """All drivers, each once."""
        every = [each.driver for each in (*self.followers, *self.swellings, *self.transitions)]
        return tuple(dict.fromkeys(every))


def shoulders() -> Morphing:
    """What goes along with raised arms: ``data/shoulder.toml``."""
    file = resources.files("jaxmocap.body").joinpath("data", "shoulder.toml")
    return morphing_of(tomllib.loads(file.read_text("utf-8")))


def morphing_of(table: dict) -> Morphing:
    """The joints and swellings of both sides from a table like ``data/shoulder.toml``'s."""
    followers, swellings = [], []
    for side, sign in (("l", 1.0), ("r", -1.0)):
        for row in table.get("joint", []):
            followers.append(Follower(f"{row['name']}_{side}", _driver(row, side), row["gain"]))
        swellings += [_swelling(row, side, sign) for row in table.get("swelling", [])]
    return Morphing(tuple(followers), tuple(swellings))


def _swelling(row: dict, side: str, sign: float) -> Swelling:
    """Limbs have a patch on each side, whose angles are counted outwards; a trunk has one."""
    single = row["patch"] == TRUNK_PATCH
    phi, wide = np.radians([row["centre"][0], row["radii"][0]])
    direction = row.get("direction")
    if direction is not None:
        direction = direction[0], sign * direction[1], direction[2]
    return Swelling(
        row["patch"] if single else f"{row['patch']}_{side}",
        _driver(row, side),
        (float(sign * phi if single else phi), row["centre"][1]),
        (float(wide), row["radii"][1]),
        row["gain"],
        direction,
    )


def _driver(row: dict, side: str) -> Driver:
    joints = tuple(f"{joint}_{side}" for joint in row["steered_by"])
    return Driver(joints, row.get("weighting", "linear"))
