"""Where trunk, arms, neck and legs of a silhouette meet (second paper, 2.1, body separation).

INPUTS: the mask of a person seen from the front, arms lifted off the trunk.
OUTPUTS: the trunk's bottom line, both arm pits, the neck's narrowest row; a ValueError where the
arms touch the trunk.
"""

from typing import NamedTuple

import numpy as np

# Over an arm the trunk's run leaps out by so much of its half, at least.
LEAST_LEAP = 0.3
# An arm's gap reaches down so much of the way to the bottom line, at least.
LEAST_GAP = 0.2
# An arm pit lies so far above that line, at least, of the way to the head's top.
LEAST_HEIGHT = 0.25
# Legs are apart where the gap between them is at least so many pixels wide and so many high.
LEG_GAP_PX = (2, 6)
# The neck begins where a slice is so much narrower than the head's widest,
NECK_BEGINS = 0.94
# and ends where one is so much wider than its narrowest.
NECK_ENDS = 1.25


class FrontLandmarks(NamedTuple):
    """Places of a silhouette seen from the front, pixels (x, y)."""

    top: int  # row of the head's highest pixel
    neck: int  # row where the neck is narrowest
    neck_x: float  # the neck's middle there
    # (2, 2) the person's left arm pit, which is on the right of the image, and the right.
    pits: np.ndarray
    bottom: int  # row of the trunk's bottom line
    middle_x: float  # the trunk's middle at the bottom line


def find_landmarks(mask: np.ndarray, bottom: int | None = None) -> FrontLandmarks:
    """Landmarks of a silhouette (H, W) bool, from the front.

    ``bottom`` is the row of the trunk's bottom line; without it, where the legs part.

    Raises:
        ValueError: no gap between an arm and the trunk, or none between the legs.
    """
    top = int(np.flatnonzero(mask.any(1))[0])
    bottom = crotch(mask) if bottom is None else bottom
    if not 0 <= bottom < len(mask):
        raise ValueError(f"found row {bottom} as the trunk's bottom line, expected one of the "
                         f"image's {len(mask)} rows")  # fmt: skip
    first, last = trunk_run(mask, bottom)
    middle = (first + last) / 2
    pits = arm_pits(mask, top, bottom, middle)
    neck, neck_x = narrowest_neck(mask, top, int(pits[:, 1].min()), middle)
    return FrontLandmarks(top, neck, neck_x, pits, bottom, middle)


def crotch(mask: np.ndarray) -> int:
    """The lowest row in which the legs have not parted, by the gap that reaches the lower edge."""
    columns = np.flatnonzero(mask[-1])
    if len(columns) == 0:
        raise ValueError("the person ends above the image's lower edge, expected them from the "
                         "thighs upwards, or the row of the trunk's bottom line")  # fmt: skip
    between = np.flatnonzero(~mask[-1, columns[0] : columns[-1] + 1]) + columns[0]
    if len(between) < LEG_GAP_PX[0]:
        raise ValueError("found no gap between the legs at the image's lower edge, expected legs "
                         "apart, or the row of the trunk's bottom line")  # fmt: skip
    # The gap's middle wanders upwards: follow what is open of it.
    row, (a, b) = len(mask) - 1, (between[0], between[-1])
    while row > 0:
        open_ = np.flatnonzero(~mask[row - 1, a : b + 1]) + a
        if len(open_) == 0 or row - 1 <= np.flatnonzero(mask.any(1))[0]:
            break
        a, b, row = open_[0], open_[-1], row - 1
    if len(mask) - row < LEG_GAP_PX[1]:
        raise ValueError("found no gap between the legs, expected legs apart, or the row of the "
                         "trunk's bottom line")  # fmt: skip
    return row - 1


def trunk_run(mask: np.ndarray, row: int, x: float | None = None) -> tuple[int, int]:
    """First and last column of the run about ``x`` in a row; by default the widest of the row."""
    padded = np.concatenate([[False], mask[row], [False]])
    firsts = np.flatnonzero(~padded[:-1] & padded[1:])
    lasts = np.flatnonzero(padded[:-1] & ~padded[1:]) - 1
    if len(firsts) == 0:
        raise ValueError(f"nobody in row {row}")
    if x is None:
        best = int(np.argmax(lasts - firsts))
    else:
        best = int(np.argmin(np.maximum(np.maximum(firsts - x, x - lasts), 0)))
    return int(firsts[best]), int(lasts[best])


def arm_pits(mask: np.ndarray, top: int, bottom: int, middle_x: float) -> np.ndarray:
    """(2, 2) the highest places between trunk and arms, pixels: the corners of the silhouette.

    Going up from the bottom line the trunk's run of pixels ends at gaps on both sides; where a
    gap ends, the run leaps out over the arm.
    """
    runs = np.zeros((bottom + 1, 2), int)
    for row in range(bottom, top - 1, -1):
        runs[row] = trunk_run(mask, row, middle_x)
    return np.array([_pit(mask, runs, top, bottom, side) for side in (1, -1)], float)


def _pit(mask: np.ndarray, runs: np.ndarray, top: int, bottom: int, side: int) -> tuple[int, int]:
    """(x, y) of the arm pit on the right (1) or the left (-1) of the image."""
    edges = runs[:, 1 if side > 0 else 0]
    half = side * (edges[bottom] - runs[bottom].mean())
    leaps = side * np.diff(edges) < -LEAST_LEAP * half
    if leaps[top:bottom].any():
        row = top + int(np.flatnonzero(leaps[top:bottom])[-1])
        # In this row the run is trunk and arm; below it the gap must stay open.
        below = range(row + 1, min(bottom, row + 2 + int(LEAST_GAP * (bottom - row))))
        high = bottom - row > LEAST_HEIGHT * (bottom - top)
        if high and all(_beyond(mask, r, edges[r], side) for r in below):
            return int(edges[row + 1]) + side, row + 1
    name = "left" if side > 0 else "right"
    raise ValueError(
        f"found no gap between the {name} arm and the trunk, expected arms lifted off the trunk "
        "and hands off the thighs"
    )


def _beyond(mask: np.ndarray, row: int, edge: int, side: int) -> bool:
    """Is there, in this row, anything of the person farther out?"""
    return bool((mask[row, edge + 2 :] if side > 0 else mask[row, : max(edge - 1, 0)]).any())


def narrowest_neck(mask: np.ndarray, top: int, pits: int, middle_x: float) -> tuple[int, float]:
    """Row of the neck's narrowest slice and its middle there, between head and shoulders."""
    rows = range(top, pits)
    runs = np.array([trunk_run(mask, row, middle_x) for row in rows])
    widths = runs[:, 1] - runs[:, 0] + 1
    # Down from the top: past the head's widest slice, and on until the shoulders begin.
    widest = np.maximum.accumulate(widths)
    slim_rows = np.flatnonzero(widths < NECK_BEGINS * widest)
    if len(slim_rows) == 0:
        raise ValueError("found no neck, expected head and shoulders above the arms")
    below = widths[slim_rows[0] :]
    least = np.minimum.accumulate(below)
    wider = np.flatnonzero(below > NECK_ENDS * least)
    end = wider[0] if len(wider) else len(below)
    slim = np.flatnonzero(below[:end] == below[:end].min()) + slim_rows[0]
    place = int(np.median(slim))
    return top + place, float(runs[place].mean())
