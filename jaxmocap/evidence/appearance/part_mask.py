"""Which pixels show one part of the person rather than another: sleeves, bare forearms.

INPUTS: a frame, the whole person's log-odds, colours of the part and of the rest of the body.
OUTPUTS: log-odds of the part.
"""

import cv2
import numpy as np

from jaxmocap.images.colours import Colours, colour_bins
from jaxmocap.images.foreground import MOST_ODDS, SOFTNESS

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
