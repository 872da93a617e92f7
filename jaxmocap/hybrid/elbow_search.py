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

from jaxmocap.body.arms import Arms, flesh, turn_forearm
from jaxmocap.body.pose import Pose
from jaxmocap.evidence.edges import arm_cost
from jaxmocap.geometry.cameras import Camera
from jaxmocap.geometry.rotations import HIGHEST, compose, exp
from jaxmocap.hybrid.observe import Observation
from jaxmocap.hybrid.settings import SearchSettings, Settings


class Belief(NamedTuple):
    """What is believed of each arm's forearm, left and right.

    Attributes:
        log_weights: (2, K) of the candidates, largest 0.
        turn: (2, 3) rotation vector from the markers' forearm to the expected one, in the
            markers' forearm's frame, radians.
        spread: (2,) standard deviation of the elbow, metres.
        time: () of the last image, seconds since the tracker began.
        pose: the last refined one.
    """

    log_weights: Array
    turn: Array
    spread: Array
    time: Array
    pose: Pose


def candidate_turns(farthest: float = 75.0, spacing: float = 10.0) -> np.ndarray:
    """Rotation vectors (K, 3), radians, about x and y of the forearm: a hexagonal grid.

    Args:
        farthest: from the markers' pose, degrees.
        spacing: between neighbours, degrees.
    """
    reach = int(farthest / (spacing * np.sqrt(0.75))) + 1
    rows, columns = np.meshgrid(np.arange(-reach, reach + 1), np.arange(-2 * reach, 2 * reach + 1))
    x = (columns + 0.5 * (rows % 2)) * spacing
    y = rows * spacing * np.sqrt(0.75)
    kept = np.hypot(x, y) <= farthest
    flat = np.stack([x[kept], y[kept], np.zeros(kept.sum())], 1)
    return np.radians(flat)


TURNS = candidate_turns()
R_TURNS = Rotation.from_rotvec(TURNS).as_matrix()
# How far apart two candidates' elbows are on a forearm of one metre.
CHORDS = 2 * np.sin(np.minimum(np.linalg.norm(TURNS[:, None] - TURNS, axis=-1), np.pi) / 2)
# Without an image, what the last one told is forgotten within a second or so.
FADES_S = 1.0
# Elbows keep close to where the markers' pose takes them: the spread grows by this share of the
# speed that a single frame must allow for.
DRIFT_SHARE = 0.1
# Spread of an elbow, metres, at which the confidence is one half.
HALF_AT_M = 0.05


def no_belief(settings: SearchSettings, pose: Pose) -> Belief:
    """Before the first image: the markers' pose is as good as its prior."""
    dtype = pose.angles.dtype
    weights = jnp.zeros((2, len(TURNS)), dtype)
    spread = jnp.broadcast_to(settings.elbow_prior, (2,))
    return Belief(weights, jnp.zeros((2, 3), dtype), spread, jnp.zeros((), dtype), pose)


def search(
    settings: Settings,
    cameras: Camera,
    observation: Observation,
    arms: Arms,
    belief: Belief,
    time: Array,
) -> Belief:
    """One step of the filter for both arms; an arm that no camera sees keeps drifting to its prior.

    Args:
        settings: of the tracker.
        cameras: C, stacked.
        observation: of both arms.
        arms: of the markers' pose.
        belief: after the last image.
        time: of this image, seconds since the tracker began.
    """
    elapsed = jnp.maximum(time - belief.time, 1e-3)

    def of_arm(arm: Arms, seen: Observation, log_weights: Array) -> tuple[Array, Array, Array]:
        costs, elbows = _candidate_costs(settings, cameras, seen, arm)
        drifted = _drift(settings.look, arm, log_weights, elapsed)
        posterior = drifted - costs
        posterior = posterior - jnp.max(posterior)
        share = jax.nn.softmax(posterior)
        turn = jnp.matmul(share, jnp.asarray(TURNS, share.dtype), precision=HIGHEST)
        mean = jnp.matmul(share, elbows, precision=HIGHEST)
        spread = jnp.sqrt(jnp.sum(share * jnp.sum((elbows - mean) ** 2, -1)))
        return posterior, turn, spread

    log_weights, turn, spread = jax.vmap(of_arm)(arms, observation.by_arm(), belief.log_weights)
    return Belief(log_weights, turn, spread, time, belief.pose)


def _candidate_costs(
    settings: Settings, cameras: Camera, observation: Observation, arm: Arms
) -> tuple[Array, Array]:
    """Costs (K,) in nats of one arm's candidates, and their elbows (K, 3)."""
    R, look = arm.R_world_radius, settings.look
    turns = compose(compose(R, jnp.asarray(R_TURNS, R.dtype)), R.T)
    moved, slack = turn_forearm(arm, turns)
    seen = arm_cost(settings.evidence, settings.fit, cameras, observation, flesh(moved))
    away = jnp.sum((moved.elbow - arm.elbow) ** 2, -1) / look.elbow_prior**2
    # Student's t with three degrees of freedom: markers alone may be far off.
    prior = 2 * jnp.log1p(away / 3)
    return seen + (slack / look.shoulder_slack) ** 2 / 2 + prior, moved.elbow


def _drift(settings: SearchSettings, arm: Arms, log_weights: Array, elapsed: Array) -> Array:
    """Log-weights (K,) before the image: each candidate's share spreads with the elbow's speed."""
    squared = jnp.asarray(CHORDS**2, arm.elbow.dtype)
    forearm = jnp.sum((arm.elbow - arm.grip) ** 2)
    price = squared * (forearm / (settings.elbow_speed * elapsed) ** 2 / 2)
    kernel = jnp.exp(-jnp.minimum(price, settings.surprise))
    # It is symmetric, and each share is spread whole.
    whole = jnp.matmul(kernel, jnp.ones_like(log_weights), precision=HIGHEST)
    spread = jnp.matmul(kernel, jax.nn.softmax(log_weights) / whole, precision=HIGHEST)
    return jnp.log(spread + 1e-20)


def believed_elbows(arms: Arms, turn: Array) -> Array:
    """Elbows (2, 3) of the markers' arms with their forearms turned by (2, 3) ``turn``."""

    def of_arm(arm: Arms, vector: Array) -> Array:
        R = arm.R_world_radius
        return turn_forearm(arm, compose(compose(R, exp(vector)), R.T))[0].elbow

    return jax.vmap(of_arm)(arms, turn)


def carried(settings: SearchSettings, belief: Belief, time: Array) -> tuple[Array, Array]:
    """The belief between images: turns (2, 3) that fade out, and a spread (2,) that grows."""
    age = jnp.maximum(time - belief.time, 0.0)
    fading = jnp.exp(-((age / FADES_S) ** 2))
    drift = DRIFT_SHARE * settings.elbow_speed * age
    spread = jnp.minimum(jnp.sqrt(belief.spread**2 + drift**2), settings.elbow_prior)
    return fading * belief.turn, spread


def confidence_of(spread: Array | np.ndarray) -> Array | np.ndarray:
    """Confidence (...) in elbows whose standard deviation is so many metres, 0 to 1."""
    return 1 / (1 + (spread / HALF_AT_M) ** 2)
