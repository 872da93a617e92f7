"""``jaxmocap offsets``: where devices sit in the hands and on the head.

INPUTS: a recording of devices that are turned about resting joints. OUTPUTS: lines for
[markers.on], with their standard deviations.
"""

import argparse

from jaxmocap.cli.command import numbers, report

PURPOSE = "find where devices sit in the hands"
EXAMPLE = "jaxmocap offsets turning.toml --turning 5,20 --still 0,3"

TURNING_TEXT = """\
For every marker with an orientation: its offset from its bone's joint, in its own axes.

Rest the forearms on a table and turn the hands about the wrists for ten seconds or more: up and
down, to the sides, and twisting; nod, turn and tilt the head. Prints lines for [markers.on] (those
with a warning are left out) and their standard deviations."""


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.description = f"{parser.description}\n\n{TURNING_TEXT}"
    parser.add_argument("recording", metavar="RECORDING.toml")
    parser.add_argument(
        "--turning",
        metavar="S,S",
        type=numbers(2),
        help="from when to when the devices turn about resting joints, seconds; default: always",
    )
    parser.add_argument(
        "--still",
        metavar="S,S",
        type=numbers(2),
        help="from when to when you stand upright, arms hanging, thumbs and nose forward; gives "
        "how the devices are held",
    )


def run(options: argparse.Namespace) -> None:
    from jaxmocap.calibration.devices.offsets import find_offsets, offsets_figures, offsets_text

    turning = options.turning or (float("-inf"), float("inf"))
    offsets = find_offsets(options.recording, options.still, turning)
    report(options, offsets_text(offsets), offsets_figures(offsets))
