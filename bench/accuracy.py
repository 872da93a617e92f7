"""``python -m bench.accuracy [RECORDINGS]``: the measuring protocol, one command for any setting.

Elbow errors without and with video, wrong turns, elbows astray (farther off than 20 cm; that is
stated where it is within two deviations), calm, lag and, where the tracker reports it, confidence,
on real cameras and on synthetic recordings from all around; then what a tracker must show, and
whether this one does. Tune on seeds 0 to 9. Seeds 100 to 119 are kept for the final report: never
run them before.

INPUTS: the folder of real recordings, with ``balancing/recording_cam_0*.toml`` and
``balancing/truth.trc`` in it; without one the synthetic recordings alone.
OUTPUTS: tables, and Metrics as JSON.
"""

import argparse
import math
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from bench import command, kept, numbers, seeds
from bench.clips import Clip, real, synthetic
from bench.criteria import covered, criteria, pool, table
from bench.evaluation import Result, evaluate_clip
from bench.figures import Metric, aligned, write_json
from jaxmocap.evaluation.errors import Errors
from jaxmocap.formats.settings_file import read_settings
from jaxmocap.hybrid.settings import Settings
from jaxmocap.pipelines.kept_programs import keep_compiled
from jaxmocap.synthetic.movements.motions import MOTIONS

SPREAD = ["mean", "median", "95 %", ">0.3 Hz"]
ERROR_HEADINGS = [
    ["recording", "markers", "", "", "", "video", "", "", "", "better", "off markers", ""],
    ["", *SPREAD, *SPREAD, "by", "95 %", "max"],
]
CALM_HEADINGS = [
    ["recording", "wrong turns", "", "astray, s", "", "acceleration", "", "", "", "lag", ""],
    [
        "",
        "%",
        "most s",
        "stated",
        "not",
        "truth",
        "video",
        "ratio",
        "markers'",
        "frames",
        "markers'",
    ],
]
KINDS = ("real", *MOTIONS)


def spread(errors: Errors) -> list[float]:
    """Mean, median, 95th percentile and RMS above 0.3 Hz over both elbows, metres."""
    distances = errors.distances[np.isfinite(errors.distances)]
    fast = float(np.sqrt(np.nanmean(errors.high_passed**2)))
    return [errors.mean, float(np.median(distances)), float(np.percentile(distances, 95)), fast]


def error_row(result: Result) -> list[str]:
    """Centimetres, and the improvement in per cent."""
    cells = [f"{100 * v:.1f}" for e in (result.alone, result.video) for v in spread(e)]
    off = [100 * np.nanpercentile(result.off, 95), 100 * np.nanmax(result.off)]
    return [result.clip.name, *cells, f"{result.improvement:.0%}", *(f"{v:.2f}" for v in off)]


def mean_row(group: str, results: list[Result]) -> list[str]:
    """The means over some recordings, and by how much the mean error falls."""
    alone, video = (
        np.mean([spread(getattr(result, which)) for result in results], 0)
        for which in ("alone", "video")
    )
    cells = [f"{100 * v:.1f}" for v in (*alone, *video)]
    return [f"{group}, mean", *cells, f"{1 - video[0] / alone[0]:.0%}", "", ""]


def worst_row(group: str, results: list[Result]) -> list[str]:
    """Of the recording with the largest mean error with video."""
    worst = max(results, key=lambda result: result.video.mean)
    return [f"{group}, worst", *error_row(worst)[1:]]


def calm_row(result: Result) -> list[str]:
    """Wrong turns, elbows astray, acceleration in m/s^2, lag in frames of the video."""
    calm, alone = result.calm, result.calm_alone
    sizes = [float(np.sqrt(np.mean(values**2))) for values in (calm.reference, calm.track)]
    return [
        result.clip.name,
        f"{100 * result.wrong_share:.1f}",
        f"{np.nanmax(result.turns.longest):.2f}",
        *(f"{seconds:.2f}" for seconds in result.astray),
        *(f"{size:.1f}" for size in sizes),
        *(f"{ratio:.2f}" for ratio in (calm.ratio, alone.ratio)),
        *(_or_dash(lag) for lag in (result.lag_frames, alone.worst_lag / result.frame)),
    ]


def _or_dash(value: float) -> str:
    return f"{value:+.2f}" if math.isfinite(value) else "-"


def sure_rows(group: str, results: list[Result]) -> list[list[str]]:
    """Of each landmark: truths within the 90 % interval, width, share that is the prior's."""
    sure, pooled = covered(results), pool(results)
    if sure is None or pooled is None:
        return []
    rows = [[group, "in 90 %, %", "", "", "deviation/RMS", "", "", "from prior"]]
    rows.append(["", *"xyz", *"xyz", "%"])
    for i, name in enumerate(pooled.landmarks):
        prior = 100 * np.nanmean(pooled.from_prior[:, i])
        shares, widths = ([f"{100 * v:.0f}" for v in sure.share[i]], sure.ratio[i])
        rows.append([name, *shares, *(f"{v:.2f}" for v in widths), f"{prior:.0f}"])
    return rows


def metrics(result: Result) -> list[Metric]:
    """The figures that a baseline holds."""
    name, calm = result.clip.name, 100 * abs(result.calm.ratio - 1)
    listed = [
        Metric(f"{name}, elbows, markers", 100 * result.alone.mean, "cm", tolerance=0.03),
        Metric(f"{name}, elbows, video", 100 * result.video.mean, "cm", tolerance=0.05),
        Metric(f"{name}, elbows, video, 95 %", 100 * spread(result.video)[2], "cm", tolerance=0.1),
        Metric(f"{name}, improvement", 100 * result.improvement, "%", "higher", 0.1),
        Metric(f"{name}, farthest off a marker", 100 * float(np.nanmax(result.off)), "cm"),
        Metric(f"{name}, wrong turns", 100 * result.wrong_share, "%", tolerance=0.5),
        Metric(f"{name}, longest wrong turn", float(np.nanmax(result.turns.longest)), "s"),
        Metric(f"{name}, elbows astray, unstated", result.astray[1], "s"),
        Metric(f"{name}, acceleration off the reference's", calm, "%"),
        Metric(f"{name}, lag", abs(result.lag_frames), "frames"),
    ]
    return [metric for metric in listed if math.isfinite(metric.value)]


def mean_metrics(group: str, results: list[Result]) -> Iterator[Metric]:
    """Means over a group's recordings."""
    for way in ("alone", "video"):
        mean = np.mean([getattr(result, way).mean for result in results])
        name = f"{group}, elbows, {'markers' if way == 'alone' else way}, mean"
        yield Metric(name, 100 * float(mean), "cm", tolerance=0.05)


def report(groups: dict[str, list[Result]], causal: bool) -> str:
    """All tables."""
    errors, calm, parts = list(ERROR_HEADINGS), list(CALM_HEADINGS), []
    for group, results in groups.items():
        errors += [*map(error_row, results)]
        errors += [mean_row(group, results), worst_row(group, results)]
        calm += map(calm_row, results)
        parts += [aligned(rows)] if (rows := sure_rows(group, results)) else []
    first = "elbows: distance from the truth, cm; off markers: head and hands, cm\n"
    return "\n\n".join(
        [first + aligned(errors), aligned(calm), *parts, table(criteria(groups, causal))]
    )


def chosen_clips(options: argparse.Namespace, keep: Path) -> dict[str, list[Clip]]:
    """The recordings asked for, rendered where they are not there yet."""
    groups: dict[str, list[Clip]] = {}
    for kind in options.only:
        if kind != "real":
            groups[kind] = synthetic(kind, options.seeds, options.azimuths, options.seconds, keep)
        elif options.recordings:
            groups["balancing"] = real(Path(options.recordings))
    return groups


def kinds(text: str) -> list[str]:
    """Such as ``real,tennis``."""
    chosen = text.split(",")
    if unknown := [kind for kind in chosen if kind not in KINDS]:
        raise argparse.ArgumentTypeError(f"{unknown[0]!r}: expected of {', '.join(KINDS)}")
    return chosen


def parser() -> argparse.ArgumentParser:
    """The command line."""
    command_line = command("bench.accuracy", __doc__)
    add = command_line.add_argument
    add("recordings", nargs="?", help="folder of the real recordings")
    add(
        "--seeds", type=seeds, default=seeds("0-9"), metavar="0-9",
        help="of each synthetic kind; 100 to 119 are kept for the final report",
    )  # fmt: skip
    add("--seconds", type=float, default=6.0, help="of a synthetic recording")
    add(
        "--azimuths", type=numbers, default=numbers("0,-60,60,-30,30"), metavar="0,-60,...",
        help="of the camera, degrees from frontal, one for each seed in turn (with a leading "
        "minus: --azimuths=-60,60)",
    )  # fmt: skip
    add("--noise", type=float, default=0.0, help="on the markers, metres, such as 0.005")
    add("--causal", action="store_true", help="as a live run would have it")
    add("--settings", metavar="FILE.toml", help="as of 'jaxmocap track'")
    add(
        "--only", type=kinds, default=list(KINDS), metavar="KIND,...",
        help=f"of {', '.join(KINDS)}; usually all",
    )  # fmt: skip
    add("--keep", metavar="DIR", help="keep synthetic recordings here, rendered once")
    return command_line


def main() -> None:
    options = parser().parse_args()
    keep_compiled()
    settings, mode = Settings(), "causal" if options.causal else "own"
    if options.settings:
        settings = read_settings(options.settings, settings)
    groups: dict[str, list[Result]] = {}
    with kept(options.keep) as keep:
        for group, clips in chosen_clips(options, keep).items():
            for clip in clips:
                print(f"tracking {clip.name}", file=sys.stderr, flush=True)
                groups.setdefault(group, []).append(
                    evaluate_clip(clip, settings, mode, options.noise)
                )
    print(report(groups, options.causal))
    every = [metric for results in groups.values() for r in results for metric in metrics(r)]
    means = (m for group, results in groups.items() for m in mean_metrics(group, results))
    write_json([*every, *means], options.json)


if __name__ == "__main__":
    main()
