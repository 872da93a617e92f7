"""``jaxmocap video``: a video of one camera and the person's height, and nothing else.

INPUTS: a video. OUTPUTS: a folder with the motion in every format, a report, overlay videos, and in
``recording`` the recording that was made of the video; exit code 1 where the person is lost in more
than half of the frames.
"""

import argparse
from dataclasses import replace
from pathlib import Path

from jaxmocap.cli.command import exit_code, positive_number, report
from jaxmocap.cli.detector_options import MEDIAPIPE, add_detector, detector_of

PURPOSE = "track a person in a video, by the height alone"
EXAMPLE = "jaxmocap video clip.mp4 --height 1.75 --out tracked --python mp/bin/python"

FOLDER = "recording"


def add_options(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("video", metavar="VIDEO", help="of a camera that stands still, of one person")
    add("--height", metavar="M", type=positive_number, required=True, help="of the person, metres")
    add("--out", metavar="DIR", required=True, help="where to write")
    add(
        "--fov",
        metavar="DEG",
        type=positive_number,
        help="field of view along the longer side, degrees; default: as the file states it, or "
        "else 62, with a warning",
    )
    add_detector(parser, MEDIAPIPE)


def run(options: argparse.Namespace) -> int:
    from jaxmocap.pipelines.kept_programs import keep_compiled
    from jaxmocap.pipelines.silhouettes.keypoints import lost_sentences
    from jaxmocap.pipelines.silhouettes.track import track_silhouettes
    from jaxmocap.pipelines.silhouettes.video import (
        RECORDING,
        recording_of_video,
        unmade_recording,
    )
    from jaxmocap.pipelines.silhouettes.writing import results_folder, write_results
    from jaxmocap.pipelines.summary import figures, summary

    keep_compiled()
    detector, out, inputs = detector_of(options), Path(options.out), [Path(options.video)]
    # Whether the folder can be written to, before any work.
    results_folder(out, unmade_recording(), inputs)
    made, warnings_before = recording_of_video(
        options.video, options.height, options.fov, detector, out / FOLDER, progress=True
    )
    # What was made within the folder is not in the way of what is written to it.
    made_here = replace(made, path=None)
    followed = track_silhouettes(made, warnings_before=warnings_before, progress=True)
    warnings: list[str] = []
    files = write_results(followed, made_here, out, True, inputs=inputs, warn=warnings.append)
    given = followed.motion, [out / FOLDER / RECORDING, *files], warnings
    report(options, summary(*given), figures(*given))
    return exit_code(options, lost_sentences(followed.motion))
