"""``python -m bench.detector_accuracy RECORDINGS --detector-python PYTHON``: MediaPipe's elbows.

The detector gives joints in metres about the hips, in no world. Each frame's joints are moved,
turned and scaled to where they lie nearest to the true ones (Procrustes), which nobody could do who
does not have the truth: so its errors are its own at best.

INPUTS: the real recording by each camera, rendered table tennis; an environment with ``mediapipe``.
OUTPUTS: the elbows' mean error by recording, centimetres.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from bench import add_rendered, command, kept
from bench.clips import Clip, real, synthetic
from bench.figures import Metric, table, write_json
from bench.rival_detector import joints_found
from jaxmocap.body.skeleton import ELBOWS, LANDMARKS
from jaxmocap.formats.recordings.recording import Recording
from jaxmocap.formats.time_series.trc import read_trc

# Our landmark -> number of the detector's.
NUMBERS = {
    f"{name}_{side}": number + (side == "r")
    for name, number in {"shoulder": 11, "elbow": 13, "wrist": 15, "hip": 23, "knee": 25}.items()
    for side in "lr"
}
# The camera of rendered table tennis, degrees from frontal, seed by seed.
AZIMUTHS = (0.0, -60.0, 60.0, -30.0, 30.0)
# Joints that lie no farther than this in time from a frame are its own, seconds.
NEAR_S = 0.02


def aligned(joints: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Joints (J, 3) moved, turned and scaled to lie nearest to true ones (J, 3)."""
    centre, there = joints.mean(0), truth.mean(0)
    a, b = joints - centre, truth - there
    U, S, Vt = np.linalg.svd(a.T @ b)
    mirrored = np.sign(np.linalg.det(U @ Vt))
    S[-1] *= mirrored
    U[:, -1] *= mirrored
    return there + S.sum() / np.sum(a**2) * (a @ U @ Vt)


def elbow_errors(python: str, clip: Clip) -> np.ndarray:
    """(F, 2) metres of a recording's first camera, NaN where the detector finds nobody."""
    video, truth = Recording.load(clip.path).videos[0], read_trc(clip.truth)
    kept, points = [name for name in NUMBERS if name in clip.landmarks], truth.points()
    true = np.stack([points[clip.landmarks[name]] for name in kept], 1)
    assert video.path is not None
    joints = joints_found(python, Path(video.path))[:, [NUMBERS[name] for name in kept]]
    rate = cv2.VideoCapture(str(video.path)).get(cv2.CAP_PROP_FPS)
    elbows = [kept.index(LANDMARKS[index]) for index in ELBOWS]
    errors = np.full((len(joints), 2), np.nan)
    for frame, own in enumerate(joints):
        time = frame / rate + video.offset
        nearest = int(np.abs(truth.times - time).argmin())
        there = true[nearest]
        if abs(truth.times[nearest] - time) < NEAR_S and np.isfinite([own, there]).all():
            errors[frame] = np.linalg.norm((aligned(own, there) - there)[elbows], axis=-1)
    return errors


def measured(options: argparse.Namespace, keep: Path) -> Iterator[Metric]:
    """The elbows' mean error of every clip."""
    clips = real(Path(options.recordings))
    clips += synthetic("tennis", options.seeds, AZIMUTHS, options.seconds, keep)
    for clip in clips:
        errors = elbow_errors(options.detector_python, clip)
        yield Metric(f"{clip.group}, {clip.name}", 100 * float(np.nanmean(errors)), "cm")
        print(f"{clip.name}: found in {np.isfinite(errors).all(1).mean():.0%} of frames")


def main() -> None:
    """Detect, compare, print."""
    parser = command("bench.detector_accuracy", __doc__)
    add = parser.add_argument
    add("recordings", help="folder of the real recording")
    add("--detector-python", required=True, help="of an environment with MediaPipe")
    add_rendered(parser)
    options = parser.parse_args()
    with kept(options.keep) as keep:
        rows = list(measured(options, keep))
    print(table(rows))
    write_json(rows, options.json)


if __name__ == "__main__":
    main()
