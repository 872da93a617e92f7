"""The room without the person, learned from frames in which the person stands in its way.

Every pixel takes the median of the frames in which no body covers it; where a body always did, the
background is unknown rather than guessed. A camera that brightens or darkens as a whole is followed
frame by frame.

INPUTS: frames (N, h, w, 3) uint8, masks (N, h, w) bool of where the body may be. OUTPUTS: a
Background; or, for a live run, a RunningBackground, which knows the past alone.
"""

from dataclasses import dataclass, field

import cv2
import numpy as np

# More frames than these, spread over the recording, tell nothing new of a room.
MOST_FRAMES = 60
# A pixel is known once this share of the frames shows it, and never by fewer than so many of them.
KNOWN_SHARE, KNOWN_FRAMES = 0.1, 3
# Noise below this cannot be told from compression and rounding (grey levels); noise above is not
# the sensor's: something moves there, and the pixel counts as unknown by and by.
LEAST_NOISE, MOST_NOISE = 3.0, 12.0
# A normal distribution's standard deviation by its median and its mean absolute deviation.
SIGMA_PER_MAD, SIGMA_PER_MEAN = 1.4826, 1.2533
# Exposure is read at every so many pixels, and believed up to this ratio.
STRIDE, MOST_GAIN, LEAST_GAIN = 6, 2.0, 0.005
# Values that tell an exposure (grey levels), and the fewest of them.
DARK, BRIGHT, FEWEST = 20, 245, 50
# Shares of the sampled pixels that agree with the background where it is trusted not at all, fully.
AGREEING = (0.25, 0.5)
# Rows at a time: what the processor's cache holds.
ROWS = 8


@dataclass(frozen=True)
class Background:
    """What the camera sees where nobody stands.

    Attributes:
        colour: (h, w, 3) float32, grey levels in the frames' own order of channels.
        noise: (h, w) float32, standard deviation of each channel, grey levels.
        known: (h, w) float32, 0 to 1: how surely the pixel was seen without the person.
    """

    colour: np.ndarray
    noise: np.ndarray
    known: np.ndarray


def spread(count: int, most: int = MOST_FRAMES) -> np.ndarray:
    """Indices of at most so many frames, evenly over a recording of ``count``."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int))


def learn_background(frames: np.ndarray, bodies: np.ndarray | None = None) -> Background:
    """The background of a recording by a camera that stands still.

    Args:
        frames: (N, h, w, 3) uint8; of many, ``MOST_FRAMES`` are looked at.
        bodies: (N, h, w) bool, where the person may be, generously; None: nobody was there.

    Returns:
        The median of what each pixel showed unmasked, and how far it scatters about it.
    """
    chosen = spread(len(frames))
    frames = frames[chosen]
    free = np.ones(frames.shape[:3], bool) if bodies is None else ~bodies[chosen]
    frames = _equally_exposed(frames, free)
    colour, noise, seen = _medians(frames, free)
    return Background(colour, *_trusted(noise, seen, KNOWN_SHARE * len(frames)))


def _trusted(noise: np.ndarray, seen: np.ndarray, enough: float) -> tuple[np.ndarray, np.ndarray]:
    """Noise within its bounds, and how surely pixels are known by sightings and their scatter."""
    steady = np.minimum(1, (MOST_NOISE / np.maximum(noise, MOST_NOISE)) ** 2)
    known = np.minimum(1, seen / max(enough, KNOWN_FRAMES)) * steady
    return np.clip(noise, LEAST_NOISE, MOST_NOISE).astype(np.float32), known.astype(np.float32)


def _medians(frames: np.ndarray, free: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Median colour (h, w, 3), scatter (h, w) and sightings (h, w) of the free pixels."""
    colour = np.empty(frames.shape[1:], np.float32)
    noise = np.empty(frames.shape[1:3], np.float32)
    seen = free.sum(0, dtype=np.int32)
    for top in range(0, frames.shape[1], ROWS):
        rows = slice(top, top + ROWS)
        covered = ~free[:, rows, :, None]
        # Covered pixels sort behind all others: the middle is that of the others.
        middle = (np.maximum(seen[rows, :, None], 1) - 1) // 2
        part = np.where(covered, np.uint8(255), frames[:, rows])
        median = ranked(part, middle)
        away = np.where(
            covered, np.uint8(255), cv2.absdiff(part, np.broadcast_to(median, part.shape))
        )
        colour[rows] = median
        noise[rows] = SIGMA_PER_MAD * ranked(away, middle).mean(-1)
    return colour, np.where(seen > 0, noise, 0), seen


def ranked(values: np.ndarray, rank: np.ndarray) -> np.ndarray:
    """The ``rank``-th smallest (from 0) of (N, ...) uint8 values along the first axis, N < 256.

    Found bit by bit, highest first: eight counts of what lies below, which takes a tenth of the
    time of sorting.
    """
    found = np.zeros(values.shape[1:], np.uint8)
    below, less = np.empty_like(found), np.empty(found.shape, bool)
    for bit in (128, 64, 32, 16, 8, 4, 2, 1):
        middle = found + np.uint8(bit)
        below.fill(0)
        for value in values:
            np.less(value, middle, out=less)
            np.add(below, less.view(np.uint8), out=below)
        found = np.where(below <= rank, middle, found)
    return found


def _equally_exposed(frames: np.ndarray, free: np.ndarray) -> np.ndarray:
    """Frames brought to the exposure of their median, as far as they show it."""
    few, open_ = frames[:, ::STRIDE, ::STRIDE], free[:, ::STRIDE, ::STRIDE]
    usual, _, seen = _medians(few, open_)
    shown = open_ & (seen > 0)
    gains = [gain(few[i][shown[i]], usual[shown[i]]) for i in range(len(frames))]
    return np.stack([regained(frame, g) for frame, g in zip(frames, gains, strict=True)])


def gain(pixels: np.ndarray, expected: np.ndarray) -> np.ndarray | None:
    """How much brighter each channel is than expected: (3,), or None where nothing tells.

    The median of the ratios of (K, 3) values, then of those near it, so that what stands before
    the background does not count. Dark and overexposed values do not tell.
    """
    gains = np.ones(3)
    for channel in range(3):
        a, b = pixels[:, channel].astype(np.float32), expected[:, channel]
        telling = (b > DARK) & (b < BRIGHT) & (a < BRIGHT)
        if telling.sum() < FEWEST:
            return None
        ratios = a[telling] / b[telling]
        middle = np.median(ratios)
        near = np.abs(ratios - middle)
        gains[channel] = np.median(ratios[near <= 2 * np.median(near)])
    return gains if (gains < MOST_GAIN).all() and (gains > 1 / MOST_GAIN).all() else None


def regained(frame: np.ndarray, gains: np.ndarray | None) -> np.ndarray:
    """The frame (h, w, 3) uint8 as it would be at a gain of one."""
    if gains is None or np.abs(gains - 1).max() < LEAST_GAIN:
        return frame
    levels = np.arange(256)[None, :, None] / gains
    return cv2.LUT(frame, np.clip(np.rint(levels), 0, 255).astype(np.uint8))


def as_learned(frame: np.ndarray, background: Background) -> tuple[np.ndarray, float]:
    """The frame at the background's exposure, and how far it can be that room at all: 0 to 1.

    A black frame, a moved camera or a cut to something else agrees with the background hardly
    anywhere: nothing then follows from a difference.
    """
    few = (slice(None, None, STRIDE),) * 2
    sure = background.known[few] > 0.5
    pixels, expected = frame[few][sure], background.colour[few][sure]
    gains = gain(pixels, expected)
    if gains is None:
        return frame, 0.0
    away = np.abs(pixels / gains - expected).max(-1)
    agreeing = float((away < 3 * background.noise[few][sure]).mean())
    low, high = AGREEING
    return regained(frame, gains), float(np.clip((agreeing - low) / (high - low), 0, 1))


@dataclass
class RunningBackground:
    """A background that only looks back: fed frame by frame, at any time ready to be used.

    A running mean at first, an exponential one of about ``memory`` sightings later, from which
    outliers are cut, since a median needs all the frames at once.

    Attributes:
        memory: sightings after which the past fades.
        enough: sightings after which a pixel is known.
    """

    memory: float = 300.0
    enough: float = 6.0
    _colour: np.ndarray | None = field(default=None, repr=False)
    _noise: np.ndarray = field(default_factory=lambda: np.zeros(0), repr=False)
    _seen: np.ndarray = field(default_factory=lambda: np.zeros(0), repr=False)

    def update(self, frame: np.ndarray, body: np.ndarray | None = None) -> None:
        """Look at a frame (h, w, 3) uint8, except where the body (h, w) bool may be."""
        if self._colour is None:
            self._colour = np.zeros(frame.shape, np.float32)
            self._noise = np.zeros(frame.shape[:2], np.float32)
            self._seen = np.zeros(frame.shape[:2], np.float32)
        elif self._seen.any():
            frame, trust = as_learned(frame, self.background())
            if trust == 0:
                return
        free = np.ones(frame.shape[:2], np.float32) if body is None else (~body).astype(np.float32)
        self._seen = np.minimum(self._seen + free, self.memory)
        rate = free / np.maximum(self._seen, 1)
        bound = np.where(self._seen > self.enough, 3 * np.maximum(self._noise, LEAST_NOISE), 255)
        step = np.clip(frame - self._colour, -bound[..., None], bound[..., None])
        self._colour += rate[..., None] * step
        late = rate * (self._seen > 1)
        self._noise += late * (SIGMA_PER_MEAN * np.abs(step).mean(-1) - self._noise)

    def background(self) -> Background:
        """What is known so far."""
        if self._colour is None:
            raise ValueError("RunningBackground has not seen any frame yet: call update first")
        return Background(self._colour, *_trusted(self._noise, self._seen, self.enough))
