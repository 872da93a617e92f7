"""``python -m bench.coverage RECORDINGS``: whether the stated standard deviations hold.

Each tracker by itself: offline, causally, by silhouettes; by markers alone see ``bench.people``. Of
each kind of joint the share of true coordinates that 90 % intervals contain, and how many times
larger the error is than stated. 80 to 97 % and 0.7 to 1.3 are asked for. And the risk: the error of
the samples that are kept when the least sure are left out first.

INPUTS: the folder of recordings, with ``balancing/`` and ``person/person.npz`` in it.
OUTPUTS: two tables; Metrics as JSON; a picture of the curves.
"""

import argparse
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from bench import add_rendered, command, kept
from bench.clips import AZIMUTHS, REAL_LANDMARKS, Clip, exercises, real, synthetic
from bench.figures import Metric, write_json
from bench.silhouette import REAL, true_start
from jaxmocap.body.motion import UNDETERMINED_M, Motion
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.capture.timeline import Mode
from jaxmocap.evaluation.errors import Errors, evaluate, interval_coverage
from jaxmocap.evaluation.reliability import plot_reliability, risk_curve, stated_and_found
from jaxmocap.evaluation.tables import align_columns
from jaxmocap.formats.recordings.recording import Recording
from jaxmocap.formats.time_series.trc import read_trc
from jaxmocap.pipelines.kept_programs import keep_compiled
from jaxmocap.pipelines.silhouettes.first_pose import start_pose
from jaxmocap.pipelines.silhouettes.track import track_silhouettes
from jaxmocap.pipelines.tracking.track import track
from jaxmocap.silhouette.settings import Settings
from jaxmocap.synthetic.movements.motions import MOTIONS
from jaxmocap.synthetic.people.rigged_mesh import load_rig
from jaxmocap.synthetic.photographs import rest_height

KINDS = ("elbow", "shoulder", "hip", "knee", "wrist")
WAYS: dict[str, Mode] = {"hybrid": "own", "causal": "causal"}
SILHOUETTES = "silhouettes"
EXERCISES = ("walking", "arm_raises")
# Shares of the samples, the surest first.
KEPT = (1.0, 0.9, 0.75, 0.5)


def tracked(options: argparse.Namespace, keep: Path) -> Iterator[tuple[str, Errors]]:
    """Each tracker's case, and the errors of one recording beside what was stated."""
    folder = Path(options.recordings)
    for way, mode in WAYS.items():
        if way not in options.only:
            continue
        clips = [("real", clip) for clip in real(folder)]
        for motion in MOTIONS:
            played = synthetic(motion, options.seeds, AZIMUTHS, 6.0, keep)
            clips += [(motion, clip) for clip in played]
        for kind, clip in clips:
            print(f"{way}: {clip.name}", file=sys.stderr, flush=True)
            yield f"{way}, {kind}", _errors(clip, track(Recording.load(clip.path), mode=mode))
    if SILHOUETTES in options.only:
        path = folder / REAL / "recording_all_cameras.toml"
        recording, clip = Recording.load(path), Clip(REAL, REAL, path, REAL_LANDMARKS)
        start = start_pose(recording, body=Settings.body)
        motion = track_silhouettes(recording, start, progress=True).motion
        yield f"{SILHOUETTES}, real, four cameras", _errors(clip, motion)
        for clip, recording, start in rendered(options, folder / "person" / "person.npz", keep):
            for cameras in (4, 2):
                some = replace(recording, videos=recording.videos[:cameras])
                motion = track_silhouettes(some, start, progress=True).motion
                yield f"{SILHOUETTES}, rendered, {cameras} cameras", _errors(clip, motion)


def rendered(
    options: argparse.Namespace, file: Path, keep: Path
) -> Iterator[tuple[Clip, Recording, Pose]]:
    """Exercises of people by their heights, as most have nothing else; first poses of the truth."""
    for who in options.people.split(","):
        skeleton = Skeleton.human(rest_height(load_rig(file, who)))
        for clip in exercises(file, EXERCISES, options.seeds, [who], options.seconds, keep):
            recording = replace(Recording.load(clip.path), skeleton=skeleton)
            yield clip, recording, true_start(skeleton, read_trc(clip.truth).points())


def _errors(clip: Clip, motion: Motion) -> Errors:
    found = evaluate(motion, clip.truth, clip.landmarks)
    assert found.deviations is not None
    return found


def pooled(each: list[Errors]) -> Errors:
    """Recordings with the same landmarks as one."""
    joints, *_ = {errors.joints for errors in each}
    names = ("times", "offsets", "deviations")
    parts = ([getattr(errors, name) for errors in each] for name in names)
    return Errors(joints, *(np.concatenate(part) for part in parts))


def row_of(errors: Errors) -> np.ndarray:
    """(2, 1 + KINDS) share within 90 % and RMS error by the median stated, of kinds and of all."""
    found, deviations = [], errors.deviations
    assert deviations is not None
    for kinds in (*((kind,) for kind in KINDS), KINDS):
        chosen = [name.split("_")[0] in kinds for name in errors.joints]
        offsets, stated = errors.offsets[:, chosen].ravel(), deviations[:, chosen].ravel()
        held = interval_coverage(offsets, stated)
        found.append([100 * float(held.share), 1 / float(held.ratio)])
    return np.array(found).T


def risks_of(errors: Errors) -> list[float]:
    """Mean error of the surest samples, of each share of ``KEPT``; and of the undetermined, cm.

    Last the share of samples that are stated as undetermined, per cent.
    """
    stated, found = stated_and_found(errors)
    shares, risk = risk_curve(stated, found)
    kept = [100 * float(risk[np.searchsorted(shares, share)]) for share in KEPT]
    lost = stated > UNDETERMINED_M
    return [*kept, 100 * float(found[lost].mean()) if lost.any() else np.nan, 100 * lost.mean()]


def main() -> None:
    """Track, compare, print."""
    parser = command("bench.coverage", __doc__)
    parser.add_argument("recordings")
    ways = [*WAYS, SILHOUETTES]
    parser.add_argument("--only", default=",".join(ways), help=f"of {', '.join(ways)}")
    parser.add_argument(
        "--plot", metavar="FILE", help="draw reliability and risk (.png, .svg, .pdf)"
    )
    add_rendered(parser)
    options = parser.parse_args()
    keep_compiled()
    cases: dict[str, list[Errors]] = {}
    with kept(options.keep) as keep:
        for case, found in tracked(options, keep):
            cases.setdefault(case, []).append(found)
    runs = {case: pooled(each) for case, each in cases.items()}
    rows, metrics = [["within 90 %, error / stated", *(f"{k}s" for k in KINDS), "all"]], []
    shares_kept = [f"{100 * share:.0f} % kept" for share in KEPT]
    risks = [["mean error of all landmarks, cm", *shares_kept, "undetermined", "share, %"]]
    for case, errors in runs.items():
        shares, ratios = row_of(errors)
        rows.append([case, *(f"{s:.0f} ({r:.1f})" for s, r in zip(shares, ratios, strict=True))])
        risks.append([case, *(f"{value:.1f}" for value in risks_of(errors))])
        metrics += [
            Metric(f"{case}: {kind}", float(share), "%", "higher", 0.05)
            for kind, share in zip((*KINDS, "all"), shares, strict=True)
        ]
    print(align_columns(rows), align_columns(risks), sep="\n\n")
    write_json(metrics, options.json)
    if options.plot:
        groups: dict[str, list[Errors]] = {}
        for case, each in cases.items():
            way = case.split(",")[0]
            groups.setdefault(f"{way}, {'real' if 'real' in case else 'rendered'}", []).extend(each)
        plot_reliability(options.plot, {name: pooled(each) for name, each in groups.items()})


if __name__ == "__main__":
    main()
