"""Meshes of quadrilaterals that follow moving bones.

INPUTS: rings along an axis, or a skinned mesh with moving frames.
OUTPUTS: a Mesh; its vertices over time, world, metres.
"""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class QuadMesh:
    """V vertices in F quadrilaterals, skinned to bones by linear blending."""

    vertices: np.ndarray  # (V, 3) at rest, metres
    faces: np.ndarray  # (F, 4) vertex indices, anticlockwise seen from outside
    colours: np.ndarray  # (F, 3) reflectance, BGR, 0 to 1
    bones: np.ndarray  # (V, K) indices of the bones that carry a vertex
    weights: np.ndarray  # (V, K) their shares, adding up to 1

    def pose_vertices(self, R_world_bone: np.ndarray, shifts: np.ndarray) -> np.ndarray:
        """Vertices (T, V, 3) with the bones moved by turns (T, B, 3, 3) from their rest.

        ``shifts`` (T, B, 3) are where a bone's turn takes the rest frame's origin, metres.
        """
        frames = np.concatenate([R_world_bone, shifts[..., None]], -1)
        blended = np.zeros((len(frames), len(self.vertices), 3, 4))
        for bones, weights in zip(self.bones.T, self.weights.T, strict=True):
            blended += weights[:, None, None] * frames[:, bones]
        return np.einsum("tvij,vj->tvi", blended[..., :3], self.vertices) + blended[..., 3]


def merged_meshes(parts: list[QuadMesh]) -> QuadMesh:
    """One mesh of several with equally many bones per vertex."""
    starts = np.cumsum([0, *(len(part.vertices) for part in parts[:-1])])
    return QuadMesh(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.faces + start for part, start in zip(parts, starts, strict=True)]),
        np.concatenate([part.colours for part in parts]),
        np.concatenate([part.bones for part in parts]),
        np.concatenate([part.weights for part in parts]),
    )


def grid_faces(rings: int, sides: int) -> np.ndarray:
    """(F, 4) quadrilaterals between ``rings`` closed rings of ``sides`` vertices each."""
    k, n = np.meshgrid(np.arange(rings - 1), np.arange(sides), indexing="ij")
    here, beside = k * sides + n, k * sides + (n + 1) % sides
    return np.stack([here, beside, beside + sides, here + sides], -1).reshape(-1, 4)


def loft(
    centres: np.ndarray,
    radii: np.ndarray,
    across: tuple[np.ndarray, np.ndarray],
    sides: int,
    exponent: float = 2.0,
    swell: np.ndarray | float = 1.0,
) -> np.ndarray:
    """Vertices (K * sides, 3) of superellipses along an axis.

    Args:
        centres: (K, 3) of the rings.
        radii: (K, 2) along the two directions ``across``.
        across: two unit vectors (3,); their cross product points along the axis, so that faces
            of ``grid_faces`` look outward.
        sides: vertices per ring.
        exponent: 2 is an ellipse, more is boxier.
        swell: (K, sides) factors on the radii, for folds.
    """
    angles = 2 * np.pi * np.arange(sides) / sides
    power, (c, s) = 2 / exponent, (np.cos(angles), np.sin(angles))
    u = radii[:, :1] * (np.sign(c) * np.abs(c) ** power) * swell
    v = radii[:, 1:] * (np.sign(s) * np.abs(s) ** power) * swell
    points = centres[:, None] + u[..., None] * across[0] + v[..., None] * across[1]
    return points.reshape(-1, 3)


def waves(
    rng: np.random.Generator, rings: int, sides: int, around: int = 5, along: float = 3.0
) -> np.ndarray:
    """Smooth noise (rings, sides), about unit deviation, periodic around the ring."""
    t = np.linspace(0, 1, rings)[:, None]
    angle = 2 * np.pi * np.arange(sides)[None] / sides
    total = np.zeros((rings, sides))
    for _ in range(6):
        turns, phase = rng.integers(0, around + 1), rng.uniform(0, 2 * np.pi)
        total += np.cos(turns * angle + 2 * np.pi * rng.uniform(-along, along) * t + phase)
    return total / np.sqrt(3.0)
