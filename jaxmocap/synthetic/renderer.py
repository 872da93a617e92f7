"""A small renderer: quadrilaterals from back to front, lit, blurred by movement, seen by a sensor.

Everything a real camera does to an arm's outline is here but compression, which the video adds:
occlusion, shading, a soft shadow on floor and wall, motion blur, lens distortion, vignetting,
shot and read noise. The camera stands at any azimuth about the person; the room turns with it, and
lies behind the person as cluttered from every side.

INPUTS: a camera, something that moves, times. OUTPUTS: frames, BGR uint8.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np

from jaxmocap.geometry.cameras import Camera, depth, on_host, project
from jaxmocap.synthetic.drawing_camera import image_size, look_around
from jaxmocap.synthetic.people.meshes import QuadMesh
from jaxmocap.synthetic.room import FRACTION_BITS, OVERSAMPLING, WALL_X, Room, to_fixed

EXPOSURE_S = 0.010
# Instants averaged within one exposure are about so many pixels apart.
BLUR_STEP_PX = 3.0
# But there are at most so many of them.
MOST_INSTANTS = 5
# Unit vector from the scene to the lamp.
LAMP = np.array([0.55, 0.45, 0.70]) / np.linalg.norm([0.55, 0.45, 0.70])
# Share of the light that comes from the lamp.
DIRECT = 0.62
# From the camera's side.
FILL = 0.18
# From everywhere.
AMBIENT = 0.38
# Share of the light that a shadow takes.
SHADOW = 0.38
# The shadow is drawn at this fraction of the image's size.
SHADOW_SCALE = 4
# And blurred by a box of so many pixels.
SHADOW_BLUR = 11
# Drawn around the mover's box.
MARGIN_PX = 3
# Standard deviation of the sensor's noise in the dark, grey levels.
READ_NOISE = 1.6
# Its variance for each grey level of light.
SHOT_NOISE = 0.12
# By this share the corners are darker.
VIGNETTING = 0.16
# Called with the frames done and their total.
Progress = Callable[[int, int], None]


class Mover(Protocol):
    """A mesh in motion."""

    @property
    def mesh(self) -> QuadMesh:
        """At rest: its faces and colours."""
        ...

    def vertices(self, times: np.ndarray) -> np.ndarray:
        """(T, V, 3) in the world, metres."""
        ...


@dataclass(frozen=True)
class Scene:
    """A camera before a room with someone in it."""

    camera: Camera  # of the video
    background: np.ndarray  # (H, W, 3) BGR uint8, the empty room
    mover: Mover  # the person
    seed: int = 0  # of the sensor's noise

    @classmethod
    def in_room(
        cls, camera: Camera, mover: Mover, seed: int = 0, furnished: bool = True
    ) -> "Scene":
        """A room furnished by the seed, or a bare one."""
        rng = np.random.default_rng([seed, 2])
        room = Room.furnish(camera, rng) if furnished else Room.bare(camera)
        return cls(camera, room, mover, seed)


def render_frames(
    scene: Scene, times: np.ndarray, progress: Progress | None = None
) -> Iterator[np.ndarray]:
    """Frames (H, W, 3), BGR uint8, at the middles of exposures (F,), seconds.

    ``progress`` is called with the frames done and their total.
    """
    sensor = Sensor.create(image_size(scene.camera), np.random.default_rng([scene.seed, 3]))
    for i, time in enumerate(times):
        yield sensor.expose(exposure(scene, float(time)))
        if progress:
            progress(i + 1, len(times))


def exposure(scene: Scene, time: float) -> np.ndarray:
    """The light of one exposure: (H, W, 3), BGR uint8, without the sensor's noise."""
    camera = on_host(scene.camera)
    vertices = scene.mover.vertices(time + EXPOSURE_S * np.array([-0.5, 0.0, 0.5]))
    middle, pixels = vertices[1], _blur_pixels(project(camera, vertices))
    image = draw_shadow(scene, middle)
    box = _box(pixels, image_size(camera))
    if box is None:
        return image
    order, colours = _shade_faces(scene.mover.mesh, camera, middle)
    faces = scene.mover.mesh.faces[order]
    _draw_quads(image, box, to_fixed(pixels - box[0])[:, faces], colours)
    return image


def silhouette(mesh: QuadMesh, camera: Camera, vertices: np.ndarray) -> np.ndarray:
    """Pixels (H, W) bool of which at least half shows the mesh, its vertices at (V, 3)."""
    camera, size = on_host(camera), image_size(camera)
    pixels = np.asarray(project(camera, vertices))
    mask = np.zeros(size[::-1], np.uint8)
    box = _box(pixels[None], size)
    if box is None:
        return mask > 0
    order, _ = _shade_faces(mesh, camera, vertices)
    quads = to_fixed(pixels - box[0])[None, mesh.faces[order]]
    _draw_quads(mask, box, quads, [(255.0,)] * len(order))
    return mask >= 128


def _blur_pixels(pixels: np.ndarray) -> np.ndarray:
    """Pixels (N, V, 2) at instants evenly within the exposure, from its start, middle and end."""
    start, middle, end = pixels
    farthest = np.linalg.norm(end - start, axis=-1).max()
    count = int(np.clip(np.ceil(farthest / BLUR_STEP_PX), 1, MOST_INSTANTS))
    shares = ((2 * np.arange(count) + 1) / count - 1)[:, None, None]
    return middle + np.abs(shares) * np.where(shares < 0, start - middle, end - middle)


def _draw_quads(
    image: np.ndarray, box: np.ndarray, instants: np.ndarray, colours: list[tuple]
) -> None:
    """Draw quadrilaterals (T, N, 4, 2), fixed-point from a box' corner, the mean of T instants.

    Within the box, one over the other.
    """
    (left, top), (right, bottom) = box
    part = np.ascontiguousarray(image[top:bottom, left:right])
    empty = cv2.resize(
        part, None, fx=OVERSAMPLING, fy=OVERSAMPLING, interpolation=cv2.INTER_NEAREST
    )
    total, fill = np.zeros(part.shape, np.float32), cv2.fillConvexPoly
    for quads in np.ascontiguousarray(instants):
        drawn = empty.copy()
        for quad, colour in zip(quads, colours, strict=True):
            fill(drawn, quad, colour, cv2.LINE_8, FRACTION_BITS)
        total += cv2.resize(drawn, part.shape[1::-1], interpolation=cv2.INTER_AREA)
    image[top:bottom, left:right] = np.rint(total / len(instants)).astype(np.uint8)


def _box(pixels: np.ndarray, size: tuple[int, int]) -> np.ndarray | None:
    """Corners [[left, top], [right, bottom]] of what is drawn, within the image; None if empty."""
    low = np.floor(pixels.min((0, 1))) - MARGIN_PX
    high = np.ceil(pixels.max((0, 1))) + MARGIN_PX
    box = np.clip([low, high], 0, size).astype(int)
    return box if (box[1] > box[0]).all() else None


def _shade_faces(
    mesh: QuadMesh, camera: Camera, vertices: np.ndarray
) -> tuple[np.ndarray, list[tuple]]:
    """Faces towards the camera, from back to front, and their colours, BGR 0 to 255."""
    corners = vertices[mesh.faces]
    normals = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True) + 1e-12
    middles = corners.mean(1)
    views = camera.position_world - middles
    facing = np.flatnonzero(np.sum(normals * views, -1) > 0)
    order = facing[np.argsort(-np.linalg.norm(views[facing], axis=-1), kind="stable")]
    n = normals[order]
    towards = views[order] / np.linalg.norm(views[order], axis=-1, keepdims=True)
    lit = DIRECT * np.maximum(n @ LAMP, 0) + FILL * np.sum(n * towards, -1) + AMBIENT
    # Light from above is stronger than light from the floor.
    lit += 0.08 * n[:, 2]
    colours = np.clip(255 * mesh.colours[order] * lit[:, None], 0, 255)
    return order, [tuple(colour) for colour in colours.tolist()]


def draw_shadow(scene: Scene, vertices: np.ndarray) -> np.ndarray:
    """The room with the person's soft shadow on floor and back wall: (H, W, 3), BGR uint8."""
    to_floor = np.maximum(vertices[:, 2], 0) / LAMP[2]
    to_wall = (vertices[:, 0] - WALL_X) / LAMP[0]
    cast = vertices - np.minimum(to_floor, to_wall)[:, None] * LAMP
    camera, (width, height) = on_host(scene.camera), image_size(scene.camera)
    mask = np.zeros((height // SHADOW_SCALE, width // SHADOW_SCALE), np.uint8)
    in_front = np.where(depth(camera, cast)[:, None] > 0.3, project(camera, cast), -1e3)
    pixels = np.rint(np.clip(in_front, -1e4, 1e4) / SHADOW_SCALE).astype(np.int32)
    bones = scene.mover.mesh.bones[:, 0]
    for bone in np.unique(bones):
        cv2.fillConvexPoly(mask, cv2.convexHull(pixels[bones == bone]), 255)
    mask = cv2.blur(cv2.blur(mask, (SHADOW_BLUR, SHADOW_BLUR)), (SHADOW_BLUR, SHADOW_BLUR))
    soft = cv2.resize(mask, (width, height), interpolation=cv2.INTER_LINEAR)
    factor = cv2.LUT(soft, np.rint(255 - SHADOW * np.arange(256)).astype(np.uint8))
    return cv2.multiply(scene.background, cv2.merge([factor] * 3), scale=1 / 255)


@dataclass(frozen=True)
class Sensor:
    """Vignetting and noise."""

    falloff: np.ndarray  # (H, W, 3) float32, brightness towards the corners
    # (H + g, W + g, 3) float32 of unit deviation; each frame takes another cut-out.
    grain: np.ndarray
    deviations: np.ndarray  # (256,) float32, noise of each brightness
    rng: np.random.Generator  # of the cut-outs

    @classmethod
    def create(cls, size: tuple[int, int], rng: np.random.Generator) -> "Sensor":
        """A sensor of width and height in pixels."""
        width, height = size
        x, y = np.meshgrid(np.linspace(-1, 1, width), np.linspace(-1, 1, height))
        falloff = (1 - VIGNETTING * (x * x + y * y) / 2).astype(np.float32)
        grain = rng.standard_normal((height + 97, width + 131, 3), np.float32)
        deviations = np.sqrt(READ_NOISE**2 + SHOT_NOISE * np.arange(256)).astype(np.float32)
        return cls(cv2.merge([falloff] * 3), grain, deviations, rng)

    def expose(self, image: np.ndarray) -> np.ndarray:
        """The frame (H, W, 3), BGR uint8, of an exposure."""
        height, width = image.shape[:2]
        top = int(self.rng.integers(self.grain.shape[0] - height + 1))
        left = int(self.rng.integers(self.grain.shape[1] - width + 1))
        noise = (
            cv2.LUT(image, self.deviations) * self.grain[top : top + height, left : left + width]
        )
        return cv2.add(cv2.multiply(image, self.falloff, dtype=cv2.CV_32F), noise, dtype=cv2.CV_8U)


# From the person, metres: far enough for the whole of them, from shoes to a raised hand.
DISTANCE_M = 3.6
# Of the camera, metres.
HEIGHT_M = 1.30
# Of the point that it looks at, metres.
TARGET_HEIGHT_M = 1.0


def camera_at(azimuth: float) -> Camera:
    """A camera that looks at a person at the world's origin, who faces +x."""
    return look_around(azimuth, DISTANCE_M, HEIGHT_M, (0.0, 0.0, TARGET_HEIGHT_M))


@dataclass(frozen=True)
class RotatedMover:
    """A mover rotated about the world's vertical, before a camera that stays in place.

    ``azimuth`` is the camera's about the mover, degrees.
    """

    mover: Mover
    azimuth: float

    @property
    def mesh(self) -> QuadMesh:
        """At rest."""
        return self.mover.mesh

    def vertices(self, times: np.ndarray) -> np.ndarray:
        """(T, V, 3) metres; the camera at azimuth 0 sees them as the rotated one sees the mover."""
        return self.mover.vertices(times) @ self.turn.T

    @property
    def turn(self) -> np.ndarray:
        """(3, 3) from the world to the room before the camera at azimuth 0."""
        cosine, sine = np.cos(np.deg2rad(self.azimuth)), np.sin(np.deg2rad(self.azimuth))
        return np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])
