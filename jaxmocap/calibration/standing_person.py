"""A camera's height, pitch and roll by a person who stands or walks before it.

Hips, shoulders and ankles of somebody upright are at heights above the floor that follow from the
stature; the image has them at rows that depend on the camera's height and pitch, and on how far
away the person is, frame by frame. They are above each other, so that their line is the image's
vertical, but for the camera's roll. What the room's vertical lines have found counts beside them.

INPUTS: pixels of landmarks, a lens, a skeleton, the tilt by lines. OUTPUTS: a StandingCamera.
"""

from dataclasses import replace
from typing import NamedTuple

import jax
import numpy as np
from scipy.optimize import least_squares

from jaxmocap.body.motion import landmarks_over_time
from jaxmocap.body.pose import relaxed_pose
from jaxmocap.body.skeleton import Skeleton, landmark_rows
from jaxmocap.calibration.vertical_lines import USUAL_TILT, CameraTilt
from jaxmocap.compilation.arrays import on_device
from jaxmocap.geometry.cameras import Camera, on_host, pixel_rays

# Pairs of landmarks whose middles are looked at. Knees bend.
PAIRS = ("ankle", "hip", "shoulder")
# Height of the ankles of feet on the floor, metres.
ANKLE_M = 0.07
# Of a middle about where somebody upright has it, up and sideways, metres at the person.
DEVIATION_M, ASIDE_DEVIATION_M = 0.03, 0.1
# How high cameras usually are, metres, and the deviation.
USUAL_HEIGHT_M, HEIGHT_DEVIATION_M = 1.3, 0.4
# Least and most height, pitch and roll.
LOWEST, HIGHEST = [0.05, -1.2, -0.8], [6.0, 1.2, 0.8]
# Frames that are looked at, and how few will not do.
MOST_FRAMES, FEWEST_FRAMES = 60, 3
# Somebody is upright whose hip and ankle are so far apart, as a share of thigh and shank, and whose
# trunk is in line with the legs within so much, radians.
STRAIGHT, IN_LINE = 0.97, np.radians(20)
PARTS = {f"{part}_{side}" for part in (*PAIRS, "knee") for side in "lr"}
# How far away people are, metres.
NEAREST_M, FARTHEST_M = 0.8, 30.0


class StandingCamera(NamedTuple):
    """Where a camera is, above the floor."""

    height: float  # metres
    pitch: float  # downwards, radians
    roll: float  # of the image about its middle, clockwise where positive, radians
    deviations: np.ndarray  # (3,) standard deviations of these

    def stand_camera(self, camera: Camera) -> Camera:
        """The same lens above the world's origin, looking along x; the floor is z = 0."""
        c, s = np.cos(self.pitch), np.sin(self.pitch)
        R_cam_world = np.array([[0.0, -1.0, 0.0], [-s, 0.0, -c], [c, 0.0, -s]])
        R_cam_world[:2] = _turn_places(R_cam_world[:2].T, self.roll).T
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = R_cam_world, -R_cam_world @ [0.0, 0.0, self.height]
        return replace(camera, T_cam_world=on_device(T))


def camera_by_person(
    camera: Camera,
    names: tuple[str, ...],
    pixels_xy: np.ndarray,
    confidences: np.ndarray,
    skeleton: Skeleton,
    joints_cam: np.ndarray | None = None,
    tilt: CameraTilt = USUAL_TILT,
) -> StandingCamera | None:
    """The height, pitch and roll that suit somebody who mostly stands upright.

    Args:
        camera: whose lens counts.
        names: of P landmarks.
        pixels_xy: (F, P, 2).
        confidences: (F, P); 0 where missing.
        skeleton: of the person.
        joints_cam: (F, P, 3) where the detector has the landmarks, camera's axes, metres: frames
            whose legs are bent, or whose trunk is, are left out.
        tilt: of the camera, as far as it is found by anything else.

    Returns:
        The camera; None where hardly any frame shows hips, shoulders and ankles of somebody
        upright.
    """
    slopes = _slopes(camera, names, pixels_xy, confidences)
    if joints_cam is not None and set(names) >= PARTS:
        upright = _are_upright(names, joints_cam)
        slopes = np.where(upright[:, None, None], slopes, np.nan)
    whole = np.flatnonzero(np.isfinite(slopes).all((1, 2)))
    if len(whole) < FEWEST_FRAMES:
        return None
    slopes = slopes[whole[np.linspace(0, len(whole) - 1, min(len(whole), MOST_FRAMES)).astype(int)]]
    # Of somebody at ease, above the floor.
    at_ease = jax.tree.map(lambda part: part[None], relaxed_pose(skeleton))
    points = np.asarray(landmarks_over_time(skeleton, at_ease))[0]
    pairs = [landmark_rows((f"{pair}_l", f"{pair}_r")) for pair in PAIRS]
    heights = np.array([points[pair, 2].mean() for pair in pairs])
    heights += ANKLE_M - heights[0]
    spans = np.linalg.norm(slopes[:, 0] - slopes[:, -1], axis=-1)
    reach = (heights[-1] - heights[0]) / np.maximum(spans, 1e-2)
    usual = np.array([USUAL_HEIGHT_M, tilt.pitch, tilt.roll])
    usual_deviations = np.array([HEIGHT_DEVIATION_M, *tilt.deviations])
    start = np.concatenate([usual, np.clip(reach, 1.0, FARTHEST_M - 1)])

    def residuals(x: np.ndarray) -> np.ndarray:
        height, pitch, away = x[0], x[1], x[3:, None]
        below, level = height - heights, _turn_places(slopes, -x[2])
        depth = away * np.cos(pitch) + below * np.sin(pitch)
        rows = below * np.cos(pitch) - away * np.sin(pitch)
        off = (rows - level[..., 1] * depth) / DEVIATION_M
        aside = level[..., 0] * depth
        aside = (aside - aside.mean(1, keepdims=True)) / ASIDE_DEVIATION_M
        # Frames err alike: somebody who leans goes on doing so.
        errors = np.concatenate([off.ravel(), aside.ravel()]) / np.sqrt(len(slopes))
        return np.concatenate([errors, (x[:3] - usual) / usual_deviations])

    low = np.concatenate([LOWEST, np.full(len(slopes), NEAREST_M)])
    high = np.concatenate([HIGHEST, np.full(len(slopes), FARTHEST_M)])
    solved = least_squares(residuals, start, bounds=(low, high), loss="soft_l1")
    covariance = np.linalg.pinv(solved.jac.T @ solved.jac)
    height, pitch, roll = (float(each) for each in solved.x[:3])
    return StandingCamera(height, pitch, roll, np.sqrt(np.diag(covariance)[:3]))


def _turn_places(xy: np.ndarray, angle: float) -> np.ndarray:
    """Places (..., 2) of an image turned about its middle, clockwise (y is down)."""
    c, s = np.cos(angle), np.sin(angle)
    return xy @ np.array([[c, s], [-s, c]])


def _are_upright(names: tuple[str, ...], joints_cam: np.ndarray) -> np.ndarray:
    """(F,) bool: whether a leg is straight, and the trunk in line with the legs."""
    at = {name: joints_cam[:, names.index(name)] for name in PARTS}
    straight, trunk, legs = np.zeros(len(joints_cam)), 0.0, 0.0
    for side in "lr":
        shoulder, hip, knee, ankle = (
            at[f"{part}_{side}"] for part in ("shoulder", "hip", "knee", "ankle")
        )
        along = np.linalg.norm(hip - knee, axis=-1) + np.linalg.norm(knee - ankle, axis=-1)
        straight = np.fmax(straight, np.linalg.norm(hip - ankle, axis=-1) / along)
        trunk, legs = trunk + shoulder - hip, legs + hip - ankle
    lengths = np.linalg.norm(trunk, axis=-1) * np.linalg.norm(legs, axis=-1)
    return (straight > STRAIGHT) & (np.sum(trunk * legs, -1) > np.cos(IN_LINE) * lengths)


def _slopes(
    camera: Camera, names: tuple[str, ...], pixels_xy: np.ndarray, confidences: np.ndarray
) -> np.ndarray:
    """(F, K, 2) tangents, right and down, at which the pairs' middles are; NaN where not."""
    columns, unturned = [], replace(on_host(camera), T_cam_world=np.eye(4))
    for pair in PAIRS:
        sides = [f"{pair}_l", f"{pair}_r"]
        if not set(sides) <= set(names):
            return np.full((len(pixels_xy), len(PAIRS), 2), np.nan)
        rows = [names.index(side) for side in sides]
        middle = np.where(confidences[:, rows].min(1) > 0, pixels_xy[:, rows].mean(1).T, np.nan).T
        rays = np.asarray(pixel_rays(unturned, middle))
        columns.append(rays[:, :2] / rays[:, 2:])
    return np.stack(columns, 1)
