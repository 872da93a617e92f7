"""The prior of a pose: the motion's prediction, and rest for joints that outlines hardly determine.

Which way a shoulder blade moved and what bent the arm behind it look nearly alike, and an outline's
points err together: without a hold the least error of the surface bends such joints. The two
expectations, of the motion and of rest, are one normal each, and so is their product.

INPUTS: a predicted pose, deviations. OUTPUTS: a Prior.
"""

import jax.numpy as jnp
import numpy as np

from jaxmocap.body.pose import Pose
from jaxmocap.body.tree import ROOT_DOF
from jaxmocap.silhouette.pose import Prior


def combined_prior(expected: Pose, deviations: np.ndarray, rest: np.ndarray) -> Prior:
    """The prior of a pose before its images.

    Args:
        expected: by the motion.
        deviations: (6 + D,) about it, metres and radians.
        rest: (D,) about 0, radians; infinite for joints that are not held there.
    """
    moving, still = deviations[ROOT_DOF:] ** -2.0, rest**-2.0
    both = moving + still
    angles = (moving / both * np.asarray(expected.angles)).astype(np.float32)
    joined = np.concatenate([deviations[:ROOT_DOF], both**-0.5]).astype(np.float32)
    return Prior(expected._replace(angles=jnp.asarray(angles)), jnp.asarray(joined))
