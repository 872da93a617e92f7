"""``jaxmocap scale``: a person's body, by height, a static trial or a recording of movement.

INPUTS: a height, a static trial or a recording. OUTPUTS: subject.toml; its lengths and mass.
"""

import argparse

from jaxmocap.cli.command import PairsAction, files_read, pair, positive_number, report
from jaxmocap.formats.files.errors import InputError

PURPOSE = "write a person's body to a file"
EXAMPLE = "jaxmocap scale --height 1.80 --mass 75 --out subject.toml"

LENGTHS_TEXT = """\
One of --height, --static and --recording says whose body it is. From a recording every length is
found that makes its motion fit best, markers and video, with how far lengths vary among people
as a prior; each is reported as determined, partly, or not. Stretch both arms and swing them to the
side, to shoulder height and down, bend and stretch the elbows with the upper arms hanging, swing
the arms ahead, bend them before the chest, then bend the knees: 6 to 10 s, facing the camera."""


def add_options(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    parser.description = f"{parser.description}\n\n{LENGTHS_TEXT}"
    add(
        "--height",
        metavar="M",
        type=positive_number,
        help="metres; lengths follow from it, and with --recording start from there",
    )
    source = parser.add_mutually_exclusive_group()
    source.add_argument("--static", metavar="FILE", help="markers of the person standing upright")
    source.add_argument(
        "--recording",
        metavar="RECORDING.toml",
        help="markers on head and hands, and video, of the arms stretched, swung and bent",
    )
    add("--mass", metavar="KG", type=positive_number, help="kilograms; default: 23 kg/m²")
    add("--sex", choices=("female", "male"), help="with --height; default: the mean of both")
    add(
        "--landmarks",
        metavar="LANDMARK=MARKER",
        type=pair("LANDMARK=MARKER"),
        nargs="+",
        action=PairsAction,
        default={},
        help="neck, hips, shoulders, and any others of the static trial; without it, those that "
        "are called as landmarks are",
    )
    add("--up", choices=("y", "z"), help="the static file's vertical; default: z")
    add("--wrists", action="store_true", help="neck that turns, forearms that twist, wrists")
    add("--out", metavar="FILE", required=True, help="subject.toml")


def run(options: argparse.Namespace) -> None:
    from jaxmocap.formats.files.writing import check_target
    from jaxmocap.formats.recordings.subject import check_replaceable

    out = check_target(options.out, files_read(options))
    check_replaceable(out)
    if options.recording is None:
        from jaxmocap.calibration.static_trial import scale_subject

        body = scale_subject(
            options.out,
            options.height,
            options.static,
            options.landmarks,
            options.up,
            options.mass,
            options.wrists,
            options.sex,
        )
    elif options.landmarks or options.up or options.wrists:
        stated = "--landmarks, --up and --wrists do not go with --recording, whose file states them"
        raise InputError(options.recording, stated)
    else:
        # The picture of the lengths replaces that of an earlier run alone.
        picture = check_target(out.with_suffix(".png"), files_read(options))
        if picture.exists() and not out.exists():
            problem = "is there and no earlier run wrote it; move it away, or choose another --out"
            raise InputError(picture, problem)
        # A recording takes what tracks, which height and static trial do without.
        from jaxmocap.pipelines.kept_programs import keep_compiled
        from jaxmocap.pipelines.scaling.fit_lengths import scale_by_recording

        keep_compiled()
        chosen = options.recording, options.height, options.mass, options.sex
        body = scale_by_recording(options.out, *chosen, progress=True)
    report(options, body.text(), body.figures())
