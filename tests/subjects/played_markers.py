"""Head and wrists of a table-tennis player, as a headset and controllers measure them.

INPUTS: a seed, seconds, a rate. OUTPUTS: times and markers.
"""

import numpy as np

from jaxmocap.synthetic.movements import motions
from jaxmocap.synthetic.recording import marker_noise

NAMES = ("vertex", "wrist_l", "wrist_r")


def played(
    seed: int, seconds: float = 6.0, rate: float = 90.0, noise: bool = True
) -> tuple[np.ndarray, np.ndarray]:
    """Times (T,) and positions (T, 3, 3), metres, with a headset's noise or without any."""
    times = np.arange(seconds * rate) / rate
    landmarks = motions.table_tennis(seconds, seed).landmarks(times)
    points = np.stack([landmarks[name] for name in NAMES], 1)
    return times, points + noise * marker_noise(times, 3, np.random.default_rng(seed))
