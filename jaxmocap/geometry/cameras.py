"""A calibrated camera: points to pixels and pixels to rays.

INPUTS: points in the world (metres, Z up), a Camera.
OUTPUTS: pixels (x right, y down, centres at whole numbers), depths, rays.
"""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.geometry.rotations import HIGHEST, exp, rotate

# Points nearer than this to the camera's plane, or behind it, are projected as if they lay here.
NEAREST_M = 0.05


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Camera:
    """Intrinsics, distortion and pose of a camera in OpenCV's frame (x right, y down, z forward).

    Attributes:
        size: (2,) width and height in pixels.
        matrix: (3, 3) intrinsic matrix M_intr of equation (11), pixels.
        distortion: (8,) OpenCV's k1 k2 p1 p2 k3 k4 k5 k6; zeros where there is none.
        T_cam_world: (4, 4) the inverse of M_extr of equation (11): world to camera, metres.
    """

    size: Array
    matrix: Array
    distortion: Array
    T_cam_world: Array

    @classmethod
    def create(
        cls,
        size: tuple[float, float],
        matrix: np.ndarray | Array,
        distortion: np.ndarray | Array | list[float] = (),  # type: ignore[assignment]
        rotation: np.ndarray | Array | list[float] = (0.0, 0.0, 0.0),  # type: ignore[assignment]
        translation: np.ndarray | Array | list[float] = (0.0, 0.0, 0.0),  # type: ignore[assignment]
    ) -> "Camera":
        """Build a camera from what a calibration file holds.

        Args:
            size: width and height, pixels.
            matrix: (3, 3) intrinsic matrix.
            distortion: up to eight of OpenCV's coefficients.
            rotation: (3,) Rodrigues vector or (3, 3) matrix, world to camera.
            translation: (3,) metres, world to camera.

        Raises:
            ValueError: more than eight distortion coefficients.
        """
        coefficients = np.zeros(8)
        given = np.asarray(distortion, float).ravel()
        if given.size > 8:
            raise ValueError(f"at most 8 distortion coefficients, found {given.size}")
        coefficients[: given.size] = given
        # Converted on the host: on the device that would be a program for each shape.
        dtype = jax.dtypes.canonicalize_dtype(float)
        return cls(
            jnp.asarray(np.asarray(size, dtype), dtype),
            jnp.asarray(np.asarray(matrix, dtype), dtype),
            jnp.asarray(coefficients.astype(dtype), dtype),
            _transform(np.asarray(rotation, dtype), np.asarray(translation, dtype)),
        )

    @property
    def position_world(self) -> Array:
        """(3,) the centre of projection in the world, metres."""
        return _centre(self.T_cam_world)


# As one program each: step by step each step would compile by itself.
@jax.jit
def _centre(T_cam_world: Array) -> Array:
    return -jnp.matmul(T_cam_world[:3, :3].T, T_cam_world[:3, 3], precision=HIGHEST)


@jax.jit
def _transform(rotation: Array | np.ndarray, translation: Array | np.ndarray) -> Array:
    """(4, 4) from a Rodrigues vector (3,) or a matrix (3, 3), and a translation (3,)."""
    R = jnp.asarray(rotation)
    R = exp(R) if R.shape == (3,) else R
    return jnp.eye(4, dtype=R.dtype).at[:3, :3].set(R).at[:3, 3].set(translation)


def turned(camera: Camera, turn_cam: Array) -> Camera:
    """A camera turned about its centre by a rotation vector (3,) in its own frame, radians."""
    T = jnp.matmul(exp(turn_cam), camera.T_cam_world[:3], precision=HIGHEST)
    return replace(camera, T_cam_world=camera.T_cam_world.at[:3].set(T))


def to_camera(camera: Camera, points_world: Array) -> Array:
    """Points (..., 3) of the world in the camera's frame, metres."""
    return rotate(camera.T_cam_world[:3, :3], points_world) + camera.T_cam_world[:3, 3]


def normalise(points_cam: Array) -> Array:
    """Central projection of (..., 3) camera points onto the plane z = 1: (..., 2)."""
    return points_cam[..., :2] / jnp.maximum(points_cam[..., 2:], NEAREST_M)


def distort(camera: Camera, points_plane: Array) -> Array:
    """OpenCV's rational radial and tangential distortion of (..., 2) points on the plane z = 1."""
    return jnp.stack(_distorted(camera, points_plane[..., 0], points_plane[..., 1]), -1)


def _distorted(camera: Camera, x: Array, y: Array) -> tuple[Array, Array]:
    """``distort`` by components."""
    k1, k2, p1, p2, k3, k4, k5, k6 = camera.distortion
    r2 = x * x + y * y
    radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    dx = 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    dy = p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return x * radial + dx, y * radial + dy


def to_pixels(camera: Camera, points_plane: Array) -> Array:
    """Distort (..., 2) points on the plane z = 1 and apply the intrinsic matrix: pixels (x, y)."""
    return jnp.stack(pixel_components(camera, points_plane[..., 0], points_plane[..., 1]), -1)


def pixel_components(camera: Camera, x: Array, y: Array) -> tuple[Array, Array]:
    """``to_pixels`` by components: arrays of two are slow to work through."""
    x, y = _distorted(camera, x, y)
    M = camera.matrix
    return M[0, 0] * x + M[0, 1] * y + M[0, 2], M[1, 1] * y + M[1, 2]


def project(camera: Camera, points_world: Array) -> Array:
    """Project (..., 3) world points, metres, to (..., 2) pixels (x, y); equation (11).

    Points behind the camera get a finite pixel; ``to_camera(...)[..., 2] <= 0`` tells them.
    """
    return to_pixels(camera, normalise(to_camera(camera, points_world)))


def pixel_rays(camera: Camera, pixels_xy: Array, iterations: int = 8) -> Array:
    """Directions (..., 3), unit length, world frame, of the rays through (..., 2) pixels.

    The distortion is undone by fixed-point iteration, as OpenCV does.
    """
    M = camera.matrix
    y = (pixels_xy[..., 1] - M[1, 2]) / M[1, 1]
    x = (pixels_xy[..., 0] - M[0, 2] - M[0, 1] * y) / M[0, 0]
    seen = jnp.stack([x, y], -1)
    plane = seen
    for _ in range(iterations):
        plane = plane + seen - distort(camera, plane)
    rays_cam = jnp.concatenate([plane, jnp.ones_like(plane[..., :1])], -1)
    rays_cam = rays_cam / jnp.linalg.norm(rays_cam, axis=-1, keepdims=True)
    return rotate(camera.T_cam_world[:3, :3].T, rays_cam)
