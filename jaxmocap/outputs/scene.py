"""The body over time, for drawing: limbs in the world, outlines in an image, the floor below.

INPUTS: a Motion, a Camera. OUTPUTS: NumPy arrays, world (metres) or pixels (x, y).

The floor lies at the body's lowest points: marker systems place the world's origin anywhere.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.kinematics import forward
from jaxmocap.body.motion import Motion, in_blocks
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.body.surfaces.cones import cones
from jaxmocap.body.tree import Tree
from jaxmocap.compilation.programs import program
from jaxmocap.formats.time_series.resampling import LONGEST_BRIDGED_S, is_gap
from jaxmocap.formats.time_series.tables import usual_step
from jaxmocap.geometry.cameras import (
    NEAREST_M,
    Camera,
    pixel_components_anywhere,
    to_camera,
)
from jaxmocap.geometry.outlines import outline_pieces, project_limb
from jaxmocap.geometry.solids import Solid

# A sample that is the only one is there for so long, seconds.
ALONE_S = 0.05
# Points on each straight side of an outline: smooth at 500 pixels.
POINTS_ALONG = 8
# Points on each round end of an outline.
POINTS_AROUND = 12


@dataclass(frozen=True)
class BodyScene:
    """A body of B bones over T samples, in the world."""

    tree: Tree  # names and kinds of the bones
    times: np.ndarray  # (T,) seconds
    R_world_bone: np.ndarray  # (T, B, 3, 3) orientations
    near: np.ndarray  # (T, B, 3) the bones' joints, world, metres
    far: np.ndarray  # (T, B, 3) the bones' far ends, world, metres
    radii: np.ndarray  # (B, 2) of the flesh at both ends, metres

    def part(self, rows: slice) -> "BodyScene":
        """Some of the samples."""
        names = ("times", "R_world_bone", "near", "far")
        return replace(self, **{name: getattr(self, name)[rows] for name in names})

    def at(self, time: float) -> tuple[np.ndarray, np.ndarray] | None:
        """Near and far ends (B, 3) at a time, between the samples on a straight line.

        None where the time lies more than a sample outside, or within a gap.
        """
        return both_at(self.times, time, self.near, self.far)


def both_at(
    times: np.ndarray, time: float, a: np.ndarray, b: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    """Two arrays (T, ...) at a time, between the samples on a straight line.

    None where the time lies more than a sample outside of times (T,), seconds, or within a gap.
    """
    after = int(np.clip(np.searchsorted(times, time), 1, max(len(times) - 1, 1)))
    before, after = after - 1, min(after, len(times) - 1)
    step = times[after] - times[before]
    part = (time - times[before]) / (step or ALONE_S)
    if not -1.0 <= part <= 2.0:
        return None
    part = float(np.clip(part, 0.0, 1.0))
    if step > LONGEST_BRIDGED_S and is_gap(times)[before]:
        part = float(round(part))
        if abs(time - times[before] - part * step) > usual_step(times):
            return None
    ends = ((values[before], values[after]) for values in (a, b))
    first, second = ((1 - part) * start + part * end for start, end in ends)
    return first, second


def make_scene(motion: Motion) -> BodyScene:
    """Place every bone of a motion in the world."""
    skeleton, times = motion.skeleton, np.asarray(motion.times, float)
    R, near, far = in_blocks(_place, skeleton, motion.poses)
    return BodyScene(skeleton.tree, times, R, near, far, np.asarray(skeleton.diameters) / 2)


@program("quick")
def _place(skeleton: Skeleton, poses: Pose) -> tuple[Array, Array, Array]:
    bones = np.arange(len(skeleton.tree.bones))
    frames = jax.vmap(forward, (None, 0))(skeleton, poses)
    flesh = jax.vmap(lambda placed: cones(skeleton, placed, bones))(frames)
    return frames.R_world_bone, flesh.near, flesh.far


def limb_outlines(
    camera: Camera, near: np.ndarray, far: np.ndarray, radii: np.ndarray
) -> np.ndarray:
    """Closed outlines (..., P, 2), pixels, of limbs; NaN where one reaches behind the camera.

    Args:
        camera: distorts every point of the outline by itself.
        near: (..., 3) world, metres.
        far: (..., 3) world, metres.
        radii: (..., 2) metres.
    """
    dtype = camera.T_cam_world.dtype
    return np.asarray(_outlines(camera, *(np.asarray(part, dtype) for part in (near, far, radii))))


@program("quick")
def _outlines(camera: Camera, near: Array, far: Array, radii: Array) -> Array:
    near_cam, far_cam = to_camera(camera, near), to_camera(camera, far)
    discs = project_limb(near_cam, far_cam, radii)
    x, y = jnp.moveaxis(jnp.stack([discs.near, discs.far]), -1, 0)
    sizes = jnp.moveaxis(discs.radii, -1, 0)
    both = outline_pieces(x, y, sizes, POINTS_ALONG, POINTS_AROUND, jnp.ones_like(sizes))

    def close_loop(sides: Array, arcs: Array) -> Array:
        """(..., P) of two pieces each, joined into one loop."""
        loop = [sides[0], arcs[1, ::-1], sides[1, ::-1], arcs[0, ::-1], sides[0, :1]]
        return jnp.moveaxis(jnp.concatenate(loop), 0, -1)

    xs, ys = (close_loop(*(getattr(piece, axis) for piece in both)) for axis in "xy")
    ahead = jnp.minimum(near_cam[..., 2], far_cam[..., 2]) - jnp.max(radii, -1) > NEAREST_M
    xy = jnp.stack(pixel_components_anywhere(camera, xs, ys), -1)
    return jnp.where(ahead[..., None, None], xy, jnp.nan)


# The lowest points of a recording: this percentile of the samples', so that one bad pose of many
# does not sink the floor.
LOWEST_PERCENT = 5.0
# Samples at most that are looked at.
MOST_SAMPLES = 200
# Around where the body goes, and half the side at most, metres.
MARGIN_M, LARGEST_M = 1.5, 25.0


class Floor(NamedTuple):
    """A level square."""

    height_m: float  # along the world's z
    centre_xy: np.ndarray  # (2,) of it
    half_size_m: float  # half its side


def floor_of(scene: BodyScene, pieces: Mapping[str, Solid]) -> Floor | None:
    """The floor on which a body stands; None without a pose."""
    is_present = np.isfinite(scene.near).all((1, 2))
    if not is_present.any():
        return None
    present = np.flatnonzero(is_present)
    some = present[:: -(-len(present) // MOST_SAMPLES)]
    lowest = np.full(len(some), np.inf)
    for bone, solid in pieces.items():
        i = scene.tree.bone(bone)
        heights = scene.R_world_bone[some, i, 2] @ solid.vertices.T
        lowest = np.minimum(lowest, scene.near[some, i, 2] + heights.min(1))
    places = scene.near[present][..., :2].reshape(-1, 2)
    low, high = places.min(0), places.max(0)
    half = min(float((high - low).max()) / 2 + MARGIN_M, LARGEST_M)
    return Floor(float(np.percentile(lowest, LOWEST_PERCENT)), (low + high) / 2, half)
