"""Trunk, neck, head and thighs from the front and the side silhouette (second paper, 2.1).

A level slice is cut by four lines: through each camera and the two edges of its silhouette. The
body's contour touches all four; a closed curve within their quadrilateral is what two silhouettes
determine of it (``readings``). Of thighs the front view shows where either lies across, the side
view how far both reach ahead and back.

INPUTS: two Views nearly at right angles; the landmarks of the front view.
OUTPUTS: a grid of closed rings from the bottom line to the top of the head, world, metres; Thighs
as far down as both show them.
"""

from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter1d

from jaxmocap.silhouette.modelling.pictures.views import PhotographView
from jaxmocap.silhouette.modelling.readings import Reading, slice_ring
from jaxmocap.silhouette.modelling.separation import FrontLandmarks, trunk_run

# Rings of trunk, neck and head.
RINGS = 72
# Deviation of the smoothing along a limb, slices.
SMOOTHING_SLICES = 0.8
# How full a slice is, the power of its superellipse (2 for an ellipse), by the height above the
# bottom line as a share of the arm pits': what two people, on whom nothing is tested, need.
FULLNESS = (
    (0.05, 0.20, 0.37, 0.47, 0.58, 0.68, 0.78, 0.90, 1.20, 1.35, 1.45),
    (2.40, 2.35, 2.25, 2.15, 2.35, 2.55, 2.50, 2.95, 2.90, 2.00, 1.90),
)
# Nothing of the trunk reaches farther from its middle than so much, metres.
FARTHEST_M = 0.35


class Trunk(NamedTuple):
    """Closed rings of R times N nodes, world, metres."""

    # (R, N, 3) from the bottom line upwards, from the person's front to their left.
    rings: np.ndarray
    middles: np.ndarray  # (R, 3) middles of the slices
    pits: np.ndarray  # (2, 3) left and right arm pit


def find_trunk(
    front: PhotographView, side: PhotographView, landmarks: FrontLandmarks, reading: Reading
) -> Trunk:
    """Everything but the arms, from the bottom line to the top of the head."""
    middle = trunk_middle(front, side, landmarks)
    pits = front.plane_points(landmarks.pits, middle)
    rows = np.array([[landmarks.middle_x, landmarks.bottom], [landmarks.neck_x, landmarks.top]])
    low, high = front.plane_points(rows, middle)[:, 2]
    heights = np.linspace(low, high - 0.004, RINGS)
    corners, middles = [], []
    for height in heights:
        middle = np.append(middle[:2], height)
        corners.append(slice_corners(front, side, middle, pits))
        middle = np.append(corners[-1].mean(0), height)
        middles.append(middle)
    # A silhouette's rim is accurate to a pixel; over a few slices its steps cancel out.
    corners = np.array(
        gaussian_filter1d(np.array(corners), SMOOTHING_SLICES, axis=0, mode="nearest")
    )
    shares = (heights - low) / (pits[:, 2].mean() - low)
    fullness = np.interp(shares, *FULLNESS)
    rings = np.stack(
        [slice_ring(c, full, reading) for c, full in zip(corners, fullness, strict=True)]
    )
    level = np.broadcast_to(heights[:, None, None], (*rings.shape[:2], 1))
    return Trunk(np.concatenate([rings, level], -1), np.array(middles), pits)


def trunk_middle(
    front: PhotographView, side: PhotographView, landmarks: FrontLandmarks
) -> np.ndarray:
    """(3,) where the front's ray through the trunk's middle passes the middle of the side view."""
    row = (landmarks.pits[:, 1].mean() + landmarks.bottom) / 2
    ray = front.rays(np.array([landmarks.middle_x, row]))
    along = np.linspace(0, 2 * np.linalg.norm(front.centre - side.centre), 4000)
    is_covered = side.covers(front.centre + along[:, None] * ray)
    if not is_covered.any():
        raise ValueError("the side view shows nobody where the front view does, expected both "
                         "photographs of one stance and their own cameras")  # fmt: skip
    return front.centre + along[is_covered].mean() * ray


def slice_corners(
    front: PhotographView, side: PhotographView, middle: np.ndarray, pits: np.ndarray
) -> np.ndarray:
    """(4, 2) corners of a slice: front left, back left, back right, front right; metres.

    About a point (3,) within; above the arm pits (2, 3) what lies farther out is arm.
    """
    left, ahead = np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0])
    across = [front.extent(middle[None], s * left, FARTHEST_M)[0] for s in (1, -1)]
    deep = [side.extent(middle[None], s * ahead, FARTHEST_M)[0] for s in (1, -1)]
    if middle[2] > pits[:, 2].min():
        across = [min(a, abs(pit[1] - middle[1])) for a, pit in zip(across, pits, strict=True)]
    edges_front = [middle + s * a * left for s, a in zip((1, -1), across, strict=True)]
    edges_side = [middle + s * d * ahead for s, d in zip((1, -1), deep, strict=True)]

    def crossing(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """From above: where the front's line through one edge meets the side's."""
        first, second = (a - front.centre)[:2], (b - side.centre)[:2]
        return a[:2] + np.linalg.solve(np.stack([first, -second], 1), (b - a)[:2])[0] * first

    order = ((0, 0), (0, 1), (1, 1), (1, 0))
    return np.stack([crossing(edges_front[f], edges_side[s]) for f, s in order])


# Slices from the crotch to the image's lower edge.
THIGH_SLICES = 12
# Pixels that they keep away from both.
THIGH_MARGIN_PX = 4
# A thigh reaches no farther ahead or back from the trunk's middle, metres.
FARTHEST_THIGH_M = 0.3
# Fewer rows of thigh are ignored, pixels.
LEAST_THIGH_PX = 40


class Thighs(NamedTuple):
    """Slices from the crotch downwards, world, metres; none where no thigh is visible."""

    heights: np.ndarray  # (S,) of the slices
    across: np.ndarray  # (S, 2, 2) y of the left and the right thigh's right and left edge
    deep: np.ndarray  # (S, 2) x of the back and the front of both


def find_thighs(
    front: PhotographView, side: PhotographView, landmarks: FrontLandmarks, middle: np.ndarray
) -> Thighs:
    """What two views show below the trunk; ``middle`` (3,) lies in it."""
    first, last = landmarks.bottom + 2 * THIGH_MARGIN_PX, len(front.mask) - 1 - THIGH_MARGIN_PX
    ahead, slices = np.array([1.0, 0.0, 0.0]), []
    rows = (
        np.linspace(first, last, THIGH_SLICES).astype(int) if last - first > LEAST_THIGH_PX else ()
    )
    for row in rows:
        columns = np.flatnonzero(front.mask[row])
        inner = (
            columns[columns > landmarks.middle_x][:1],
            columns[columns < landmarks.middle_x][-1:],
        )
        if not (inner[0].size and inner[1].size):
            continue
        # The person's left is on the right of the image; hands may hang beside the thighs.
        runs = [trunk_run(front.mask, row, float(x[0])) for x in inner]
        if runs[0] == runs[1]:
            continue
        ends = np.array([[x, row] for run in runs for x in (run[0] - 0.5, run[1] + 0.5)])
        edges = front.plane_points(ends, middle)
        across, height = np.sort(edges[:, 1].reshape(2, 2), 1), edges[:, 2].mean()
        at = np.array([[middle[0], y, height] for y in across.mean(1)])
        # One thigh hides the other: each reaches as far as the nearer edge at most.
        back, front_ = (side.extent(at, sign * ahead, FARTHEST_THIGH_M).min() for sign in (-1, 1))
        if min(back, front_) > 0:
            slices.append((height, across, middle[0] + np.array([-back, front_])))
    if not slices:
        return Thighs(np.zeros(0), np.zeros((0, 2, 2)), np.zeros((0, 2)))
    return Thighs(*(np.array(part) for part in zip(*slices, strict=True)))
