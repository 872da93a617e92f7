"""A detector of poses in images, MediaPipe's, frame by frame in turn with the tracker.

It wants another NumPy than ours, so it runs in an environment of its own: as a script there it
reads numbers of frames from standard input, and writes how long each took. Nothing of this project
is imported by the script.

INPUTS: the Python of an environment with ``mediapipe``, a video. OUTPUTS: milliseconds.
"""

import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

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
    _serve(sys.argv[1])
