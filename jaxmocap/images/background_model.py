"""The room without the person, learned from frames in which the person stands in its way.

Every pixel takes the median of the frames in which no body covers it; where a body always did, the
background is unknown rather than guessed. A camera that brightens or darkens as a whole is followed
frame by frame.

INPUTS: frames (N, h, w, 3) uint8, masks (N, h, w) bool of where the body may be. OUTPUTS: a
Background; or, for a live run, a RunningBackground, which uses earlier frames alone.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import cv2
import numpy as np

# More frames than these, spread over the recording, add nothing to what is learned of a room.
MOST_FRAMES = 60
# A pixel is certain once this share of the frames shows it, and at least so many of them.
CERTAIN_SHARE, CERTAIN_FRAMES = 0.1, 3
# Noise below this may be compression and rounding (grey levels); noise above is not the sensor's:
# something moves there, and the pixel becomes uncertain.
LEAST_NOISE, MOST_NOISE = 3.0, 12.0
# A normal distribution's standard deviation by its median and its mean absolute deviation.
SIGMA_PER_MAD, SIGMA_PER_MEAN = 1.4826, 1.2533
# Exposure is read at about so many rows, believed up to this ratio, and left as it is where it
# differs by less than that.
SAMPLED_ROWS = 40
MOST_GAIN, LEAST_GAIN = 2.0, 0.005
# Values by which an exposure is measured (grey levels), and the fewest of them.
DARK, BRIGHT, FEWEST = 20, 245, 50
# Shares of the sampled pixels that agree with the background where it is used not at all, fully:
# of those that no body hides, and, where these are too few, of all.
AGREEING, AGREEING_OF_ALL = (0.6, 0.85), (0.25, 0.5)
# Pixels agree at least up to so many grey levels. Two frames show one room where so many do, as a
# share of those in frames that follow each other.
ALIKE_LEVELS, SAME_ROOM = 18, 0.65
# Rows at a time: what the processor's cache holds.
ROWS = 8


class Background(NamedTuple):
    """What the camera sees where nobody stands."""

    colour: np.ndarray  # (h, w, 3) float32, grey levels in the frames' own order of channels
    noise: np.ndarray  # (h, w) float32, standard deviation of each channel, grey levels
    certainty: np.ndarray  # (h, w) float32, 0 to 1: of having observed the pixel without the person

    def part(self, rows_columns: tuple[slice, slice]) -> "Background":
        """Some rows and columns of it: a view."""
        return Background(*(values[rows_columns] for values in self))


def spread(count: int, most: int = MOST_FRAMES) -> np.ndarray:
    """Indices of at most so many frames, evenly over a recording of ``count``."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int))


def learn_background(
    frames: np.ndarray, bodies: np.ndarray | None = None, share: float = 0.5
) -> Background:
    """The background of a recording by a camera that stands still.

    Args:
        frames: (N, h, w, 3) uint8; of many, ``MOST_FRAMES`` are looked at.
        bodies: (N, h, w) bool, where the person may be, generously; None: nobody was there.
        share: of what each pixel showed unmasked, that is darker than the background.

    Returns:
        What lies there in the order of brightness, by default the median, and how far the pixel
        scatters about it.
    """
    chosen = spread(len(frames))
    frames = frames[chosen]
    free = np.ones(frames.shape[:3], bool) if bodies is None else ~bodies[chosen]
    even = equally_exposed(frames, free)
    alike = most_alike(even, free)
    return background_of(even[alike], free[alike], share)


def most_alike(frames: np.ndarray, free: np.ndarray) -> np.ndarray:
    """Indices, ascending, of those frames (N, h, w, 3) whose room is that of most of them.

    A camera that was pushed shows another one from then on; of both together the median would be
    neither. Only pixels (N, h, w) that no body hides count.
    """
    some = exposure_sample(frames[0])
    few, open_ = frames[:, *some].astype(np.int16), free[:, *some]
    shares = np.ones((len(few), len(few)))
    for i, own in enumerate(few):
        both = open_ & open_[i]
        same = both & (np.abs(few - own).max(-1) < ALIKE_LEVELS)
        counts = both.sum((1, 2))
        shares[i] = np.where(counts < FEWEST, 1, same.sum((1, 2)) / np.maximum(counts, 1))
    usual = np.median(np.diagonal(shares, 1)) if len(few) > 1 else 1.0
    alike = shares >= SAME_ROOM * usual
    return np.flatnonzero(alike[alike.sum(1).argmax()])


def background_of(frames: np.ndarray, free: np.ndarray, share: float = 0.5) -> Background:
    """``learn_background`` by frames (N, h, w, 3) of one exposure, where pixels are free."""
    colour, noise, counts = _rank_frames(frames, free, share)
    return Background(colour, *_noise_and_certainty(noise, counts, CERTAIN_SHARE * len(frames)))


def _noise_and_certainty(
    noise: np.ndarray, counts: np.ndarray, enough: float
) -> tuple[np.ndarray, np.ndarray]:
    """Noise within its bounds, and pixels' certainty by counts of sightings and their scatter."""
    steady = np.minimum(1, (MOST_NOISE / np.maximum(noise, MOST_NOISE)) ** 2)
    certainty = np.minimum(1, counts / max(enough, CERTAIN_FRAMES)) * steady
    return np.clip(noise, LEAST_NOISE, MOST_NOISE).astype(np.float32), certainty.astype(np.float32)


def _rank_frames(
    frames: np.ndarray, free: np.ndarray, share: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Colour (h, w, 3) brighter than a share, scatter (h, w), sightings (h, w) of free pixels."""
    colour = np.empty(frames.shape[1:], np.float32)
    noise = np.empty(frames.shape[1:3], np.float32)
    counts = free.sum(0, dtype=np.int32)
    for top in range(0, frames.shape[1], ROWS):
        rows = slice(top, top + ROWS)
        covered = ~free[:, rows, :, None]
        # Covered pixels sort behind all others: the last is that of the others.
        last = np.maximum(counts[rows, :, None], 1) - 1
        part = np.where(covered, np.uint8(255), frames[:, rows])
        usual = nth_smallest(part, (share * last).astype(last.dtype))
        away = np.where(
            covered, np.uint8(255), cv2.absdiff(part, np.broadcast_to(usual, part.shape))
        )
        colour[rows] = usual
        noise[rows] = SIGMA_PER_MAD * nth_smallest(away, last // 2).mean(-1)
    return colour, np.where(counts > 0, noise, 0), counts


def nth_smallest(values: np.ndarray, rank: np.ndarray) -> np.ndarray:
    """The ``rank``-th smallest (from 0) of (N, ...) uint8 values along the first axis, N < 256.

    Found bit by bit, highest first: eight counts of what lies below, which takes a tenth of the
    time of sorting.
    """
    result = np.zeros(values.shape[1:], np.uint8)
    below, less = np.empty_like(result), np.empty(result.shape, bool)
    for bit in (128, 64, 32, 16, 8, 4, 2, 1):
        middle = result + np.uint8(bit)
        below.fill(0)
        for value in values:
            np.less(value, middle, out=less)
            np.add(below, less.view(np.uint8), out=below)
        result = np.where(below <= rank, middle, result)
    return result


def exposure_sample(image: np.ndarray) -> tuple[slice, slice]:
    """Rows and columns of an image (h, w, ...) that are enough to read its exposure."""
    step = max(1, round(len(image) / SAMPLED_ROWS))
    every = slice(step // 2, None, step)
    return every, every


def equally_exposed(frames: np.ndarray, free: np.ndarray) -> np.ndarray:
    """Frames brought to the exposure of their median, as far as they show it."""
    few, open_ = frames[:, *exposure_sample(frames[0])], free[:, *exposure_sample(frames[0])]
    usual, _, counts = _rank_frames(few, open_, 0.5)
    shown = open_ & (counts > 0)
    gains = [gain(few[i][shown[i]].T, usual[shown[i]].T) for i in range(len(frames))]
    return np.stack([undo_gains(frame, g) for frame, g in zip(frames, gains, strict=True)])


def gain(pixels: np.ndarray, expected: np.ndarray) -> np.ndarray | None:
    """How much brighter each channel is than expected: (3,), or None where no exposure is.

    The median of the ratios of (3, K) values, then of those near it, so that what stands before
    the background does not count. Dark and overexposed values do not count: of a channel that has
    hardly any others, as before a green wall, it is 1.
    """
    observed, usual = (np.ascontiguousarray(each, np.float32) for each in (pixels, expected))
    usable = (usual > DARK) & (usual < BRIGHT) & (observed < BRIGHT)
    gains = np.ones(3)
    for channel, ratios in enumerate(observed / np.maximum(usual, 1)):
        ratios = ratios[usable[channel]]
        if len(ratios) < FEWEST:
            continue
        near = np.abs(ratios - _middle(ratios))
        gains[channel] = _middle(ratios[near <= 2 * _middle(near)])
    return gains if (gains < MOST_GAIN).all() and (gains > 1 / MOST_GAIN).all() else None


def _middle(values: np.ndarray) -> float:
    """The median of many values, or the one beside it: NumPy's own takes several times as long."""
    return np.partition(values, len(values) // 2)[len(values) // 2]


def undo_gains(frame: np.ndarray, gains: np.ndarray | None) -> np.ndarray:
    """The frame (h, w, 3) uint8 as it would be at a gain of one."""
    if gains is None or np.abs(gains - 1).max() < LEAST_GAIN:
        return frame
    levels = np.arange(256)[None, :, None] / gains
    return cv2.LUT(frame, np.clip(np.rint(levels), 0, 255).astype(np.uint8))


def exposure(
    frame: np.ndarray, background: Background, free: np.ndarray
) -> tuple[np.ndarray | None, float]:
    """A frame's gains (3,) against a background, and how far it can be that room.

    None and 0 where the gains cannot be read. A black frame, a moved camera, something that covers
    half of the image or a cut to something else agrees with the background far too seldom:
    nothing then follows from a difference.

    Args:
        frame: (h, w, 3) uint8.
        background: of that size.
        free: (h, w) bool, where the body cannot be.
    """
    some = exposure_sample(frame)
    return _exposure(frame, background.part(some), free[some])


def _exposure(
    frame: np.ndarray, few: Background, free: np.ndarray
) -> tuple[np.ndarray | None, float]:
    """``exposure`` by the background, and where no body is, at every so many pixels."""
    sure = np.flatnonzero(few.certainty > 0.5)
    if len(sure) < FEWEST:
        return None, 0.0
    some = frame[exposure_sample(frame)].reshape(-1, 3), few.colour.reshape(-1, 3)
    # Channel by channel: long rows are several times as fast as rows of three.
    pixels, expected = (np.take(each.T, sure, 1).astype(np.float32) for each in some)
    gains = gain(pixels, expected)
    if gains is None:
        return None, 0.0
    away = np.abs(pixels / gains[:, None].astype(np.float32) - expected).max(0)
    agreeing = away < np.maximum(3 * few.noise.ravel()[sure], ALIKE_LEVELS)
    elsewhere = free.ravel()[sure]
    is_enough = elsewhere.sum() >= FEWEST
    low, high = AGREEING if is_enough else AGREEING_OF_ALL
    share = float((agreeing[elsewhere] if is_enough else agreeing).mean())
    return gains, float(np.clip((share - low) / (high - low), 0, 1))


@dataclass
class RunningBackground:
    """A background that only looks back: fed frame by frame, at any time ready to be used.

    A running mean at first, an exponential one of about ``memory`` sightings later, whose steps are
    bounded, since a median needs all the frames at once. Where nothing agrees with it for so long
    that the camera must have been moved, it starts again.
    """

    memory: float = 300.0  # sightings after which earlier ones fade
    enough: float = 6.0  # sightings after which a pixel is certain
    patience: int = 30  # frames in a row that may disagree
    _counts: np.ndarray | None = field(default=None, repr=False)
    _colour: np.ndarray = field(default_factory=lambda: np.zeros(0), repr=False)
    _noise: np.ndarray = field(default_factory=lambda: np.zeros(0), repr=False)
    _strangers: int = field(default=0, repr=False)

    def update(self, frame: np.ndarray, body: np.ndarray | None = None) -> None:
        """Look at a frame (h, w, 3) uint8, except where the body (h, w) bool may be."""
        if self._counts is None or self._strangers >= self.patience:
            self._start(frame.shape)
        elif ((some := self._sample(frame)).certainty > 0).sum() >= FEWEST:
            everywhere = np.ones(frame.shape[:2], bool) if body is None else ~body
            gains, agreement = _exposure(frame, some, everywhere[exposure_sample(frame)])
            self._strangers = 0 if agreement > 0 else self._strangers + 1
            if agreement == 0:
                return
            frame = undo_gains(frame, gains)
        self._learn(frame, np.zeros(frame.shape[:2], bool) if body is None else body)

    def background(self) -> Background:
        """The model so far: a copy, which later frames leave as it is."""
        if self._counts is None:
            raise ValueError("RunningBackground has no frame yet: call update first")
        noise, certainty = _noise_and_certainty(self._noise, self._counts, self.enough)
        return Background(self._colour.copy(), noise, certainty)

    def _sample(self, frame: np.ndarray) -> Background:
        """Every so many pixels; one sighting is good enough to read the exposure."""
        assert self._counts is not None
        some = exposure_sample(frame)
        counts, noise = self._counts[some], np.maximum(self._noise[some], LEAST_NOISE)
        # Of few sightings the noise cannot be estimated yet.
        noise = np.where(counts > self.enough, noise, np.maximum(noise, MOST_NOISE))
        return Background(self._colour[some], noise, np.minimum(counts, 1))

    def _start(self, shape: tuple[int, ...]) -> None:
        """Forget everything."""
        self._counts, self._noise = np.zeros(shape[:2], np.float32), np.zeros(shape[:2], np.float32)
        self._colour, self._strangers = np.zeros(shape, np.float32), 0

    def _learn(self, frame: np.ndarray, body: np.ndarray) -> None:
        """Move each free pixel's mean and noise towards the frame, by bounded steps."""
        assert self._counts is not None
        self._counts = np.minimum(self._counts + ~body, np.float32(self.memory))
        rate = np.where(body, np.float32(0), 1 / np.maximum(self._counts, 1))
        step = cv2.subtract(frame, self._colour, dtype=cv2.CV_32F)
        away = cv2.transform(np.abs(step), np.full((1, 3), SIGMA_PER_MEAN / 3))
        usual = np.where(self._counts > self.enough, np.maximum(self._noise, LEAST_NOISE), 255)
        bounded = np.minimum(away, 3 * usual)
        cv2.multiply(step, cv2.merge([rate * (bounded / np.maximum(away, 1))] * 3), dst=step)
        cv2.add(self._colour, step, dst=self._colour)
        # The first sighting is a colour, not yet a deviation.
        self._noise += np.where(self._counts > 1, rate, np.float32(0)) * (bounded - self._noise)
