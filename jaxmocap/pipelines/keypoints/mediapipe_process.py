"""A process that detects: MediaPipe's full model, frame by frame.

It runs in another environment and imports nothing of this package.

INPUTS: on standard input for each frame its height and width, as two little-endian 32-bit numbers,
and its pixels, BGR. OUTPUTS: a line ``ready``; for each frame a line of JSON, COCO's 17 points
[x, y, confidence], or an empty list.
"""

import json
import struct
import sys

# COCO's points by MediaPipe's numbers: nose, eyes, ears, then shoulders to ankles, left and right.
NUMBERS = (0, 2, 5, 7, 8, 11, 12, 13, 14, 15, 16, 23, 24, 25, 26, 27, 28)


def main() -> None:
    """Detect until the input ends."""
    import mediapipe  # type: ignore[import-not-found]
    import numpy as np

    pose = mediapipe.solutions.pose.Pose(model_complexity=1)
    print("ready", flush=True)
    while len(size := sys.stdin.buffer.read(8)) == 8:
        height, width = struct.unpack("<II", size)
        pixels = sys.stdin.buffer.read(3 * height * width)
        image = np.frombuffer(pixels, np.uint8).reshape(height, width, 3)
        found = pose.process(np.ascontiguousarray(image[..., ::-1])).pose_landmarks
        points = []
        if found:
            marks = [found.landmark[number] for number in NUMBERS]
            points = [[m.x * width - 0.5, m.y * height - 0.5, m.visibility] for m in marks]
        print(json.dumps(points), flush=True)


if __name__ == "__main__":
    main()
