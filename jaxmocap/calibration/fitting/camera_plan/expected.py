"""How sure a recording will be that has not been made: expected deviations of landmarks.

A camera is worth what the drawn body's outlines would hold there, which needs no image. With the
markers' and the priors' information it is what ``smoothing.uncertainty`` inverts after a solve, so
that the figures are those that a report would state. Limbs cover one another softly here, and so
there are derivatives by the cameras' places, angles and lenses.

INPUTS: a Model, settings, a movement, cameras. OUTPUTS: standard deviations.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.kinematics import forward, landmarks
from jaxmocap.body.model import Model
from jaxmocap.body.pose import Pose, retract
from jaxmocap.body.skeleton import LANDMARKS, Skeleton
from jaxmocap.body.surfaces.cones import Cones, cones
from jaxmocap.evidence.appearance.learned import (
    CELLS,
    LEG_CELLS,
    LEG_MARGIN,
    MARGIN,
    ROWS,
    landmark_halves,
)
from jaxmocap.evidence.expansion import linearise_terms
from jaxmocap.evidence.silhouettes import (
    HIDDEN_BEYOND_M,
    HIDDEN_SOFTLY_M,
    Silhouettes,
    forearms,
    project_flesh,
)
from jaxmocap.evidence.smoothness import second_differences
from jaxmocap.evidence.terms import Measurements
from jaxmocap.geometry.cameras import NEAREST_M, Camera, depth, pixels_per_metre, project
from jaxmocap.geometry.outlines import Swept, Touch, depth_along, swept, touch_swept
from jaxmocap.geometry.rotations import HIGHEST
from jaxmocap.images.regions import Region, discs_in_region
from jaxmocap.images.silhouette_grid import cells
from jaxmocap.smoothing.batch import FINELY
from jaxmocap.smoothing.settings import SmoothingSettings
from jaxmocap.smoothing.uncertainty import deviations_of

# Curvature that every unknown has at least.
FLOOR = 1e-3


class Movement(NamedTuple):
    """S stretches of a movement, each of T moments."""

    times: Array  # (T,) seconds of a stretch, evenly
    poses: Pose  # (S, T, ...) of the person
    measured: Measurements  # (S, T, ...) without what cameras show


class Information(NamedTuple):
    """What holds a movement's poses, N = 6 + D unknowns a moment."""

    times: Array  # (T,) seconds of a stretch
    poses: Pose  # (S, T, ...) of the person
    hessian: Array  # (S, T, N, N) of all evidence but the motion's smoothness
    jacobian: Array  # (S, T, 3 L, N) of the landmarks


@jax.jit
def of_markers(model: Model, settings: SmoothingSettings, movement: Movement) -> Information:
    """The information of markers and priors, without any camera; bones are taken as they are.

    Errors that are alike count once in the settings (``uncertainty.count_once``).
    """
    none = jnp.zeros(0, model.dtype)

    def of_moment(each: tuple[Pose, Measurements]) -> tuple[Array, Array]:
        linear = linearise_terms(settings.terms, model, none, *each)
        J = linear.jacobian
        return jnp.matmul(J.T, J, precision=HIGHEST), linear.points_jacobian

    S, T = movement.poses.angles.shape[:2]
    each = movement.poses, movement.measured
    flat = jax.tree.map(lambda part: part.reshape(S * T, *part.shape[2:]), each)
    hessian, jacobian = (
        part.reshape(S, T, *part.shape[1:]) for part in jax.lax.map(of_moment, flat)
    )
    return Information(movement.times, movement.poses, hessian, jacobian)


@jax.jit
def with_camera(
    skeleton: Skeleton,
    settings: SmoothingSettings,
    information: Information,
    camera: Camera,
    rate: Array | float,
) -> Information:
    """The information with what one more camera would show, which is taken as calibrated.

    Limbs outside of its image add nothing; ``rate`` is its frames a second.
    """
    times = information.times
    a_moment = rate * (times[-1] - times[0]) / (len(times) - 1)
    weight = a_moment / settings.silhouettes.deviation**2

    def of_view(pose: Pose) -> Array:
        rows = _view_rows(skeleton, settings.silhouettes, camera, pose)
        return sum((jnp.matmul(J.T, J, precision=HIGHEST) for J in rows), jnp.zeros(()))

    of_moment = jax.checkpoint(of_view)
    views = jax.lax.map(lambda stretch: jax.lax.map(of_moment, stretch), information.poses)
    return information._replace(hessian=information.hessian + weight * views)


@jax.jit
def expected_deviations(settings: SmoothingSettings, information: Information) -> Array:
    """Standard deviations (S, T, L, 3) of the ``LANDMARKS``' coordinates, world, metres.

    A stretch borrows nothing from outside of it, so that its ends are less sure than its middle.
    """

    def of_stretch(each: tuple[Array, Array]) -> Array:
        """By Hessians (T, N, N) of moments and the landmarks' derivatives (T, 3 L, N)."""
        hessian, jacobian = each
        T, M, N = jacobian.shape
        second, at = second_differences(information.times) / settings.acceleration, np.arange(T)
        rows = jnp.zeros((T - 2, M, T, N), jacobian.dtype)
        for k in range(3):
            tied = second[:, k, None, None] * jacobian[k : T - 2 + k]
            rows = rows.at[at[:-2], :, at[:-2] + k].set(tied)
        rows = rows.reshape(-1, T * N)
        every = jnp.matmul(rows.T, rows, precision=HIGHEST)
        every = every + FLOOR * jnp.eye(T * N, dtype=rows.dtype)
        every = every.reshape(T, N, T, N).at[at, :, at].add(hessian).reshape(T * N, T * N)
        sides = jnp.zeros((T, N, T, M), rows.dtype).at[at, :, at].set(jacobian.swapaxes(1, 2))
        factor = jnp.linalg.cholesky(every)
        solved = jax.scipy.linalg.solve_triangular(factor, sides.reshape(T * N, T * M), lower=True)
        variances = jnp.sum(solved**2, 0).reshape(T, len(LANDMARKS), 3)
        return deviations_of(variances, settings.mismatch)

    return jax.lax.map(of_stretch, (information.hessian, information.jacobian))


def _view_rows(
    skeleton: Skeleton, settings: Silhouettes, camera: Camera, pose: Pose
) -> tuple[Array, Array, Array]:
    """Of each picture of a view, how its cells' coverage changes (S * S, N) with the pose."""
    drawn, still = skeleton.tree.drawn, jnp.zeros(skeleton.costs.size, pose.angles.dtype)
    flesh = cones(skeleton, forward(skeleton, pose), drawn)
    away = jnp.maximum(jnp.mean(depth(camera, flesh.near)), NEAREST_M)
    per_metre = pixels_per_metre(camera, away)

    def outlines(step: Array) -> Array:
        moved = cones(skeleton, forward(skeleton, retract(pose, step)), drawn)
        return jnp.concatenate(project_flesh(skeleton.tree, camera, moved, per_metre), -1)

    leverage = jax.jacfwd(outlines)(still)
    discs = project_flesh(skeleton.tree, camera, flesh, per_metre)
    pixels = project(camera, landmarks(skeleton, pose))
    # Images are shrunk before they are measured: a distant person has coarser cells.
    finest = camera.size[1] / ROWS

    def picture(rows: np.ndarray, size: int, margin: float) -> tuple[Region, Array, Touch]:
        low, high = jnp.min(pixels[rows], 0), jnp.max(pixels[rows], 0)
        scale = jnp.maximum(jnp.max(high - low) * (1 + 2 * margin) / size, finest)
        # Not at whole pixels, as a tracker's are: it follows the person.
        region = Region((low + high - scale * size) / 2, scale)
        limbs = swept(discs_in_region(region, discs))
        x, y = cells(size, pixels.dtype)
        at = touch_swept(Swept(*(part[:, None] for part in limbs)), x, y)
        return region, _inside(camera, region, x, y), at

    upper, legs = landmark_halves(skeleton.tree)
    region, inside, at = picture(upper, CELLS, MARGIN)
    below, inside_below, at_below = picture(legs, LEG_CELLS, LEG_MARGIN)
    fore = np.isin(np.arange(len(drawn)), forearms(skeleton.tree))
    arms, unhidden = Touch(*(part[fore] for part in at)), _unhidden(camera, flesh, at, fore)
    return (
        settings.person * inside[:, None] * _rows(at, leverage / region.scale),
        settings.forearms
        * (inside * unhidden)[:, None]
        * _rows(arms, leverage[fore] / region.scale),
        # By samples of the upper grid, as all else.
        settings.person * inside_below[:, None] * _rows(at_below, leverage / below.scale),
    )


def _rows(at: Touch, leverage: Array) -> Array:
    """How the coverage of cells (C, N) changes with limbs (K, C), by their (K, 6, N) leverage.

    A limb counts where no other one covers the cell.
    """
    softness = FINELY[-1]
    covered = jax.nn.sigmoid(-at.distance / softness)
    clear = -jax.nn.softplus(-at.distance / softness)
    others = jnp.sum(clear, 0) - clear
    slope = covered * (1 - covered) * jnp.exp(others) / softness
    x, y, far = at.normal_x, at.normal_y, at.along
    # As in ``Discs``: near x, y; far x, y; both radii.
    by_limb = jnp.stack([x - far * x, y - far * y, far * x, far * y, 1 - far, far], -1)
    return jnp.einsum("kc,kcr,krn->cn", slope, by_limb, leverage, precision=HIGHEST)


def _unhidden(camera: Camera, flesh: Cones, at: Touch, fore: np.ndarray) -> Array:
    """Share (C,) of the forearms that no other limb hides, as ``silhouettes.unhidden`` has it."""
    depths = jnp.stack([depth(camera, end) for end in (flesh.near, flesh.far)], 1)
    surfaces = jnp.mean(depths - flesh.radii, 1)
    covered = jax.nn.sigmoid(-at.distance / FINELY[-1])
    # Of the forearms the one that covers the cell most.
    share = covered[fore] / (jnp.sum(covered[fore], 0) + 1e-6)
    away = jnp.sum(
        share * depth_along(Touch(*(part[fore] for part in at)), *depths[fore].T[..., None]), 0
    )
    before = jax.nn.sigmoid((away - surfaces[~fore, None] - HIDDEN_BEYOND_M) / HIDDEN_SOFTLY_M)
    return jnp.prod(1 - covered[~fore] * before, 0)


def _inside(camera: Camera, region: Region, x: Array, y: Array) -> Array:
    """How far cells (C,) lie within the image: 0 to 1, softly over a cell."""

    def share(corner: Array, cell: Array, end: Array) -> Array:
        at = corner + region.scale * (cell + 0.5)
        return jax.nn.sigmoid(4 * jnp.minimum(at + 0.5, end - 0.5 - at) / region.scale)

    (left, top), (width, height) = region.origin, camera.size
    return share(left, x, width) * share(top, y, height)
