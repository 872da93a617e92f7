"""Which pixels show the person: by a learned background and by the body's colours.

A pixel speaks for the person as far as the body's colours explain it better than the background
does; where the background is unknown, the colours of all the rest stand in for it. The log-odds are
resampled to a static grid around the person, where a drawn silhouette can be laid over them.

INPUTS: frames uint8, masks of where the body may be and of where it surely is.
OUTPUTS: log-odds (h, w) float32, positive where the person is; grids of probability and weight.
"""

import cv2
import numpy as np

from jaxmocap.images.background_model import (
    Background,
    background_of,
    equally_exposed,
    exposure,
    most_alike,
    spread,
    undo_gains,
)
from jaxmocap.images.colours import Colours, colour_bins, learn_colours, lit_or_shaded_density

# Rows and columns of an image.
Window = tuple[slice, slice]
EVERYWHERE = (slice(None), slice(None))
# What pixels (h, w) show of the person, times its weight; and the weight.
Layers = tuple[np.ndarray, np.ndarray]
# Log-odds are cut off here: no pixel is surer than 98 %.
MOST_ODDS = 4.0
# Of the background's pixels, how many show something else: passers-by, reflections, screens.
STRANGE = 0.02
# Weight of the colours where they are all there is: neighbouring pixels share their errors.
COLOURS_ALONE = 0.5
# While learning, a pixel within the body's reach is background from these log-odds downwards.
SURE_ODDS = 1.0
# Blur of the log-odds, pixels.
SOFTNESS = 0.8
# What blurring reaches beyond what is asked for, pixels.
AROUND_PX = 4
# Samples along a cell, at most: of a body that stands in the camera a cell has a million pixels.
FINEST = 32
# Log-odds from which a pixel has its full weight.
FULL_WEIGHT_ODDS = 2.0
# An image whose brightness varies by less (of 255) shows nothing.
BLANK_RANGE = 12


def is_blank(image: np.ndarray) -> bool:
    """Whether an image (H, W) or (H, W, 3) uint8 is black, or of one brightness all over."""
    return bool(np.ptp(image[::8, ::8]) < BLANK_RANGE)


def shrunk_size(size: tuple[int, int], rows: int) -> tuple[int, int]:
    """Width and height of an image of that width and height, shrunk to ``rows``; never enlarged."""
    width, height = size
    return (width, height) if rows >= height else (max(1, round(width * rows / height)), rows)


def shrink(image: np.ndarray, rows: int) -> np.ndarray:
    """Average an image (H, W, ...) down to ``rows`` rows; one that has fewer is left as it is.

    It is halved as often as possible, which OpenCV does in integers, and the rest is interpolated.
    Edges map onto edges: pixel x of W becomes ``(x + 0.5) w / W - 0.5`` of w, rows likewise
    (``shrunk_pixels``). Width is rounded, so the two ratios differ by up to half a pixel of w.
    """
    height, width = image.shape[:2]
    if rows >= height:
        return image
    size = shrunk_size((width, height), rows)
    while height >= 2 * rows:
        height, width = height // 2, width // 2
        image = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
    return cv2.resize(image, size, interpolation=cv2.INTER_LINEAR)


def log_odds(
    frame: np.ndarray,
    background: Background,
    colours: Colours,
    alone: float = COLOURS_ALONE,
    window: Window = EVERYWHERE,
) -> np.ndarray:
    """How much more likely each pixel of a frame (h, w, 3) uint8 is under the person.

    With what the background there would look like, p, and its certainty, k, with the
    body's colours b and the rest's r, and a share e of strange things, within ``MOST_ODDS``:
    ``-log[ k ((1 - e) p(I) + e r(I)) / b(I) + (1 - k) (r(I) / b(I))^alone ]``.

    Args:
        frame: is brought to the background's exposure; one that does not show it has no odds.
        background: learned.
        colours: learned.
        alone: weight of the colours where no background was learned; with 0 the odds there are 0.
        window: the part of the frame that is asked for, with the body in it. Elsewhere the frame
            must look like the background.

    Returns:
        (h, w) of the window, float32, slightly blurred; 0 where nothing was learned.
    """
    free = np.ones(frame.shape[:2], bool)
    free[window] = False
    gains, agreement = exposure(frame, background, free)
    frame, background = undo_gains(frame[window], gains), background.part(window)
    if agreement == 0:
        return np.zeros(frame.shape[:2], np.float32)
    bins, ratio = colour_bins(frame), colours.rest / colours.body
    unlike, certainty = np.take(ratio, bins), background.certainty
    lit = _like(frame, background) * np.take((1 - STRANGE) / colours.body, bins)
    unlearned = (1 - certainty) * np.take(ratio**alone, bins)
    odds = -cv2.log(certainty * (lit + STRANGE * unlike) + unlearned)
    return cv2.GaussianBlur(agreement * np.clip(odds, -MOST_ODDS, MOST_ODDS), (0, 0), SOFTNESS)


def log_odds_of(
    frame: np.ndarray,
    background: Background,
    colours: Colours,
    body: np.ndarray,
    alone: float = COLOURS_ALONE,
) -> np.ndarray:
    """``log_odds`` (h, w) in the box about a body (h, w) bool, and 0 elsewhere."""
    odds = np.zeros(body.shape, np.float32)
    window = box_about(body, AROUND_PX)
    if window is not None:
        odds[window] = log_odds(frame, background, colours, alone, window)
    return odds


def box_about(mask: np.ndarray, around_px: int = 0) -> Window | None:
    """Rows and columns that hold a mask (h, w) bool, and so many more; None where it is empty."""
    rows, columns = (np.flatnonzero(mask.any(axis)) for axis in (1, 0))
    if not len(rows):
        return None
    tall, wide = (slice(max(i[0] - around_px, 0), i[-1] + 1 + around_px) for i in (rows, columns))
    return tall, wide


def _like(frame: np.ndarray, background: Background) -> np.ndarray:
    """``lit_or_shaded_density`` (h, w) of a frame's colours (h, w, 3) uint8."""
    observed, room = frame.astype(np.float32), background.colour
    products = _dot(observed, observed), _dot(observed, room), _dot(room, room)
    return lit_or_shaded_density(*products, background.noise, cv2.exp)


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Scalar products (h, w) of colours (h, w, 3) float32."""
    return cv2.transform(a * b, np.ones((1, 3)))


def learn_foreground(
    frames: np.ndarray, cores: np.ndarray, bodies: np.ndarray
) -> tuple[Background, Colours]:
    """Background and colours of a recording, each helping the other.

    At first a pixel is background where the body cannot be. Then also where it might be, in frames
    in which it looks like the learned background; what was never visible stays unknown,
    so that someone who hardly moves is not taken for furniture.

    Args:
        frames: (N, h, w, 3) uint8.
        cores: (N, h, w) bool, surely the person, whatever the error of the pose.
        bodies: (N, h, w) bool, wherever the person may be.
    """
    chosen = spread(len(frames))
    frames, cores, bodies = frames[chosen], cores[chosen], bodies[chosen]
    even = equally_exposed(frames, ~bodies)
    alike = most_alike(even, ~bodies)
    frames, cores, bodies, even = frames[alike], cores[alike], bodies[alike], even[alike]
    background, colours = background_of(even, ~bodies), learn_colours(frames, cores, bodies)
    # Elsewhere no body hides anything.
    box = box_about(np.asarray(bodies.any(0)))
    if box is None:
        return background, colours
    odds = np.stack(
        [
            log_odds_of(frame, background, colours, body, alone=0)
            for frame, body in zip(frames, bodies, strict=True)
        ]
    )
    free = ~(cores | (bodies & (odds > -SURE_ODDS)))
    for values, part in zip(background, background_of(even[:, *box], free[:, *box]), strict=True):
        values[box] = part
    return background, learn_colours(frames, cores & (odds >= 0), bodies)


def weigh_odds(odds: np.ndarray) -> Layers:
    """By log-odds (h, w): the person's probability times its weight, and that weight."""
    weight = np.minimum(np.abs(odds) * np.float32(1 / FULL_WEIGHT_ODDS), 1)
    return weight / (1 + cv2.exp(-odds)), weight


def person_grids(
    pair: tuple[Layers, Layers], origin_px: np.ndarray, cell_px: float, size: int, blur: float = 0.5
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Log-odds averaged over the cells of a static grid, two at once.

    OpenCV is fastest with four channels.

    Args:
        pair: two of ``weigh_odds``.
        origin_px: (2,) pixel (x, y) of the grid's left upper corner: the edge, as in ``Region``.
        cell_px: pixels per cell.
        size: cells per side.
        blur: standard deviation of a further Gaussian blur, cells.

    Returns:
        Of each P (size, size) float32, the probability that the person is there, mean by weight;
        and W, the weights' own mean, 0 to 1: 0 where nothing was learned and outside the image. The
        middle of cell i lies at pixel ``origin + (i + 0.5) cell``.
    """
    finer = int(np.clip(np.ceil(cell_px), 1, FINEST))
    step = cell_px / finer
    x, y = np.asarray(origin_px, float) + step / 2
    fine = cv2.warpAffine(
        cv2.merge([*pair[0], *pair[1]]),
        np.array([[step, 0, x], [0, step, y]]),
        (size * finer, size * finer),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
    )
    coarse = cv2.resize(fine, (size, size), interpolation=cv2.INTER_AREA)
    along = step * np.arange(size * finer)
    inside = [
        _inside(first + along, end, size)
        for first, end in zip((y, x), pair[0][0].shape, strict=True)
    ]
    outside = inside[0] * inside[1].T < 0.5
    if blur > 0:
        coarse, *inside = (
            cv2.GaussianBlur(each, (0, 0), blur, borderType=cv2.BORDER_REPLICATE)
            for each in (coarse, *inside)
        )
    shown = np.maximum(inside[0] * inside[1].T, 1e-3)
    person, total, other_person, other_total = cv2.split(coarse)
    return [
        ((there + np.float32(0.5e-3)) / (all_ + np.float32(1e-3)),
         np.where(outside, np.float32(0), all_ / shown))
        for there, all_ in ((person, total), (other_person, other_total))
    ]  # fmt: skip


def _inside(at_px: np.ndarray, end: int, size: int) -> np.ndarray:
    """Which share (size, 1) float32 of each cell lies within ``end`` pixels, as OpenCV fades them.

    ``at_px`` are the rows or columns, the same number to each cell, that are looked at.
    """
    shown = np.clip(np.minimum(at_px + 1, end - at_px), 0, 1)
    return shown.reshape(size, -1).mean(1, keepdims=True).astype(np.float32)
