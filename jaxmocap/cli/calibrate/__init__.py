"""The kinds of ``jaxmocap calibrate``: a camera's lens and its place, by a chessboard.

Begin with ``intrinsics``.
"""

from jaxmocap.cli.calibrate import extrinsics, intrinsics
from jaxmocap.cli.command import Command

PURPOSE = "calibrate a camera by a chessboard"
COMMANDS: tuple[Command, ...] = (intrinsics, extrinsics)
