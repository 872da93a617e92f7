"""Several arrays as one vector: a crossing between host and device costs by the number of arrays.

INPUTS: a pytree of arrays, or a vector and the shapes that it holds. OUTPUTS: the other.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array


def packed(tree: Any) -> Array:
    """All numbers of a pytree, leaf after leaf."""
    return jnp.concatenate([jnp.ravel(leaf) for leaf in jax.tree.leaves(tree)])


def unpacked(vector: np.ndarray, shapes: Any) -> Any:
    """The pytree of a packed vector.

    Args:
        vector: on the host.
        shapes: the pytree with a ``jax.ShapeDtypeStruct`` or an array for each leaf.
    """
    leaves, structure = jax.tree.flatten(shapes)
    ends = np.cumsum([int(np.prod(leaf.shape)) for leaf in leaves])
    parts = np.split(vector, ends[:-1])
    each = [part.reshape(leaf.shape) for part, leaf in zip(parts, leaves, strict=True)]
    return jax.tree.unflatten(structure, each)
