"""Drawn hulls of projected limbs, by OpenCV: where in an image a body may be.

INPUTS: discs in pixels. OUTPUTS: masks.
"""

import cv2
import numpy as np

from jaxmocap.geometry.outlines import Discs
from jaxmocap.images.colours import Colours, colour_bins
from jaxmocap.images.foreground import MOST_ODDS, SOFTNESS

# Directions in which a hull's corners lie.
ANGLES = np.linspace(0, 2 * np.pi, 24, endpoint=False)
WAYS = np.stack([np.cos(ANGLES), np.sin(ANGLES)], 1)
# Pixels farther out than this are no longer whole numbers that OpenCV takes.
FARTHEST_PX = 1e5


def draw_hulls(discs: Discs, size: tuple[int, int]) -> np.ndarray:
    """The union (h, w) bool of K hulls in an image of width and height ``size``.

    Args:
        discs: K, pixels; those that are not finite, or too far away, are left out.
        size: of the image.
    """
    mask = np.zeros((size[1], size[0]), np.uint8)
    near, far, radii = (np.asarray(part, float) for part in discs)
    # What is not a number is not less either.
    kept = (np.abs(np.concatenate([near, far, radii], 1)) < FARTHEST_PX).all(1)
    near, far, radii = near[kept], far[kept], radii[kept]
    # In each direction the hull reaches as far as the disc that reaches farther.
    is_far = far @ WAYS.T + radii[:, 1:] > near @ WAYS.T + radii[:, :1]
    reach = np.where(is_far, radii[:, 1:], radii[:, :1])[..., None] * WAYS
    corners = np.where(is_far[..., None], far[:, None], near[:, None]) + reach
    for polygon in np.rint(corners).astype(np.int32):
        cv2.fillConvexPoly(mask, polygon, 1)
    return mask.view(bool)


# The part is a piece of the person; where the person is doubtful it may still be there.
BENEFIT = 1.0


def part_odds(
    frame: np.ndarray, person: np.ndarray, colours: Colours, elsewhere: np.ndarray
) -> np.ndarray:
    """Log-odds (h, w) float32 that pixels show the part.

    Args:
        frame: (h, w, 3) uint8.
        person: (h, w) log-odds of the whole person.
        colours: of the part against the rest of the body.
        elsewhere: (h, w) bool, where something else may have the part's colours: weighs nothing.
    """
    ratio = np.take(np.log(colours.body / colours.rest), colour_bins(frame))
    odds = np.clip(np.minimum(ratio, person + BENEFIT), -MOST_ODDS, MOST_ODDS)
    odds = cv2.GaussianBlur(odds.astype(np.float32), (0, 0), SOFTNESS)
    return np.where(elsewhere, np.float32(0), odds)
