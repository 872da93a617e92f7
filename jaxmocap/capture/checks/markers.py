"""Is a recording what its file states? Checked before anything is tracked; nothing is corrected.

INPUTS: a Recording, and the times of its videos' frames.
OUTPUTS: Findings: what is wrong, and the field to change, in one sentence each. A finding is fatal
where no tracking could mean anything (a person of 1,780 m), and a warning where an unusual person
or room might explain it.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from jaxmocap.body.model import LOWER_LEG
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.body.subject import skeleton_stature
from jaxmocap.capture.checks import Finding
from jaxmocap.capture.checks.body_reach import ReachCounts, standing_points
from jaxmocap.capture.checks.lengths import check_lengths, check_proportions
from jaxmocap.capture.checks.sides import check_heights, check_sides
from jaxmocap.formats.recordings.marker_places import MarkerPlace
from jaxmocap.formats.recordings.recording import Recording
from jaxmocap.formats.time_series.tables import usual_step
from jaxmocap.geometry.origin import local_origin

# Markers that span so many times as much as on somebody who stands are in another unit,
MAX_SPAN_RATIO = 3.0
# and so are those that never span more than this share of it.
MIN_SPAN_RATIO = 0.1
UNIT_FACTORS = {
    "millimetres": 1000.0,
    "centimetres": 100.0,
    "inches": 39.37,
    "metres, not millimetres": 0.001,
    "metres, not centimetres": 0.01,
}
# A unit is named where it explains the span up to such a factor: people bend and raise arms.
UNIT_TOLERANCE = 2.5
STATURE_RANGE_M = (0.4, 2.6)
# Beyond reach by such a factor, and as rarely, a marker is an outlier, not on another bone.
OUTLIER_RATIO = 2.0
MAX_OUTLIER_SHARE = 0.05
# Marker rates outside are times in another unit than seconds, or the numbers of frames.
RATE_RANGE_HZ = (2.0, 20_000.0)
RATE_TOLERANCE = 0.02
# How much of a standing person's differences of height the markers show along an axis: 1 for a
# person who stands along it; raised hands leave half of it. From here on an axis may be upright.
UPRIGHT_SHARE = 0.4
# Heights that differ by less on somebody who stands, metres, show no axis.
MIN_HEIGHTS_M = 0.2
# The vertical axis must show more than this share of what another axis shows.
STANDS_RATIO = 0.6
# The markers' mean height along an upright axis, as shares of a standing person's.
LEVEL_RANGE = (0.6, 1.8)
# Nobody is tracked who is upside down in most samples. Heights are so for certain if they differ so
# much the other way round; hands held up as far as they reach make it 0.45, on the back 0.66.
INVERTED_SHARE = 0.75
# A head may be so much too high or low for somebody who stands on z = 0, metres: people bow, and
# are taller than stated.
MAX_FLOOR_M = 0.35
# A world of a continent's size: no place on the Earth's maps is farther from their origin.
MAX_COORDINATE_M = 1e7


def check_markers(recording: Recording) -> list[Finding]:
    """What is wrong with body, units, times, axes, sides and places of the markers."""
    if impossible := list(_check_positions(recording)):
        return impossible
    findings = [*_check_body(recording), *_check_times(recording)]
    unit = list(_check_unit(recording))
    if unit:
        # Whatever else is wrong follows from the unit.
        return findings + unit
    findings += [
        *_check_origin(recording),
        *check_up(recording.skeleton, recording.places, recording.positions_world),
        *check_proportions(recording),
        *check_sides(recording),
        *check_heights(recording),
    ]
    # A marker on a wrong bone says nothing of lengths; and what is wrong so far explains a floor.
    return findings + (
        list(_check_reach(recording))
        or [*check_lengths(recording), *(() if findings else _check_floor(recording))]
    )


def _check_positions(recording: Recording) -> Iterator[Finding]:
    positions = recording.positions_world
    # Missing is NaN; an infinite position is none.
    wrong = np.argwhere((np.abs(positions) > MAX_COORDINATE_M).any(-1))
    if not len(wrong):
        return
    sample, marker = wrong[0]
    place = ", ".join(f"{value:.4g}" for value in positions[sample, marker])
    yield Finding(
        "place",
        f"[markers] file: {recording.marker_names[marker]} is at ({place}) m at "
        f"{recording.times[sample]:.4g} s, expected a place within {MAX_COORDINATE_M:.0e} m of the "
        "origin, and NaN where it is missing",
        fatal=True,
    )


def _check_origin(recording: Recording) -> Iterator[Finding]:
    """A recording that was made in memory; one that is read has been given a local origin."""
    origin = local_origin(recording.positions_world)
    if not origin.any():
        return
    distance = float(np.linalg.norm(origin))
    yield Finding(
        "origin",
        f"positions_world: the markers are {distance / 1e3:.4g} km from the origin, where single "
        f"precision keeps {1e3 * np.spacing(np.float32(distance)):.2g} mm; subtract a place nearby "
        "from them and from the cameras' places before cameras are made",
    )


def _check_body(recording: Recording) -> Iterator[Finding]:
    height, (low, high) = skeleton_stature(recording.skeleton), STATURE_RANGE_M
    if not low <= height <= high:
        yield Finding(
            "unit",
            f"[subject]: the person is {height:.4g} m tall, expected {low:g} to {high:g} m; state "
            "the static trial's unit in its header",
            fatal=True,
        )


def _check_unit(recording: Recording) -> Iterator[Finding]:
    expected = _span(standing_points(recording.skeleton, recording.places)[None])[0]
    spans = _span(recording.positions_world)
    if expected < MIN_SPAN_RATIO or not np.isfinite(spans).any():
        return
    times = np.nanmedian(spans) / expected
    if times < MAX_SPAN_RATIO:
        times = np.nanmax(spans) / expected
        if times > MIN_SPAN_RATIO:
            return
    if times == 0:
        yield Finding("unit", "[markers] file: all markers lie at one place", fatal=True)
        return
    unit = min(UNIT_FACTORS, key=lambda name: abs(np.log(times / UNIT_FACTORS[name])))
    suffix = recording.markers_file.suffix.lower() if recording.markers_file else ""
    field = {".trc": "change Units in its third line", ".c3d": "change its POINT:UNITS"}.get(suffix)
    cause = f"the numbers look like {unit}, {field or 'which must be metres'}"
    if abs(np.log(times / UNIT_FACTORS[unit])) > np.log(UNIT_TOLERANCE):
        cause = "no unit explains that, are these one person's markers?"
    yield Finding(
        "unit",
        f"[markers] file: the markers span {times * expected:.4g} m, as on a person of "
        f"{times * skeleton_stature(recording.skeleton):.4g} m, expected {expected:.2g} m; {cause}",
        fatal=True,
    )


def _span(positions: np.ndarray) -> np.ndarray:
    """(T,) diagonal of the box around the markers, NaN where less than two are present."""
    is_present = np.asarray(np.isfinite(positions).all(-1))
    low = np.where(is_present[..., None], positions, np.inf).min(1)
    high = np.where(is_present[..., None], positions, -np.inf).max(1)
    several = is_present.sum(1) > 1
    sides = np.where(several[:, None], high, 0.0) - np.where(several[:, None], low, 0.0)
    return np.where(several, np.linalg.norm(sides, axis=-1), np.nan)


def _check_times(recording: Recording) -> Iterator[Finding]:
    interval, stated = usual_step(recording.times), recording.stated_rate
    if not interval:
        return
    rate, (low, high) = 1 / interval, RATE_RANGE_HZ
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
            f"time stamps state {rate:.4g} and are what counts; change the one that is wrong",
        )


def check_up(
    skeleton: Skeleton, places: Sequence[MarkerPlace], positions_world: np.ndarray
) -> Iterator[Finding]:
    """Whether the person stands along another axis than z, by samples (T, M, 3), metres."""
    # Markers that are mostly present, and (T', M', 3) the samples that have all of them.
    is_present = np.asarray(np.isfinite(positions_world).all(-1))
    kept = np.flatnonzero(is_present.mean(0) >= 0.5)
    positions = positions_world[is_present[:, kept].all(1)][:, kept]
    heights = standing_points(skeleton, places)[kept, 2]
    if not len(positions) or len(kept) < 2 or np.ptp(heights) < MIN_HEIGHTS_M:
        return
    centred = heights - heights.mean()
    shares = np.median(np.einsum("tma,m->ta", positions, centred), 0) / (centred @ centred)
    levels = np.median(positions.mean(1), 0) / heights.mean()
    for axis, name in enumerate("xy"):
        sign, level = ("", levels[axis]) if shares[axis] > 0 else ("-", -levels[axis])
        upright = abs(shares[axis]) >= UPRIGHT_SHARE and LEVEL_RANGE[0] <= level <= LEVEL_RANGE[1]
        stands = shares[2] > STANDS_RATIO * abs(shares[axis])
        if upright and not stands:
            yield Finding(
                "up axis",
                f"[markers] up: the person stands along the world's {sign}{name} "
                f"({100 * abs(shares[axis]):.0f} % of a standing person's heights), not along z "
                f"({100 * shares[2]:.0f} %); change [markers] up, or state to_world",
                fatal=True,
            )
            return
    if shares[2] <= -UPRIGHT_SHARE:
        is_certain = bool(shares[2] <= -INVERTED_SHARE or -levels[2] >= LEVEL_RANGE[0])
        unless = "" if is_certain else "; unless hands are held up all the time"
        yield Finding(
            "up axis",
            f"[markers] up: the person is upside down in most samples ({100 * shares[2]:.0f} % of "
            f"a standing person's heights){unless}, the file's axis points down or an axis is "
            "mirrored: state to_world in place of up",
            fatal=is_certain,
        )


def _check_floor(recording: Recording) -> Iterator[Finding]:
    """Feet that no marker holds stand on z = 0, wherever the world's floor is."""
    skeleton, places = recording.skeleton, recording.places
    on_head = [i for i, place in enumerate(places) if place.bone == "head"]
    on_legs = set(skeleton.tree.names_in(*LOWER_LEG)) & {place.bone for place in places}
    heads = recording.positions_world[:, on_head, 2]
    if on_legs or not np.isfinite(heads).any():
        return
    standing = standing_points(skeleton, places)[on_head, 2]
    floor, tall = float(np.nanmedian(heads - standing)), float(standing.mean())
    if abs(floor) > MAX_FLOOR_M:
        zero = float(recording.origin_world[2])
        yield Finding(
            "floor",
            f"[markers] file: the head is at z = {zero + floor + tall:.2f} m in the median, on "
            f"somebody who stands {tall:.2f} m above the floor, and feet without markers stand on "
            f"z = {zero:g} m: unless the person sits or crouches, state floor = {floor:.2f} in "
            "[ik] of a settings file (--settings)",
        )


def _check_reach(recording: Recording) -> Iterator[Finding]:
    counts, total = ReachCounts(recording.skeleton, recording.places), len(recording.times)
    counts.add(recording.positions_world)
    if (worst := counts.worst()) is None:
        return
    names = recording.marker_names
    advice = "check its bone, or [subject]"
    is_outlier = worst.farthest_m > OUTLIER_RATIO * worst.allowed_m
    if is_outlier and worst.samples <= MAX_OUTLIER_SHARE * total:
        advice = "[markers.filters] hampel takes such outliers out"
    yield Finding(
        "reach",
        f"[markers.on] {names[worst.marker]}: up to {worst.farthest_m:.2f} m from "
        f"{names[worst.other]}, in {worst.samples} of {total} samples farther than the "
        f"{worst.allowed_m:.2f} m that this body reaches; {advice}",
        fatal=2 * worst.samples > total,
    )
