"""The hybrid tracker: markers and one or several cameras to a pose, frame by frame.

A frame is two jitted calls with OpenCV's image chain between them:

    solve    markers -> pose (section 4), and the regions where it puts the arms
    observe  regions of the video frames -> distance fields of their edges (5.1)
    refine   pose, fields -> search and simplex (5.1, 5.2), balance (5.3) -> pose, belief

``solve`` reads its own last pose only; what the video found lives in refine's belief and is
carried to the marker samples between two video frames.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.kinematics import Sites, forward, landmark_sites
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.geometry.cameras import Camera
from jaxmocap.hybrid.arms import arms_of, grips
from jaxmocap.hybrid.balance import bow_factors, bow_on_feet
from jaxmocap.hybrid.evidence import outline_px
from jaxmocap.hybrid.gradient import Aims, refine_body
from jaxmocap.hybrid.ik import IKResult, goal_distances, goals_of, reach, solve_ik
from jaxmocap.hybrid.observe import Observation, Observer, arm_regions
from jaxmocap.hybrid.refine import elbow_wishes, look_for_elbows, refine_arms, remember, swivels
from jaxmocap.hybrid.search import Belief, carried, confidence_of, no_belief
from jaxmocap.hybrid.settings import Settings
from jaxmocap.hybrid.stance import Stance, effectors, on_held_feet, place
from jaxmocap.hybrid.whole import Scans
from jaxmocap.images.regions import Region
from jaxmocap.solvers.status import Status

# Markers farther than this from the last pose's points: the body is placed anew, metres.
LOST_M = 0.6


class State(NamedTuple):
    """What a frame leaves to the next.

    Attributes:
        pose: of the markers alone.
        stance: where the feet stand.
        belief: what the video has told of the elbows.
    """

    pose: Pose
    stance: Stance
    belief: Belief


class StepReport(NamedTuple):
    """How far to trust a step.

    Attributes:
        pose: of the markers alone.
        distances: (M,) of the markers from their points on the refined body, metres; NaN where
            missing.
        arm_costs: (2,) mean distance of each arm's outline to the edges, pixels; NaN unseen.
        swivels: (2,) turn of each elbow that the video added, radians.
        spread: (2,) standard deviation of the elbows, metres.
        iterations: () of the inverse kinematics.
        planted: () whether the feet were planted anew.
        placed: () whether the body was placed anew.
        balanced: () whether balance bowed the spine.
        ending: () int32 ``Status`` of the gradient refinement.
    """

    pose: Pose
    distances: Array
    arm_costs: Array
    swivels: Array
    spread: Array
    iterations: Array
    planted: Array
    placed: Array
    balanced: Array
    ending: Array

    @property
    def confidence(self) -> Array | np.ndarray:
        """(2,) in the elbows, 0 to 1."""
        return confidence_of(self.spread)


class Solved(NamedTuple):
    """What ``solve`` hands on: the markers' pose, whether it was placed anew, and the regions."""

    ik: IKResult
    placed: Array
    region: Region | None


class HybridTracker:
    """Tracks one person. The jitted functions trace once for a shape of input.

    Attributes:
        skeleton: of the person, as the inverse kinematics takes it.
        cameras: C cameras, stacked; None without video.
        markers: M points on bones that the markers hold.
        settings: how to work.
        factors: (3,) p_i of the balance heuristic.
        scans: the same steps over many events at once.
    """

    def __init__(
        self,
        skeleton: Skeleton,
        cameras: Camera | Sequence[Camera] | None = None,
        settings: Settings | None = None,
        markers: Sites | None = None,
    ):
        """Prepare a tracker.

        Args:
            skeleton: of the person.
            cameras: one or several, or None for markers only.
            settings: defaults to ``Settings()``.
            markers: points on bones; defaults to the paper's: the vertex and both wrists.
        """
        listed = [cameras] if isinstance(cameras, Camera) else list(cameras or [])
        chosen = settings or Settings()
        self.dtype = skeleton.lengths.dtype
        self.settings = chosen if listed else replace(chosen, refine="none")
        self.cameras = jax.tree.map(lambda *leaves: jnp.stack(leaves), *listed) if listed else None
        names = ("vertex", "wrist_l", "wrist_r")
        self.markers = landmark_sites(skeleton, names) if markers is None else markers
        self.held = effectors(skeleton, self.markers)
        self.skeleton = on_held_feet(skeleton, self.held.held)
        self.grips = grips(skeleton, self.markers)
        self.observer = Observer(
            len(listed), chosen.samples, chosen.directions, chosen.edges, chosen.spacing
        )
        balancing = chosen.balance
        no_bow = jnp.zeros(3, skeleton.lengths.dtype)
        self.factors = jax.jit(bow_factors)(self.skeleton, chosen.ik) if balancing else no_bow
        self._begin = jax.jit(self._start)
        self.solve = jax.jit(self._solve)
        self.refine = jax.jit(self._refine)
        self.scans = Scans(self._solve, self._refine)

    def init(self, markers_world: np.ndarray | Array) -> State:
        """The state before the first sample, placed by its (M, 3) markers; NaN where missing."""
        targets = np.asarray(markers_world, self.dtype)
        return self._begin(self.skeleton, self.settings, targets)

    def step(
        self,
        state: State,
        time: float,
        markers_world: np.ndarray | Array,
        images: Sequence[np.ndarray | None] | None = None,
    ) -> tuple[State, Pose, StepReport]:
        """One sample: solve, observe, refine.

        Args:
            state: after the last sample.
            time: of this one, seconds since the first.
            markers_world: (M, 3) metres; NaN where missing.
            images: a BGR or grey uint8 frame per camera, None where there is no new one.

        Returns:
            The state, the refined pose and a report.
        """
        targets = np.asarray(markers_world, self.dtype)
        solved = self.solve(
            self.skeleton, self.cameras, self.settings, state.pose, state.stance, targets
        )
        seen = None if solved.region is None else self.observer.observe(images, solved.region)
        now = np.asarray(time, self.dtype)
        belief, pose, report = self.refine(
            self.skeleton, self.cameras, self.settings, self.factors,
            solved, targets, seen, state.belief, now,
        )  # fmt: skip
        return State(solved.ik.pose, solved.ik.stance, belief), pose, report

    def _start(self, skeleton: Skeleton, settings: Settings, targets: Array) -> State:
        """Place the body by its first markers."""
        mask = jnp.all(jnp.isfinite(targets), -1)
        pose, stance = place(skeleton, self.held, settings.ik, targets, mask)
        return State(pose, stance, no_belief(settings.look, pose))

    def _solve(
        self,
        skeleton: Skeleton,
        cameras: Camera | None,
        settings: Settings,
        pose: Pose,
        stance: Stance,
        targets: Array,
    ) -> Solved:
        """Markers to pose and regions."""
        mask = jnp.all(jnp.isfinite(targets), -1)
        goals = goals_of(skeleton, self.held, settings.ik, stance, targets, mask)
        placed = jnp.max(goal_distances(skeleton, goals, pose)[: mask.shape[0]]) > LOST_M
        pose, stance = jax.lax.cond(
            placed,
            lambda: place(skeleton, self.held, settings.ik, targets, mask),
            lambda: (pose, stance),
        )
        ik = solve_ik(skeleton, self.held, settings.ik, pose, stance, targets, mask)
        if cameras is None:
            return Solved(ik, placed, None)
        arms = arms_of(skeleton, forward(skeleton, ik.pose), self.grips)
        return Solved(
            ik, placed,
            arm_regions(cameras, arms, settings.samples, settings.margin, settings.spacing),
        )  # fmt: skip

    def _refine(
        self,
        skeleton: Skeleton,
        cameras: Camera | None,
        settings: Settings,
        factors: Array,
        solved: Solved,
        targets: Array,
        seen: Observation | None,
        belief: Belief,
        time: Array,
    ) -> tuple[Belief, Pose, StepReport]:
        """The markers' pose and what was seen to the refined pose and the new belief."""
        mask = jnp.all(jnp.isfinite(targets), -1)
        pose, ik = solved.ik.pose, settings.ik
        goals = goals_of(skeleton, self.held, ik, solved.ik.stance, targets, mask)
        arms = arms_of(skeleton, forward(skeleton, pose), self.grips)
        costs = jnp.full(2, jnp.nan, targets.dtype)
        balanced, free = jnp.zeros((), bool), jnp.ones(skeleton.costs.shape, bool)
        centre, ending = pose, jnp.asarray(int(Status.CONVERGED), jnp.int32)
        elbows = arms.elbow
        if cameras is not None and seen is not None and settings.refine != "none":
            # From its own last pose, so that the trunk that video has found stays found.
            fresh = goal_distances(skeleton, goals, belief.pose)[: mask.shape[0]]
            lost = jnp.max(fresh) > LOST_M
            pose = jax.tree.map(lambda new, old: jnp.where(lost, new, old), pose, belief.pose)
            belief, elbows = look_for_elbows(settings, cameras, arms, seen, belief, time)
        if settings.balance:
            # From the markers' pose: one bow on another would pile up.
            bowed, free, balanced = bow_on_feet(skeleton, ik, solved.ik.pose, factors)
            pose, centre = (
                jax.tree.map(lambda new, old: jnp.where(balanced, new, old), bowed, before)
                for before in (pose, centre)
            )
        if cameras is not None and seen is not None and settings.refine != "none":
            pose, _ = reach(skeleton, goals, ik, pose, free, elbow_wishes(skeleton, elbows))
            if settings.refine == "gradient":
                aims = Aims(goals, elbows, centre, free)
                pose, *_, ending = refine_body(
                    settings, skeleton, cameras, seen, pose, self.grips, aims
                )
            else:
                pose = refine_arms(
                    settings, skeleton, cameras, seen, pose, self.grips, arms.grip, elbows
                )
            found = arms_of(skeleton, forward(skeleton, pose), self.grips)
            belief = remember(belief, arms, found, seen, pose)
            costs = outline_px(settings.fit, cameras, seen, found)
        elif settings.balance:
            again = lambda: reach(skeleton, goals, ik, pose, free)[0]  # noqa: E731
            pose = jax.lax.cond(balanced, again, lambda: pose)
        refined = arms_of(skeleton, forward(skeleton, pose), self.grips)
        distances = goal_distances(skeleton, goals, pose)[: mask.shape[0]]
        return (
            belief,
            pose,
            StepReport(
                solved.ik.pose,
                jnp.where(mask, distances, jnp.nan),
                costs,
                swivels(arms, refined),
                carried(settings.look, belief, time)[1],
                solved.ik.iterations,
                solved.ik.planted,
                solved.placed,
                balanced,
                ending,
            ),
        )
