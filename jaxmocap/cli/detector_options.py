"""Options that name a detector of key points.

INPUTS: a command's parser; parsed options. OUTPUTS: the options; the Detector that they name.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from jaxmocap.cli.command import positive_number
from jaxmocap.formats.files.errors import InputError

if TYPE_CHECKING:
    from jaxmocap.pipelines.keypoints.detect import Detector

MEDIAPIPE = "mediapipe"
# Where the recipe for an environment of MediaPipe puts its Python.
USUAL_PYTHON = Path("mp/bin/python")
# Seconds that a frame may take.
MAX_TIMEOUT_S = 86400


def add_detector(parser: argparse.ArgumentParser, default: str | None = None) -> None:
    """The options --detector, --python and --detector-timeout."""
    add = parser.add_argument
    usual = "" if default is None else "; default: %(default)s"
    add(
        "--detector",
        metavar="NAME",
        required=default is None,
        default=default,
        help="mediapipe, or an RTMPose-like model as an .onnx file "
        f"(pip install 'jaxmocap[onnx]'){usual}",
    )
    add(
        "--python",
        metavar="FILE",
        help="for mediapipe: the Python of an environment that has it; default: "
        f"{USUAL_PYTHON} where there is one",
    )
    add(
        "--detector-timeout",
        metavar="S",
        type=positive_number,
        help="seconds that mediapipe may take for a frame; default: two minutes",
    )


def detector_of(options: argparse.Namespace) -> Detector:
    """The detector that the options name.

    Raises:
        InputError: there is none such; the sentence says how to make MediaPipe's environment.
    """
    if options.detector == MEDIAPIPE:
        from jaxmocap.pipelines.keypoints.by_mediapipe import RECIPE, TIMEOUT_S, mediapipe_detector

        python = options.python
        if python is None and USUAL_PYTHON.exists():
            python = str(USUAL_PYTHON)
        if python is None:
            problem = f"found no --python, expected an environment's; {RECIPE} makes one"
            raise InputError("--detector mediapipe", problem)
        timeout_s = TIMEOUT_S if options.detector_timeout is None else options.detector_timeout
        if not 0 < timeout_s <= MAX_TIMEOUT_S:
            problem = f"found {timeout_s:g}, expected seconds, up to {MAX_TIMEOUT_S}"
            raise InputError("--detector-timeout", problem)
        return mediapipe_detector(python, timeout_s)
    if not options.detector.endswith(".onnx"):
        expected = f"expected {MEDIAPIPE} or an .onnx file"
        raise InputError("--detector", f"found {options.detector!r}, {expected}")
    from jaxmocap.pipelines.keypoints.by_onnx import onnx_detector

    return onnx_detector(Path(options.detector))
