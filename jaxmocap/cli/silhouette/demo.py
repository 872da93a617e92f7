"""``jaxmocap silhouette demo``: a synthetic recording by four cameras, tracked and evaluated.

INPUTS: a folder, a duration, a seed, by choice a rigged mesh. OUTPUTS: the recording, its tracked
files, errors against the truth.
"""

import argparse

from jaxmocap.cli.command import report
from jaxmocap.cli.recording_options import add_demo
from jaxmocap.formats.files.errors import InputError

PURPOSE = "make a synthetic recording by four cameras and track it"
EXAMPLE = "jaxmocap silhouette demo --out jaxmocap-silhouettes"

# The names of ``synthetic.movements.exercises.EXERCISES``; --help does not load that.
EXERCISES = ("push_ups", "sit_ups", "arm_raises", "turn", "walking", "jumping", "scissors")
DEFAULT_EXERCISE = "arm_raises"


def add_options(parser: argparse.ArgumentParser) -> None:
    add_demo(parser, "jaxmocap-silhouettes", 2.0, "the rooms, the movement")
    add = parser.add_argument
    add(
        "--person",
        metavar="PERSON.npz",
        help="a rigged mesh that moves; default: a simple person made here, who squats",
    )
    add("--exercise", choices=EXERCISES, help=f"of the mesh; default: {DEFAULT_EXERCISE}")


def run(options: argparse.Namespace) -> None:
    from jaxmocap.pipelines.kept_programs import keep_compiled
    from jaxmocap.pipelines.silhouettes.demo import demonstrate_silhouettes

    if options.exercise and options.person is None:
        raise InputError("--exercise", "is of a rigged mesh, expected --person too")
    keep_compiled()
    exercise = options.exercise or DEFAULT_EXERCISE
    chosen = options.seconds, options.seed, options.person, exercise
    demonstration = demonstrate_silhouettes(options.out, *chosen, progress=True)
    files = "\n".join(f"written  {path}" for path in demonstration.files)
    report(options, f"{demonstration.text()}\n\n{files}", demonstration.as_dict())
