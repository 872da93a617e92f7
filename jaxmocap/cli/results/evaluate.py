"""``jaxmocap evaluate``: tracked joints against a reference.

INPUTS: a folder that ``track`` wrote, a reference's file. OUTPUTS: errors of each joint.
"""

import argparse
from typing import TYPE_CHECKING

from jaxmocap.cli.command import PairsAction, files_read, finite_number, pair, report

if TYPE_CHECKING:
    from jaxmocap.evaluation.errors import Errors

PURPOSE = "compare tracked joints with a reference"
EXAMPLE = "jaxmocap evaluate tracked truth.trc --match elbow_l=LElbow elbow_r=RElbow"
# Errors of more, metres, may be those of another vertical, if that has so small a share of them.
FAR_M, MUCH_NEARER = 0.3, 0.4


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "directory",
        metavar="DIR",
        help="what track --out was given, or its motion.npz or joints.trc",
    )
    parser.add_argument("truth", metavar="TRUTH.trc", help="reference: .trc .csv .c3d .bvh .glb")
    parser.add_argument(
        "--match",
        metavar="JOINT=MARKER",
        type=pair("JOINT=MARKER"),
        nargs="+",
        action=PairsAction,
        help="a joint and its marker in the reference; default: joints of the same name in both",
    )
    parser.add_argument(
        "--up", choices=("y", "z"), help="the reference's vertical; default: y of .bvh .glb, else z"
    )
    parser.add_argument(
        "--offset",
        metavar="S",
        type=finite_number,
        default=0.0,
        help="seconds to add to the reference's times; default: 0",
    )
    parser.add_argument(
        "--out",
        metavar="PICTURE",
        help="errors beside the deviations that were stated (.png, .svg, .pdf)",
    )


def run(options: argparse.Namespace) -> None:
    from jaxmocap.evaluation.errors import evaluate_directory
    from jaxmocap.evaluation.plots import check_picture
    from jaxmocap.evaluation.reliability import by_joint, plot_reliability
    from jaxmocap.evaluation.tables import format_table
    from jaxmocap.formats.files.errors import FileError, InputError

    if options.out:
        check_picture(options.out, files_read(options))
    errors = evaluate_directory(
        options.directory, options.truth, options.match, options.up, options.offset
    )
    lines, files = [format_table(errors), *_other_vertical(options, errors)], []
    if options.out:
        try:
            plot_reliability(options.out, by_joint(errors))
        except FileError:
            raise
        except ValueError as error:
            raise InputError(options.directory, str(error)) from None
        files.append(options.out)
        lines += ["", f"written  {options.out}"]
    report(options, "\n".join(lines), errors.as_dict() | {"files": files})


def _other_vertical(options: argparse.Namespace, errors: "Errors") -> list[str]:
    """A line where the reference fits far better with its other axis upwards."""
    from jaxmocap.evaluation.errors import evaluate_directory
    from jaxmocap.formats.time_series.markers import default_up

    if options.up is not None or not errors.mean > FAR_M:
        return []
    other = "z" if default_up(options.truth) == "y" else "y"
    turned = evaluate_directory(
        options.directory, options.truth, options.match, other, options.offset
    )
    if turned.mean > MUCH_NEARER * errors.mean:
        return []
    return ["", f"warning  with --up {other} the mean is {100 * turned.mean:.2f} cm"]
