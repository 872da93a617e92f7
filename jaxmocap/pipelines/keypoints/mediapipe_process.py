"""A process that detects: MediaPipe's full model, frame by frame.

It runs in another environment and imports nothing of this package.

INPUTS: on standard input for each frame its height and width, as two little-endian 32-bit numbers,
and its pixels, BGR. OUTPUTS: a line ``ready``; for each frame a line of JSON, COCO's 17 points and
the toes, each [x, y, confidence, X, Y, Z] in pixels and in metres about the hips' middle, right,
down and away from the camera; or an empty list.
"""

import json
import struct
import sys

# The points by MediaPipe's numbers: nose, eyes, ears, then shoulders to toes, left and right.
NUMBERS = (0, 2, 5, 7, 8, 11, 12, 13, 14, 15, 16, 23, 24, 25, 26, 27, 28, 31, 32)


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
        found = pose.process(np.ascontiguousarray(image[..., ::-1]))
        points = []
        if found.pose_landmarks and found.pose_world_landmarks:
            marks, joints = found.pose_landmarks.landmark, found.pose_world_landmarks.landmark
            for mark, joint in ((marks[number], joints[number]) for number in NUMBERS):
                pixel = [mark.x * width - 0.5, mark.y * height - 0.5, mark.visibility]
                points.append([*pixel, joint.x, joint.y, joint.z])
        print(json.dumps(points), flush=True)


if __name__ == "__main__":
    main()
