"""What a term of evidence is, and how the residuals of several are found together.

A term is one file: a settings record with ``residual``. Solvers and smoothers take a tuple of terms
and know none by name. A new one needs its file, and one line in the settings of whoever uses it.

INPUTS: terms, a Model, a pose, what was measured. OUTPUTS: whitened residuals.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.kinematics import (
    Frames,
    Sites,
    joined_sites,
    landmark_sites,
    points_on,
    site_positions,
)
from jaxmocap.body.model import Model
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import LANDMARKS, Skeleton
from jaxmocap.geometry.rotations import HIGHEST, quaternion_to_matrix


class Measurements(NamedTuple):
    """What events bring: of one moment, or with leading axes of many; None where nothing does.

    Attributes:
        markers: (M, 3) world, metres; NaN where missing.
        upright: (2,) horizontal part of the pelvis' z axis, of the markers' pose.
        facing: (3,) unit and horizontal, where that pelvis faces.
        ankles: (2, 3) of the markers' pose, world, metres.
        elbows: (2, 3) where images have them, world, metres; NaN where none does.
        sight_lines: ``SightLines`` of the cameras with key points.
        usual: ``Usual``, where landmarks usually are.
        edges: ``WeightedEdges`` about both arms.
        goals: ``Goals`` of inverse kinematics.
        last: ``LastPose``.
        centre: a ``Pose`` to stay near.
        estimate: ``EstimatedPose``.
        own: name -> arrays, what terms of one's own ask for.
    """

    markers: Any = None
    upright: Any = None
    facing: Any = None
    ankles: Any = None
    elbows: Any = None
    sight_lines: Any = None
    usual: Any = None
    edges: Any = None
    goals: Any = None
    last: Any = None
    centre: Any = None
    estimate: Any = None
    own: Mapping[str, Any] | None = None


class PosedBody(NamedTuple):
    """The body as a pose puts it: all that terms look at.

    Attributes:
        markers: (M, 3) points on bones where markers sit, world, metres.
        landmarks: (L, 3) world, metres.
        R_world_pelvis: (3, 3).
        centre_of_gravity: (3,) world, metres.
        pose: that puts it there.
        frames: of the bones, for Jacobians; None where nobody has them yet.
    """

    markers: Array
    landmarks: Array
    R_world_pelvis: Array
    centre_of_gravity: Array
    pose: Pose
    frames: Frames | None = None


class Term(ABC):
    """A kind of evidence or of prior knowledge; subclasses are settings (``compilation.settings``).

    Attributes:
        errors_last: whether what is wrong with it stays wrong for a while (somebody who stands
            unusually goes on doing so), so that many frames tell no more than few.
        needs: fields of ``Measurements`` without which it has no residual.
    """

    errors_last: ClassVar[bool] = False
    needs: ClassVar[tuple[str, ...]] = ()

    @abstractmethod
    def residual(self, model: Model, body: PosedBody, measured: Measurements) -> Array:
        """Whitened residuals (...): of unit variance where model and measurements are right.

        Args:
            model: of the person, the markers and the cameras.
            body: as the pose puts it.
            measured: of this moment.
        """

    def jacobian(self, model: Model, body: PosedBody, measured: Measurements) -> Array | None:
        """Derivatives (..., 6 + D) of the residual by the tangent vector of ``retract``.

        None, as here, has them found by automatic differentiation. It is for what is solved often
        and has a short formula.
        """
        return None

    def curvature(
        self, model: Model, body: PosedBody, measured: Measurements, weights: Array
    ) -> Array | None:
        """Second derivatives (6 + D, 6 + D) of the residual times ``weights``, of its shape.

        None, as here, has them found by automatic differentiation.
        """
        return None

    @property
    def metres_per_deviation(self) -> Array | None:
        """The length that a residual of 1 stands for; None where residuals are no lengths."""
        return None


def residuals(terms: Sequence[Term], model: Model, pose: Pose, measured: Measurements) -> Array:
    """All whitened residuals (R,) of a pose."""
    return joined_residuals(terms, model, posed_body(model, pose), measured)


def posed_body(model: Model, pose: Pose, frames: Frames | None = None) -> PosedBody:
    """The body as a pose puts it; its derivative by the pose is the geometric Jacobian.

    Args:
        model: of the person, the markers and the cameras.
        pose: of the person.
        frames: of its bones, where somebody has them and asks for no derivative by the pose.
    """
    skeleton, markers = model.skeleton, len(model.markers.bone_indices)
    points = points_of(skeleton, pose, frames, body_sites(model))
    on_markers, landmarks, in_bones = jnp.split(points, [markers, markers + len(LANDMARKS)])
    shares = skeleton.masses / jnp.sum(skeleton.masses)
    gravity = jnp.matmul(shares, in_bones, precision=HIGHEST)
    R_world_pelvis = quaternion_to_matrix(pose.quaternion)
    return PosedBody(on_markers, landmarks, R_world_pelvis, gravity, pose, frames)


def points_of(skeleton: Skeleton, pose: Pose, frames: Frames | None, sites: Sites) -> Array:
    """Points (M, 3) on bones, world, metres: by the bones' frames, where somebody has them."""
    if frames is None:
        return points_on(skeleton, pose, sites)
    return site_positions(skeleton, frames, sites)


def body_sites(model: Model) -> Sites:
    """Points that terms see: markers, landmarks, the bones' centres of gravity."""
    skeleton = model.skeleton
    every = np.arange(len(skeleton.tree.bones))
    centres = Sites(every, skeleton.centres, jnp.zeros((len(every), 3), skeleton.centres.dtype))
    return joined_sites(joined_sites(model.markers, landmark_sites(skeleton)), centres)


def joined_residuals(
    terms: Sequence[Term], model: Model, body: PosedBody, measured: Measurements
) -> Array:
    """All whitened residuals (R,) of a posed body."""
    return jnp.concatenate([residual_of(term, model, body, measured).ravel() for term in terms])


def residual_of(term: Term, model: Model, body: PosedBody, measured: Measurements) -> Array:
    """A term's whitened residuals (...).

    Raises:
        ValueError: something that it needs was not measured.
    """
    check_measured(term, measured)
    return term.residual(model, body, measured)


def check_measured(term: Term, measured: Measurements) -> None:
    """Refuse measurements without what a term needs; see ``residual_of``."""
    if missing := [name for name in term.needs if getattr(measured, name) is None]:
        raise ValueError(f"{type(term).__name__} needs measured {missing[0]!r}, which is missing")
