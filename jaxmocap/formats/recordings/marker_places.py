"""Where markers sit on the body, and the points on bones that oriented markers determine.

INPUTS: entries of [markers.on]; positions and quaternions of markers.
OUTPUTS: points on bones and where they are, which the tracker takes as markers like any other.

A marker with an orientation (a head-set, a controller, a rigid set) measures two things more. With
``offset_in = "marker"`` its offset from the bone is stated in its own axes, so that the point on
the bone follows whatever the bone's orientation: a wrist from the controller in the hand. With
``turn``, its orientation on the bone, it measures the bone's orientation: two more points of that
bone, ``lever`` metres from the first along two of the bone's axes, lie where they then must. A
radian weighs as much as ``lever`` metres, and every stage that takes markers takes orientations.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from jaxmocap.body.orientations import matrices
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.formats.files.errors import InputError, short_name, short_repr
from jaxmocap.formats.files.toml import TomlTable

# A degree of orientation weighs as 1.7 mm.
LEVER_M = 0.1
# Metres: nothing that is fixed to a bone is further away from it.
FARTHEST_OFFSET_M = 10.0
# Bones that the joints of ``body/data/wrists.toml`` turn.
BONES_BEYOND_WRISTS = ("neck", "head", "radius_l", "radius_r", "hand_l", "hand_r")


@dataclass(frozen=True)
class MarkerPlace:
    """Where a marker sits on the body."""

    name: str
    bone: str  # name of the bone
    at: float = 1.0  # fraction of the bone's length from its joint
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)  # metres, from that point to the marker
    offset_in: str = "bone"  # whose axes the offset is in, ``bone`` or ``marker``
    # Unit quaternion, wxyz, that takes the marker's axes to the bone's (``turn`` in the file); None
    # where the marker's orientation is not used.
    orientation: tuple[float, float, float, float] | None = None
    lever: float = LEVER_M  # metres that weigh as much as a radian
    states_no_turn: bool = False  # ``turn = false``: the orientation is left out on purpose

    @property
    def needs_orientation(self) -> bool:
        """Whether the marker's orientation must be measured."""
        return self.offset_in == "marker" or self.orientation is not None


def read_place(path: Path, name: str, entry: Any) -> MarkerPlace:
    """Where one marker of [markers.on] sits."""
    keys = ("bone", "at", "offset", "offset_in", "turn", "lever")
    fields = TomlTable(path, f"[markers.on] {name}", entry, keys)
    at = fields.number("at", 1.0, 0.0, 1.0, "a fraction")
    bone = fields.text("bone")
    stated: dict[str, Any] = {}
    if "offset" in fields:
        offset = fields.array("offset", [(3,)], "3 numbers in metres", FARTHEST_OFFSET_M)
        stated["offset"] = tuple(offset.tolist())
    if "offset_in" in fields:
        stated["offset_in"] = fields.choice("offset_in", ("bone", "marker"), "'bone' or 'marker'")
    if fields.entries.get("turn", False) is not False:
        quaternion = fields.array("turn", [(4,)], "a quaternion w, x, y, z, or false")
        norm = float(np.linalg.norm(quaternion))
        if abs(norm - 1) > 0.01:
            raise fields.error("turn", f"found a quaternion of length {norm:g}, expected 1")
        stated["orientation"] = tuple((quaternion / norm).tolist())
    elif "turn" in fields:
        stated["states_no_turn"] = True
    if "lever" in fields:
        stated["lever"] = lever = fields.number("lever", high=FARTHEST_OFFSET_M)
        if "orientation" not in stated or not lever > 0.0:
            raise fields.error("lever", f"found {lever:g}, expected metres above 0 beside 'turn'")
    return MarkerPlace(name, bone, at, **stated)


def check_bones(path: str | Path, places: Sequence[MarkerPlace], skeleton: Skeleton) -> None:
    """InputError for a place on a bone that the skeleton does not have."""
    bones = skeleton.tree.bones
    for place in places:
        if place.bone not in bones:
            problem = f"unknown bone {short_repr(place.bone)}, expected one of {', '.join(bones)}"
            raise InputError(path, f"[markers.on] {short_name(place.name)}: {problem}")


def need_wrists(places: Sequence[MarkerPlace]) -> bool:
    """Whether a marker measures an orientation that the paper's 21 joints cannot follow.

    Without a neck that turns, a headset's orientation turns the trunk.
    """
    return any(
        place.orientation is not None and place.bone in BONES_BEYOND_WRISTS for place in places
    )


def bone_points(skeleton: Skeleton, places: Sequence[MarkerPlace]) -> tuple[MarkerPlace, ...]:
    """The points on bones that the markers measure, each by an offset in its bone's axes."""
    points = []
    for place in places:
        offset = np.zeros(3) if place.offset_in == "marker" else np.array(place.offset)
        points.append(_point(place, place.name, offset))
        if place.orientation is not None:
            points += [
                _point(place, f"{place.name} turned {axis}", offset + place.lever * lever)
                for axis, lever in _lever_axes(skeleton, place.bone).items()
            ]
    return tuple(points)


def _point(place: MarkerPlace, name: str, offset: np.ndarray) -> MarkerPlace:
    x, y, z = offset.tolist()
    return MarkerPlace(name, place.bone, place.at, (x, y, z))


def _lever_axes(skeleton: Skeleton, bone: str) -> dict[str, np.ndarray]:
    """The two axes of a bone's frame that go most across it: its twist moves both."""
    along = np.abs(np.asarray(skeleton.directions[skeleton.tree.bone(bone)]))
    across = sorted(np.argsort(along, kind="stable")[:2])
    return {"xyz"[i]: np.eye(3)[i] for i in across}


def bone_point_binder(
    skeleton: Skeleton, places: Sequence[MarkerPlace]
) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """What takes measurements to the points of ``bone_points``.

    Args:
        skeleton: with the bones.
        places: of the M markers.

    Returns:
        A function of positions (..., M, 3), metres, NaN where missing, and rotations from the
        markers' axes (..., M, 3, 3), NaN where missing. It returns the points (..., P, 3), NaN
        where a marker is missing, or its orientation where that is needed.
    """
    levers = [_levers_marker(skeleton, place) for place in places]
    offsets = [np.array(p.offset) if p.offset_in == "marker" else None for p in places]

    def bind(positions_world: np.ndarray, R_world_marker: np.ndarray) -> np.ndarray:
        points = []
        for i, offset in enumerate(offsets):
            point, R = positions_world[..., i, :], R_world_marker[..., i, :, :]
            if offset is not None:
                point = point - R @ offset
            points += [point, *(point + R @ lever for lever in levers[i])]
        return np.stack(points, -2)

    return bind


def _levers_marker(skeleton: Skeleton, place: MarkerPlace) -> list[np.ndarray]:
    """From a marker's point to those that its orientation gives, metres, in its own axes."""
    if place.orientation is None:
        return []
    R_bone_marker = matrices(np.array([place.orientation]))[0]
    axes = _lever_axes(skeleton, place.bone).values()
    return [place.lever * (R_bone_marker.T @ axis) for axis in axes]
