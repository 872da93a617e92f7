"""2-D key points as evidence: each is a line of sight that a landmark of the person lies near.

Detectors mark joints where they look to be, centimetres from where they are, and now and then mark
a wrong place, or another limb's; so a line pulls the less the further off it is (Student's t).

INPUTS: pixels and confidences of landmarks. OUTPUTS: lines of sight; whitened residuals.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.model import Model
from jaxmocap.body.skeleton import LANDMARKS, landmark_rows
from jaxmocap.compilation.settings import settings, traced
from jaxmocap.evidence.terms import Measurements, PosedBody, Term
from jaxmocap.geometry.cameras import Camera, on_host, pixel_rays
from jaxmocap.solvers.robust import shortened


class SightLines(NamedTuple):
    """Where C cameras see the landmarks at one time."""

    origin: Array | np.ndarray  # (C, 3) the cameras' centres, world, metres
    # (C, L, 3) unit vectors to the ``LANDMARKS``, world; NaN where not detected.
    directions: Array | np.ndarray
    confidences: Array | np.ndarray  # (C, L) between 0 and 1; 0 where not detected


def lines_of_sight(
    camera: Camera, landmarks: Sequence[str], pixels_xy: np.ndarray, confidences: np.ndarray
) -> SightLines:
    """The lines (T, ...) through one camera's detections.

    Args:
        camera: that sees them.
        landmarks: names of P landmarks.
        pixels_xy: (T, P, 2); NaN where missing.
        confidences: (T, P).
    """
    count, columns = len(pixels_xy), landmark_rows(landmarks)
    origin = np.tile(on_host(camera).position_world, (count, 1))
    ways, sure = np.full((count, len(LANDMARKS), 3), np.nan), np.zeros((count, len(LANDMARKS)))
    ways[:, columns] = pixel_rays(on_host(camera), np.asarray(pixels_xy, float))
    is_detected = np.isfinite(ways[:, columns]).all(-1)
    sure[:, columns] = np.where(is_detected, confidences, 0.0)
    return SightLines(*(np.asarray(part, np.float32)[:, None] for part in (origin, ways, sure)))


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
    return shortened(jnp.where(is_detected, across * lines.confidences[..., None] / deviation, 0.0))


@settings
class KeyPoints(Term):
    """2-D key points; measured ``sight_lines`` of the cameras that come with them."""

    deviation: Array = traced(
        0.02, "of a point of full confidence about its landmark, metres at the person"
    )

    def residual(self, model: Model, body: PosedBody, measured: Measurements) -> Array:
        """(C, L, 3); none where no camera comes with key points."""
        if "sight_lines" not in measured:
            return jnp.zeros(0, body.landmarks.dtype)
        return line_residuals(body.landmarks, measured["sight_lines"], self.deviation)
