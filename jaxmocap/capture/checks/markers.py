"""Is a recording what its file says? Looked at before anything is tracked; nothing is corrected.

INPUTS: a Recording, and the times of its videos' frames.
OUTPUTS: Findings: what is wrong, and the field to change, in one sentence each. A finding is fatal
where no tracking could mean anything (a person of 1,780 m), and a warning where an unusual person
or room might explain it.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from jaxmocap.body.origin import local_origin
from jaxmocap.capture.checks.body_reach import reach, standing_points, stature
from jaxmocap.capture.markers import median_interval
from jaxmocap.formats.recordings.recording import Recording

# Markers that span as many times as much as on somebody who stands are in another unit.
TOO_LARGE, TOO_SMALL = 3.0, 0.1
UNITS = {
    "millimetres": 1000.0,
    "centimetres": 100.0,
    "inches": 39.37,
    "metres, not millimetres": 0.001,
    "metres, not centimetres": 0.01,
}
STATURES_M = (0.4, 2.6)
# Limbs are a tenth longer than a table says, and a marker sits some centimetres off its bone.
REACH_SHARE, REACH_M = 1.1, 0.05
# Marker rates outside are times in another unit than seconds, or the numbers of frames.
RATES_HZ = (2.0, 20_000.0)
RATE_TOLERANCE = 0.02
# Of a person who stands, heights differ along the vertical as they should (share 1); raised hands
# leave half of it. Another axis must do so much better, and its level be that of a person.
UPRIGHT, MUCH_LESS, LEVELS = 0.4, 0.6, (0.6, 1.8)
# Nobody is tracked who is upside down in most samples. Heights are so for certain if they differ so
# much the other way round; hands held up as far as they reach make it 0.45, on the back 0.66.
INVERTED = 0.75
# A world of a continent's size: no place on the Earth's maps is farther from their origin.
FARTHEST_M = 1e7
# Hands this far before (or behind) the head tell where the front is, if they do so most of the
# time and the recording is long enough for a habit to show.
BEFORE_M, MOST, HABIT_S = 0.2, 0.8, 3.0


@dataclass(frozen=True)
class Finding:
    """Something that is wrong with a recording.

    Attributes:
        check: which check found it.
        sentence: the field, what was found there, and what to change.
        fatal: whether tracking would be nonsense.
    """

    check: str
    sentence: str
    fatal: bool = False


def check_markers(recording: Recording) -> list[Finding]:
    """What is wrong with body, units, times, axes, sides and places of the markers."""
    if absurd := list(_places(recording)):
        return absurd
    found = [*_body(recording), *_times(recording)]
    unit = list(_unit(recording))
    if unit:
        # Whatever else would be said follows from the unit.
        return found + unit
    return [*found, *_far(recording), *_up(recording), *_sides(recording), *_reach(recording)]


def _places(recording: Recording) -> Iterator[Finding]:
    positions = recording.positions_world
    # Missing is NaN; an infinite position is none.
    wrong = np.argwhere((np.abs(positions) > FARTHEST_M).any(-1))
    if not len(wrong):
        return
    sample, marker = wrong[0]
    found = ", ".join(f"{value:.4g}" for value in positions[sample, marker])
    yield Finding(
        "place",
        f"[markers] file: {recording.marker_names[marker]} is at ({found}) m at "
        f"{recording.times[sample]:.4g} s, expected a place within {FARTHEST_M:.0e} m of the "
        "origin, and NaN where it is missing",
        fatal=True,
    )


def _far(recording: Recording) -> Iterator[Finding]:
    """A recording that was made in memory; one that is read has been given a local origin."""
    origin = local_origin(recording.positions_world)
    if not origin.any():
        return
    away = float(np.linalg.norm(origin))
    yield Finding(
        "origin",
        f"positions_world: the markers are {away / 1e3:.4g} km from the origin, where single "
        f"precision keeps {1e3 * np.spacing(np.float32(away)):.2g} mm; subtract a place nearby "
        "from them and from the cameras' places before cameras are made",
    )


def _body(recording: Recording) -> Iterator[Finding]:
    height, (low, high) = stature(recording.skeleton), STATURES_M
    if not low <= height <= high:
        yield Finding(
            "unit",
            f"[subject]: the person is {height:.4g} m tall, expected {low:g} to {high:g} m; state "
            "the static trial's unit in its header",
            fatal=True,
        )


def _unit(recording: Recording) -> Iterator[Finding]:
    expected = _span(standing_points(recording.skeleton, recording.places)[None])[0]
    spans = _span(recording.positions_world)
    if expected < TOO_SMALL or not np.isfinite(spans).any():
        return
    times = np.nanmedian(spans) / expected
    if times < TOO_LARGE:
        times = np.nanmax(spans) / expected
        if times > TOO_SMALL:
            return
    if times == 0:
        yield Finding("unit", "[markers] file: all markers lie at one place", fatal=True)
        return
    unit = min(UNITS, key=lambda name: abs(np.log(times / UNITS[name])))
    yield Finding(
        "unit",
        f"[markers] file: the markers span {times * expected:.4g} m, as on a person of "
        f"{times * stature(recording.skeleton):.4g} m, expected {expected:.2g} m; the numbers look "
        f"like {unit}, {_unit_field(recording.markers_file)}",
        fatal=True,
    )


def _unit_field(path: Path | None) -> str:
    """Where a marker file states its unit."""
    suffix = path.suffix.lower() if path else ""
    stated = {".trc": "change Units in its third line", ".c3d": "change its POINT:UNITS"}
    return stated.get(suffix, "which must be metres")


def _span(positions: np.ndarray) -> np.ndarray:
    """(T,) diagonal of the box around the markers, NaN where less than two are seen."""
    seen = np.asarray(np.isfinite(positions).all(-1))
    low = np.where(seen[..., None], positions, np.inf).min(1)
    high = np.where(seen[..., None], positions, -np.inf).max(1)
    several = seen.sum(1) > 1
    sides = np.where(several[:, None], high, 0.0) - np.where(several[:, None], low, 0.0)
    return np.where(several, np.linalg.norm(sides, axis=-1), np.nan)


def _times(recording: Recording) -> Iterator[Finding]:
    interval, stated = median_interval(recording.times), recording.stated_rate
    if not interval:
        return
    rate, (low, high) = 1 / interval, RATES_HZ
    if not low <= rate <= high:
        yield Finding(
            "rate",
            f"[markers] file: its time stamps are {interval:.4g} s apart, {rate:.3g} samples per "
            f"second, expected {low:g} to {high:g}; the column of times must be seconds",
            fatal=True,
        )
    elif stated and abs(stated / rate - 1) > RATE_TOLERANCE:
        yield Finding(
            "rate",
            f"[markers] file: its header states {stated:.4g} samples per second (DataRate), its "
            f"time stamps say {rate:.4g} and are what counts; change the one that is wrong",
        )


def _complete(recording: Recording) -> tuple[np.ndarray, np.ndarray]:
    """Markers that are mostly seen, and (T', M', 3) the samples that show all of them."""
    seen = np.asarray(np.isfinite(recording.positions_world).all(-1))
    kept = np.flatnonzero(seen.mean(0) >= 0.5)
    return kept, recording.positions_world[seen[:, kept].all(1)][:, kept]


def _up(recording: Recording) -> Iterator[Finding]:
    kept, positions = _complete(recording)
    heights = standing_points(recording.skeleton, recording.places)[kept, 2]
    if not len(positions) or len(kept) < 2 or np.ptp(heights) < BEFORE_M:
        return
    centred = heights - heights.mean()
    shares = np.median(np.einsum("tma,m->ta", positions, centred), 0) / (centred @ centred)
    levels = np.median(positions.mean(1), 0) / heights.mean()
    for axis, name in enumerate("xy"):
        sign = 1.0 if shares[axis] > 0 else -1.0
        upright = sign * shares[axis] >= UPRIGHT and LEVELS[0] <= sign * levels[axis] <= LEVELS[1]
        stands = shares[2] > MUCH_LESS * abs(shares[axis])
        if upright and not stands:
            yield _wrong_up(f"{'' if sign > 0 else '-'}{name}", shares[2], abs(shares[axis]))
            return
    if shares[2] <= -UPRIGHT:
        sure = shares[2] <= -INVERTED or -levels[2] >= LEVELS[0]
        yield _upside_down(shares[2], bool(sure))


def _wrong_up(axis: str, stated: float, other: float) -> Finding:
    remedy = "change [markers] up, or state to_world"
    return Finding(
        "up axis",
        f"[markers] up: the person stands along the world's {axis} ({100 * other:.0f} % of a "
        f"standing person's heights), not along z ({100 * stated:.0f} %); {remedy}",
        fatal=True,
    )


def _upside_down(share: float, sure: bool) -> Finding:
    rather = "" if sure else "; unless hands are held up all the time"
    return Finding(
        "up axis",
        f"[markers] up: the person is upside down in most samples ({100 * share:.0f} % of a "
        f"standing person's heights){rather}, the file's axis points down or an axis is mirrored: "
        "state to_world in place of up",
        fatal=sure,
    )


def pairs(recording: Recording) -> list[tuple[int, int]]:
    """Markers at the same place of the left and the right side."""
    places = {(place.bone, place.at): i for i, place in enumerate(recording.places)}
    return [
        (i, places[bone[:-2] + "_r", at])
        for (bone, at), i in places.items()
        if bone.endswith("_l") and (bone[:-2] + "_r", at) in places
    ]


def facing(recording: Recording) -> list[tuple[tuple[int, int], float, float]]:
    """Which way round each pair of markers is, if the hands are before the head.

    Returns:
        For each pair: its markers; the share of samples in which the hands, well away from the
        head, are where the front is with the left marker at the left; and that share's mean of
        metres before the head. Nothing where head or hands are not seen for long enough.
    """
    head = [i for i, place in enumerate(recording.places) if place.bone == "head"]
    on_hands = recording.skeleton.tree.names_in("forearm", "hand")
    hands = [p for p in pairs(recording) if recording.places[p[0]].bone in on_hands]
    if not (head and hands) or np.ptp(recording.times) < HABIT_S:
        return []
    positions = recording.positions_world[..., :2]
    ahead = positions[:, list(hands[0])].mean(1) - positions[:, head[0]]
    return [
        ((left, right), *_signed(ahead, positions[:, left] - positions[:, right]))
        for left, right in pairs(recording)
    ]


def _signed(ahead: np.ndarray, leftward: np.ndarray) -> tuple[float, float]:
    """Share of (T, 2) vectors ``ahead`` to the right of ``leftward``, and their mean there."""
    across = ahead[:, 0] * leftward[:, 1] - ahead[:, 1] * leftward[:, 0]
    forward = across / np.maximum(np.linalg.norm(leftward, axis=1), 1e-9)
    tell = np.abs(forward) > BEFORE_M
    if tell.sum() < 0.25 * len(forward):
        return 0.5, 0.0
    return float((forward[tell] > 0).mean()), float(np.nanmean(forward))


def _sides(recording: Recording) -> Iterator[Finding]:
    told = facing(recording)
    wrong = [row for row in told if row[1] <= 1 - MOST]
    if not wrong:
        return
    names = [tuple(recording.marker_names[i] for i in pair) for pair, _, _ in wrong]
    exchanged = ", ".join(f"{left} and {right}" for left, right in names)
    rather = ""
    if len(wrong) == len(told):
        rather = (
            ", or the file's axes are left-handed (then state to_world with one row negated, in "
            "place of up)"
        )
    share, metres = wrong[0][1], -wrong[0][2]
    yield Finding(
        "left and right",
        f"[markers.on] {exchanged}: the hands are behind the head in {100 * (1 - share):.0f} % of "
        f"the samples, by {metres:.2f} m on average; left and right are exchanged{rather}",
    )


def _reach(recording: Recording) -> Iterator[Finding]:
    names, positions = recording.marker_names, recording.positions_world
    allowed = REACH_SHARE * reach(recording.skeleton, recording.places) + REACH_M
    counts, worst = np.zeros(allowed.shape, int), np.zeros(allowed.shape)
    for i in range(len(names)):
        for j in range(i):
            away = np.linalg.norm(positions[:, i] - positions[:, j], axis=-1)
            counts[i, j] = counts[j, i] = (away > allowed[i, j]).sum()
            worst[i, j] = worst[j, i] = np.nanmax(away, initial=0.0)
    marker = int(counts.sum(1).argmax())
    other = int(counts[marker].argmax())
    if not counts[marker, other]:
        return
    number, total = counts[marker, other], len(positions)
    yield Finding(
        "reach",
        f"[markers.on] {names[marker]}: up to {worst[marker, other]:.2f} m from {names[other]}, in "
        f"{number} of {total} samples farther than the {allowed[marker, other]:.2f} m that this "
        "body reaches; check its bone, or [subject]",
        fatal=bool(2 * number > total),
    )
