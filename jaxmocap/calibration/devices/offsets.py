"""Where a device sits in relation to the joint that it rotates about, such as a grip to a wrist.

INPUTS: a clip of markers with orientations, each rotating about a joint that stays where it is:
the forearm rests on a table and the hand turns, up and down, to the sides, and twisting.
OUTPUTS: for each marker its offset from that joint in its own axes, with covariance; and how it is
held, by a while in which the person stands upright.

A marker at p with orientation R, whose joint lies at w has the offset o with p = w + R o (pivot
calibration). In every second of the clip w is an unknown of its own, so that the arm may shift and
devices wander; all seconds share o, by least squares, those in which the joint strays more counting
less. Three devices with six degrees of freedom do not measure joints: the result is the point
that stayed, and that this is the wrist is the clip's making. When the whole arm moves it is an
elbow, a shoulder, or nothing; the offset's length and the joint's own motion show it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from jaxmocap.body.orientations import quaternions
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.files.toml import toml_key
from jaxmocap.formats.recordings.marker_places import MarkerPlace
from jaxmocap.formats.recordings.recording import load_markers
from jaxmocap.formats.time_series.tables import Markers

WINDOW_S = 1.0
# Windows that the scatter between them takes.
MIN_WINDOWS = 8
# Samples that make a window.
MIN_WINDOW_SAMPLES = 5
# A joint that strays less within a second, metres, is not weighed down for it.
STEADY_RMS_M = 0.001
REWEIGHTINGS = 10
# Beyond these, metres, the clip was none of rotation about a joint that rests: the offset's
# standard deviation, the joint's own motion, and the offset's length.
MAX_STD_M = 0.01
MAX_JOINT_RMS_M = 0.01
MAX_LENGTH_M = 0.25
# A bone -> the one whose joint is at its far end, about which hands turn.
BONE_BEYOND = {"radius_l": "hand_l", "radius_r": "hand_r"}


@dataclass(frozen=True)
class DeviceOffset:
    """How one device sits on its bone."""

    place: MarkerPlace  # of the marker; its bone's joint is what it rotated about
    offset: np.ndarray  # (3,) metres, from the joint to the marker, in the marker's axes
    covariance: np.ndarray  # (3, 3) of it, by the scatter between the clip's seconds
    joint_rms: float  # metres (RMS) that the joint moved within a second, noise included
    rotation_rms: float  # degrees (RMS) that the marker rotated within a second
    windows: int  # seconds that were used
    # (3, 3) from the marker's axes to the bone's, or None where nobody stood still.
    orientation: np.ndarray | None = None
    orientation_rms: float = float("nan")  # degrees (RMS) that it varied by while standing

    @property
    def std(self) -> np.ndarray:
        """(3,) standard deviations of the offset, metres."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def warnings(self) -> tuple[str, ...]:
        """Why not to use it; empty where nothing speaks against it."""
        values, vectors = np.linalg.eigh(self.covariance)
        warnings, length = [], float(np.linalg.norm(self.offset))
        if values[-1] > MAX_STD_M**2:
            x, y, z = vectors[:, -1]
            warnings.append(
                f"not determined along [{x:.2f}, {y:.2f}, {z:.2f}] of the marker's axes, about "
                "which alone it rotated: rotate it about the others too"
            )
        if self.joint_rms > MAX_JOINT_RMS_M:
            warnings.append(f"its joint moved by {1e3 * self.joint_rms:.0f} mm a second: rest it")
        if length > MAX_LENGTH_M:
            warnings.append(
                f"{100 * length:.0f} cm from what it rotated about, which is hardly the joint of "
                f"{self.place.bone}: rest what carries it"
            )
        if self.place.bone in BONE_BEYOND and self.place.at > 0.5:
            beyond = BONE_BEYOND[self.place.bone]
            warnings.append(
                f"stated at the wrist, but the joint of {self.place.bone} is the elbow, from which "
                f'its offset would count: state bone = "{beyond}" and find it again'
            )
        return tuple(warnings)


def estimate_offsets(
    markers: Markers,
    places: Sequence[MarkerPlace],
    still: tuple[float, float] | None = None,
    span: tuple[float, float] = (-np.inf, np.inf),
) -> list[DeviceOffset]:
    """How every marker with an orientation sits on its bone.

    Args:
        markers: in the world's axes, metres, with orientations.
        places: of the markers, in the same order; only their bones count.
        still: seconds between which the person stands upright, arms hanging, thumbs and nose
            forward; None leaves the devices' orientations open.
        span: seconds between which the devices turn about their joints.

    Raises:
        ValueError: no marker has an orientation, the clip is too short, or markers on both hands
            do not show somebody who stands at those times.
    """
    if markers.orientations is None or not np.isfinite(markers.orientations).any():
        raise ValueError("no marker has an orientation")
    orientations, offsets = markers.orientations, []
    yaw = None if still is None else _standing_orientation(markers, places, still)
    for i, place in enumerate(places):
        if not np.isfinite(orientations[:, i]).any():
            continue
        offset = _pivot_calibration(
            markers.times, markers.positions[:, i], orientations[:, i], place, span
        )
        if still is not None and yaw is not None:
            R_measured = orientations[_within(markers.times, still), i]
            R_measured = R_measured[np.isfinite(R_measured.sum((1, 2)))]
            if not len(R_measured):
                raise ValueError(f"{place.name}: has no orientation while standing")
            R = Rotation.from_matrix(yaw.T @ R_measured)
            spread = float(np.degrees(np.sqrt(np.mean((R.mean().inv() * R).magnitude() ** 2))))
            offset = replace(offset, orientation=R.mean().as_matrix(), orientation_rms=spread)
        offsets.append(offset)
    return offsets


def _within(times: np.ndarray, span: tuple[float, float]) -> np.ndarray:
    return (times >= span[0]) & (times <= span[1])


def _pivot_calibration(
    times: np.ndarray,
    positions: np.ndarray,
    orientations: np.ndarray,
    place: MarkerPlace,
    span: tuple[float, float],
) -> DeviceOffset:
    """The offset of one marker (T, 3), (T, 3, 3)."""
    usable = np.isfinite(positions.sum(-1) + orientations.sum((1, 2))) & _within(times, span)
    seconds = np.floor((times - times[0]) / WINDOW_S).astype(int)
    windows = [np.flatnonzero(usable & (seconds == k)) for k in np.unique(seconds)]
    windows = [window for window in windows if len(window) >= MIN_WINDOW_SAMPLES]
    if len(windows) < MIN_WINDOWS:
        raise ValueError(
            f"{place.name}: found {len(windows)} seconds with places and turns, expected "
            f"{MIN_WINDOWS} or more"
        )
    A = [orientations[w] - orientations[w].mean(0) for w in windows]
    b = [positions[w] - positions[w].mean(0) for w in windows]
    offset, weights, strays = _robust_offset(A, b)
    swing = [Rotation.from_matrix(orientations[w]) for w in windows]
    angles = [(R.mean().inv() * R).magnitude() for R in swing]
    return DeviceOffset(
        place,
        offset,
        _covariance(A, b, offset, weights),
        float(np.sqrt(np.average(strays**2, weights=weights))),
        float(np.degrees(np.sqrt(np.mean(np.concatenate(angles) ** 2)))),
        len(windows),
    )


def _robust_offset(
    A: Sequence[np.ndarray], b: Sequence[np.ndarray]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Offset (3,), and weight and straying (K,) of each second, reweighted till they settle."""
    weights, offset, strays = np.ones(len(A)), np.zeros(3), np.zeros(len(A))
    for _ in range(REWEIGHTINGS):
        rows = np.concatenate(
            [np.sqrt(w) * a.reshape(-1, 3) for w, a in zip(weights, A, strict=True)]
        )
        target = np.concatenate([np.sqrt(w) * c.ravel() for w, c in zip(weights, b, strict=True)])
        offset = np.linalg.lstsq(rows, target, rcond=None)[0]
        strays = np.array([np.sqrt(np.mean(np.sum((c - a @ offset) ** 2, -1)))
                           for a, c in zip(A, b, strict=True)])  # fmt: skip
        usual = max(float(np.median(strays)), STEADY_RMS_M)
        weights = 1 / (1 + (strays / usual) ** 2)
    return offset, weights, strays


def _covariance(
    A: Sequence[np.ndarray], b: Sequence[np.ndarray], offset: np.ndarray, weights: np.ndarray
) -> np.ndarray:
    """Of the offset (3, 3), metres^2, by how much the seconds disagree (a sandwich by seconds).

    Within a second errors are anything but independent: the joint strays, devices wander.
    """
    normal, pulls = np.zeros((3, 3)), np.zeros((len(A), 3))
    for k, (w, a, c) in enumerate(zip(weights, A, b, strict=True)):
        normal += w * np.einsum("tki,tkj->ij", a, a)
        pulls[k] = w * np.einsum("tki,tk->i", a, c - a @ offset)
    inverse = np.linalg.pinv(normal)
    # Three unknowns have made the residuals smaller than the errors are.
    few = len(A) / (len(A) - 3)
    # What the turns leave open: a device is within a metre. About an axis that rotated a thirtieth
    # of the others or less the noise outweighs it.
    values, vectors = np.linalg.eigh(normal)
    is_open = values / max(float(values[-1]), 1e-12) < 1e-3
    undetermined = vectors @ np.diag(np.where(is_open, 1.0, 0.0)) @ vectors.T
    return few * inverse @ pulls.T @ pulls @ inverse + undetermined


def _standing_orientation(
    markers: Markers, places: Sequence[MarkerPlace], still: tuple[float, float]
) -> np.ndarray:
    """(3, 3) from the body's axes to the world's of who stands, by the line between the hands."""
    sides = [[i for i, p in enumerate(places) if p.bone == f"hand_{side}"] for side in "lr"]
    during = markers.positions[_within(markers.times, still)]
    if not all(sides) or not len(during):
        raise ValueError("standing still needs a marker on hand_l and one on hand_r at those times")
    left, right = (np.nanmean(during[:, side], axis=(0, 1)) for side in sides)
    y = (left - right) * [1, 1, 0]
    if not np.linalg.norm(y) > 0.1:
        raise ValueError("standing still needs hands apart, to both sides of the body")
    y /= np.linalg.norm(y)
    return np.stack([np.cross(y, [0.0, 0, 1]), y, [0.0, 0, 1]], -1)


def find_offsets(
    path: str | Path,
    still: tuple[float, float] | None = None,
    span: tuple[float, float] = (-np.inf, np.inf),
) -> list[DeviceOffset]:
    """``estimate_offsets`` of a recording's file; what does not fit is an InputError."""
    markers, places = load_markers(path)
    try:
        return estimate_offsets(markers, places, still, span)
    except ValueError as error:
        raise InputError(path, str(error)) from None


def offsets_text(offsets: Sequence[DeviceOffset]) -> str:
    """What was found, and lines for [markers.on]."""
    lines = []
    for offset in offsets:
        mm, std = 1e3 * offset.offset, 1e3 * offset.std
        values = ", ".join(f"{a:.1f} ± {b:.1f}" for a, b in zip(mm, std, strict=True))
        lines.append(
            f"{offset.place.name}: {values} mm from the joint of {offset.place.bone}, which "
            f"moved by {1e3 * offset.joint_rms:.1f} mm a second while it rotated by "
            f"{offset.rotation_rms:.0f}°"
        )
        if offset.orientation is not None:
            lines.append(
                f"  orientation within {offset.orientation_rms:.1f}° while standing (how "
                "straight the person stood is not in that)"
            )
        lines += [f"  warning: {warning}" for warning in offset.warnings]
    entries = [toml_line(offset) for offset in offsets if not offset.warnings]
    nothing = "no line for [markers.on]: every device has a warning"
    return "\n".join([*lines, "", *(["[markers.on]", *entries] if entries else [nothing])])


def toml_line(offset: DeviceOffset) -> str:
    """The entry of [markers.on]."""
    x, y, z = offset.offset
    entry = f'bone = "{offset.place.bone}", at = 0.0, offset = [{x:.4f}, {y:.4f}, {z:.4f}]'
    if offset.orientation is not None:
        quaternion = ", ".join(f"{part:.4f}" for part in quaternions(offset.orientation))
        entry += f', offset_in = "marker", turn = [{quaternion}]'
    else:
        entry += ', offset_in = "marker"'
    return f"{toml_key(offset.place.name)} = {{ {entry} }}"


def offsets_figures(offsets: Sequence[DeviceOffset]) -> dict:
    """The same as figures; what is not finite has none."""
    return {
        offset.place.name: {
            "bone": offset.place.bone,
            "offset_m": offset.offset,
            "std_m": offset.std,
            "covariance_m2": offset.covariance,
            "joint_rms_m": offset.joint_rms,
            "rotation_rms_deg": offset.rotation_rms,
            "seconds": offset.windows,
            "turn_wxyz": None if offset.orientation is None else quaternions(offset.orientation),
            "turn_rms_deg": offset.orientation_rms,
            "warnings": offset.warnings,
        }
        for offset in offsets
    }
