"""How thick limbs are, by the body's surface.

INPUTS: a Skeleton and the Surface around it.
OUTPUTS: the Skeleton with its limbs' diameters as measured, for what takes limbs as cones.
"""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np

from jaxmocap.body.skeleton import Skeleton
from jaxmocap.body.surfaces.loft import rest_joints
from jaxmocap.body.surfaces.surface import Surface, rest_nodes

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
