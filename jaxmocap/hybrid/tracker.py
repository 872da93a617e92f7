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
from functools import cached_property

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.arms import grips
from jaxmocap.body.kinematics import Sites, landmark_sites
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.compilation.programs import Program
from jaxmocap.geometry.cameras import Camera, stack_cameras
from jaxmocap.hybrid.balance import bow_factors
from jaxmocap.hybrid.feet import effectors, on_held_feet
from jaxmocap.hybrid.observe import Observer
from jaxmocap.hybrid.scan import Scans
from jaxmocap.hybrid.settings import Settings
from jaxmocap.hybrid.steps import Held, State, StepReport, programs_of

_bow_factors = Program(bow_factors, "bow_factors", effort="once")


class HybridTracker:
    """Tracks one person. The jitted functions trace once for a shape of input.

    Attributes:
        skeleton: of the person, as the inverse kinematics takes it.
        cameras: C cameras, stacked; None without video.
        markers: M points on bones that the markers hold.
        settings: how to work.
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
        self.cameras = stack_cameras(listed) if listed else None
        names = ("vertex", "wrist_l", "wrist_r")
        self.markers = landmark_sites(skeleton, names) if markers is None else markers
        self.held = effectors(skeleton, self.markers)
        self.skeleton = on_held_feet(skeleton, self.held.held)
        self.grips = grips(skeleton, self.markers)
        self.observer = Observer(
            len(listed), chosen.samples, chosen.directions, chosen.edges, chosen.spacing
        )
        own = programs_of(Held(self.held, self.grips))
        self._begin, self.solve, self.refine = own.start, own.solve, own.refine
        self.scans = Scans(own.solve_all, own.refine_all)

    @cached_property
    def factors(self) -> Array:
        """(3,) p_i of the balance heuristic."""
        if not self.settings.balance:
            return jnp.zeros(3, self.dtype)
        person = self.skeleton, self.settings.ik
        return _bow_factors.lowered(*person)()(*person)

    def init(self, markers_world: np.ndarray | Array) -> State:
        """The state before the first sample, placed by its (M, 3) markers; NaN where missing."""
        first = self.skeleton, self.settings, np.asarray(markers_world, self.dtype)
        return self._begin.lowered(*first)()(*first)

    def init_like(self, count: int) -> State:
        """Shapes of a state by so many markers."""
        markers = jax.ShapeDtypeStruct((count, 3), self.dtype)
        return self._begin.shapes(self.skeleton, self.settings, markers)

    def prepare(self, count: int) -> None:
        """What comes before a first step by so many markers compiles beside from now on."""
        markers = jax.ShapeDtypeStruct((count, 3), self.dtype)
        self._begin.beside(self.skeleton, self.settings, markers)
        if self.settings.balance:
            _bow_factors.beside(self.skeleton, self.settings.ik)

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
