"""2-D key points as evidence: each is a line of sight that a landmark of the person lies near.

Detectors mark joints where they look to be, centimetres from where they are, and now and then mark
a wrong place, or another limb's; so a line pulls the less the further off it is (Student's t). Some
also estimate how far off the joints are (MediaPipe), a decimetre from where they are.

INPUTS: pixels and confidences of landmarks; a detector's joints. OUTPUTS: lines of sight; whitened
residuals.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.kinematics import landmarks as landmark_positions
from jaxmocap.body.model import Model
from jaxmocap.body.pose import relaxed_pose
from jaxmocap.body.skeleton import LANDMARKS, Skeleton, landmark_rows
from jaxmocap.compilation.settings import settings, traced
from jaxmocap.evidence.terms import Measurements, PosedBody, Term
from jaxmocap.geometry.cameras import Camera, on_host, pixel_rays, project
from jaxmocap.geometry.rotations import HIGHEST
from jaxmocap.solvers.robust import shorten_residuals

# A ray that is projected farther from its pixel is none.
NO_RAY_PX = 5.0
HIPS = landmark_rows(("hip_l", "hip_r"))
# By their lengths a detector's person is as large as ours.
LIMBS = tuple(
    (f"{near}_{side}", f"{far}_{side}")
    for near, far in (("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"), ("knee", "ankle"))
    for side in "lr"
)


class SightLines(NamedTuple):
    """Where C cameras see the landmarks at one time."""

    origin: Array | np.ndarray  # (C, 3) the cameras' centres, world, metres
    # (C, L, 3) unit vectors to the ``LANDMARKS``, world; NaN where not detected.
    directions: Array | np.ndarray
    confidences: Array | np.ndarray  # (C, L) between 0 and 1; 0 where not detected
    # (C, L) metres by which a landmark lies farther off than the hips' middle, as the detector has
    # it; NaN where it does not say.
    depths: Array | np.ndarray

    @classmethod
    def none(cls, cameras: int) -> "SightLines":
        """Of so many cameras that see nothing."""
        flat = np.zeros((cameras, len(LANDMARKS)), np.float32)
        unknown = np.full((cameras, len(LANDMARKS), 3), np.nan, np.float32)
        return cls(np.zeros((cameras, 3), np.float32), unknown, flat, np.full_like(flat, np.nan))


def lines_of_sight(
    camera: Camera,
    landmarks: Sequence[str],
    pixels_xy: np.ndarray,
    confidences: np.ndarray,
    depths: np.ndarray | None = None,
) -> SightLines:
    """The lines (T, ...) through one camera's detections.

    Args:
        camera: that sees them.
        landmarks: names of P landmarks.
        pixels_xy: (T, P, 2); NaN where missing.
        confidences: (T, P).
        depths: (T, P) beyond the hips' middle, metres; NaN where missing, None for none.
    """
    count, columns = len(pixels_xy), landmark_rows(landmarks)
    origin = np.tile(on_host(camera).position_world, (count, 1))
    ways, sure = np.full((count, len(LANDMARKS), 3), np.nan), np.zeros((count, len(LANDMARKS)))
    eye, pixels = on_host(camera), np.asarray(pixels_xy, float)
    # Where a lens's polynomial folds there is no ray, and its iteration ends anywhere.
    with np.errstate(all="ignore"):
        rays = pixel_rays(eye, pixels)
        again = project(eye, eye.position_world + rays)
        is_detected = np.linalg.norm(again - pixels, axis=-1) < NO_RAY_PX
    ways[:, columns] = np.where(is_detected[..., None], rays, np.nan)
    sure[:, columns] = np.where(is_detected, confidences, 0.0)
    beyond = np.full(sure.shape, np.nan)
    if depths is not None:
        beyond[:, columns] = np.where(is_detected, depths, np.nan)
    parts = (origin, ways, sure, beyond)
    return SightLines(*(np.asarray(part, np.float32)[:, None] for part in parts))


def estimated_depths(
    skeleton: Skeleton, landmarks: Sequence[str], joints_cam: np.ndarray
) -> np.ndarray:
    """How much farther off than the hips' middle (T, P) landmarks are, as a detector has them.

    Detectors know nobody's size: theirs is changed so that the limbs are as long as the person's.

    Args:
        skeleton: of the person.
        landmarks: names of P landmarks.
        joints_cam: (T, P, 3) metres about the hips' middle, in the camera's axes; NaN where
            missing.
    """
    rest = np.asarray(landmark_positions(skeleton, relaxed_pose(skeleton)))
    own, theirs = 0.0, 0.0
    for ends in LIMBS:
        if set(ends) <= set(landmarks):
            near, far = (landmarks.index(end) for end in ends)
            spans = np.linalg.norm(joints_cam[:, far] - joints_cam[:, near], axis=-1)
            if np.isfinite(spans).any():
                near, far = landmark_rows(ends)
                own += float(np.linalg.norm(rest[far] - rest[near]))
                theirs += float(np.nanmedian(spans))
    return joints_cam[..., 2] * (own / theirs if theirs else 1.0)


def line_residuals(points_world: Array, lines: SightLines, deviation: Array) -> Array:
    """How far landmarks (..., L, 3) lie off their lines: (..., C, L, 3), long tails included.

    Their squares add up to a logarithm that Student's t has, instead of growing without end.

    Args:
        points_world: metres.
        lines: of C cameras.
        deviation: of a point of full confidence, metres at the person.
    """
    is_detected = (
        jnp.isfinite(lines.directions).all(-1, keepdims=True) & (lines.confidences > 0)[..., None]
    )
    way = jnp.where(is_detected, lines.directions, 0.0)
    off = points_world[..., None, :, :] - lines.origin[..., None, :]
    across = off - jnp.sum(off * way, -1, keepdims=True) * way
    return shorten_residuals(
        across * jnp.where(is_detected, lines.confidences[..., None], 0.0) / deviation
    )


@settings
class KeyPoints(Term):
    """2-D key points; measured ``sight_lines`` of the cameras that come with them."""

    deviation: Array = traced(
        0.02, "of a point of full confidence about its landmark, metres at the person"
    )
    redundancy: Array = traced(
        40.0, "of frames, 30 a second: so many have the same error; for the deviations only"
    )

    def residual(self, model: Model, body: PosedBody, measured: Measurements) -> Array:
        """(C, L, 3); none where no camera comes with key points."""
        if measured.sight_lines is None:
            return jnp.zeros(0, body.landmarks.dtype)
        return line_residuals(body.landmarks, measured.sight_lines, self.deviation)


@settings
class EstimatedDepths(Term):
    """How far off joints are as their detector has it; measured ``sight_lines`` with depths."""

    deviation: Array = traced(0.13, "of a landmark's depth beyond the hips', metres")

    def residual(self, model: Model, body: PosedBody, measured: Measurements) -> Array:
        """(C, L); none where no camera comes with key points."""
        if measured.sight_lines is None:
            return jnp.zeros(0, body.landmarks.dtype)
        lines = measured.sight_lines
        hips = jnp.mean(body.landmarks[HIPS], 0)
        way = hips - lines.origin
        way = way / jnp.linalg.norm(way, axis=-1, keepdims=True)
        beyond = jnp.einsum("lk,ck->cl", body.landmarks - hips, way, precision=HIGHEST)
        is_there = jnp.isfinite(lines.depths) & (lines.confidences > 0)
        off = beyond - jnp.where(is_there, lines.depths, 0.0)
        return shorten_residuals(jnp.where(is_there, off / self.deviation, 0.0)[..., None])[..., 0]
