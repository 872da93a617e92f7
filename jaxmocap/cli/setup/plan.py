"""``jaxmocap plan``: where to put the camera, before anything is filmed.

INPUTS: a recording with markers, or a movement's name and a height. OUTPUTS: places of cameras and
expected deviations, as text, picture and figures.
"""

import argparse

from jaxmocap.cli.command import files_read, finite_number, names, numbers, positive_number, report
from jaxmocap.cli.command import positive_whole_number as whole

PURPOSE = "find where to put the camera"
EXAMPLE = "jaxmocap plan --height 1.75 --room 3,1,2,2 --out plan.png"

MOVEMENTS = ("tennis", "thrust", "reaching", "across", "raises", "squat")
MOST_CAMERAS = 4
# Frames a second: of film, and of the fastest cameras.
RATES = 1.0, 10_000.0
PLAN_TEXT = """\
Which place of a camera makes the joints surest, by gradient, and what it would be worth: the
deviation that a report would state. With a recording its markers show the movement, and its cameras
are those that stand now. Without one somebody with headset and controllers is drawn."""


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.description = f"{parser.description}\n\n{PLAN_TEXT}"
    parser.add_argument("recording", nargs="?", metavar="RECORDING.toml")
    parser.add_argument(
        "--movement", choices=MOVEMENTS, help="drawn where there is no recording; default: tennis"
    )
    parser.add_argument(
        "--height", type=positive_number, metavar="M", help="of that person; default: 1.75"
    )
    parser.add_argument(
        "--joints",
        type=names,
        default=["elbows"],
        metavar="NAMES",
        help="elbows, wrists, shoulders, hips, knees, ankles, or landmarks; default: elbows",
    )
    parser.add_argument(
        "--cameras", type=whole, default=2, metavar="N", help="to be placed, up to 4; default: 2"
    )
    parser.add_argument(
        "--room",
        type=numbers(4),
        default=(3.0, 3.0, 3.0, 3.0),
        metavar="A,B,L,R",
        help="how far a camera may stand from the person ahead, behind, to the left and to the "
        "right, metres; default: 3,3,3,3",
    )
    parser.add_argument(
        "--heights",
        type=numbers(2),
        default=(0.4, 2.2),
        metavar="M,M",
        help="lowest and highest place above the floor; default: 0.4,2.2",
    )
    parser.add_argument(
        "--fov",
        type=_fields_of_view,
        metavar="DEG[,DEG]",
        help="field of view along the longer side, two for a zoom lens; default: that of the "
        "recording's first camera, or 60",
    )
    parser.add_argument(
        "--rate",
        type=positive_number,
        default=30.0,
        metavar="HZ",
        help="frames a second; default: 30",
    )
    parser.add_argument("--out", metavar="PICTURE", help="the room from above (.png, .svg, .pdf)")


def _fields_of_view(text: str) -> tuple[float, ...]:
    """One or two angles."""
    if "," in text:
        return numbers(2)(text)
    return (finite_number(text),)


def run(options: argparse.Namespace) -> None:
    from jaxmocap.evaluation.plots import check_picture
    from jaxmocap.formats.files.errors import InputError
    from jaxmocap.formats.recordings.recording import load_recording
    from jaxmocap.pipelines.kept_programs import keep_compiled
    from jaxmocap.pipelines.planning.floor_plan import plot_floor_plan
    from jaxmocap.pipelines.planning.plan import plan_cameras
    from jaxmocap.pipelines.planning.requirements import Requirements

    if options.cameras > MOST_CAMERAS:
        raise InputError("--cameras", f"found {options.cameras}, expected 1 to {MOST_CAMERAS}")
    if not RATES[0] <= options.rate <= RATES[1]:
        expected = f"expected {RATES[0]:g} to {RATES[1]:g} frames a second"
        raise InputError("--rate", f"found {options.rate:g}, {expected}")
    for name in ("movement", "height"):
        if options.recording and getattr(options, name) is not None:
            raise InputError(f"--{name}", "is for a drawn movement, and a recording was given")
    if options.out:
        check_picture(options.out, files_read(options))
    keep_compiled()
    required = Requirements(
        tuple(options.joints), options.cameras, options.room, options.heights, options.fov,
        options.rate,
    )  # fmt: skip
    plan = plan_cameras(
        load_recording(options.recording) if options.recording else None,
        required,
        movement=options.movement or MOVEMENTS[0],
        height=options.height or 1.75,
        progress=True,
    )
    files = []
    if options.out:
        plot_floor_plan(options.out, plan)
        files.append(options.out)
    report(options, plan.text(files), plan.figures() | {"files": files})
