"""Colours of the person and of everything else: smoothed histograms.

INPUTS: frames uint8, masks of where the body surely is and of where it may be.
OUTPUTS: Colours, densities over colour bins; or, frame by frame, RunningColours.
"""

from dataclasses import dataclass, field

import cv2
import numpy as np

from jaxmocap.images.background_model import spread

# Levels of each channel in a histogram, and the blur between neighbouring bins.
LEVELS, BIN_BLUR = 16, 0.7
BINS = LEVELS**3
# Every colour has this share of the even distribution: what was never observed is not impossible.
EVEN_SHARE = 1e-4


@dataclass(frozen=True)
class Colours:
    """How likely colours are, per cubic grey level: (BINS,) float32 each, never 0.

    Attributes:
        body: of the person.
        rest: of everything else.
    """

    body: np.ndarray
    rest: np.ndarray


@dataclass
class RunningColours:
    """Colours that only look back: fed frame by frame, at any time ready to be used.

    Attributes:
        body: (BINS,) pixels of the person so far.
        rest: (BINS,) of everything else.
    """

    body: np.ndarray = field(default_factory=lambda: np.zeros(BINS), repr=False)
    rest: np.ndarray = field(default_factory=lambda: np.zeros(BINS), repr=False)

    def update(self, frame: np.ndarray, core: np.ndarray, body: np.ndarray) -> None:
        """Count a frame (h, w, 3) uint8 inside the core and outside the body (h, w) bool."""
        bins = colour_bins(frame)
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
        counted.update(frames[i], cores[i], bodies[i])
    return counted.colours()


def _density(counts: np.ndarray) -> np.ndarray:
    """Counts (BINS,) smoothed over neighbouring colours, per cubic grey level, float32."""
    cube = counts
    for _ in range(3):
        # Blurs the first of the three channels and makes it the last.
        plane = np.ascontiguousarray(cube.reshape(LEVELS, -1).T)
        cube = cv2.GaussianBlur(plane, (5, 1), BIN_BLUR, borderType=cv2.BORDER_REFLECT)
    even = np.full(BINS, 1 / BINS)
    share = cube.ravel() / cube.sum() if counts.any() else even
    return (((1 - EVEN_SHARE) * share + EVEN_SHARE * even) * (LEVELS / 256) ** 3).astype(np.float32)
