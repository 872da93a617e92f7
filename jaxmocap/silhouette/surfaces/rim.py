"""The rim of the surface as each camera sees it: what its silhouette is made of (3.1.5, 3.2).

INPUTS: a Surface around a Skeleton, a pose, C cameras.
OUTPUTS: for each camera nodes of the surface on its occluding boundary, with the pixel where they
appear and the direction out of the body; boundaries between limbs, flagged, as well.

The surface is made denser than the canvas, projected, and its index image traced; so limbs before
the trunk hide it. A cell's node is the nearest in it, not the outermost: the node is then moved
along the surface to where it stands out farthest. The rim is found anew in every cycle.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.kinematics import forward
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.body.subject import rest_joints
from jaxmocap.body.surfaces.morphing import Morphing
from jaxmocap.body.surfaces.surface import (
    Skin,
    Surface,
    resample_surface,
    skin_nodes,
)
from jaxmocap.compilation.programs import Program
from jaxmocap.geometry.cameras import (
    NEAREST_M,
    Camera,
    camera_components,
    pixel_components_anywhere,
)
from jaxmocap.images.regions import Region, region_around
from jaxmocap.silhouette.surfaces.body_shape import FULL, BodyShape
from jaxmocap.silhouette.surfaces.index_image import (
    Boundary,
    body_mask,
    index_image,
    inner_boundary,
    node_keys,
    outer_boundary,
    subsample_rows,
)
from jaxmocap.silhouette.surfaces.morph import Morph, morphed_skin
from jaxmocap.silhouette.surfaces.swelling import morph_around


@dataclass(frozen=True)
class RimSettings:
    """Sizes; static."""

    size: int = 192  # of the canvas, cells
    outer: int = 256  # rim points kept of each camera, evenly along the outline
    inner: int = 96  # those kept of boundaries between limbs; 0 does not look for them
    spacing: float = 0.009  # of the denser surface's nodes, metres
    jump: float = 0.04  # in depth that makes a boundary between limbs, metres
    margin: float = 0.03  # around the person, as a fraction of its extent
    finest: float = 0.25  # image pixels to a cell, at least
    outwards: int = 3  # steps of a node to a neighbour farther out along its normal, at most
    along: float = 0.0  # price of a cell that it goes along the outline, in cells farther out
    # Of the surface's low-passes, coarse to fine: harmonics around and waves along each limb.
    levels: tuple[tuple[int, int], ...] = ((1, 4), (2, 8), (4, 16))


class Rim(NamedTuple):
    """R points of each of C cameras, padded."""

    nodes: np.ndarray  # (C, R) of the denser surface
    pixels_xy: np.ndarray  # (C, R, 2) their projections, in the full image
    normals: np.ndarray  # (C, R, 2) unit vectors in the image, out of the body
    inner: np.ndarray  # (C, R) is it a boundary between limbs, which no mask shows?
    valid: np.ndarray  # (C, R) False for padding, and beyond the image's border
    masks: np.ndarray  # (C, size, size) uint8 of the body on the canvases
    region: Region  # the canvases' places in the images


class ProjectedNodes(NamedTuple):
    """M nodes as C cameras see them."""

    u: Any  # (C, M) pixel's column in the whole image
    v: Any  # (C, M) its row
    depth: Any  # (C, M) metres
    shown: Any  # (C, M) is it within the image?
    places: Any  # (C, M) on the canvas
    keys: Any  # (C, M) for ``index_image``
    region: Region  # of the canvases


def on_canvases(
    nodes: tuple[Array, Array, Array], cameras: Camera, settings: RimSettings
) -> ProjectedNodes:
    """Nodes in the world, by components (M,), as C cameras see them on canvases about them."""
    x, y, z = nodes

    def one(camera: Camera) -> ProjectedNodes:
        at_cam = camera_components(camera, x, y, z)
        depth = jnp.maximum(at_cam[2], NEAREST_M)
        # Polynomials of a lens fold nodes that are far outside back into the image.
        u, v = pixel_components_anywhere(camera, at_cam[0] / depth, at_cam[1] / depth)
        corners = jnp.stack([jnp.stack([jnp.min(u), jnp.min(v)]),
                             jnp.stack([jnp.max(u), jnp.max(v)])])  # fmt: skip
        region = region_around(corners, settings.size, settings.margin, settings.finest)
        column = (u - region.origin[0]) / region.scale - 0.5
        row = (v - region.origin[1]) / region.scale - 0.5
        places, keys = node_keys(column, row, depth, settings.size)
        width, height = camera.size[0], camera.size[1]
        shown = (u > -0.5) & (u < width - 0.5) & (v > -0.5) & (v < height - 0.5)
        return ProjectedNodes(u, v, depth, shown, places, keys, region)

    return jax.vmap(one)(cameras)


class RimTracer:
    """Traces rims on the canvases of surfaces that are alike node for node."""

    def __init__(self, surface: Surface, settings: RimSettings):
        """Remember which nodes lie beside one another, and on which limb."""
        self._settings = settings
        self._neighbours = neighbours(surface)
        # A foot and its leg are one.
        names = [patch.continued for patch in surface.patches]
        numbers = np.array([names.index(name) for name in names], np.uint8)
        self._limbs = numbers[surface.patch_of()]

    def rim(self, projected: ProjectedNodes) -> Rim:
        """The rims of C cameras."""
        projected = jax.tree.map(np.asarray, projected)
        count = len(projected.u)
        views = [jax.tree.map(lambda part, c=c: part[c], projected) for c in range(count)]
        rows = zip(*(self._of_camera(view) for view in views), strict=True)
        nodes, pixels, normals, inner, valid, masks = (np.stack(parts) for parts in rows)
        return Rim(nodes, pixels, normals, inner, valid, masks, projected.region)

    def _of_camera(self, projected: ProjectedNodes) -> tuple[np.ndarray, ...]:
        """One camera's row of all fields but the region."""
        s = self._settings
        keys = index_image(projected.places, projected.keys, s.size)
        mask = body_mask(keys)
        boundaries = [outer_boundary(keys, mask, s.outer)]
        if s.inner:
            inner = inner_boundary(keys, projected.depth, s.jump, self._limbs)
            boundaries.append(Boundary(*subsample_rows(inner, s.inner)))
        nodes, normals = np.zeros(s.outer + s.inner, int), np.zeros((s.outer + s.inner, 2))
        real = np.zeros(len(nodes), bool)
        for part, start in zip(boundaries, (0, s.outer), strict=False):
            rows = np.s_[start : start + len(part.nodes)]
            nodes[rows], normals[rows], real[rows] = part.nodes, part.normals, True
        nodes = self._outermost(nodes, normals, projected)
        pixels = np.stack([projected.u[nodes], projected.v[nodes]], 1)
        # Of what is cut off there is no contour to lie on.
        real &= projected.shown[nodes]
        is_inner = np.arange(len(nodes)) >= s.outer
        return nodes, pixels, normals.astype(pixels.dtype), is_inner, real, mask

    def _outermost(
        self, nodes: np.ndarray, normals: np.ndarray, projected: ProjectedNodes
    ) -> np.ndarray:
        """Nodes (R,) moved to neighbours that appear farthest along the normals."""
        u, v = projected.u[nodes, None], projected.v[nodes, None]
        price = self._settings.along / float(projected.region.scale)
        for _ in range(self._settings.outwards):
            options = self._neighbours[nodes]
            x, y = projected.u[options] - u, projected.v[options] - v
            out = x * normals[:, :1] + y * normals[:, 1:]
            if price:
                out = out - price * (x * normals[:, 1:] - y * normals[:, :1]) ** 2
            nodes = options[np.arange(len(nodes)), out.argmax(1)]
        return nodes


@lru_cache
def _projection(settings: RimSettings) -> Program:
    """The program of what C cameras see of all nodes: their places on canvases about the person."""

    def projected_nodes(
        skin: Skin, morph: Morph | None, skeleton: Skeleton, pose: Pose, cameras: Camera
    ) -> ProjectedNodes:
        skin = skin if morph is None else morphed_skin(skin, morph, pose.angles)
        return on_canvases(skin_nodes(forward(skeleton, pose), skin), cameras, settings)

    return Program(projected_nodes, "projected_nodes", settings, "full")


class RimFinder:
    """Finds rims of surfaces that are alike node for node.

    Attributes:
        initial_shape: of the person, before any pass has corrected it.
        settings: static.
        morph: what of it goes along with the joints' angles; None if nothing does.
    """

    def __init__(
        self,
        skeleton: Skeleton,
        surface: Surface,
        settings: RimSettings | None = None,
        morphing: Morphing | None = None,
    ):
        """Prepare for a surface around a skeleton; traces once for a number of cameras."""
        self.settings = settings or RimSettings()
        joints, spacing = rest_joints(skeleton), self.settings.spacing
        self.initial_shape = self.shape_of(skeleton, resample_surface(surface, joints, spacing))
        self.morph = None
        if morphing is not None and morphing.drivers:
            self.morph = morph_around(morphing, skeleton.tree, surface, joints, spacing)
        self._tracer = RimTracer(self.initial_shape.surface, self.settings)
        self._project = _projection(self.settings)

    def shape_of(self, skeleton: Skeleton, surface: Surface) -> BodyShape:
        """Another shape of the same person: a surface of as many nodes, around a skeleton."""
        return BodyShape.of(skeleton, surface, self.settings.levels)

    def find(self, shape: BodyShape, pose: Pose, cameras: Camera, level: int = FULL) -> Rim:
        """The rims as C cameras (stacked) see them, of the surface or of one of its low-passes."""
        projected = self._project(shape.skins[level], self.morph, shape.skeleton, pose, cameras)
        return self._tracer.rim(projected)

    def moves(self, nodes: np.ndarray) -> np.ndarray | None:
        """How the same nodes go along with drivers, (N, 3, S); None if nothing does."""
        if self.morph is None or self.morph.moves is None:
            return None
        return np.asarray(self.morph.moves)[nodes.ravel()]


def neighbours(surface: Surface) -> np.ndarray:
    """(M, 9) every node and its eight neighbours on the patch; itself past a limb's ends."""
    rows = []
    for patch in surface.patches:
        v, u = np.meshgrid(np.arange(patch.along), np.arange(patch.around), indexing="ij")
        near = [
            patch.start + np.clip(v + dv, 0, patch.along - 1) * patch.around
            + (u + du) % patch.around
            for dv in (0, -1, 1) for du in (0, -1, 1)
        ]  # fmt: skip
        rows.append(np.stack(near, -1).reshape(-1, 9))
    return np.concatenate(rows).astype(np.int32)
