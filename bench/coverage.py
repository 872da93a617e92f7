"""``python -m bench.coverage RECORDINGS``: whether the stated standard deviations hold.

Each tracker by itself: offline, causally, by silhouettes; by markers alone see ``bench.people``. Of
each kind of joint the share of true coordinates that 90 % intervals contain, and how many times
larger the error is than stated. 80 to 97 % and 0.7 to 1.3 are asked for.

INPUTS: the folder of recordings, with ``balancing/`` and ``person/person.npz`` in it.
OUTPUTS: a table, and Metrics as JSON.
"""

import argparse
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from bench.clips import REAL_LANDMARKS, Clip, exercises, real, synthetic
from bench.command_line import add_rendered, command
from bench.evaluation import Sureness, sureness_of
from bench.metrics import Metric, aligned, write_json
from bench.silhouette import REAL
from jaxmocap.body.motion import Motion
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import LANDMARKS, Skeleton, with_joints
from jaxmocap.capture.timeline import Mode
from jaxmocap.evaluation.errors import interval_coverage
from jaxmocap.formats.recordings.recording import Recording
from jaxmocap.formats.time_series.trc import read_trc
from jaxmocap.pipelines.kept_programs import keep_compiled
from jaxmocap.pipelines.silhouettes.first_pose import start_pose
from jaxmocap.pipelines.silhouettes.track import track_silhouettes
from jaxmocap.pipelines.tracking.track import track
from jaxmocap.silhouette.first_pose import pose_at_landmarks
from jaxmocap.silhouette.settings import Settings
from jaxmocap.synthetic.movements.motions import MOTIONS
from jaxmocap.synthetic.people.rigged_mesh import load_rig
from jaxmocap.synthetic.photographs import rest_height

KINDS = ("elbow", "shoulder", "hip", "knee", "wrist")
WAYS: dict[str, Mode] = {"hybrid": "own", "causal": "causal"}
SILHOUETTES = "silhouettes"
AZIMUTHS_DEG = (0.0, -60.0, 60.0, -30.0, 30.0)
EXERCISES = ("walking", "arm_raises")


def sureness(options: argparse.Namespace, keep: Path) -> Iterator[tuple[str, Sureness]]:
    """Each tracker's case, and the errors of one recording beside what was stated."""
    folder = Path(options.recordings)
    for way, mode in WAYS.items():
        if way not in options.only:
            continue
        clips = [("real", clip) for clip in real(folder)]
        for motion in MOTIONS:
            played = synthetic(motion, options.seeds, AZIMUTHS_DEG, 6.0, keep)
            clips += [(motion, clip) for clip in played]
        for kind, clip in clips:
            print(f"{way}: {clip.name}", file=sys.stderr, flush=True)
            yield f"{way}, {kind}", _stated(clip, track(Recording.load(clip.path), mode=mode))
    if SILHOUETTES in options.only:
        path = folder / REAL / "recording_all_cameras.toml"
        recording, clip = Recording.load(path), Clip(REAL, REAL, path, REAL_LANDMARKS)
        start = start_pose(recording, body=Settings.body)
        tracked = track_silhouettes(recording, start, progress=True).motion
        yield f"{SILHOUETTES}, real, four cameras", _stated(clip, tracked)
        for clip, recording, start in rendered(options, folder / "person" / "person.npz", keep):
            for cameras in (4, 2):
                some = replace(recording, videos=recording.videos[:cameras])
                tracked = track_silhouettes(some, start, progress=True).motion
                yield f"{SILHOUETTES}, rendered, {cameras} cameras", _stated(clip, tracked)


def rendered(
    options: argparse.Namespace, file: Path, keep: Path
) -> Iterator[tuple[Clip, Recording, Pose]]:
    """Exercises of people by their heights, as most have nothing else; first poses of the truth."""
    for who in options.people.split(","):
        skeleton = Skeleton.human(rest_height(load_rig(file, who)))
        for clip in exercises(file, EXERCISES, options.seeds, [who], options.seconds, keep):
            truth, nothing = read_trc(clip.truth).points(), np.full(3, np.nan)
            first = np.array([truth[name][0] if name in truth else nothing for name in LANDMARKS])
            recording = replace(Recording.load(clip.path), skeleton=skeleton)
            yield clip, recording, pose_at_landmarks(with_joints(skeleton, Settings.body), first)


def _stated(clip: Clip, motion: Motion) -> Sureness:
    found = sureness_of(motion, clip)
    assert found is not None
    return found


def row_of(each: list[Sureness]) -> np.ndarray:
    """(2, 1 + KINDS) share within 90 % and RMS error by the median stated, of kinds and of all."""
    found = []
    for kinds in (*((kind,) for kind in KINDS), KINDS):
        chosen = [name.split("_")[0] in kinds for name in each[0].landmarks]
        offsets, stated = (
            np.concatenate([part[:, chosen].ravel() for part in parts])
            for parts in ([one.offsets for one in each], [one.deviations for one in each])
        )
        held = interval_coverage(np.zeros_like(offsets), offsets, stated)
        found.append([100 * float(held.share), 1 / float(held.ratio)])
    return np.array(found).T


def main() -> None:
    """Track, compare, print."""
    parser = command("bench.coverage", __doc__)
    parser.add_argument("recordings")
    ways = [*WAYS, SILHOUETTES]
    parser.add_argument("--only", default=",".join(ways), help=f"of {', '.join(ways)}")
    add_rendered(parser)
    options = parser.parse_args()
    keep_compiled()
    cases: dict[str, list[Sureness]] = {}
    with tempfile.TemporaryDirectory() as scratch:
        for case, found in sureness(options, Path(options.keep or scratch)):
            cases.setdefault(case, []).append(found)
    rows, metrics = [["within 90 %, error / stated", *(f"{k}s" for k in KINDS), "all"]], []
    for case, each in cases.items():
        shares, ratios = row_of(each)
        rows.append([case, *(f"{s:.0f} ({r:.1f})" for s, r in zip(shares, ratios, strict=True))])
        metrics += [
            Metric(f"{case}: {kind}", float(share), "%", "higher", 0.05)
            for kind, share in zip((*KINDS, "all"), shares, strict=True)
        ]
    print(aligned(rows))
    if options.json:
        write_json(metrics, options.json)


if __name__ == "__main__":
    main()
