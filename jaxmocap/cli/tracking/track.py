"""``jaxmocap track``: a recording with markers, with or without video.

INPUTS: a recording. OUTPUTS: a folder with the motion in every format, a report, overlay videos;
exit code 1 where the body is far off its markers.
"""

import argparse

from jaxmocap.cli.command import exit_code, positive_number, report
from jaxmocap.cli.recording_options import (
    add_cameras,
    add_settings,
    mode_of,
    recording_of,
    settings_of,
)

PURPOSE = "track a recording"
EXAMPLE = "jaxmocap track recording.toml --out tracked"


def add_options(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("recording", metavar="RECORDING.toml")
    add("--out", metavar="DIR", required=True, help="where to write")
    add_settings(parser)
    mode = parser.add_mutually_exclusive_group()
    mode.add_argument(
        "--causal",
        dest="mode",
        action="store_const",
        const="causal",
        help="use no later marker or frame than a live run would, which smooths each pose once it "
        "has received two more video frames, or some 0.1 s later",
    )
    mode.add_argument(
        "--nearest",
        dest="mode",
        action="store_const",
        const="nearest",
        help="use the frame nearest to each marker sample, as in the paper",
    )
    add(
        "--paper",
        action="store_true",
        help="as the first paper prints it: its edges, cost, simplex and balance, nothing smoothed "
        "or remembered, the nearest frame",
    )
    add_cameras(parser, "use these of the recording's cameras")
    add("--height", metavar="M", type=positive_number, help="metres, in place of the [subject]")
    add(
        "--why",
        action="store_true",
        help="state how sure each landmark would be without each marker, camera and prior: in the "
        "summary, report.json and recording.rrd",
    )
    add(
        "--names",
        choices=("opensim",),
        help="write angles_opensim.mot as well: the coordinates of OpenSim's full-body model "
        "(Rajagopal 2016), always Y up",
    )
    add("--up", choices=("z", "y"), help="vertical axis of joints.trc; default: z")


def run(options: argparse.Namespace) -> int:
    from jaxmocap.capture.checks.sides import exchanged_labels
    from jaxmocap.outputs.report import MISFIT_M
    from jaxmocap.pipelines.kept_programs import keep_compiled
    from jaxmocap.pipelines.summary import figures, misfit, summary
    from jaxmocap.pipelines.tracking.track import track_both
    from jaxmocap.pipelines.writing import OPENSIM_FILE, tracked_folder, write_outputs

    keep_compiled()
    settings, recording = settings_of(options), recording_of(options)
    mode = mode_of(options, settings)
    # Whether the folder can be written to, before any work.
    tracked_folder(options.out, recording, [OPENSIM_FILE] if options.names else [])
    motion, _, recording = track_both(
        recording, settings, mode=mode, progress=True, why=options.why
    )
    warnings = exchanged_labels(recording)
    files = write_outputs(
        motion, recording, options.out, settings, True, warnings.append,
        options.up or "z", opensim=options.names is not None,
    )  # fmt: skip
    given = motion, files, warnings
    report(options, summary(*given), figures(*given))
    problem = misfit(motion, MISFIT_M)
    return exit_code(options, [problem] if problem else [])
