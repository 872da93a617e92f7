"""Segmentation: where the person is in each camera's image (section 4.1).

A level set starts from the silhouette of the predicted pose and moves to where the densities of
person and rest explain the image best (4.19). Densities are estimated as the contour moves:
histograms, of grey levels or of colours, and, for a camera that stands still, what is known of the
room behind every single cell. What looks like the room tells nothing of the person, and what does
not tells nothing of the rest: so a predicted limb that lies beside the true one does not make floor
and limb change places. Where exactly the contour lies is for ``images.sharpen`` to say.

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
    downsampled,
    evolve,
    heaviside,
    upsampled,
)

# A cell is the room's as far as this is likelier than such a density, per cubic grey level.
ANYTHING = 1e-6
# Width of H where it weighs pixels of the two regions, cells.
SOFT = 1.5
LEAST = 1e-30


class CanvasImages(NamedTuple):
    """V cameras' images on canvases of S x S cells.

    Attributes:
        colour: (V, 3, S, S) uint8, BGR, channel by channel: XLA takes a tenth longer to pick them
            out of pixels.
        inside: (V, S, S) 0 to 1, how far the cell lies within the image.
        background: (V, 3, S, S) uint8, what the cell shows where nobody stands.
        noise: (V, S, S) float32, its deviation, grey levels.
        certainty: (V, S, S) float32, 0 to 1, how surely that is known.
    """

    colour: Array | np.ndarray
    inside: Array | np.ndarray
    background: Array | np.ndarray
    noise: Array | np.ndarray
    certainty: Array | np.ndarray

    @classmethod
    def of(cls, canvases: Sequence[Canvas]) -> "CanvasImages":
        """What V cameras' canvases show."""
        colour, inside, room, *rest = (np.stack(parts) for parts in zip(*canvases, strict=True))
        planes = (np.moveaxis(image, -1, 1).copy() for image in (colour, room))
        return cls(next(planes), inside, next(planes), *rest)


class Stage(NamedTuple):
    """Some steps between two estimates of the densities; static.

    Attributes:
        steps: how many.
        width: of H' in cells, of twice the size where ``coarse``.
        background_width: the same where the room is known: a limb beside the predicted one is seen from afar.
        coarse: whether on cells of twice the size.
        gap: cells about the contour that histograms leave out.
    """

    steps: int
    width: float
    background_width: float
    coarse: bool = False
    gap: float = 0.0


class SegmentationPlan(NamedTuple):
    """What is computed; static.

    Attributes:
        colour: joint histograms of colours rather than of grey levels.
        background: whether anything is known of the rooms; their densities are of colours.
        stages: in turn.
    """

    colour: bool = True
    background: bool = True
    stages: tuple[Stage, ...] = (
        Stage(8, 4.0, 8.0, coarse=True, gap=2.0),
        Stage(8, 2.0, 2.0, coarse=True, gap=1.0),
        Stage(10, 1.5, 1.5, gap=0.5),
    )


class LevelSetSettings(NamedTuple):
    """Traced numbers.

    Attributes:
        motion: of the level set.
        largest_log_ratio: log-ratios are cut off here.
        outlier_share: share of the room that does not look as it is known.
        shape_prior: log-ratio by which a cell far from the predicted silhouette must do better.
        prior_reach: how far that is, cells.
        histogram_decay: weight of the histograms before in those of the next frame.
    """

    motion: LevelSetMotion = LevelSetMotion()
    largest_log_ratio: Array | float = 3.0
    outlier_share: Array | float = 0.002
    shape_prior: Array | float = 0.0
    prior_reach: Array | float = 12.0
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
    """What V cameras see of the person.

    Attributes:
        phi: (V, S, S) cells, positive within the person.
        log_ratio: (V, S, S) how much likelier a cell is the person than the rest.
        histograms: to begin the next frame with.
    """

    phi: Array
    log_ratio: Array
    histograms: Histograms


@partial(jax.jit, static_argnames="plan")
def segment(
    seen: CanvasImages,
    start: Array,
    before: Histograms,
    settings: LevelSetSettings,
    plan: SegmentationPlan,
) -> Segmentation:
    """Segment V images.

    Args:
        seen: the images.
        start: (V, S, S) signed distance to the predicted silhouette, cells, positive within.
        before: of the frames before; ``Histograms.empty`` at first.
        settings: traced numbers.
        plan: static choices; another one compiles anew.
    """
    if plan.background and not plan.colour:
        raise ValueError("plan.room without plan.colour: expected plan.colour = True too")
    fine = _Pixels.of(seen, plan)
    coarse = fine.halved(plan)
    phi, ratio, now = jnp.clip(start, -BAND, BAND), jnp.zeros_like(start), before
    beyond = jnp.clip(start + settings.prior_reach, -settings.prior_reach, 0.0)
    prior = settings.shape_prior * beyond / settings.prior_reach
    for stage in plan.stages:
        pixels = coarse if stage.coarse else fine
        here = downsampled(phi) / 2 if stage.coarse else phi
        now = _histograms(here, pixels, before.person.shape[-1], stage, plan)
        mixed = Histograms(*(a + b for a, b in zip(now, before, strict=True)))
        ratio = _log_ratio(mixed, pixels, settings, plan)
        ratio = ratio * pixels.inside
        force = ratio + (downsampled(prior) if stage.coarse else prior)
        width = (
            stage.width + (stage.background_width - stage.width) * pixels.known
            if plan.background
            else stage.width
        )
        moved = evolve(here, force, settings.motion, width, stage.steps)
        phi = jnp.clip(upsampled(moved), -BAND, BAND) if stage.coarse else moved
    kept = Histograms(
        *(settings.histogram_decay * (a + b) for a, b in zip(before, now, strict=True))
    )
    return Segmentation(phi, ratio, kept)


class _Pixels(NamedTuple):
    """What stays as it is while the contour moves: channels (V, 3, S, S) and cells (V, S, S)."""

    colour: Array
    inside: Array
    room: Array
    noise: Array
    known: Array
    bins: Array
    empty: Array

    @classmethod
    def of(cls, seen: CanvasImages, plan: SegmentationPlan) -> "_Pixels":
        colour, room = (
            jnp.asarray(image).astype(jnp.float32) for image in (seen.colour, seen.background)
        )
        inside, noise, known = (jnp.asarray(a) for a in (seen.inside, seen.noise, seen.certainty))
        return cls._with(plan, colour, inside, room, noise, known)

    @classmethod
    def _with(cls, plan: SegmentationPlan, colour: Array, *rest: Array) -> "_Pixels":
        """With what follows from the rest: bins, and the density of the room."""
        inside, room, noise, known = rest
        bins = (densities.joint_bins if plan.colour else densities.grey_bins)(colour)
        empty = (
            densities.background_density(colour, room, noise) if plan.background else jnp.zeros(())
        )
        return cls(colour, inside, room, noise, known, bins, empty)

    def halved(self, plan: SegmentationPlan) -> "_Pixels":
        """On cells of twice the size."""
        return self._with(plan, *(downsampled(part) for part in self[:5]))


def _histograms(
    phi: Array, pixels: _Pixels, count: int, stage: Stage, plan: SegmentationPlan
) -> Histograms:
    """Counts of both sides, but for the cells next to the contour that the stage leaves out."""
    # A coarse cell counts as the four that it is, so that histograms can be added.
    weight = 4.0 if stage.coarse else 1.0
    person, rest = (
        weight * heaviside(sign * phi - stage.gap, SOFT) * pixels.inside for sign in (1.0, -1.0)
    )
    if plan.background:
        room = pixels.empty / (pixels.empty + ANYTHING)
        person, rest = person * (1 - pixels.known * room), rest * (1 - pixels.known * (1 - room))
    return Histograms(
        *(densities.histogram_counts(pixels.bins, side, count) for side in (person, rest))
    )


def _log_ratio(
    histograms: Histograms, pixels: _Pixels, settings: LevelSetSettings, plan: SegmentationPlan
) -> Array:
    """Log p1 - log p2 (V, S, S), by histograms and the room."""
    density = densities.colour_density if plan.colour else densities.grey_density
    person, rest = (densities.lookup(density(each), pixels.bins) for each in histograms)
    if plan.background:
        empty = (1 - settings.outlier_share) * pixels.empty + settings.outlier_share * rest
        rest = pixels.known * empty + (1 - pixels.known) * rest
    ratio = jnp.log(person + LEAST) - jnp.log(rest + LEAST)
    return jnp.clip(ratio, -settings.largest_log_ratio, settings.largest_log_ratio)
