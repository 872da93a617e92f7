"""Penetration: two parts of a body are never in the same place.

An arm that is lost often ends within the trunk: there it hides from every silhouette, and no
outline denies it. What flesh yields and a model errs is allowed for: of a limb that touches another
part the axis lies outside, and only so far as that is inside it is where it cannot be.

INPUTS: a surface of patches, poses. OUTPUTS: how much of limbs lies within other parts.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.surfaces.surface import BodyPoints, Surface
from jaxmocap.geometry.rotations import HIGHEST

# Nodes kept of a ring.
RING_NODES = 12
# Of the rings one in so many is kept.
RING_STRIDE = 6
# Where a limb is tested, shares of each bone's length: its root is joined to the trunk.
TESTED_SHARES = ((0.65, 0.9), (0.25, 0.75), (0.25, 0.75))
# Limb -> what else it cannot be in; thighs are joined to the trunk.
OBSTACLES = {"arm": ("torso", "leg"), "leg": ("leg",)}


class Obstacles(NamedTuple):
    """Parts of a body that a limb cannot be in, ring by ring.

    Attributes:
        nodes: (N, 3) in the world, metres.
        outwards: (N, 3) unit vectors from the rings' middles.
    """

    nodes: Array
    outwards: Array

    @classmethod
    def of(cls, nodes: Array) -> "Obstacles":
        """Of the points of ``obstacle_rings`` (N, 3) in the world."""
        grid = nodes.reshape(-1, RING_NODES, 3)
        away = (grid - jnp.mean(grid, 1, keepdims=True)).reshape(-1, 3)
        return cls(nodes, away / jnp.sqrt(jnp.sum(away**2, -1, keepdims=True) + 1e-12))


def obstacle_rings(surface: Surface, limb: str) -> BodyPoints:
    """Points of the parts that a limb cannot be in, ring by ring ``RING_NODES`` of each."""
    own = next(patch for patch in surface.patches if patch.name == limb)
    chosen = [
        patch.start + np.arange(0, patch.along, RING_STRIDE)[:, None] * patch.around
        + np.arange(RING_NODES) * patch.around // RING_NODES
        for patch in surface.patches if patch != own and patch.limb in OBSTACLES[own.limb]
    ]  # fmt: skip
    nodes = np.concatenate(chosen).ravel()
    return BodyPoints(*(np.asarray(part)[nodes] for part in surface.points))


def penetration_depths(points: Array, obstacles: Obstacles) -> Array:
    """(P,) metres that points (P, 3) lie below the obstacles' surface; negative outside."""
    middle = jnp.mean(obstacles.nodes, 0)
    nodes, outwards, points = obstacles.nodes - middle, obstacles.outwards, points - middle
    # Products of matrices and plain extrema: an argmin takes many times as long.
    apart = jnp.sum(nodes**2, -1) / 2 - jnp.matmul(points, nodes.T, precision=HIGHEST)
    deep = jnp.sum(nodes * outwards, -1) - jnp.matmul(points, outwards.T, precision=HIGHEST)
    nearest = apart <= jnp.min(apart, -1, keepdims=True)
    return jnp.max(jnp.where(nearest, deep, -jnp.inf), -1)


def penetrating_share(near: Array, far: Array, radii: Array, obstacles: Obstacles) -> Array:
    """() 0 to 1: how much of a limb, its bones' ends (B, 3), lies within obstacles.

    A place of it counts in full where its axis lies as deep as the limb is thick.
    """
    at = jnp.asarray(TESTED_SHARES, near.dtype)[..., None]
    points = near[:, None] + at * (far - near)[:, None]
    deep = penetration_depths(points.reshape(-1, 3), obstacles).reshape(points.shape[:2])
    return jnp.mean(jnp.clip(deep / jnp.maximum(radii, 0.01)[:, None], 0.0, 1.0))
