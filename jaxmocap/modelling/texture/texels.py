"""A person's surface as a cloud of texels, dense enough for photographs.

INPUTS: a Surface, its atlas and mesh, its nodes in some pose. OUTPUTS: places and normals.
"""

from typing import NamedTuple

import numpy as np

from jaxmocap.body.surfaces.mesh import Atlas, SurfaceMesh, normals_of
from jaxmocap.body.surfaces.surface import Surface
from jaxmocap.modelling.pictures.views import PhotographView


class SurfacePhotograph(NamedTuple):
    """A photograph of the surface.

    Attributes:
        image: (H, W, 3) BGR uint8.
        view: mask and camera.
        nodes_world: (N, 3) of the surface in the pose that it shows, in the camera's world, metres.
    """

    image: np.ndarray
    view: PhotographView
    nodes_world: np.ndarray


class Texels(NamedTuple):
    """The surface as K texels of its atlas.

    Attributes:
        rows: (K,) of the picture.
        columns: (K,) of it.
        patches: (K,) number of each one's patch.
        points: (K, 3) world, metres.
        normals: (K, 3) unit, outward.
    """

    rows: np.ndarray
    columns: np.ndarray
    patches: np.ndarray
    points: np.ndarray
    normals: np.ndarray


def texels_of(surface: Surface, atlas: Atlas, mesh: SurfaceMesh, nodes: np.ndarray) -> Texels:
    """All texels, the nodes at (N, 3)."""
    upright = np.zeros_like(nodes)
    upright[mesh.nodes] = normals_of(nodes[mesh.nodes], mesh.triangles)
    # Half a million places: single numbers are exact to a micrometre.
    both = np.concatenate([nodes, upright], 1).astype(np.float32)
    texels = []
    for i, (patch, rectangle) in enumerate(zip(surface.patches, atlas.rectangles, strict=True)):
        grid = both[patch.nodes].reshape(patch.along, patch.around, 6)
        values = rectangle.texels(grid).reshape(-1, 6)
        row, column = np.divmod(np.arange(len(values)), rectangle.width)
        number = np.full(len(values), i)
        texels.append((row + rectangle.top, column + rectangle.left, number, values))
    rows, columns, patches, values = (np.concatenate(part) for part in zip(*texels, strict=True))
    lengths = np.linalg.norm(values[:, 3:], axis=1, keepdims=True)
    return Texels(rows, columns, patches, values[:, :3], values[:, 3:] / np.maximum(lengths, 1e-9))
