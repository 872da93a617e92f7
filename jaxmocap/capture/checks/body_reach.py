"""How a body stands and how far it reaches, against which its markers are checked.

INPUTS: a Skeleton and the places of markers on it; samples of them.
OUTPUTS: heights (M,) of the markers on somebody who stands, arms hanging; largest distances (M, M)
between them in any pose; metres; which markers are farther from one another, and how often.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jaxmocap.body.skeleton import Skeleton
from jaxmocap.body.subject import bone_vectors, rest_joints, sole_and_vertex
from jaxmocap.formats.recordings.recording import MarkerPlace

# Limbs may be a tenth longer than a table says,
REACH_MARGIN_SHARE = 1.1
# and a marker may sit some centimetres off its bone, metres.
REACH_MARGIN_M = 0.05
# Distances that are in memory together.
BLOCK_DISTANCES = 2**20


class BeyondReach(NamedTuple):
    """Two markers that are too far from one another."""

    marker: int  # the one of them that is oftener too far from any
    other: int
    samples: int  # in how many they are
    farthest_m: float  # how far, at most
    allowed_m: float  # that this body reaches


class ReachCounts:
    """Counts the samples in which markers are farther from one another than a body reaches."""

    def __init__(self, skeleton: Skeleton, places: Sequence[MarkerPlace]):
        """Of M markers at these places; no sample yet."""
        distances = max_marker_distances(skeleton, places)
        self._first, self._second = np.tril_indices(len(places), -1)
        self._allowed = (REACH_MARGIN_SHARE * distances + REACH_MARGIN_M)[self._first, self._second]
        self._counts, self._markers = np.zeros(len(self._first), int), len(places)
        self._farthest = np.zeros(len(self._first))

    def add(self, positions: np.ndarray) -> bool:
        """Samples (T, M, 3), metres; NaN where missing. Returns whether any is beyond reach."""
        before = self._counts.sum()
        size = max(1, BLOCK_DISTANCES // max(len(self._first), 1))
        for first in range(0, len(positions), size):
            block = positions[first : first + size]
            apart = np.linalg.norm(block[:, self._first] - block[:, self._second], axis=-1)
            self._counts += (apart > self._allowed).sum(0)
            self._farthest = np.fmax(self._farthest, np.fmax.reduce(apart, 0))
        return bool(self._counts.sum() > before)

    def worst(self) -> BeyondReach | None:
        """The marker that is oftenest too far from others, and the one it is so most; or None."""
        if not self._counts.any():
            return None
        of_marker = sum(
            np.bincount(ends, self._counts, self._markers) for ends in (self._first, self._second)
        )
        marker = int(np.argmax(of_marker))
        is_its = (self._first == marker) | (self._second == marker)
        pair = int(np.where(is_its, self._counts, -1).argmax())
        other = int(self._first[pair] + self._second[pair]) - marker
        figures = self._farthest[pair], self._allowed[pair]
        return BeyondReach(marker, other, int(self._counts[pair]), *map(float, figures))


def standing_points(skeleton: Skeleton, places: Sequence[MarkerPlace]) -> np.ndarray:
    """(M, 3) places of the markers with all angles 0, metres; x forward, floor at z = 0."""
    vectors = bone_vectors(skeleton)
    joints = rest_joints(skeleton)
    bones = [skeleton.tree.bone(place.bone) for place in places]
    along = np.array([place.at for place in places])[:, None] * vectors[bones]
    offsets = np.array([place.offset for place in places], float).reshape(-1, 3)
    return joints[bones] + along + offsets - [0.0, 0.0, sole_and_vertex(joints, vectors)[0]]


def max_marker_distances(skeleton: Skeleton, places: Sequence[MarkerPlace]) -> np.ndarray:
    """(M, M) metres that two markers can be apart: the way along the bones between them."""
    lengths = np.asarray(skeleton.lengths, float)
    distances = np.zeros((len(places), len(places)))
    for i, first in enumerate(places):
        for j, second in enumerate(places[:i]):
            way = bones_between(skeleton, first, second)
            straight = sum(share * lengths[bone] for bone, share in way)
            sides = np.linalg.norm(first.offset) + np.linalg.norm(second.offset)
            distances[i, j] = distances[j, i] = straight + sides
    return distances


def bones_between(
    skeleton: Skeleton, first: MarkerPlace, second: MarkerPlace
) -> list[tuple[int, float]]:
    """Bones on the way between two markers, and the share of each that is passed."""
    chains = [skeleton.tree.chain(place.bone) for place in (first, second)]
    if chains[0] == chains[1]:
        return [(chains[0][-1], abs(first.at - second.at))]
    shared = sum(a == b for a, b in zip(*chains, strict=False))
    segments = []
    for chain, at in zip(chains, (first.at, second.at), strict=True):
        if len(chain) == shared:
            # The other chain goes on from this bone's far end.
            segments.append((chain[-1], 1.0 - at))
        else:
            segments += [(bone, 1.0) for bone in chain[shared:-1]] + [(chain[-1], at)]
    return segments
