"""Ellipses of uncertainty in an image: where the body's landmarks may lie.

INPUTS: a Motion with its report, a camera. OUTPUTS: closed lines, pixels.

A landmark's covariance is projected by the derivative of its pixel (first order).
"""

from dataclasses import dataclass

import numpy as np
from jax import Array

from jaxmocap.body.motion import Motion, landmarks_over_time
from jaxmocap.body.skeleton import ELBOWS, LANDMARKS
from jaxmocap.compilation.programs import program
from jaxmocap.geometry.cameras import NEAREST_M, Camera, depth, project, projection_jacobian
from jaxmocap.outputs.scene import both_at

# Half axes, standard deviations: 86 of 100 points of a plane's normal distribution lie within.
SIGMAS = 2.0
# Points of a line.
POINTS = 33
# Besides the elbows' those whose longer half axis exceeds this share of the image's smaller side.
SMALLEST_SHARE = 0.06


@dataclass(frozen=True)
class Uncertainty:
    """The L landmarks over T samples."""

    times: np.ndarray  # (T,) seconds
    centres: np.ndarray  # (T, L, 3) world, metres
    # (T, L, 3) standard deviations along the world's axes, metres; NaN unknown.
    deviations: np.ndarray

    def part(self, rows: slice) -> "Uncertainty":
        """Some of the samples."""
        return Uncertainty(self.times[rows], self.centres[rows], self.deviations[rows])

    def at(self, time: float) -> tuple[np.ndarray, np.ndarray] | None:
        """Centres and deviations (L, 3) at a time, as ``BodyScene.at`` has them."""
        return both_at(self.times, time, self.centres, self.deviations)


def uncertainty_of(motion: Motion) -> Uncertainty | None:
    """The landmarks of a motion; None where it has no report."""
    if motion.report is None:
        return None
    centres = landmarks_over_time(motion.skeleton, motion.poses)
    return Uncertainty(
        np.asarray(motion.times, float), centres, np.asarray(motion.report.landmarks_std, float)
    )


def ellipses_in(camera: Camera, uncertainty: Uncertainty, time: float) -> dict[str, np.ndarray]:
    """The elbows' ellipses, and the large ones of other landmarks; none where no ± is stated.

    Returns:
        Landmark -> (POINTS, 2) of a closed line, pixels.
    """
    if (values := uncertainty.at(time)) is None:
        return {}
    loops, half_axes = landmark_ellipses(camera, *values)
    smallest = SMALLEST_SHARE * float(np.min(np.asarray(camera.size)))
    is_shown = np.isfinite(half_axes) & (half_axes > smallest)
    is_shown[list(ELBOWS)] = np.isfinite(half_axes[list(ELBOWS)])
    return {LANDMARKS[i]: loops[i] for i in np.flatnonzero(is_shown)}


def landmark_ellipses(
    camera: Camera, centres: np.ndarray, deviations: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Closed lines (N, POINTS, 2) and their longer half axes (N,), pixels; NaN where unknown.

    Args:
        camera: that takes the image.
        centres: (N, 3) world, metres.
        deviations: (N, 3) standard deviations along the world's axes, metres.
    """
    dtype = camera.T_cam_world.dtype
    at, J, depths = map(np.asarray, _project_points(camera, np.asarray(centres, dtype)))
    is_known = np.isfinite(centres).all(-1) & np.isfinite(deviations).all(-1)
    is_known &= depths > NEAREST_M
    spread = np.where(is_known[:, None, None], J * deviations[:, None, :], 0.0)
    variances, axes = np.linalg.eigh(spread @ np.swapaxes(spread, -1, -2))
    lengths = np.where(is_known[:, None], SIGMAS * np.sqrt(np.maximum(variances, 0.0)), np.nan)
    turn = np.linspace(0, 2 * np.pi, POINTS)
    around = (axes * lengths[:, None, :]) @ np.stack([np.cos(turn), np.sin(turn)])
    return at[:, None] + np.swapaxes(around, -1, -2), lengths[:, -1]


@program("quick")
def _project_points(camera: Camera, points_world: Array) -> tuple[Array, Array, Array]:
    """Pixels (N, 2), their derivatives (N, 2, 3) and depths (N,) of points (N, 3)."""
    J = projection_jacobian(camera, points_world)
    return project(camera, points_world), J, depth(camera, points_world)
