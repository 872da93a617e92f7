"""Arrays between host and device that compile nothing.

JAX compiles a program for each shape of what it converts, or works through step by step, outside
of a traced function: some ten milliseconds of every start each.

INPUTS: numbers on the host, or arrays of either kind. OUTPUTS: arrays on the device; the module
whose functions work on an array; several arrays as one.
"""

from types import ModuleType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

# NumPy's on the host, a JAX array in a program.
Numbers = Any


def on_device(values: Any, dtype: Any = float) -> Array:
    """Numbers, or NumPy arrays, as an array of JAX; ``float`` is JAX's own precision."""
    dtype = jax.dtypes.canonicalize_dtype(dtype)
    return jnp.asarray(np.asarray(values, dtype), dtype)


def namespace(array: Numbers) -> ModuleType:
    """NumPy on the host, ``jax.numpy`` of what is JAX's or traced."""
    return jnp if isinstance(array, jax.Array) else np


def pack_leaves(tree: Any) -> Array:
    """All numbers of a pytree, leaf after leaf."""
    return jnp.concatenate([jnp.ravel(leaf) for leaf in jax.tree.leaves(tree)])


def unpack_leaves(vector: np.ndarray, shapes: Any) -> Any:
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
