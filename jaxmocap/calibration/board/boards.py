"""Calibration boards: chessboards, and ChArUco boards whose squares carry numbers.

INPUTS: counts of inner corners, the size of a square. OUTPUTS: a Board and its corners, metres.

A board's frame: x runs along the first number of ``COLUMNSxROWS``, y along the second, z out of the
print, towards who looks at it. So a board that lies on the floor, print up, has its z up. Its
origin is the inner corner at the bottom left where the board is held so that x points right and y
up: of a chessboard, with that end at the bottom (or, where the first number is odd, at the left)
whose two outermost squares are black; of a ChArUco board, with its markers upright.
"""

from dataclasses import dataclass

import numpy as np

from jaxmocap.formats.files.errors import InputError

# A larger "square" was meant in millimetres.
LARGEST_SQUARE_M = 1.0


@dataclass(frozen=True)
class Board:
    """A flat board of squares."""

    columns: int  # inner corners along x
    rows: int  # inner corners along y
    square: float  # side of a square, metres
    # Of a ChArUco board's markers, such as ``5X5_100``; None for a chessboard.
    dictionary: str | None = None
    marker: float = 0.0  # side of a marker, metres; 0 for a chessboard

    def __post_init__(self):
        """Check what OpenCV would answer with an assertion."""
        if min(self.columns, self.rows) < 3:
            raise InputError(f"board {self.label}", "expected at least 3 x 3 inner corners")
        if not 0 < self.square <= LARGEST_SQUARE_M:
            problem = f"found a square of {self.square:g}, expected metres (60 mm is 0.06)"
            raise InputError(f"board {self.label}", problem)
        if self.dictionary is not None and not 0 < self.marker < self.square:
            problem = f"found a marker of {self.marker:g} m, expected less than its square"
            raise InputError(f"board {self.label}", f"{problem} ({self.square:g} m)")

    @property
    def label(self) -> str:
        """Its counts, as they are given on the command line."""
        return f"{self.columns}x{self.rows}"

    @property
    def points_board(self) -> np.ndarray:
        """(columns · rows, 3) inner corners in the board's frame, metres, along x first."""
        y, x = np.mgrid[: self.rows, : self.columns]
        return self.square * np.stack([x, y, np.zeros_like(x)], -1).reshape(-1, 3).astype(float)

    @property
    def symmetry_order(self) -> int:
        """Order of its rotational symmetry: 1, 2 (half turns) or 4."""
        if self.dictionary is not None or (self.columns + self.rows) % 2:
            return 1
        return 4 if self.columns == self.rows else 2


def parse_board(
    counts: tuple[int, int], square: float, charuco: tuple[str, float] | None = None
) -> Board:
    """A Board from what the command line holds."""
    return Board(*counts, square, *(charuco or (None, 0.0)))
