"""What hides what: crossed arms, and arms behind the body, must not claim each other's edges.

INPUTS: both arms and the torso in the world, a camera, points of outlines.
OUTPUTS: which of the points another limb hides from that camera.
"""

import jax
import jax.numpy as jnp
from jax import Array

from jaxmocap.body.arms import Arms, flesh
from jaxmocap.body.kinematics import Frames
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.body.surfaces.cones import Cones, cones
from jaxmocap.geometry.cameras import Camera, to_camera
from jaxmocap.geometry.outlines import Discs, depth_along, project_limb, touch

# A limb must be nearer by this, between the axes, to hide another, metres: limbs side by side and
# the shoulder on its own chest hide nothing.
NEARER_M = 0.04


def blockers(skeleton: Skeleton, frames: Frames, arms: Arms) -> Cones:
    """What may hide each arm: (2, N) cones, the other arm's limbs and then the torso's."""
    torso = cones(skeleton, frames, skeleton.tree.bones_in("spine"))
    crossed = jax.tree.map(lambda part: part[::-1], flesh(arms))
    return jax.tree.map(
        lambda other, own: jnp.concatenate([other, jnp.broadcast_to(own, (2, *own.shape))], 1),
        crossed,
        torso,
    )


def hidden(camera: Camera, limbs: Cones, points: Array, others: Cones) -> Array:
    """Which points of one arm's outline lie behind another limb.

    Args:
        camera: that sees them.
        limbs: three cones, world.
        points: (3, K, 2) on the limbs' outlines, on the plane z = 1.
        others: N cones that may hide them, world.

    Returns:
        (3, K) True where hidden.
    """
    near, far = to_camera(camera, limbs.near), to_camera(camera, limbs.far)
    x, y = points[..., 0], points[..., 1]
    limb = Discs(*(part[:, None] for part in project_limb(near, far, limbs.radii)))
    own = depth_along(touch(limb, x, y), near[:, 2:], far[:, 2:])

    def behind(other: Cones) -> Array:
        a, b = to_camera(camera, other.near), to_camera(camera, other.far)
        at = touch(project_limb(a, b, other.radii), x, y)
        seen = jnp.minimum(a[2], b[2]) > 0
        return (at.distance < 0) & seen & (depth_along(at, a[2], b[2]) + NEARER_M < own)

    return jnp.any(jax.vmap(behind)(others), 0)
