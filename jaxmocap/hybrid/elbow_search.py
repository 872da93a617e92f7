"""Global search for each elbow, with memory.

Markers hold the hand; what they leave open is where the forearm points. Candidates turn the
forearm about its grip, on a fixed grid of directions around the markers' pose; the upper arm
follows, and the shoulder, which three markers leave uncertain, may give way at a price. A discrete
Bayes filter carries the belief over the grid from frame to frame: ambiguous frames keep several
answers alive, and the next clear one decides.

INPUTS: the arms of the markers' pose, an Observation, the belief. OUTPUTS: the belief, the
forearm's turn that it expects.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy.spatial.transform import Rotation

from jaxmocap.body.arms import TURNS, Arms, flesh, turn_forearm
from jaxmocap.body.pose import Pose
from jaxmocap.compilation.arrays import on_device
from jaxmocap.evidence.edges import EdgeFields
from jaxmocap.geometry.cameras import Camera
from jaxmocap.geometry.rotations import HIGHEST, compose, exp
from jaxmocap.hybrid.settings import ElbowSearchSettings, Settings


class ElbowBelief(NamedTuple):
    """Where each arm's forearm may be, left and right: a discrete Bayes filter's state."""

    log_weights: Array  # (2, K) of the candidates, largest 0
    # (2, 3) rotation vector from the markers' forearm to the expected one, in the markers'
    # forearm's frame, radians.
    turn: Array
    deviation: Array  # (2,) standard deviation of the elbow, metres
    age: Array  # () of the last image, seconds
    pose: Pose  # the last refined one


R_TURNS = Rotation.from_rotvec(TURNS).as_matrix()
# How far apart two candidates' elbows are on a forearm of one metre.
CHORDS = 2 * np.sin(np.minimum(np.linalg.norm(TURNS[:, None] - TURNS, axis=-1), np.pi) / 2)


def no_belief(settings: ElbowSearchSettings, pose: Pose) -> ElbowBelief:
    """Before the first image: the markers' pose is as good as its prior."""
    dtype = pose.angles.dtype
    weights, turn, age = (on_device(np.zeros(n), dtype) for n in ((2, len(TURNS)), (2, 3), ()))
    return ElbowBelief(weights, turn, jnp.broadcast_to(settings.elbow_prior, (2,)), age, pose)


def search(
    settings: Settings, cameras: Camera, fields: EdgeFields, arms: Arms, belief: ElbowBelief
) -> ElbowBelief:
    """One step of the filter for both arms; an arm without an image keeps drifting to its prior.

    Args:
        settings: of the tracker.
        cameras: C, stacked.
        fields: of both arms.
        arms: of the markers' pose.
        belief: before the image.
    """
    elapsed = jnp.maximum(belief.age, 1e-3)

    def of_arm(arm: Arms, own: EdgeFields, log_weights: Array) -> tuple[Array, Array, Array]:
        costs, elbows = _candidate_costs(settings, cameras, own, arm)
        drifted = _drift(settings.elbow_search, arm, log_weights, elapsed)
        posterior = drifted - costs
        posterior = posterior - jnp.max(posterior)
        share = jax.nn.softmax(posterior)
        turn = jnp.matmul(share, jnp.asarray(TURNS, share.dtype), precision=HIGHEST)
        mean = jnp.matmul(share, elbows, precision=HIGHEST)
        deviation = jnp.sqrt(jnp.sum(share * jnp.sum((elbows - mean) ** 2, -1)))
        return posterior, turn, deviation

    result = jax.vmap(of_arm)(arms, fields.by_arm(), belief.log_weights)
    return ElbowBelief(*result, jnp.zeros_like(belief.age), belief.pose)


def _candidate_costs(
    settings: Settings, cameras: Camera, fields: EdgeFields, arm: Arms
) -> tuple[Array, Array]:
    """Costs (K,) in nats of one arm's candidates, and their elbows (K, 3)."""
    R, own = arm.R_world_radius, settings.elbow_search
    turns = compose(compose(R, jnp.asarray(R_TURNS, R.dtype)), R.T)
    moved, slack = turn_forearm(arm, turns)
    edges = settings.edges.arm_cost(cameras, fields, flesh(moved), flesh(arm))
    away = jnp.sum((moved.elbow - arm.elbow) ** 2, -1) / own.elbow_prior**2
    # Student's t with three degrees of freedom: markers alone may be far off.
    prior = 2 * jnp.log1p(away / 3)
    return edges + (slack / own.shoulder_slack) ** 2 / 2 + prior, moved.elbow


def _drift(settings: ElbowSearchSettings, arm: Arms, log_weights: Array, elapsed: Array) -> Array:
    """Log-weights (K,) before the image: each candidate's share spreads with the elbow's speed."""
    squared = jnp.asarray(CHORDS**2, arm.elbow.dtype)
    forearm = jnp.sum((arm.elbow - arm.grip) ** 2)
    price = squared * (forearm / (settings.elbow_speed * elapsed) ** 2 / 2)
    kernel = jnp.exp(-jnp.minimum(price, settings.surprise))
    # It is symmetric, and each share is spread whole.
    total = jnp.matmul(kernel, jnp.ones_like(log_weights), precision=HIGHEST)
    spread = jnp.matmul(kernel, jax.nn.softmax(log_weights) / total, precision=HIGHEST)
    return jnp.log(spread + 1e-20)


def expected_elbows(arms: Arms, turn: Array) -> Array:
    """Elbows (2, 3) of the markers' arms with their forearms turned by (2, 3) ``turn``."""

    def of_arm(arm: Arms, vector: Array) -> Array:
        R = arm.R_world_radius
        return turn_forearm(arm, compose(compose(R, exp(vector)), R.T))[0].elbow

    return jax.vmap(of_arm)(arms, turn)


def without_image(settings: ElbowSearchSettings, belief: ElbowBelief) -> tuple[Array, Array]:
    """The belief between images: turns (2, 3) that fade out, and a deviation (2,) that grows."""
    fading = jnp.exp(-((belief.age / settings.fading) ** 2))
    drift = settings.drift * settings.elbow_speed * belief.age
    deviation = jnp.minimum(jnp.sqrt(belief.deviation**2 + drift**2), settings.elbow_prior)
    return fading * belief.turn, deviation
