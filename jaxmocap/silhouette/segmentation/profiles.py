"""Profiles of colour across lines, and where one plain colour gives way to another.

INPUTS: an image, places in it with their normals. OUTPUTS: colours across them; where they change.
"""

import cv2
import numpy as np

# Colours are averaged over so many places along the line, this far apart, pixels.
ALONG = np.array([-2.0, -1.0, 0.0, 1.0, 2.0])
# Samples next to the line, on either side, that mix the sides' colours.
BETWEEN = 3


def colour_profiles(
    image: np.ndarray, pixels_xy: np.ndarray, normals: np.ndarray, offsets: np.ndarray
) -> np.ndarray:
    """(R, K, 3) colours across lines.

    Args:
        image: (H, W, 3) uint8.
        pixels_xy: (R, 2) on the lines.
        normals: (R, 2) unit vectors across them.
        offsets: (K,) along the normals, pixels.
    """
    across = pixels_xy[:, None] + offsets[:, None] * normals[:, None]
    beside = np.stack([-normals[:, 1], normals[:, 0]], 1)
    places = across[:, :, None] + ALONG[:, None] * beside[:, None, None]
    flat = places.reshape(len(pixels_xy), -1, 2).astype(np.float32)
    taken = cv2.remap(
        image, flat[..., 0], flat[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    several = taken.astype(np.float32).reshape(*places.shape[:3], 3)
    # Faster than their mean, over so few.
    return np.add.reduce([several[:, :, i] for i in range(len(ALONG))]) / np.float32(len(ALONG))


def colour_boundary(profiles: np.ndarray) -> tuple[np.ndarray, float]:
    """Where profiles (R, K, 3) of one line go over from the colour before to the one behind.

    Returns:
        (R,) places between samples, NaN where a profile stays on one side; how far apart the two
        colours are, by the deviations about them.
    """
    half = profiles.shape[1] // 2
    before, behind = slice(half - BETWEEN + 1), slice(half + BETWEEN, None)
    first, second = (profiles[:, side].mean((0, 1)) for side in (before, behind))
    way = first - second
    apart = max(float(way @ way), 1e-6)
    along = profiles @ way
    spread = (along[:, before].var() + along[:, behind].var()) / apart
    # 1 before the line and 0 behind it.
    share = (along - second @ way) / apart
    gain = np.cumsum(np.clip(share, -0.5, 1.5) - 0.5, 1)
    best = gain.argmax(1)
    lasting = (gain.max(1) > 0.5) & (best < profiles.shape[1] - 1)
    after = gain[:, -1] < gain.max(1) - 0.5
    place = np.where(lasting & after, best + 0.5, np.nan)
    return place, float(np.sqrt(apart / max(spread, 1e-6)))
