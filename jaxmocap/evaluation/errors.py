"""Joint positions against a reference: distances, their statistics, jitter.

INPUTS: a Motion, or tracked joints, and reference markers over time (metres, Z up, seconds).
OUTPUTS: Errors: distances per joint and matched sample, their statistics, a dictionary for JSON.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jaxmocap.body.motion import Motion
from jaxmocap.evaluation.series import finite_mean, high_pass, match, second_difference
from jaxmocap.formats.files.errors import InputError, comma_list
from jaxmocap.formats.motion_npz import load_motion
from jaxmocap.formats.time_series.axes import R_WORLD_OF_UP, to_world
from jaxmocap.formats.time_series.markers import default_up, read_markers
from jaxmocap.formats.time_series.resampling import interpolation_at, lerp
from jaxmocap.formats.time_series.tables import MILLISECOND_S, Markers

# Of a normal distribution 90 % lie within so many standard deviations.
WITHIN_90 = 1.6448536269514722


class IntervalCoverage(NamedTuple):
    """Figures of each column, shaped as a row of what they were made of, such as (3,) or (L, 3)."""

    samples: np.ndarray  # where both were measured
    share: np.ndarray  # of these, errors within the 90 % interval; NaN where there is none
    # Median standard deviation over root mean square error; NaN where there is none, infinite where
    # there is no error.
    ratio: np.ndarray


def interval_coverage(errors: np.ndarray, deviations: np.ndarray) -> IntervalCoverage:
    """Hold standard deviations (T, ...) against actual errors of the same shape; NaN is unknown."""
    errors, deviations = (np.asarray(each, float) for each in (errors, deviations))
    is_finite = np.isfinite(errors) & np.isfinite(deviations)
    inside = is_finite & (np.abs(errors) <= WITHIN_90 * deviations)
    samples = is_finite.sum(0)
    some, counts = samples > 0, np.maximum(samples, 1)
    rms = np.sqrt(np.sum(np.where(is_finite, errors, 0.0) ** 2, 0) / counts)
    # Columns without data get a row that keeps NumPy's median from warning.
    medians = np.nanmedian(np.where(is_finite | ~some, np.where(some, deviations, 0.0), np.nan), 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(some, medians / rms, np.nan)
    return IntervalCoverage(samples, np.where(some, inside.sum(0) / counts, np.nan), ratio)


# Statistic -> its unit, as the end of its key in JSON; metres where it is not here.
_UNITS = {"samples": "", "jitter": "_m_s2", "within_90": "_share", "error_over_stated": ""}


@dataclass(frozen=True)
class Errors:
    """Errors of J joints at N matched samples.

    Attributes:
        joints: names of the tracked joints.
        times: (N,) seconds.
        offsets: (N, J, 3) tracked minus reference position, world, metres; NaN where either is
            missing.
        deviations: (N, J, 3) standard deviations of the tracked joints, world, metres; NaN where
            none is stated; None where the tracked joints come without any.
    """

    joints: tuple[str, ...]
    times: np.ndarray
    offsets: np.ndarray
    deviations: np.ndarray | None = None

    @property
    def distances(self) -> np.ndarray:
        """(N, J) Euclidean distances, metres; NaN where missing."""
        return np.linalg.norm(self.offsets, axis=-1)

    @property
    def high_passed(self) -> np.ndarray:
        """(N, J) the part of the distances above 0.3 Hz, metres."""
        columns = [high_pass(self.times, column) for column in self.distances.T]
        return np.stack(columns, -1)

    @property
    def jitter(self) -> np.ndarray:
        """(J,) root mean square of the offsets' second differences, m/s^2.

        The reference's own acceleration is subtracted; what remains is the jitter of the tracked
        joint and of the reference.
        """
        acceleration = second_difference(self.times, self.offsets)
        return np.sqrt(_per_joint(np.mean, np.sum(acceleration**2, -1)))

    def statistics(self) -> dict[str, np.ndarray]:
        """Name -> (J,) figures: metres, and m/s^2 for the jitter; NaN for a joint without data."""
        distances = self.distances
        return {
            "samples": np.sum(np.isfinite(distances), 0),
            "mean": _per_joint(np.mean, distances),
            "median": _per_joint(np.median, distances),
            "p95": _per_joint(lambda d: np.percentile(d, 95), distances),
            "rms": np.sqrt(_per_joint(np.mean, distances**2)),
            "high_pass_rms": np.sqrt(_per_joint(np.mean, self.high_passed**2)),
            "jitter": self.jitter,
        } | self._reliability()

    def _reliability(self) -> dict[str, np.ndarray]:
        """What was stated beside what was found, where any deviation was."""
        if self.deviations is None or not np.isfinite(self.deviations).any():
            return {}
        # All three coordinates of a joint in one column.
        columns = (
            np.swapaxes(each, 1, 2).reshape(-1, len(self.joints))
            for each in (self.offsets, self.deviations)
        )
        _, share, ratio = interval_coverage(*columns)
        with np.errstate(divide="ignore"):
            over_stated = 1 / ratio
        return {
            "stated": _per_joint(np.median, np.linalg.norm(self.deviations, axis=-1)),
            "within_90": share,
            "error_over_stated": over_stated,
        }

    @property
    def mean(self) -> float:
        """Mean over the joints of their mean distances, metres; NaN where there is no data."""
        return finite_mean(self.statistics()["mean"])

    def as_dict(self) -> dict:
        """Figures of each joint and their means over the joints, for JSON; NaN becomes None."""
        statistics = self.statistics()
        table = {key + _UNITS.get(key, "_m"): values for key, values in statistics.items()}
        joints = {
            name: {key: _plain(values[j]) for key, values in table.items()}
            for j, name in enumerate(self.joints)
        }
        over_joints = {key: _plain(finite_mean(values)) for key, values in table.items()}
        return {"joints": joints, "mean_over_joints": over_joints}


def _per_joint(statistic, values: np.ndarray) -> np.ndarray:
    """A statistic of each column's finite entries; NaN for a column without any."""
    finite = [column[np.isfinite(column)] for column in values.T]
    return np.array([statistic(column) if len(column) else np.nan for column in finite])


def _plain(value: np.generic | float) -> int | float | None:
    """A Python number for JSON."""
    number = float(value)
    if not np.isfinite(number):
        return None
    return int(number) if isinstance(value, np.integer) else number


def position_errors(
    times: np.ndarray,
    joints: Mapping[str, np.ndarray],
    truth_times: np.ndarray,
    truth: Mapping[str, np.ndarray],
    pairs: Mapping[str, str],
    sources: tuple[str | Path, str | Path] = ("tracked joints", "reference"),
    deviations: Mapping[str, np.ndarray] | None = None,
) -> Errors:
    """Errors of tracked joints against a reference's markers at the same times.

    Between two samples the reference is interpolated, except within a gap.

    Args:
        times: (T,) seconds of the tracked joints.
        joints: name -> (T, 3) world, metres (``Motion.joints()``).
        truth_times: (R,) seconds of the reference.
        truth: name -> (R, 3) world, metres.
        pairs: joint name -> the name of its marker in the reference.
        sources: names of the two in messages.
        deviations: joint -> (T, 3) standard deviations of the tracked joints, metres.

    Raises:
        InputError: an unknown joint or marker, no pair, or no common time.
    """
    tracked, reference = sources
    if not pairs:
        raise InputError(tracked, "nothing to compare, expected a pair such as elbow_r=RElbow")
    for joint, marker in pairs.items():
        _require(joint, joints, "joint", tracked)
        _require(marker, truth, "marker", reference)
    a, b = match(times, truth_times)
    if not len(a):
        problem = f"covers {_span(times)} and has no time in common with {reference}"
        raise InputError(tracked, f"{problem}, which covers {_span(truth_times)}")
    # Stamps that differ by rounding are of one moment; else the reference is taken between samples.
    own, found = np.asarray(times, float)[a], np.asarray(truth_times, float)
    within = np.clip(own, found[0], found[-1])
    at = interpolation_at(
        found, np.where(np.abs(found[b] - own) > MILLISECOND_S / 2, within, found[b])
    )
    offsets = [
        np.asarray(joints[joint], float)[a] - lerp(np.asarray(truth[marker], float), at)
        for joint, marker in pairs.items()
    ]
    stated = None
    if deviations is not None:
        stated = np.stack([np.asarray(deviations[joint], float)[a] for joint in pairs], 1)
    return Errors(tuple(pairs), np.asarray(times, float)[a], np.stack(offsets, 1), stated)


def _require(name: str, points: Mapping[str, np.ndarray], kind: str, source: str | Path) -> None:
    if name not in points:
        raise InputError(source, f"no {kind} {name!r}, expected one of {', '.join(points)}")


def _span(times: np.ndarray) -> str:
    return f"{times[0]:.3f} to {times[-1]:.3f} s" if len(times) else "no time at all"


def _points_z_up(reference: Markers, up: str) -> dict[str, np.ndarray]:
    """Name -> points (T, 3), world with Z up, of a reference whose vertical axis is ``up``."""
    if up not in R_WORLD_OF_UP:
        raise ValueError(f"up = {up!r}: expected one of {', '.join(R_WORLD_OF_UP)}")
    return {name: to_world(R_WORLD_OF_UP[up], at) for name, at in reference.points().items()}


def evaluate(
    motion: Motion, truth: str | Path | Markers, pairs: Mapping[str, str], up: str | None = None
) -> Errors:
    """Errors of a motion's joints against a reference, matched by time stamp.

    Args:
        motion: what was tracked.
        truth: a file of markers, a .bvh or .glb whose joints are compared, or Markers.
        pairs: joint name -> the name of its marker in the reference.
        up: the reference's vertical axis, "z" or "y" (world = (z, x, y) of the file); None is "y"
            for .bvh and .glb, else "z".

    Raises:
        InputError: a file that is missing or no marker file, an unknown name, no common time.
        ValueError: another ``up``.

    Example:
        >>> from jaxmocap import Recording, Settings, evaluate, track
        >>> motion = track(Recording.load("recording.toml"), Settings(refine="none"))
        >>> errors = evaluate(motion, "truth.trc", {"elbow_r": "elbow_r"})
        >>> bool(errors.mean < 1.0)  # metres
        True
    """
    in_memory = isinstance(truth, Markers)
    markers = truth if in_memory else read_markers(truth)
    points = _points_z_up(markers, up or ("z" if in_memory else default_up(truth)))
    sources = "motion", "reference" if in_memory else truth
    joints, deviations = motion.joints(), motion.deviations()
    return position_errors(motion.times, joints, markers.times, points, pairs, sources, deviations)


def evaluate_directory(
    directory: str | Path,
    truth_path: str | Path,
    pairs: Mapping[str, str] | None = None,
    up: str | None = None,
    offset: float = 0.0,
) -> Errors:
    """Errors of the joints that ``track`` wrote, against a reference.

    They are those of ``motion.npz``, whose axes are the world's; of ``joints.trc``, Z up, where
    that is missing; or of the one that is named in place of their folder.

    ``pairs`` and ``up`` are as in ``evaluate``; without pairs, joints of the same names in both are
    compared. ``offset`` is added to the reference's times, seconds; a .bvh always begins at 0.

    Raises:
        InputError: a file that is missing or no marker file, an unknown name, no common time.
        ValueError: another ``up``.
    """
    path, deviations = Path(directory), None
    if not path.is_file():
        names = ("motion.npz", "joints.trc")
        path = next((path / name for name in names if (path / name).is_file()), path / names[1])
    if path.suffix == ".npz":
        motion = load_motion(path)
        times, joints, deviations = motion.times, motion.joints(), motion.deviations()
    else:
        tracked = read_markers(path)
        times, joints = tracked.times, tracked.points()
    truth = read_markers(truth_path)
    points = _points_z_up(truth, up or default_up(truth_path))
    if pairs is None:
        pairs = {name: name for name in joints if name in points}
        if not pairs:
            found, ours = comma_list(truth.names), comma_list(tuple(joints))
            problem = f"no joint of the same name; state --match: found {found}, ours are {ours}"
            raise InputError(truth_path, problem)
    sources = path, truth_path
    return position_errors(times, joints, truth.times + offset, points, pairs, sources, deviations)
