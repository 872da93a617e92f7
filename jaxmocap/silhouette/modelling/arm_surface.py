"""An arm's surface from two views across it (second paper, 2.1).

The joint view shows how thick the arm is in the plane in which it bends, the arms' side view how
thick it is along the elbow's axis. Slices across the bones take both; the arm is laid out level,
to the side, thumb ahead.

INPUTS: two Views; shoulder, elbow, wrist and fingertip in each, world, metres.
OUTPUTS: closed rings from within the trunk to the fingertip, world, metres.
"""

from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter1d

from jaxmocap.body.surfaces.loft import BLEND
from jaxmocap.silhouette.modelling.pictures.views import STEP_M, PhotographView
from jaxmocap.silhouette.modelling.readings import OWN, Reading, slice_ring
from jaxmocap.silhouette.modelling.trunk import SMOOTHING_SLICES

# Slices of upper arm, forearm and hand.
SLICES = (16, 16, 12)
# Nodes of each.
RING_NODES = 32
# How full they are, powers of superellipses, as two people, on whom nothing is tested, need.
FULLNESS = (2.15, 1.85, 2.0)
# Nearer to the shoulder than this share of the upper arm a slice would run into the trunk:
FREE_FROM = 0.35
# there it may be so much thicker than here.
LARGEST_THICKENING = 1.12
# Between these places a slice may run into the fold of a bent elbow:
FOLD = (0.75, 1.3)
# no elbow reaches so much farther than the arm does beside them.
LARGEST_BULGE = 1.3
# No arm reaches farther from its bones, metres.
FARTHEST_M = 0.14
# No part of a hand lies farther from the forearm's line, metres.
HAND_M = 0.1
# The arm goes on into the trunk as far as this share of the way to the middle,
INTO_TRUNK = 0.45
# by so many rings.
INNER_RINGS = 4


class ArmBones(NamedTuple):
    """An arm in one stance: its joints and its tip, (3,) each, world, metres."""

    shoulder: np.ndarray
    elbow: np.ndarray
    wrist: np.ndarray
    tip: np.ndarray  # of the longest finger

    @property
    def lengths(self) -> np.ndarray:
        """(3,) of upper arm, forearm and hand, metres."""
        return np.linalg.norm(np.diff(np.array(self), axis=0), axis=1)


def slice_positions() -> np.ndarray:
    """(K,) of the slices along an arm: 0 at the shoulder, 1 the elbow, 2 the wrist, 3 the tip."""
    along = [k + np.arange(count) / count for k, count in enumerate(SLICES)]
    return np.append(np.concatenate(along), 3.0)


def slice_stations(bones: ArmBones, towards: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points (K, 3) along an arm and unit ways (K, 3) across it, to the side ``towards`` (3,).

    Where a bent elbow carries them: blended as the skin's nodes are, with what the upper arm and
    what the forearm makes of a straight arm's points and ways. A hand goes on as the forearm,
    however it is held.
    """
    at, ends = slice_positions(), np.array(bones)
    upper, lower = (ends[k + 1] - ends[k] for k in (0, 1))
    units = np.stack([way / np.linalg.norm(way) for way in (upper, lower)])
    lengths = np.append(bones.lengths[:2], hand_extent(bones))
    arc_length = np.interp(at, np.arange(4.0), np.append(0.0, np.cumsum(lengths))) - lengths[0]
    part = np.clip((at - 1) / (2 * BLEND) + 0.5, 0, 1)
    part = (part * part * (3 - 2 * part))[:, None]
    across = np.stack([np.zeros(2), -units[:, 2], units[:, 1]], 1)
    across *= np.sign(across @ towards)[:, None]
    way, cross = ((1 - part) * each[0] + part * each[1] for each in (units, across))
    return ends[1] + arc_length[:, None] * way, cross / np.linalg.norm(cross, axis=1, keepdims=True)


def hand_extent(bones: ArmBones) -> float:
    """How far the fingertip lies from the wrist, along the forearm, metres."""
    lower = bones.wrist - bones.elbow
    return float((bones.tip - bones.wrist) @ lower / np.linalg.norm(lower))


def arm_thickness(view: PhotographView, bones: ArmBones, towards: np.ndarray) -> np.ndarray:
    """(K, 2) how far the arm reaches from its bones, to the side ``towards`` (3,) and away from it.

    Across the bones, in the plane x = constant in which the arm is held; metres. A bent elbow is
    round: along the line that halves its angle it is as thick as a stretched one is across. Fingers
    may be apart, and all on one side of the forearm's line: then what they reach to the other is
    negative.
    """
    points, ways = slice_stations(bones, towards)
    hand = slice_positions() > 2
    reach = np.stack([view.extent(points, s * ways, FARTHEST_M) for s in (1, -1)], 1)
    reach[hand] = _spans(view, points[hand], ways[hand])
    free = int(FREE_FROM * SLICES[0])
    reach[:free] = np.minimum(reach[:free], LARGEST_THICKENING * reach[free])
    return gaussian_filter1d(reach, SMOOTHING_SLICES, axis=0, mode="nearest")


def without_elbow_fold(reach: np.ndarray) -> np.ndarray:
    """Reaches (K, 2) of an arm by a bent one's, which may have run into the fold of its elbow."""
    at = slice_positions()
    beside = (at < FOLD[0]) | (at > FOLD[1])
    usual = np.stack([np.interp(at, at[beside], side) for side in reach[beside].T], 1)
    return np.where(beside[:, None], reach, np.minimum(reach, LARGEST_BULGE * usual))


def _spans(view: PhotographView, points: np.ndarray, ways: np.ndarray) -> np.ndarray:
    """(K, 2) the farthest of what is covered on lines (K, 3) through points, there and back."""
    steps = np.arange(-HAND_M, HAND_M, STEP_M)
    covered = view.covers(points[:, None] + steps[:, None] * ways[:, None])
    first, last = covered.argmax(1), len(steps) - 1 - covered[:, ::-1].argmax(1)
    spans = np.stack([steps[last] + STEP_M / 2, STEP_M / 2 - steps[first]], 1)
    # The last slice may lie a pixel beyond the fingertip.
    covering = np.flatnonzero(covered.any(1))
    if len(covering) == 0:
        raise ValueError("found no hand beyond the wrist, expected an open hand in line with "
                         "the forearm")  # fmt: skip
    nearest = covering[np.abs(np.arange(len(points))[:, None] - covering).argmin(1)]
    return spans[nearest]


def arm_rings(
    bend: np.ndarray,
    hinge: np.ndarray,
    shoulder: np.ndarray,
    left: float,
    lengths: np.ndarray,
    reading: Reading = OWN,
) -> np.ndarray:
    """(K, N, 3) the arm stretched out level to its side, from within the trunk to the fingertip.

    Args:
        bend: (K, 2) reaches towards the inner side of the bent elbow, which looks ahead then, and
            away from it, metres.
        hinge: (K, 2) reaches up and down.
        shoulder: (3,) its joint, world, metres.
        left: how far it lies to the left of the neck, metres; negative on the right.
        lengths: (3,) of upper arm and forearm, and how far the hand reaches along it.
        reading: how slices are made of reaches.
    """
    side = np.sign(left)
    along = np.interp(slice_positions(), np.arange(4.0), np.append(0.0, np.cumsum(lengths)))
    fullness = np.repeat(FULLNESS, [*SLICES[:2], SLICES[2] + 1])
    rings = np.stack([_ring(*three, reading) for three in zip(bend, hinge, fullness, strict=True)])
    # Inwards it goes on as it begins, somewhat slimmer, so that it ends within the trunk.
    inner = np.linspace(-INTO_TRUNK * abs(left), 0, INNER_RINGS + 1)[:-1]
    slim = np.linspace(0.7, 1.0, INNER_RINGS + 1)[:-1, None, None]
    rings = np.concatenate([slim * rings[:1], rings])
    y = np.broadcast_to(side * np.append(inner, along)[:, None], rings.shape[:2])
    return shoulder + np.stack([rings[..., 0], y, rings[..., 1]], -1)


def _ring(bend: np.ndarray, hinge: np.ndarray, fullness: float, reading: Reading) -> np.ndarray:
    """(N, 2) ahead and up."""
    (ahead, back), (up, down) = (
        np.maximum(pair, least - pair[::-1]) for pair, least in ((bend, 2e-3), (hinge, 2e-3))
    )
    corners = np.array([[ahead, up], [-back, up], [-back, -down], [ahead, -down]])
    return slice_ring(corners, fullness, reading, RING_NODES)
