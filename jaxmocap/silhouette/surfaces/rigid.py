"""A rigid object's surface and its rims (second paper, 3.1.5, Figs. 10 to 12).

INPUTS: a grid of nodes in the object's frame; a pose, cameras.
OUTPUTS: the surface and its low-passes; the rim that each camera sees.
"""

import numpy as np
from jax import Array

from jaxmocap.body.surfaces.surface import low_pass, resample_surface, rest_nodes, surface_from_rest
from jaxmocap.compilation.programs import program
from jaxmocap.geometry import twists
from jaxmocap.geometry.cameras import Camera
from jaxmocap.silhouette.surfaces.body_shape import FULL
from jaxmocap.silhouette.surfaces.rim import (
    ProjectedNodes,
    Rim,
    RimSettings,
    RimTracer,
    on_canvases,
)

# Two cells of a gap are closed: they are smaller where an object points at the camera.
RIM = RimSettings(size=96, outer=128, inner=0, outwards=24, along=0.05)
# Of nodes, at most: ``index_image`` numbers no more than twice as many.
MOST_NODES = 60_000
# Of low-passes, around; along, where a surface has ends, twice as many half waves.
HARMONICS = (1, 2, 4, 8)
# The one bone of a surface that nothing bends lies at its frame's origin.
ORIGIN = np.zeros((1, 3))


class RigidSurface:
    """A surface F(phi1, phi2) of two parameters, (3.16), that nothing bends.

    Attributes:
        harmonics: of its low-passes, (3.17), coarse to fine.
        nodes: of each low-pass and of the surface (M, 3), object's frame, metres.
    """

    def __init__(self, grid: np.ndarray):
        """Make it as dense as rims need it.

        Args:
            grid: (V, U, 3) nodes in the object's frame, metres: V rings of U nodes, the ends
                closed where the first and the last are points.

        Raises:
            ValueError: a grid of another shape.
        """
        shape = np.shape(grid)
        if len(shape) != 3 or shape[2] != 3 or shape[0] < 2 or shape[1] < 3:
            raise ValueError(f"found a grid {shape}, expected (V, U, 3) with V >= 2 and U >= 3")
        grid = np.asarray(grid, float)
        sparse = surface_from_rest({"object": grid}, {"object": np.ones((*shape[:2], 1))}, ORIGIN)
        dense = resample_surface(sparse, ORIGIN, _spacing(grid))
        low = [low_pass(dense, ORIGIN, each, 2 * each) for each in HARMONICS]
        self.harmonics = HARMONICS
        self.nodes = [rest_nodes(each, ORIGIN).astype(np.float32) for each in (*low, dense)]
        self._tracer = RimTracer(dense, RIM)

    def rim(self, T_world_object: Array, cameras: Camera, level: int = FULL) -> Rim:
        """What C cameras (stacked) see of it at a pose (4, 4)."""
        return self._tracer.rim(_project_nodes(self.nodes[level], T_world_object, cameras))


@program("full")
def _project_nodes(nodes: Array, T_world_object: Array, cameras: Camera) -> ProjectedNodes:
    x, y, z = twists.move(T_world_object.astype(nodes.dtype), nodes).T
    return on_canvases((x, y, z), cameras, RIM)


def _spacing(grid: np.ndarray) -> float:
    """Metres between nodes: a cell of the canvas, where there are not too many of them."""
    cell = np.sort(np.ptp(grid.reshape(-1, 3), axis=0))[1] / RIM.size
    girth = np.linalg.norm(np.roll(grid, -1, 1) - grid, axis=-1).sum(1).max()
    length = np.linalg.norm(np.diff(grid, axis=0), axis=-1).max(1).sum()
    return float(max(cell, np.sqrt(girth * length / MOST_NODES)))
