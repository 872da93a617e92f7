"""Several hypotheses of where a limb is, by a particle filter (second paper, section 5).

A limb that was hidden, or too fast, may be far from where one hypothesis looks for it: its rim
finds the contour of something else, and stays there. Where the images show person that no part of
the body explains, within a limb's reach, its particles are spread, weighed by what they would
explain, drawn again in proportion (systematic resampling), and so once more with less spread; fits
then start from the best, and from the best elsewhere. Particles live on from frame to frame as long
as the limb may be elsewhere.

INPUTS: a pose, what the images show of a limb, see ``limb_likelihood``.
OUTPUTS: the limb's likeliest angles in some places, what they explain, the particles for the next
frame.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.geometry.cameras import Camera
from jaxmocap.silhouette.recovery.limb_likelihood import (
    LEAST_VISIBLE,
    LimbEvidence,
    explained_log_ratio,
)
from jaxmocap.silhouette.recovery.limbs import LimbChain, with_angles

# Of the particles so many are drawn evenly from all of the joints' ranges, at first.
UNIFORM_SHARE = 0.35
# Deviations of the others about those before, layer by layer, radians,
SPREADS = (0.5, 0.25, 0.1)
# and by what a log-ratio counts in the weights.
INVERSE_TEMPERATURES = (4.0, 10.0, 25.0)
# Of an angle about the pose given, radians: of two that explain alike, the nearer.
ANGLE_DEVIATION = 2.0
# So many particles are fitted.
FITTED_PARTICLES = 3
# They differ by so much in their angles' root mean square, radians.
DISTINCT_RAD = 0.5


class LimbSearchResult(NamedTuple):
    """What a search found."""

    particles: Array  # (P, K) angles, for the next frame
    # (H, K) angles of the best, and of the best that are elsewhere than those before them.
    best: Array
    gains: Array  # (H,) what they explain: the mean log-ratio where the limb would be visible
    baseline: Array  # () what they must explain more than, see ``explained_log_ratio``


@jax.jit
def search_limb(
    skeleton: Skeleton,
    cameras: Camera,
    pose: Pose,
    limb: LimbChain,
    evidence: LimbEvidence,
    particles: Array,
    key: Array,
) -> LimbSearchResult:
    """Search a limb's angles, from particles (P, K) of the frame before.

    Those are the pose's own where the limb was in its place. The same key gives the same.
    """
    here, limits = pose.angles[limb.joints], skeleton.limits[limb.joints]

    def explained(pose: Pose, least: float = -math.inf) -> Array:
        return explained_log_ratio(skeleton, cameras, pose, limb, evidence, least)

    def weigh(angles: Array) -> tuple[Array, Array]:
        gains = jax.vmap(lambda each: explained(with_angles(pose, limb, each)))(angles)
        distance = jnp.mean((angles - here) ** 2, -1) / ANGLE_DEVIATION**2
        return gains, gains - distance / 2

    left, angles, gains, scores = _layers(particles, key, limits, weigh)
    best = distinct_particles(angles, scores)
    return LimbSearchResult(left, angles[best], gains[best], explained(pose, LEAST_VISIBLE))


def _layers(
    particles: Array,
    key: Array,
    limits: Array,
    weigh: Callable[[Array], tuple[Array, Array]],
) -> tuple[Array, Array, Array, Array]:
    """Particles (P, K) after all layers; angles (N, K), gains and scores (N,) of every layer's.

    ``limits`` (K, 2) are of their angles; ``weigh`` gives gains and scores (P,) of angles (P, K).
    """
    low, high = limits.T

    def layer(carry: tuple[Array, Array], numbers: tuple) -> tuple[tuple[Array, Array], tuple]:
        old, uniform_share = carry
        key, spread, inverse_temperature = numbers
        fresh, moving, choosing, drawing = jax.random.split(key, 4)
        # About the old ones, a share of them anywhere.
        moved = old + spread * jax.random.normal(moving, old.shape, old.dtype)
        anywhere = low + (high - low) * jax.random.uniform(fresh, old.shape, old.dtype)
        is_fresh = jax.random.uniform(choosing, (len(old), 1), old.dtype) < uniform_share
        angles = jnp.clip(jnp.where(is_fresh, anywhere, moved), low, high)
        gains, scores = weigh(angles)
        weights = jax.nn.softmax(inverse_temperature * scores)
        kept = angles[systematic_resampling(drawing, weights)]
        return (kept, jnp.zeros_like(uniform_share)), (angles, gains, scores)

    dtype = particles.dtype
    spreads = jnp.asarray(SPREADS, dtype)
    temperatures = jnp.asarray(INVERSE_TEMPERATURES, dtype)
    keys = jax.random.split(key, len(spreads))
    carry = particles, jnp.asarray(UNIFORM_SHARE, dtype)
    (left, _), layers = jax.lax.scan(layer, carry, (keys, spreads, temperatures))
    angles, gains, scores = (jnp.concatenate(part) for part in layers)
    return left, angles, gains, scores


def distinct_particles(angles: Array, scores: Array) -> Array:
    """(H,) indices of the best of particles (N, K), ``DISTINCT_RAD`` from those before each."""
    chosen = []
    for _ in range(FITTED_PARTICLES):
        chosen.append(jnp.argmax(scores))
        distance = jnp.sqrt(jnp.mean((angles - angles[chosen[-1]]) ** 2, -1))
        scores = jnp.where(distance < DISTINCT_RAD, -jnp.inf, scores)
    return jnp.stack(chosen)


def systematic_resampling(key: Array, weights: Array) -> Array:
    """(P,) indices drawn in proportion to weights (P,) that add up to 1: one number for all.

    Each is drawn as often as its weight times P says, rounded up or down.
    """
    count = len(weights)
    start = jax.random.uniform(key, (), weights.dtype)
    places = (jnp.arange(count, dtype=weights.dtype) + start) / count
    return jnp.minimum(jnp.searchsorted(jnp.cumsum(weights), places), count - 1)
