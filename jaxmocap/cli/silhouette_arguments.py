"""What the commands of ``silhouette`` take on the command line.

INPUTS: a command's parser. OUTPUTS: the parser with its options.
"""

import argparse
import math

from jaxmocap.cli.setup_arguments import natural, positive

EXERCISES = ("push_ups", "sit_ups", "arm_raises", "turn", "walking", "jumping", "scissors")


def add_silhouette_track(parser: argparse.ArgumentParser) -> None:
    """Options of ``silhouette track``."""
    parser.add_argument("recording", metavar="RECORDING.toml")
    parser.add_argument("--out", metavar="DIR", required=True, help="where to write")
    parser.add_argument(
        "--cameras", metavar="A,B", type=_names, help="use these of the recording's cameras"
    )
    parser.add_argument(
        "--at",
        metavar="X,Y,FACING",
        type=_place,
        help="where the person stands upright at first, metres, and faces, degrees from x towards "
        "y; default: as the recording's markers say",
    )
    learned = parser.add_mutually_exclusive_group()
    learned.add_argument(
        "--once",
        dest="passes",
        action="store_const",
        const=1,
        default=3,
        help="one pass, which knows of the rooms what its frames so far showed, and no girths; "
        "default: two passes learn both",
    )
    learned.add_argument(
        "--lengths",
        action="store_true",
        help="let these passes correct the bones' lengths too, where no static trial tells them",
    )
    parser.add_argument("--markers", action="store_true", help="follow the recording's markers too")
    parser.add_argument(
        "--shoulders",
        action="store_true",
        help="let shoulders go along with raised arms, up and back, as most people's do",
    )
    parser.add_argument(
        "--model",
        metavar="DIR",
        help="the person's own, as 'silhouette model' wrote it; default: a body of people's mean "
        "proportions around the recording's [subject]",
    )


def add_silhouette_demo(parser: argparse.ArgumentParser) -> None:
    """Options of ``silhouette demo``."""
    parser.add_argument(
        "--out", metavar="DIR", default="jaxmocap-silhouettes", help="default: %(default)s"
    )
    parser.add_argument("--seconds", type=positive, default=2.0, help="default: %(default)s")
    parser.add_argument(
        "--seed", type=natural, default=0, help="of the rooms, the movement and noise"
    )
    parser.add_argument(
        "--person",
        metavar="PERSON.npz",
        help="a rigged mesh that moves; default: a simple person made here, who squats",
    )
    parser.add_argument(
        "--exercise", choices=EXERCISES, default="arm_raises", help="of the mesh; %(default)s"
    )


def add_silhouette_model(parser: argparse.ArgumentParser) -> None:
    """Options of ``silhouette model``."""
    for name, stance in (
        ("front", "arms lifted off the trunk"),
        ("side", "from the left, arms spread towards and away from the camera"),
        ("joint", "from the front, upper arms level, forearms up, hands flat"),
        ("arm-side", "from the front, arms spread level, palms down"),
    ):
        parser.add_argument(f"--{name}", metavar="IMAGE", required=True, help=stance)
    parser.add_argument(
        "--calibration",
        metavar="FILE.toml",
        required=True,
        help="sections front and side, and joint and arm_side where it was another camera; in its "
        "world z is up and the person faces +x",
    )
    parser.add_argument("--out", metavar="DIR", required=True, help="where to write")
    parser.add_argument(
        "--bottom",
        metavar="ROW",
        type=natural,
        help="row of the front photograph where the trunk ends; default: where the legs part",
    )
    parser.add_argument(
        "--height",
        metavar="METRES",
        type=positive,
        help="of the body, which tells how long the legs are; default: as people's of such a trunk",
    )


def _names(text: str) -> list[str]:
    return [name.strip() for name in text.split(",")]


def _place(text: str) -> tuple[float, float, float]:
    try:
        x, y, facing = map(float, text.split(","))
        if not all(map(math.isfinite, (x, y, facing))):
            raise ValueError
    except ValueError:
        raise argparse.ArgumentTypeError(f"found {text!r}, expected X,Y,FACING") from None
    return x, y, facing
