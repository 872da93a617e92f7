"""Where a camera should stand, by gradient: the place at which joints are expected most surely.

    a ring of places about the person -> the best of them -> L-BFGS-B between the walls

Places are the person's: ahead, to the left, above the floor. A camera that comes too near sees
less of the limbs, and one that is far off has coarser cells; neither needs a rule.

INPUTS: the information of markers and of the cameras that stand already. OUTPUTS: CameraPlaces.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy.optimize import minimize

from jaxmocap.body.skeleton import Skeleton
from jaxmocap.calibration.fitting.camera_plan.expected import (
    Information,
    expected_deviations,
    with_camera,
)
from jaxmocap.geometry.cameras import Camera
from jaxmocap.geometry.rotations import cross
from jaxmocap.smoothing.settings import SmoothingSettings

# Azimuths of the ring, and distances from the person, metres, that the search starts from.
AZIMUTHS, DISTANCES_M = 12, (2.0, 3.2)
# Height of the camera there, and of what it looks at, in statures.
RING_HEIGHT, TARGET_HEIGHT = 0.75, 0.57
# So many places of the ring are improved, at least so far from one another, degrees.
STARTS, APART_DEG = 3, 60.0
# Steps of L-BFGS-B, at most, and the gain below which it ends, metres.
STEPS, LEAST_GAIN_M = 12, 2e-4
# Of the cost that it descends, by metres: its first step is as long as the slope.
COST_SCALE = 10.0
# No camera stands nearer to the person than this, metres: ``bench.camera_plan`` tried none.
NEAREST_M = 1.6
# What looking a radian beside the person costs, metres: people aim a camera at who is filmed, and
# within the image the deviation hardly depends on it.
ASIDE_M = 0.02
# How far it may look up or down, radians.
STEEPEST = 1.2


class Frame(NamedTuple):
    """The person's place in the world."""

    x: Array | float  # metres, world, of the point on the floor about which the person moves
    y: Array | float  # likewise
    facing: Array | float  # radians from the world's +x, as the person faces in the mean


class CameraPlace(NamedTuple):
    """Where a camera stands and looks, in the person's frame."""

    ahead: Array | float  # metres, as the person faces
    left: Array | float  # metres, to the person's left
    height: Array | float  # metres above the floor
    yaw: Array | float  # radians, of the line of sight to the left of where the person faces
    pitch: Array | float  # radians, upwards
    zoom: Array | float  # natural logarithm of the focal length over the lens's own

    @property
    def distance(self) -> float:
        """From the person, level, metres."""
        return float(np.hypot(self.ahead, self.left))

    @property
    def azimuth_deg(self) -> float:
        """From where the person faces, degrees, positive to the left."""
        return float(np.degrees(np.arctan2(self.left, self.ahead)))


class Bounds(NamedTuple):
    """What a place may be: the least and the largest of each of its numbers."""

    least: CameraPlace
    largest: CameraPlace


class Goal(NamedTuple):
    """What a camera is placed for."""

    skeleton: Skeleton  # of the person
    settings: SmoothingSettings  # as of ``expected.of_markers``
    information: Information  # without this camera
    frame: Frame  # the person's
    lens: Camera  # any camera with that lens; its place is of no account
    rate: Array | float  # frames a second
    weights: Array  # (L,) of the ``LANDMARKS``, sum 1


def frame_of(information: Information, facing: np.ndarray) -> Frame:
    """The person's frame: where the pelvis is, and faces (..., 3), world, in the mean."""
    turned = np.asarray(facing, float).reshape(-1, 3).mean(0)
    pelvis = np.asarray(information.poses.position, float).reshape(-1, 3).mean(0)
    return Frame(pelvis[0], pelvis[1], float(np.arctan2(turned[1], turned[0])))


def camera_at(lens: Camera, frame: Frame, place: CameraPlace) -> Camera:
    """The camera at a place, upright, in the world; with derivatives by the place."""
    cosine, sine = jnp.cos(frame.facing), jnp.sin(frame.facing)
    position = jnp.stack(
        [
            frame.x + cosine * place.ahead - sine * place.left,
            frame.y + sine * place.ahead + cosine * place.left,
            jnp.asarray(place.height),
        ]
    )
    yaw, pitch = frame.facing + place.yaw, place.pitch
    level = jnp.cos(pitch)
    forward = jnp.stack([level * jnp.cos(yaw), level * jnp.sin(yaw), jnp.sin(pitch)])
    right = jnp.stack([jnp.sin(yaw), -jnp.cos(yaw), jnp.zeros_like(yaw)])
    R = jnp.stack([right, cross(forward, right), forward])
    T = jnp.eye(4, dtype=R.dtype).at[:3, :3].set(R).at[:3, 3].set(-R @ position)
    focal = jnp.exp(jnp.asarray(place.zoom))
    matrix = lens.matrix * jnp.ones((3, 3)).at[[0, 1], [0, 1]].set(focal)
    return replace(lens, T_cam_world=T.astype(lens.T_cam_world.dtype), matrix=matrix)


def expected_error(goal: Goal, place: CameraPlace) -> Array:
    """The weighted landmarks' deviation in the mean over the movement, (), metres."""
    camera = camera_at(goal.lens, goal.frame, place)
    filmed = with_camera(goal.skeleton, goal.settings, goal.information, camera, goal.rate)
    return mean_deviation(goal.settings, filmed, goal.weights)


@jax.jit
def mean_deviation(settings: SmoothingSettings, information: Information, weights: Array) -> Array:
    """Of the landmarks by their weights (L,), in the mean over the movement, (), metres."""
    deviations = expected_deviations(settings, information)
    return jnp.mean(jnp.linalg.norm(deviations, axis=-1) @ weights)


error_at = jax.jit(expected_error)
error_and_slope = jax.jit(jax.value_and_grad(expected_error, argnums=1))


class Ring(NamedTuple):
    """K places about the person, before any is improved, and errors (K,) expected there, metres."""

    places: CameraPlace
    errors: np.ndarray


def ring_about(goal: Goal, bounds: Bounds, stature: float, show: Callable[[float], None]) -> Ring:
    """What is expected of a camera on a ring of places, moved between the walls.

    The stature is metres; ``show`` gets the share done.
    """
    places, errors = [], []
    around = [(a, far) for a in range(AZIMUTHS) for far in DISTANCES_M]
    for k, (number, far) in enumerate(around):
        azimuth = 2 * np.pi * number / AZIMUTHS - np.pi
        place = np.zeros(len(CameraPlace._fields))
        place[:3] = far * np.cos(azimuth), far * np.sin(azimuth), RING_HEIGHT * stature
        place = np.clip(place, *(np.array(each, float) for each in bounds))
        away = np.hypot(*place[:2])
        place[3] = np.arctan2(-place[1], -place[0])
        place[4] = np.arctan2(TARGET_HEIGHT * stature - place[2], away)
        places.append(place)
        near = away < NEAREST_M
        errors.append(np.inf if near else float(error_at(goal, _place(goal, place))))
        show((k + 1) / len(around))
    return Ring(CameraPlace(*np.array(places).T), np.array(errors))


class BestPlace(NamedTuple):
    """A place that no small step improves."""

    place: CameraPlace
    error: float  # that is expected there, metres
    slope: CameraPlace  # its derivatives by the place's numbers


def best_place(goal: Goal, bounds: Bounds, ring: Ring, show: Callable[[float], None]) -> BestPlace:
    """The best place of a camera, from the best ones of a ring; ``show`` gets the share done.

    Some place of the ring must be far enough from the person.
    """
    starts = _starts(ring)
    found: list[tuple[float, np.ndarray]] = []
    for k, start in enumerate(starts):
        found.append(_improve_place(goal, bounds, start))
        show((k + 1) / len(starts))
    place = _place(goal, min(found, key=lambda each: each[0])[1])
    error, slope = error_and_slope(goal, place)
    numbers = (CameraPlace(*map(float, each)) for each in (place, slope))
    return BestPlace(next(numbers), float(error), next(numbers))


def _starts(ring: Ring) -> list[np.ndarray]:
    """The best places of a ring that are not near one another."""
    every, starts = np.array(ring.places).T, []
    for row in np.argsort(ring.errors):
        azimuth = np.arctan2(every[row, 1], every[row, 0])
        apart = [
            abs(np.angle(np.exp(1j * (azimuth - np.arctan2(other[1], other[0]))), deg=True))
            for other in starts
        ]
        if np.isfinite(ring.errors[row]) and all(a > APART_DEG - 1 for a in apart):
            starts.append(every[row])
    return starts[:STARTS]


def _improve_place(goal: Goal, bounds: Bounds, start: np.ndarray) -> tuple[float, np.ndarray]:
    """The error, metres, and the place at the end of a descent."""

    def cost(numbers: np.ndarray) -> tuple[float, np.ndarray]:
        error, slope = error_and_slope(goal, _place(goal, numbers))
        more, more_slope = penalty(numbers)
        return COST_SCALE * (float(error) + more), COST_SCALE * (
            np.array(slope, float) + more_slope
        )

    found = minimize(
        cost, start, jac=True, method="L-BFGS-B", bounds=np.array(bounds).T,
        options={"maxiter": STEPS, "ftol": COST_SCALE * LEAST_GAIN_M},
    )  # fmt: skip
    return float(found.fun) / COST_SCALE, np.asarray(found.x)


def penalty(numbers: np.ndarray) -> tuple[float, np.ndarray]:
    """What is added for a place (6,) that is too near or looks beside the person; its slope."""
    ahead, left, yaw = (float(numbers[i]) for i in (0, 1, 3))
    away = max(float(np.hypot(ahead, left)), 1e-3)
    short = max(NEAREST_M - away, 0.0)
    aside = float(np.angle(np.exp(1j * (yaw - np.arctan2(-left, -ahead)))))
    slope = np.zeros(len(numbers))
    slope[0] = -2 * short * ahead / away + 2 * ASIDE_M * aside * left / away**2
    slope[1] = -2 * short * left / away - 2 * ASIDE_M * aside * ahead / away**2
    slope[3] = 2 * ASIDE_M * aside
    return short**2 + ASIDE_M * aside**2, slope


def _place(goal: Goal, numbers: np.ndarray) -> CameraPlace:
    """In the precision of all else."""
    return CameraPlace(*np.asarray(numbers, goal.weights.dtype))
