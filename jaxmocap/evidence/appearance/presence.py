"""Whether a camera shows the person where the markers have the person.

One that films another room, or at another time, or stands elsewhere, shows the room there. That is
no evidence that the person's arms are elsewhere.

INPUTS: log-odds of frames, masks. OUTPUTS: shares; grids, of weight 0 where nobody is shown.
"""

from collections.abc import Sequence

import numpy as np

from jaxmocap.evidence.silhouettes import SilhouetteGrids
from jaxmocap.images.foreground import weigh_odds

# Weight of the pixels in the mean, below which they tell nothing.
LEAST_WEIGHT = 0.05
# A camera shows nobody if less than this share of its evidence speaks for the person.
LEAST_SHARE = 0.5


def share_of_person(odds: np.ndarray, core: np.ndarray) -> float:
    """Share of the evidence where the person must be that speaks for the person, 0 to 1.

    NaN where hardly any pixel there tells anything, or none is in the image.

    Args:
        odds: (h, w) log-odds that pixels show the person.
        core: (h, w) bool, where the person must be.
    """
    if not core.any():
        return np.nan
    person, weight = (float(part.mean()) for part in weigh_odds(odds[core][:, None]))
    return person / weight if weight > LEAST_WEIGHT else np.nan


def without_nobody(grids: SilhouetteGrids, shares: Sequence[float]) -> SilhouetteGrids:
    """Grids as they are, or of weight 0 where most of the frames' shares are the room's."""
    counted = [share for share in shares if np.isfinite(share)]
    if counted and np.median(counted) < LEAST_SHARE:
        return grids.each_grid(lambda grid: grid._replace(weight=0 * grid.weight))
    return grids
