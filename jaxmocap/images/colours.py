"""Colours of the person and of everything else: smoothed histograms.

INPUTS: frames uint8, masks of where the body surely is and of where it may be.
OUTPUTS: Colours, densities over colour bins; or, frame by frame, RunningColours; how likely
colours are before a learned background, lit or in shadow: on the host and the device.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np

from jaxmocap.images.background_model import spread

# Levels of each channel in a histogram, and the blur between neighbouring bins.
LEVELS, BIN_BLUR = 16, 0.7
BINS = LEVELS**3
BLUR = cv2.GaussianBlur(np.eye(LEVELS), (1, 5), BIN_BLUR, borderType=cv2.BORDER_REFLECT)
# Every colour has this share of the even distribution: what was never observed is not impossible.
EVEN_SHARE = 1e-4


@dataclass(frozen=True)
class Colours:
    """How likely colours are, per cubic grey level: (BINS,) float32 each, never 0."""

    body: np.ndarray  # of the person
    rest: np.ndarray  # of everything else


@dataclass
class RunningColours:
    """Colours that only look back: fed frame by frame, at any time ready to be used."""

    # (BINS,) pixels of the person so far.
    body: np.ndarray = field(default_factory=lambda: np.zeros(BINS), repr=False)
    # (BINS,) of everything else.
    rest: np.ndarray = field(default_factory=lambda: np.zeros(BINS), repr=False)

    def update(self, bins: np.ndarray, core: np.ndarray, body: np.ndarray) -> None:
        """Count a frame's ``colour_bins`` inside the core and outside the body, each (h, w)."""
        self.body += np.bincount(bins[core], minlength=BINS)
        self.rest += np.bincount(bins[~body], minlength=BINS)

    def colours(self) -> Colours:
        """The densities so far; even distributions before the first frame."""
        return Colours(_density(self.body), _density(self.rest))


def colour_bins(image: np.ndarray) -> np.ndarray:
    """Histogram bin (...) of every pixel of an image (..., 3) uint8."""
    levels = (image.reshape(-1, 1, 3) // (256 // LEVELS)).astype(np.float32)
    places = np.array([[LEVELS**2, LEVELS, 1.0]])
    return cv2.transform(levels, places).astype(np.uint16).reshape(image.shape[:-1])


def learn_colours(frames: np.ndarray, cores: np.ndarray, bodies: np.ndarray) -> Colours:
    """Colours inside the cores and outside the bodies.

    Args:
        frames: (N, h, w, 3) uint8.
        cores: (N, h, w) bool, surely the person.
        bodies: (N, h, w) bool, perhaps the person.
    """
    counted = RunningColours()
    for i in spread(len(frames)):
        counted.update(colour_bins(frames[i]), cores[i], bodies[i])
    return counted.colours()


def _density(counts: np.ndarray) -> np.ndarray:
    """Counts (BINS,) smoothed over neighbouring colours, per cubic grey level, float32."""
    cube = counts
    for _ in range(3):
        # Blurs the first of the three channels and makes it the last.
        cube = (BLUR @ cube.reshape(LEVELS, -1)).T
    even = np.full(BINS, 1 / BINS)
    share = cube.ravel() / cube.sum() if counts.any() else even
    return (((1 - EVEN_SHARE) * share + EVEN_SHARE * even) * (LEVELS / 256) ** 3).astype(np.float32)


# Share of the background that lies in shadow, and how much light is left there at least.
SHADED, DARKEST = 0.05, 0.6
# Beyond this exponent a normal density is none at all (and would underflow).
FARTHEST = 60.0


def lit_or_shaded_density(
    observed_observed: Any,
    observed_room: Any,
    room_room: Any,
    noise: Any,
    exp: Callable[[Any], Any],
) -> Any:
    """Density (...), per cubic grey level, of colours before a background, lit or shaded.

    Normal about the background's colour; or, in shadow, evenly on the way from there towards black
    as far as ``DARKEST``, and normal across it.

    Args:
        observed_observed: (...) NumPy's or JAX's: squares of the colours,
        observed_room: products with those of the background,
        room_room: and squares of these, grey levels.
        noise: (...) standard deviation of each channel of the background, grey levels.
        exp: that is fastest for such arrays.
    """
    xp, room_room = room_room.__array_namespace__(), room_room + 1
    lit = xp.clip(observed_room / room_room, DARKEST, 1)
    across = observed_observed - lit * (2 * observed_room - lit * room_room)
    away = observed_observed - 2 * observed_room + room_room
    precision = 0.5 / noise**2
    planar = precision / xp.pi
    plain = planar * xp.sqrt(planar) * exp(-xp.minimum(away * precision, FARTHEST))
    length = (1 - DARKEST) * xp.sqrt(room_room)
    shaded = planar / length * exp(-xp.minimum(across * precision, FARTHEST))
    return (1 - SHADED) * plain + SHADED * shaded
