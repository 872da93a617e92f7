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

from jaxmocap.modelling.pictures.corners import evenly_spaced, turning_angles
from jaxmocap.modelling.pictures.medial_axis import MedialAxis, path
from jaxmocap.modelling.readings import Reading

# Deviation of the blur over an axis, pixels.
SMOOTH_PX = 4.0
# A corner is searched for with triangles whose sides are this share of the axis.
CORNER_REACH = 0.05
# A bent elbow turns the axis by at least so much, radians.
LEAST_BEND = 0.5
# Deviation of the blur over radii along the axis, pixels: single pixels make no place thin.
SMOOTH_RADII_PX = 3.0


class ArmPixels(NamedTuple):
    """One arm in the joint view: pixels (x, y).

    Attributes:
        shoulder: (2,).
        elbow: (2,).
        corner: (2,) of the axis, where the elbow is before its shift.
        wrist: (2,).
        tip: (2,) of the longest finger.
        axis: (K, 2) from the trunk to the tip, 1 pixel apart.
    """

    shoulder: np.ndarray
    elbow: np.ndarray
    corner: np.ndarray
    wrist: np.ndarray
    tip: np.ndarray
    axis: np.ndarray


def arm_axis(
    axis: MedialAxis, start_xy: np.ndarray, pit_xy: np.ndarray, lowest: float
) -> np.ndarray:
    """(K, 2) the way from a place in the trunk to the farthest end beyond an arm pit's column.

    Args:
        axis: of the whole silhouette.
        start_xy: where to begin, in the trunk's middle.
        pit_xy: of the arm, which lies farther from the start than this, and above ``lowest``.
        lowest: row that arms do not hang below.
    """
    side = np.sign(pit_xy[0] - start_xy[0])
    beyond = side * (axis.pixels_xy[:, 0] - pit_xy[0]) > 0
    beyond &= axis.pixels_xy[:, 1] < lowest
    if not beyond.any():
        raise ValueError("found no arm beyond the arm pit, expected arms held out and up")
    begin = int(np.argmin(np.sum((axis.pixels_xy - start_xy) ** 2, 1)))
    ways = dijkstra(axis.edges, indices=begin)
    tip = axis.pixels_xy[np.argmax(np.where(beyond, ways, -1.0))]
    way = evenly_spaced(axis.pixels_xy[path(axis, start_xy, tip)].astype(float))
    return evenly_spaced(gaussian_filter1d(way, SMOOTH_PX, axis=0, mode="nearest"))


def arm_joints(
    axis: np.ndarray, distance: np.ndarray, shoulder: np.ndarray, reading: Reading
) -> ArmPixels:
    """Joints of one arm.

    Args:
        axis: (K, 2) of ``arm_axis``.
        distance: (H, W) pixels to the rim.
        shoulder: (2,) its pixel.
        reading: where joints lie on an axis.

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
