"""The level set's step, cell by cell: (4.19) and (4.20) as they are written.

INPUTS: Φ (S, S), densities' log-ratio. OUTPUTS: Φ after one step; the energy.
"""

import numpy as np
from scipy.special import erf

BAND, FLAT = 8.0, 1e-2


def heaviside(phi: np.ndarray, width: float) -> np.ndarray:
    """H(Φ) by the error function."""
    return 0.5 * (1 + erf(phi / width))


def energy(phi: np.ndarray, log_ratio: np.ndarray, length: float, width: float) -> float:
    """(4.19) but for a constant, log-likelihoods counted negatively, gradients by differences."""
    h = heaviside(phi, width)
    rows, columns = np.gradient(h)
    return float(np.sum(-h * log_ratio + length * np.hypot(rows, columns)))


def step(
    phi: np.ndarray,
    log_ratio: np.ndarray,
    length: float,
    speed: float,
    distance: float,
    smoothing: float,
    width: float,
) -> np.ndarray:
    """One step of (4.20), drawn towards a distance; beyond the border Φ is replicated."""
    size = len(phi)
    moved = np.empty_like(phi)

    def at(row: int, column: int) -> float:
        return float(phi[min(max(row, 0), size - 1), min(max(column, 0), size - 1)])

    for i in range(size):
        for j in range(size):
            x, y = (at(i, j + 1) - at(i, j - 1)) / 2, (at(i + 1, j) - at(i - 1, j)) / 2
            xx = at(i, j + 1) + at(i, j - 1) - 2 * at(i, j)
            yy = at(i + 1, j) + at(i - 1, j) - 2 * at(i, j)
            xy = at(i - 1, j - 1) + at(i + 1, j + 1) - at(i - 1, j + 1) - at(i + 1, j - 1)
            bend = xx * y**2 - 2 * x * y * xy / 4 + yy * x**2
            slope = np.sqrt(x**2 + y**2 + FLAT)
            near = np.exp(-((phi[i, j] / width) ** 2))
            force = speed * near * (log_ratio[i, j] + length * bend / slope**3)
            sign = phi[i, j] / np.sqrt(phi[i, j] ** 2 + 1)
            # What the Laplacian has along the gradient.
            along = xx + yy - bend / slope**2
            kept = distance * sign * (1 - slope) + smoothing * along
            moved[i, j] = np.clip(phi[i, j] + force + kept, -BAND, BAND)
    return moved
