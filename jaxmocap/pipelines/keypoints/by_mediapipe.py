"""MediaPipe's pose detector, in a process and an environment of its own.

Its last version whose wheel brings the model, 0.10.21, wants NumPy 1, and cannot live beside ours.

INPUTS: the Python of an environment with ``mediapipe``; images. OUTPUTS: COCO's 17 points of each.
"""

import json
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from jaxmocap.formats.files.errors import InputError
from jaxmocap.pipelines.keypoints.detect import Detect, Detector

SCRIPT = Path(__file__).with_name("mediapipe_process.py")
# What makes such an environment.
RECIPE = "python3.11 -m venv mp && mp/bin/pip install mediapipe==0.10.21"
# A line that the process writes once its model is there.
READY = "ready"


def mediapipe_detector(python: str) -> Detector:
    """The detector of an environment's Python.

    Args:
        python: such as ``mp/bin/python``.
    """
    return Detector("COCO_17", lambda: _opened(python))


@contextmanager
def _opened(python: str) -> Iterator[Detect]:
    """A process for one video: it follows the person from frame to frame.

    Raises:
        InputError: that Python does not start, has no ``mediapipe``, or its process ends.
    """
    with tempfile.TemporaryFile("w+") as errors:
        pipe = subprocess.PIPE
        try:
            process = subprocess.Popen(
                [python, str(SCRIPT)], stdin=pipe, stdout=pipe, stderr=errors
            )
        except OSError as error:
            problem = f"cannot be started ({error.strerror}); {RECIPE} makes an environment"
            raise InputError(python, problem) from None
        with process:
            try:
                assert process.stdin is not None and process.stdout is not None
                if process.stdout.readline().decode(errors="replace").strip() != READY:
                    raise _ended(python, process, errors)

                def detect(image: np.ndarray, _: np.ndarray) -> np.ndarray | None:
                    assert process.stdin is not None and process.stdout is not None
                    try:
                        process.stdin.write(np.array(image.shape[:2], "<u4").tobytes())
                        process.stdin.write(np.ascontiguousarray(image).tobytes())
                        process.stdin.flush()
                        points = json.loads(process.stdout.readline())
                    except (OSError, ValueError):
                        raise _ended(python, process, errors) from None
                    return np.array(points) if points else None

                yield detect
            finally:
                process.kill()


def _ended(python: str, process: "subprocess.Popen[bytes]", errors) -> InputError:
    """What its last line says about why the process ended."""
    process.kill()
    process.wait()
    errors.seek(0)
    lines = [line for line in errors.read().splitlines() if line.strip()]
    if any("No module named" in line for line in lines[-3:]):
        return InputError(python, f"{lines[-1].strip()}; {RECIPE} makes an environment with it")
    reason = f" ({lines[-1].strip()})" if lines else ""
    return InputError(python, f"MediaPipe's pose detector ended{reason}")
