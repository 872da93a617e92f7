"""Closed meshes of rings: every patch watertight.

INPUTS: rings (K, N, 3) along a limb. OUTPUTS: vertices and triangles, anticlockwise from outside.
"""

import numpy as np


def closed_mesh(rings: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (K N + 2, 3) and triangles (F, 3): the rings, and a fan over either end."""
    count, around, _ = rings.shape
    ends = np.stack([rings[0].mean(0), rings[-1].mean(0)])
    vertices = np.concatenate([rings.reshape(-1, 3), ends])
    here = np.arange((count - 1) * around)
    beside = here // around * around + (here + 1) % around
    sides = np.concatenate(
        [
            np.stack([here, beside, beside + around], 1),
            np.stack([here, beside + around, here + around], 1),
        ]
    )
    first, next_ = np.arange(around), (np.arange(around) + 1) % around
    last = (count - 1) * around
    low = np.stack([next_, first, np.full(around, count * around)], 1)
    high = np.stack([last + first, last + next_, np.full(around, count * around + 1)], 1)
    faces = np.concatenate([sides, low, high])
    return vertices, faces if volume(vertices, faces) > 0 else faces[:, ::-1]


def volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Enclosed by a closed mesh, cubic metres; negative where it is inside out."""
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    return float(np.sum(a * np.cross(b, c)) / 6)


def joined_meshes(patches: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """One mesh of several patches of rings, each of them closed."""
    meshes = [closed_mesh(rings) for rings in patches]
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in meshes[:-1])])
    return (
        np.concatenate([vertices for vertices, _ in meshes]),
        np.concatenate([faces + start for (_, faces), start in zip(meshes, starts, strict=True)]),
    )
