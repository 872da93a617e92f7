"""The model that is tracked: a person's skeleton, markers on its bones, cameras that see it.

INPUTS: a Skeleton, Sites, Cameras. OUTPUTS: a Model, one pytree that jit, vmap and grad go through.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from jaxmocap.body import arms
from jaxmocap.body.arms import SIDES
from jaxmocap.body.kinematics import Sites, joined_sites, landmark_sites
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.geometry.cameras import Camera, stack_cameras

# A marker on one of these parts of a leg holds the foot of its side.
LOWER_LEG = ("shank", "foot")
# The paper's five targets but the feet.
PAPERS_MARKERS = ("vertex", "wrist_l", "wrist_r")


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Model:
    """What a pose is estimated of, and by what. Names, counts and bones are static, numbers traced.

    Attributes:
        skeleton: of the person.
        markers: M points on bones that the markers hold.
        cameras: C cameras, stacked; None without video.
    """

    skeleton: Skeleton
    markers: Sites
    cameras: Camera | None = None

    @classmethod
    def create(
        cls,
        skeleton: Skeleton,
        markers: Sites | None = None,
        cameras: Camera | Sequence[Camera] | None = None,
    ) -> "Model":
        """A model of a person, of markers and of one or several cameras.

        Args:
            skeleton: of the person.
            markers: defaults to the paper's: the vertex and both wrists.
            cameras: one or several, or None for markers only.
        """
        listed = [cameras] if isinstance(cameras, Camera) else list(cameras or [])
        sites = landmark_sites(skeleton, PAPERS_MARKERS) if markers is None else markers
        return cls(skeleton, sites, stack_cameras(listed) if listed else None)

    @property
    def unmarked_feet(self) -> tuple[str, ...]:
        """Sides ("l", "r") of the feet that no marker on shank or foot holds."""
        tree, marked = self.skeleton.tree, np.asarray(self.markers.bones)
        return tuple(
            side
            for side in SIDES
            if not np.isin(marked, tree.bones_in(*LOWER_LEG, side=side)).any()
        )

    @property
    def no_foot_is_marked(self) -> bool:
        """Whether the ground must hold both feet."""
        return len(self.unmarked_feet) == len(SIDES)

    @property
    def effectors(self) -> Sites:
        """All that is held somewhere: the markers, then the ankles of feet that carry none."""
        ankles = tuple(f"ankle_{side}" for side in self.unmarked_feet)
        return joined_sites(self.markers, landmark_sites(self.skeleton, ankles))

    @property
    def grips(self) -> Sites:
        """The point of each arm that its first marker on forearm or hand holds, else the wrist."""
        return arms.grips(self.skeleton, self.markers)

    @property
    def dtype(self) -> jnp.dtype:
        """Of the numbers that are computed with."""
        return self.skeleton.lengths.dtype

    def camera(self, index: int) -> Camera:
        """One of the cameras."""
        return jax.tree.map(lambda part: part[index], self.cameras)

    @property
    def camera_count(self) -> int:
        """C; 0 without video."""
        return 0 if self.cameras is None else len(self.cameras.size)
