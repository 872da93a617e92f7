"""Points where they were measured, or where a search puts them: markers, goals, elbows.

INPUTS: points, targets (world, metres; NaN where missing). OUTPUTS: what lies between them, and how
noisy markers are.
"""

from math import comb
from typing import ClassVar, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.kinematics import (
    Sites,
    curvature,
    forward,
    jacobian,
    landmark_sites,
    site_positions,
)
from jaxmocap.body.model import Model
from jaxmocap.body.skeleton import ELBOWS
from jaxmocap.compilation.settings import settings, traced
from jaxmocap.evidence.terms import Measurements, PosedBody, Term, points_of
from jaxmocap.solvers.robust import shorten_residuals


def are_present(targets: Array | np.ndarray) -> Array:
    """Which (...) of targets (..., 3) are there: all of their coordinates are finite."""
    return jnp.isfinite(jnp.asarray(targets)).all(-1)


def off_targets(points: Array, targets: Array | np.ndarray) -> Array:
    """Points (..., 3) less their targets, metres; 0 where a target is missing (NaN)."""
    targets = jnp.asarray(targets)
    there = are_present(targets)[..., None]
    return jnp.where(there, points - jnp.where(there, targets, 0.0), 0.0)


@settings
class MarkerPositions(Term):
    """Markers on bones; measured ``markers`` (M, 3), world, metres, NaN where missing."""

    needs: ClassVar[tuple[str, ...]] = ("markers",)
    deviation: Array = traced(0.004, "of a marker about its point on the body, metres")

    def residual(self, model: Model, body: PosedBody, measured: Measurements) -> Array:
        """(M, 3)."""
        return off_targets(body.markers, measured.markers) / self.deviation

    def jacobian(self, model: Model, body: PosedBody, measured: Measurements) -> Array:
        """(M, 3, 6 + D)."""
        present = are_present(measured.markers)[:, None, None]
        return jnp.where(present, _jacobian(model, body, model.markers) / self.deviation, 0.0)

    @property
    def metres_per_deviation(self) -> Array:
        """Of a residual of 1."""
        return self.deviation


# Noise shows in differences of this order, whose deviation is so many times that of the samples.
# At 30 samples a second a hand that swings twice in one leaves a tenth of a millimetre in them.
NOISE_ORDER = 6
NOISE_GAIN = comb(2 * NOISE_ORDER, NOISE_ORDER) ** 0.5
# Fewer of them, of all markers, tell nothing.
LEAST_DIFFERENCES = 20
# Steps in time that differ by a larger share from the median are uneven.
MOST_UNEVEN = 0.2
# Of a normal distribution: its standard deviation over its median magnitude.
MEDIAN_TO_DEVIATION = 1.4826


def measured_noise(times: np.ndarray, positions: np.ndarray) -> float:
    """Standard deviation of white noise in each coordinate of markers, metres; 0 if it is unclear.

    Args:
        times: (T,) seconds.
        positions: (T, M, 3) metres; NaN where missing.
    """
    if len(times) <= NOISE_ORDER:
        return 0.0
    steps = np.diff(times)
    is_uneven = np.abs(steps / np.median(steps) - 1) > MOST_UNEVEN
    uneven = np.convolve(is_uneven, np.ones(NOISE_ORDER), "valid") > 0
    size = np.abs(np.diff(positions, NOISE_ORDER, axis=0)) / NOISE_GAIN
    size[uneven] = np.nan
    variances = []
    for own in np.moveaxis(size, 1, 0):
        there = own[np.isfinite(own).all(-1)]
        if len(there) >= LEAST_DIFFERENCES:
            variances.append((MEDIAN_TO_DEVIATION * np.median(there)) ** 2)
    return float(np.sqrt(np.mean(variances))) if variances else 0.0


class Goals(NamedTuple):
    """Where M points on bones are to go."""

    sites: Sites
    targets: Array  # (M, 3) world, metres
    weights: Array  # (M,) of each in the least-squares sense; 0 where there is no target

    def off(self, points: Array) -> Array:
        """Points (M, 3) less their goals, metres; 0 for those of no weight."""
        return jnp.where(self.weights[:, None] > 0, points - self.targets, 0.0)


@settings
class PointGoals(Term):
    """Goals of inverse kinematics: markers, then feet that carry none; measured ``goals``."""

    needs: ClassVar[tuple[str, ...]] = ("goals",)
    deviation: Array = traced(0.004, "of a marker about its point on the body, metres")

    def residual(self, model: Model, body: PosedBody, measured: Measurements) -> Array:
        """(M, 3) of the goals' M points."""
        goals = measured.goals
        points = points_of(model.skeleton, body.pose, body.frames, goals.sites)
        return goals.weights[:, None] * goals.off(points) / self.deviation

    def jacobian(self, model: Model, body: PosedBody, measured: Measurements) -> Array:
        """(M, 3, 6 + D): equation (4), with the goals' weights."""
        goals = measured.goals
        weights = (goals.weights / self.deviation)[:, None, None]
        return weights * _jacobian(model, body, goals.sites)

    def curvature(
        self, model: Model, body: PosedBody, measured: Measurements, weights: Array
    ) -> Array:
        """(6 + D, 6 + D)."""
        goals = measured.goals
        forces = (goals.weights / self.deviation)[:, None] * weights
        return _curvature(model, body, goals.sites, forces)

    @property
    def metres_per_deviation(self) -> Array:
        """Of a residual of 1."""
        return self.deviation


@settings
class ElbowGoals(Term):
    """Elbows of a search over time; measured ``elbows`` (2, 3), NaN where there is no goal."""

    deviation: Array = traced(0.04, "of an elbow about where the search puts it, metres")

    def residual(self, model: Model, body: PosedBody, measured: Measurements) -> Array:
        """(2, 3); none where nothing was searched for."""
        if measured.elbows is None:
            return jnp.zeros((0, 3), body.landmarks.dtype)
        return off_targets(body.landmarks[ELBOWS], measured.elbows) / self.deviation

    def jacobian(self, model: Model, body: PosedBody, measured: Measurements) -> Array:
        """(2, 3, 6 + D)."""
        if measured.elbows is None:
            return jnp.zeros((0, 3, model.skeleton.costs.size), body.landmarks.dtype)
        present = are_present(measured.elbows)[:, None, None]
        J = _jacobian(model, body, _elbow_sites(model))
        return jnp.where(present, J / self.deviation, 0.0)

    def curvature(
        self, model: Model, body: PosedBody, measured: Measurements, weights: Array
    ) -> Array:
        """(6 + D, 6 + D)."""
        if measured.elbows is None:
            return jnp.zeros((model.skeleton.costs.size,) * 2, weights.dtype)
        present = are_present(measured.elbows)[:, None]
        forces = jnp.where(present, weights / self.deviation, 0.0)
        return _curvature(model, body, _elbow_sites(model), forces)

    @property
    def metres_per_deviation(self) -> Array:
        """Of a residual of 1."""
        return self.deviation


def _elbow_sites(model: Model) -> Sites:
    return landmark_sites(model.skeleton, ("elbow_l", "elbow_r"))


def _jacobian(model: Model, body: PosedBody, sites: Sites) -> Array:
    """(M, 3, 6 + D) of points on bones: equation (4) without its weight."""
    frames = body.frames or forward(model.skeleton, body.pose)
    points = site_positions(model.skeleton, frames, sites)
    return jacobian(model.skeleton, frames, sites.bones, points)


def _curvature(model: Model, body: PosedBody, sites: Sites, forces: Array) -> Array:
    """Second derivatives (6 + D, 6 + D) of points on bones times forces (M, 3)."""
    frames = body.frames or forward(model.skeleton, body.pose)
    points = site_positions(model.skeleton, frames, sites)
    return curvature(model.skeleton, frames, sites.bones, points, forces)


# Degrees of freedom of Student's t, by which a searched elbow may be wrong.
TAILS = 4.0


@settings
class SearchedElbows(Term):
    """Elbows of a frame's own search, which may be quite wrong; measured ``elbows`` (2, 3)."""

    deviation: Array = traced(
        0.02, "of an elbow about the searched one, metres; its tails are long"
    )

    def residual(self, model: Model, body: PosedBody, measured: Measurements) -> Array:
        """(2, 3), with the tails of Student's t; none without a search."""
        if measured.elbows is None:
            return jnp.zeros(0, body.landmarks.dtype)
        away = (body.landmarks[ELBOWS] - measured.elbows) / self.deviation
        return shorten_residuals(away, TAILS)
