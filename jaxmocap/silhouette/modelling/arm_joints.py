"""Shoulder, elbow, wrist and fingertip in the joint view (second paper, 2.1, Figs. 2 to 4).

The arm's axis is the way over the closed skeleton from the trunk to the farthest fingertip. Its
sharpest corner is the elbow, which is then shifted towards the rim, as anatomy has it; the wrist is
where the forearm ends being slim. The shoulder is where it is seen in the front view.

INPUTS: the joint view's skeleton and mask; the front view's landmarks.
OUTPUTS: joints of one arm, pixels, and its axis.
"""

from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter1d, map_coordinates
from scipy.sparse.csgraph import dijkstra

from jaxmocap.silhouette.modelling.arm_surface import ArmBones
from jaxmocap.silhouette.modelling.pictures.medial_axis import MedialAxis, path
from jaxmocap.silhouette.modelling.pictures.views import PhotographView
from jaxmocap.silhouette.modelling.readings import Reading
from jaxmocap.silhouette.modelling.separation import FrontLandmarks, trunk_run

# Deviation of the blur over an axis, pixels.
SMOOTH_PX = 4.0
# A corner is searched for with triangles whose sides are this share of the axis.
CORNER_REACH = 0.05
# A bent elbow turns the axis by at least so much, radians.
LEAST_BEND = 0.5
# The forearm's middle, as a share of the way from the middle of the trunk to the fingertip.
FOREARM_MIDDLE = 0.66
# Deviation of the blur over radii along the axis, pixels: single pixels make no place thin.
SMOOTH_RADII_PX = 3.0


class ArmPixels(NamedTuple):
    """One arm in the joint view: pixels (x, y)."""

    shoulder: np.ndarray  # (2,)
    elbow: np.ndarray  # (2,)
    corner: np.ndarray  # (2,) of the axis, where the elbow is before its shift
    wrist: np.ndarray  # (2,)
    tip: np.ndarray  # (2,) of the longest finger
    axis: np.ndarray  # (K, 2) from the trunk to the tip, 1 pixel apart


def arm_axis(
    axis: MedialAxis, start_xy: np.ndarray, pit_xy: np.ndarray, lowest: float
) -> np.ndarray:
    """(K, 2) the way from a place in the trunk to the farthest end beyond an arm pit's column.

    The arm lies farther from the start than its pit, and above the row ``lowest``.
    """
    side = np.sign(pit_xy[0] - start_xy[0])
    beyond = side * (axis.pixels_xy[:, 0] - pit_xy[0]) > 0
    beyond &= axis.pixels_xy[:, 1] < lowest
    if not beyond.any():
        raise ValueError("found no arm beyond the arm pit, expected arms held out and up")
    begin = int(np.argmin(np.sum((axis.pixels_xy - start_xy) ** 2, 1)))
    lengths_px = np.where(beyond, dijkstra(axis.edges, indices=begin), -1.0)
    # The way over closed gaps can be longest to a finger that is not: the longest reaches farthest.
    hand = lengths_px > FOREARM_MIDDLE * lengths_px.max()
    forearm = np.argmin(np.abs(lengths_px - FOREARM_MIDDLE * lengths_px.max()))
    reach_px = np.linalg.norm(axis.pixels_xy - axis.pixels_xy[forearm], axis=1)
    tip = axis.pixels_xy[np.argmax(np.where(hand, reach_px, -1.0))]
    way = evenly_spaced(axis.pixels_xy[path(axis, start_xy, tip)].astype(float))
    return evenly_spaced(gaussian_filter1d(way, SMOOTH_PX, axis=0, mode="nearest"))


def arm_joints(
    axis: np.ndarray, distance: np.ndarray, shoulder: np.ndarray, reading: Reading
) -> ArmPixels:
    """Joints of one arm by its axis (K, 2), distances (H, W) to the rim and shoulder (2,), pixels.

    Raises:
        ValueError: the arm is not bent, or no wrist is slimmer than the palm.
    """
    first = int(np.argmin(np.sum((axis - shoulder) ** 2, 1)))
    turned = turning_angles(axis, CORNER_REACH * len(axis))
    # Where hand and trunk begin, other corners may be.
    inner = slice(first + (len(axis) - first) // 6, first + 7 * (len(axis) - first) // 10)
    middle = inner.start + int(np.argmax(turned[inner]))
    if turned[middle] < LEAST_BEND:
        degrees = np.degrees(turned[middle])
        raise ValueError(f"found an arm bent by {degrees:.0f} degrees, expected a bent elbow")
    long = len(axis) - first
    middle += round(reading.elbow_beyond_corner * long)
    wrist = _wrist(axis, distance, middle, round(reading.wrist_beyond_thinnest * long))
    corner = axis[middle]
    elbow = corner + reading.towards_rim * _rim(corner, axis[first], axis[wrist], distance)
    return ArmPixels(shoulder, elbow, corner, axis[wrist], axis[-1], axis)


def _wrist(axis: np.ndarray, distance: np.ndarray, elbow: int, beyond: int) -> int:
    """Place on the axis so far beyond the forearm's thinnest slice, and before the palm."""
    radii = map_coordinates(distance, axis[:, ::-1].T, order=1)
    half = elbow + (len(axis) - elbow) // 2
    palm = half + int(np.argmax(radii[half:]))
    forearm = gaussian_filter1d(radii, SMOOTH_RADII_PX)[elbow : palm + 1]
    if forearm.min() > 0.9 * radii[palm]:
        raise ValueError("found no wrist slimmer than the palm, expected an open hand seen flat")
    return min(elbow + int(np.argmin(forearm)) + beyond, palm)


def _rim(corner: np.ndarray, near: np.ndarray, far: np.ndarray, distance: np.ndarray) -> np.ndarray:
    """(2,) from a corner to the rim, away from both bones."""
    towards = [(end - corner) / np.linalg.norm(end - corner) for end in (near, far)]
    away = -(towards[0] + towards[1]) / np.linalg.norm(towards[0] + towards[1])
    steps = np.arange(0.0, max(distance.shape), 0.5)
    line = corner + steps[:, None] * away
    inside = map_coordinates(distance, line[:, ::-1].T, order=1, mode="constant") > 0.5
    return steps[np.argmin(inside)] * away


def evenly_spaced(points: np.ndarray) -> np.ndarray:
    """(N, 2) points 1 apart along a path through (M, 2) points."""
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    way = np.append(0.0, np.cumsum(steps))
    kept = np.append(True, steps > 0)
    places = np.arange(0.0, way[-1])
    return np.stack([np.interp(places, way[kept], line[kept]) for line in points.T], 1)


def turning_angles(points: np.ndarray, reach: float) -> np.ndarray:
    """(N,) by how much a path with points 1 apart turns at each of them, radians; 0 at its ends.

    The arms of the angle reach from the point to those ``reach`` before and after: the largest
    triangle inscribed there.
    """
    k = max(1, int(reach))
    turned = np.zeros(len(points))
    if len(points) <= 2 * k:
        return turned
    before, after = points[k:-k] - points[: -2 * k], points[2 * k :] - points[k:-k]
    cross = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
    turned[k:-k] = np.abs(np.arctan2(cross, np.sum(before * after, 1)))
    return turned


# Deviation of the blur over the middles of an arm's rows.
SMOOTH_ROWS = 3.0


def lift_arms(
    front: PhotographView, landmarks: FrontLandmarks, bent: tuple[ArmBones, ...]
) -> tuple[ArmBones, ...]:
    """Left and right arm in the front view, in the plane through their shoulders."""
    return tuple(
        _lift_arm(front, pit, side, bones)
        for pit, side, bones in zip(landmarks.pits, (1, -1), bent, strict=True)
    )


def _lift_arm(front: PhotographView, pit: np.ndarray, side: int, bones: ArmBones) -> ArmBones:
    """Of an arm on the right (1) or left (-1) of the image."""
    middles, outer = [], float(pit[0])
    for row in range(int(pit[1]) + 1, len(front.mask)):
        columns = np.flatnonzero(front.mask[row])
        beyond = columns[side * (columns - outer) > 0]
        if len(beyond) == 0:
            break
        first, last = trunk_run(front.mask, row, float(beyond[np.argmin(side * beyond)]))
        middles.append(((first + last) / 2, row))
        # The gap beside the trunk widens downwards with the arm.
        outer = max(outer, first - 1) if side > 0 else min(outer, last + 1)
    if not middles:
        raise ValueError("found no arm beside the trunk, expected arms lifted off the trunk")
    way = gaussian_filter1d(np.array(middles), SMOOTH_ROWS, axis=0, mode="nearest")
    places = front.plane_points(way, bones.shoulder)
    ends, after = [bones.shoulder], 0
    for length in bones.lengths:
        far = np.linalg.norm(places[after:] - ends[-1], axis=1)
        after += int(np.argmin(np.abs(far - length)))
        towards = places[after] - ends[-1]
        ends.append(ends[-1] + length * towards / np.linalg.norm(towards))
    return ArmBones(*ends)
