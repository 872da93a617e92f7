"""Limbs: which bones and joints an arm or a leg has, and how thick it is.

INPUTS: a skeleton and a surface around it; poses. OUTPUTS: Limbs; where their bones are.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.kinematics import forward
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.body.surfaces.surface import BodyPoints, Surface


class LimbChain(NamedTuple):
    """A limb of B bones and K joints, by their indices, and the bones' radii (B,), metres."""

    bones: np.ndarray
    joints: np.ndarray
    radii: np.ndarray


def limb_chains(skeleton: Skeleton, surface: Surface) -> dict[str, LimbChain]:
    """``arm_l`` and so on, those of which the skeleton has joints to search by."""
    tree, chains = skeleton.tree, {}
    turned = np.array(tree.dof_bones, np.int32)
    for kind in ("arm", "leg"):
        for side in "lr":
            bones = tree.bones_in(kind, side=side)
            on_side = [tree.segments[bone].side == side for bone in turned]
            joints = np.flatnonzero((np.array(tree.searched) == kind) & on_side)
            if len(bones) and len(joints):
                # From the body outwards.
                joints = joints[np.argsort(turned[joints], kind="stable")].astype(np.int32)
                radii = bone_radii(skeleton, surface, bones)
                chains[f"{kind}_{side}"] = LimbChain(bones, joints, radii)
    return chains


def halves_of(limb: LimbChain) -> tuple[LimbChain, LimbChain]:
    """The limb's first bone, and what follows it: what is left out is given no thickness."""
    first = np.arange(len(limb.bones)) < 1
    return tuple(limb._replace(radii=np.where(of, limb.radii, 0)) for of in (first, ~first))  # type: ignore[return-value]


def with_angles(pose: Pose, limb: LimbChain, angles: Array | np.ndarray) -> Pose:
    """A pose whose limb has other angles (K,)."""
    return pose._replace(angles=pose.angles.at[limb.joints].set(angles))


def bone_ends(skeleton: Skeleton, pose: Pose, limb: LimbChain) -> tuple[Array, Array]:
    """(B, 3) near and far ends of a limb's bones in the world, metres."""
    frames = forward(skeleton, pose)
    near = frames.joints_world[limb.bones]
    reach = (skeleton.lengths[:, None] * skeleton.directions)[limb.bones]
    return near, near + jnp.sum(frames.R_world_bone[limb.bones] * reach[:, None], -1)


def bone_radii(skeleton: Skeleton, surface: Surface, bones: np.ndarray) -> np.ndarray:
    """(B,) metres from bones to the surface's nodes that they carry alone or most."""
    carrier, places = carrying_bones(surface.points)
    ways = np.asarray(skeleton.directions)
    radii = []
    for bone in bones:
        at = places[carrier == bone]
        away = np.linalg.norm(np.cross(at, ways[bone]), axis=1)
        radii.append(np.median(away) if len(at) else 0.03)
    return np.array(radii, np.float32)


def carrying_bones(points: BodyPoints) -> tuple[np.ndarray, np.ndarray]:
    """(N,) the bone that carries most of each point, and (N, 3) the point in its frame."""
    bones, shares = np.asarray(points.bones), np.asarray(points.shares)
    rows, most = np.arange(len(bones)), shares.argmax(1)
    return bones[rows, most], np.asarray(points.points_bone)[rows, most]


def bins_along(
    skeleton: Skeleton, limb: LimbChain, points: BodyPoints, shares: np.ndarray
) -> np.ndarray:
    """(N,) numbers of the places, A of each bone one after the other, that points lie nearest to.

    -1 of points elsewhere. Places lie at ``shares`` (A,) of a bone's length.
    """
    carrier, places = carrying_bones(points)
    numbers = np.full(len(carrier), -1)
    for row, bone in enumerate(limb.bones):
        on = carrier == bone
        length = max(float(skeleton.lengths[bone]), 1e-6)
        at = places[on] @ np.asarray(skeleton.directions)[bone] / length
        numbers[on] = row * len(shares) + np.abs(at[:, None] - shares).argmin(1)
    return numbers
