"""Proportions of a person that a whole recording may correct: lengths and girths by a few factors.

INPUTS: a Skeleton, logarithms of factors. OUTPUTS: the skeleton scaled.
"""

from dataclasses import replace
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.skeleton import Skeleton, Tree


class Proportion(NamedTuple):
    """A factor on some bones.

    Attributes:
        name: of it.
        bones: how the bones' names begin.
        girth: it scales diameters instead of lengths.
        deviation: of its logarithm among people, given the subject that a recording states.
    """

    name: str
    bones: tuple[str, ...]
    girth: bool
    deviation: float


# A trunk that bends is shorter than one that stands, and shoulders move on the ribs.
PROPORTIONS = (
    Proportion("trunk length", ("spine",), False, 0.08),
    Proportion("shoulder breadth", ("clavicle",), False, 0.08),
)


def scaled(skeleton: Skeleton, logarithms: Array) -> Skeleton:
    """The skeleton with ``PROPORTIONS`` multiplied by the exponentials of (P,) ``logarithms``."""
    lengths, girths = (_matrix(skeleton.tree, girth) for girth in (False, True))
    dtype = skeleton.lengths.dtype
    return replace(
        skeleton,
        lengths=skeleton.lengths * jnp.exp(jnp.asarray(lengths, dtype) @ logarithms),
        diameters=skeleton.diameters * jnp.exp(jnp.asarray(girths, dtype) @ logarithms)[:, None],
    )


def _matrix(tree: Tree, girth: bool) -> np.ndarray:
    """Which proportions (B, P) scale which bones."""
    return np.array(
        [
            [p.girth == girth and bone.startswith(p.bones) for p in PROPORTIONS]
            for bone in tree.bones
        ],
        np.float32,
    )
