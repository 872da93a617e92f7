"""A run's results: a few lines of text, and the same as figures.

INPUTS: a Motion with its Report. OUTPUTS: plain text; frames per second; figures.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from jaxmocap.body.motion import UNDETERMINED_M, Motion, Report
from jaxmocap.body.skeleton import LANDMARKS
from jaxmocap.outputs.report import misfit, summarise

# A landmark that is not determined in fewer of the samples is not listed.
LEAST_SHARE = 0.05
# Landmarks of which the summary says what determines them, and by how much of it.
EXPLAINED = ("elbow_l", "elbow_r", "pelvis")
MOST_REASONS = 4


def frames_per_second(report: Report | None) -> float:
    """Video frames, or samples where there is none, by all the seconds that tracking took.

    Compilation is included. NaN where nothing was timed.
    """
    if report is None or not (seconds := report.run.seconds):
        return float("nan")
    count = report.run.video_frames or len(report.statuses)
    return count / sum(seconds.values())


def summary(motion: Motion, files: Sequence[Path] = (), warnings: Sequence[str] = ()) -> str:
    """Samples, seconds, marker errors, the elbows' deviations, all warnings, and the files."""
    report = motion.report
    rows = [("samples", f"{len(motion.times)}, {motion.times[0]:.2f} to {motion.times[-1]:.2f} s")]
    if report is not None:
        rows += _figures(report)
        if report.run.fitted:
            rows.append(("fitted", report.run.fitted))
        rows += [("status", sentence) for sentence in _statuses(report)]
        if on := report.run.filters.get("on"):
            rows.append(("filters", ", ".join(f"{name} = {value}" for name, value in on.items())))
        rows += [("warning", warning) for warning in report.run.warnings]
        if (sentence := misfit(motion)) is not None:
            rows.append(("warning", sentence))
    rows += [("warning", sentence) for sentence in warnings]
    rows += [("written", str(path)) for path in files]
    width = max(len(name) for name, _ in rows)
    return "\n".join(f"{name.ljust(width)}  {text}" for name, text in rows)


def _figures(report: Report) -> list[tuple[str, str]]:
    rows, seconds = [], report.run.seconds
    if seconds:
        passes = ", ".join(
            f"{name} {spent:.1f} s" for name, spent in seconds.items() if spent > 0.05
        )
        frames = report.run.video_frames
        of_frames = f" for {frames} video frames" if frames else ""
        rows.append(("took", f"{sum(seconds.values()):.1f} s{of_frames}: {passes}"))
    columns = zip(report.markers, report.marker_errors.T, strict=True)
    errors = [f"{name} {_centimetres(column)}" for name, column in columns]
    if errors:
        rows.append(("markers", f"position error {', '.join(errors)} (95 %)"))
    deviations = report.elbow_deviations
    if np.isfinite(deviations).any():
        left, right = 100 * np.nanmedian(deviations, 0)
        rows.append(("elbows", f"left ± {left:.1f} cm, right ± {right:.1f} cm (median)"))
    without = report.run.deviations_without_m
    rows += [("why", _why(name, without[name])) for name in EXPLAINED if name in without]
    shares = zip(LANDMARKS, report.undetermined_shares, strict=True)
    unsure = [f"{name} {100 * share:.0f} %" for name, share in shares if share >= LEAST_SHARE]
    if unsure:
        within = f"not determined within {100 * UNDETERMINED_M:.0f} cm"
        rows.append(("unsure", f"{within}: {', '.join(unsure)} of the samples"))
    return rows


def _statuses(report: Report) -> Iterator[str]:
    """Each kind of status, with how many samples have it: what it is about, most often first."""
    kinds: dict[str, Counter[str]] = {}
    for sentence in (line for lines in report.statuses for line in lines):
        kind, colon, about = sentence.partition(": ")
        kinds.setdefault(kind + colon, Counter())[about] += 1
    for kind, counts in kinds.items():
        (first, n), *others = counts.most_common()
        listed = [f"{kind}{first} ({n} samples)", *(f"{about} ({k})" for about, k in others)]
        yield ", ".join(listed)


def _why(landmark: str, deviations_m: Mapping[str, float]) -> str:
    """How sure a landmark is, and would be without what matters most to it."""
    (_, all_of_it), *parts = deviations_m.items()
    most = sorted(parts, key=lambda part: -part[1])[:MOST_REASONS]
    listed = ", ".join(f"{name} ± {100 * without:.1f}" for name, without in most)
    return f"{landmark} ± {100 * all_of_it:.1f} cm; without {listed or 'any of it the same'}"


def _centimetres(errors: np.ndarray) -> str:
    finite = errors[np.isfinite(errors)]
    return f"{100 * np.percentile(finite, 95):.1f} cm" if len(finite) else "never measured"


def figures(motion: Motion, files: Sequence[Path] = (), warnings: Sequence[str] = ()) -> dict:
    """What ``report.json`` holds, the rate, and as in ``summary`` the warnings and the files."""
    rate = {} if motion.report is None else {"frames_per_second": frames_per_second(motion.report)}
    return summarise(motion) | rate | {"warnings": list(warnings), "files": list(map(str, files))}
