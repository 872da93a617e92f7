"""Soft coverage of projected limbs (the binary image P_s of equation (12), softened).

INPUTS: limbs as discs in region samples. OUTPUTS: coverage of every sample, 0 to 1.
"""

import jax
import jax.numpy as jnp
from jax import Array

from jaxmocap.geometry.outlines import Discs, signed_distance


def soft_coverage(limbs: Discs, size: int, softness: Array | float) -> Array:
    """Coverage (size, size) of the union of N limbs: ``1 - prod(1 - sigmoid(-d / softness))``.

    Differentiable by the limbs; as ``softness`` (samples) goes to 0 it becomes b_ij of (12).
    """
    axis = jnp.arange(size, dtype=limbs.near.dtype)
    grid = jnp.stack(jnp.meshgrid(axis, axis), -1)
    each = Discs(*(part[:, None, None] for part in limbs))
    inside = jax.nn.sigmoid(-signed_distance(each, grid) / softness)
    return 1 - jnp.prod(1 - inside, 0)
