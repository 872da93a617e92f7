"""Are left and right, and markers above one another, as the file states? See ``checks``.

Where the front is, hands tell, which are before the head most of the time, and walking, which goes
ahead.

INPUTS: a Recording. OUTPUTS: Findings about labels that are exchanged.
"""

from collections.abc import Iterator

import numpy as np

from jaxmocap.capture.checks import Finding
from jaxmocap.capture.checks.body_reach import standing_points
from jaxmocap.formats.recordings.recording import Recording

# Hands this far before (or behind) the head show where the front is, metres,
MIN_HANDS_AHEAD_M = 0.2
# and so does a head that goes so fast, metres per second, as measured over so many seconds,
MIN_WALK_M_S = 0.4
WALK_SPAN_S = 0.5
# for so many metres at least and in this share of the samples,
MIN_WALKED_M = 1.5
MIN_WALKED_SHARE = 0.5
# in this share of the samples or of the way,
MIN_AGREEING_SHARE = 0.8
# and hands do if the recording is long enough for a habit to show, seconds.
MIN_DURATION_S = 3.0
# Markers whose heights differ by so much on somebody who stands, metres, keep their order,
MIN_APART_M = 0.5
# or lie beside one another, within so much, metres.
BESIDE_M = 0.1


def facing_of_pairs(recording: Recording) -> list[tuple[tuple[int, int], str]]:
    """Each left marker and its right one, and what says that they are exchanged; "" if nothing."""
    head = [i for i, place in enumerate(recording.places) if place.bone == "head"]
    # Markers at the same place of the left and the right side.
    places = {(place.bone, place.at): i for i, place in enumerate(recording.places)}
    pairs = [
        (i, places[bone[:-2] + "_r", at])
        for (bone, at), i in places.items()
        if bone.endswith("_l") and (bone[:-2] + "_r", at) in places
    ]
    if not (head and pairs):
        return []
    lasts = np.ptp(recording.times) >= MIN_DURATION_S
    positions = recording.positions_world[..., :2]
    on_hands = recording.skeleton.tree.names_in("forearm", "hand")
    hands = [p for p in pairs if lasts and recording.places[p[0]].bone in on_hands]
    middle = positions[:, list(hands[0])].mean(1) if hands else positions[:, head[0]]
    ahead = middle - positions[:, head[0]]
    walked, steps = _walk(recording.times, positions[:, head[0]])
    found = []
    for left, right in pairs:
        leftward = positions[:, left] - positions[:, right]
        hands_share, hands_ahead = _hands_share(_forward(ahead, leftward))
        walk_share = _walk_share(_forward(walked, leftward), steps)
        votes = [
            int(share >= MIN_AGREEING_SHARE) - int(share <= 1 - MIN_AGREEING_SHARE)
            for share in (hands_share, walk_share)
        ]
        # Hands or walking say that left is right, and the other does not deny it.
        reason = ""
        if sum(votes) < 0 and votes[0] < 0:
            reason = (
                f"the hands are behind the head in {100 * (1 - hands_share):.0f} % of the samples, "
                f"by {-hands_ahead:.2f} m on average"
            )
        elif sum(votes) < 0:
            reason = f"{100 * (1 - walk_share):.0f} % of the way is walked backwards"
        found.append(((left, right), reason))
    return found


def _forward(ahead: np.ndarray, leftward: np.ndarray) -> np.ndarray:
    """(T,) what of vectors ``ahead`` (T, 2) points to the right of ``leftward`` (T, 2), by 90°."""
    across = ahead[:, 0] * leftward[:, 1] - ahead[:, 1] * leftward[:, 0]
    return across / np.maximum(np.linalg.norm(leftward, axis=1), 1e-9)


def _hands_share(forward: np.ndarray) -> tuple[float, float]:
    """Of (T,) metres, the share ahead among those clearly off 0 (0.5 of few), and their mean."""
    is_clear = np.abs(forward) > MIN_HANDS_AHEAD_M
    if is_clear.sum() < 0.25 * len(forward):
        return 0.5, 0.0
    return float((forward[is_clear] > 0).mean()), float(np.nanmean(forward))


def _walk(times: np.ndarray, head: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Velocities (T, 2) of a head (T, 2), NaN at the ends, and the seconds (T,) of each sample."""
    before = np.clip(np.searchsorted(times, times - WALK_SPAN_S / 2), 0, len(times) - 1)
    after = np.clip(np.searchsorted(times, times + WALK_SPAN_S / 2), 0, len(times) - 1)
    spans = times[after] - times[before]
    whole = spans > WALK_SPAN_S / 2
    velocities = (head[after] - head[before]) / np.where(whole, spans, np.nan)[:, None]
    return velocities, np.gradient(times) if len(times) > 1 else np.zeros(len(times))


def _walk_share(forward: np.ndarray, seconds: np.ndarray) -> float:
    """Share of what is walked ahead, of (T,) metres per second, if it is a way."""
    walks = np.abs(forward) > MIN_WALK_M_S
    metres = np.where(walks, forward * seconds, 0.0)
    total = np.abs(metres).sum()
    if total < MIN_WALKED_M or walks.mean() < MIN_WALKED_SHARE:
        return 0.5
    return float(metres[metres > 0].sum() / total)


def check_sides(recording: Recording) -> Iterator[Finding]:
    """Left and right."""
    facing = facing_of_pairs(recording)
    wrong = [(pair, reason) for pair, reason in facing if reason]
    if not wrong:
        yield from _check_names(recording)
        return
    names = [tuple(recording.marker_names[i] for i in pair) for pair, _ in wrong]
    exchanged = ", ".join(f"{left} and {right}" for left, right in names)
    alternative = ""
    if len(wrong) == len(facing):
        alternative = (
            ", or the file's axes are left-handed (then state to_world with one row negated, in "
            "place of up)"
        )
    yield Finding(
        "left and right",
        f"[markers.on] {exchanged}: {wrong[0][1]}; left and right are exchanged{alternative}",
    )


def _check_names(recording: Recording) -> Iterator[Finding]:
    """Markers whose names say left and right the other way round than their bones."""
    others = [
        f"{a.name} on {a.bone} and {b.name} on {b.bone}"
        for a in recording.places
        for b in recording.places
        if a.bone.endswith("_l") and b.bone == f"{a.bone[:-2]}_r" and _is_mirrored(a.name, b.name)
    ]
    if others:
        sentence = f"[markers.on] {', '.join(others)}: by their names left and right are exchanged"
        yield Finding("left and right", sentence)


def _is_mirrored(right: str, left: str) -> bool:
    """Do two names differ in R and L, or right and left, alone?"""
    for of_right, of_left in (("right", "left"), ("r", "l")):
        for i in range(len(right)):
            end = i + len(of_right)
            other = f"{right[:i]}{of_left}{right[end:]}"
            if right[i:end].lower() == of_right and left.lower() == other.lower():
                return True
    return False


def check_heights(recording: Recording) -> Iterator[Finding]:
    """A marker that is stated far above another and is mostly below it: a head as a hand."""
    heights = standing_points(recording.skeleton, recording.places)[:, 2]
    levels, names = recording.positions_world[..., 2], recording.marker_names
    wrong = []
    for high in range(len(names)):
        for low in np.flatnonzero(heights < heights[high] - MIN_APART_M):
            apart = levels[:, low] - levels[:, high]
            apart = apart[np.isfinite(apart)]
            expected = heights[high] - heights[low]
            share = float((apart > BESIDE_M).mean()) if len(apart) else 0.0
            if share >= MIN_AGREEING_SHARE:
                wrong.append((expected, high, int(low), share, float(np.median(apart))))
    if not wrong:
        return
    _, high, low, share, apart = max(wrong)
    yield Finding(
        "exchanged",
        f"[markers.on] {names[high]} and {names[low]}: {names[low]} is above {names[high]} in "
        f"{100 * share:.0f} % of the samples, by {apart:.2f} m in the median, expected "
        f"{heights[high] - heights[low]:.2f} m below it on somebody who stands; the two are "
        "exchanged, unless they are held so all the time",
    )


def exchanged_labels(recording: Recording) -> list[str]:
    """What both find, as sentences: what would fit where a body does not meet its markers."""
    return [each.sentence for each in (*check_sides(recording), *check_heights(recording))]
