"""A whole body painted before a room, without anything of the tracker: what a camera would see."""

from typing import NamedTuple

import cv2
import numpy as np

from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.geometry.cameras import Camera
from jaxmocap.reference import kinematics as reference

SKIN, SHIRT, TROUSERS = (110, 150, 215), (150, 60, 40), (50, 50, 45)
BARE = ("radius", "hand", "head", "neck")
LEGS = ("hip", "femur", "tibia")
# Pieces of a limb, so that each hides what lies behind it, and pixels per pixel while painting.
PIECES, FINE = 4, 2


class Painted(NamedTuple):
    """What a camera saw, and of whom.

    Attributes:
        image: (h, w, 3) BGR uint8.
        person: (h, w) 0 to 1, the share of each pixel that the person fills.
        forearms: (h, w) the same of forearms and hands, where nothing hides them.
    """

    image: np.ndarray
    person: np.ndarray
    forearms: np.ndarray


def spheres(skeleton: Skeleton, pose: Pose):
    """Name, centres (PIECES + 1, 3) and radii (PIECES + 1,) along every bone but the feet."""
    frames = reference.forward(skeleton, pose)
    share = np.linspace(0, 1, PIECES + 1)
    for bone, name in enumerate(skeleton.tree.bones):
        if not name.startswith("foot"):
            along = frames.R_world_bone[bone] @ reference.bone_vector(skeleton, bone)
            ends = np.asarray(skeleton.diameters[bone], float) / 2
            centres = frames.joints_world[bone] + np.outer(share, along)
            yield name, centres, ends[0] + share * (ends[1] - ends[0])


def contours(camera: Camera, centres: np.ndarray, radii: np.ndarray, count: int = 24):
    """Nearest depths (K,) of spheres, and pixels (K, N, 2) of the circles that they are seen as."""
    T = np.asarray(camera.T_cam_world, float)
    centres_cam = centres @ T[:3, :3].T + T[:3, 3]
    rays = centres_cam / np.linalg.norm(centres_cam, axis=1, keepdims=True)
    across = np.cross(rays, [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    turn = np.linspace(0, 2 * np.pi, count, endpoint=False)[:, None]
    circle = np.cos(turn) * across[:, None] + np.sin(turn) * np.cross(rays, across)[:, None]
    points = centres_cam[:, None] + radii[:, None, None] * circle
    lens = np.asarray(camera.matrix, float), np.asarray(camera.distortion, float)
    pixels, _ = cv2.projectPoints(points.reshape(-1, 3), np.zeros(3), np.zeros(3), *lens)
    return centres_cam[:, 2] - radii, pixels.reshape(*points.shape[:2], 2)


def paint(camera: Camera, skeleton: Skeleton, pose: Pose, room: np.ndarray) -> Painted:
    """The body before a room (h, w, 3), its pieces painted from the farthest to the nearest."""
    hulls = []
    for name, centres, radii in spheres(skeleton, pose):
        depths, pixels = contours(camera, centres, radii)
        corners = np.round((pixels + 0.5) * FINE - 0.5).astype(np.int32)
        for i in range(PIECES):
            hull = cv2.convexHull(np.concatenate(corners[i : i + 2]))
            hulls.append((depths[i : i + 2].mean(), name, hull))
    height, width = room.shape[:2]
    image = cv2.resize(room, (width * FINE, height * FINE), interpolation=cv2.INTER_NEAREST)
    person, forearms = np.zeros((2, *image.shape[:2]), np.uint8)
    for _, name, hull in sorted(hulls, key=lambda each: -each[0]):
        colour = SKIN if name.startswith(BARE) else TROUSERS if name.startswith(LEGS) else SHIRT
        cv2.fillConvexPoly(image, hull, colour)
        cv2.fillConvexPoly(person, hull, 255)
        cv2.fillConvexPoly(forearms, hull, 255 * name.startswith(BARE[:2]))
    covered, *shares = (
        cv2.resize(each, (width, height), interpolation=cv2.INTER_AREA)
        for each in (image, person, forearms)
    )
    return Painted(covered, *(share.astype(np.float32) / 255 for share in shares))


def with_noise(images: list[np.ndarray], seed: int) -> list[np.ndarray]:
    """Images as a sensor gives them, with its little noise."""
    rng = np.random.default_rng(seed)
    noise = [np.rint(rng.normal(0, 2, image.shape)) for image in images]
    return [
        np.clip(image + each, 0, 255).astype(np.uint8)
        for image, each in zip(images, noise, strict=True)
    ]


def room(size: tuple[int, int], seed: int = 0) -> np.ndarray:
    """A wall (h, w, 3) uint8 with blots of many colours, none of them the person's."""
    rng = np.random.default_rng(seed)
    blots = rng.uniform(90, 200, (9, 12, 1)) + rng.uniform(-20, 20, (9, 12, 3))
    return cv2.resize(blots.astype(np.uint8), size, interpolation=cv2.INTER_CUBIC)
