"""The floor under a body that moves: where pictures of it draw the ground.

INPUTS: a BodyScene, the meshes of its bones. OUTPUTS: a Floor, world, metres.

It lies at the body's lowest points, not at the world's origin: marker systems place that anywhere.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from jaxmocap.geometry.solids import Solid
from jaxmocap.outputs.scene import BodyScene

# The lowest points of a recording: this percentile of the samples', so that one bad pose of many
# does not sink the floor.
LOWEST_PERCENT = 5.0
# Samples at most that are looked at.
MOST_SAMPLES = 200
# Around where the body goes, and half the side at most, metres.
MARGIN_M, LARGEST_M = 1.5, 25.0


class Floor(NamedTuple):
    """A level square.

    Attributes:
        height_m: along the world's z.
        centre_xy: (2,) of it.
        half_size_m: half its side.
    """

    height_m: float
    centre_xy: np.ndarray
    half_size_m: float


def floor_of(scene: BodyScene, pieces: Mapping[str, Solid]) -> Floor | None:
    """The floor on which a body stands; None where no pose is known."""
    is_known = np.isfinite(scene.near).all((1, 2))
    if not is_known.any():
        return None
    known = np.flatnonzero(is_known)
    some = known[:: -(-len(known) // MOST_SAMPLES)]
    lowest = np.full(len(some), np.inf)
    for bone, solid in pieces.items():
        i = scene.tree.bone(bone)
        heights = scene.R_world_bone[some, i, 2] @ solid.vertices.T
        lowest = np.minimum(lowest, scene.near[some, i, 2] + heights.min(1))
    places = scene.near[known][..., :2].reshape(-1, 2)
    low, high = places.min(0), places.max(0)
    half = min(float((high - low).max()) / 2 + MARGIN_M, LARGEST_M)
    return Floor(float(np.percentile(lowest, LOWEST_PERCENT)), (low + high) / 2, half)
