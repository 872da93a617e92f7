"""Do a body's lengths go with its markers? See ``checks``.

A limb is about as long as people's of that stature: else it was measured between other landmarks.
Markers at both ends of a bone are its length apart. Others come no farther apart than the stretched
body between them: where they do, it is too short, and where hands come nearly as far, the recording
says more of the arms than a height does.

INPUTS: a Recording. OUTPUTS: Findings; names of bones as a user reads them.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from jaxmocap.body.model import marker_sites
from jaxmocap.body.skeleton import (
    JOINT_CENTRES,
    LEAST_HEIGHT_M,
    MOST_HEIGHT_M,
    WINTER,
    Skeleton,
)
from jaxmocap.body.subject import skeleton_stature
from jaxmocap.capture.checks import Finding
from jaxmocap.capture.checks.body_reach import bones_between, max_marker_distances, standing_points
from jaxmocap.formats.marker_sets.sets import determine_body
from jaxmocap.formats.recordings.recording import Recording

# A limb may be longer or shorter by this share than both tables of proportions have it: four
# standard deviations among people.
UNUSUAL_SHARE = 0.25
# A bone's length may differ from that between its markers by this share,
BONE_SHARE = 0.08
# and markers may come so much farther apart than the body reaches.
REACH_SHARE = 0.03
# A marker may lie so far off its point, metres.
OFF_M = 0.015
# Shorter ways between markers are no lengths, metres.
SHORTEST_M = 0.1
# So many findings at most.
MOST = 5
# Samples that are measured, evenly among all: sixty markers have 1770 distances in each.
MOST_SAMPLES = 10_000
# Of these samples, which count as the farthest.
FARTHEST = 99.0
# Arms that come so far of what they reach are stretched: an elbow bent by 35 degrees is at 0.95.
STRETCHED_SHARE = 0.95
ARM, TRUNK, LEG = ("upper_arm", "forearm", "hand"), ("spine", "head"), ("thigh", "shank")
LIMBS = ("upper_arm", "forearm", *LEG)
MEASURE = "measure them (`jaxmocap scale`), or check [subject] and [markers.on]"


class _Pair(NamedTuple):
    """Two markers, ``reach`` apart at most or, rigid, always; distances (T,), metres, or NaN."""

    names: tuple[str, str]
    bones: list[str]
    reach: float
    is_rigid: bool
    distances: np.ndarray

    @property
    def apart(self) -> float:
        """How far they are apart in the median, or at most but for the odd sample, metres."""
        return float(np.nanpercentile(self.distances, 50.0 if self.is_rigid else FARTHEST))

    @property
    def excess(self) -> float:
        """By which share of the body's that is too much, or too little; 0 where it may be right."""
        over, share = self.apart - self.reach, BONE_SHARE if self.is_rigid else REACH_SHARE
        amount = abs(over) if self.is_rigid else over
        return over / self.reach if amount > share * self.reach + OFF_M else 0.0


def check_lengths(recording: Recording) -> Iterator[Finding]:
    """Which lengths do not go with the markers; none where tracking fits them anyway."""
    skeleton, listed = recording.skeleton, []
    if recording.fit and determine_body(skeleton, marker_sites(skeleton, recording.places)):
        return
    # The fewer bones between two markers, the more they say of each.
    for pair in sorted(_pairs(recording), key=lambda pair: len(pair.bones)):
        if not pair.excess or any(set(pair.bones) >= bones for bones in listed):
            continue
        listed.append(set(pair.bones))
        if len(listed) > MOST:
            return
        is_are, up_to, most = ("is", "", "") if pair.is_rigid else ("are", "up to ", "at most ")
        off = f"{'short' if pair.excess > 0 else 'long'} by {100 * abs(pair.excess):.0f} %"
        yield Finding(
            "lengths",
            f"[subject]: {' and '.join(pair.names)} are {up_to}{pair.apart:.2f} m apart, by this "
            f"body {most}{pair.reach:.2f} m: {bone_list(pair.bones)} {is_are} too "
            f"{off}; {MEASURE}",
        )


def check_proportions(recording: Recording) -> Iterator[Finding]:
    """Limbs as nobody of that stature has them: a landmark is of another marker, or side."""
    skeleton = recording.skeleton
    stature = skeleton_stature(skeleton)
    tall = float(np.clip(stature, LEAST_HEIGHT_M, MOST_HEIGHT_M))
    bodies = [Skeleton.human(tall, proportions=each) for each in (JOINT_CENTRES, WINTER)]
    for bone in skeleton.tree.names_in(*LIMBS):
        long = float(skeleton.lengths[skeleton.tree.bone(bone)])
        usual = [float(body.lengths[body.tree.bone(bone)]) for body in bodies]
        least, most = min(usual), max(usual)
        if not (1 - UNUSUAL_SHARE) * least <= long <= (1 + UNUSUAL_SHARE) * most:
            yield Finding(
                "lengths",
                f"[subject]: {bone} is {long:.2f} m long, of somebody {stature:.2f} m tall usually "
                f"{least:.2f} to {most:.2f} m: was it measured between other markers, or sides "
                "exchanged?",
            )


def check_stretched_arms(recording: Recording, measured: Sequence[str]) -> Iterator[Finding]:
    """Whether the recording determines arms that no ``measured`` bone states, by its reach."""
    arms = recording.skeleton.tree.names_in(*ARM)
    if not recording.videos or recording.path is None or set(arms) & set(measured):
        return
    hands = [place.name for place in recording.places if place.bone in arms]
    for pair in _pairs(recording):
        sides = {bone[-2:] for bone in pair.bones if bone in arms}
        if set(pair.names) <= set(hands) and sides == {"_l", "_r"}:
            if pair.apart >= STRETCHED_SHARE * pair.reach:
                yield Finding(
                    "arms",
                    f"[subject]: {' and '.join(pair.names)} are up to {pair.apart:.2f} m apart, "
                    "both arms being stretched: this recording determines their lengths better "
                    f"than the height does; `jaxmocap scale --recording {recording.path.name} --out"
                    " measured.toml` finds them",
                )
            return


def bone_list(bones: Sequence[str]) -> str:
    """Names of bones; without side where both sides are among them."""
    return ", ".join(
        dict.fromkeys(
            bone[:-2] if {f"{bone[:-2]}_l", f"{bone[:-2]}_r"} <= set(bones) else bone
            for bone in bones
        )
    )


def _pairs(recording: Recording) -> Iterator[_Pair]:
    """All pairs of markers that are ever there together, and lengths apart."""
    skeleton, places = recording.skeleton, recording.places
    farthest, lengths = _reaches(recording), np.asarray(skeleton.lengths, float)
    positions = recording.positions_world[:: max(1, -(-len(recording.times) // MOST_SAMPLES))]
    for i, second in enumerate(places):
        for j, first in enumerate(places[:i]):
            distances = np.linalg.norm(positions[:, i] - positions[:, j], axis=-1)
            ways = [
                bone
                for bone, share in bones_between(skeleton, first, second)
                if abs(share) * lengths[bone] > OFF_M
            ]
            if not np.isfinite(distances).any() or farthest[i, j] < SHORTEST_M:
                continue
            offset = np.any(first.offset) or np.any(second.offset)
            rigid = len(ways) == 1 and not offset
            names = [skeleton.tree.bones[bone] for bone in ways]
            yield _Pair((first.name, second.name), names, farthest[i, j], rigid, distances)


def _reaches(recording: Recording) -> np.ndarray:
    """(M, M) metres that two markers can be apart; from head or trunk to a leg, as who stands."""
    skeleton, places = recording.skeleton, recording.places
    farthest = max_marker_distances(skeleton, places)
    standing = standing_points(skeleton, places)
    upright = np.linalg.norm(standing[:, None] - standing, axis=-1)
    on_trunk, on_legs = (
        np.array([place.bone in skeleton.tree.names_in(*parts) for place in places])
        for parts in (TRUNK, LEG)
    )
    across = on_trunk[:, None] & on_legs
    return np.where(across | across.T, upright, farthest)
