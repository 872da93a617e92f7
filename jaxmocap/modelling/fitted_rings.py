"""A generic surface's rings moved to what was measured of a person.

Every ring keeps its level and its nodes' angles about its middle; middle and radii become those
that were measured there. Beyond what was measured the last ratio to the generic ring is carried on,
so that nothing leaps where measured and generic parts meet.

INPUTS: grids at rest (along, around, 3), Slices. OUTPUTS: such grids; how stout a person is.
"""

import numpy as np

from jaxmocap.body.skeleton import Skeleton
from jaxmocap.body.surfaces.loft import generic_surface, rest_joints
from jaxmocap.body.surfaces.surface import rest_nodes
from jaxmocap.modelling.slices import BodySlices

# A ring of less than this is the closed end of a limb, metres.
CLOSED_M = 1e-4
# Girth of the surface that exponents of girth are measured with.
STOUTER_GIRTH = 1.1


def fitted_grid(grid: np.ndarray, side: float, measured: BodySlices) -> np.ndarray:
    """(along, around, 3) the rings as they were measured; ``side`` is -1 on the right."""
    levels, phi = grid[:, 0, 2], 2 * np.pi * np.arange(grid.shape[1]) / grid.shape[1]
    middles, radii = _polar(grid[..., :2] * [1.0, side], phi)
    ratios, shifts = _ratios_and_shifts(levels, middles, radii, phi, measured)
    middles, radii = middles + shifts, radii * ratios
    across = middles[:, None] + radii[..., None] * np.stack([np.cos(phi), np.sin(phi)], -1)
    return np.concatenate([across * [1.0, side], grid[..., 2:]], -1)


def stoutness(skeleton: Skeleton, measured: dict[str, BodySlices]) -> float:
    """The girth at which a generic surface suits best what was measured, ring by ring."""
    joints, slopes, ratios = rest_joints(skeleton), [], []
    usual, stout = (generic_surface(skeleton, girth) for girth in (1.0, STOUTER_GIRTH))
    nodes, thick = rest_nodes(usual, joints), rest_nodes(stout, joints)
    for patch in usual.patches:
        if patch.name not in measured:
            continue
        grids = [patch.grid(n) for n in (nodes, thick)]
        low, high = np.sort(measured[patch.name].levels)[[0, -1]]
        within = (grids[0][:, 0, 2] > low) & (grids[0][:, 0, 2] < high)
        within[[0, -1]] = False
        new = fitted_grid(grids[0], patch.outwards, measured[patch.name])
        was, grown, now = (np.log(_size(grid[within])) for grid in (*grids, new))
        slopes.append((grown - was) / np.log(STOUTER_GIRTH))
        ratios.append(now - was)
    slope, ratio = np.concatenate(slopes), np.concatenate(ratios)
    return float(np.exp(slope @ ratio / (slope @ slope)))


def _size(grid: np.ndarray) -> np.ndarray:
    """(along,) mean of rings' half width and half depth."""
    return np.ptp(grid[..., :2], axis=1).mean(-1) / 2


def _ratios_and_shifts(
    levels: np.ndarray,
    middles: np.ndarray,
    radii: np.ndarray,
    phi: np.ndarray,
    measured: BodySlices,
) -> tuple[np.ndarray, np.ndarray]:
    """From generic to measured: ratios (along, around) of radii, shifts (along, 2) of middles."""
    order = np.argsort(measured.levels)
    heights, outlines = measured.levels[order], measured.outlines[order]
    there, around = _polar(outlines, phi)
    open_ = radii.min(1) > CLOSED_M
    within = open_ & (levels >= heights[0]) & (levels <= heights[-1])
    rows_within = np.flatnonzero(within)
    rows_within = rows_within[np.argsort(levels[rows_within])]
    at = levels[rows_within]
    result = [np.interp(at, heights, line) for line in np.concatenate([there, around], 1).T]
    result = np.stack(result, 1)
    change = np.concatenate(
        [result[:, :2] - middles[rows_within], result[:, 2:] / radii[rows_within] - 1], 1
    )
    carried = np.stack([np.interp(levels, at, line) for line in change.T], 1)
    (above, below) = measured.fades
    fade = 1 - np.clip(np.maximum((levels - at[-1]) / above, (at[0] - levels) / below), 0, 1)
    carried *= fade[:, None]
    return 1 + carried[:, 2:], carried[:, :2]


def _polar(outlines: np.ndarray, phi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Middles (K, 2) of closed outlines (K, N, 2), and radii (K, U) about them at angles (U,)."""
    middles = (outlines.max(1) + outlines.min(1)) / 2
    radii = np.zeros((len(outlines), len(phi)))
    for row, off in zip(radii, outlines - middles[:, None], strict=True):
        reach, angles = np.linalg.norm(off, axis=1), np.arctan2(off[:, 1], off[:, 0])
        order = np.argsort(angles)
        if reach.max() >= CLOSED_M:
            row[:] = np.interp(phi, angles[order], reach[order], period=2 * np.pi)
    return middles, radii
