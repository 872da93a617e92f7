"""Proportions of a person that a recording may correct: lengths, and girths, by a few factors.

INPUTS: a Skeleton, logarithms of factors. OUTPUTS: the skeleton scaled; how factors vary.
"""

from dataclasses import replace
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.model_files import proportions_of
from jaxmocap.body.skeleton import JOINT_CENTRES, Skeleton
from jaxmocap.body.surfaces.surface import BodyPoints
from jaxmocap.compilation.arrays import Numbers, namespace


class Proportion(NamedTuple):
    """A factor on some bones' lengths or diameters."""

    name: str
    bones: tuple[str, ...]  # groups of them, or parts
    deviation: float  # of its logarithm among people, given the subject that a recording states


# What every recording corrects.
# A trunk that bends is shorter than one that stands, and shoulders move on the ribs.
PROPORTIONS = (
    Proportion("trunk length", ("spine",), 0.08),
    Proportion("shoulder breadth", ("shoulder",), 0.08),
)
_AMONG_PEOPLE = proportions_of(JOINT_CENTRES)["deviation"]
# All that a clip made for it may correct: people of one stature differ, and so do authors on where
# joints are.
LENGTHS = (
    *PROPORTIONS,
    Proportion("neck and head", ("head",), _AMONG_PEOPLE["neck_head"]),
    Proportion("upper arm", ("upper_arm",), _AMONG_PEOPLE["upper_arm"]),
    Proportion("forearm", ("forearm",), _AMONG_PEOPLE["forearm"]),
    Proportion("hand", ("hand",), _AMONG_PEOPLE["hand"]),
    Proportion("hip breadth", ("hip",), _AMONG_PEOPLE["hip"]),
    Proportion("thigh", ("thigh",), _AMONG_PEOPLE["thigh"]),
    Proportion("shank", ("shank",), _AMONG_PEOPLE["shank"]),
)
# Clothes and muscle: held to be as stated, they would pass for lengths.
GIRTHS = (
    Proportion("head's girth", ("head",), 0.15),
    Proportion("trunk's girth", ("spine", "shoulder", "hip"), 0.15),
    Proportion("upper arm's girth", ("upper_arm",), 0.15),
    Proportion("forearm's girth", ("forearm", "hand"), 0.15),
    Proportion("leg's girth", ("thigh", "shank"), 0.15),
)
# By which a stature that somebody stated is wrong, and all lengths with it.
STATURE = 0.02


def scale_skeleton(skeleton: Skeleton, logarithms: Numbers) -> Skeleton:
    """The skeleton with lengths, then girths, multiplied by the exponentials of logarithms (P,).

    On the host where these are NumPy's.

    Fewer than all are of the first: two are ``PROPORTIONS``.
    """
    count = min(logarithms.shape[0], len(LENGTHS))
    lengths = skeleton.lengths * _factors(skeleton, LENGTHS[:count], logarithms[:count])
    if logarithms.shape[0] == count:
        return replace(skeleton, lengths=lengths)
    girths = _factors(skeleton, GIRTHS, logarithms[count:])
    return replace(skeleton, lengths=lengths, diameters=skeleton.diameters * girths[:, None])


def _factors(
    skeleton: Skeleton, proportions: tuple[Proportion, ...], logarithms: Numbers
) -> Numbers:
    """One for each bone."""
    tree = skeleton.tree
    bones = np.arange(len(tree.bones))
    scales = np.array([np.isin(bones, tree.bones_in(*p.bones)) for p in proportions]).T
    return namespace(logarithms).exp((scales.astype(skeleton.lengths.dtype) * logarithms).sum(-1))


def stretch_points(skeleton: Skeleton, points: BodyPoints, logarithms: Array) -> BodyPoints:
    """Points of a body on that of ``scale_skeleton``: each stays where it was along its bones.

    What lies before a bone's joint, or beyond its end, is moved with it and not stretched.
    """
    count = min(logarithms.shape[0], len(LENGTHS))
    longer = skeleton.lengths * (_factors(skeleton, LENGTHS[:count], logarithms[:count]) - 1)
    way, places = skeleton.directions[points.bones], jnp.asarray(points.points_bone)
    share = jnp.sum(places * way, -1) / skeleton.lengths[points.bones]
    shift = jnp.clip(share, 0, 1) * longer[points.bones]
    return points._replace(points_bone=places + shift[..., None] * way)


def covariance_among_people(count: int) -> np.ndarray:
    """Of logarithms (P,), (P, P); lengths, if more than every recording's two, share a stature."""
    chosen = (*LENGTHS, *GIRTHS)[:count]
    independent = np.diag([proportion.deviation**2 for proportion in chosen])
    if count <= len(PROPORTIONS):
        return independent
    of_lengths = np.arange(count) < len(LENGTHS)
    return independent + STATURE**2 * np.outer(of_lengths, of_lengths)
