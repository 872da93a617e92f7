"""Three or more markers of one rigid set as one marker with an orientation.

INPUTS: Markers, and which of them form sets.
OUTPUTS: Markers with one more for each set: at the middle of its markers, x from the first to the
second, z upright on the plane of the first three (x towards the third makes y).

A set's shape is the median over all samples in which its first three are present; then each sample
is fitted by least squares (Kabsch) to those present, three at least.
"""

import warnings
from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from jaxmocap.formats.files.errors import comma_list, short_repr
from jaxmocap.formats.files.toml import TomlTable
from jaxmocap.formats.time_series.tables import Markers

MIN_MARKERS = 3
# Samples times markers with an orientation: 0.4 GB.
MAX_ORIENTATIONS = 5_000_000
# Markers nearer to one line than this, metres, do not determine a set's rotation about it.
MIN_WIDTH_M = 0.005


def with_rigid_sets(fields: TomlTable, markers: Markers, names: Collection[str]) -> Markers:
    """Those markers that are wanted and, behind them, the sets of [markers.rigid].

    Without sets all markers stay as they are.

    Raises:
        InputError: a set's marker that is not in the file, a set called as a marker is, or one
            that is never complete or lies on a line; or more orientations than memory holds.
    """
    sets: dict[str, list[str]] = fields.entries
    for name, members in sets.items():
        texts = isinstance(members, list) and all(isinstance(each, str) for each in members)
        if not texts or len(set(members)) < MIN_MARKERS or len(set(members)) < len(members):
            expected = "a list of three or more different markers"
            raise fields.error(name, f"found {short_repr(members)}, expected {expected}")
    if not sets:
        return markers
    by_name, samples = markers.points(), len(markers.times)
    kept = [i for i, name in enumerate(markers.names) if name in names]
    count = len(kept) + len(sets)
    if samples * count > MAX_ORIENTATIONS:
        most = f"expected at most {MAX_ORIENTATIONS} orientations"
        raise fields.error("", f"found {samples} samples of {count} markers and sets, {most}")
    orientations = np.full((samples, count, 3, 3), np.nan)
    if markers.orientations is not None:
        orientations[:, : len(kept)] = markers.orientations[:, kept]
    centres = []
    for i, (name, members) in enumerate(sets.items(), len(kept)):
        missing = [member for member in members if member not in by_name]
        if missing or name in by_name:
            problem = f"no marker {short_repr(missing[0])}" if missing else "a marker of that name"
            problem = f"found {problem} in the file, which has {comma_list(by_name)}"
            raise fields.error(name, problem)
        points = np.stack([by_name[m] for m in members], 1)
        centre, orientations[:, i] = _fitted_poses(fields, name, points, members)
        centres.append(centre)
    return replace(
        markers,
        names=(*(markers.names[i] for i in kept), *sets),
        positions=np.concatenate([markers.positions[:, kept], np.stack(centres, 1)], 1),
        orientations=orientations,
    )


def _fitted_poses(
    fields: TomlTable, name: str, points: np.ndarray, members: Sequence[str]
) -> tuple[np.ndarray, np.ndarray]:
    """Centres (T, 3) and orientations (T, 3, 3) of a set's (T, K, 3) markers; NaN below three."""
    is_complete = np.isfinite(points[:, :MIN_MARKERS]).all((1, 2))
    if not is_complete.any():
        raise fields.error(name, f"found {comma_list(members[:MIN_MARKERS])} in no common sample")
    shape = _rest_shape(points[is_complete])
    unseen = [m for m, at in zip(members, shape, strict=True) if not np.isfinite(at).all()]
    if unseen:
        raise fields.error(name, f"found {short_repr(unseen[0])} never beside the first three")
    if np.linalg.svd(shape - shape.mean(0), compute_uv=False)[1] < MIN_WIDTH_M:
        problem = "found all markers on one line, which determines no rotation about it"
        raise fields.error(name, problem)
    is_measured = np.isfinite(points.sum(-1))
    enough = is_measured.sum(1) >= MIN_MARKERS
    weights = is_measured[..., None] / np.maximum(is_measured.sum(1), 1)[:, None, None]
    present = np.where(is_measured[..., None], points, 0.0)
    centre = (weights * present).sum(1)
    shape_centre = (weights * shape).sum(1)
    H = np.einsum("tki,tkj->tij", weights * (present - centre[:, None]),
                  shape - shape_centre[:, None])  # fmt: skip
    U, _, Vt = np.linalg.svd(H)
    U[..., 2] *= np.linalg.det(U @ Vt)[:, None]
    R = np.where(enough[:, None, None], U @ Vt, np.nan)
    return centre - np.einsum("tij,tj->ti", R, shape_centre), R


def _rest_shape(points: np.ndarray) -> np.ndarray:
    """Markers (K, 3) in the set's axes, metres, about their middle."""
    first, second, third = (points[:, i] for i in range(MIN_MARKERS))
    x, aside = second - first, third - first
    z = np.cross(x, aside)
    with np.errstate(invalid="ignore"):
        x, z = (each / np.linalg.norm(each, axis=-1, keepdims=True) for each in (x, z))
    R = np.stack([x, np.cross(z, x), z], -1)
    upright = np.isfinite(R.sum((1, 2)))[:, None, None]
    local = np.einsum("tji,tkj->tki", R, points - points[:, :MIN_MARKERS].mean(1, keepdims=True))
    with warnings.catch_warnings():
        # A marker that is never present is NaN here; the caller raises the error.
        warnings.simplefilter("ignore", RuntimeWarning)
        shape = np.nanmedian(np.where(upright, local, np.nan), 0)
    return shape - shape.mean(0)
