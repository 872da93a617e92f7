"""A calibrated camera: points to pixels and pixels to rays.

INPUTS: points in the world (metres, Z up), a Camera.
OUTPUTS: pixels (x right, y down, centres at whole numbers), depths, rays, derivatives.

All that depends on intrinsics is here: nothing else reads ``matrix`` or ``distortion``.
What goes by components, ``project`` and ``pixel_rays`` work alike with JAX and, of a camera
``on_host``, with NumPy, which compiles no programs.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.compilation.arrays import namespace, on_device
from jaxmocap.geometry.lenses import BROWN_CONRADY, FISHEYE, LENSES, Component
from jaxmocap.geometry.rotations import HIGHEST, exp, rotate

# Pixels: of a picture's side, and of the principal point from the picture's first pixel.
LARGEST_SIZE = 65_536
# Pixels of a focal length: a telescope has some million.
SMALLEST_FOCAL, LARGEST_FOCAL = 1e-3, 1e8
# Coefficients: of a real lens none is beyond some hundred; the tangential ones are below 0.1.
LARGEST_DISTORTION, LARGEST_TANGENTIAL = 1e6, 100.0
# Points nearer than this to the camera's plane, or behind it, are projected as if they lay here.
NEAREST_M = 0.05
# A video that differs more than this from its calibration was not taken with it.
SIZE_TOLERANCE = 0.02
# Lenses bend lines; beyond this much of the image's size their formula means nothing.
DISTORTION_MARGIN = 0.5

# Fields of view of cameras without distortion, along the longer side, degrees.
LEAST_FOV_DEG, MOST_FOV_DEG = 5.0, 150.0


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Camera:
    """Intrinsics, distortion and pose of a camera in OpenCV's frame (x right, y down, z forward).

    Attributes:
        size: (2,) width and height in pixels.
        matrix: (3, 3) intrinsic matrix M_intr of equation (11), pixels.
        distortion: (8,) OpenCV's k1 k2 p1 p2 k3 k4 k5 k6, or a fisheye's (4,) k1 k2 k3 k4; zeros
            where there is none.
        T_cam_world: (4, 4) the inverse of M_extr of equation (11): world to camera, metres.
        lens: name of the lens in ``lenses.LENSES``; static.
    """

    size: Array
    matrix: Array
    distortion: Array
    T_cam_world: Array
    lens: str = field(default=BROWN_CONRADY, metadata={"static": True})

    @classmethod
    def create(
        cls,
        size: tuple[float, float],
        matrix: np.ndarray | Array,
        distortion: np.ndarray | Array | list[float] = (),  # type: ignore[assignment]
        rotation: np.ndarray | Array | list[float] = (0.0, 0.0, 0.0),  # type: ignore[assignment]
        translation: np.ndarray | Array | list[float] = (0.0, 0.0, 0.0),  # type: ignore[assignment]
        lens: str = BROWN_CONRADY,
    ) -> "Camera":
        """Build a camera from what a calibration file holds.

        Args:
            size: width and height, pixels.
            matrix: (3, 3) intrinsic matrix.
            distortion: the first of the lens's coefficients; the others are 0.
            rotation: (3,) Rodrigues vector or (3, 3) matrix, world to camera.
            translation: (3,) metres, world to camera.
            lens: name in ``lenses.LENSES``.

        Raises:
            ValueError: more distortion coefficients than the lens has, or a parameter that no
                camera has.
        """
        most = len(LENSES[lens].coefficients)
        coefficients = np.zeros(most)
        given = np.asarray(distortion, float).ravel()
        if given.size > most:
            raise ValueError(f"at most {most} distortion coefficients, found {given.size}")
        coefficients[: given.size] = given
        if problem := lens_problem(np.asarray(size, float), np.asarray(matrix, float), given, lens):
            raise ValueError(": ".join(problem))
        R, T = np.asarray(rotation, float), np.eye(4)
        T[:3, :3], T[:3, 3] = exp(R) if R.shape == (3,) else R, translation
        return cls(*map(on_device, (size, matrix, coefficients, T)), lens=lens)

    @property
    def position_world(self) -> Component:
        """(3,) the centre of projection in the world, metres."""
        T = self.T_cam_world
        return -rotate(T[:3, :3].T, T[:3, 3])


def camera_of_fov(size: tuple[float, float], fov_deg: float) -> Camera:
    """A camera without distortion at the world's origin, by its field of view.

    Args:
        size: width and height, pixels.
        fov_deg: along the longer side, degrees.

    Raises:
        ValueError: no camera has that field of view.
    """
    if not LEAST_FOV_DEG <= fov_deg <= MOST_FOV_DEG:
        expected = f"expected {LEAST_FOV_DEG:g} to {MOST_FOV_DEG:g} degrees"
        raise ValueError(f"found {fov_deg:g}, {expected}")
    width, height = size
    focal = max(width, height) / 2 / np.tan(np.radians(fov_deg) / 2)
    centre = (width - 1) / 2, (height - 1) / 2
    matrix = np.array([[focal, 0, centre[0]], [0, focal, centre[1]], [0, 0, 1]])
    return Camera.create((width, height), matrix)


def lens_problem(
    size: np.ndarray, matrix: np.ndarray, distortion: np.ndarray, lens: str = BROWN_CONRADY
) -> tuple[str, str] | None:
    """The field of ``Camera.create`` that no real camera has, and a sentence; None where all do."""
    if not ((size >= 1) & (size <= LARGEST_SIZE)).all():
        return "size", f"found {size.tolist()}, expected two positive numbers up to {LARGEST_SIZE}"
    found, focal = f"found {matrix.tolist()}, expected", matrix[[0, 1], [0, 1]]
    if not (focal >= SMALLEST_FOCAL).all() or not np.allclose(matrix[2], [0, 0, 1]):
        return "matrix", f"{found} positive focal lengths and a last row of 0 0 1"
    if not (focal <= LARGEST_FOCAL).all():
        return "matrix", f"{found} focal lengths up to {LARGEST_FOCAL:g}"
    if not abs(matrix[0, 1]) <= focal.max() or matrix[1, 0] != 0:
        return "matrix", f"{found} a skew below the focal lengths, and 0 on the left of them"
    if not (np.abs(matrix[:2, 2]) <= LARGEST_SIZE).all():
        return "matrix", f"{found} a principal point within {LARGEST_SIZE} pixels"
    for name, value in zip(LENSES[lens].coefficients, distortion.tolist(), strict=False):
        most = LARGEST_TANGENTIAL if name.startswith("p") else LARGEST_DISTORTION
        if not abs(value) <= most:
            return "distortions", f"found {name} = {value:g}, expected none beyond {most:g}"
    return None


def turn_camera(camera: Camera, turn_cam: Array) -> Camera:
    """A camera turned about its centre by a rotation vector (3,) in its own frame, radians."""
    T = jnp.matmul(exp(turn_cam), camera.T_cam_world[:3], precision=HIGHEST)
    return replace(camera, T_cam_world=camera.T_cam_world.at[:3].set(T))


def on_host(camera: Camera) -> Camera:
    """The same camera, or cameras, in NumPy and double precision."""
    return jax.tree.map(lambda leaf: np.asarray(leaf, float), camera)


def to_camera(camera: Camera, points_world: Component) -> Component:
    """Points (..., 3) of the world in the camera's frame, metres."""
    return rotate(camera.T_cam_world[:3, :3], points_world) + camera.T_cam_world[:3, 3]


def camera_components(
    camera: Camera, x: Component, y: Component, z: Component
) -> tuple[Component, Component, Component]:
    """``to_camera`` by components (...): arrays of three are slow to work through."""
    T = camera.T_cam_world
    first, second, third = (T[i, 0] * x + T[i, 1] * y + T[i, 2] * z + T[i, 3] for i in range(3))
    return first, second, third


def depth(camera: Camera, points_world: Component) -> Component:
    """(...) of points (..., 3) of the world along the optical axis, metres; negative behind."""
    ahead = camera.T_cam_world[2]
    x, y, z = (points_world[..., i] for i in range(3))
    return x * ahead[0] + y * ahead[1] + z * ahead[2] + ahead[3]


def pixels_per_metre(camera: Camera, depths: Component) -> Component:
    """How many pixels a metre across the optical axis spans at depths (...), metres."""
    return camera.matrix[..., 0, 0] / depths


def focal_length(camera: Camera) -> Component:
    """Pixels of a unit on the plane z = 1: the mean of both axes."""
    return (camera.matrix[..., 0, 0] + camera.matrix[..., 1, 1]) / 2


def normalise(points_cam: Component) -> Component:
    """Central projection of (..., 3) camera points onto the plane z = 1: (..., 2)."""
    return points_cam[..., :2] / namespace(points_cam).maximum(points_cam[..., 2:], NEAREST_M)


def to_pixels(camera: Camera, points_plane: Component) -> Component:
    """Distort (..., 2) points on the plane z = 1 and apply the intrinsic matrix: pixels (x, y)."""
    components = pixel_components(camera, points_plane[..., 0], points_plane[..., 1])
    return namespace(points_plane).stack(components, -1)


def pixel_components(camera: Camera, x: Component, y: Component) -> tuple[Component, Component]:
    """``to_pixels`` by components: arrays of two are slow to work through."""
    return _from_plane(camera, *LENSES[camera.lens].distort(camera.distortion, x, y))


def pixel_components_anywhere(
    camera: Camera, x: Component, y: Component
) -> tuple[Component, Component]:
    """``pixel_components`` of points that may lie far outside the image.

    Polynomials of a lens hold near the image, and farther out fold points back into it: there
    points are where a pinhole has them.
    """
    bent, plain = pixel_components(camera, x, y), _from_plane(camera, x, y)
    near, where = _is_near(camera, *plain), namespace(x).where
    return where(near, bent[0], plain[0]), where(near, bent[1], plain[1])


def visible_pixels(camera: Camera, points_world: np.ndarray) -> np.ndarray:
    """Pixels (..., 2) of (..., 3) world points, in double precision; NaN behind or missing."""
    camera = on_host(camera)
    x, y, z = camera_components(camera, *np.moveaxis(np.asarray(points_world, float), -1, 0))
    ahead = z > NEAREST_M
    depths = np.where(ahead, z, 1.0)
    xy = pixel_components_anywhere(camera, x / depths, y / depths)
    return np.where(ahead[..., None], np.stack(xy, -1), np.nan)


def _from_plane(camera: Camera, x: Component, y: Component) -> tuple[Component, Component]:
    M = camera.matrix
    return M[0, 0] * x + M[0, 1] * y + M[0, 2], M[1, 1] * y + M[1, 2]


def plane_components(camera: Camera, x: Component, y: Component) -> tuple[Component, Component]:
    """Points on the plane z = 1 of pixels, by components (...): undoes ``pixel_components``."""
    M = camera.matrix
    y = (y - M[1, 2]) / M[1, 1]
    x = (x - M[0, 2] - M[0, 1] * y) / M[0, 0]
    return LENSES[camera.lens].undistort(camera.distortion, x, y)


def radii_in_pixels(camera: Camera, points_plane: Array, radii: Array) -> Array:
    """Radii (...), pixels, of small discs about points (..., 2) of the plane z = 1.

    A lens makes ellipses of them: these are circles of the same area.
    """
    xx, xy, yy = _slopes(camera, points_plane[..., 0], points_plane[..., 1])
    return radii * focal_length(camera) * jnp.sqrt(jnp.maximum(xx * yy - xy * xy, 0.0))


def normals_in_pixels(
    camera: Camera, at: tuple[Array, Array], normal_x: Array, normal_y: Array
) -> tuple[Array, Array]:
    """Components (...), of any length, of an outline's normals in the image.

    Args:
        camera: that shows the outline.
        at: components (...) of its points on the plane z = 1.
        normal_x: (...) component of its normals there.
        normal_y: (...) component of its normals there.
    """
    # A normal goes by the inverse of the transposed derivative, here times its determinant.
    xx, xy, yy = _slopes(camera, *at)
    normal_x, normal_y = yy * normal_x - xy * normal_y, xx * normal_y - xy * normal_x
    M = camera.matrix
    return M[1, 1] * normal_x, M[0, 0] * normal_y - M[0, 1] * normal_x


def projection_jacobian(camera: Camera, points_world: Array) -> Array:
    """(..., 2, 3) derivatives of the pixels of points (..., 3), pixels per metre of the world."""
    points_cam = to_camera(camera, points_world)
    depths = jnp.maximum(points_cam[..., 2], NEAREST_M)
    x, y = points_cam[..., 0] / depths, points_cam[..., 1] / depths
    R = camera.T_cam_world[:3, :3]
    # On the plane, of a step in the world; then in the image.
    across = (R[0] - x[..., None] * R[2]) / depths[..., None]
    down = (R[1] - y[..., None] * R[2]) / depths[..., None]
    xx, xy, yy = (part[..., None] for part in _slopes(camera, x, y))
    across, down = xx * across + xy * down, xy * across + yy * down
    M = camera.matrix
    return jnp.stack([M[0, 0] * across + M[0, 1] * down, M[1, 1] * down], -2)


def depth_gradient(camera: Camera) -> Array:
    """(3,) by how much a step in the world goes along the optical axis."""
    return camera.T_cam_world[2, :3]


def _slopes(camera: Camera, x: Array, y: Array) -> tuple[Array, Array, Array]:
    """Of the lens; of points far outside the image those of a pinhole, as they are drawn there."""
    xx, xy, yy = LENSES[camera.lens].slopes(camera.distortion, x, y)
    near = _is_near(camera, *_from_plane(camera, x, y))
    return jnp.where(near, xx, 1.0), jnp.where(near, xy, 0.0), jnp.where(near, yy, 1.0)


def _is_near(camera: Camera, x: Component, y: Component) -> Component:
    """Whether pixels (...) lie where a lens's polynomials hold: a fisheye's do anywhere."""
    if camera.lens == FISHEYE:
        return namespace(x).ones_like(x, dtype=bool)
    reach = 0.5 + DISTORTION_MARGIN
    width, height = camera.size[0], camera.size[1]
    return (abs(x - width / 2) <= reach * width) & (abs(y - height / 2) <= reach * height)


def project(camera: Camera, points_world: Component) -> Component:
    """Project (..., 3) world points, metres, to (..., 2) pixels (x, y); equation (11).

    Points behind the camera get a finite pixel; ``depth(camera, points) <= 0`` marks them.
    """
    return to_pixels(camera, normalise(to_camera(camera, points_world)))


def pixel_rays(camera: Camera, pixels_xy: Component) -> Component:
    """Directions (..., 3), unit length, world frame, of the rays through (..., 2) pixels."""
    x, y = plane_components(camera, pixels_xy[..., 0], pixels_xy[..., 1])
    xp = namespace(x)
    rays_cam = xp.stack([x, y, xp.ones_like(x)], -1)
    rays_cam = rays_cam / xp.linalg.norm(rays_cam, axis=-1, keepdims=True)
    return rotate(camera.T_cam_world[:3, :3].T, rays_cam)


def stack_cameras(cameras: Sequence[Camera]) -> Camera:
    """C cameras as one, each of its arrays with a new first axis.

    Raises:
        ValueError: their lenses are of several kinds, which one program cannot hold.
    """
    if len({camera.lens for camera in cameras}) > 1:
        raise ValueError("the cameras' lenses are of several kinds, expected one kind")
    return jax.tree.map(_stack_cameras, *cameras)


def _stack_cameras(*leaves: Array) -> Array:
    return on_device(np.stack([np.asarray(leaf) for leaf in leaves]), leaves[0].dtype)
