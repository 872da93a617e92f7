"""Limbs as triangle meshes, for viewers.

INPUTS: a bone's vector and the radii of its flesh. OUTPUTS: vertices, normals, triangles.
"""

from typing import NamedTuple

import numpy as np

# Corners around a limb, and rings on each of its round ends.
CORNERS, RINGS = 20, 6


class Solid(NamedTuple):
    """A closed mesh of V vertices and F triangles."""

    vertices: np.ndarray  # (V, 3) in the bone's frame, metres
    normals: np.ndarray  # (V, 3) unit, outward
    triangles: np.ndarray  # (F, 3) vertex indices, counter-clockwise from outside


def limb_solid(reach: np.ndarray, radii: np.ndarray) -> Solid:
    """The hull of two spheres, at a bone's joint and at its far end.

    Args:
        reach: (3,) from the joint to the far end, in the bone's frame, metres.
        radii: (2,) of the spheres at the joint and at the far end, metres.
    """
    length = float(np.linalg.norm(reach))
    axis = reach / length
    side = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    side /= np.linalg.norm(side)
    # On the cone between the spheres the normal leans towards the thinner one.
    lean = np.arcsin(np.clip((radii[0] - radii[1]) / length, -1.0, 1.0))
    lifts = np.concatenate(
        [np.linspace(-np.pi / 2, lean, RINGS), np.linspace(lean, np.pi / 2, RINGS)]
    )
    turns = np.arange(CORNERS) * 2 * np.pi / CORNERS
    around = np.cos(turns)[:, None] * side + np.sin(turns)[:, None] * np.cross(axis, side)
    normals = np.cos(lifts)[:, None, None] * around + np.sin(lifts)[:, None, None] * axis
    far = np.repeat([0.0, 1.0], RINGS)[:, None, None]
    vertices = far * reach + np.repeat(radii, RINGS)[:, None, None] * normals
    return Solid(
        vertices.reshape(-1, 3), normals.reshape(-1, 3), ring_triangles(2 * RINGS, CORNERS)
    )


def ring_triangles(rings: int, corners: int) -> np.ndarray:
    """(F, 3) two triangles for each face between neighbouring rings."""
    a = np.arange((rings - 1) * corners)
    b = a // corners * corners + (a + 1) % corners
    c, d = b + corners, a + corners
    return np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)])
