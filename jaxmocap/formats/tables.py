"""What TRC and CSV share: Markers, text lines, tables of numbers.

INPUTS: a text file; lines of cells.
OUTPUTS: Markers (seconds, metres); InputError with the line where something is wrong.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from jaxmocap.formats.errors import InputError
from jaxmocap.formats.reading import MOST_TEXT_BYTES, read_bytes


@dataclass(frozen=True)
class Markers:
    """Labelled points over T samples.

    Attributes:
        times: (T,) seconds, float64, ascending.
        names: of the M markers.
        positions: (T, M, 3) metres, float64, in the file's own axes; all three NaN where missing.
        residuals: (T, M) metres, how far apart the rays of each point were, NaN where it is
            missing; or None where the file says nothing of them (only C3D does).
        rate: samples per second as the file's header states them, whatever its time stamps say;
            or None where it has no such field (only TRC has both).
        turns: (T, M, 3, 3) rotations from each marker's own axes to the file's, NaN where it is
            not known how it is turned; or None where that is known of no marker.
    """

    times: np.ndarray
    names: tuple[str, ...]
    positions: np.ndarray
    residuals: np.ndarray | None = None
    rate: float | None = None
    turns: np.ndarray | None = None

    def points(self) -> dict[str, np.ndarray]:
        """Name -> (T, 3) positions."""
        return {name: self.positions[:, i] for i, name in enumerate(self.names)}

    def turned(self) -> dict[str, np.ndarray]:
        """Name -> (T, 3, 3) turns of the markers of which any is known."""
        if self.turns is None:
            return {}
        columns = {name: self.turns[:, i] for i, name in enumerate(self.names)}
        return {name: R for name, R in columns.items() if np.isfinite(R).any()}


def read_lines(path: str | Path) -> list[str]:
    """Lines of a UTF-8 text file, without byte-order mark and line ends, none empty at the end."""
    content = read_bytes(path, MOST_TEXT_BYTES)
    if not content.strip():
        raise InputError(path, "the file is empty")
    if b"\0" in content:
        line = content.count(b"\n", 0, content.index(b"\0")) + 1
        raise InputError(path, f"line {line}: found binary data, expected text")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise InputError(path, f"line {line}: found bytes that are not UTF-8 text") from None
    # Not splitlines: it also splits at characters that a name may hold.
    return text.replace("\r\n", "\n").replace("\r", "\n").rstrip("\n").split("\n")


def parse_rows(
    path: str | Path, rows: Iterable[tuple[int, Sequence[str]]], columns: int
) -> tuple[np.ndarray, list[int]]:
    """Numbers of a table; empty cells are NaN.

    Args:
        path: for the message.
        rows: line number and cells of each row. Cells beyond ``columns`` must be empty.
        columns: how many cells a row has.

    Returns:
        (T, columns) float64 and the T line numbers.
    """
    table, numbers = [], []
    for line, cells in rows:
        if not any(map(str.strip, cells)):
            continue
        if len(cells) < columns or any(map(str.strip, cells[columns:])):
            raise InputError(path, f"line {line}: found {len(cells)} columns, expected {columns}")
        table.append([_number(path, line, cell) for cell in cells[:columns]])
        numbers.append(line)
    if not table:
        raise InputError(path, "found no frames after the header")
    return np.array(table), numbers


def _number(path: str | Path, line: int, cell: str) -> float:
    if not (text := cell.strip()):
        return math.nan
    try:
        value = float(text)
    except ValueError:
        value = math.inf
    if math.isinf(value):
        shown = text if len(text) <= 20 else text[:20] + "…"
        raise InputError(path, f"line {line}: found {shown!r}, expected a number")
    return value


def make_markers(
    path: str | Path,
    table: np.ndarray,
    lines: Sequence[int],
    names: Sequence[str],
    name_place: str,
) -> Markers:
    """Markers from a table (T, 1 + 3 M) of times and coordinates, in metres.

    Args:
        path: for the message.
        table: see above.
        lines: of the T rows; none where the file is not text.
        names: of the M markers.
        name_place: where in the file they stand.

    Raises:
        InputError: two markers of one name, a time that is missing or does not follow the one
            before.
    """
    for i, name in enumerate(names):
        if name in names[:i]:
            raise InputError(path, f"{name_place}: marker {name!r} is named twice")
    times = table[:, 0]
    places = [f"line {line}" for line in lines] or [f"frame {i}" for i in range(len(times))]
    check_times(path, times, places)
    positions = table[:, 1:].reshape(len(table), -1, 3)
    # A marker of which one coordinate is missing is missing.
    positions = np.where(np.isnan(positions).any(-1, keepdims=True), np.nan, positions)
    return Markers(times, tuple(names), positions)


def check_times(path: str | Path, times: np.ndarray, places: Sequence[str]) -> None:
    """InputError unless every one of (T,) times is a number and later than the one before."""
    if np.isnan(times).any():
        raise InputError(path, f"{places[int(np.isnan(times).argmax())]}: found no time")
    later = np.diff(times) > 0
    if not later.all():
        i = int((~later).argmax())
        raise InputError(
            path,
            f"{places[i + 1]}: time runs backwards, found {times[i + 1]:g} s after {times[i]:g} s",
        )


def is_even(times: np.ndarray) -> bool:
    """Does no step of (T,) times differ from their mean by more than a hundredth of it?

    Two microseconds are always allowed, since text files round.
    """
    steps = np.diff(times)
    return not len(steps) or bool(
        np.abs(steps - steps.mean()).max() <= max(0.01 * steps.mean(), 2e-6)
    )


def even_rate(path: str | Path, times: np.ndarray) -> float:
    """Samples per second of (T,) evenly spaced times; 1 for a single one.

    Raises:
        InputError: they are not evenly spaced.
    """
    if len(times) == 1:
        return 1.0
    steps, step = np.diff(times), (times[-1] - times[0]) / (len(times) - 1)
    if not is_even(times):
        found = f"samples are {1e3 * steps.min():.3g} to {1e3 * steps.max():.3g} ms apart"
        raise InputError(path, f"{found}, the format holds one rate only (give --rate)")
    # 60.000024 is what is left of 60 after rounding.
    rate = round(1 / step, 3)
    return rate if abs(rate * step - 1) * len(times) < 1e-3 else 1 / step


def format_rows(values: np.ndarray) -> np.ndarray:
    """Text cells of a float array, to the micrometre; empty where NaN."""
    return np.where(np.isnan(values), "", np.char.mod("%.6f", values))


def stack_points(
    times: np.ndarray, points: dict[str, np.ndarray], forbidden: str
) -> tuple[np.ndarray, np.ndarray]:
    """Times (T,) and coordinates (T, 3 M) to write, checked.

    Raises:
        ValueError: shapes that do not fit, times that do not ascend, or a name that the format
            cannot hold.
    """
    times = np.asarray(times, float)
    if any(np.isinf(positions).any() for positions in points.values()):
        raise ValueError("found an infinite position; missing ones are NaN")
    for name, positions in points.items():
        if not name.strip() or name != name.strip() or any(c in name for c in forbidden):
            raise ValueError(f"marker name {name!r} cannot be written")
        if np.shape(positions) != (len(times), 3):
            raise ValueError(
                f"marker {name!r}: found shape {np.shape(positions)}, expected {(len(times), 3)}"
            )
    if not points or not len(times):
        raise ValueError("expected at least one marker and one sample")
    check_times("times to write", times, [f"sample {i}" for i in range(len(times))])
    return times, np.concatenate([np.asarray(p, float) for p in points.values()], axis=1)
