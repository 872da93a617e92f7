"""From a file's axes to the world's, Z up, and back.

INPUTS: ``up`` ("z" or "y") or ``to_world`` (3 × 3) of a table in a recording; Markers.
OUTPUTS: the matrix that takes the file's points to the world; Markers in a file's axes.
"""

from dataclasses import replace

import numpy as np

from jaxmocap.formats.cameras.calibration import is_orthonormal
from jaxmocap.formats.files.toml import TomlTable
from jaxmocap.formats.time_series.tables import Markers

Z_UP, Y_UP = "z", "y"
# "y" is the cyclic permutation that OpenSim and Pose2Sim use: world = (z, x, y) of the file.
R_WORLD_OF_UP = {Z_UP: np.eye(3), Y_UP: np.eye(3)[[2, 0, 1]]}
# Unity's frame is left-handed: x right, y up, z forward. The matrix is a reflection.
R_WORLD_UNITY = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


def read_axes(fields: TomlTable) -> np.ndarray:
    """(3, 3) R_world_file; Z up where the table says nothing.

    Raises:
        InputError: both fields at once, an unknown ``up``, or a matrix with other than unit rows
            at right angles. A reflection is allowed: some files are left-handed.
    """
    if "to_world" not in fields:
        up = fields.choice("up", R_WORLD_OF_UP, "'z' or 'y'") if "up" in fields else Z_UP
        return R_WORLD_OF_UP[up]
    if "up" in fields:
        raise fields.error("", "found both 'up' and 'to_world', expected one of them")
    expected = "a 3 × 3 matrix with unit rows at right angles"
    matrix = fields.array("to_world", [(3, 3)], expected)
    if not is_orthonormal(matrix):
        raise fields.error("to_world", f"found {matrix.tolist()}, expected {expected}")
    return matrix


def to_world(R_world_file: np.ndarray, positions_file: np.ndarray) -> np.ndarray:
    """Turn (..., 3) positions of a file into the world's axes; a point with a NaN stays NaN."""
    if (R_world_file == np.eye(3)).all():
        return positions_file
    return positions_file @ R_world_file.T


def from_world(markers: Markers, up: str) -> Markers:
    """Markers of the world in the axes of a file that is Z up or Y up."""
    R_world_file = R_WORLD_OF_UP[up]
    orientations = markers.orientations
    return replace(
        markers,
        positions=to_world(R_world_file.T, markers.positions),
        orientations=None if orientations is None else R_world_file.T @ orientations,
    )
