"""A run's results: a few lines of text, and the same as figures.

INPUTS: a Motion with its Report. OUTPUTS: plain text; frames per second; JSON.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from jaxmocap.body.motion import Motion, Report
from jaxmocap.formats.files.writing import replacing
from jaxmocap.outputs.report import misfit, plain, summarise

# Stages that run once, compilation included.
ONE_TIME_STAGES = ("first_call", "smooth")


def frames_per_second(report: Report) -> float:
    """All stages of an event together: of those with a video frame where there are any.

    In the median, to which smoothing over a whole recording adds its mean, compilation included.
    NaN where nothing was timed.
    """
    spent = report.milliseconds
    for stage in ("frame", "sample"):
        if stage in spent:
            each = float(np.median(spent[stage]))
            if stage == "frame" and len(spent.get("smooth", ())) == 1:
                each += float(spent["smooth"][0]) / len(spent["observe"])
            return 1e3 / each
    return float("nan")


def summary(motion: Motion, files: Sequence[Path] = (), warnings: Sequence[str] = ()) -> str:
    """Samples, rate, stages, marker errors, confidence, warnings, and the files.

    Args:
        motion: with or without its report.
        files: that were written.
        warnings: besides those of the report.
    """
    report = motion.report
    rows = [("samples", f"{len(motion.times)}, {motion.times[0]:.2f} to {motion.times[-1]:.2f} s")]
    if report is not None:
        rows += _figures(report)
        counts: dict[str, int] = {}
        for sentence in (line for lines in report.statuses for line in lines):
            counts[sentence] = counts.get(sentence, 0) + 1
        rows += [("status", f"{sentence} ({n} samples)") for sentence, n in counts.items()]
        if on := report.settings.get("filters", {}).get("on"):
            rows.append(("filters", ", ".join(f"{name} = {value}" for name, value in on.items())))
        rows += [("warning", warning) for warning in report.settings.get("warnings", ())]
        if (sentence := misfit(motion)) is not None:
            rows.append(("warning", sentence))
    rows += [("warning", sentence) for sentence in warnings]
    rows += [("written", str(path)) for path in files]
    width = max(len(name) for name, _ in rows)
    return "\n".join(f"{name.ljust(width)}  {text}" for name, text in rows)


def _figures(report: Report) -> list[tuple[str, str]]:
    rows = [("rate", f"{frames_per_second(report):.0f} frames per second")]
    for stage, times in report.milliseconds.items():
        if stage in ONE_TIME_STAGES:
            rows.append((stage, f"{times[0] / 1e3:.1f} s, compilation included"))
        else:
            rows.append((stage, f"{np.median(times):.2f} ms (median of {len(times)})"))
    errors = [f"{name} {_centimetres(column)}" for name, column in _columns(report)]
    if errors:
        rows.append(("off the markers", f"{', '.join(errors)} (95 %)"))
    # Frames need not fall on a sample to have been observed.
    if "observe" in report.milliseconds:
        means = [f"{np.nanmean(column):.2f}" for column in report.confidence.T]
        rows.append(("confidence", f"left elbow {means[0]}, right elbow {means[1]}"))
    return rows


def _columns(report: Report) -> list[tuple[str, np.ndarray]]:
    return list(zip(report.markers, report.marker_errors.T, strict=True))


def _centimetres(errors: np.ndarray) -> str:
    finite = errors[np.isfinite(errors)]
    return f"{100 * np.percentile(finite, 95):.1f} cm" if len(finite) else "never measured"


def figures(motion: Motion) -> dict:
    """What ``report.json`` holds, and the rate."""
    rate = {} if motion.report is None else {"frames_per_second": frames_per_second(motion.report)}
    return summarise(motion) | rate


def write_figures(figures: Mapping, path: str | Path | None = None) -> str:
    """The figures as JSON text, NaN as null; written to a file where one is named."""
    text = json.dumps(plain(figures), indent=2, ensure_ascii=False, allow_nan=False)
    if path is not None:
        with replacing(path) as beside:
            beside.write_text(text + "\n", encoding="utf-8")
    return text
