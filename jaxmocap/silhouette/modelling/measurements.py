"""Girths, widths and depths of a person's model, as a tape and callipers would find them.

INPUTS: a PersonModel. OUTPUTS: Sections by the name of the place.
"""

from typing import NamedTuple

import numpy as np
from scipy.spatial import ConvexHull

from jaxmocap.silhouette.modelling.arm_surface import INNER_RINGS, SLICES
from jaxmocap.silhouette.modelling.person import PersonModel

# Shares of the way from the bottom line to the arm pits: within them the chest is stoutest,
CHEST = (0.75, 0.98)
# the waist slimmest,
WAIST = (0.25, 0.75)
# and the hips are stoutest.
HIPS = (0.02, 0.4)
# Where on its bone an arm is measured.
MEASURED_AT = {"upper_arm": (0, 0.5), "forearm": (SLICES[0], 0.25)}


class GirthSection(NamedTuple):
    """One place: metres."""

    width: float  # across; of an arm, along the hinge of its elbow
    depth: float  # to the front; of an arm, in the plane in which it bends
    girth: float  # of a tape around it

    def to_millimetres(self) -> dict[str, float]:
        """By name, to a tenth of a millimetre."""
        return {name: round(value, 4) for name, value in self._asdict().items()}


def girth_section(outline: np.ndarray) -> GirthSection:
    """Of a closed outline (N, 2) across and ahead."""
    hull = outline[ConvexHull(outline).vertices]
    girth = np.linalg.norm(np.roll(hull, -1, 0) - hull, axis=1).sum()
    width, depth = np.ptp(outline, axis=0)
    return GirthSection(float(width), float(depth), float(girth))


def girths(model: PersonModel) -> dict[str, GirthSection]:
    """Neck, chest, waist, hips, and of either arm the upper arm, the forearm and the wrist."""
    rings = model.trunk.rings
    levels = rings[:, 0, 2]
    shares = (levels - levels[0]) / (model.trunk.pits[:, 2].mean() - levels[0])
    all_ = [girth_section(ring[:, [1, 0]]) for ring in rings]
    result = {"neck": all_[int(np.argmin(np.abs(levels - model.neck_height())))]}
    for name, (low, high), sign in (("chest", CHEST, 1), ("waist", WAIST, -1), ("hips", HIPS, 1)):
        among = np.flatnonzero((shares > low) & (shares < high))
        result[name] = all_[max(among, key=lambda k: sign * all_[k].girth)]
    for side, arm in zip("lr", model.arms, strict=True):
        for name, (first, share) in MEASURED_AT.items():
            ring = arm[INNER_RINGS + first + round(share * SLICES[0])]
            result[f"{name}_{side}"] = girth_section(ring[:, [2, 0]])
        result[f"wrist_{side}"] = girth_section(arm[INNER_RINGS + sum(SLICES[:2])][:, [2, 0]])
    return result
