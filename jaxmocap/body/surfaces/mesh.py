"""A body's surface as one mesh of triangles, and where its patches lie on a flat picture: an atlas.

INPUTS: a Surface, its nodes at rest. OUTPUTS: triangles, places on the picture, normals.

Every patch has a rectangle of its own, u around the limb from left to right, v along it downwards.
A ring's first node is there twice, at both ends of its row, so that the picture closes around.
"""

from typing import NamedTuple

import numpy as np

from jaxmocap.body.surfaces.surface import BodyPoints, Patch, Surface
from jaxmocap.geometry.fourier import linear_matrix

# Texels left free around a rectangle, for colours that run over: viewers blend neighbours.
MARGIN = 4
# Vertices nearer than this are one point of the surface, metres.
SAME_M = 1e-5


class Rectangle(NamedTuple):
    """Where a patch lies on the picture."""

    left: int  # column of its first texel
    top: int  # row of it
    width: int  # texels, from the ring's first node all the way around to it
    height: int  # texels
    # (along,) places of the rings from the first row, 0, to the last, 1: by their distance on the
    # surface.
    levels: np.ndarray

    def texels(self, grid: np.ndarray) -> np.ndarray:
        """(height, width, C) values between the nodes' (along, around, C)."""
        rows = np.interp(np.linspace(0, 1, self.height), self.levels, np.arange(len(grid)))
        around = grid.shape[1]
        columns = np.linspace(0, around, self.width) % around
        onto = linear_matrix(len(grid), rows).astype(grid.dtype)
        across = linear_matrix(around, columns, periodic=True).astype(grid.dtype)
        return np.einsum("av,vuc,bu->abc", onto, grid, across, optimize=True)

    @property
    def within(self) -> tuple[slice, slice]:
        """Its rows and columns of the picture."""
        return self.with_margin(0)

    def with_margin(self, margin: int) -> tuple[slice, slice]:
        """Rows and columns with a margin about it, texels."""
        return (
            slice(self.top - margin, self.top + self.height + margin),
            slice(self.left - margin, self.left + self.width + margin),
        )


class Atlas(NamedTuple):
    """A picture's layout."""

    width: int  # of the picture, texels
    height: int  # of it
    rectangles: tuple[Rectangle, ...]  # of the patches, in their order


class SurfaceMesh(NamedTuple):
    """V vertices and F triangles."""

    nodes: np.ndarray  # (V,) the surface's node at each vertex
    places: np.ndarray  # (V, 2) on the atlas, from 0 to 1, rightwards and downwards
    triangles: np.ndarray  # (F, 3) vertices, counter-clockwise from outside


def atlas_of(surface: Surface, nodes: np.ndarray, texel: float) -> Atlas:
    """Lay the patches out in rows, the tallest first, on a picture about as wide as high.

    Args:
        surface: of the body.
        nodes: (N, 3) of it at rest, metres.
        texel: size of the picture's texels on the surface, metres.
    """
    sizes = [_size(patch.grid(nodes), texel) for patch in surface.patches]
    area = sum((w + 2 * MARGIN) * (h + 2 * MARGIN) for w, h, _ in sizes)
    wide = max(int(1.1 * area**0.5), *(w + 2 * MARGIN for w, _, _ in sizes))
    rectangles: dict[int, Rectangle] = {}
    left = top = tall = 0
    for i in sorted(range(len(sizes)), key=lambda i: -sizes[i][1]):
        width, height, levels = sizes[i]
        if left + width + 2 * MARGIN > wide:
            left, top, tall = 0, top + tall, 0
        rectangles[i] = Rectangle(left + MARGIN, top + MARGIN, width, height, levels)
        left, tall = left + width + 2 * MARGIN, max(tall, height + 2 * MARGIN)
    return Atlas(wide, top + tall, tuple(rectangles[i] for i in range(len(sizes))))


def _size(grid: np.ndarray, texel: float) -> tuple[int, int, np.ndarray]:
    """Width and height of a patch's nodes (along, around, 3), texels; levels of its rings."""
    girth = np.linalg.norm(np.roll(grid, -1, 1) - grid, axis=-1).sum(1).max()
    gaps = np.linalg.norm(np.diff(grid, axis=0), axis=-1).mean(1)
    way = np.append(0.0, np.cumsum(np.maximum(gaps, SAME_M)))
    width, height = (max(int(np.ceil(length / texel)), 2) for length in (girth, way[-1]))
    return width, height, way / way[-1]


def coarser(surface: Surface, nodes: np.ndarray, spacing: float) -> Surface:
    """The surface with fewer of its nodes (N, 3), about ``spacing`` metres apart: for pictures."""
    patches, kept, start = [], [], 0
    for patch in surface.patches:
        width, height, levels = _size(patch.grid(nodes), spacing)
        around, along = min(max(width, 8), patch.around), min(max(height, 4), patch.along)
        columns = np.arange(around) * patch.around // around
        # The nearest rings to even places; ends, where a ring is a point, stay.
        even = np.arange(patch.along)
        if along < patch.along:
            even = np.interp(np.linspace(0, 1, along), levels, np.arange(patch.along))
        ends = [0, 1, patch.along - 2, patch.along - 1]
        rows = np.unique(np.append(np.rint(even), ends)).astype(int)
        kept.append((patch.start + rows[:, None] * patch.around + columns).ravel())
        patches.append(Patch(patch.name, around, len(rows), start))
        start += around * len(rows)
    chosen = np.concatenate(kept)
    points = BodyPoints(*(np.asarray(part)[chosen] for part in surface.points))
    return Surface(tuple(patches), points)


def mesh_of(surface: Surface, nodes: np.ndarray, atlas: Atlas) -> SurfaceMesh:
    """The surface's mesh, its nodes (N, 3) at rest."""
    numbers, places, triangles, count = [], [], [], 0
    for patch, rectangle in zip(surface.patches, atlas.rectangles, strict=True):
        ring, column = np.divmod(np.arange(patch.along * (patch.around + 1)), patch.around + 1)
        own = patch.start + ring * patch.around + column % patch.around
        x = rectangle.left + column / patch.around * (rectangle.width - 1)
        y = rectangle.top + rectangle.levels[ring] * (rectangle.height - 1)
        places.append(np.stack([x + 0.5, y + 0.5], 1) / [atlas.width, atlas.height])
        faces = grid_triangles(patch.along, patch.around)
        triangles.append(count + facing_outwards(nodes[own], faces))
        numbers.append(own)
        count += len(own)
    return SurfaceMesh(np.concatenate(numbers), np.concatenate(places), np.concatenate(triangles))


def grid_triangles(along: int, around: int) -> np.ndarray:
    """(F, 3) of a grid of ``along`` by ``around + 1`` vertices, row by row."""
    row, column = np.divmod(np.arange((along - 1) * around), around)
    a = row * (around + 1) + column
    b, c, d = a + 1, a + around + 2, a + around + 1
    return np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])


def facing_outwards(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """The triangles, turned over where the volume within them would be negative."""
    a, b, c = np.moveaxis((vertices - vertices.mean(0))[triangles], 1, 0)
    return triangles if np.sum(a * np.cross(b, c)) > 0 else triangles[:, ::-1]


def normals_of(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(V, 3) unit normals: of the triangles about a point, the large ones counting more."""
    a, b, c = np.moveaxis(vertices[triangles], 1, 0)
    across = np.cross(b - a, c - a)
    # The seam and the ends, where a ring is a point, are several vertices in one place.
    _, point = np.unique(np.rint(vertices / SAME_M).astype(np.int64), axis=0, return_inverse=True)
    point = point.reshape(-1)
    total = np.zeros((point.max() + 1, 3))
    np.add.at(total, point[triangles], across[:, None])
    length = np.linalg.norm(total, axis=1, keepdims=True)
    upright = np.where(length > 0, total / np.maximum(length, 1e-30), [0.0, 0.0, 1.0])
    return upright[point]
