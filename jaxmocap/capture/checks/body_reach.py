"""How a body stands and how far it reaches, against which its markers are checked.

INPUTS: a Skeleton and the places of markers on it.
OUTPUTS: heights (M,) of the markers on somebody who stands, arms hanging; largest distances (M, M)
between them in any pose; metres.
"""

from collections.abc import Sequence

import numpy as np

from jaxmocap.body.skeleton import Skeleton
from jaxmocap.body.subject import bone_vectors, sole_and_vertex, standing_joints
from jaxmocap.formats.recordings.recording import MarkerPlace


def standing_points(skeleton: Skeleton, places: Sequence[MarkerPlace]) -> np.ndarray:
    """(M, 3) places of the markers with all angles 0, metres; x forward, floor at z = 0."""
    vectors = bone_vectors(skeleton)
    joints = standing_joints(skeleton, vectors)
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
