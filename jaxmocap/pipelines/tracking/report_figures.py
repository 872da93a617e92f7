"""How far to trust tracked poses.

INPUTS: poses and what their solve or their steps tell of them. OUTPUTS: Judged.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.arms import arms_of
from jaxmocap.body.kinematics import Sites, forward, site_positions
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import ELBOWS, LANDMARKS, Skeleton
from jaxmocap.compilation.batches import in_batches
from jaxmocap.hybrid.elbow_search import confidence_of
from jaxmocap.hybrid.refine import swivels
from jaxmocap.hybrid.tracker import HybridTracker, StepReport

# Events per call, so that they compile once.
EVENTS_A_CALL = 64


class Judged(NamedTuple):
    """Of E events.

    Attributes:
        distances: (E, M) of the markers from their points on the body, metres.
        swivels: (E, 2) turns of the elbows that the video added, radians.
        deviations: (E, L, 3) of the landmarks' coordinates, metres.
        from_prior: (E, L) 1 where neither markers nor video tell much, else 0.
    """

    distances: np.ndarray
    swivels: np.ndarray
    deviations: np.ndarray
    from_prior: np.ndarray

    @property
    def confidence(self) -> np.ndarray:
        """(E, 2) in the elbows, 0 to 1."""
        spread = np.sqrt(np.sum(self.deviations[:, ELBOWS] ** 2, -1))
        return np.asarray(confidence_of(spread))


def judge(
    tracker: HybridTracker,
    person: Skeleton,
    poses: Pose,
    trust: tuple[np.ndarray, np.ndarray],
    alone: Pose,
    markers_world: np.ndarray,
) -> Judged:
    """Of smoothed poses (E, ...) of a person as found, against those of the markers alone.

    Args:
        tracker: that found the markers' poses.
        person: as found.
        poses: of the person.
        trust: deviations (E, L, 3) and what is a guess (E, L).
        alone: poses of the markers alone.
        markers_world: (E, M, 3) metres; NaN where missing.
    """
    each = poses, alone, markers_world
    each = jax.tree.map(lambda part: np.asarray(part, tracker.dtype), each)
    call = partial(_distances, person, tracker.skeleton, tracker.markers, tracker.grips)
    distances, turned = in_batches(call, each, EVENTS_A_CALL)
    return Judged(distances, turned, *trust)


@jax.jit
def _distances(
    person: Skeleton, first: Skeleton, markers: Sites, grips: Sites,
    poses: Pose, alone: Pose, targets: Array,
) -> tuple[Array, Array]:  # fmt: skip
    """Of a batch of events: the markers' distances, the elbows' turns."""

    def of_event(pose: Pose, before: Pose, targets: Array) -> tuple[Array, Array]:
        bones = forward(person, pose)
        off = site_positions(person, bones, markers) - targets
        arms = arms_of(first, forward(first, before), grips), arms_of(person, bones, grips)
        return jnp.sqrt(jnp.sum(off**2, -1)), swivels(*arms)

    return jax.vmap(of_event)(poses, alone, targets)


def judge_steps(reports: StepReport) -> Judged:
    """Of E steps (E, ...), which tell of the elbows' deviations only."""
    spread = np.asarray(reports.spread)
    deviations = np.full((len(spread), len(LANDMARKS), 3), np.nan)
    deviations[:, ELBOWS] = spread[..., None] / np.sqrt(3)
    unknown = np.full(deviations.shape[:2], np.nan)
    return Judged(np.asarray(reports.distances), np.asarray(reports.swivels), deviations, unknown)
