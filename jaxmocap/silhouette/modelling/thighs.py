"""Thighs, as far down as the front and the side photograph show them.

The front view shows where either thigh lies across, the side view how far both reach ahead and
back.

INPUTS: two Views nearly at right angles; landmarks of the front view; a point in the trunk.
OUTPUTS: Thighs.
"""

from typing import NamedTuple

import numpy as np

from jaxmocap.silhouette.modelling.pictures.views import PhotographView
from jaxmocap.silhouette.modelling.separation import FrontLandmarks, trunk_run

# Slices from the crotch to the image's lower edge.
SLICES = 12
# Pixels that they keep away from both.
MARGIN_PX = 4
# A thigh reaches no farther ahead or back from the trunk's middle, metres.
FARTHEST_M = 0.3
# Fewer rows of thigh are ignored, pixels.
LEAST_PX = 40


class Thighs(NamedTuple):
    """Slices from the crotch downwards, world, metres; none where no thigh is visible.

    Attributes:
        heights: (S,) of the slices.
        across: (S, 2, 2) y of the left and the right thigh's right and left edge.
        deep: (S, 2) x of the back and the front of both.
    """

    heights: np.ndarray
    across: np.ndarray
    deep: np.ndarray


def find_thighs(
    front: PhotographView, side: PhotographView, landmarks: FrontLandmarks, middle: np.ndarray
) -> Thighs:
    """What two views show below the trunk; ``middle`` (3,) lies in it."""
    first, last = landmarks.bottom + 2 * MARGIN_PX, len(front.mask) - 1 - MARGIN_PX
    ahead, slices = np.array([1.0, 0.0, 0.0]), []
    rows = np.linspace(first, last, SLICES).astype(int) if last - first > LEAST_PX else ()
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
        back, front_ = (side.extent(at, sign * ahead, FARTHEST_M).min() for sign in (-1, 1))
        if min(back, front_) > 0:
            slices.append((height, across, middle[0] + np.array([-back, front_])))
    if not slices:
        return Thighs(np.zeros(0), np.zeros((0, 2, 2)), np.zeros((0, 2)))
    return Thighs(*(np.array(part) for part in zip(*slices, strict=True)))
