"""The report of a run as JSON: its times, its standard deviations, the versions it ran on.

INPUTS: a Motion with its Report. OUTPUTS: figures; JSON, where missing numbers are null.
"""

import json
import platform
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxmocap.body.motion import Motion, Report
from jaxmocap.body.skeleton import LANDMARKS
from jaxmocap.formats.files.writing import write_text

SIDES = ("left", "right")
# A body whose median error of a marker is larger, metres, has not been tracked: noise, clothes and
# wrong lengths cause a few centimetres, a wrong axis or a marker on another bone a metre.
MISFIT_M = 0.25
# Further off a marker than this, metres, in half of the samples: a warning.
OFF_M = 0.05
# OpenCV's packages, of which one is installed.
_OPENCV = ("opencv-python-headless", "opencv-python", "opencv-contrib-python-headless")


def write_figures(figures: Mapping, path: str | Path | None = None) -> str:
    """Figures as JSON text, NaN as null; written to a file where one is named."""
    text = json.dumps(plain(figures), indent=2, ensure_ascii=False, allow_nan=False)
    if path is not None:
        write_text(path, text + "\n")
    return text


def summarise(motion: Motion) -> dict:
    """Frames, milliseconds, costs, statuses, deviations, marker errors, settings, versions.

    "misfit" is a warning where the body is far off its markers.
    """
    times = np.asarray(motion.times, float)
    summary: dict = {
        "frames": len(times),
        "start_s": times[0] if len(times) else None,
        "end_s": times[-1] if len(times) else None,
    }
    if motion.report is not None:
        summary |= _summarise_report(times, motion.report) | {"misfit": misfit(motion)}
    device = jax.devices()[0]
    backend = {"platform": device.platform, "device": device.device_kind}
    return summary | {"versions": versions(), "backend": backend}


def misfit(motion: Motion, least: float = OFF_M) -> str | None:
    """A warning that the body is far off a marker in half of the samples; None if it is not.

    By more than ``least``, metres; beyond ``MISFIT_M`` it is not the motion of who was recorded.
    """
    if (report := motion.report) is None:
        return None
    medians = [
        (float(np.median(finite)), name)
        for name, column in zip(report.markers, np.asarray(report.marker_errors).T, strict=True)
        if len(finite := column[np.isfinite(column)])
    ]
    error, name = max(medians, default=(0.0, ""))
    if error <= least:
        return None
    if error > MISFIT_M:
        return (
            f"the position error of marker {name!r} is {100 * error:.0f} cm in the median, so the "
            "body was not tracked: check [markers.on], up or to_world, the unit, and [subject] "
            "(jaxmocap check)"
        )
    off = sorted((each for each in medians if each[0] > least), reverse=True)
    listed = ", ".join(f"{name} ({100 * each:.0f} cm)" for each, name in off)
    return (
        f"the body is more than {100 * least:.0f} cm off these markers in half of the samples: "
        f"{listed}: check their labels and places in [markers]"
    )


def _summarise_report(times: np.ndarray, report: Report) -> dict:
    return {
        "milliseconds": {
            stage: statistics(spent, {"median": 50, "p99": 99})
            for stage, spent in report.milliseconds.items()
        },
        "costs_px": _by_arm(report.arm_costs),
        "statuses": _count_statuses(times, report.statuses),
        "elbow_deviations_m": _by_arm(report.elbow_deviations),
        "swivel_rad": _by_arm(np.abs(report.swivels)),
        "marker_errors_m": {
            name: statistics(errors, {"p95": 95})
            for name, errors in zip(report.markers, np.asarray(report.marker_errors).T, strict=True)
        },
        "landmarks": _by_landmark(report),
        "settings": report.run.as_dict(),
    }


def _by_landmark(report: Report) -> dict:
    """Landmark -> standard deviation over the three axes, metres; shares of samples."""
    by_landmark, undetermined = {}, report.undetermined_shares
    for i, name in enumerate(LANDMARKS):
        deviations = np.linalg.norm(np.asarray(report.landmarks_std[:, i], float), axis=-1)
        by_landmark[name] = {
            "deviation_m": statistics(deviations, {"median": 50, "p95": 95}),
            "undetermined_share": float(undetermined[i]),
            "from_prior_share": statistics(report.from_prior[:, i], {})["mean"],
        }
    return by_landmark


def statistics(values: np.ndarray, percentiles: Mapping[str, float]) -> dict:
    """Count, mean and the named percentiles of what is not NaN; NaN where there is nothing."""
    values = np.asarray(values, float)
    finite = values[np.isfinite(values)]
    figures = {"count": len(finite), "mean": finite.mean() if len(finite) else np.nan}
    for name, percent in percentiles.items():
        figures[name] = np.percentile(finite, percent) if len(finite) else np.nan
    return figures


def _by_arm(values: np.ndarray) -> dict:
    """Statistics of (T, 2) values, left and right arm."""
    columns = np.asarray(values, float).T
    percentiles = {"median": 50, "p95": 95}
    return {side: statistics(each, percentiles) for side, each in zip(SIDES, columns, strict=True)}


def _count_statuses(times: np.ndarray, statuses: tuple[tuple[str, ...], ...]) -> dict:
    """Status -> how often it occurred, and its spans (seconds) without a break."""
    samples_of: dict[str, list[int]] = {}
    for sample, sentences in enumerate(statuses):
        for sentence in dict.fromkeys(sentences):
            samples_of.setdefault(sentence, []).append(sample)
    return {
        sentence: {"count": len(samples), "spans_s": _spans(times, np.array(samples))}
        for sentence, samples in samples_of.items()
    }


def _spans(times: np.ndarray, samples: np.ndarray) -> list[list[float]]:
    runs = np.split(samples, np.flatnonzero(np.diff(samples) > 1) + 1)
    return [[float(times[run[0]]), float(times[run[-1]])] for run in runs]


def versions() -> dict[str, str | None]:
    """Package -> version; None for what is not installed as a package."""
    opencv = (version for name in _OPENCV if (version := _version(name)))
    return {
        "jaxmocap": _version("jaxmocap"),
        "jax": _version("jax"),
        "numpy": _version("numpy"),
        "opencv": next(opencv, None),
        "python": platform.python_version(),
    }


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def plain(value: Any) -> Any:
    """A value for JSON: arrays as lists, dataclasses as dictionaries, NaN as None.

    Fields that no ``repr`` shows, such as whole surfaces, are left out.
    """
    if isinstance(value, Mapping):
        return {str(key): plain(entry) for key, entry in value.items()}
    if is_dataclass(value) and not isinstance(value, type):
        shown = [entry.name for entry in fields(value) if entry.repr]
        return {name: plain(getattr(value, name)) for name in shown}
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(entry) for entry in value]
    if isinstance(value, np.ndarray | np.generic | jax.Array):
        return plain(np.asarray(value).tolist())
    if isinstance(value, float):
        return value if np.isfinite(value) else None
    if value is None or isinstance(value, bool | int | str):
        return value
    return str(value)
