"""A person before a backdrop of one colour: which pixels show the person (second paper, 2.1).

The backdrop's colour over the image is a smooth surface through samples at the image's sides and
top. A pixel differs from it in brightness and in chromaticity, after Horprasert: by the factor that
brings the backdrop's colour nearest to the pixel's, and by what is left then. Both thresholds come
from the samples: what they scatter, the backdrop does. A shadow is darker, but of the same
chromaticity, and stays with the backdrop.

INPUTS: a photograph (H, W, 3), BGR uint8.
OUTPUTS: the person's mask; a PhotographError, with a picture that shows why, where there is none.
"""

import cv2
import numpy as np

# Samples lie within this share of width and height at the left, right and upper side.
BORDER_SHARE = 0.06
# One pixel in so many columns and rows.
SAMPLE_STRIDE = 2
# Which term of the surface is x y.
XY_TERM = 4
# Noise is measured on images blurred by so many pixels.
BLUR_PX = 0.8
# Share of the samples, at least, that must lie near the smooth surface,
LEAST_EVEN = 0.93
# within so many deviations,
FAR_DEVIATIONS = 3.5
# which are taken for at least and at most so much of the colour.
LEAST_UNEVEN = 0.01
MOST_UNEVEN = 0.03
# A threshold is so many times what the samples reach,
THRESHOLD_MARGIN = 1.3
# but at least so much of the colour: in chromaticity,
LEAST_CHROMA = 0.045
# and in brightness.
LEAST_DARKER = 0.12
# A shadow darkens the backdrop by this share at most.
LARGEST_SHADOW = 0.42
# Share of the image that the person covers, at least and at most.
LEAST_AREA = 0.02
MOST_AREA = 0.7
# From its rim so many pixels inwards the person surely covers a pixel.
RIM_PX = 3
# Holes smaller than this share of the person are noise.
LARGEST_HOLE = 0.002


class PhotographError(ValueError):
    """A photograph that shows no person before an even backdrop.

    Attributes:
        problem: one sentence.
        picture: (H, W, 3) BGR uint8 that shows why.
    """

    def __init__(self, problem: str, picture: np.ndarray):
        super().__init__(problem, picture)
        self.problem, self.picture = problem, picture

    def __str__(self) -> str:
        return self.problem


def person_mask(photograph: np.ndarray) -> np.ndarray:
    """(H, W) bool, the pixels that show the person.

    Raises:
        PhotographError: the backdrop is not uniform, nobody is there, or the person is cut off
            anywhere but below.
    """
    image = cv2.GaussianBlur(photograph, (0, 0), BLUR_PX).astype(np.float32)
    samples = border(image.shape[:2])
    surface = smooth_surface(image, samples)
    square = np.sum(surface * surface, -1)
    brightness = np.sum(image * surface, -1) / square
    left = np.linalg.norm(image - brightness[..., None] * surface, axis=-1) / np.sqrt(square)
    dark, bright, chroma = thresholds(brightness, left, samples, photograph)
    mask = largest_piece((left > chroma) | (brightness > bright) | (brightness < dark))
    _check(mask, photograph)
    return largest_piece(half_covered(mask, image, surface))


def border(shape: tuple[int, int]) -> np.ndarray:
    """(H, W) bool, pixels at the left, right and upper side."""
    rows, columns = (max(2, int(BORDER_SHARE * n)) for n in shape)
    samples = np.ones(shape, bool)
    samples[rows:, columns:-columns] = False
    return samples


def smooth_surface(image: np.ndarray, samples: np.ndarray) -> np.ndarray:
    """(H, W, 3) float32, quadratic in x and y, through most of the samples' colours."""
    height, width = samples.shape
    rows, columns = np.nonzero(samples[::SAMPLE_STRIDE, ::SAMPLE_STRIDE])
    basis = _quadratic(columns * SAMPLE_STRIDE / width, rows * SAMPLE_STRIDE / height)
    colours = image[::SAMPLE_STRIDE, ::SAMPLE_STRIDE][rows, columns]
    weights, fit = np.ones(len(colours)), np.zeros((basis.shape[1], 3))
    for _ in range(8):
        weighted = basis * weights[:, None]
        fit = np.linalg.solve(basis.T @ weighted, weighted.T @ colours)
        off = np.linalg.norm(colours - basis @ fit, axis=1)
        # Those far off count ever less: a hand may reach into the border.
        weights = 1 / (1 + (off / (2 * np.median(off) + 0.5)) ** 4)
    x, y = np.arange(width, dtype=np.float32) / width, np.arange(height, dtype=np.float32) / height
    # Terms of x alone, of y alone, and x y: one row and one column make the whole image.
    across, down = _quadratic(x, np.full_like(x, 0.5)), _quadratic(np.full_like(y, 0.5), y)
    fit = fit.astype(np.float32)
    surface = (across @ fit)[None] + (down @ fit)[:, None] - fit[0]
    surface += ((2 * y - 1)[:, None] * (2 * x - 1))[..., None] * fit[XY_TERM]
    return np.maximum(surface, 4.0)


def _quadratic(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """(N, 6) terms of a quadratic surface; x and y are 0 to 1, and 0.5 leaves out theirs."""
    x, y = 2 * x - 1, 2 * y - 1
    return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], -1)


def thresholds(
    brightness: np.ndarray, left: np.ndarray, samples: np.ndarray, photograph: np.ndarray
) -> tuple[float, float, float]:
    """Darkest and brightest factor, and largest chromaticity, of the backdrop's samples (H, W).

    ``brightness`` (H, W) is the factor by which the image is brighter, ``left`` (H, W) what is left
    then, as a share of the backdrop's colour. The photograph is for the error's picture.

    Raises:
        PhotographError: the samples differ too much among themselves.
    """
    off = np.abs(brightness - 1)
    # Either is about one deviation of what most samples do.
    spread = [1.48 * float(np.median(v[samples])) for v in (off, left)]
    near_off, near_left = np.clip(spread, LEAST_UNEVEN, MOST_UNEVEN)
    odd = (off > FAR_DEVIATIONS * near_off) | (left > FAR_DEVIATIONS * near_left)
    like = 1 - np.mean(odd[samples])
    if like < LEAST_EVEN:
        raise PhotographError(
            f"the background is not uniform: {100 * like:.0f} % of its samples at the image's "
            f"sides and top follow one smooth colour, expected at least {100 * LEAST_EVEN:.0f} %",
            _mark_pixels(photograph, samples & odd, samples),
        )
    usual = samples & ~odd
    far_off, far_left = (float(np.quantile(v[usual], 0.999)) for v in (off, left))
    bright = 1 + max(THRESHOLD_MARGIN * far_off, LEAST_DARKER)
    return (
        1 - max(THRESHOLD_MARGIN * far_off, LARGEST_SHADOW),
        bright,
        max(THRESHOLD_MARGIN * far_left, LEAST_CHROMA),
    )


def largest_piece(foreground: np.ndarray) -> np.ndarray:
    """(H, W) bool: the largest piece, smoothed, without small holes."""
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (3, 3))
    mask = cv2.morphologyEx(foreground.astype(np.uint8), cv2.MORPH_OPEN, disc)
    mask = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, disc)
    count, pieces, stats, _ = cv2.connectedComponentsWithStats(mask)
    if count < 2:
        return np.zeros(foreground.shape, bool)
    person = pieces == 1 + np.argmax(stats[1:, cv2.CC_STAT_AREA])
    _, holes, stats, _ = cv2.connectedComponentsWithStats((~person).astype(np.uint8))
    small = stats[:, cv2.CC_STAT_AREA] < LARGEST_HOLE * person.sum()
    # Label 0 is the person itself.
    small[0] = False
    return person | small[holes]


def half_covered(mask: np.ndarray, image: np.ndarray, surface: np.ndarray) -> np.ndarray:
    """The mask (H, W), at its rim only where a pixel is half-way to the person's colour nearby.

    A pixel that the person covers by a tenth differs from the backdrop already.
    """
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * RIM_PX + 1, 2 * RIM_PX + 1))
    solid = cv2.erode(mask.astype(np.uint8), disc)
    # What the person looks like nearby: the mean over what is surely theirs.
    weight = cv2.GaussianBlur(solid.astype(np.float32), (0, 0), RIM_PX)[..., None]
    inside = cv2.GaussianBlur(image * solid[..., None], (0, 0), RIM_PX) / np.maximum(weight, 1e-3)
    share = np.linalg.norm(image - surface, axis=-1)
    share /= np.maximum(np.linalg.norm(inside - surface, axis=-1), 1.0)
    # Limbs as thin as a finger have nothing solid to compare with.
    is_measured = weight[..., 0] > 1e-2
    return mask & ((share >= 0.5) | ~is_measured)


def _check(mask: np.ndarray, photograph: np.ndarray) -> None:
    """PhotographError where the mask cannot be a whole person."""
    area, none = mask.mean(), np.zeros_like(mask)
    if area < LEAST_AREA:
        raise PhotographError(
            f"found nobody: {100 * area:.1f} % of the image differ from its background, expected "
            f"at least {100 * LEAST_AREA:.0f} %",
            _mark_pixels(photograph, mask, none),
        )
    if area > MOST_AREA:
        raise PhotographError(
            f"{100 * area:.0f} % of the image differ from its background, expected at most "
            f"{100 * MOST_AREA:.0f} %: the person is too near or the background not uniform",
            _mark_pixels(photograph, mask, none),
        )
    sides = {"left": mask[:, 0], "right": mask[:, -1], "upper": mask[0]}
    cut = [name for name, line in sides.items() if line.any()]
    if cut:
        raise PhotographError(
            f"the person is cut off at the {' and the '.join(cut)} side of the image, expected "
            "head, arms and hands within it",
            _mark_pixels(photograph, mask, none),
        )


def _mark_pixels(photograph: np.ndarray, red: np.ndarray, blue: np.ndarray) -> np.ndarray:
    """The photograph, paler, with pixels (H, W) bool in red, and others in blue."""
    picture = (photograph // 2 + 90).astype(np.uint8)
    picture[blue] = (picture[blue] // 2 + np.array([110, 40, 0])).astype(np.uint8)
    picture[red] = (40, 40, 230)
    return picture
