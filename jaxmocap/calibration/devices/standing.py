"""How tall somebody is and how devices are held, by standing still in a T or an I pose.

INPUTS: where devices are while the person stands; what is stated of the body and of the devices.
OUTPUTS: a StandingCalibration: height, arms' lengths, orientations and offsets of devices.

    t   arms stretched to the sides, palms down
    i   arms hanging, thumbs ahead

In both the person stands upright and looks straight ahead. The line between the hands tells which
way the body faces; every bone's orientation follows from the pose, and a device's on its bone from
that. The stature is the headset's height by the eyes' share of it (Winter, after Drillis and
Contini 1966); in a T pose the hands' distance gives the arms' length. How well the person stands is
in all of it: some degrees, and a centimetre or two. ``offsets`` measures offsets of hands better.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from jaxmocap.body.orientations import quaternions
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.body.surfaces.surface import bones_over_time
from jaxmocap.formats.armatures.body_armature import T_POSE
from jaxmocap.formats.recordings.marker_places import MarkerPlace

Stance = Literal["t", "i"]
# Joints of a stance that are not 0, degrees.
STANCE_ANGLES_DEG: dict[Stance, dict[str, float]] = {"t": T_POSE, "i": {}}
# Height of the eyes by stature (Winter 2009, figure 4.1, after Drillis and Contini 1966).
EYE_HEIGHT = 0.936
# What is worn farther above or below the eyes, by its stated place, is no headset, metres.
NEAR_EYES_M = 0.08
# Statures that are believed, metres: beyond them the floor is not where the devices have it.
HEIGHT_RANGE_M = (1.0, 2.3)
# Arms differ from the tables' by less than this share.
MAX_ARM_CHANGE = 0.12
# A head that looks further aside than this, degrees, does not look straight ahead.
MAX_GAZE_DEG = 20.0
# No device sits further from its bone, metres.
MAX_OFFSET_M = 0.3
# Hands further from where the stance has them, metres, are in another one.
MAX_HAND_AWAY_M = 0.35
# Hands nearer than this, metres, do not tell which way the body faces.
MIN_HANDS_APART_M = 0.2
_ARM_BONES = ("humerus", "radius")


@dataclass(frozen=True)
class StandingCalibration:
    """What standing still has measured."""

    height: float | None  # stature, metres; None without a headset
    # Bone -> metres, of the arms; in a T pose only.
    lengths: Mapping[str, float] = field(default_factory=dict)
    # Marker -> quaternion, wxyz, from its axes to its bone's.
    orientations: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    # Marker -> (3,) metres in its bone's axes, from its stated place on the bone.
    offsets: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()  # sentences that a user should see


class StandingError(ValueError):
    """What was measured cannot be somebody who stands so; the message is one sentence."""


@dataclass(frozen=True)
class _Stand:
    """A body that stands: bones' joints (B, 3), metres, above the origin, and (B, 3, 3)."""

    skeleton: Skeleton
    joints: np.ndarray
    R_body_bone: np.ndarray

    def point(self, place: MarkerPlace) -> np.ndarray:
        """Where a place on a bone is, its offset left out."""
        i = self.skeleton.tree.bone(place.bone)
        along = float(self.skeleton.lengths[i]) * np.asarray(self.skeleton.directions[i], float)
        return self.joints[i] + self.R_body_bone[i] @ (place.at * along)

    def site(self, place: MarkerPlace) -> np.ndarray:
        """Where a marker is."""
        i = self.skeleton.tree.bone(place.bone)
        return self.point(place) + self.R_body_bone[i] @ np.array(place.offset)


def calibrate_standing(
    places: Sequence[MarkerPlace],
    positions_world: np.ndarray,
    R_world_marker: np.ndarray,
    stance: Stance,
    body: Skeleton,
    scaled: bool = True,
) -> StandingCalibration:
    """What a stance tells of the body and its devices.

    Args:
        places: of the M markers.
        positions_world: (M, 3) metres, Z up, the floor at 0; NaN where missing.
        R_world_marker: (M, 3, 3) from the markers' axes; NaN where missing.
        stance: ``t`` or ``i``.
        body: of the person, as stated.
        scaled: whether height and arms' lengths are measured too; else the body stays as stated.

    Raises:
        StandingError: neither hands nor headset tell which way the body faces, or the headset is
            at no height that a person's is, or hands are not where the stance has them.
    """
    warnings: list[str] = []
    height = _stature(places, positions_world) if scaled else None
    places, positions_world = _on_bones(places, positions_world, R_world_marker)
    R_world_body = _facing(places, positions_world, R_world_marker, warnings)
    if height is not None:
        # The stature's bones; the joints stay.
        usual, bones = Skeleton.human(height), ("lengths", "directions", "masses", "diameters")
        body = replace(body, **{name: getattr(usual, name) for name in bones})
    lengths: dict[str, float] = {}
    if scaled and stance == "t":
        lengths = _arm_lengths(places, positions_world, stand(body, stance), warnings)
        changed = np.array(body.lengths)
        for name, length in lengths.items():
            changed[body.tree.bone(name)] = length
        body = replace(body, lengths=changed.astype(body.lengths.dtype))
    standing, orientations = stand(body, stance), {}
    _check_hands(places, positions_world, R_world_body, standing)
    for place, R in zip(places, R_world_marker, strict=True):
        if np.isfinite(R).all():
            R_world_bone = R_world_body @ standing.R_body_bone[body.tree.bone(place.bone)]
            orientations[place.name] = tuple(quaternions(R_world_bone.T @ R).tolist())
    if height is not None:
        _check_headset(places, standing, height, warnings)
    offsets = _offsets(places, positions_world, R_world_body, standing, warnings)
    return StandingCalibration(height, lengths, orientations, offsets, tuple(warnings))


def stand(skeleton: Skeleton, stance: Stance) -> _Stand:
    """A body in a stance, facing x, its ankles on the floor as the tracker stands it."""
    tree = skeleton.tree
    angles = np.zeros((1, len(tree.joints)))
    for joint, degrees in STANCE_ANGLES_DEG[stance].items():
        angles[0, tree.joint(joint)] = np.radians(degrees)
    pose = Pose(np.zeros((1, 3)), np.eye(4)[:1], angles)  # type: ignore[arg-type]
    R, joints = (part[0] for part in bones_over_time(skeleton, pose))
    foot = tree.bone("foot_l")
    joints[:, 2] += float(skeleton.diameters[foot, 0]) - joints[foot, 2]
    return _Stand(skeleton, joints, R)


def _on_bones(
    places: Sequence[MarkerPlace], positions_world: np.ndarray, R_world_marker: np.ndarray
) -> tuple[list[MarkerPlace], np.ndarray]:
    """Places and positions of the bones' points, of markers whose offset is in their own axes."""
    points, moved = np.array(positions_world, float), list(places)
    for i, (place, R) in enumerate(zip(places, R_world_marker, strict=True)):
        if place.offset_in == "marker":
            points[i] -= np.nan_to_num(R @ np.array(place.offset))
            moved[i] = replace(place, offset=(0.0, 0.0, 0.0))
    return moved, points


def _facing(
    places: Sequence[MarkerPlace],
    positions_world: np.ndarray,
    R_world_marker: np.ndarray,
    warnings: list[str],
) -> np.ndarray:
    """(3, 3) from the body's axes to the world's: by the hands, else by the headset."""
    by_hands, by_head = _left_of_hands(places, positions_world), None
    for place, R in zip(places, R_world_marker, strict=True):
        if place.bone == "head" and place.orientation is not None and np.isfinite(R).all():
            R_head = R @ Rotation.from_quat(place.orientation, scalar_first=True).as_matrix().T
            by_head = R_head[:, 1] * [1, 1, 0]
    left = by_hands if by_hands is not None else by_head
    if left is None:
        raise StandingError(
            "found neither both hands nor a headset's orientation, one of which tells which way "
            "you face"
        )
    left = left / np.linalg.norm(left)
    if by_hands is not None and by_head is not None:
        aside = float(
            np.degrees(np.arccos(np.clip(left @ by_head / np.linalg.norm(by_head), -1, 1)))
        )
        if aside > MAX_GAZE_DEG:
            warnings.append(f"the headset looks {aside:.0f}° away from where you face by the hands")
    return np.stack([np.cross(left, [0.0, 0, 1]), left, [0.0, 0, 1]], -1)


def _left_of_hands(places: Sequence[MarkerPlace], positions: np.ndarray) -> np.ndarray | None:
    """The horizontal line (3,) from the right to the left hand, metres, or None."""
    sides = [
        [p for place, p in zip(places, positions, strict=True)
         if place.bone == f"hand_{side}" and np.isfinite(p).all()] for side in "lr"
    ]  # fmt: skip
    if not all(sides):
        return None
    left = (np.mean(sides[0], 0) - np.mean(sides[1], 0)) * [1, 1, 0]
    return left if np.linalg.norm(left) > MIN_HANDS_APART_M else None


def _stature(places: Sequence[MarkerPlace], positions: np.ndarray) -> float | None:
    """Stature by the height of what is worn on the head, metres; None without."""
    heights = [p[2] for place, p in zip(places, positions, strict=True)
               if place.bone == "head" and np.isfinite(p).all()]  # fmt: skip
    if not heights:
        return None
    height = float(np.mean(heights)) / EYE_HEIGHT
    low, high = HEIGHT_RANGE_M
    if not low <= height <= high:
        raise StandingError(
            f"found the headset {np.mean(heights):.2f} m above the floor, expected "
            f"{EYE_HEIGHT * low:.1f} to {EYE_HEIGHT * high:.1f} m: set the floor in the program "
            "that sends"
        )
    return height


def _check_headset(
    places: Sequence[MarkerPlace], standing: _Stand, height: float, warnings: list[str]
) -> None:
    """Warn of a marker on the head whose stated place is not the eyes' height."""
    for place in places:
        stated, eyes = standing.site(place)[2], EYE_HEIGHT * height
        if place.bone == "head" and abs(stated - eyes) > NEAR_EYES_M:
            warnings.append(
                f"{place.name} is stated to be {100 * abs(stated - eyes):.0f} cm "
                f"{'above' if stated > eyes else 'below'} the eyes, and the stature was found as "
                "if it were at them: state the height in [subject], or at = 0.4 of a headset"
            )


def _check_hands(
    places: Sequence[MarkerPlace],
    positions: np.ndarray,
    R_world_body: np.ndarray,
    standing: _Stand,
) -> None:
    """StandingError where a hand is elsewhere beside the head than in the stance."""
    sites = np.stack([standing.site(place) for place in places])
    on_head = [place.bone == "head" for place in places]
    away = positions @ R_world_body - sites
    if not any(on_head):
        return
    distances = np.linalg.norm(away - away[on_head].mean(0), axis=-1)
    for place, distance in zip(places, distances, strict=True):
        if place.bone.startswith("hand") and distance > MAX_HAND_AWAY_M:
            raise StandingError(
                f"{place.name} is {100 * distance:.0f} cm from where this stance has it: stand in "
                "it until it is measured"
            )


def _arm_lengths(
    places: Sequence[MarkerPlace], positions: np.ndarray, standing: _Stand, warnings: list[str]
) -> dict[str, float]:
    """Lengths of the arms' bones by the distance between the hands, metres."""
    line = _left_of_hands(places, positions)
    if line is None:
        return {}
    by_side = {side: np.mean([standing.site(p)[1] for p in places if p.bone == f"hand_{side}"])
               for side in "lr"}  # fmt: skip
    apart, expected = float(np.linalg.norm(line)), float(by_side["l"] - by_side["r"])
    body = standing.skeleton
    arm = sum(float(body.lengths[body.tree.bone(f"{name}_l")]) for name in _ARM_BONES)
    factor = 1 + (apart - expected) / 2 / arm
    if abs(factor - 1) > MAX_ARM_CHANGE:
        warnings.append(
            f"the hands are {apart:.2f} m apart, expected about {expected:.2f} m of stretched "
            "arms: the arms' lengths stay as they were"
        )
        return {}
    return {
        f"{name}_{side}": factor * float(body.lengths[body.tree.bone(f"{name}_{side}")])
        for name in _ARM_BONES
        for side in "lr"
    }


def _offsets(
    places: Sequence[MarkerPlace],
    positions_world: np.ndarray,
    R_world_body: np.ndarray,
    standing: _Stand,
    warnings: list[str],
) -> dict[str, tuple[float, ...]]:
    """Offsets of what is not held: the headset's height, and all of trackers on trunk and legs.

    The body stands below the headset, or between the hands; hands' offsets are the grip's.
    """
    present = [i for i, p in enumerate(positions_world) if np.isfinite(p).all()]
    on_head = [i for i in present if places[i].bone == "head"]
    anchors = on_head or [i for i in present if places[i].bone.startswith("hand")]
    if not anchors:
        return {}
    origin = np.mean(
        [positions_world[i] - R_world_body @ standing.site(places[i]) for i in anchors], 0
    ) * [1, 1, 0]
    offsets = {}
    for i in present:
        place = places[i]
        if place.bone.startswith(("hand", "radius", "humerus")) or place.offset_in == "marker":
            continue
        R = R_world_body @ standing.R_body_bone[standing.skeleton.tree.bone(place.bone)]
        offset = R.T @ (positions_world[i] - origin - R_world_body @ standing.point(place))
        if place.bone == "head":
            # How far ahead of the head's axis it is decides where the body is, not this pose.
            offset = np.array([*place.offset[:2], offset[2]])
        if np.linalg.norm(offset) > MAX_OFFSET_M:
            warnings.append(
                f"{place.name} is {100 * np.linalg.norm(offset):.0f} cm from its place on "
                f"{place.bone}: its offset stays as it was"
            )
            continue
        offsets[place.name] = tuple(np.round(offset, 4).tolist())
    return offsets
