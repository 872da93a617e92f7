"""Proportions of a person that a whole recording may correct: lengths by a few factors.

INPUTS: a Skeleton, logarithms of factors. OUTPUTS: the skeleton scaled.
"""

from dataclasses import replace
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.skeleton import Skeleton


class Proportion(NamedTuple):
    """A factor on some bones' lengths.

    Attributes:
        name: of it.
        bones: how the bones' names begin.
        deviation: of its logarithm among people, given the subject that a recording states.
    """

    name: str
    bones: tuple[str, ...]
    deviation: float


# A trunk that bends is shorter than one that stands, and shoulders move on the ribs.
PROPORTIONS = (
    Proportion("trunk length", ("spine",), 0.08),
    Proportion("shoulder breadth", ("clavicle",), 0.08),
)


def scaled(skeleton: Skeleton, logarithms: Array) -> Skeleton:
    """The skeleton with ``PROPORTIONS`` multiplied by the exponentials of (P,) ``logarithms``."""
    bones = skeleton.tree.bones
    scales = np.array([[bone.startswith(p.bones) for p in PROPORTIONS] for bone in bones])
    factors = jnp.exp(jnp.asarray(scales, skeleton.lengths.dtype) @ logarithms)
    return replace(skeleton, lengths=skeleton.lengths * factors)
