"""A person with their colours on: the model's surface, its texture, and how true it is.

INPUTS: a PersonalModel; the photographs and their views.
OUTPUTS: an Avatar; pictures of it; how far its colours are from the photographs'.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from jaxmocap.body.pose import Pose
from jaxmocap.body.surfaces.host_skin import bones_over_time, nodes_over_time
from jaxmocap.body.surfaces.loft import rest_joints
from jaxmocap.body.surfaces.mesh import Atlas, SurfaceMesh, atlas_of, mesh_of
from jaxmocap.body.surfaces.surface import rest_nodes
from jaxmocap.modelling.personal import PersonalModel
from jaxmocap.modelling.pictures.views import PhotographView
from jaxmocap.modelling.texture.fused import baked
from jaxmocap.modelling.texture.splats import splatted
from jaxmocap.modelling.texture.texels import SurfacePhotograph, texels_of

# A person is shown from ahead, from the left, from behind and from the right.
DIRECTIONS_DEG = (0.0, 90.0, 180.0, 270.0)
# Of pictures.
PIXELS_PER_METRE = 400.0
# Size of one, metres across and upwards.
PICTURE_M = (1.5, 2.1)


class Avatar(NamedTuple):
    """A person's colours.

    Attributes:
        person: skeleton and surface.
        atlas: where patches lie on the picture.
        mesh: of the surface.
        picture: (H, W, 3) BGR uint8.
        shots: photograph -> what it is of.
    """

    person: PersonalModel
    atlas: Atlas
    mesh: SurfaceMesh
    picture: np.ndarray
    shots: dict[str, SurfacePhotograph]

    def around(self) -> np.ndarray:
        """The person from four sides, as they stood for the front view: (H, W, 3) BGR uint8."""
        nodes = self.shots["front"].nodes_world
        texels = texels_of(self.person.surface, self.atlas, self.mesh, nodes)
        points = texels.points - (nodes.min(0) + nodes.max(0)) / 2
        colours = self.picture[texels.rows, texels.columns]
        size = np.round(PIXELS_PER_METRE * np.array(PICTURE_M)).astype(int)
        pictures = []
        for turn in np.radians(DIRECTIONS_DEG):
            towards = np.array([np.cos(turn), np.sin(turn), 0.0])
            aside = np.array([-np.sin(turn), np.cos(turn), 0.0])
            pixels = PIXELS_PER_METRE * np.stack([points @ aside, -points[:, 2]], 1) + size / 2
            front = texels.normals @ towards > 0
            cloud = pixels[front], -(points @ towards)[front], colours[front]
            pictures.append(splatted(*cloud, (size[1], size[0]))[0])
        return np.hstack(pictures)


def avatar_of(
    person: PersonalModel,
    images: Mapping[str, np.ndarray],
    views: Mapping[str, PhotographView],
    texel: float,
) -> Avatar:
    """A person's colours from the photographs.

    Args:
        person: of the shape that they gave.
        images: photograph -> (H, W, 3) BGR uint8.
        views: photograph -> mask and camera.
        texel: of the picture, metres on the surface.
    """
    rest = rest_nodes(person.surface, rest_joints(person.skeleton))
    atlas = atlas_of(person.surface, rest, texel)
    mesh = mesh_of(person.surface, rest, atlas)
    poses = Pose(*(np.stack(part) for part in zip(*person.poses.values(), strict=True)))  # type: ignore[arg-type]
    nodes = nodes_over_time(person.surface.points, *bones_over_time(person.skeleton, poses))
    shots = {
        name: SurfacePhotograph(images[name], views[name], at)
        for name, at in zip(person.poses, nodes, strict=True)
    }
    return Avatar(person, atlas, mesh, baked(person.surface, atlas, mesh, shots), shots)
