"""A planar arm on a sliding base, measured over time: a trajectory and its dense solution."""

from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from jaxmocap.evidence.smoothness import Smoothness, smoothness
from jaxmocap.smoothing.levenberg_marquardt import Linearised

FRAMES, LINKS = 9, 2
LENGTHS = np.array([0.5, 0.4])
ACCELERATIONS = np.array([2.0, 2.0, 3.0, 4.0, 5.0, 6.0])
VELOCITIES = np.array([2.0, np.inf, 2.0, np.inf, 3.0, 3.0])


class Arm(NamedTuple):
    """A planar arm on a sliding base: its rotations live on SO(2), its lengths may be shared."""

    base: np.ndarray  # (T, 2)
    turns: np.ndarray  # (T, LINKS) complex, of length 1
    lengths: np.ndarray  # (LINKS,)


class Measured(NamedTuple):
    """Ranges of an arm's joints from the origin, and its last joint's height."""

    ranges: np.ndarray  # (T, LINKS)
    heights: np.ndarray  # (T,)
    weights: np.ndarray  # (T,), 0 where nothing was measured
    shared: int  # how many lengths are free


def move(arm: Arm, steps: np.ndarray, shared: np.ndarray) -> Arm:
    lengths = arm.lengths.copy()
    lengths[: len(shared)] += shared
    return Arm(arm.base + steps[:, :2], arm.turns * np.exp(1j * steps[:, 2:]), lengths)


def joints(arm: Arm) -> np.ndarray:
    """(T, M) positions of the base and of the links' ends."""
    links = np.cumprod(arm.turns, 1) * arm.lengths
    along = np.cumsum(np.concatenate([arm.base @ [[1], [1j]], links], 1), 1)
    return np.stack([along.real, along.imag], 2).reshape(len(along), -1)


def residuals(arm: Arm, measured: Measured) -> np.ndarray:
    """(T, R) of the frames by themselves."""
    xy = joints(arm).reshape(-1, LINKS + 1, 2)[:, 1:]
    range_error = (np.hypot(xy[..., 0], xy[..., 1]) - measured.ranges) * 50
    height_error = (xy[:, -1, 1] - measured.heights) * 50
    lean = arm.base / 0.3
    bend = np.angle(arm.turns) / 1.5
    return (
        np.concatenate([range_error, height_error[:, None], lean, bend], 1)
        * measured.weights[:, None]
    )


def derivatives(function, arm: Arm, shared: int) -> tuple[np.ndarray, np.ndarray]:
    """Central differences (T, R, N) and (T, R, P): each frame's values know that frame only."""

    def column(steps, lengths):
        ahead, behind = move(arm, steps, lengths), move(arm, -steps, -lengths)
        return (function(ahead) - function(behind)) / 2e-6

    still, rigid = np.zeros((len(arm.base), 2 + LINKS)), np.zeros(shared)
    own = [column(still + 1e-6 * axis, rigid) for axis in np.eye(2 + LINKS)]
    common = [column(still, 1e-6 * axis) for axis in np.eye(shared)]
    values = function(arm)
    return np.stack(own, 2), np.reshape(common, (shared, *values.shape)).transpose(1, 2, 0)


def linearise(arm: Arm, measured: Measured) -> Linearised:
    r = residuals(arm, measured)
    J, K = derivatives(lambda x: residuals(x, measured), arm, measured.shared)
    Q, S = derivatives(joints, arm, measured.shared)
    # The lengths' prior, a share in each frame.
    error = (arm.lengths - LENGTHS)[: measured.shared] / 0.05 / np.sqrt(FRAMES)
    return Linearised(
        np.sum(r**2, 1) + error @ error,
        np.einsum("tri,trj->tij", J, J),
        np.einsum("tri,tr->ti", J, r),
        joints(arm),
        Q,
        np.einsum("tri,trp->tip", J, K),
        np.einsum("trp,trq->tpq", K, K) + np.eye(measured.shared) / 0.05**2 / FRAMES,
        np.einsum("trp,tr->tp", K, r) + error / 0.05 / np.sqrt(FRAMES),
        S,
    )


def evaluate(arm: Arm, measured: Measured) -> tuple[np.ndarray, np.ndarray]:
    linear = linearise(arm, measured)
    return np.asarray(linear.cost), np.asarray(linear.points)


def problem(
    seed: int, shared: int, absent: tuple[int, ...] = ()
) -> tuple[Arm, Measured, tuple[np.ndarray, Smoothness]]:
    """A start away from an arm that was measured with noise at uneven times, and the prior."""
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.uniform(0.02, 0.2, FRAMES))
    phase = times[:, None] * [3.0, 2.0] + rng.uniform(0, 1, LINKS)
    truth = Arm(0.2 * np.cos(phase), np.exp(1j * (0.8 + 0.5 * np.sin(phase))), LENGTHS * 1.1)
    weights = np.ones(FRAMES)
    weights[list(absent)] = 0
    measured = Measured(np.zeros((FRAMES, LINKS)), np.zeros(FRAMES), weights, shared)
    xy = joints(truth).reshape(FRAMES, LINKS + 1, 2)[:, 1:]
    measured = measured._replace(
        ranges=np.linalg.norm(xy, axis=2) + 0.005 * rng.normal(size=(FRAMES, LINKS)),
        heights=xy[:, -1, 1] + 0.005 * rng.normal(size=FRAMES),
    )
    start = move(truth, 0.05 * rng.normal(size=(FRAMES, 2 + LINKS)), np.zeros(0))
    prior = smoothness(times, ACCELERATIONS, VELOCITIES)
    return start._replace(lengths=LENGTHS), measured, (times, prior)


def motion_matrix(times: np.ndarray) -> np.ndarray:
    """The prior's residuals as a dense matrix on (T * M,) points, written out term by term."""
    rows = []
    for m in range(len(ACCELERATIONS)):
        for t in range(FRAMES - 1):
            h = times[t + 1] - times[t]
            row = np.zeros((FRAMES, len(ACCELERATIONS)))
            row[[t, t + 1], m] = np.array([-1, 1]) / h * np.sqrt(h) / VELOCITIES[m]
            rows.append(row.ravel())
        for t in range(1, FRAMES - 1):
            h1, h2 = times[t] - times[t - 1], times[t + 1] - times[t]
            row = np.zeros((FRAMES, len(ACCELERATIONS)))
            ends = np.array([1 / h1, -1 / h1 - 1 / h2, 1 / h2])
            row[t - 1 : t + 2, m] = 2 * ends / (h1 + h2) * np.sqrt((h1 + h2) / 2) / ACCELERATIONS[m]
            rows.append(row.ravel())
    return np.array(rows)


def dense_residuals(arm: Arm, measured: Measured, motion: np.ndarray) -> np.ndarray:
    lengths = (arm.lengths - LENGTHS)[: measured.shared] / 0.05
    own = residuals(arm, measured).ravel()
    return np.concatenate([own, motion @ joints(arm).ravel(), lengths])


def dense_solution(start: Arm, measured: Measured, motion: np.ndarray) -> tuple[Arm, float]:
    """By SciPy, over all free unknowns at once in the chart about the start."""

    def at(z: np.ndarray) -> Arm:
        steps = z[: FRAMES * (2 + LINKS)].reshape(FRAMES, 2 + LINKS)
        return move(start, steps, z[FRAMES * (2 + LINKS) :])

    unknowns = FRAMES * (2 + LINKS) + measured.shared
    tight = {"xtol": 1e-15, "ftol": 1e-15, "gtol": 1e-12}
    actual = least_squares(
        lambda z: dense_residuals(at(z), measured, motion), np.zeros(unknowns), "3-point", **tight
    )
    return at(actual.x), 2 * actual.cost


def dense_hessian(linear: Linearised, motion: np.ndarray) -> np.ndarray:
    """(T * N + P) squared, from the frames' blocks and the motion matrix."""
    T, M, N = np.shape(linear.jacobian)
    P = np.shape(linear.shared_gradient)[-1]
    leverage = np.zeros((T, M, T * N + P))
    H = np.zeros((T * N + P, T * N + P))
    H[T * N :, T * N :] = np.sum(linear.shared_hessian, 0)
    for t in range(T):
        here = slice(t * N, (t + 1) * N)
        leverage[t, :, here] = np.asarray(linear.jacobian)[t]
        H[here, here] = np.asarray(linear.hessian)[t]
        H[here, T * N :] = np.broadcast_to(linear.cross, (T, N, P))[t]
        H[T * N :, here] = H[here, T * N :].T
    leverage[:, :, T * N :] = linear.shared_jacobian
    pulled = motion @ leverage.reshape(T * M, -1)
    return H + pulled.T @ pulled
