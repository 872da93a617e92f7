"""A cluttered room behind the person, full of straight edges; or a bare one, without any.

INPUTS: a Camera, a random generator. OUTPUTS: an image of the empty room, BGR;
where its floor and back wall are.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike

from jaxmocap.geometry.cameras import Camera, on_host, project
from jaxmocap.synthetic.drawing_camera import image_size

# The back wall's x, metres.
WALL_X = -1.9
# From the middle to the side walls, metres.
HALF_WIDTH = 3.2
# Height of the ceiling, metres.
CEILING = 2.9
# Grey of a bare room.
BARE = 140
# Drawn at this multiple of the size and averaged, so that edges are smooth.
OVERSAMPLING = 2
# Fractional bits of OpenCV's drawing.
FRACTION_BITS = 4


@dataclass
class Room:
    """An image of a room while it is drawn."""

    camera: Camera  # that sees the room
    rng: np.random.Generator  # of what stands where
    image: np.ndarray  # (2 H, 2 W, 3) BGR uint8

    @classmethod
    def furnish(cls, camera: Camera, rng: np.random.Generator) -> np.ndarray:
        """An image (H, W, 3), BGR uint8, of a room with everything in it."""
        width, height = image_size(camera)
        blank = np.full((height * OVERSAMPLING, width * OVERSAMPLING, 3), 90, np.uint8)
        room = cls(on_host(camera), rng, blank)
        room.walls()
        room.window((-1.25, 1.2), (0.85, 1.0))
        for left in (2.0, 0.85):
            room.shelf(left, 0.85, rng.uniform(1.6, 2.3))
        for place in ((-0.17, 1.75), (2.4, 1.6), (-2.75, 1.5)):
            room.poster(place)
        room.door(-1.5)
        for _ in range(5):
            room.box(rng.uniform(-1.8, -0.9), rng.uniform(-2.2, 2.2))
        room.table()
        image = cv2.GaussianBlur(room.image, (0, 0), 1.1)
        return cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)

    @classmethod
    def bare(cls, camera: Camera) -> np.ndarray:
        """An image (H, W, 3), BGR uint8, of nothing but one grey."""
        width, height = image_size(camera)
        return np.full((height, width, 3), BARE, np.uint8)

    def panel(self, corner: ArrayLike, u: ArrayLike, v: ArrayLike, colour: ArrayLike) -> None:
        """A parallelogram from a corner (3,) along two edges; its edges bend with the lens."""
        t = np.linspace(0, 1, 9)[:-1, None]
        corner, u, v = (np.asarray(a, float) for a in (corner, u, v))
        edge = np.concatenate([t * u, u + t * v, u + v - t * u, v - t * v]) + corner
        self.fill(edge, colour)

    def fill(self, outline: np.ndarray, colour: ArrayLike) -> None:
        """A flat shape (N, 3)."""
        pixels = to_fixed(np.asarray(project(self.camera, outline)))
        paint = tuple(float(c) for c in np.clip(np.asarray(colour) * 255, 0, 255))
        cv2.fillPoly(self.image, [pixels], paint, cv2.LINE_AA, FRACTION_BITS)

    def colour(self, low: float = 0.1, high: float = 0.9) -> np.ndarray:
        """Some colour, BGR."""
        grey = self.rng.uniform(low, high)
        return 0.4 * grey + 0.6 * self.rng.uniform(low, high, 3)

    def walls(self) -> None:
        """Back wall with faint stripes, side walls, planks on the floor."""
        wide, tone = 2 * HALF_WIDTH, np.array([0.60, 0.66, 0.68])
        for y in np.arange(0, wide, 0.16):
            shade = tone * self.rng.uniform(0.94, 1.03)
            self.panel([WALL_X, y - HALF_WIDTH, 0], [0, 0.16, 0], [0, 0, CEILING], shade)
        for y in np.arange(0, wide, 0.13):
            wood = np.array([0.30, 0.42, 0.52]) * self.rng.uniform(0.75, 1.15)
            self.panel([WALL_X, y - HALF_WIDTH, 0], [0, 0.13, 0], [3.6, 0, 0], wood)
        for side in (-HALF_WIDTH, HALF_WIDTH):
            self.panel([WALL_X, side, 0], [3.6, 0, 0], [0, 0, CEILING], tone * 0.8)
        self.panel([WALL_X, -HALF_WIDTH, 0], [0, wide, 0], [0, 0, 0.09], [0.82, 0.82, 0.82])

    def window(self, corner: tuple[float, float], size: tuple[float, float]) -> None:
        """A bright window with bars."""
        x = WALL_X + 0.01
        (y, z), (w, h) = corner, size
        self.panel([x, y - 0.05, z - 0.05], [0, w + 0.1, 0], [0, 0, h + 0.1], [0.35, 0.38, 0.40])
        self.panel([x, y, z], [0, w, 0], [0, 0, h], [0.97, 0.90, 0.84])
        self.panel([x, y, z], [0, w, 0], [0, 0, 0.35 * h], [0.42, 0.60, 0.48])
        for share in (0.32, 0.64):
            self.panel([x, y + share * w, z], [0, 0.035, 0], [0, 0, h], [0.8, 0.8, 0.8])
        self.panel([x, y, z + 0.5 * h], [0, w, 0], [0, 0, 0.035], [0.8, 0.8, 0.8])

    def shelf(self, left: float, width: float, height: float) -> None:
        """Boards full of books."""
        depth, wood = 0.28, np.array([0.16, 0.26, 0.38]) * self.rng.uniform(0.8, 1.8)
        front, low = WALL_X + depth, left - width
        self.panel([WALL_X + 0.02, low, 0], [0, width, 0], [0, 0, height], wood * 0.55)
        for z in np.arange(0.05, height - 0.2, 0.36):
            y = low + 0.03
            while y < left - 0.09:
                thick, tall = self.rng.uniform(0.025, 0.075), self.rng.uniform(0.2, 0.32)
                if self.rng.random() < 0.88:
                    colour = self.colour(0.08, 0.85)
                    self.panel([front - 0.05, y, z], [0, thick, 0], [0, 0, tall], colour)
                    band = [front - 0.05, y, z + 0.6 * tall]
                    self.panel(band, [0, thick, 0], [0, 0, 0.03], np.clip(colour + 0.3, 0, 1))
                y += thick + 0.004
            self.panel([front, low, z - 0.03], [0, width, 0], [0, 0, 0.03], wood)
        for y in (low, left - 0.025):
            self.panel([front, y, 0], [0, 0.025, 0], [0, 0, height], wood)
        self.panel([front, low, height], [0, width, 0], [-depth, 0, 0], wood * 1.2)

    def poster(self, place: tuple[float, float]) -> None:
        """A framed picture of random shapes around a place (y, z) on the wall."""
        x, size = WALL_X + 0.015, self.rng.uniform(0.28, 0.48, 2)
        corner = np.array([x, place[0] - size[0] / 2, place[1] - size[1] / 2])
        self.panel(
            corner - [0, 0.02, 0.02], [0, size[0] + 0.04, 0], [0, 0, size[1] + 0.04], [0.1] * 3
        )
        self.panel(corner, [0, size[0], 0], [0, 0, size[1]], self.colour(0.4, 0.95))
        for _ in range(6):
            at = self.rng.uniform(0.05, 0.6, 2) * size
            part = np.minimum(self.rng.uniform(0.1, 0.5, 2) * size, 0.95 * size - at)
            self.panel(corner + np.array([0, *at]), [0, part[0], 0], [0, 0, part[1]], self.colour())

    def door(self, left: float) -> None:
        """A door with four panels and a frame."""
        x, low = WALL_X + 0.01, left - 0.85
        self.panel([x, low - 0.08, 0], [0, 1.01, 0], [0, 0, 2.1], [0.86, 0.86, 0.84])
        self.panel([x, low, 0], [0, 0.85, 0], [0, 0, 2.02], [0.42, 0.50, 0.58])
        for y in (0.08, 0.47):
            for z, tall in ((0.12, 0.75), (1.02, 0.85)):
                self.panel([x, low + y, z], [0, 0.3, 0], [0, 0, tall], [0.34, 0.41, 0.48])

    def box(self, x: float, y: float) -> None:
        """A cardboard box on the floor, three sides of it."""
        w, d, h = self.rng.uniform(0.25, 0.55, 3)
        tone = np.array([0.38, 0.52, 0.66]) * self.rng.uniform(0.6, 1.15)
        self.panel([x, y, h], [d, 0, 0], [0, w, 0], tone * 1.2)
        side = y + w if self.camera.position_world[1] > y + w else y
        self.panel([x, side, 0], [d, 0, 0], [0, 0, h], tone * 0.7)
        self.panel([x + d, y, 0], [0, w, 0], [0, 0, h], tone)
        self.panel([x + d, y + 0.45 * w, 0], [0, 0.05, 0], [0, 0, h], tone * 1.35)

    def table(self) -> None:
        """A table-tennis table folded away along the wall, its lines and net post showing."""
        x, y, blue = WALL_X + 0.75, -2.35, np.array([0.48, 0.26, 0.10])
        self.panel([x, y, 0.25], [0, 1.5, 0], [0, 0, 0.95], blue)
        for z in (0.25, 0.71, 1.18):
            self.panel([x + 0.01, y, z], [0, 1.5, 0], [0, 0, 0.02], [0.92] * 3)
        for shift in (0.1, 1.36):
            self.panel([x + 0.01, y + shift, 0], [0, 0.04, 0], [0, 0, 0.25], [0.2] * 3)


def to_fixed(pixels_xy: np.ndarray) -> np.ndarray:
    """Pixels (..., 2) in OpenCV's fixed-point numbers on the oversampled image."""
    fine = (pixels_xy + 0.5) * OVERSAMPLING - 0.5
    return np.rint(np.clip(fine, -9e4, 9e4) * 2**FRACTION_BITS).astype(np.int32)
