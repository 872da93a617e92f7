"""``python -m bench.one_camera RECORDINGS --detector-python PYTHON``: one camera, key points.

The real recording by each of its cameras, rendered exercises by the first two of theirs, and
rendered squats: nothing but the video, MediaPipe's key points, the calibration, and of rendered
people the stature. Errors of shoulders, elbows, wrists, hips, knees and ankles: in the world, and
with the hips' middles laid over one another; how many coordinates lie within their 90 % intervals.
Beside them those of MediaPipe's own joints, which are in metres about the hips, in no world: laid
over the truth's hips and turned by the true camera, which nobody has; and of its elbows where each
frame's joints are moved, turned and scaled to lie nearest to the true ones. ``--detector-only``
leaves our own out.

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
from bench.clips import AZIMUTHS, Clip, exercises, real, synthetic
from bench.figures import Metric, table, write_json
from bench.rival_detector import joints_found
from jaxmocap.body.skeleton import landmark_rows
from jaxmocap.capture.video import open_video
from jaxmocap.evaluation.errors import interval_coverage
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
HIPS, ELBOWS = (
    [list(NUMBERS).index(f"{name}_{side}") for side in "lr"] for name in ("hip", "elbow")
)
# By these each frame's joints are laid upon the true ones.
LAID = [row for row, name in enumerate(NUMBERS) if "ankle" not in name]
KINDS, DETECTED = ("walking", "arm_raises", "squat", "balancing"), "tennis"
# A truth that is farther off in time than that is not a frame's, seconds.
NEAR_S = 0.02


def errors(points: np.ndarray, truth: np.ndarray) -> tuple[float, float]:
    """Mean centimetres in the world, and about the hips, of (F, J, 3) against the truth's."""
    about = [each - each[:, HIPS].mean(1, keepdims=True) for each in (points, truth)]
    off = [np.linalg.norm(a - b, axis=-1) for a, b in ((points, truth), about)]
    return float(100 * np.nanmean(off[0])), float(100 * np.nanmean(off[1]))


def tracked(clip: Clip, camera: str, options: argparse.Namespace) -> Iterator[Metric]:
    """What one camera of a recording shows."""
    recording, name = Recording.load(clip.path), f"{clip.group}, {clip.name}, {camera}"
    (source,) = (video for video in recording.videos if video.camera_name == camera)
    if not options.detector_only:
        yield from ours(clip, recording, source, options, name)
    yield from detectors_own(clip, source, options.detector_python, name)


def ours(
    clip: Clip, recording: Recording, source: VideoSource, options: argparse.Namespace, name: str
) -> Iterator[Metric]:
    """By the detector's key points and one video alone."""
    with tempfile.TemporaryDirectory() as folder:
        # Without its markers: who it is and where follows from the key points.
        none = recording.positions_world[:, :0]
        alone = replace(recording, videos=(source,), places=(), positions_world=none)
        detector = mediapipe_detector(options.detector_python)
        (detected,) = detect_keypoints(alone, detector, Path(folder))
        with_points = replace(alone, videos=(replace(source, keypoints=detected.file),))
        motion = track_silhouettes(with_points, passes=options.passes).motion
    joints, truth = motion.joints(), _truth(clip, motion.times)
    found = np.stack([joints[each] for each in NUMBERS], 1)
    off = errors(found, truth)
    yield Metric(f"{name}, world", off[0], "cm")
    yield Metric(f"{name}, about the hips", off[1], "cm")
    assert motion.report is not None
    deviations = np.asarray(motion.report.landmarks_std)[:, landmark_rows(NUMBERS)]
    held = interval_coverage(found - truth, deviations)
    share = np.average(held.share, weights=held.samples)
    yield Metric(f"{name}, 90 % intervals hold", 100 * float(share), "%", "higher")
    lost = [any(s.startswith(LOST) for s in each) for each in motion.report.statuses]
    yield Metric(f"{name}, lost frames", 100 * float(np.mean(lost)), "%")


def detectors_own(clip: Clip, source: VideoSource, python: str, name: str) -> Iterator[Metric]:
    """Errors of MediaPipe's own joints."""
    assert source.path is not None
    found = joints_found(python, source.path)[:, list(NUMBERS.values())]
    truth = _truth(clip, open_video(source).times[: len(found)])
    in_world = found @ np.asarray(source.camera.T_cam_world, float)[:3, :3]
    yield Metric(f"{name}, MediaPipe about the hips", errors(in_world, truth)[1], "cm")
    both = np.isfinite(found[:, LAID]).all((1, 2)) & np.isfinite(truth[:, LAID]).all((1, 2))
    off = [
        np.linalg.norm((laid_upon(own[LAID], true[LAID]) - true[LAID])[ELBOWS], axis=-1)
        for own, true in zip(found[both], truth[both], strict=True)
    ]
    yield Metric(f"{name}, MediaPipe's elbows laid upon the truth", 100 * float(np.mean(off)), "cm")
    yield Metric(f"{name}, frames with MediaPipe's joints", 100 * float(both.mean()), "%", "higher")


def laid_upon(joints: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Joints (J, 3) moved, turned and scaled to lie nearest to true ones (J, 3)."""
    centre, there = joints.mean(0), truth.mean(0)
    a, b = joints - centre, truth - there
    U, S, Vt = np.linalg.svd(a.T @ b)
    mirrored = np.sign(np.linalg.det(U @ Vt))
    S[-1] *= mirrored
    U[:, -1] *= mirrored
    return there + S.sum() / np.sum(a**2) * (a @ U @ Vt)


def _truth(clip: Clip, times: np.ndarray) -> np.ndarray:
    """(F, J, 3) true joints, metres, at the sample nearest to each time; NaN where none is near."""
    truth = read_trc(clip.truth)
    nearest, points = np.abs(truth.times[None] - times[:, None]).argmin(1), truth.points()
    near = np.abs(truth.times[nearest] - times) < NEAR_S
    joints = np.stack([points[clip.landmarks[name]][nearest] for name in NUMBERS], 1)
    return np.where(near[:, None, None], joints, np.nan)


def clips(options: argparse.Namespace, keep: Path) -> Iterator[tuple[Clip, str]]:
    """Recordings, and the name of a camera of each."""
    folder, kinds = Path(options.recordings), options.only.split(",")
    if "balancing" in kinds:
        for clip in real(folder):
            yield clip, clip.name
    people = options.people.split(",")
    file = folder / "person" / "person.npz"
    meshes = [kind for kind in kinds if kind in KINDS[:2]]
    for seed, who in zip(options.seeds, people, strict=False):
        for clip in exercises(file, meshes, [seed], [who], options.seconds, keep):
            yield from ((clip, f"cam_{number}") for number in range(1, options.cameras + 1))
    for kind, seconds in (("squat", options.squat_seconds), (DETECTED, options.seconds)):
        if kind in kinds:
            for clip in synthetic(kind, options.seeds, AZIMUTHS, seconds, keep):
                yield clip, "webcam"


def main() -> None:
    """Detect, track, compare, print."""
    parser = command("bench.one_camera", __doc__)
    add = parser.add_argument
    add("recordings", help="folder of the real recording and of the rigged meshes")
    add("--detector-python", required=True, help="of an environment with MediaPipe")
    add("--only", default=",".join(KINDS), help=f"default: %(default)s; also {DETECTED}")
    add("--detector-only", action="store_true", help="MediaPipe's own joints alone")
    add("--passes", type=int, help="default: those of ``silhouette track``")
    add("--cameras", type=int, default=2, help="of each rendered exercise; default: %(default)s")
    add("--squat-seconds", type=float, default=6.0, help="of rendered squats; default: 6")
    add_rendered(parser)
    options = parser.parse_args()
    keep_compiled()
    rows: list[Metric] = []
    with kept(options.keep) as keep:
        for clip, camera in clips(options, keep):
            own = list(tracked(clip, camera, options))
            print(table(own), flush=True)
            rows += own
    rows += means(rows)
    print(table(rows))
    write_json(rows, options.json)


def means(rows: list[Metric]) -> list[Metric]:
    """Of each kind of recording."""
    result = []
    for key in dict.fromkeys((r.name.split(", ")[0], r.name.split(", ")[-1]) for r in rows):
        same = [r for r in rows if (r.name.split(", ")[0], r.name.split(", ")[-1]) == key]
        values = [r.value for r in same]
        name, mean = f"{key[0]}, all {len(values)}, {key[1]}", float(np.mean(values))
        result.append(replace(same[0], name=name, value=mean))
    return result


if __name__ == "__main__":
    main()
