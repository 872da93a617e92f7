"""``python -m bench.one_camera RECORDINGS --detector-python PYTHON``: one camera, key points.

The real recording by each of its cameras, rendered exercises by the first two of theirs, and
rendered squats: nothing but the video, MediaPipe's key points, the calibration, and of rendered
people the stature. Errors of shoulders, elbows, wrists, hips, knees and ankles: in the world, and
with the hips' middles laid over one another. Beside them those of MediaPipe's own joints, laid over
the truth's hips and turned by the true camera, which nobody has.

INPUTS: the folder of recordings; an environment with ``mediapipe``.
OUTPUTS: a table; Metrics as JSON.
"""

import argparse
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from bench import add_rendered, command, kept
from bench.clips import Clip, exercises, real, synthetic
from bench.figures import Metric, table, write_json
from bench.rival_detector import joints_found
from jaxmocap.capture.video import open_video
from jaxmocap.formats.recordings.recording import Recording, VideoSource
from jaxmocap.formats.time_series.trc import read_trc
from jaxmocap.pipelines.kept_programs import keep_compiled
from jaxmocap.pipelines.keypoints.by_mediapipe import mediapipe_detector
from jaxmocap.pipelines.keypoints.detect import detect_keypoints
from jaxmocap.pipelines.silhouettes.keypoints import LOST
from jaxmocap.pipelines.silhouettes.track import track_silhouettes

# Our landmark -> number of MediaPipe's.
NUMBERS = {
    f"{name}_{side}": number + (side == "r")
    for name, number in {
        "shoulder": 11, "elbow": 13, "wrist": 15, "hip": 23, "knee": 25, "ankle": 27,
    }.items()
    for side in "lr"
}  # fmt: skip
HIPS = [list(NUMBERS).index(name) for name in ("hip_l", "hip_r")]
# The camera of rendered squats, degrees from frontal, seed by seed.
AZIMUTHS = (0.0, -60.0, 60.0, -30.0, 30.0)
KINDS = ("walking", "arm_raises", "squat", "balancing")


def errors(points: np.ndarray, truth: np.ndarray) -> tuple[float, float]:
    """Mean centimetres in the world, and about the hips, of (F, J, 3) against the truth's."""
    about = [each - each[:, HIPS].mean(1, keepdims=True) for each in (points, truth)]
    off = [np.linalg.norm(a - b, axis=-1) for a, b in ((points, truth), about)]
    return float(100 * np.nanmean(off[0])), float(100 * np.nanmean(off[1]))


def tracked(clip: Clip, camera: str, python: str, passes: int) -> Iterator[Metric]:
    """What one camera of a recording shows."""
    recording = Recording.load(clip.path)
    (source,) = (video for video in recording.videos if video.camera_name == camera)
    with tempfile.TemporaryDirectory() as folder:
        # Without its markers: who it is and where follows from the key points.
        none = recording.positions_world[:, :0]
        alone = replace(recording, videos=(source,), places=(), positions_world=none)
        (found,) = detect_keypoints(alone, mediapipe_detector(python), Path(folder))
        source = replace(source, keypoints=found.file)
        motion = track_silhouettes(replace(alone, videos=(source,)), passes=passes).motion
    joints, truth = motion.joints(), _truth(clip, motion.times)
    ours = errors(np.stack([joints[name] for name in NUMBERS], 1), truth)
    name = f"{clip.group}, {clip.name}, {camera}"
    yield Metric(f"{name}, world", ours[0], "cm")
    yield Metric(f"{name}, about the hips", ours[1], "cm")
    assert motion.report is not None
    lost = [any(s.startswith(LOST) for s in each) for each in motion.report.statuses]
    yield Metric(f"{name}, lost frames", 100 * float(np.mean(lost)), "%")
    yield Metric(f"{name}, MediaPipe about the hips", _detectors_own(clip, source, python), "cm")


def _detectors_own(clip: Clip, source: VideoSource, python: str) -> float:
    """Error of MediaPipe's own joints about the hips, centimetres."""
    assert source.path is not None
    found = joints_found(python, source.path)[:, list(NUMBERS.values())]
    times = open_video(source).times[: len(found)]
    in_world = found @ np.asarray(source.camera.T_cam_world, float)[:3, :3]
    return errors(in_world, _truth(clip, times))[1]


def _truth(clip: Clip, times: np.ndarray) -> np.ndarray:
    """(F, J, 3) true joints, metres, at the sample nearest to each time."""
    truth = read_trc(clip.truth)
    nearest = np.abs(truth.times[None] - times[:, None]).argmin(1)
    points = truth.points()
    return np.stack([points[clip.landmarks[name]][nearest] for name in NUMBERS], 1)


def clips(options: argparse.Namespace, keep: Path) -> Iterator[tuple[Clip, str]]:
    """Recordings, and the name of a camera of each."""
    folder, kinds = Path(options.recordings), options.only.split(",")
    if "balancing" in kinds:
        for clip in real(folder):
            yield clip, clip.name
    people = options.people.split(",")
    file = folder / "person" / "person.npz"
    for seed, who in zip(options.seeds, people, strict=False):
        for clip in exercises(file, kinds_of(kinds), [seed], [who], options.seconds, keep):
            yield from ((clip, f"cam_{number}") for number in range(1, options.cameras + 1))
    if "squat" in kinds:
        for clip in synthetic("squat", options.seeds, AZIMUTHS, options.squat_seconds, keep):
            yield clip, "webcam"


def kinds_of(kinds: list[str]) -> list[str]:
    """Those that the rigged meshes do."""
    return [kind for kind in kinds if kind in ("walking", "arm_raises")]


def main() -> None:
    """Detect, track, compare, print."""
    parser = command("bench.one_camera", __doc__)
    add = parser.add_argument
    add("recordings", help="folder of the real recording and of the rigged meshes")
    add("--detector-python", required=True, help="of an environment with MediaPipe")
    add("--only", default=",".join(KINDS), help="default: %(default)s")
    add("--passes", type=int, default=3, help="default: %(default)s")
    add("--cameras", type=int, default=2, help="of each rendered exercise; default: %(default)s")
    add("--squat-seconds", type=float, default=6.0, help="of rendered squats; default: 6")
    add_rendered(parser)
    options = parser.parse_args()
    keep_compiled()
    rows: list[Metric] = []
    with kept(options.keep) as keep:
        for clip, camera in clips(options, keep):
            rows += tracked(clip, camera, options.detector_python, options.passes)
            print(table(rows[-4:]), flush=True)
    print(table(rows + means(rows)))
    write_json(rows + means(rows), options.json)


def means(rows: list[Metric]) -> list[Metric]:
    """Of each kind of recording."""
    result = []
    for key in dict.fromkeys((r.name.split(", ")[0], r.name.split(", ")[-1]) for r in rows):
        same = [r for r in rows if (r.name.split(", ")[0], r.name.split(", ")[-1]) == key]
        values = [r.value for r in same]
        result.append(
            Metric(f"{key[0]}, all {len(values)}, {key[1]}", float(np.mean(values)), same[0].unit)
        )
    return result


if __name__ == "__main__":
    main()
