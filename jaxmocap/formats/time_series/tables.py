"""What TRC and CSV share: Markers, text lines, tables of numbers.

INPUTS: a text file; lines of cells.
OUTPUTS: Markers (seconds, metres); InputError with the line where something is wrong.
"""

import math
import unicodedata
from array import array
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from jaxmocap.formats.files.errors import InputError, short_repr
from jaxmocap.geometry.rows import ComputedRows, Index, Rows, row_blocks

# Of one table, 0.5 GB: half an hour of 60 markers at 200 Hz.
MAX_VALUES = 66_000_000
# In a file's own unit.
LARGEST_NUMBER = 1e15
# Metres from the origin: the earth's centre is nearer from everywhere on it.
FARTHEST_M = 1e7
# Seconds from 0: since any calendar's first day.
LATEST_S = 1e11
# Seconds between samples.
SHORTEST_STEP_S = 1e-5
# Some files round times to a millisecond: so far off is one then, and steps are longer than this.
MILLISECOND_S, LEAST_ROUNDED_STEP_S = 1.001e-3, 3.9e-3
# The last digit of what is written, metres.
SMALLEST_M = 1e-6
# Characters of a marker's or joint's name.
MAX_NAME_CHARACTERS = 200
# Units of length that marker files state.
METRES_PER_UNIT = {"m": 1.0, "cm": 0.01, "mm": 0.001}
# And those that a user may state of files that state none.
UNITS = METRES_PER_UNIT | {"in": 0.0254}
# Of a count in a header.
_MAX_DIGITS = 18


@dataclass(frozen=True)
class Markers:
    """Labelled points over T samples."""

    times: np.ndarray  # (T,) seconds, float64, ascending
    names: tuple[str, ...]  # of the M markers
    # (T, M, 3) metres, float64, in the file's own axes; all three NaN where missing.
    positions: np.ndarray
    # Samples per second as the file's header states them, whatever its time stamps say; or None
    # where it has no such field (only TRC has both).
    rate: float | None = None
    # (T, M, 3, 3) rotations from each marker's own axes to the file's, NaN where missing; or None
    # where no marker has any.
    orientations: np.ndarray | None = None
    # Marker -> how many positions the file has at exactly (0, 0, 0), which some writers have for
    # missing ones; without markers that have none.
    at_zero: Mapping[str, int] = field(default_factory=dict)
    left_out: tuple[str, ...] = ()  # what the file holds besides, in words

    def points(self) -> dict[str, np.ndarray]:
        """Name -> (T, 3) positions."""
        return {name: self.positions[:, i] for i, name in enumerate(self.names)}

    def measured_orientations(self) -> dict[str, np.ndarray]:
        """Name -> (T, 3, 3) orientations of the markers that have any."""
        if self.orientations is None:
            return {}
        columns = {name: self.orientations[:, i] for i, name in enumerate(self.names)}
        return {name: R for name, R in columns.items() if np.isfinite(R).any()}


def parse_rows(
    path: str | Path,
    rows: Iterable[tuple[int, Sequence[str]]],
    columns: int,
    max_values: int = MAX_VALUES,
) -> tuple[np.ndarray, np.ndarray]:
    """Numbers (T, columns) of numbered rows, float64, and the T line numbers; empty cells are NaN.

    Cells beyond ``columns`` must be empty. InputError names the line, or says what is too much.
    """
    values, numbers = array("d"), array("q")
    for line, cells in rows:
        if not any(map(str.strip, cells)):
            continue
        if len(cells) < columns or any(map(str.strip, cells[columns:])):
            raise InputError(path, f"line {line}: found {len(cells)} columns, expected {columns}")
        if len(values) + columns > max_values:
            problem = f"expected at most {max_values // columns} rows of {columns} numbers"
            raise InputError(path, f"line {line}: found one row more, {problem}")
        values.extend(_numbers(path, line, cells[:columns]))
        numbers.append(line)
    if not numbers:
        raise InputError(path, "found no frames after the header")
    table, lines = np.frombuffer(values).reshape(-1, columns), np.frombuffer(numbers, np.int64)
    beyond = np.fmax(np.fmax.reduce(table), -np.fmin.reduce(table)) > LARGEST_NUMBER
    if beyond.any():
        column = int(beyond.argmax())
        row = int((np.abs(table[:, column]) > LARGEST_NUMBER).argmax())
        expected = f"expected a number within {LARGEST_NUMBER:g}"
        raise InputError(path, f"line {lines[row]}: found '{table[row, column]:g}', {expected}")
    return table, lines


def _numbers(path: str | Path, line: int, cells: Sequence[str]) -> array:
    try:
        return array("d", map(float, cells))
    except ValueError:
        return array("d", (_number(path, line, cell) for cell in cells))


def _number(path: str | Path, line: int, cell: str) -> float:
    if not (text := cell.strip()):
        return math.nan
    try:
        return float(text)
    except ValueError:
        raise InputError(
            path, f"line {line}: found {short_repr(text)}, expected a number"
        ) from None


def declared_count(text: str) -> int | None:
    """A count that a header states, cut off where it is absurd; None for no whole number."""
    if not (text.isascii() and text.isdecimal()):
        return None
    return int(text) if len(text) <= _MAX_DIGITS else 10**_MAX_DIGITS


def make_markers(
    path: str | Path,
    table: np.ndarray,
    lines: Sequence[int] | np.ndarray,
    names: Sequence[str],
    name_place: str,
) -> Markers:
    """Markers from a table (T, 1 + 3 M) of times and coordinates, metres, which becomes their own.

    ``lines`` are the rows' (none where the file is not text), ``name_place`` is where names stand.

    Raises:
        InputError: two markers of one name, a name that no terminal can show, a time that is
            missing or does not follow the one before, a position that is nowhere on earth.
    """
    check_names(path, names, name_place)
    labels = ("line", lines) if len(lines) else ("frame", range(len(table)))
    check_times(path, table[:, 0], *labels)
    positions = table[:, 1:].reshape(len(table), -1, 3)
    beyond = np.fmax(np.fmax.reduce(positions), -np.fmin.reduce(positions)) > FARTHEST_M
    if beyond.any():
        marker, axis = np.argwhere(beyond)[0]
        column = positions[:, marker, axis]
        i = int((np.abs(column) > FARTHEST_M).argmax())
        problem = f"{labels[0]} {labels[1][i]}: marker {short_repr(names[marker])} is at"
        expected = f"expected a position within {FARTHEST_M:g} m"
        raise InputError(path, f"{problem} {column[i]:g} m, {expected}")
    # A marker of which one coordinate is missing is missing; so is one at exactly 0.
    is_zero = ~positions.any(-1)
    positions[np.isnan(positions).any(-1) | is_zero] = np.nan
    counts = zip(names, is_zero.sum(0).tolist(), strict=True)
    at_zero = {name: count for name, count in counts if count}
    return Markers(table[:, 0], tuple(names), positions, at_zero=at_zero)


def check_names(path: str | Path, names: Sequence[str], place: str, kind: str = "marker") -> None:
    """InputError where two things have one name, or one has none that can be written down."""
    earlier = set()
    for name in names:
        if len(name) > MAX_NAME_CHARACTERS or any(unicodedata.category(c) == "Cc" for c in name):
            expected = f"at most {MAX_NAME_CHARACTERS} characters, none of them for control"
            problem = f"{place}: found {short_repr(name)} as a name, expected {expected}"
            raise InputError(path, problem)
        if name in earlier:
            raise InputError(path, f"{place}: {kind} {short_repr(name)} is named twice")
        earlier.add(name)


def check_times(
    path: str | Path,
    times: np.ndarray,
    kind: str,
    numbers: Sequence[int] | np.ndarray | None = None,
) -> None:
    """InputError unless each of (T,) times, seconds, is a number and later than the one before.

    Nor may they follow one another faster than any device measures. Messages call a sample by its
    kind, such as ``line``, and its number, from 0 where there are no ``numbers``.
    """

    def label(i: int) -> str:
        return f"{kind} {i if numbers is None else numbers[i]}"

    if np.isnan(times).any():
        raise InputError(path, f"{label(int(np.isnan(times).argmax()))}: found no time")
    late = np.abs(times) > LATEST_S
    if late.any():
        i = int(late.argmax())
        expected = f"expected one within {LATEST_S:g} s"
        raise InputError(path, f"{label(i)}: found a time of {times[i]:g} s, {expected}")
    later = np.diff(times) > 0
    if not later.all():
        i = int((~later).argmax())
        raise InputError(
            path,
            f"{label(i + 1)}: time runs backwards, found {times[i + 1]:g} s after {times[i]:g} s",
        )
    if len(times) > 1 and (step := usual_step(times)) < SHORTEST_STEP_S:
        expected = f"expected at least {SHORTEST_STEP_S:g} s"
        raise InputError(path, f"found samples {step:.3g} s apart, {expected}")


def nearest_times(times: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(K,) index of the time (T,) nearest to each of (K,) others, and how far it is, seconds."""
    after = np.searchsorted(times, at).clip(1, max(len(times) - 1, 1))
    pair = np.stack([after - 1, after.clip(max=len(times) - 1)], 1)
    distance = np.abs(times[pair] - at[:, None])
    return pair[np.arange(len(at)), distance.argmin(1)], distance.min(1)


def usual_step(times: np.ndarray) -> float:
    """Seconds between samples (T,): the mean of the steps near the median; 0 of fewer than two.

    The median alone is none of 120 Hz in whole milliseconds.
    """
    if len(times) < 2:
        return 0.0
    steps = np.diff(times)
    middle = float(np.median(steps))
    near = steps[np.abs(steps - middle) <= min(MILLISECOND_S, middle / 2)]
    return float(near.mean()) if len(near) else middle


def is_even(times: np.ndarray) -> bool:
    """Does no step of (T,) times differ from the mean by more than 1 %, or 2 µs as text rounds?

    Where all times are whole milliseconds, each may be one off.
    """
    if len(times) < 2:
        return True
    steps = np.diff(times)
    mean = float(steps.mean())
    if np.abs(steps - mean).max() <= max(0.01 * mean, 2e-6):
        return True
    evenly = times[0] + mean * np.arange(len(times))
    return _in_milliseconds(times) and bool(np.abs(times - evenly).max() <= MILLISECOND_S)


def _in_milliseconds(times: np.ndarray) -> bool:
    """Whether times are whole milliseconds, and steps too long for one to be taken for another."""
    parts = times / 1e-3
    is_whole = np.abs(parts - np.round(parts)).max() < 1e-3
    return bool(is_whole) and times[-1] - times[0] >= LEAST_ROUNDED_STEP_S * (len(times) - 1)


def even_rate(path: str | Path, times: np.ndarray) -> float:
    """Samples per second of (T,) even times, 1 for a single one; InputError where they are not."""
    if len(times) == 1:
        return 1.0
    steps, step = np.diff(times), (times[-1] - times[0]) / (len(times) - 1)
    if not is_even(times):
        spacing = f"samples are {1e3 * steps.min():.3g} to {1e3 * steps.max():.3g} ms apart"
        raise InputError(path, f"{spacing}, the format holds one rate only (give --rate)")
    # 60.000024 is what is left of 60 after rounding.
    slack = MILLISECOND_S / step if _in_milliseconds(times) else 1e-3
    rates = (round(1 / step, decimals) for decimals in range(4))
    fitting = (rate for rate in rates if abs(rate * step - 1) * len(times) < slack)
    return next(fitting, 1 / step)


def row_texts(values: Rows, between: str, decimals: int = 6, nan: str = "") -> Iterator[str]:
    """The cells of each row of (T, C), joined; one row at a time, for tables of any length."""
    count, columns = values.shape
    cells = between.join([f"%.{decimals}f"] * columns)
    for rows in row_blocks(count):
        for row in values[rows]:
            text = cells % tuple(row)
            yield text.replace("nan", nan) if "nan" in text else text


def stack_points(
    times: np.ndarray,
    points: Mapping[str, Rows],
    forbidden: str,
    path: str | Path = "points to write",
    smallest_m: float = SMALLEST_M,
) -> tuple[np.ndarray, ComputedRows]:
    """Times (T,) and coordinates (T, 3 M) to write, checked.

    A point at the origin moves by the smallest distance written, since zeros mean missing.

    Raises:
        ValueError: shapes that do not fit, times that do not ascend, or a name that the format
            cannot hold; ``path`` is what messages name.
    """
    times = np.asarray(times, float)
    for name, positions in points.items():
        if not name.strip() or name != name.strip() or any(c in name for c in forbidden):
            raise InputError(path, f"marker name {short_repr(name)} cannot be written")
        if positions.shape != (len(times), 3):
            raise ValueError(
                f"marker {name!r}: found shape {positions.shape}, expected {(len(times), 3)}"
            )
        if any(np.isinf(positions[rows]).any() for rows in row_blocks(len(times))):
            raise ValueError("found an infinite position; missing ones are NaN")
    if not points or not len(times):
        raise InputError(path, "expected at least one marker and one sample to write")
    check_times(path, times, "sample")
    check_names(path, tuple(points), "names to write")

    def table(rows: Index) -> np.ndarray:
        parts = []
        for positions in points.values():
            part = np.array(positions[rows], float)
            is_zero = (np.abs(part) <= smallest_m / 2).all(-1)
            part[is_zero, 0] = np.copysign(smallest_m, part[is_zero, 0])
            parts.append(part)
        return np.concatenate(parts, -1)

    return times, ComputedRows((len(times), 3 * len(points)), table)
