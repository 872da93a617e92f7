"""The silhouette tracker: images of one or several cameras to a pose, frame by frame (section 5).

    predict   the last pose moves on at its velocity
    rim       of the surface at that pose, as each camera sees it (3.1.5)
    look      level sets from the predicted silhouettes, their contours (4.1)
    fit       rim -> contour, twist equations of all cameras in one system (3.2); again with the
              rim of the pose that was found, and a narrower view of what is an outlier; in the
              first frame begun with the surface's low-pass, coarse to fine
    doubt     a limb that explains more where an earlier pass found it is fitted from there; person
              that no limb explains, or a limb that is not there: many hypotheses, the best is
              fitted again; parts that look otherwise than before are not seen

Cameras that show nothing of the person, or what the others deny, are left out frame by frame;
joints that no camera tells of stay where they are expected, and the report says so.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxmocap.body.kinematics import Sites
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import ROOT_DOF, Skeleton
from jaxmocap.body.surfaces.loft import generic_surface, rest_joints
from jaxmocap.body.surfaces.surface import Surface
from jaxmocap.geometry.cameras import Camera, stack_cameras
from jaxmocap.images.background_model import Background
from jaxmocap.silhouette.camera_agreement import chosen, denied, shares_found
from jaxmocap.silhouette.correspond import matched
from jaxmocap.silhouette.device_functions import Seen, fit, free, predict, velocity_of
from jaxmocap.silhouette.expected_pose import expectation
from jaxmocap.silhouette.markers import MarkerRows, points_at
from jaxmocap.silhouette.pose import PoseResult, PoseSettings, Prior, standard_deviations
from jaxmocap.silhouette.recovery.limbs import carriers
from jaxmocap.silhouette.recovery.lost_limbs import Better, Doubter, Doubts, freed
from jaxmocap.silhouette.recovery.projected_body import Sight
from jaxmocap.silhouette.segmentation.image_changes import Glances
from jaxmocap.silhouette.segmentation.inner_edges import edge_pairs, joined
from jaxmocap.silhouette.segmentation.outlines import Outlines, look
from jaxmocap.silhouette.segmentation.segment import Histograms, Plan
from jaxmocap.silhouette.settings import Settings
from jaxmocap.silhouette.state import Moving, State, StepReport
from jaxmocap.silhouette.surfaces.rim import RimFinder
from jaxmocap.silhouette.surfaces.shape import Paired


class _Shown(NamedTuple):
    """What is known of a frame before it is looked at."""

    images: Sequence[np.ndarray | None]
    histograms: Histograms
    markers: MarkerRows | None
    first: bool


class _Fitted(NamedTuple):
    """What the last cycle found, from which cameras, by what they show."""

    result: PoseResult
    used: np.ndarray
    shares: np.ndarray
    outlines: Outlines
    pairs: Paired


class _Reconsidered(NamedTuple):
    """What is left of a frame's result, and what became of the limbs.

    Attributes:
        fitted: the result.
        moved: (D,) bool: joints that were moved elsewhere.
        resumed: (D,) bool: those of them that are where an earlier pass found them.
        hidden: (D,) bool: joints of parts that are not seen.
        doubts: to remember.
    """

    fitted: _Fitted
    moved: np.ndarray
    resumed: np.ndarray
    hidden: np.ndarray
    doubts: Doubts


class SilhouetteTracker:
    """Tracks one person without markers. Its jitted parts trace once.

    Attributes:
        skeleton: of the person, moved by the joints of ``supple.toml`` or of another model.
        cameras: C, stacked.
        settings: how to work.
        finder: of the rims.
        rooms: what each camera shows where nobody stands, or None; may be set between frames.
        rest: (D,) deviations of joints held about 0, radians; infinite for the others.
    """

    def __init__(
        self,
        skeleton: Skeleton,
        cameras: Camera | Sequence[Camera],
        settings: Settings | None = None,
        surface: Surface | None = None,
        rooms: Sequence[Background | None] | None = None,
        sites: Sites | None = None,
    ):
        """Prepare a tracker.

        Args:
            skeleton: of the person.
            cameras: one or several.
            settings: defaults to ``Settings()``.
            surface: of the person; a generic one of the skeleton's proportions without it.
            rooms: what is known of each camera's room.
            sites: of markers that are to be followed too.
        """
        listed = [cameras] if isinstance(cameras, Camera) else list(cameras)
        self.settings = settings or Settings()
        dtype = skeleton.lengths.dtype
        self.cameras = jax.tree.map(lambda part: jnp.asarray(part, dtype), stack_cameras(listed))
        skin = generic_surface(skeleton) if surface is None else surface
        self.finder = RimFinder(skeleton, skin, self.settings.rim, self.settings.morphing)
        self._bones = carriers(self.finder.surface.points)
        self.rest = self.settings.held_at_rest * np.asarray(skeleton.rest_deviations, float)
        self.rooms = [None] * len(listed) if rooms is None else list(rooms)
        self.plan = Plan()
        self._sites = sites
        self._take(skeleton)

    def become(self, skeleton: Skeleton, surface: Surface) -> None:
        """Take the person for another: bones of other lengths, a surface of as many nodes."""
        self.finder.wear(surface, rest_joints(skeleton))
        if skeleton is not self.skeleton:
            self._take(skeleton)

    def _take(self, skeleton: Skeleton) -> None:
        """Bones of other lengths: markers sit elsewhere, limbs reach farther."""
        self.skeleton = skeleton
        self._points = None if self._sites is None else points_at(skeleton, self._sites)
        count = self.settings.hypotheses
        self._doubter = Doubter(skeleton, self.finder.surface, self.cameras, count)

    def init(self, pose: Pose) -> State:
        """The state before the first frame, the person about there."""
        width = self.skeleton.costs.shape
        cameras, still = len(self.rooms), np.zeros(width, np.float32)
        empty, told = Histograms.empty(cameras, self.plan), np.ones(width, bool)
        glances, doubts = Glances.none(cameras), self._doubter.none()
        return State(pose, still, None, empty, told, glances, doubts)

    def step(
        self,
        state: State,
        time: float,
        images: Sequence[np.ndarray | None],
        positions_world: np.ndarray | None = None,
        earlier: Moving | None = None,
    ) -> tuple[State, Pose, StepReport]:
        """One frame of all cameras.

        Args:
            state: after the last frame.
            time: of this one, seconds.
            images: (H, W, 3) BGR uint8 of each camera, None where there is none.
            positions_world: (M, 3) of the markers, metres; NaN where one is missing.
            earlier: what an earlier pass found in this frame; limbs that explain more there are
                taken from it.

        Returns:
            The state, the pose and a report.
        """
        s = self.settings
        images, glances = state.glances.believed(images, s.changed, s.patience)
        ahead = 0.0 if state.time is None else max(time - state.time, 1e-3)
        expected = predict(self.skeleton, state.pose, s.damping * state.velocity, np.float32(ahead))
        beforehand = np.where(state.told, s.expected, s.held).astype(np.float32)
        markers, first = self._markers(positions_world), state.time is None
        shown = _Shown(images, state.histograms, markers, first)
        fitted = self._fitted(shown, expected, beforehand)
        fitted, moved, resumed, hidden, doubts = self._reconsidered(
            state.doubts, shown, fitted, beforehand, earlier
        )
        result, used, outlines, pairs = fitted.result, fitted.used, fitted.outlines, fitted.pairs
        if hidden.any():
            result = self.told_without(hidden, result.pose, pairs, positions_world)
        deviations = standard_deviations(result.information, s.blind)
        seen = deviations < s.told * s.blind
        told = standard_deviations(result.information, s.expected) < s.told * s.expected
        seen[ROOT_DOF:][hidden] = False
        velocity = self._velocity(state, result.pose, ahead) * told
        velocity[ROOT_DOF:][moved] = 0
        if earlier is not None:
            velocity[ROOT_DOF:][resumed] = earlier.velocity[ROOT_DOF:][resumed]
        if not told.any():
            # Who is not seen for an instant moves on; for longer, comes to rest.
            told, velocity = state.told, s.damping * state.velocity
        histograms = chosen(used, outlines.segmented.histograms, state.histograms)
        report = StepReport(
            used, fitted.shares, float(result.spread), deviations, seen,
            np.asarray(result.information), np.asarray(result.slope), outlines, moved, hidden,
            pairs,
        )  # fmt: skip
        after = State(result.pose, velocity, time, histograms, told, glances, doubts)
        return after, result.pose, report

    def told_without(
        self, hidden: np.ndarray, pose: Pose, pairs: Paired, positions_world: np.ndarray | None
    ) -> PoseResult:
        """What pairs tell about the pose found by them, without those of hidden joints (D,).

        For what hides a part has outlines too; ``positions_world`` as in ``step``.
        """
        s, (nodes, seen) = self.settings, pairs
        moved = np.any(self.skeleton.tree.carries[ROOT_DOF:][hidden], 0)
        gone = moved[self._bones[nodes]]
        left = seen._replace(weights=np.where(gone, np.float32(0), seen.weights))
        how = PoseSettings(deviation=s.deviations[-1], iterations=0)
        here = expectation(pose, np.full(self.skeleton.costs.shape, s.expected), self.rest)
        return self._fit(pose, left, how, here, self._markers(positions_world))

    def covering(self, pose: Pose) -> np.ndarray:
        """(C, N, 2) pixels of points all over the body, hidden or not."""
        return self._doubter.covering(pose)

    def _markers(self, positions_world: np.ndarray | None) -> MarkerRows | None:
        """Rows of the markers, where any are followed."""
        if self._points is None:
            return None
        count = len(self._points.bones)
        nowhere = np.full((count, 3), np.nan)
        there = nowhere if positions_world is None else positions_world
        firm = np.full(count, self.settings.marked, np.float32)
        return MarkerRows(self._points, np.asarray(there, np.float32), firm)

    def _fitted(self, shown: _Shown, expected: Pose, beforehand: np.ndarray) -> _Fitted:
        """Cycle by cycle from the predicted pose."""
        s, pose, fitted = self.settings, expected, None
        rough = s.starting if shown.first else ()
        morph = self.finder.morph
        apart = expected if morph is None else free(morph, expected)
        prior = expectation(apart, beforehand, self.rest)
        used, outlines = np.zeros(0, bool), None
        for cycle, deviation in enumerate((*rough, *s.deviations)):
            coarse = cycle < len(rough)
            rim = self.finder.find(self.skeleton, pose, self.cameras, coarse)
            if coarse or outlines is None or cycle - len(rough) in s.looks:
                outlines = look(shown.images, self.rooms, rim, shown.histograms, s, self.plan)
                used = np.ones(len(self.rooms), bool)
            pairs = matched(rim, outlines.contours, s.match)
            shares = shares_found(rim, pairs, [len(each.pixels_xy) for each in outlines.contours])
            used = used & (shares >= s.share)
            edges = edge_pairs(shown.images, rim, self._bones, s.edges)
            weights = np.concatenate([pairs.real, s.edges.weight * edges.real], 1)
            pairs = joined(pairs, edges)
            weights = (weights * used[:, None]).astype(np.float32)
            points = self.finder.points(pairs.nodes, coarse)
            moves = self.finder.moves(pairs.nodes)
            seen = Seen(points, pairs.pixels_xy, pairs.normals, weights, moves)
            how = PoseSettings(deviation=deviation, iterations=s.iterations)
            result = self._fit(pose, seen, how, prior, shown.markers)
            apart = np.asarray(result.distances).reshape(weights.shape)
            pose, used = result.pose, used & ~denied(apart, weights > 0, s.apart, s.near)
            robust = np.asarray(result.shares).reshape(weights.shape)
            left = Paired(pairs.nodes, seen._replace(weights=robust * weights))
            fitted = _Fitted(result, used, shares, outlines, left)
        assert fitted is not None
        return fitted

    def _fit(
        self, pose: Pose, seen: Seen, how: PoseSettings, prior: Prior, markers: MarkerRows | None
    ) -> PoseResult:
        morph, grip = self.finder.morph, self.settings.match.grip
        return fit(self.skeleton, self.cameras, pose, seen, how, prior, grip, markers, morph)

    def _reconsidered(
        self,
        doubts: Doubts,
        shown: _Shown,
        fitted: _Fitted,
        beforehand: np.ndarray,
        earlier: Moving | None = None,
    ) -> _Reconsidered:
        """What was found, or what is found from elsewhere if that explains more."""
        s, doubter = self.settings, self._doubter
        none = doubter.joints_of(())
        if not fitted.used.any():
            return _Reconsidered(fitted, none, none, ~none, doubts)
        sight = self._sight(fitted.result.pose, fitted, shown)
        resumed, elsewhere = (), ()
        # Who does not know the rooms takes what looks like a person for one, and learns it as none.
        known = all(room is not None for room in self.rooms)
        if s.hypotheses > 1 and known:
            if earlier is not None:
                better = doubter.found_earlier(doubts, sight, earlier.pose)
                fitted, sight, resumed = self._tried(
                    better, doubts, shown, fitted, sight, beforehand
                )
            better, doubts = doubter.better(doubts, sight, s.search)
            fitted, sight, elsewhere = self._tried(better, doubts, shown, fitted, sight, beforehand)
        hidden, doubts = doubter.hidden(doubts, sight, shown.images, (*resumed, *elsewhere))
        there, anew = doubter.joints_of(resumed), doubter.joints_of(elsewhere)
        return _Reconsidered(fitted, there | anew, there & ~anew, hidden, doubts)

    def _tried(
        self,
        better: Better | None,
        doubts: Doubts,
        shown: _Shown,
        fitted: _Fitted,
        sight: Sight,
        beforehand: np.ndarray,
    ) -> tuple[_Fitted, Sight, tuple[int, ...]]:
        """The best of better poses, each fitted, and its limbs; or what was found, and none."""
        moved: tuple[int, ...] = ()
        if better is None:
            return fitted, sight, moved
        wide = freed(beforehand, self._doubter.joints_of(better.limbs), self.settings.expected)
        before, least = fitted, better.least
        for pose in better.poses:
            again = self._fitted(shown, pose, wide)
            old, new = (self._sight(each.result.pose, again, shown) for each in (before, again))
            more = self._doubter.gain(better.limbs, old, new, doubts.known)
            if more > least:
                least, fitted, moved, sight = more, again, better.limbs, new
        return fitted, sight, moved

    def _sight(self, pose: Pose, by: _Fitted, shown: _Shown) -> Sight:
        """A pose laid over what was segmented."""
        return self._doubter.sight(pose, by.outlines, by.used, shown.images, self.rooms)

    def _velocity(self, state: State, pose: Pose, ahead: float) -> np.ndarray:
        """The velocity (6 + D,) as it is carried on."""
        if state.time is None:
            return state.velocity
        now = np.asarray(velocity_of(state.pose, pose, np.float32(ahead)))
        newest = self.settings.newest
        return (newest * now + (1 - newest) * state.velocity).astype(np.float32)
