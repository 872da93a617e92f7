"""Which cameras count, by how rim and contour match and how they agree with the others.

INPUTS: rims, pairs of C cameras. OUTPUTS: shares; cameras that disagree; histograms.
"""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np

from jaxmocap.silhouette.fit.correspond import Matches
from jaxmocap.silhouette.segmentation.segment import Histograms
from jaxmocap.silhouette.surfaces.rim import Rim


def matched_shares(rim: Rim, pairs: Matches, points: Sequence[int]) -> np.ndarray:
    """(C,) the smaller of the shares of rim points and of contour points that found a partner.

    Args:
        rim: of C cameras.
        pairs: of rim and contours.
        points: of each camera's contour.
    """
    outline = rim.valid & ~rim.inner
    shares = []
    for camera, count in enumerate(points):
        width = int((~rim.inner[camera]).sum())
        of_rim = pairs.valid[camera, :width].sum() / max(outline[camera].sum(), 1)
        taken = min(count, pairs.valid.shape[1] - width)
        of_contour = pairs.valid[camera, width:].sum() / max(taken, 1)
        shares.append(min(of_rim, of_contour))
    return np.array(shares)


def disagreeing(distances: np.ndarray, real: np.ndarray, apart: float, near: float) -> np.ndarray:
    """(C,) bool: cameras whose pairs lie much farther apart than all cameras' together.

    Args:
        distances: (C, N) of pairs, metres.
        real: (C, N) bool: those that are pairs.
        apart: how many times as far is much farther.
        near: unless they are within this, metres.
    """
    if real.any(1).sum() < 2:
        return np.zeros(len(real), bool)
    each = np.array(
        [np.median(d[r]) if r.any() else 0.0 for d, r in zip(distances, real, strict=True)]
    )
    usual = np.median(each[real.any(1)])
    return each > max(near, apart * usual)


def kept_histograms(used: np.ndarray, new: Histograms, old: Histograms) -> Histograms:
    """The new histograms of cameras that were used, the old ones of the others."""
    mask = jnp.asarray(used)[:, None]
    return Histograms(*(jnp.where(mask, a, b) for a, b in zip(new, old, strict=True)))
