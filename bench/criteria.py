"""What a tracker must show, and whether it does.

INPUTS: Results, by group. OUTPUTS: Criteria, and their table.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from bench.evaluation import Result, Sureness
from bench.figures import aligned
from jaxmocap.evaluation.errors import IntervalCoverage, interval_coverage

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


@dataclass(frozen=True)
class Criterion:
    """One demand.

    Attributes:
        name: what is measured.
        values: every figure that has to fulfil it.
        least: bound from below.
        most: bound from above.
        unit: cm, s, frames, % or x.
    """

    name: str
    values: Sequence[float]
    least: float
    most: float
    unit: str

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


def table(criteria: Iterable[Criterion]) -> str:
    """One row for each."""
    heading = ["criterion", "measured", "wanted", "", ""]
    return aligned([heading, *(criterion.row() for criterion in criteria)])


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
    after, everywhere, cameras = (
        mean_error(front),
        mean_error(results),
        "balancing, cameras 1, 2, 4",
    )
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
    return interval_coverage(np.zeros(pooled.offsets.shape), pooled.offsets, pooled.deviations)


def pool(results: list[Result]) -> Sureness | None:
    """The samples of all recordings; None where there are no deviations."""
    available = [result.sureness for result in results if result.sureness is not None]
    if not available:
        return None
    columns = (np.concatenate(parts) for parts in zip(*(s[1:] for s in available), strict=True))
    return Sureness(available[0].landmarks, *columns)


def _below(name: str, values: Sequence[float], most: float, unit: str) -> Criterion:
    return Criterion(name, values, -np.inf, most, unit)
