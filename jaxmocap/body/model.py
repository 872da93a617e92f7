"""The model that is tracked: a person's skeleton, markers on its bones, cameras that see it.

INPUTS: a Skeleton, Sites, Cameras. OUTPUTS: a Model, one pytree that jit, vmap and grad go through.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body import arms
from jaxmocap.body.arms import SIDES
from jaxmocap.body.kinematics import Sites, joined_sites, landmark_sites
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.compilation.arrays import on_device
from jaxmocap.geometry.cameras import Camera, stack_cameras

# A marker on one of these parts of a leg holds the foot of its side.
LOWER_LEG = ("shank", "foot")
# The paper's five targets but the feet.
PAPERS_MARKERS = ("vertex", "wrist_l", "wrist_r")


class Placed(Protocol):
    """Where a marker sits: a bone, a fraction of its length, an offset in its frame, metres."""

    @property
    def bone(self) -> str:
        """Its name."""
        ...

    @property
    def at(self) -> float:
        """Of the bone's length, from its joint."""
        ...

    @property
    def offset(self) -> tuple[float, float, float]:
        """In the bone's frame, metres."""
        ...


class Filmed(Protocol):
    """A video, calibrated."""

    @property
    def camera(self) -> Camera:
        """That took it."""
        ...


class Recorded(Protocol):
    """What a model is made of: a ``Recording``, or anything alike."""

    @property
    def skeleton(self) -> Skeleton:
        """Of the person."""
        ...

    @property
    def places(self) -> Sequence[Placed]:
        """Of the markers."""
        ...

    @property
    def videos(self) -> Sequence[Filmed]:
        """Any number."""
        ...


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

    @classmethod
    def of(cls, recording: Recorded) -> "Model":
        """The model of a recording, as it is tracked; see ``on_unmarked_feet``.

        Args:
            recording: its skeleton, where its markers sit, its cameras.
        """
        skeleton = recording.skeleton
        sites = marker_sites(skeleton, recording.places)
        cameras = [video.camera for video in recording.videos]
        return on_unmarked_feet(cls.create(skeleton, sites, cameras))

    def with_lengths(self, **lengths: Array | float) -> "Model":
        """The model with other bone lengths; a derivative by them goes through it.

        Girths, masses and where markers sit along their bones stay.

        Args:
            **lengths: bone -> () metres; ``model.skeleton.tree.bones`` has the names.

        Raises:
            KeyError: no such bone; the message lists the valid ones.
            ValueError: not one number.

        Example:
            >>> from jaxmocap import Model, Skeleton
            >>> model = Model.create(Skeleton.human(1.75))
            >>> longer = model.with_lengths(humerus_l=0.33, humerus_r=0.33)
            >>> float(longer.skeleton.lengths[longer.skeleton.tree.bone("humerus_l")])
            0.33...
        """
        tree, changed = self.skeleton.tree, self.skeleton.lengths
        for name, length in lengths.items():
            bone = tree.bone(name)
            if shape := np.shape(length):
                problem = f"found shape {shape}, expected one length, metres"
                raise ValueError(f"{name}: {problem}; jax.vmap takes several at once")
            changed = changed.at[bone].set(jnp.asarray(length, self.dtype))
        return replace(self, skeleton=replace(self.skeleton, lengths=changed))

    def __repr__(self) -> str:
        """In one line: counts and names, no numbers."""
        tree = self.skeleton.tree
        bones = ", ".join(tree.bones[bone] for bone in self.markers.bone_indices)
        cameras = f", {self.camera_count} cameras" if self.camera_count else ", no camera"
        return (
            f"Model({len(tree.bones)} bones with {len(tree.joints)} joints, "
            f"{len(self.markers.bone_indices)} markers on {bones or 'nothing'}{cameras}, "
            f"{self.dtype})"
        )

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


def marker_sites(skeleton: Skeleton, places: Sequence[Placed]) -> Sites:
    """The markers' points on the bones."""
    bones = np.array([skeleton.tree.bone(place.bone) for place in places], np.int32)
    at = np.array([place.at for place in places], float)
    offsets = np.array([place.offset for place in places], float).reshape(-1, 3)
    return Sites(bones, on_device(at), on_device(offsets))


def on_unmarked_feet(model: Model) -> Model:
    """The model as inverse kinematics takes it while neither foot carries a marker.

    Nothing determines then how the trunk leans, and a straight leg cannot be shortened to the first
    order: a sinking head would bend neck and trunk instead of the knees. So the knees stay soft
    and cheap, and the trunk is stiff. With markers on both legs the skeleton stays as it is.
    """
    if not model.no_foot_is_marked:
        return model
    skeleton = model.skeleton
    low = jnp.maximum(skeleton.limits[:, 0], skeleton.unmarked_least)
    return replace(
        model,
        skeleton=replace(
            skeleton,
            costs=skeleton.costs * skeleton.unmarked_costs,
            relaxed=jnp.maximum(skeleton.relaxed, skeleton.unmarked_relaxed),
            limits=jnp.stack([low, skeleton.limits[:, 1]], -1),
        ),
    )
