"""Which pixels show the person: by a learned background and by the body's colours.

A pixel speaks for the person as far as the body's colours explain it better than the background
does; where the background is unknown it says nothing. The log-odds are resampled to a static grid
around the person, where a drawn silhouette can be laid over them.

INPUTS: frames uint8, masks of where the body may be and of where it surely is.
OUTPUTS: log-odds (h, w) float32, positive where the person is; grids of probability and weight.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from jaxmocap.images.background import Background, as_learned, learn_background, spread

# Log-odds are cut off here: no pixel is surer than 98 %.
MOST_ODDS = 4.0
# Levels of each channel in a colour histogram, and the blur between neighbouring bins.
LEVELS, BIN_BLUR = 16, 0.7
# Every colour has this share of the even distribution: what was never seen is not impossible.
EVEN_SHARE = 1e-4
# Of the background's pixels, how many show something else: passers-by, reflections, screens.
STRANGE = 0.02
# Blur of the log-odds, pixels.
SOFTNESS = 0.8
# Log-odds from which a pixel has its full weight.
FULL_WEIGHT_ODDS = 2.0


def shrunk_size(size: tuple[int, int], rows: int) -> tuple[int, int]:
    """Width and height of an image of that width and height, shrunk to ``rows``; never enlarged."""
    width, height = size
    return (width, height) if rows >= height else (max(1, round(width * rows / height)), rows)


def shrink(image: np.ndarray, rows: int) -> np.ndarray:
    """Average an image (H, W, ...) down to ``rows`` rows; one that has fewer is left as it is.

    Edges map onto edges: pixel x of W becomes ``(x + 0.5) w / W - 0.5`` of w, rows likewise
    (``shrunk_pixels``). Width is rounded, so the two ratios differ by up to half a pixel of w.
    """
    height, width = image.shape[:2]
    if rows >= height:
        return image
    return cv2.resize(image, shrunk_size((width, height), rows), interpolation=cv2.INTER_AREA)


def shrunk_pixels(pixels_xy: np.ndarray, size: tuple[int, int], rows: int) -> np.ndarray:
    """Where pixels (..., 2) of an image of width and height ``size`` lie once it is shrunk."""
    ratio = np.divide(shrunk_size(size, rows), size)
    return (np.asarray(pixels_xy) + 0.5) * ratio - 0.5


@dataclass(frozen=True)
class Colours:
    """How likely colours are, per cubic grey level: (LEVELS ** 3,) float32 each.

    Attributes:
        body: of the person.
        rest: of everything else.
    """

    body: np.ndarray
    rest: np.ndarray


def colour_bins(image: np.ndarray) -> np.ndarray:
    """Histogram bin (...) of every pixel of an image (..., 3) uint8."""
    a, b, c = np.moveaxis((image // (256 // LEVELS)).astype(np.int32), -1, 0)
    return (a * LEVELS + b) * LEVELS + c


def learn_colours(frames: np.ndarray, cores: np.ndarray, bodies: np.ndarray) -> Colours:
    """Colours inside the cores and outside the bodies.

    Args:
        frames: (N, h, w, 3) uint8.
        cores: (N, h, w) bool, surely the person.
        bodies: (N, h, w) bool, perhaps the person.
    """
    body, rest = np.zeros(LEVELS**3), np.zeros(LEVELS**3)
    for i in spread(len(frames)):
        bins = colour_bins(frames[i])
        body += np.bincount(bins[cores[i]], minlength=LEVELS**3)
        rest += np.bincount(bins[~bodies[i]], minlength=LEVELS**3)
    return Colours(_density(body), _density(rest))


def _density(counts: np.ndarray) -> np.ndarray:
    """Counts (LEVELS ** 3,) smoothed over neighbouring colours, per cubic grey level."""
    cube = counts.reshape(LEVELS, LEVELS, LEVELS)
    for _ in range(3):
        cube = np.moveaxis(_blurred_first(cube), 0, -1)
    share = cube.ravel() / max(cube.sum(), 1e-9) if counts.any() else np.full(LEVELS**3, 0.0)
    share = (1 - EVEN_SHARE) * share + EVEN_SHARE / LEVELS**3 if counts.any() else 1 / LEVELS**3
    return np.broadcast_to(share * (LEVELS / 256) ** 3, LEVELS**3).astype(np.float32)


def _blurred_first(cube: np.ndarray) -> np.ndarray:
    """A cube blurred along its first axis."""
    flat = np.ascontiguousarray(cube.reshape(LEVELS, -1))
    blurred = cv2.GaussianBlur(flat, (1, 5), 1e-6, sigmaY=BIN_BLUR, borderType=cv2.BORDER_REFLECT)
    return blurred.reshape(cube.shape)


def log_odds(frame: np.ndarray, background: Background, colours: Colours) -> np.ndarray:
    """How much more likely each pixel of a frame (h, w, 3) uint8 is under the person.

    With the background's colour B, noise s and knowledge k, the body's colours b and the rest's r:
    ``log[ b(I) / (k ((1 - e) N(I; B, s) + e r(I)) + (1 - k) b(I)) ]``, at most ``MOST_ODDS`` either
    way.

    Returns:
        (h, w) float32; 0 where nothing is known.
    """
    frame, trust = as_learned(frame, background)
    bins = colour_bins(frame)
    away = frame.astype(np.float32) - background.colour
    square = np.einsum("...c,...c->...", away, away) / (2 * background.noise**2)
    like = cv2.exp(-np.minimum(square, 60)) / ((2 * np.pi) ** 1.5 * background.noise**3)
    other = (1 - STRANGE) * like + STRANGE * colours.rest[bins]
    known = trust * background.known
    ratio = known * other / colours.body[bins] + (1 - known)
    odds = np.clip(-cv2.log(ratio.astype(np.float32)), -MOST_ODDS, MOST_ODDS)
    return cv2.GaussianBlur(odds, (0, 0), SOFTNESS)


def learn_foreground(
    frames: np.ndarray, cores: np.ndarray, bodies: np.ndarray, rounds: int = 2
) -> tuple[Background, Colours]:
    """Background and colours of a recording, each helping the other.

    At first a pixel is background where the body cannot be. Then also where it might be, in frames
    in which it looks like what is known of the background; what nobody has seen free stays unknown,
    so that someone who hardly moves is not taken for furniture.

    Args:
        frames: (N, h, w, 3) uint8.
        cores: (N, h, w) bool, surely the person, whatever the error of the pose.
        bodies: (N, h, w) bool, wherever the person may be.
        rounds: 1 or more.
    """
    chosen = spread(len(frames))
    frames, cores, bodies = frames[chosen], cores[chosen], bodies[chosen]
    colours, covered = learn_colours(frames, cores, bodies), bodies
    background = learn_background(frames, covered)
    for _ in range(rounds - 1):
        odds = np.stack([log_odds(frame, background, colours) for frame in frames])
        background = learn_background(frames, cores | (bodies & (odds >= 0)))
        colours = learn_colours(frames, cores & (odds >= 0), bodies)
    return background, colours


def person_grid(
    odds: np.ndarray, origin_px: np.ndarray, cell_px: float, size: int, blur: float = 0.5
) -> tuple[np.ndarray, np.ndarray]:
    """Log-odds averaged over the cells of a static grid.

    Args:
        odds: (h, w) float32.
        origin_px: (2,) pixel (x, y) of the grid's left upper corner: the edge, as in ``Region``.
        cell_px: pixels per cell.
        size: cells per side.
        blur: standard deviation of a further Gaussian blur, cells.

    Returns:
        P (size, size) float32, the probability that the person is there, mean by weight; and W, the
        weights' own mean, 0 to 1: 0 where nothing is known and outside the image. The middle of
        cell i lies at pixel ``origin + (i + 0.5) cell``.
    """
    weight = np.minimum(np.abs(odds) / FULL_WEIGHT_ODDS, 1)
    inside = np.ones_like(odds)
    layers = np.dstack([weight / (1 + cv2.exp(-odds)), weight, inside])
    finer = max(1, int(np.ceil(cell_px)))
    step = cell_px / finer
    x, y = np.asarray(origin_px, float) + step / 2
    fine = cv2.warpAffine(
        layers,
        np.array([[step, 0, x], [0, step, y]]),
        (size * finer, size * finer),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
    )
    coarse = cv2.resize(fine, (size, size), interpolation=cv2.INTER_AREA)
    outside = coarse[..., 2] < 0.5
    if blur > 0:
        coarse = cv2.GaussianBlur(coarse, (0, 0), blur, borderType=cv2.BORDER_REPLICATE)
    person, total, seen = np.moveaxis(coarse, -1, 0)
    probability = (person + 0.5e-3) / (total + 1e-3)
    return probability, np.where(outside, 0, total / np.maximum(seen, 1e-3)).astype(np.float32)
