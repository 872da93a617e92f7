"""A detector of poses in images, MediaPipe's, frame by frame in turn with the tracker.

It wants another NumPy than ours, so it runs in an environment of its own: as a script there it
reads numbers of frames from standard input, and writes how long each took. Nothing of this project
is imported by the script.

INPUTS: the Python of an environment with ``mediapipe``, a video. OUTPUTS: milliseconds.
"""

import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

# A line that the script writes once its model is there.
READY = "ready"


class Detector:
    """The script at work.

    Attributes:
        milliseconds: of the processor, for each frame that was asked for.
    """

    def __init__(self, process: "subprocess.Popen[str]"):
        self.milliseconds: list[float] = []
        self._process = process

    def detect(self, frame: int) -> None:
        """Let it look at a frame, and wait for it."""
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.write(f"{frame}\n")
        self._process.stdin.flush()
        self.milliseconds.append(float(self._process.stdout.readline()))


@contextmanager
def detector(python: str, video: Path) -> Iterator[Detector]:
    """The script on a video, on this process' cores.

    Args:
        python: of its environment.
        video: whose frames it looks at.

    Raises:
        OSError: that Python does not start.
        RuntimeError: it has no ``mediapipe``, or cannot read the video.
    """
    command = [python, str(Path(__file__).resolve()), str(video)]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
    with subprocess.Popen(command, text=True, **pipes) as process:
        assert process.stdout is not None
        if process.stdout.readline().strip() != READY:
            raise RuntimeError(f"{python}: MediaPipe's pose detector does not start there")
        try:
            yield Detector(process)
        finally:
            process.terminate()


def joints_found(python: str, video: Path) -> Any:
    """(F, 33, 3) joints of every frame of a video, metres about the hips; NaN where nobody is.

    Args:
        python: of its environment.
        video: that it looks at.

    Raises:
        RuntimeError: it has no ``mediapipe``, or cannot read the video.
    """
    import numpy as np

    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "joints.npy"
        command = [python, str(Path(__file__).resolve()), str(video), str(out)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise RuntimeError(f"{python}: MediaPipe's pose detector found nothing in {video}")
        return np.load(out)


def _write_joints(video: str, out: str) -> None:
    """The joints of all frames, by the full model."""
    import cv2
    import mediapipe  # type: ignore[import-not-found]
    import numpy as np

    pose, reader, rows = (
        mediapipe.solutions.pose.Pose(model_complexity=1), cv2.VideoCapture(video), []
    )  # fmt: skip
    while (read := reader.read())[0]:
        found = pose.process(cv2.cvtColor(read[1], cv2.COLOR_BGR2RGB)).pose_world_landmarks
        nobody = np.full((33, 3), np.nan)
        rows.append([(p.x, p.y, p.z) for p in found.landmark] if found else nobody)
    np.save(out, np.array(rows, np.float32))


def _serve(video: str) -> None:
    """Detect what is asked for, by the full model on one core."""
    import cv2  # type: ignore[import-not-found]
    import mediapipe  # type: ignore[import-not-found]

    cv2.setNumThreads(1)
    reader, images = cv2.VideoCapture(video), []
    while len(images) < 400:
        found, image = reader.read()
        if not found:
            break
        images.append(cv2.cvtColor(image, cv2.COLOR_BGR2RGB))
    if not images:
        sys.exit(f"{video}: no frame can be read")
    pose = mediapipe.solutions.pose.Pose(model_complexity=1)
    for image in images[:10]:
        pose.process(image)
    print(READY, flush=True)
    for line in sys.stdin:
        began = time.process_time()
        pose.process(images[int(line) % len(images)])
        print(1e3 * (time.process_time() - began), flush=True)


if __name__ == "__main__":
    _write_joints(*sys.argv[1:]) if len(sys.argv) > 2 else _serve(sys.argv[1])
