"""Settings of the smoothing over a whole recording.

INPUTS: what a user tunes. OUTPUTS: a pytree of arrays.
"""

from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
from jax import Array


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class SmoothingSettings:
    """What a user may tune of the smoothing over a whole recording; all but the first are traced.

    Standard deviations, unless said otherwise.

    Attributes:
        iterations: most of one solve (static).
        marker: of a marker about its point on the body, metres.
        silhouette: of a cell's coverage; above what one cell errs by, since neighbours err alike.
        person: weight of the differences from the whole person's silhouette; 0 leaves it out.
        forearms: weight of those from the forearms'.
        acceleration: spectral density of the landmarks' accelerations, m / s^2 * sqrt(s).
        lean: of the pelvis' upright about that of the markers' pose, radians; about the vertical
            where no marker holds the feet.
        facing: of the pelvis about where the markers' pose faces, radians; thrice that where no
            marker holds the feet.
        ease: how far joints go from the relaxed pose, as a multiple of what is usual.
        limit: by which a joint may exceed its range, radians.
        goal: of an elbow about where a hypothesis puts it, metres.
        keypoints: of a 2-D key point of full confidence about its landmark, metres at the person.
        ground: of the height of ankles that no marker holds, metres.
        footing: of their place on the ground about that in the markers' pose, metres.
        balance: of the middle of such feet about the point below the centre of gravity, metres.
        proportions: weight of the prior on the person's proportions, in sights.
        camera: of a camera's turn against its calibration, about each axis, radians; weighs in as
            many sights as the proportions do. With 0 no camera turns. Key points' lines never do.
        redundancy: how many cells and frames err alike: a silhouette is wrong where the person is
            no cone, and goes on being so. For the deviations only.
        habit: for how long somebody keeps to what is unusual, seconds. For the deviations only.
        mismatch: of skeletons, as a multiple of what is usual. For the deviations only.
    """

    iterations: int = field(metadata={"static": True})
    marker: Array
    silhouette: Array
    person: Array
    forearms: Array
    acceleration: Array
    lean: Array
    facing: Array
    ease: Array
    limit: Array
    goal: Array
    keypoints: Array
    ground: Array
    footing: Array
    balance: Array
    proportions: Array
    camera: Array
    redundancy: Array
    habit: Array
    mismatch: Array

    @classmethod
    def create(
        cls,
        iterations: int = 12,
        marker: float = 0.004,
        silhouette: float = 0.7,
        person: float = 1.0,
        forearms: float = 1.0,
        acceleration: float = 3.0,
        lean: float = 0.1,
        facing: float = 0.1,
        ease: float = 1.0,
        limit: float = 0.02,
        goal: float = 0.04,
        keypoints: float = 0.02,
        ground: float = 0.05,
        footing: float = 1.0,
        balance: float = 0.06,
        proportions: float = 5.0,
        camera: float = 0.005,
        redundancy: float = 100.0,
        habit: float = 1.0,
        mismatch: float = 1.0,
    ) -> "SmoothingSettings":
        """Settings as arrays (a Python float in a pytree would trace anew)."""
        numbers = (
            marker, silhouette, person, forearms, acceleration, lean, facing, ease, limit, goal,
            keypoints, ground, footing, balance, proportions, camera, redundancy, habit, mismatch,
        )  # fmt: skip
        return cls(iterations, *(jnp.asarray(value, float) for value in numbers))
