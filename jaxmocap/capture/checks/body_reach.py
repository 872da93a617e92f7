"""How a body stands and how far it reaches, against which its markers are checked.

INPUTS: a Skeleton and the places of markers on it.
OUTPUTS: heights (M,) of the markers on somebody who stands, arms hanging; largest distances (M, M)
between them in any pose; metres.
"""

from collections.abc import Sequence

import numpy as np

from jaxmocap.body.skeleton import Skeleton
from jaxmocap.body.subject import ANKLE_HEIGHT
from jaxmocap.formats.recordings.recording import MarkerPlace


def standing_points(skeleton: Skeleton, places: Sequence[MarkerPlace]) -> np.ndarray:
    """(M, 3) places of the markers with all angles 0, metres; x forward, floor at z = 0."""
    vectors = _bone_vectors(skeleton)
    joints = _joints(skeleton, vectors)
    bones = [skeleton.tree.bone(place.bone) for place in places]
    along = np.array([place.at for place in places])[:, None] * vectors[bones]
    offsets = np.array([place.offset for place in places], float).reshape(-1, 3)
    return joints[bones] + along + offsets - [0.0, 0.0, _sole_and_vertex(joints, vectors)[0]]


def skeleton_stature(skeleton: Skeleton) -> float:
    """How tall the skeleton stands, metres, from sole to vertex."""
    vectors = _bone_vectors(skeleton)
    sole, vertex = _sole_and_vertex(_joints(skeleton, vectors), vectors)
    return vertex - sole


def _bone_vectors(skeleton: Skeleton) -> np.ndarray:
    return np.asarray(skeleton.lengths, float)[:, None] * np.asarray(skeleton.directions, float)


def _joints(skeleton: Skeleton, vectors: np.ndarray) -> np.ndarray:
    """(B, 3) joints about the pelvis; every bone begins where its parent ends."""
    joints = np.zeros_like(vectors)
    for bone, parent in enumerate(skeleton.tree.parents):
        if parent >= 0:
            joints[bone] = joints[parent] + vectors[parent]
    return joints


def _sole_and_vertex(joints: np.ndarray, vectors: np.ndarray) -> tuple[float, float]:
    """Heights of the body's ends; the lowest joints, the ankles, are a share of them above one."""
    vertex, ankle = float((joints + vectors)[:, 2].max()), float(joints[:, 2].min())
    return vertex - (vertex - ankle) / (1 - ANKLE_HEIGHT), vertex


def max_marker_distances(skeleton: Skeleton, places: Sequence[MarkerPlace]) -> np.ndarray:
    """(M, M) metres that two markers can be apart: the way along the bones between them."""
    lengths = np.asarray(skeleton.lengths, float)
    chains = [skeleton.tree.chain(place.bone) for place in places]
    distances = np.zeros((len(places), len(places)))
    for i, first in enumerate(places):
        for j, second in enumerate(places[:i]):
            segments = _bones_between(chains[i], chains[j], first.at, second.at)
            straight = sum(share * lengths[bone] for bone, share in segments)
            sides = np.linalg.norm(first.offset) + np.linalg.norm(second.offset)
            distances[i, j] = distances[j, i] = straight + sides
    return distances


def _bones_between(
    first: tuple[int, ...], second: tuple[int, ...], at_first: float, at_second: float
) -> list[tuple[int, float]]:
    """Bones between two points on the ends of two chains, and the share of each that is passed."""
    if first == second:
        return [(first[-1], abs(at_first - at_second))]
    shared = sum(a == b for a, b in zip(first, second, strict=False))
    segments = []
    for chain, at in ((first, at_first), (second, at_second)):
        if len(chain) == shared:
            # The other chain goes on from this bone's far end.
            segments.append((chain[-1], 1.0 - at))
        else:
            segments += [(bone, 1.0) for bone in chain[shared:-1]] + [(chain[-1], at)]
    return segments
