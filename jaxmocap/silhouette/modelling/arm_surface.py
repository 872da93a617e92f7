"""An arm's surface from two views across it (second paper, 2.1).

The joint view shows how thick the arm is in the plane in which it bends, the arms' side view how
thick it is along the elbow's axis. Slices across the bones take both; the arm is laid out level,
to the side, thumb up.

INPUTS: two Views; shoulder, elbow, wrist and fingertip in each, world, metres.
OUTPUTS: closed rings from within the trunk to the fingertip, world, metres.
"""

from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter1d

from jaxmocap.silhouette.modelling.trunk import SMOOTH, ring
from jaxmocap.silhouette.modelling.views import View

# Slices of upper arm, forearm and hand; nodes of each; how full they are, as two people, on whom
# nothing is tested, need.
SLICES, AROUND, FULLNESS = (16, 16, 12), 32, (2.15, 1.85, 2.0)
# Nearer to the shoulder than this share of the upper arm a slice would run into the trunk: there
# it may be so much thicker than here.
FREE, THICKER = 0.35, 1.12
# Within this share of a bone's ends slices turn from being square to the one bone to the other.
TURNS_IN = 0.25
# No arm reaches farther from its bones, metres.
FARTHEST_M = 0.14
# The arm goes on into the trunk as far as this share of the way to the middle, by so many rings.
INTO_TRUNK, INNER = 0.45, 4


class Bones(NamedTuple):
    """An arm in one stance: (3,) each, world, metres.

    Attributes:
        shoulder: its joint.
        elbow: its joint.
        wrist: its joint.
        tip: of the longest finger.
    """

    shoulder: np.ndarray
    elbow: np.ndarray
    wrist: np.ndarray
    tip: np.ndarray

    @property
    def lengths(self) -> np.ndarray:
        """(3,) of upper arm, forearm and hand, metres."""
        return np.linalg.norm(np.diff(np.array(self), axis=0), axis=1)


def stations(bones: Bones) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points (K, 3) along an arm, its direction (K, 3) there, and how square that is to the bone.

    The direction turns in at the joints; the cosine (K,) of its angle to the bone makes what is
    measured across it what it would be across the bone.
    """
    ends = np.array(bones)
    units = np.diff(ends, axis=0) / bones.lengths[:, None]
    points, ways, own_way = [], [], []
    for k, count in enumerate(SLICES):
        share = np.arange(count + (k == 2)) / count
        points.append(ends[k] + share[:, None] * (ends[k + 1] - ends[k]))
        before, after = units[max(k - 1, 0)], units[min(k + 1, 2)]
        # At a joint half of the one bone's direction, half of the other's.
        own = np.clip(np.minimum(share, 1 - share) / TURNS_IN, 0, 1)[:, None]
        other = np.where(share[:, None] < 0.5, before, after)
        ways.append((0.5 + 0.5 * own) * units[k] + (0.5 - 0.5 * own) * other)
        own_way.append(np.tile(units[k], (len(share), 1)))
    way = np.concatenate(ways)
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    return np.concatenate(points), way, np.sum(way * np.concatenate(own_way), 1)


def thickness(view: View, bones: Bones, towards: np.ndarray) -> np.ndarray:
    """(K, 2) how far the arm reaches from its bones, to the side ``towards`` (3,) and away from it.

    Across the bones, in the plane x = constant in which the arm is held; metres.
    """
    points, ways, square = stations(bones)
    across = np.stack([np.zeros(len(ways)), -ways[:, 2], ways[:, 1]], 1)
    across *= np.sign(across @ towards)[:, None]
    reach = np.stack([view.reach(points, s * across, FARTHEST_M) for s in (1, -1)], 1)
    reach *= square[:, None]
    free = int(FREE * SLICES[0])
    reach[:free] = np.minimum(reach[:free], THICKER * reach[free])
    return gaussian_filter1d(reach, SMOOTH, axis=0, mode="nearest")


def arm_rings(
    bend: np.ndarray, hinge: np.ndarray, shoulder: np.ndarray, lengths: np.ndarray
) -> np.ndarray:
    """(K, N, 3) the arm stretched out level to its side, from within the trunk to the fingertip.

    Args:
        bend: (K, 2) reaches towards the inner side of the bent elbow, which looks ahead then, and
            away from it, metres.
        hinge: (K, 2) reaches up and down.
        shoulder: (3,) its joint, world, metres; left where y is positive as seen from the neck.
        lengths: (3,) of upper arm, forearm and hand.
    """
    side = np.sign(shoulder[1])
    starts = np.append(0.0, np.cumsum(lengths)[:2])
    along = [
        start + length * np.arange(count) / count
        for start, length, count in zip(starts, lengths, SLICES, strict=True)
    ]
    places = np.append(np.concatenate(along), lengths.sum())
    fullness = np.repeat(FULLNESS, [*SLICES[:2], SLICES[2] + 1])
    rings = np.stack([_ring(*three) for three in zip(bend, hinge, fullness, strict=True)])
    # Inwards it goes on as it begins, somewhat slimmer, so that it ends within the trunk.
    inner = np.linspace(-INTO_TRUNK * abs(shoulder[1]), 0, INNER + 1)[:-1]
    slim = np.linspace(0.7, 1.0, INNER + 1)[:-1, None, None]
    rings = np.concatenate([slim * rings[:1], rings])
    y = np.broadcast_to(side * np.append(inner, places)[:, None], rings.shape[:2])
    return shoulder + np.stack([rings[..., 0], y, rings[..., 1]], -1)


def _ring(bend: np.ndarray, hinge: np.ndarray, fullness: float) -> np.ndarray:
    """(N, 2) ahead and up."""
    (ahead, back), (up, down) = np.maximum(bend, 1e-3), np.maximum(hinge, 1e-3)
    corners = np.array([[ahead, up], [-back, up], [-back, -down], [ahead, -down]])
    return ring(corners, fullness, AROUND)
