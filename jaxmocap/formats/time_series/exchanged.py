"""Markers whose labels a tracking system exchanges on the way, such as two controllers' roles.

From one sample to the next each of two markers leaps to where the other one was. No hand does that.
The labels that most samples have are kept.

INPUTS: Markers. OUTPUTS: Markers of which each has one label, and sentences about what changed.
"""

from dataclasses import replace
from itertools import combinations

import numpy as np

from jaxmocap.formats.time_series.tables import Markers

# Both leap by more than this, metres, and faster than two hands ever do, metres per second,
LEAST_LEAP_M, LEAST_SPEED_M_S = 0.1, 5.0
# to within this share of the leap of where the other one was, so many seconds ago at most.
NEAREST_SHARE = 0.25
LONGEST_GAP_S = 0.1


def undo_exchanges(markers: Markers) -> tuple[Markers, tuple[str, ...]]:
    """Markers of which each label stays with its marker, and a sentence for each pair."""
    exchanges = _exchanges(markers.times, markers.positions)
    if not exchanges:
        return markers, ()
    order = np.arange(len(markers.names))
    columns = np.tile(order, (len(markers.times), 1))
    rows_of: dict[tuple[int, int], list[int]] = {}
    for row, i, j in exchanges:
        order[[i, j]] = order[[j, i]]
        columns[row:] = order
        rows_of.setdefault((i, j), []).append(row)
    orders, counts = np.unique(columns, axis=0, return_counts=True)
    columns = columns[:, np.argsort(orders[counts.argmax()])]
    rows = np.arange(len(columns))[:, None]
    sentences = tuple(
        f"markers {markers.names[i]} and {markers.names[j]} exchange places within a sample, "
        f"{len(at)} times, first at {markers.times[at[0]]:.2f} s; the labels of most samples "
        "are kept"
        for (i, j), at in rows_of.items()
    )
    orientations = markers.orientations
    if orientations is not None:
        orientations = orientations[rows, columns]
    return replace(
        markers, positions=markers.positions[rows, columns], orientations=orientations
    ), sentences


def _exchanges(times: np.ndarray, positions: np.ndarray) -> list[tuple[int, int, int]]:
    """(row, marker, other) of each exchange, the row the first afterwards, in order of time."""
    # Rows to which a marker leaps from its last one.
    leaps, found = {}, []
    for i in range(positions.shape[1]):
        rows = np.flatnonzero(np.isfinite(positions[:, i]).all(-1))
        far = np.linalg.norm(np.diff(positions[rows, i], axis=0), axis=-1)
        if len(leaped := rows[1:][far > _longest_steps(times[rows])]):
            leaps[i] = leaped
    for i, j in combinations(leaps, 2):
        rows = np.flatnonzero(np.isfinite(positions[:, [i, j]]).all((1, 2)))
        pairs, allowed = positions[rows][:, [i, j]], _longest_steps(times[rows])
        stays = np.linalg.norm(pairs[1:] - pairs[:-1], axis=-1).min(1)
        exchanges = np.linalg.norm(pairs[1:] - pairs[:-1, ::-1], axis=-1).max(1)
        of_both = np.union1d(leaps[i], leaps[j])
        for k in np.flatnonzero((stays > allowed) & (exchanges <= NEAREST_SHARE * stays)):
            # One of them may have come again before the other.
            first = of_both[np.searchsorted(of_both, rows[k], side="right")]
            found.append((int(first), i, j))
    return sorted(found)


def _longest_steps(times: np.ndarray) -> np.ndarray:
    """(T - 1,) metres that a marker may go from one time (T,) to the next."""
    since = np.diff(times)
    longest = np.maximum(LEAST_LEAP_M, LEAST_SPEED_M_S * since)
    return np.where(since <= LONGEST_GAP_S, longest, np.inf)
