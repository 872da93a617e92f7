"""Segmentation: where the person is in each camera's image (section 4.1).

A level set starts from the silhouette of the predicted pose and moves to where the densities of
person and rest explain the image best (4.19). Densities are estimated as the contour moves:
histograms, of grey levels or of colours, and, for a camera that stands still, a model of
the background behind every single cell. What looks like background is kept out of the person's
histograms, and what does not out of the rest's: so a predicted limb that lies beside the true one
does not make floor and limb change places. Where exactly the contour lies, ``sharpen`` decides.

INPUTS: images of V cameras on canvases of one static size; Φ of the predicted silhouettes.
OUTPUTS: Φ, the log-ratio of the densities, histograms to begin the next frame with.
"""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.images.canvases import Canvas
from jaxmocap.silhouette.segmentation import densities
from jaxmocap.silhouette.segmentation.level_set import (
    BAND,
    LevelSetMotion,
    downsample,
    evolve,
    heaviside,
    upsample,
)

# A cell is background as far as it is likelier than such a density, per cubic grey level.
ANYTHING_DENSITY = 1e-6
# Width of H where it weighs pixels of the two regions, cells.
REGION_WIDTH = 1.5
# Of a logarithm's argument, per cubic grey level.
LEAST_DENSITY = 1e-30


class CanvasImages(NamedTuple):
    """V cameras' images on canvases of S x S cells."""

    # (V, 3, S, S) uint8, BGR, channel by channel: XLA takes a tenth longer to pick them out of
    # pixels.
    colour: Array | np.ndarray
    inside: Array | np.ndarray  # (V, S, S) 0 to 1, how far the cell lies within the image
    background: Array | np.ndarray  # (V, 3, S, S) uint8, what the cell shows where nobody stands
    noise: Array | np.ndarray  # (V, S, S) float32, its deviation, grey levels
    certainty: Array | np.ndarray  # (V, S, S) float32, 0 to 1, of that background

    @classmethod
    def of(cls, canvases: Sequence[Canvas]) -> "CanvasImages":
        """Of V cameras' canvases."""
        colour, inside, background, *rest = (
            np.stack(parts) for parts in zip(*canvases, strict=True)
        )
        planes = (np.moveaxis(image, -1, 1).copy() for image in (colour, background))
        return cls(next(planes), inside, next(planes), *rest)


class Stage(NamedTuple):
    """Some steps between two estimates of the densities; static."""

    steps: int
    width: float  # of H' in cells, of twice the size where ``coarse``
    # The same where the background was learned: a limb beside the predicted one attracts the
    # contour from afar.
    background_width: float
    coarse: bool = False  # whether on cells of twice the size
    gap: float = 0.0  # cells about the contour that histograms leave out


class SegmentationPlan(NamedTuple):
    """What is computed; static."""

    colour: bool = True  # joint histograms of colours rather than of grey levels
    background: bool = True  # whether any background was learned; its densities are of colours
    stages: tuple[Stage, ...] = (  # in turn
        Stage(8, 4.0, 8.0, coarse=True, gap=2.0),
        Stage(8, 2.0, 2.0, coarse=True, gap=1.0),
        Stage(10, 1.5, 1.5, gap=0.5),
    )


class LevelSetSettings(NamedTuple):
    """Traced numbers."""

    motion: LevelSetMotion = LevelSetMotion()  # of the level set
    largest_log_ratio: Array | float = 3.0  # log-ratios are cut off here
    outlier_share: Array | float = 0.002  # share of the background that does not look as its model
    # Weight of the histograms before in those of the next frame.
    histogram_decay: Array | float = 0.9


class Histograms(NamedTuple):
    """Counts (V, B) of grey levels or colours, of person and rest, neither smoothed."""

    person: Array
    rest: Array

    @classmethod
    def empty(cls, views: int, plan: SegmentationPlan) -> "Histograms":
        """Before the first frame."""
        bins = densities.LEVELS**3 if plan.colour else densities.GREYS
        zero = jnp.zeros((views, bins), jnp.float32)
        return cls(zero, zero)


class Segmentation(NamedTuple):
    """Where V cameras show the person."""

    phi: Array  # (V, S, S) cells, positive within the person
    log_ratio: Array  # (V, S, S) how much likelier a cell is the person than the rest
    histograms: Histograms  # to begin the next frame with


@partial(jax.jit, static_argnames="plan")
def segment(
    images: CanvasImages,
    start: Array,
    before: Histograms,
    settings: LevelSetSettings,
    plan: SegmentationPlan,
) -> Segmentation:
    """Segment V images, from signed distances (V, S, S) to the predicted silhouettes.

    Those are cells, positive within. ``before`` is ``Histograms.empty`` at first; another plan
    compiles again.
    """
    if plan.background and not plan.colour:
        raise ValueError("plan.background without plan.colour: expected plan.colour = True too")
    images = jax.tree.map(jnp.asarray, images)
    colour, background = (each.astype(jnp.float32) for each in (images.colour, images.background))
    images = images._replace(colour=colour, background=background)
    fine = _Pixels.of(images, plan)
    coarse = _Pixels.of(jax.tree.map(downsample, images), plan)
    phi, ratio, now = jnp.clip(start, -BAND, BAND), jnp.zeros_like(start), before
    for stage in plan.stages:
        pixels = coarse if stage.coarse else fine
        here = downsample(phi) / 2 if stage.coarse else phi
        now = _histograms(here, pixels, before.person.shape[-1], stage, plan)
        mixed = Histograms(*(a + b for a, b in zip(now, before, strict=True)))
        ratio = _log_ratio(mixed, pixels, settings, plan) * pixels.images.inside
        width = stage.width
        if plan.background:
            certainty = jnp.asarray(pixels.images.certainty)
            width = width + (stage.background_width - width) * certainty
        moved = evolve(here, ratio, settings.motion, width, stage.steps)
        phi = jnp.clip(upsample(moved), -BAND, BAND) if stage.coarse else moved
    kept = Histograms(
        *(settings.histogram_decay * (a + b) for a, b in zip(before, now, strict=True))
    )
    return Segmentation(phi, ratio, kept)


class _Pixels(NamedTuple):
    """What stays as it is while the contour moves: images, and (V, S, S) what follows from them."""

    images: CanvasImages
    bins: Array
    background_density: Array

    @classmethod
    def of(cls, images: CanvasImages, plan: SegmentationPlan) -> "_Pixels":
        """With the bins of histograms, and the density of the background."""
        colour, room, noise = map(jnp.asarray, (images.colour, images.background, images.noise))
        bins = (densities.joint_bins if plan.colour else densities.grey_bins)(colour)
        density = jnp.zeros(())
        if plan.background:
            density = densities.background_density(colour, room, noise)
        return cls(images, bins, density)


def _histograms(
    phi: Array, pixels: _Pixels, count: int, stage: Stage, plan: SegmentationPlan
) -> Histograms:
    """Counts of both sides, but for the cells next to the contour that the stage leaves out."""
    # A coarse cell counts as the four that it is, so that histograms can be added.
    weight = 4.0 if stage.coarse else 1.0
    person, rest = (
        weight * heaviside(sign * phi - stage.gap, REGION_WIDTH) * pixels.images.inside
        for sign in (1.0, -1.0)
    )
    if plan.background:
        share = pixels.background_density / (pixels.background_density + ANYTHING_DENSITY)
        person = person * (1 - pixels.images.certainty * share)
        rest = rest * (1 - pixels.images.certainty * (1 - share))
    return Histograms(
        *(densities.histogram_counts(pixels.bins, side, count) for side in (person, rest))
    )


def _log_ratio(
    histograms: Histograms, pixels: _Pixels, settings: LevelSetSettings, plan: SegmentationPlan
) -> Array:
    """Log p1 - log p2 (V, S, S), by histograms and the background."""
    density = densities.colour_density if plan.colour else densities.grey_density
    person, rest = (densities.lookup(density(each), pixels.bins) for each in histograms)
    if plan.background:
        other = settings.outlier_share
        empty = (1 - other) * pixels.background_density + other * rest
        rest = pixels.images.certainty * empty + (1 - pixels.images.certainty) * rest
    ratio = jnp.log(person + LEAST_DENSITY) - jnp.log(rest + LEAST_DENSITY)
    return jnp.clip(ratio, -settings.largest_log_ratio, settings.largest_log_ratio)
