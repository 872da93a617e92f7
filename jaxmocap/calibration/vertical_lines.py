"""A camera's pitch and roll by what is vertical in a room: corners, doors, shelves, curtains.

Lines that are vertical in the world meet in one point of the image, their vanishing point, which is
where the direction of gravity points. Each line segment counts as vertical or as anything else (a
mixture of both), at every pitch and roll; the best of them, and how far others are as good, is the
estimate. Where an image has few such lines, it is what cameras usually are.

INPUTS: an image of the room, a lens. OUTPUTS: a CameraTilt.
"""

from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np

from jaxmocap.geometry.cameras import Camera, on_host, pixel_rays

# A line segment is as long at least as this share of the image's longer side; the longest count.
SHORTEST, MOST_SEGMENTS = 0.03, 500
# Of a line from the vertical: the world's lines, radians, and the ends of a segment, pixels.
LINE_DEVIATION, END_DEVIATION_PX = np.radians(0.5), 0.7
# How many of a room's segments are vertical, and how much each counts: those of one edge err alike.
VERTICAL_SHARE, WEIGHT = 0.4, 0.3
# Every pitch and roll up to here is tried, radians.
STEP, FARTHEST = np.radians(0.5), np.radians(45)
# No estimate is better than this, radians: walls lean, and lenses distort.
LEAST_DEVIATION = np.radians(2.0)
# A segment is the person's where its middle is so near to one of the person's points, as a share of
# their span, in so many of the frames.
NEAR, PERSONS_SHARE = 0.12, 0.3


class CameraTilt(NamedTuple):
    """How a camera is turned against gravity."""

    pitch: float  # downwards, radians
    roll: float  # of the image about its middle, clockwise where positive, radians
    deviations: np.ndarray  # (2,) standard deviations of both


# What cameras are, mostly.
USUAL_TILT = CameraTilt(0.05, 0.0, np.array([0.15, 0.2]))


def tilt_by_lines(grey: np.ndarray, lens: Camera, person_xy: np.ndarray) -> CameraTilt:
    """The pitch and roll that most of a room's vertical lines have.

    Args:
        grey: (H, W) uint8, the room without what moves.
        lens: the camera's; its place does not count.
        person_xy: (F, P, 2) pixels; where the person's joints are, so that limbs do not count. NaN
            where missing.

    Returns:
        The best tilt, and standard deviations about it.
    """
    ends_xy = _segments(grey)
    ends_xy = ends_xy[_persons_share(ends_xy.mean(1), person_xy) < PERSONS_SHARE]
    angles = np.arange(-FARTHEST, FARTHEST + STEP / 2, STEP)
    pitch, roll = np.meshgrid(angles, angles, indexing="ij")
    off = np.stack([pitch - USUAL_TILT.pitch, roll - USUAL_TILT.roll], -1) / USUAL_TILT.deviations
    log_share = -0.5 * np.sum(off**2, -1)
    if len(ends_xy):
        log_share += WEIGHT * _log_ratios(ends_xy, lens, pitch, roll).sum(-1)
    best = np.unravel_index(np.argmax(log_share), log_share.shape)
    share = np.exp(log_share - log_share[best])
    share /= share.sum()
    deviations = [
        np.sqrt(np.sum(share * (each - each[best]) ** 2) + LEAST_DEVIATION**2)
        for each in (pitch, roll)
    ]
    return CameraTilt(float(pitch[best]), float(roll[best]), np.array(deviations))


def _segments(grey: np.ndarray) -> np.ndarray:
    """Both ends (N, 2, 2) of an image's straight lines, pixels, the longest first."""
    found = cv2.createLineSegmentDetector().detect(grey)[0]
    ends_xy = np.zeros((0, 2, 2)) if found is None else np.reshape(found, (-1, 2, 2))
    lengths = np.linalg.norm(ends_xy[:, 1] - ends_xy[:, 0], axis=-1)
    longest = np.argsort(-lengths)[:MOST_SEGMENTS]
    return ends_xy[longest[lengths[longest] > SHORTEST * max(grey.shape)]].astype(float)


def _persons_share(places_xy: np.ndarray, person_xy: np.ndarray) -> np.ndarray:
    """(N,): in how many of the frames, as a share, somebody's joints are near to places (N, 2)."""
    count = np.zeros(len(places_xy))
    present = [each[np.isfinite(each).all(1)] for each in person_xy]
    for joints_xy in (each for each in present if len(each)):
        span = np.ptp(joints_xy, 0).max()
        distances = np.linalg.norm(places_xy[:, None] - joints_xy, axis=-1)
        count += distances.min(1) < NEAR * span
    return count / max(len(person_xy), 1)


def _log_ratios(
    ends_xy: np.ndarray, lens: Camera, pitch: np.ndarray, roll: np.ndarray
) -> np.ndarray:
    """(..., N): how much more probable each segment is where the vertical has this tilt."""
    level, c = replace(on_host(lens), T_cam_world=np.eye(4)), np.cos(pitch)
    rays = np.asarray(pixel_rays(level, ends_xy))
    normals = np.cross(rays[:, 0], rays[:, 1])
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    up_cam = np.stack([c * np.sin(roll), -c * np.cos(roll), -np.sin(pitch)], -1)
    lengths = np.linalg.norm(ends_xy[:, 1] - ends_xy[:, 0], axis=-1)
    deviations = np.hypot(LINE_DEVIATION, np.sqrt(2) * END_DEVIATION_PX / lengths)
    # Of any other segment the sine is anything from -1 to 1 alike.
    density = np.exp(-0.5 * (up_cam @ normals.T / deviations) ** 2)
    density /= np.sqrt(2 * np.pi) * deviations
    return np.log(1 - VERTICAL_SHARE + 2 * VERTICAL_SHARE * density)
