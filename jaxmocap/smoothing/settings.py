"""Settings of smoothing: the terms of evidence, and what joins the frames.

INPUTS: what a user tunes. OUTPUTS: a pytree of arrays.
"""

from dataclasses import fields, replace
from typing import Any

import jax
from jax import Array

from jaxmocap.compilation.arrays import Numbers, namespace
from jaxmocap.compilation.settings import group, settings, static, traced
from jaxmocap.evidence.balance import Balance
from jaxmocap.evidence.ground import AnkleRange, Ground
from jaxmocap.evidence.keypoints import KeyPoints
from jaxmocap.evidence.limits import JointLimits
from jaxmocap.evidence.markers import ElbowGoals, MarkerPositions
from jaxmocap.evidence.posture import Pelvis, RelaxedPosture, UsualPlaces
from jaxmocap.evidence.silhouettes import Silhouettes
from jaxmocap.evidence.terms import Term


@settings
class ElbowPathSettings:
    """What the elbows' cheapest path through time pays."""

    shoulder_slack: Array = traced(0.03, "of a shoulder's place along the upper arm, metres")
    beyond_range: Array = traced(0.1, "by which a joint may exceed its range, radians")
    speed: Array = traced(1.0, "of an elbow's movement, metres a second")
    largest_price: Array = traced(30.0, "of any movement, nats")


# Terms whose errors last count like so many events a second, however many there are: a thousand
# samples of somebody who stands unusually are no more evidence than thirty.
LASTING_HZ = 30.0
# Events farther apart, seconds, are a gap.
LONGEST_STEP_S = 0.25


@settings
class SmoothingSettings:
    """What a user may tune of smoothing; every field that is a ``Term`` takes part."""

    iterations: int = static(12, "most steps of one solve")
    markers: MarkerPositions = group(MarkerPositions, "of markers about their points")
    pelvis: Pelvis = group(
        lambda: Pelvis(lean=0.035, facing=0.06),  # type: ignore[arg-type]
        "of how the pelvis leans and faces",
    )
    posture: RelaxedPosture = group(
        lambda: RelaxedPosture(bearing=0.45, hips=0.8),  # type: ignore[arg-type]
        "of joints at ease",
    )
    limits: JointLimits = group(JointLimits, "of the joints' ranges")
    ground: Ground = group(
        lambda: Ground(height=0.025, place=0.5),  # type: ignore[arg-type]
        "of feet that no marker holds",
    )
    ankles: AnkleRange = group(AnkleRange, "of shanks over feet that no marker holds")
    balance: Balance = group(
        lambda: Balance(deviation=0.03),  # type: ignore[arg-type]
        "of standing in balance",
    )
    elbows: ElbowGoals = group(ElbowGoals, "of elbows where the path through time has them")
    keypoints: KeyPoints = group(KeyPoints, "of 2-D key points")
    silhouettes: Silhouettes = group(Silhouettes, "of what cameras show, view by view")
    usual: UsualPlaces = group(
        lambda: UsualPlaces(spread=0.55),  # type: ignore[arg-type]
        "of landmarks where walkers have them, without video",
    )
    elbow_path: ElbowPathSettings = group(ElbowPathSettings, "of the elbows' path through time")
    acceleration: Array = traced(
        3.0, "spectral density of the landmarks' accelerations, m / s^2 * sqrt(s)"
    )
    proportions: Array = traced(5.0, "weight of the prior on the person's proportions, in views")
    camera: Array = traced(
        0.005,
        "of a camera's turn against its calibration, about each axis, radians; weighs in as many "
        "views as the proportions do; with 0 no camera turns; key points' lines never do",
        least=0,
    )
    persistence: Array = traced(
        3.0, "for how long somebody keeps to what is unusual, seconds; for the deviations only"
    )
    mismatch: Array = traced(
        1.0, "of skeletons, as a multiple of what is usual; for the deviations only"
    )

    @property
    def terms(self) -> tuple[Term, ...]:
        """The terms of a frame, in the order of the fields."""
        each = (getattr(self, field.name) for field in fields(self))
        return tuple(term for term in each if isinstance(term, Term))


def allow_for_noise(settings: SmoothingSettings, noise_m: float) -> SmoothingSettings:
    """With markers that err by white noise in each coordinate, metres, at least."""
    stated = settings.markers.deviation
    if noise_m <= stated:
        return settings
    deviation = namespace(stated).asarray(noise_m, stated.dtype)
    return replace(settings, markers=replace(settings.markers, deviation=deviation))


def weigh_by_time(settings: SmoothingSettings, times: Numbers) -> SmoothingSettings:
    """With terms whose errors last counted like ``LASTING_HZ`` events a second.

    Args:
        settings: as they were stated.
        times: (T,) seconds, of all events.
    """
    if len(times) < 2:
        return settings
    return with_lasting(settings, (mean_step(times) * LASTING_HZ) ** -0.5)


def mean_step(times: Numbers) -> Numbers:
    """() between events at (T,) seconds."""
    of = namespace(times)
    return of.mean(of.minimum(of.diff(times), LONGEST_STEP_S))


def with_lasting(settings: SmoothingSettings, factor: Numbers) -> SmoothingSettings:
    """With deviations of terms whose errors last times a factor."""

    def times(deviation: Array) -> Numbers:
        return deviation * namespace(factor).asarray(factor, deviation.dtype)

    def weighed(part: Any) -> Any:
        if isinstance(part, Term) and part.errors_last:
            return jax.tree.map(times, part)
        return part

    return jax.tree.map(weighed, settings, is_leaf=lambda part: isinstance(part, Term))
