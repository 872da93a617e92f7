"""A person with their colours on: the model's surface, its texture, and how true it is.

INPUTS: a PersonalModel; the photographs and their views.
OUTPUTS: an Avatar; pictures of it; how far its colours are from the photographs'.
"""

from collections.abc import Mapping
from typing import NamedTuple

import cv2
import numpy as np

from jaxmocap.body.pose import Pose
from jaxmocap.body.subject import rest_joints
from jaxmocap.body.surfaces.mesh import MARGIN, Atlas, SurfaceMesh, atlas_of, mesh_of
from jaxmocap.body.surfaces.surface import Surface, bones_over_time, nodes_over_time, rest_nodes
from jaxmocap.silhouette.modelling.personal import PersonalModel
from jaxmocap.silhouette.modelling.pictures.medial_axis import rim_distance
from jaxmocap.silhouette.modelling.pictures.views import PhotographView
from jaxmocap.silhouette.modelling.texture.fusion import (
    background_colour,
    blend_colours,
    close_holes,
    feathered_weight,
    gains,
    sampled_colours,
    weighted_blur,
    wide_blend,
)
from jaxmocap.silhouette.modelling.texture.texels import (
    SurfacePhotograph,
    Texels,
    splat_points,
    texels_of,
    visible_points,
)

# A surface that faces a camera by a smaller cosine is ignored.
LEAST_FACING = 0.15
# Pixels from the mask's rim that are left out.
LEFT_OUT_PX = 2.0
# Pixels from there on to full weight.
RIM_PX = 4.0
# Over so many texels a photograph's weight goes down to where something hides it.
FEATHER = 12.0
# What changes over more texels than this is light.
SLOW = 10.0
# What hides a point: within so many cells, what lies so far before it, metres. Hands are not held
# as the surface has them, so that what lies far before a point hides it from farther aside.
OCCLUSION_SLACKS = ((1, 0.015), (14, 0.12))
# Texels to a cell in which occlusion is tested.
CELL_TEXELS = 2.0
# How much a photograph counts for arms and for the rest: others were taken for those. From the side
# a spread arm points at the camera.
COUNTS = {"front": (0.25, 1.0), "side": (0.0, 1.0), "joint": (1.0, 0.25), "arm_side": (1.0, 0.25)}
# How much the other side's colours count by one's own.
MIRRORED = 0.3

# Colours (H, W, 3) of a patch, float32, and how much they count (H, W).
Part = tuple[np.ndarray, np.ndarray]


def bake_texture(
    surface: Surface, atlas: Atlas, mesh: SurfaceMesh, shots: Mapping[str, SurfacePhotograph]
) -> np.ndarray:
    """The atlas' picture (H, W, 3), BGR uint8, of a surface with the generic body's patches.

    They are pairs ``_l`` and ``_r``, or the same on both sides, and all their rings begin ahead.
    The first photograph's brightness is kept.
    """
    clouds = [texels_of(surface, atlas, mesh, shot.nodes_world) for shot in shots.values()]
    colours, weights = [], []
    for (name, shot), texels in zip(shots.items(), clouds, strict=True):
        colour, weight = _look_up_colours(texels, atlas, shot)
        counts = [COUNTS[name][patch.limb != "arm"] for patch in surface.patches]
        colours.append(colour)
        weights.append(weight * np.array(counts)[texels.patches])
    backdrops = np.array([background_colour(shot.image, shot.view.mask) for shot in shots.values()])
    factors = gains(colours, weights, backdrops)
    colours = [c * factor for c, factor in zip(colours, factors, strict=True)]
    at = clouds[0].rows, clouds[0].columns
    evened = _of_one_light(atlas, at, colours, weights)
    picture = np.zeros((atlas.height, atlas.width, 3), np.float32)
    weight = np.zeros((atlas.height, atlas.width), np.float32)
    picture[at], weight[at] = blend_colours(evened, weights)
    return np.clip(np.rint(_complete_picture(surface, atlas, picture, weight)), 0, 255).astype(
        np.uint8
    )


def _look_up_colours(
    texels: Texels, atlas: Atlas, shot: SurfacePhotograph
) -> tuple[np.ndarray, np.ndarray]:
    """(K, 3) colours that a photograph shows at texels; (K,) how much it counts, from 0 to 1."""
    view, (height, width) = shot.view, shot.image.shape[:2]
    pixels = view.pixels(texels.points)
    towards = view.centre - texels.points
    depths = np.linalg.norm(towards, axis=1)
    facing = np.sum(towards * texels.normals, 1) / depths
    beside = (np.diff(texels.columns) == 1) & (np.diff(texels.rows) == 0)
    step = float(np.percentile(np.linalg.norm(np.diff(pixels, axis=0)[beside], axis=1), 90))
    cell = CELL_TEXELS * step
    canvas = int(height / cell) + 2, int(width / cell) + 2
    visible = visible_points(pixels / cell, depths, canvas, OCCLUSION_SLACKS)
    is_visible = visible & (facing > LEAST_FACING)
    inwards = sampled_colours(rim_distance(view.mask, goes_on_below=False), pixels, 1.0)[:, 0]
    rim = np.clip((inwards - LEFT_OUT_PX) / RIM_PX, 0, 1)
    hidden = np.zeros((atlas.height, atlas.width), bool)
    hidden[texels.rows, texels.columns] = ~is_visible
    soft = feathered_weight(hidden, FEATHER)[texels.rows, texels.columns]
    weight = (facing - LEAST_FACING) / (1 - LEAST_FACING) * rim * soft
    return sampled_colours(shot.image, pixels, step), np.where(is_visible, weight, 0)


def _of_one_light(
    atlas: Atlas,
    at: tuple[np.ndarray, np.ndarray],
    colours: list[np.ndarray],
    weights: list[np.ndarray],
) -> list[np.ndarray]:
    """The photographs' colours (K, 3), without the light in which they differ.

    What two photographs show is lit twice, from where the lamp was for each: slow changes are
    blended over all that both show, and details, which have to be sharp, over less (Burt).
    """
    wide, result = wide_blend(colours, weights), []
    for colour, weight in zip(colours, weights, strict=True):
        off = np.zeros((atlas.height, atlas.width, 3), np.float32)
        weight_map = np.zeros((atlas.height, atlas.width), np.float32)
        off[at], weight_map[at] = wide - np.log(np.maximum(colour, 1)), weight
        for rectangle in atlas.rectangles:
            here = rectangle.within
            off[here] = weighted_blur(off[here], weight_map[here], SLOW)
        result.append(colour * np.exp(off[at]))
    return result


def _complete_picture(
    surface: Surface, atlas: Atlas, picture: np.ndarray, weight: np.ndarray
) -> np.ndarray:
    """The picture with every texel's colour, a margin around each rectangle too."""
    names = [patch.name for patch in surface.patches]
    parts = {
        name: (picture[rectangle.within], weight[rectangle.within])
        for name, rectangle in zip(names, atlas.rectangles, strict=True)
    }
    full = {name: _close_colours(part, _other_side(parts, name)) for name, part in parts.items()}
    everything = np.zeros_like(picture)
    everything[:] = picture[weight > 0].mean(0) if weight.any() else 0
    for patch, rectangle in zip(surface.patches, atlas.rectangles, strict=True):
        # Of a foot that no photograph shows the leg's lowest colours are all there is.
        colour, leg = full[patch.name], full.get(patch.continued)
        if colour is None and leg is not None:
            colour = np.broadcast_to(leg[-1:].mean((0, 1)), (rectangle.height, rectangle.width, 3))
        if colour is not None:
            framed = np.pad(colour, [(MARGIN, MARGIN), (MARGIN, MARGIN), (0, 0)], mode="edge")
            everything[rectangle.with_margin(MARGIN)] = framed
    return everything


def _other_side(parts: Mapping[str, Part], name: str) -> Part:
    """What the other side shows, as if it were this one."""
    other = name[:-1] + {"l": "r", "r": "l"}[name[-1]] if name[-2:] in ("_l", "_r") else name
    size = parts[name][1].shape[::-1]
    colour, weight = (
        cv2.resize(part, size, interpolation=cv2.INTER_NEAREST) for part in parts[other]
    )
    # Patches of both sides run the same way outwards; one in the middle has its sides within.
    return (colour[:, ::-1], weight[:, ::-1]) if other == name else (colour, weight)


def _close_colours(own: Part, mirrored: Part) -> np.ndarray | None:
    """A patch's colours everywhere; None where neither side shows any."""
    blend, weight = blend_colours([own[0], mirrored[0]], [own[1], MIRRORED * mirrored[1]])
    if not weight.any():
        return None
    # The last column is the first once more.
    closed = close_holes(blend[:, :-1].astype(np.float32), weight[:, :-1] > 0)
    return np.concatenate([closed, closed[:, :1]], 1)


# A person is shown from ahead, from the left, from behind and from the right.
DIRECTIONS_DEG = (0.0, 90.0, 180.0, 270.0)
# Of pictures.
PIXELS_PER_METRE = 400.0
# Size of one, metres across and upwards.
PICTURE_M = (1.5, 2.1)


class Avatar(NamedTuple):
    """A person's colours."""

    person: PersonalModel  # skeleton and surface
    atlas: Atlas  # where patches lie on the picture
    mesh: SurfaceMesh
    picture: np.ndarray  # (H, W, 3) BGR uint8
    shots: dict[str, SurfacePhotograph]  # photograph -> what it is of

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
            pictures.append(splat_points(*cloud, (size[1], size[0]))[0])
        return np.hstack(pictures)


def avatar_of(
    person: PersonalModel,
    images: Mapping[str, np.ndarray],
    views: Mapping[str, PhotographView],
    texel: float,
) -> Avatar:
    """A person's colours from the photographs (H, W, 3), BGR uint8, and their views.

    ``texel`` is of the picture, metres on the surface.
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
    return Avatar(person, atlas, mesh, bake_texture(person.surface, atlas, mesh, shots), shots)
