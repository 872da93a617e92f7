"""The silhouette tracker: images of one or several cameras to a pose, frame by frame (section 5).

    predict    the last pose moves on at its velocity
    rim        of the surface at that pose, as each camera sees it (3.1.5)
    segment    level sets from the predicted silhouettes, their contours (4.1)
    fit        rim -> contour, twist equations of all cameras in one system (3.2); again with the
               rim of the estimated pose, and a smaller deviation for outliers; begun with the
               surface's low-pass, coarse to fine, in the first frame or in all; and segmented
               and fitted again until both settle, where that is asked for
    recover    a limb that explains more where an earlier pass found it is fitted from there; where
               no limb explains a visible person, or a limb explains nothing, a particle filter
               proposes poses and the best is fitted; parts of another colour than before are hidden
    withdraw   of limbs found elsewhere the last frames' information is taken back

Cameras that show nothing of the person, or what the others deny, are left out frame by frame;
joints that no camera determines stay where they are predicted, and the report says so.

INPUTS: a body, cameras; images. OUTPUTS: State, Pose and StepReport of each frame.
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.kinematics import Sites
from jaxmocap.body.model import Model
from jaxmocap.body.pose import Pose, difference, retract
from jaxmocap.body.skeleton import Skeleton, with_joints
from jaxmocap.body.surfaces.loft import generic_surface
from jaxmocap.body.surfaces.surface import Surface
from jaxmocap.body.tree import ROOT_DOF
from jaxmocap.compilation.programs import program
from jaxmocap.evidence.terms import Measurements
from jaxmocap.geometry.cameras import Camera, stack_cameras
from jaxmocap.images.background_model import Background
from jaxmocap.silhouette.fit.cycles import (
    FrameEvidence,
    fit_pose,
    information_without,
    kept_histograms,
    term_evidence,
)
from jaxmocap.silhouette.pose import standard_deviations
from jaxmocap.silhouette.recovery.limbs import carrying_bones
from jaxmocap.silhouette.recovery.lost_limbs import LimbRecovery
from jaxmocap.silhouette.recovery.relocation import (
    RecoveredPose,
    recover_limbs,
    remember_frame,
    slim,
    withdraw_joints,
)
from jaxmocap.silhouette.segmentation.image_changes import ImageHistory
from jaxmocap.silhouette.segmentation.segment import Histograms
from jaxmocap.silhouette.settings import Settings
from jaxmocap.silhouette.state import (
    PoseEstimate,
    RecentFrame,
    State,
    StepReport,
    TrackedBody,
    TrackerConstants,
)
from jaxmocap.silhouette.surfaces.body_shape import BodyShape, surface_of_body
from jaxmocap.silhouette.surfaces.rim import RimFinder

# Shortest time between two frames that a velocity is taken over, seconds.
SHORTEST_STEP_S = 1e-3


@program("full")
def predicted_pose(skeleton: Skeleton, pose: Pose, velocity: Array, ahead: Array) -> Pose:
    """A pose (..., ) moved on by a velocity (6 + D,) for so many seconds, within the limits."""
    moved = retract(pose, velocity * ahead)
    return moved._replace(angles=jnp.clip(moved.angles, *skeleton.limits.T))


@program("full")
def _velocity_between(before: Pose, now: Pose, between: Array) -> Array:
    """(6 + D,) metres and radians per second from one pose to another, seconds later."""
    return difference(now, before) / between


class SilhouetteTracker:
    """Tracks one person without markers: a function of its State. Its jitted parts trace once.

    Attributes:
        constants: what stays as it is for all frames.
        body: who is tracked, before any pass has corrected it.
    """

    def __init__(
        self,
        skeleton: Skeleton,
        cameras: Camera | Sequence[Camera],
        settings: Settings | None = None,
        surface: Surface | None = None,
        sites: Sites | None = None,
    ):
        """Prepare a tracker.

        Args:
            skeleton: of the person; moved by the joints of ``settings.body``.
            cameras: one or several.
            settings: defaults to ``Settings()``.
            surface: of the whole person; a generic one of the skeleton's proportions without it.
            sites: of markers that are to be followed too.
        """
        listed = [cameras] if isinstance(cameras, Camera) else list(cameras)
        dtype = skeleton.lengths.dtype
        stacked = jax.tree.map(lambda part: jnp.asarray(part, dtype), stack_cameras(listed))
        s = settings or Settings()
        skeleton = with_joints(skeleton, s.body)
        whole = generic_surface(skeleton) if surface is None else surface
        skin = surface_of_body(whole, skeleton, s.body)
        finder = RimFinder(skeleton, skin, s.rim, s.morphing)
        self.constants = TrackerConstants(
            stacked, s, finder, s.rest * np.asarray(skeleton.rest_deviations, float),
            carrying_bones(finder.initial_shape.surface.points)[0],
        )  # fmt: skip
        self._sites = Sites.none(dtype) if sites is None else sites
        self.body = self._body(finder.initial_shape)

    def reshape_person(
        self, body: TrackedBody, skeleton: Skeleton, surface: Surface
    ) -> TrackedBody:
        """The same person, corrected: bones of other lengths, a surface of as many nodes.

        While the bones are the same, limbs are recovered as thick as they were.
        """
        shape = self.constants.finder.shape_of(skeleton, surface)
        if skeleton is body.shape.skeleton:
            return body._replace(shape=shape)
        return self._body(shape)

    def _body(self, shape: BodyShape) -> TrackedBody:
        """Of other lengths markers sit elsewhere, limbs reach farther."""
        cameras, s = self.constants.cameras, self.constants.settings
        recovery = LimbRecovery(shape.skeleton, shape.surface, cameras, s.particles)
        return TrackedBody(shape, Model(shape.skeleton, self._sites), recovery)

    def init(
        self,
        pose: Pose,
        body: TrackedBody | None = None,
        backgrounds: Sequence[Background | None] | None = None,
    ) -> State:
        """The state before the first frame.

        Args:
            pose: about there the person is.
            body: who is tracked; ``self.body`` by default.
            backgrounds: C models of what each camera shows where nobody stands, None where unknown.
        """
        body = self.body if body is None else body
        width, count = body.shape.skeleton.costs.shape, len(self.constants.cameras.size)
        models = (None,) * count if backgrounds is None else tuple(backgrounds)
        histograms = Histograms.empty(count, self.constants.settings.plan)
        history, limbs = ImageHistory.empty(count), body.recovery.empty_memory()
        still, determined = np.zeros(width, np.float32), np.ones(width, bool)
        return State(pose, still, None, histograms, determined, history, limbs, body, models)

    def step(
        self,
        state: State,
        time: float,
        images: Sequence[np.ndarray | None],
        measured: Measurements | None = None,
        earlier: PoseEstimate | None = None,
        expected: Pose | None = None,
    ) -> tuple[State, Pose, StepReport]:
        """One frame of all cameras.

        Args:
            state: after the last frame.
            time: of this one, seconds.
            images: (H, W, 3) BGR uint8 of each camera, None where there is none.
            measured: besides the images, see ``term_evidence``.
            earlier: what an earlier pass found in this frame; limbs that explain more there are
                taken from it.
            expected: where key points have the person; in place of the motion's prediction.

        Returns:
            The state, the pose and a report.
        """
        constants, body, s = self.constants, state.body, self.constants.settings
        images, history = state.image_history.accept(images, s.changed_share, s.patience)
        elapsed = 0.0 if state.time is None else max(time - state.time, SHORTEST_STEP_S)
        skeleton, velocity = body.shape.skeleton, s.damping * state.velocity
        predicted = predicted_pose(skeleton, state.pose, velocity, np.float32(elapsed))
        deviations = np.where(state.determined, s.predicted_deviation, s.undetermined_deviation)
        if expected is not None:
            predicted, deviations = expected, np.full(deviations.shape, s.expected_deviation)
            if len(constants.cameras.size) == 1:
                deviations[:3] = s.expected_place
        deviations, measured = deviations.astype(np.float32), measured or Measurements()
        beside, is_first = term_evidence(body.model, measured, s), state.time is None
        frame = FrameEvidence(images, state.backgrounds, state.histograms, beside, is_first)
        fitted = fit_pose(constants, body, frame, predicted, deviations)
        recovered = recover_limbs(constants, body, state.limbs, frame, fitted, deviations, earlier)
        report, pose, determined = self._make_report(body, recovered, measured)
        velocity = self._velocity(state, recovered, pose, determined, elapsed, earlier)
        if not determined.any():
            # Who is not visible for an instant moves on; for longer, comes to rest.
            determined, velocity = state.determined, s.damping * state.velocity
        recent = state.recent
        if report.relocated.any():
            recent = withdraw_joints(constants, body, recent, report.relocated)
            report = report._replace(revised=tuple(slim(each.report) for each in recent))
        now = report.outlines.segmentation.histograms
        after = State(
            pose, velocity, time, kept_histograms(report.used, now, state.histograms), determined,
            history, recovered.limbs, body, state.backgrounds,
            remember_frame(recent, RecentFrame(report, pose, measured)),
        )  # fmt: skip
        return after, pose, report

    def _make_report(
        self, body: TrackedBody, recovered: RecoveredPose, measured: Measurements
    ) -> tuple[StepReport, Pose, np.ndarray]:
        """The report, its pose, and which degrees of freedom (6 + D,) are well determined."""
        s, (fitted, relocated, _, hidden, _) = self.constants.settings, recovered
        result = fitted.result
        if hidden.any():
            result = information_without(
                self.constants, body, hidden, result.pose, fitted.pairs, measured
            )
        deviations = standard_deviations(result.information, s.unknown_deviation)
        observed = deviations < s.determined_share * s.unknown_deviation
        observed[ROOT_DOF:][hidden] = False
        posterior = standard_deviations(result.information, s.predicted_deviation)
        determined = posterior < s.determined_share * s.predicted_deviation
        report = StepReport(
            fitted.used, fitted.matched_shares, float(result.spread), deviations, observed,
            np.asarray(result.information), np.asarray(result.slope), fitted.outlines, relocated,
            hidden, fitted.pairs,
        )  # fmt: skip
        return report, result.pose, determined

    def _velocity(
        self,
        state: State,
        recovered: RecoveredPose,
        pose: Pose,
        determined: np.ndarray,
        elapsed: float,
        earlier: PoseEstimate | None,
    ) -> np.ndarray:
        """The velocity (6 + D,) as it is carried on; relocated joints begin again."""
        velocity = state.velocity
        if state.time is not None:
            now = np.asarray(_velocity_between(state.pose, pose, np.float32(elapsed)))
            gain = self.constants.settings.velocity_gain
            velocity = (gain * now + (1 - gain) * state.velocity).astype(np.float32)
        velocity = velocity * determined
        velocity[ROOT_DOF:][recovered.relocated] = 0
        if earlier is not None:
            resumed = recovered.resumed
            velocity[ROOT_DOF:][resumed] = earlier.velocity[ROOT_DOF:][resumed]
        return velocity

    def body_pixels(self, state: State) -> np.ndarray:
        """(C, N, 2) pixels of points all over the body in a state, hidden or not."""
        return state.body.recovery.projector.pixels_and_depths(state.pose)[0]
