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
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bench import command, kept, numbers, seeds
from bench.clips import Clip, real, synthetic
from bench.evaluation import Result, Sureness, evaluate_clip
from bench.figures import Metric, write_json
from jaxmocap.evaluation.errors import Errors, IntervalCoverage, interval_coverage
from jaxmocap.evaluation.tables import align_columns
from jaxmocap.formats.settings_file import read_settings
from jaxmocap.hybrid.settings import Settings
from jaxmocap.pipelines.kept_programs import keep_compiled
from jaxmocap.synthetic.movements.motions import MOTIONS

# Of the real recording, which these cameras see from the front and the sides.
FRONT = ("cam_01", "cam_02", "cam_04")
REAR = "cam_03"
# Mean error of markers alone, metres, when video was first added: no worse one serves as bound.
FIRST_IK_M = 0.0813
MOST_REAL_M, MOST_REAL_95_M, MOST_REAL_ALL_M, LEAST_GAIN = 0.055, 0.14, 0.07, 0.4
MOST_SYNTHETIC_M = {"tennis": 0.025, "thrust": 0.04}
CALM, CALM_CAUSAL = (0.8, 1.2), (-np.inf, 1.5)
MOST_LAG_FRAMES = 1.0
MOST_WRONG, MOST_RECOVERY_S = 0.02, 0.3
COVERED, MOST_WIDTH = (0.85, 0.95), 1.5
SPREAD = ["mean", "median", "95 %", ">0.3 Hz"]
ERROR_HEADINGS = [
    ["recording", "markers", "", "", "", "video", "", "", "", "better", "off markers", ""],
    ["", *SPREAD, *SPREAD, "by", "95 %", "max"],
]
CALM_HEADINGS = [
    ["recording", "wrong turns", "", "astray, s", "", "acceleration", "", "", "", "lag", ""],
    ["", "%", "most s", "stated", "not", "truth", "video", "ratio", "markers'", "frames",
     "markers'"],
]  # fmt: skip
KINDS = ("real", *MOTIONS)


@dataclass(frozen=True)
class Criterion:
    """One demand."""

    name: str  # what is measured
    values: Sequence[float]  # every figure that has to fulfil it
    least: float  # bound from below
    most: float  # bound from above
    unit: str  # cm, s, frames, % or x

    @property
    def met(self) -> bool:
        """Whether every figure is measured and within the bounds."""
        return bool(self.values) and all(self.least <= value <= self.most for value in self.values)

    def row(self) -> list[str]:
        """Name, what was measured, what was wanted, and the verdict."""
        finite = [value for value in self.values if not np.isnan(value)]
        measured = "unknown"
        if finite:
            low, high = min(finite), max(finite)
            measured = f"{low:.2f}" if low == high else f"{low:.2f} to {high:.2f}"
            measured += "" if len(finite) == len(self.values) else ", some unknown"
        wanted = f"{self.least:g} to {self.most:g}"
        if np.isinf(self.least) or np.isinf(self.most):
            bounded = ("at least", self.least) if np.isinf(self.most) else ("at most", self.most)
            wanted = f"{bounded[0]} {bounded[1]:g}"
        return [self.name, measured, wanted, self.unit, "met" if self.met else "MISSED"]


def criteria(groups: dict[str, list[Result]], causal: bool) -> list[Criterion]:
    """All demands on the groups that were tracked."""
    result = []
    for group, results in groups.items():
        if group == "balancing":
            result += real_errors(results)
        elif group in MOST_SYNTHETIC_M:
            result.append(synthetic_errors(group, results))
        result += behaviour(group, results, causal)
    return result


def real_errors(results: list[Result]) -> list[Criterion]:
    """Of the real recording, camera by camera."""
    by_name = {result.clip.name: result for result in results}
    front = [by_name[name] for name in FRONT if name in by_name]
    far = [np.nanpercentile(result.video.distances, 95) for result in front]
    alone = min(float(np.mean([result.alone.mean for result in results])), FIRST_IK_M)
    after, everywhere = mean_error(front), mean_error(results)
    cameras = "balancing, cameras 1, 2, 4"
    gain = 100 * (1 - after / alone)
    listed = [
        _below(f"{cameras}, mean", [100 * after], 100 * MOST_REAL_M, "cm"),
        _below(f"{cameras}, 95 %", [100 * float(np.mean(far))], 100 * MOST_REAL_95_M, "cm"),
        Criterion(f"{cameras}, below IK alone", [gain], 100 * LEAST_GAIN, np.inf, "%"),
        _below("balancing, all cameras", [100 * everywhere], 100 * MOST_REAL_ALL_M, "cm"),
    ]
    if REAR in by_name:
        rear = 100 * by_name[REAR].video.mean
        listed.append(_below("balancing, camera 3, IK alone", [rear], round(100 * alone, 2), "cm"))
    return listed


def synthetic_errors(group: str, results: list[Result]) -> Criterion:
    """The mean error from each camera placement."""
    placements: dict[float, list[Result]] = {}
    for result in results:
        placements.setdefault(result.clip.azimuth, []).append(result)
    means = [100 * mean_error(errors) for errors in placements.values()]
    return _below(f"{group}, mean of each placement", means, 100 * MOST_SYNTHETIC_M[group], "cm")


def behaviour(group: str, results: list[Result], causal: bool) -> list[Criterion]:
    """Calm, lag, wrong turns and, where they are reported, deviations."""
    calm = [result.calm.ratio for result in results]
    lags = [abs(result.lag_frames) for result in results]
    wrong = 100 * float(np.mean([result.wrong_share for result in results]))
    longest = [float(np.nanmax(result.turns.longest)) for result in results]
    bounds = CALM_CAUSAL if causal else CALM
    listed = [
        Criterion(f"{group}, acceleration / reference", calm, *bounds, "x"),
        _below(f"{group}, lag", lags, MOST_LAG_FRAMES, "frames"),
        _below(f"{group}, wrong turns", [wrong], 100 * MOST_WRONG, "%"),
        _below(f"{group}, recovery", [max(longest)], MOST_RECOVERY_S, "s"),
    ]
    if (sure := covered(results)) is not None:
        shares, widths = (
            [float(v) for v in values.ravel() if np.isfinite(v)]
            for values in (100 * sure.share, sure.ratio)
        )
        low, high = (100 * share for share in COVERED)
        listed.append(Criterion(f"{group}, truths in the 90 % interval", shares, low, high, "%"))
        listed.append(_below(f"{group}, deviation / RMS error", widths, MOST_WIDTH, "x"))
    return listed


def mean_error(results: list[Result]) -> float:
    """Mean elbow error with video over some recordings, metres."""
    return float(np.mean([result.video.mean for result in results]))


def covered(results: list[Result]) -> IntervalCoverage | None:
    """Coverage of each landmark and coordinate over the samples of all recordings."""
    pooled = pool(results)
    if pooled is None:
        return None
    return interval_coverage(pooled.offsets, pooled.deviations)


def pool(results: list[Result]) -> Sureness | None:
    """The samples of all recordings; None where there are no deviations."""
    available = [result.sureness for result in results if result.sureness is not None]
    if not available:
        return None
    columns = (np.concatenate(parts) for parts in zip(*(s[1:] for s in available), strict=True))
    return Sureness(available[0].landmarks, *columns)


def _below(name: str, values: Sequence[float], most: float, unit: str) -> Criterion:
    return Criterion(name, values, -np.inf, most, unit)


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
    cells = [f"{100 * result.wrong_share:.1f}", f"{np.nanmax(result.turns.longest):.2f}"]
    cells += [f"{seconds:.2f}" for seconds in result.astray]
    cells += [f"{size:.1f}" for size in sizes]
    cells += [f"{ratio:.2f}" for ratio in (calm.ratio, alone.ratio)]
    lags = (result.lag_frames, alone.worst_lag / result.frame)
    cells += [f"{lag:+.2f}" if math.isfinite(lag) else "-" for lag in lags]
    return [result.clip.name, *cells]


def astray_row(group: str, results: list[Result]) -> list[str]:
    """For how long elbows are astray in all of a group's recordings."""
    seconds = np.sum([result.astray for result in results], 0)
    return [f"{group}, all", "", "", *(f"{each:.2f}" for each in seconds), "", "", "", "", "", ""]


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
        errors += [*map(error_row, results), mean_row(group, results), worst_row(group, results)]
        calm += [*map(calm_row, results), astray_row(group, results)]
        parts += [rows] if (rows := sure_rows(group, results)) else []
    verdicts = [["criterion", "measured", "wanted", "", ""]]
    verdicts += [criterion.row() for criterion in criteria(groups, causal)]
    tables = "\n\n".join(map(align_columns, [errors, calm, *parts, verdicts]))
    return f"elbows: distance from the truth, cm; off markers: head and hands, cm\n{tables}"


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
