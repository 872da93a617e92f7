"""``jaxmocap calibrate extrinsics``: where a camera stands.

INPUTS: a picture of a board or of measured points. OUTPUTS: the camera's section of a calibration
file.
"""

import argparse

from jaxmocap.cli.calibrate.board_options import BOARD_TEXT, add_board
from jaxmocap.cli.command import numbers, report

PURPOSE = "find where a camera stands"
EXAMPLE = (
    "jaxmocap calibrate extrinsics floor.jpg --board 4x7 --square 0.06 --pose "
    "0.5,1.2,0,0,0,90 --camera cam_01 --out calibration.toml --pictures checked"
)

POSE_TEXT = """\
--pose X,Y,Z,RX,RY,RZ is the board's place in the world: its origin in metres, then its rotations in
degrees about the world's fixed axes, about x first, then y, then z (extrinsic xyz; R = Rz Ry Rx).
A board that lies on the floor, print up, its axes along the world's, has 0,0,0; one that
stands upright with y up and its print towards the world's -y has 90,0,0. --points instead is a
file of columns x,y,z,u,v (or name,x,y,z,u,v): metres in the world, pixels in the picture; at least
four on a plane, better six or more that are not."""


def add_options(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    parser.description = f"{parser.description}\n\n{BOARD_TEXT}\n\n{POSE_TEXT}"
    add("image", metavar="IMAGE")
    place = parser.add_mutually_exclusive_group(required=True)
    place.add_argument("--pose", metavar="X,Y,Z,RX,RY,RZ", type=numbers(6), help="of the board")
    place.add_argument("--points", metavar="POINTS.csv", help="listed points, instead of a board")
    add_board(parser, required=False)
    add(
        "--origin",
        metavar="U,V",
        type=numbers(2),
        help="pixel near the board's origin, for boards that look the same when rotated",
    )
    add("--up", choices=("y", "z"), default="z", help="vertical axis of what was measured")
    add(
        "--upside-down",
        action="store_true",
        help="the camera hangs upside down, as from a ceiling; else one that comes out so is "
        "refused",
    )
    add("--intrinsics", metavar="FILE", help=".toml or OpenCV's .yml; default: what --out holds")


def run(options: argparse.Namespace) -> None:
    from jaxmocap.calibration.board.boards import parse_board
    from jaxmocap.calibration.place_camera import PlacementTarget, place_camera
    from jaxmocap.formats.files.errors import InputError, comma_list

    board = None
    if options.points is not None:
        board_options = "board", "square", "charuco", "origin"
        stated = [f"--{name}" for name in board_options if getattr(options, name) is not None]
        if stated:
            raise InputError("--points", f"takes no board, found {comma_list(stated)}")
    else:
        if options.board is None or options.square is None:
            raise InputError("--pose", "is of a board, expected --board and --square too")
        board = parse_board(options.board, options.square, options.charuco)
    target = PlacementTarget(board, options.pose, options.origin, options.points, options.up)
    files = options.out, options.intrinsics, options.pictures
    calibrated = place_camera(options.image, target, options.camera, *files, options.upside_down)
    report(options, calibrated.text(), calibrated.figures())
