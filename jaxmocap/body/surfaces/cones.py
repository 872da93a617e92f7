"""Flesh on bones: each limb a sphere-swept cone (the paper's cylinders, tapered and round-ended).

INPUTS: a Skeleton and its Frames; a Camera.
OUTPUTS: end points and radii, world, metres; the same as discs in the image, pixels.
"""

from dataclasses import replace
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.kinematics import Frames
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.body.subject import rest_joints
from jaxmocap.body.surfaces.surface import Surface, rest_nodes
from jaxmocap.geometry.cameras import Camera, radii_in_pixels, to_camera, to_pixels
from jaxmocap.geometry.outlines import Discs, project_limb
from jaxmocap.geometry.rotations import rotate


class Cones(NamedTuple):
    """N sphere-swept cones."""

    near: Array  # (N, 3) centres of the spheres at the joints
    far: Array  # (N, 3) centres of the spheres at the far ends
    radii: Array  # (N, 2) of the two spheres, metres


def cones(skeleton: Skeleton, frames: Frames, bones: np.ndarray) -> Cones:
    """The flesh of the given bones (static indices), in the world."""
    reach = skeleton.lengths[bones, None] * skeleton.directions[bones]
    near = frames.joints_world[bones]
    far = near + rotate(frames.R_world_bone[bones], reach)
    return Cones(near, far, skeleton.diameters[bones] / 2)


def project_cones(camera: Camera, flesh: Cones) -> Discs:
    """Limbs (N) in the image, pixels."""
    plane = project_limb(to_camera(camera, flesh.near), to_camera(camera, flesh.far), flesh.radii)
    ends = to_pixels(camera, plane.near), to_pixels(camera, plane.far)
    centres = jnp.stack([plane.near, plane.far], -2)
    return Discs(*ends, radii_in_pixels(camera, centres, plane.radii))


# Patches of limbs, and the bones that are as thick as these.
MEASURED = {"arm": ("upper_arm", "forearm"), "leg": ("thigh", "shank")}
# A limb's rings from here to there along its bone, as a share of it: joints and muscles at its ends
# belong to others. A cone through these gives the ends.
FROM, TO = 0.2, 0.9
THINNEST_M = 0.02


def with_thickness(skeleton: Skeleton, surface: Surface) -> Skeleton:
    """The skeleton whose arms and legs are as thick as the surface."""
    joints, diameters = rest_joints(skeleton), np.array(skeleton.diameters, float)
    nodes = rest_nodes(surface, joints)
    for patch in surface.patches:
        grid = patch.grid(nodes)
        middles = grid.mean(1)
        girths = np.linalg.norm(np.roll(grid, -1, 1) - grid, axis=-1).sum(1)
        for bone in skeleton.tree.bones_in(*MEASURED.get(patch.limb, ()), side=patch.side):
            axis = np.asarray(skeleton.directions[bone], float) * float(skeleton.lengths[bone])
            at = (middles - joints[bone]) @ axis / (axis @ axis)
            kept = (at > FROM) & (at < TO)
            if kept.sum() >= 3:
                slope, start = np.polyfit(at[kept], girths[kept] / np.pi, 1)
                diameters[bone] = np.maximum([start, start + slope], THINNEST_M)
    dtype = jnp.asarray(skeleton.diameters).dtype
    return replace(skeleton, diameters=jnp.asarray(diameters, dtype))
