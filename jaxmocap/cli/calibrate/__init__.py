"""The kinds of ``jaxmocap calibrate``: a camera's lens and its place, by a chessboard.

Begin with ``intrinsics``.
"""

from jaxmocap.cli.calibrate import extrinsics, intrinsics

PURPOSE = "calibrate a camera by a chessboard"
COMMANDS = (intrinsics.COMMAND, extrinsics.COMMAND)
