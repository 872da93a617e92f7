"""Forward kinematics and the geometric Jacobian.

INPUTS: a Skeleton, a Pose. OUTPUTS: frames of all bones, points on bones, their derivatives.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.custom_derivatives import SymbolicZero

from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import LANDMARK_PLACES, LANDMARKS, Skeleton
from jaxmocap.body.tree import ROOT_DOF, ROOT_LINK
from jaxmocap.geometry.rotations import (
    HIGHEST,
    about_axis,
    compose,
    cross,
    quaternion_multiply,
    quaternion_to_matrix,
    rotate,
)


class Frames(NamedTuple):
    """Where the bones are, for B bones and D degrees of freedom."""

    root: Array  # (3,) position of the pelvis in the world, metres
    R_world_bone: Array  # (B, 3, 3) orientations
    joints_world: Array  # (B, 3) positions of the bones' joints, metres
    axes_world: Array  # (D, 3) hinge axes v_j of equation (4)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Sites:
    """M points fixed to bones, such as markers."""

    # Of the bones that carry them (static; any integers are taken).
    bone_indices: Sequence[int] | np.ndarray = field(metadata={"static": True})
    at: Array  # (M,) fraction of the bone's length from its joint
    offsets: Array  # (M, 3) metres, in the bone's frame

    def __post_init__(self):
        # Hashable, since it belongs to a program's name.
        object.__setattr__(self, "bone_indices", tuple(int(bone) for bone in self.bone_indices))

    @classmethod
    def none(cls, dtype: jnp.dtype) -> "Sites":
        """Of no point."""
        return cls((), jnp.zeros(0, dtype), jnp.zeros((0, 3), dtype))

    @property
    def bones(self) -> np.ndarray:
        """(M,) int32, the same to index with."""
        return np.array(self.bone_indices, np.int32)


def forward(skeleton: Skeleton, pose: Pose) -> Frames:
    """Frames of all bones: transforms of links composed along the tree by pointer doubling.

    Each round joins every link's transform with that of its ancestor 1, 2, 4, ... links up, so a
    chain of twelve takes four batched products instead of eleven in sequence.
    """
    links = skeleton.tree.links

    def doubled(T: Array, ancestors: Array) -> tuple[Array, None]:
        return compose(T[ancestors], T), None

    # A loop compiles once, in half the time of its rounds one by one, and runs faster.
    local, doublings = _local_transforms(skeleton, pose), jnp.asarray(links.doublings)
    T_world_link = jax.lax.scan(doubled, local, doublings)[0]
    T_world_bone = T_world_link[links.last]
    # A hinge turns its own axis nowhere.
    hinges = slice(ROOT_LINK + 1, ROOT_LINK + 1 + len(pose.angles))
    axes_world = rotate(T_world_link[hinges, :3, :3], skeleton.axes)
    return Frames(pose.position, T_world_bone[:, :3, :3], T_world_bone[:, :3, 3], axes_world)


def _local_transforms(skeleton: Skeleton, pose: Pose) -> Array:
    """(L, 4, 4) of ``Tree.links`` in their parents."""
    tree, links = skeleton.tree, skeleton.tree.links
    parents = np.array(tree.parents)[links.bones]
    # A bone's joint lies at its parent's far end; without a parent, at the root.
    apart = (links.begins & (parents >= 0))[:, None]
    offsets = jnp.where(apart, (skeleton.lengths[:, None] * skeleton.directions)[parents], 0.0)
    identity = np.eye(3, dtype=offsets.dtype)[None]
    stiff = jnp.broadcast_to(identity, (len(links.bones) - len(pose.angles), 3, 3))
    R_world_root = quaternion_to_matrix(pose.quaternion)[None]
    R = [identity, R_world_root, about_axis(skeleton.axes, pose.angles), stiff]
    p = [jnp.zeros_like(pose.position)[None], pose.position[None], offsets]
    T = jnp.concatenate([jnp.concatenate(R), jnp.concatenate(p)[:, :, None]], -1)
    last = jnp.broadcast_to(np.eye(4, dtype=T.dtype)[3], (len(T), 1, 4))
    return jnp.concatenate([T, last], 1)


def site_positions(skeleton: Skeleton, frames: Frames, sites: Sites) -> Array:
    """Positions s (M, 3) of points on bones in the world, metres."""
    bones = sites.bones
    along = (sites.at * skeleton.lengths[bones])[:, None] * skeleton.directions[bones]
    return frames.joints_world[bones] + rotate(frames.R_world_bone[bones], along + sites.offsets)


def jacobian(
    skeleton: Skeleton, frames: Frames, bones: Array | np.ndarray, points_world: Array
) -> Array:
    """Derivatives (M, 3, 6 + D) of points fixed to bones, by the tangent vector of ``retract``.

    Equation (4) without its weight: v_j x (s_i - p_j) where degree of freedom j carries the bone
    of point i, else 0. The root's translations give unit columns.
    """
    tree = skeleton.tree
    dtype = points_world.dtype
    eye = np.eye(3, dtype=dtype)
    axes = jnp.concatenate([eye, frames.axes_world])
    pivots = jnp.concatenate(
        [jnp.broadcast_to(frames.root, (3, 3)), frames.joints_world[np.array(tree.dof_bones)]]
    )
    turning = cross(axes[None], points_world[:, None] - pivots[None])
    carried = jnp.asarray(tree.carries[ROOT_DOF - 3 :])[:, bones].T[..., None]
    turning = jnp.where(carried, turning, 0.0).swapaxes(1, 2)
    shifting = jnp.broadcast_to(eye, (points_world.shape[0], 3, 3))
    return jnp.concatenate([shifting, turning], -1)


def curvature(
    skeleton: Skeleton,
    frames: Frames,
    bones: Array | np.ndarray,
    points_world: Array,
    forces: Array,
) -> Array:
    """Second derivatives (6 + D, 6 + D) of points fixed to bones, times forces (M, 3), summed.

    By the tangent vector of ``retract``. Of degrees of freedom i before j on one chain it is
    v_i x (v_j x (s - p_j)); of the root's turn by itself, the mean of that and its transpose.
    """
    tree = skeleton.tree
    J = jacobian(skeleton, frames, bones, points_world)
    eye = np.eye(3, dtype=points_world.dtype)
    axes = jnp.concatenate([jnp.zeros_like(eye), eye, frames.axes_world])
    carried = np.asarray(tree.carries)[:, bones].T[..., None]
    turned = jnp.where(carried, cross(forces[:, None], axes), 0.0)
    products = jnp.einsum("mic,mcj->ij", turned, J, precision=HIGHEST)
    upper = jnp.triu(products)
    whole = upper + jnp.triu(products, 1).T
    root = products[3:ROOT_DOF, 3:ROOT_DOF]
    return whole.at[3:ROOT_DOF, 3:ROOT_DOF].set((root + root.T) / 2)


def landmark_sites(skeleton: Skeleton, names: tuple[str, ...] = LANDMARKS) -> Sites:
    """The named landmarks as sites."""
    bones = np.array([skeleton.tree.bone(LANDMARK_PLACES[name][0]) for name in names], np.int32)
    at = np.array([LANDMARK_PLACES[name][1] for name in names], skeleton.lengths.dtype)
    offsets = np.zeros((len(names), 3), at.dtype)
    return Sites(bones, jnp.asarray(at, at.dtype), jnp.asarray(offsets, at.dtype))


def joined_sites(first: Sites, second: Sites) -> Sites:
    """The points of both, in this order."""
    return Sites(
        np.concatenate([first.bones, second.bones]),
        jnp.concatenate([first.at, second.at]),
        jnp.concatenate([first.offsets, second.offsets]),
    )


def landmarks(skeleton: Skeleton, pose: Pose) -> Array:
    """Positions (L, 3) of all ``LANDMARKS``, in their order, world, metres."""
    return points_on(skeleton, pose, landmark_sites(skeleton))


@jax.custom_jvp
def points_on(skeleton: Skeleton, pose: Pose, sites: Sites) -> Array:
    """Points (M, 3) on bones in the world, metres, with the geometric Jacobian as derivative.

    The same as pushing tangents along the tree, at a fifth of the time.
    """
    return site_positions(skeleton, forward(skeleton, pose), sites)


def _points_on_jvp(primals: tuple, tangents: tuple) -> tuple[Array, Array]:
    skeleton, pose, sites = primals
    frames = forward(skeleton, pose)
    points = site_positions(skeleton, frames, sites)
    change = jnp.zeros_like(points)
    if not _is_zero(tangents[1]):
        shift, spin, turns = _fill_zeros(tangents[1])
        back = pose.quaternion * jnp.array([1.0, -1.0, -1.0, -1.0], spin.dtype)
        turn = 2 * quaternion_multiply(spin, back)[1:] / jnp.sum(back**2)
        step = jnp.concatenate([shift, turn, turns])
        J = jacobian(skeleton, frames, sites.bones, points)
        change = jnp.einsum("mij,j->mi", J, step, precision=HIGHEST)
    # Bodies and markers have tangents only where somebody differentiates a solution by them.
    others = (tangents[0], tangents[2])
    if not _is_zero(others):

        def along_the_tree(skeleton: Skeleton, sites: Sites) -> Array:
            return site_positions(skeleton, forward(skeleton, pose), sites)

        change = change + jax.jvp(along_the_tree, (skeleton, sites), _fill_zeros(others))[1]
    return points, change


points_on.defjvp(_points_on_jvp, symbolic_zeros=True)


def _symbolic(leaf: Any) -> bool:
    return isinstance(leaf, SymbolicZero)


def _is_zero(tangents: Any) -> bool:
    return all(map(_symbolic, jax.tree.leaves(tangents, is_leaf=_symbolic)))


def _fill_zeros(tangents: Any) -> Any:
    """Tangents with symbolic zeros as arrays."""

    def fill(leaf: Any) -> Array:
        return jnp.zeros(leaf.shape, leaf.dtype) if _symbolic(leaf) else leaf

    return jax.tree.map(fill, tangents, is_leaf=_symbolic)
