"""Pictures of what was found in a photograph, and of a mesh, closed patch by patch.

INPUTS: photographs (H, W, 3) BGR uint8, masks, pixels (x, y); a mesh seen along an axis.
OUTPUTS: pictures (H, W, 3) BGR uint8.
"""

from collections.abc import Iterable

import cv2
import numpy as np

from jaxmocap.body.surfaces.mesh import facing_outwards
from jaxmocap.geometry.solids import ring_triangles


def closed_mesh(rings: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (K N + 2, 3) and triangles (F, 3): the rings, and a fan over either end."""
    count, around, _ = rings.shape
    ends = np.stack([rings[0].mean(0), rings[-1].mean(0)])
    vertices = np.concatenate([rings.reshape(-1, 3), ends])
    first, next_ = np.arange(around), (np.arange(around) + 1) % around
    last = (count - 1) * around
    low = np.stack([next_, first, np.full(around, count * around)], 1)
    high = np.stack([last + first, last + next_, np.full(around, count * around + 1)], 1)
    faces = np.concatenate([ring_triangles(count, around), low, high])
    return vertices, facing_outwards(vertices, faces)


def joined_meshes(patches: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """One mesh of several patches of rings, each of them closed."""
    meshes = [closed_mesh(rings) for rings in patches]
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in meshes[:-1])])
    return (
        np.concatenate([vertices for vertices, _ in meshes]),
        np.concatenate([faces + start for (_, faces), start in zip(meshes, starts, strict=True)]),
    )


# Colours of what is drawn, BGR.
RIM = (255, 255, 0)
AXIS = (40, 40, 230)
RING = (90, 220, 255)
POINT = (255, 0, 255)
# Digits after the point in OpenCV's fixed-point coordinates.
BITS = 4
SKIN_BGR = np.array([150.0, 175.0, 215.0])
# Of a mesh's picture, pixels.
MESH_WIDTH = 900


def draw_outline(photograph: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """The photograph, paler but for the person (H, W) bool, whose rim is drawn."""
    picture = np.where(mask[..., None], photograph, photograph // 2 + 100).astype(np.uint8)
    rims, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    return cv2.drawContours(picture, rims, -1, RIM, 1, cv2.LINE_AA)


def with_lines(
    picture: np.ndarray, lines: Iterable[np.ndarray], colour: tuple[int, int, int], closed: bool
) -> np.ndarray:
    """A picture with lines through (N, 2) pixels each."""
    fixed = [np.rint(line * 2**BITS).astype(np.int32)[:, None] for line in lines]
    return cv2.polylines(picture.copy(), fixed, closed, colour, 1, cv2.LINE_AA, BITS)


def with_points(picture: np.ndarray, points: np.ndarray) -> np.ndarray:
    """A picture with rings about (N, 2) pixels."""
    picture = picture.copy()
    for x, y in np.rint(points * 2**BITS).astype(int).tolist():
        cv2.circle(picture, (x, y), 6 * 2**BITS, (0, 0, 0), 3, cv2.LINE_AA, BITS)
        cv2.circle(picture, (x, y), 6 * 2**BITS, POINT, 2, cv2.LINE_AA, BITS)
    return picture


def shade_mesh(vertices: np.ndarray, faces: np.ndarray, turn: float) -> np.ndarray:
    """A mesh (V, 3), (F, 3) from afar, z up: +x towards the viewer, who goes round by ``turn``."""
    cosine, sine = np.cos(turn), np.sin(turn)
    towards = np.array([cosine, sine, 0.0])
    projected = vertices @ np.stack([[-sine, cosine, 0.0], [0.0, 0.0, -1.0]], 1)
    low, high = projected.min(0), projected.max(0)
    scale = 0.94 * MESH_WIDTH / max(high[0] - low[0], 1.0)
    height = int(1.08 * scale * (high[1] - low[1]))
    pixels = (projected - (low + high) / 2) * scale + np.array([MESH_WIDTH, height]) / 2
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True) + 1e-12
    lamp = towards + np.array([-0.6 * sine, 0.6 * cosine, 0.7])
    light = 0.35 + 0.65 * np.maximum(normals @ lamp / np.linalg.norm(lamp), 0)
    picture = np.full((height, MESH_WIDTH, 3), 245, np.uint8)
    facing = np.flatnonzero(normals @ towards > 0)
    fixed = np.rint(pixels * 2**BITS).astype(np.int32)
    for face in facing[np.argsort(corners[facing].mean(1) @ towards, kind="stable")]:
        colour = tuple((light[face] * SKIN_BGR).tolist())
        cv2.fillConvexPoly(picture, fixed[faces[face]], colour, cv2.LINE_AA, BITS)
    return picture
