"""MediaPipe's pose detector, in a process and an environment of its own.

Its last version whose wheel brings the model, 0.10.21, wants NumPy 1, and cannot live beside ours.

INPUTS: the Python of an environment with ``mediapipe``; images.
OUTPUTS: 19 points of each image, and where in space it takes them to be.
"""

import json
import subprocess
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from jaxmocap.formats.files.errors import InputError, short_repr
from jaxmocap.formats.recordings.keypoint_models import MODELS
from jaxmocap.pipelines.keypoints.detect import Detect, Detector

SCRIPT = Path(__file__).with_name("mediapipe_process.py")
# What makes such an environment.
RECIPE = "python3.11 -m venv mp && mp/bin/pip install mediapipe==0.10.21"
# A line that the process writes once its model is there.
READY = "ready"
MODEL = "MEDIAPIPE_19"
# It may take so long to start, and for each frame, seconds.
TIMEOUT_S = 120.0
# An answer has some three kilobytes.
MAX_ANSWER_BYTES = 2**16


def mediapipe_detector(python: str, timeout_s: float = TIMEOUT_S) -> Detector:
    """The detector of an environment's Python, which may take so long to start and for a frame."""
    return Detector(MODEL, lambda: _open_process(python, timeout_s))


@contextmanager
def _open_process(python: str, timeout_s: float) -> Iterator[Detect]:
    """A process for one video: it follows the person from frame to frame.

    Raises:
        InputError: that Python does not start, has no ``mediapipe``, takes too long, answers
            something else than points, or its process ends.
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
                with _limit_time(python, process, timeout_s):
                    line = process.stdout.readline(MAX_ANSWER_BYTES)
                if line.decode(errors="replace").strip() != READY:
                    raise _end_reason(python, process, errors)

                def detect(image: np.ndarray, _: np.ndarray) -> np.ndarray | None:
                    assert process.stdin is not None and process.stdout is not None
                    with _limit_time(python, process, timeout_s):
                        try:
                            process.stdin.write(np.array(image.shape[:2], "<u4").tobytes())
                            process.stdin.write(np.ascontiguousarray(image).tobytes())
                            process.stdin.flush()
                        except OSError:
                            raise _end_reason(python, process, errors) from None
                        line = process.stdout.readline(MAX_ANSWER_BYTES)
                    if not line:
                        raise _end_reason(python, process, errors)
                    return _points(python, line)

                yield detect
            finally:
                process.kill()


@contextmanager
def _limit_time(
    python: str, process: "subprocess.Popen[bytes]", timeout_s: float
) -> Iterator[None]:
    """End a process that takes longer; InputError then, whatever was raised within."""
    late = threading.Event()

    def end() -> None:
        late.set()
        process.kill()

    timer = threading.Timer(timeout_s, end)
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
        if late.is_set():
            problem = f"MediaPipe's pose detector gave no answer within {timeout_s:g} s"
            raise InputError(python, f"{problem} (--detector-timeout)")


def _points(python: str, line: bytes) -> np.ndarray | None:
    """(K, 6) pixels, confidences and joints in an answer; None where nobody is."""
    expected = (len(MODELS[MODEL]), 6)
    try:
        points = np.array(json.loads(line), float)
        if not points.size:
            return None
        if points.shape == expected and np.isfinite(points).all():
            return points
    except (ValueError, TypeError, RecursionError):
        pass
    problem = f"MediaPipe's pose detector answered {short_repr(line.decode(errors='replace'))}"
    raise InputError(python, f"{problem}, expected {expected[0]} times 6 numbers")


def _end_reason(python: str, process: "subprocess.Popen[bytes]", errors) -> InputError:
    """What its last line says about why the process ended."""
    process.kill()
    process.wait()
    errors.seek(0)
    lines = [line for line in errors.read().splitlines() if line.strip()]
    if any("No module named" in line for line in lines[-3:]):
        return InputError(python, f"{lines[-1].strip()}; {RECIPE} makes an environment with it")
    reason = f" ({lines[-1].strip()})" if lines else ""
    return InputError(python, f"MediaPipe's pose detector ended{reason}")
