"""Where a calibrated camera stands to points it sees: both solutions where the points are flat.

INPUTS: points (metres, any frame), their pixels, Intrinsics.
OUTPUTS: CameraPoses, the best first.

Of a plane seen with little perspective there are two poses that explain the picture almost equally
well, mirror images of one another about the line of sight (Collins & Bartoli 2014, IPPE).
"""

from dataclasses import dataclass

import cv2
import numpy as np

from jaxmocap.calibration.board.opencv_lenses import pose_candidates, project_points
from jaxmocap.formats.cameras.calibration import Intrinsics

# Points are flat where their thickness is less than this part of their breadth.
FLAT_THICKNESS = 1e-3
# Two refined poses are one where they differ less than this, radians.
SAME_POSE_RAD = 1e-3


@dataclass(frozen=True)
class CameraPose:
    """From the points' frame to the camera's."""

    rvec: np.ndarray  # (3,) Rodrigues vector
    tvec: np.ndarray  # (3,) metres
    residuals_xy: np.ndarray  # (N, 2) reprojected minus detected, pixels

    @property
    def rms(self) -> float:
        """Root mean square length of the residuals, pixels."""
        return rms_length(self.residuals_xy)

    @property
    def matrix(self) -> np.ndarray:
        """(4, 4) T_cam_points."""
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = cv2.Rodrigues(self.rvec)[0], self.tvec
        return T


def rms_length(residuals_xy: np.ndarray) -> float:
    """Root mean square length of (N, 2) residuals, pixels, as OpenCV counts it."""
    return float(np.sqrt((residuals_xy**2).sum(-1).mean()))


def candidate_poses(
    points: np.ndarray, pixels_xy: np.ndarray, lens: Intrinsics
) -> list[CameraPose]:
    """The poses of a camera that sees (N, 3) points at (N, 2) pixels: one, or two for flat ones.

    Each is refined by Levenberg-Marquardt; a second that slides into the first is none. Empty where
    OpenCV finds none, which happens with senseless intrinsics.
    """
    method = (
        cv2.SOLVEPNP_IPPE if relative_thickness(points) < FLAT_THICKNESS else cv2.SOLVEPNP_SQPNP
    )
    try:
        poses = [
            CameraPose(
                rvec.ravel(), tvec.ravel(), project_points(points, rvec, tvec, lens)[0] - pixels_xy
            )
            for rvec, tvec in pose_candidates(points, pixels_xy, lens, method)
        ]
    except cv2.error:
        return []
    in_front = [
        pose
        for pose in poses
        if np.isfinite(pose.rms) and (points @ pose.matrix[2, :3] + pose.tvec[2] > 0).all()
    ]
    in_front.sort(key=lambda pose: pose.rms)
    return [pose for i, pose in enumerate(in_front) if all(_differ(pose, q) for q in in_front[:i])]


def relative_thickness(points: np.ndarray) -> float:
    """Smallest over largest extent of (N, 3) points: 0 for a plane."""
    extents = np.linalg.svd(points - points.mean(0), compute_uv=False)
    return float(extents[2] / extents[0])


def tilt_degrees(pose: CameraPose) -> float:
    """Angle between a board's normal and the camera's axis, degrees, 0 to 90."""
    return float(np.degrees(np.arccos(np.clip(abs(pose.matrix[2, 2]), 0, 1))))


def _differ(a: CameraPose, b: CameraPose) -> bool:
    rotation, _ = cv2.Rodrigues(a.matrix[:3, :3] @ b.matrix[:3, :3].T)
    return float(np.linalg.norm(rotation)) > SAME_POSE_RAD
