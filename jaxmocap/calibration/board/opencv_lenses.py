"""What OpenCV does with either kind of lens: project, find poses, calibrate.

Of a plane in little perspective there are two poses that explain the picture almost equally well,
mirror images of one another about the camera's ray to it (Collins & Bartoli 2014, IPPE).

INPUTS: points (metres, any frame), pixels, Intrinsics. OUTPUTS: pixels, derivatives; CameraPoses,
the best first; a lens.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.optimize import least_squares

from jaxmocap.formats.cameras.calibration import Intrinsics
from jaxmocap.geometry.lenses import BROWN_CONRADY, FISHEYE, LENSES

# An array of each view.
Views = Sequence[np.ndarray]
# Coefficients of an ordinary lens that can be asked for, and what OpenCV then holds at zero.
ORDINARY = {
    0: cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST,
    1: cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST,
    2: cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST,
    4: cv2.CALIB_FIX_K3,
    5: 0,
}
# An ordinary lens's coefficients beyond these are not calibrated.
_CALIBRATED = 5
_FISHEYE_STEPS = 200
_FISHEYE_PRECISION = 1e-10
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


@dataclass(frozen=True)
class LensKind:
    """The lens that a calibration looks for."""

    coefficients: int = 4  # how many of its distortion; the others are 0
    fisheye: bool = False

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of all that may be found."""
        names = LENSES[FISHEYE if self.fisheye else BROWN_CONRADY].coefficients[:_CALIBRATED]
        return ("fx", "fy", "cx", "cy", *names)


@dataclass(frozen=True)
class LensFit:
    """One calibration."""

    lens: Intrinsics
    rms: float  # reprojection error, pixels
    values: np.ndarray  # in the order of the kind's parameters, pixels and plain numbers
    std: np.ndarray  # standard deviations by least squares; 0 of what was held at zero


def project_points(
    points: np.ndarray, rvec: np.ndarray, tvec: np.ndarray, lens: Intrinsics
) -> tuple[np.ndarray, np.ndarray]:
    """Pixels (N, 2) of points (N, 3) that a pose takes to the camera's frame, and derivatives.

    These, (2 N, 6), are by the Rodrigues vector and the translation.
    """
    if not lens.fisheye:
        pixels, J = cv2.projectPoints(points, rvec, tvec, lens.matrix, lens.distortions)
        return pixels.reshape(-1, 2), J[:, :6]
    pixels, J = _fisheye_projected(points, rvec, tvec, lens)
    return pixels, J[:, 8:14]


def _fisheye_projected(
    points: np.ndarray, rvec: np.ndarray, tvec: np.ndarray, lens: Intrinsics
) -> tuple[np.ndarray, np.ndarray]:
    """Pixels (N, 2), and (2 N, 15) by fx fy cx cy k1 to k4, the pose and the skew."""
    r, t = (np.array(part, float).reshape(3, 1) for part in (rvec, tvec))
    points = np.array(points, float).reshape(-1, 1, 3)
    pixels, J = cv2.fisheye.projectPoints(points, r, t, lens.matrix, _four(lens))
    return pixels.reshape(-1, 2), J


def _four(lens: Intrinsics) -> np.ndarray:
    return np.concatenate([lens.distortions, np.zeros(4)])[:4]


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
            for rvec, tvec in _poses(points, pixels_xy, lens, method)
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


def _poses(
    points: np.ndarray, pixels_xy: np.ndarray, lens: Intrinsics, method: int
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Rodrigues vectors and translations of a camera that sees points (N, 3) at pixels (N, 2).

    They are refined; ``method`` is OpenCV's. cv2.error where it finds none.
    """
    points, pixels_xy = np.ascontiguousarray(points), np.ascontiguousarray(pixels_xy)
    K, d = lens.matrix, lens.distortions
    if not lens.fisheye:
        _, rvecs, tvecs, _ = cv2.solvePnPGeneric(points, pixels_xy, K, d, flags=method)
        return [
            cv2.solvePnPRefineLM(points, pixels_xy, K, d, r.copy(), t.copy())
            for r, t in zip(rvecs, tvecs, strict=True)
        ]
    plane = cv2.fisheye.undistortPoints(pixels_xy[:, None].astype(float), K, _four(lens))
    _, rvecs, tvecs, _ = cv2.solvePnPGeneric(points, plane, np.eye(3), np.zeros(4), flags=method)
    return [
        _refine_pose(points, pixels_xy, lens, np.concatenate([r.ravel(), t.ravel()]))
        for r, t in zip(rvecs, tvecs, strict=True)
        if np.isfinite(r).all() and np.isfinite(t).all()
    ]


def _refine_pose(
    points: np.ndarray, pixels_xy: np.ndarray, lens: Intrinsics, pose: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """A pose (6,) by Levenberg-Marquardt on the pixels."""

    def off(pose: np.ndarray) -> np.ndarray:
        return (project_points(points, pose[:3], pose[3:], lens)[0] - pixels_xy).ravel()

    def slopes(pose: np.ndarray) -> np.ndarray:
        return project_points(points, pose[:3], pose[3:], lens)[1]

    solution = least_squares(off, pose, jac=slopes, method="lm").x  # type: ignore[arg-type]
    return solution[:3], solution[3:]


def fit_lens(points: Views, pixels: Views, size: tuple[int, int], kind: LensKind) -> LensFit:
    """Calibrate from V views of a flat board: points (N, 3), metres, and pixels (N, 2) of each.

    The pictures' ``size`` is their width and height, pixels.

    Raises:
        ArithmeticError: OpenCV finds nothing, or nothing finite.
    """
    fit = _fit_fisheye if kind.fisheye else _fit_ordinary
    try:
        lens = fit(points, pixels, size, kind)
    except (cv2.error, np.linalg.LinAlgError) as problem:
        why = problem.err if isinstance(problem, cv2.error) else problem
        raise ArithmeticError(f"OpenCV finds no calibration ({why})") from None
    if not np.isfinite([*lens.values, lens.rms]).all():
        raise ArithmeticError("OpenCV finds no finite calibration")
    return lens


def _fit_ordinary(points: Views, pixels: Views, size: tuple[int, int], kind: LensKind) -> LensFit:
    on_board, in_image = ([part.astype(np.float32) for part in views] for views in (points, pixels))
    flags = ORDINARY[kind.coefficients]
    error, K, d, _, _, std, _, _ = cv2.calibrateCameraExtended(
        on_board, in_image, size, np.eye(3), np.zeros(5), flags=flags
    )
    values = np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2], *d.ravel()[:5]])
    distortions = d.ravel()[: max(kind.coefficients, 4)].astype(float)
    lens = Intrinsics(np.array(size, float), K, distortions)
    return LensFit(lens, float(error), values, std.ravel()[:9])


def _fit_fisheye(points: Views, pixels: Views, size: tuple[int, int], kind: LensKind) -> LensFit:
    """OpenCV gives no deviations: they are of its own derivatives, by least squares."""
    held = [f"CALIB_FIX_K{i}" for i in range(kind.coefficients + 1, 5)]
    names = ("CALIB_RECOMPUTE_EXTRINSIC", "CALIB_FIX_SKEW", *held)
    # OpenCV 4 has a fisheye's flags beside its functions, OpenCV 5 among all others.
    flags = sum(getattr(cv2.fisheye, name, None) or getattr(cv2, name) for name in names)
    stop = cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, _FISHEYE_STEPS, _FISHEYE_PRECISION
    _, K, d, rvecs, tvecs = cv2.fisheye.calibrate(
        [part[None].astype(float) for part in points],
        [part[None].astype(float) for part in pixels],
        size, np.eye(3), np.zeros(4), flags=flags, criteria=stop,
    )  # fmt: skip
    lens = Intrinsics(np.array(size, float), K, d.ravel(), fisheye=True)
    values = np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2], *d.ravel()])
    if not np.isfinite(values).all():
        return LensFit(lens, np.inf, values, np.zeros(8))
    free = 4 + kind.coefficients
    off, rows = [], []
    for view, (observed, r, t) in enumerate(zip(pixels, rvecs, tvecs, strict=True)):
        shown, J = _fisheye_projected(points[view], r, t, lens)
        row = np.zeros((len(J), free + 6 * len(points)))
        row[:, :free] = J[:, :free]
        row[:, free + 6 * view : free + 6 * view + 6] = J[:, 8:14]
        off.append((shown - observed).ravel())
        rows.append(row)
    residuals, A = np.concatenate(off), np.concatenate(rows)
    variance = residuals @ residuals / max(1, len(residuals) - A.shape[1])
    std = np.zeros(8)
    std[:free] = np.sqrt(variance * np.diag(np.linalg.pinv(A.T @ A))[:free])
    return LensFit(lens, float(np.sqrt(2 * np.mean(residuals**2))), values, std)
