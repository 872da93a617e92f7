"""How far to trust tracked poses.

INPUTS: poses and what their solve or their steps tell of them. OUTPUTS: Judged.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.kinematics import forward, site_positions
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import LANDMARKS, Skeleton
from jaxmocap.hybrid.arms import arms_of
from jaxmocap.hybrid.refine import swivels
from jaxmocap.hybrid.search import HALF_AT_M
from jaxmocap.hybrid.smoothing import SmoothedPoses
from jaxmocap.hybrid.tracker import HybridTracker

ELBOWS = tuple(list(LANDMARKS).index(f"elbow_{side}") for side in "lr")


class Judged(NamedTuple):
    """Of E events.

    Attributes:
        distances: (E, M) of the markers from their points on the body, metres.
        swivels: (E, 2) turns of the elbows that the video added, radians.
        confidence: (E, 2) in the elbows, 0 to 1.
        deviations: (E, L, 3) of the landmarks' coordinates, metres.
        from_prior: (E, L) 1 where neither markers nor video tell much, else 0.
    """

    distances: np.ndarray
    swivels: np.ndarray
    confidence: np.ndarray
    deviations: np.ndarray
    from_prior: np.ndarray


def judge(
    tracker: HybridTracker,
    person: Skeleton,
    smoothed: SmoothedPoses,
    alone: Pose,
    markers_world: np.ndarray,
) -> Judged:
    """Of smoothed poses (E, ...) of a person as found, against those of the markers alone."""

    def of_event(pose: Pose, before: Pose, targets: Array) -> tuple[Array, Array]:
        bones, bones_before = forward(person, pose), forward(tracker.skeleton, before)
        off = site_positions(person, bones, tracker.markers) - targets
        first = arms_of(tracker.skeleton, bones_before, tracker.grips)
        arms = first, arms_of(person, bones, tracker.grips)
        return jnp.sqrt(jnp.sum(off**2, -1)), swivels(*arms)

    every = jax.tree.map(
        lambda part: jnp.asarray(part, float), (smoothed.trajectory.poses, alone, markers_world)
    )
    distances, turned = jax.device_get(jax.jit(jax.vmap(of_event))(*every))
    deviations = smoothed.deviations
    spread = np.sqrt(np.sum(deviations[:, ELBOWS] ** 2, -1))
    return Judged(distances, turned, sure(spread), deviations, smoothed.from_prior)


def sure(spread: np.ndarray) -> np.ndarray:
    """Confidence of elbows that deviate by so many metres."""
    return 1 / (1 + (spread / HALF_AT_M) ** 2)


def deviations_of_elbows(confidence: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Deviations (E, L, 3) where only the elbows' confidence (E, 2) is known; from_prior (E, L)."""
    spread = HALF_AT_M * np.sqrt(1 / np.maximum(confidence, 1e-6) - 1)
    deviations = np.full((len(spread), len(LANDMARKS), 3), np.nan)
    deviations[:, ELBOWS] = spread[..., None] / np.sqrt(3)
    return deviations, np.full(deviations.shape[:2], np.nan)
