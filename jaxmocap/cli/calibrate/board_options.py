"""Options of a chessboard or a ChArUco board, and the text that explains them.

INPUTS: a command's parser. OUTPUTS: the parser with its options.
"""

import argparse

from jaxmocap.cli.command import charuco_markers, inner_corners, positive_number

BOARD_TEXT = """\
Of a board its inner corners are counted, where four squares meet: a board of 5 x 8 squares is
--board 4x7. Its x axis runs along the first number, y along the second, z out of the print. Its
origin is the inner corner at the bottom left when you hold it with x to the right and y up, and
that end whose two outermost squares are black at the bottom (at the left where the first number is
odd). Of a ChArUco board: at the bottom left with its markers upright. --pictures draws the axes."""


def add_board(parser: argparse.ArgumentParser, required: bool) -> None:
    """Options of the board, of the camera, and of what is written."""
    add = parser.add_argument
    add(
        "--board",
        metavar="COLUMNSxROWS",
        type=inner_corners,
        required=required,
        help="inner corners, such as 4x7",
    )
    add(
        "--square",
        metavar="M",
        type=positive_number,
        required=required,
        help="side of a square, metres",
    )
    add(
        "--charuco",
        metavar="DICT,M",
        type=charuco_markers,
        help="a ChArUco board: its dictionary and the side of a marker, metres, such as "
        "5X5_100,0.045",
    )
    add("--camera", metavar="NAME", required=True, help="its section in the file")
    add("--out", metavar="CALIBRATION.toml", required=True, help="only that section is changed")
    add("--pictures", metavar="DIR", help="draw what was found, to look at")
