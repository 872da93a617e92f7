"""``jaxmocap calibrate intrinsics``: a camera's focal length and lens.

INPUTS: pictures of a board. OUTPUTS: the camera's section of a calibration file.
"""

import argparse

from jaxmocap.cli.calibrate.board_options import BOARD_TEXT, add_board
from jaxmocap.cli.command import report

PURPOSE = "find focal length and lens"
EXAMPLE = (
    "jaxmocap calibrate intrinsics board*.jpg --board 4x7 --square 0.06 --camera cam_01 "
    "--out calibration.toml --pictures checked"
)


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.description = f"{parser.description}\n\n{BOARD_TEXT}"
    parser.add_argument("paths", metavar="IMAGE|VIDEO", nargs="+", help="10 to 20 views are best")
    add_board(parser, required=True)
    parser.add_argument(
        "--distortions",
        type=int,
        choices=(0, 1, 2, 4, 5),
        default=4,
        help="coefficients of the lens to find: none, k1, k1 k2, with p1 p2, with k3 (of a fisheye "
        "k1, k1 k2, k1 to k4); default: %(default)s",
    )
    parser.add_argument(
        "--fisheye", action="store_true", help="the lens is a fisheye: up to 180° from side to side"
    )


def run(options: argparse.Namespace) -> None:
    from jaxmocap.calibration.board.boards import parse_board
    from jaxmocap.calibration.board.opencv_lenses import LensKind
    from jaxmocap.calibration.calibrate import calibrate_camera

    board = parse_board(options.board, options.square, options.charuco)
    calibrated = calibrate_camera(
        options.paths,
        board,
        options.camera,
        options.out,
        LensKind(options.distortions, options.fisheye),
        options.pictures,
    )
    report(options, calibrated.text(), calibrated.figures())
