"""``jaxmocap keypoints``: 2-D key points of a recording's videos, by a detector.

INPUTS: a recording, a detector. OUTPUTS: a file for each video, and the lines for the recording's
file; exit code 1 where somebody was found in no frame of a video.
"""

import argparse
from pathlib import Path

from jaxmocap.cli.command import exit_code, report
from jaxmocap.cli.detector_options import add_detector, detector_of
from jaxmocap.cli.recording_options import add_cameras, recording_of

PURPOSE = "find 2-D key points in a recording's videos by a detector"
EXAMPLE = "jaxmocap keypoints recording.toml --detector mediapipe --python mp/bin/python --write"

FOLDER = "keypoints"


def add_options(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("recording", metavar="RECORDING.toml")
    add_detector(parser)
    add("--out", metavar="DIR", help=f"default: {FOLDER} beside the recording")
    add("--write", action="store_true", help="put the lines into the recording's file")
    add_cameras(parser, "of these cameras only")


def run(options: argparse.Namespace) -> int:
    from jaxmocap.formats.files.toml import toml_value
    from jaxmocap.formats.files.writing import check_target
    from jaxmocap.pipelines.keypoints.detect import detect_keypoints, keypoint_entries, put_into

    detector, path = detector_of(options), Path(options.recording)
    recording = recording_of(options)
    if options.write:
        check_target(path)
    folder = Path(options.out) if options.out else path.parent / FOLDER
    results = detect_keypoints(recording, detector, folder, progress=True)
    entries = keypoint_entries(results, path)
    if options.write and entries:
        put_into(path, entries, detector.model)
    text = []
    for result in results:
        text.append(f"{result.camera}: found in {result.found} of {result.frames} frames")
        if result.camera in entries:
            text.append(f"    keypoints = {toml_value(entries[result.camera])}")
    todo = f"the lines are in {path}" if options.write else "put the lines into the [[video]]s"
    text += [todo] if entries else []
    figures = [{**result._asdict(), "file": result.file and str(result.file)} for result in results]
    report(options, "\n".join(text), {"videos": figures})
    nobody = [result.camera for result in results if not result.found]
    return exit_code(options, [f"{name}: nobody was found in any frame" for name in nobody])
