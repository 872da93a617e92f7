"""What the commands of this room take on the command line, and the text that explains it.

INPUTS: a command's parser. OUTPUTS: the parser with its options; values of options.
"""

import argparse
import math
from collections.abc import Callable

BOARD = """\
Of a board its inner corners are counted, where four squares meet: a board of 5 x 8 squares is
--board 4x7. Its x axis runs along the first number, y along the second, z out of the print. Its
origin is the inner corner at the bottom left when you hold it with x to the right and y up, and
that end whose two outermost squares are black at the bottom (at the left where the first number is
odd). Of a ChArUco board: at the bottom left with its markers upright. --pictures draws the axes."""
POSE = """\
--pose X,Y,Z,RX,RY,RZ is the board's place in the world: its origin in metres, then its turns in
degrees about the world's fixed axes, about x first, then y, then z (extrinsic xyz; R = Rz Ry Rx).
A board that lies on the floor, print up, its axes along the world's, has turns of 0,0,0; one that
stands upright with y up and its print towards the world's -y has 90,0,0. --points instead is a
file of columns x,y,z,u,v (or name,x,y,z,u,v): metres in the world, pixels in the picture; at least
four on a plane, better six or more that are not."""
# Options whose value may begin with a minus, which is no option then.
SIGNED = ("--pose", "--origin", "--at")

TURNING = """\
For every marker that says how it is turned: where it sits seen from its bone's joint, in its own
axes. Rest the forearms on a table and turn the hands about the wrists for ten seconds or more: up
and down, to the sides, and twisting; nod, turn and tilt the head. Prints lines for [markers.on]
(those of a doubtful answer are left out) and their standard deviations."""

LENGTHS = """\
One of --height, --static and --recording says whose body it is. From a recording every length is
found that makes its motion fit best, markers and video, with how far lengths vary among people
beside it; each is said to be determined, partly, or not. Stretch both arms and swing them to the
side, to shoulder height and down, bend and stretch the elbows with the upper arms hanging, swing
the arms ahead, bend them before the chest, then bend the knees: 6 to 10 s, facing the camera."""


def add_intrinsics(parser: argparse.ArgumentParser) -> None:
    """Options of ``calibrate intrinsics``."""
    parser.description = f"{parser.description}\n\n{BOARD}"
    parser.add_argument("paths", metavar="IMAGE|VIDEO", nargs="+", help="10 to 20 views are best")
    _add_board(parser, required=True)
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


def add_extrinsics(parser: argparse.ArgumentParser) -> None:
    """Options of ``calibrate extrinsics``."""
    parser.description = f"{parser.description}\n\n{BOARD}\n\n{POSE}"
    parser.add_argument("image", metavar="IMAGE")
    place = parser.add_mutually_exclusive_group(required=True)
    place.add_argument("--pose", metavar="X,Y,Z,RX,RY,RZ", type=_numbers(6), help="of the board")
    place.add_argument("--points", metavar="POINTS.csv", help="listed points, instead of a board")
    _add_board(parser, required=False)
    parser.add_argument(
        "--origin",
        metavar="U,V",
        type=_numbers(2),
        help="pixel near the board's origin, for boards that look the same when turned",
    )
    parser.add_argument(
        "--up", choices=("y", "z"), default="z", help="vertical axis of what was measured"
    )
    parser.add_argument(
        "--upside-down",
        action="store_true",
        help="the camera hangs upside down, as from a ceiling; else one that comes out so is "
        "refused",
    )
    parser.add_argument(
        "--intrinsics", metavar="FILE", help=".toml or OpenCV's .yml; default: what --out holds"
    )


def _add_board(parser: argparse.ArgumentParser, required: bool) -> None:
    parser.add_argument(
        "--board", metavar="COLUMNSxROWS", type=_counts, required=required, help="inner corners"
    )
    parser.add_argument(
        "--square", metavar="M", type=positive, required=required, help="its side, metres"
    )
    parser.add_argument(
        "--charuco",
        metavar="DICT,M",
        type=_charuco,
        help="a ChArUco board: its dictionary and the side of a marker, such as 5X5_100,0.045",
    )
    parser.add_argument("--camera", metavar="NAME", required=True, help="its section in the file")
    parser.add_argument(
        "--out", metavar="CALIBRATION.toml", required=True, help="only that section is changed"
    )
    parser.add_argument("--pictures", metavar="DIR", help="draw what was found, to look at")


def with_signs(arguments: list[str]) -> list[str]:
    """Arguments in which ``--pose -1,2,3`` is one, as argparse wants it."""
    joined: list[str] = []
    for argument in arguments:
        if joined and joined[-1] in SIGNED and argument[:2] != "--":
            joined[-1] += f"={argument}"
        else:
            joined.append(argument)
    return joined


def positive(text: str) -> float:
    """A positive number."""
    value = float(text)
    if not 0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"found {text}, expected a positive number")
    return value


def finite(text: str) -> float:
    """Any number but infinity."""
    if not abs(value := float(text)) < float("inf"):
        raise argparse.ArgumentTypeError(f"found {text}, expected a finite number")
    return value


def natural(text: str) -> int:
    """A whole number from 0 on, of at most nine digits."""
    if not (text.isascii() and text.isdecimal() and len(text) < 10):
        raise argparse.ArgumentTypeError(f"found {text}, expected a whole number from 0 on")
    return int(text)


def add_scale(parser: argparse.ArgumentParser) -> None:
    """Options of ``scale``."""
    parser.description = f"{parser.description}\n\n{LENGTHS}"
    parser.add_argument(
        "--height",
        metavar="M",
        type=positive,
        help="metres; proportions are Winter's, and with --recording where its lengths start from",
    )
    source = parser.add_mutually_exclusive_group()
    source.add_argument("--static", metavar="FILE", help="markers of the person standing upright")
    source.add_argument(
        "--recording",
        metavar="RECORDING.toml",
        help="markers on head and hands, and video, of the arms stretched, swung and bent",
    )
    parser.add_argument("--mass", metavar="KG", type=positive, help="kilograms; default: 23 kg/m²")
    parser.add_argument(
        "--landmarks",
        metavar="LANDMARK=MARKER",
        type=landmark_pair,
        nargs="+",
        default=[],
        help="neck, hips, shoulders, and any others of the static trial; without it, those that "
        "are called as landmarks are",
    )
    parser.add_argument("--up", choices=("y", "z"), help="the static file's vertical; default: z")
    parser.add_argument(
        "--wrists", action="store_true", help="neck that turns, forearms that twist, wrists"
    )
    parser.add_argument("--out", metavar="FILE", required=True, help="subject.toml")


def landmark_pair(text: str) -> tuple[str, str]:
    """LANDMARK=MARKER."""
    landmark, equals, marker = text.partition("=")
    if not (landmark and equals and marker):
        raise argparse.ArgumentTypeError(f"found {text!r}, expected LANDMARK=MARKER")
    return landmark, marker


def add_offsets(parser: argparse.ArgumentParser) -> None:
    """Options of ``offsets``."""
    parser.description = f"{parser.description}\n\n{TURNING}"
    parser.add_argument("recording", metavar="RECORDING.toml")
    parser.add_argument(
        "--turning",
        metavar="S,S",
        type=_numbers(2),
        help="from when to when the devices turn about resting joints, seconds; default: always",
    )
    parser.add_argument(
        "--still",
        metavar="S,S",
        type=_numbers(2),
        help="from when to when you stand upright, arms hanging, thumbs and nose forward; tells "
        "how the devices are held",
    )


def _counts(text: str) -> tuple[int, int]:
    columns, _, rows = text.lower().partition("x")
    if not (columns.isdecimal() and rows.isdecimal()):
        raise argparse.ArgumentTypeError(f"found {text!r}, expected inner corners such as 4x7")
    return int(columns), int(rows)


def _charuco(text: str) -> tuple[str, float]:
    dictionary, _, marker = text.partition(",")
    return dictionary.strip(), positive(marker)


def _numbers(count: int) -> Callable[[str], tuple[float, ...]]:
    def numbers(text: str) -> tuple[float, ...]:
        try:
            values = tuple(float(part) for part in text.split(","))
        except ValueError:
            values = ()
        if len(values) != count or not all(map(math.isfinite, values)):
            raise argparse.ArgumentTypeError(f"found {text!r}, expected {count} numbers")
        return values

    return numbers
