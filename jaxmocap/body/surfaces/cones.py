"""Flesh on bones: each limb a sphere-swept cone (the paper's cylinders, tapered and round-ended).

INPUTS: a Skeleton and its Frames; a Camera.
OUTPUTS: end points and radii, world, metres; the same as discs in the image, pixels.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.kinematics import Frames
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.geometry.cameras import Camera, radii_in_pixels, to_camera, to_pixels
from jaxmocap.geometry.outlines import Discs, project_limb
from jaxmocap.geometry.rotations import rotate


class Cones(NamedTuple):
    """N sphere-swept cones.

    Attributes:
        near: (N, 3) centres of the spheres at the joints.
        far: (N, 3) centres of the spheres at the far ends.
        radii: (N, 2) of the two spheres, metres.
    """

    near: Array
    far: Array
    radii: Array


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
