"""Selectively damped least squares: equations (3) and (5) to (9), term by term.

INPUTS: a weighted Jacobian and the displacements wanted of k end effectors.
OUTPUTS: a step in weighted coordinates psi, and the projector of the secondary task.
"""

import numpy as np


def clamp_targets(displacements: np.ndarray, limit: float) -> np.ndarray:
    """Section 4.1: displacements (k, 3), metres, each shortened to ``limit`` where it is longer."""
    clamped = []
    for displacement in displacements:
        length = np.linalg.norm(displacement)
        clamped.append(displacement * limit / length if length > limit else displacement)
    return np.array(clamped)


def clamp_max_abs(vector: np.ndarray, limit: float) -> np.ndarray:
    """ClampMaxAbs of (7): scale so that no component exceeds ``limit``; smaller ones stay."""
    largest = np.max(np.abs(vector))
    return vector * limit / largest if largest > limit else vector


def step(
    J: np.ndarray, ds: np.ndarray, gamma_max: float, rank_tolerance: float = 1e-6
) -> tuple[np.ndarray, np.ndarray]:
    """One step of equations (5) to (8), and the projector of equation (1).

    Args:
        J: (3 k, n) weighted Jacobian; rows of absent end effectors are 0.
        ds: (3 k,) displacement wanted, metres, already clamped; 0 where absent.
        gamma_max: Gamma, the largest component allowed of any term and of their sum.
        rank_tolerance: singular values below this fraction of the largest count as zero.

    Returns:
        The step (n,) and I - J^dagger J (n, n).
    """
    U, sigmas, Vt = np.linalg.svd(J)
    k, n = len(ds) // 3, J.shape[1]
    dpsi, pseudo_inverse = np.zeros(n), np.zeros((n, len(ds)))
    for i, sigma in enumerate(sigmas):
        if sigma <= rank_tolerance * sigmas[0]:
            continue
        u, v = U[:, i], Vt[i]
        pseudo_inverse += np.outer(v, u) / sigma
        N = sum(float(np.linalg.norm(u[3 * m : 3 * m + 3])) for m in range(k))
        M = 0.0
        for m in range(k):
            for j in range(n):
                M += (
                    abs(float(v[j])) * float(np.linalg.norm(J[3 * m : 3 * m + 3, j])) / float(sigma)
                )
        gamma = gamma_max * min(1.0, N / M)
        dpsi += clamp_max_abs(np.dot(ds, u) / sigma * v, gamma)
    return clamp_max_abs(dpsi, gamma_max), np.eye(n) - pseudo_inverse @ J


def secondary_task(
    masses: np.ndarray, arms: np.ndarray, theta: np.ndarray, omega: np.ndarray, gain: float = 0.5
) -> np.ndarray:
    """Equation (9), -2 m_i h_i (theta_i - omega_i), normalised by the sum of m h.

    Args:
        masses: (D,) m_i of the augmented bodies, kilograms.
        arms: (D,) h_i, metres.
        theta: (D,) angles, radians.
        omega: (D,) angles of the relaxed pose, radians.
        gain: below 1, so that no angle overshoots without bound.
    """
    total = sum(m * h for m, h in zip(masses, arms, strict=True))
    if total == 0:
        return np.zeros(len(theta))
    rows = zip(masses, arms, theta, omega, strict=True)
    return np.array([-2 * gain * m * h / total * (t - w) for m, h, t, w in rows])
