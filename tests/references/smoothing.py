"""Smoothing as one dense problem: the residuals of all frames in one vector, no bands, no border.

The unknowns x (T N + P,) are the frames' tangent vectors from the poses of a start, and the
logarithms of the proportions that they share; P may be 0.

INPUTS: a model, settings, measurements of T frames (anything with their attributes), a start.
OUTPUTS: residuals and their Jacobian, the minimum, standard deviations; float64.
"""

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from jaxmocap.reference.hybrid.ik import Pose, retract
from jaxmocap.reference.hybrid.mass import centre_of_gravity
from jaxmocap.reference.kinematics import (
    LANDMARK_ENDS,
    forward,
    landmark_positions,
    quaternion_matrix,
    site_positions,
)

# Groups of bones with a length in common, and deviations of its logarithm.
PROPORTIONS = (("spine", 0.08), ("shoulder", 0.08))
# Errors of these last: they count once for as long as ``persistence``, in the deviations.
LASTING = ("pelvis", "posture", "ground", "ankles", "balance")
TAILS = 5.0
STEP = 1e-6


class Problem(NamedTuple):
    """T frames: a model whose feet carry no marker, (T,) seconds, name -> (T, ...), poses (T, ...).

    ``shared`` is P, ``persistence`` how many frames' errors of ``LASTING`` are one.
    """

    model: Any
    settings: Any
    times: np.ndarray
    measured: dict
    start: Any
    shared: int = 0
    persistence: float = 1.0

    def split(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The frames' (T, N) and the shared (P,) of the unknowns."""
        own = len(x) - self.shared
        return x[:own].reshape(len(self.times), -1), x[own:]

    def pose(self, x: np.ndarray, t: int) -> Pose:
        """Of a frame."""
        return retract(Pose(*(np.asarray(part)[t] for part in self.start)), self.split(x)[0][t])


def frame_values(problem: Problem, x: np.ndarray, t: int) -> np.ndarray:
    """The whitened residuals of a frame's terms, and then its landmarks, metres: (R + 3 L,)."""
    model, settings, pose = problem.model, problem.settings, problem.pose(x, t)
    measured = {name: np.asarray(part, float)[t] for name, part in problem.measured.items()
                if name != "sight_lines"}  # fmt: skip
    skeleton, logarithms = model.skeleton, problem.split(x)[1]
    lengths = np.array(skeleton.lengths, float)
    for (group, _), logarithm in zip(PROPORTIONS, logarithms, strict=False):
        lengths[skeleton.tree.bones_in(group)] *= np.exp(logarithm)
    skeleton = replace(skeleton, lengths=lengths)
    frames, R = forward(skeleton, pose), quaternion_matrix(pose.quaternion)
    points = landmark_positions(skeleton, frames)
    at = dict(zip(LANDMARK_ENDS, points, strict=True))
    ankles = np.array([at["ankle_l"], at["ankle_r"]])
    elbows = np.array([at["elbow_l"], at["elbow_r"]])
    base = np.mean([*ankles, at["toe_l"], at["toe_r"]], axis=0)
    low, high = np.asarray(skeleton.limits, float).T
    # What is off, and its deviation; where no marker holds the feet, the pelvis is upright over
    # straight legs, and faces thrice less surely.
    turn = np.cross(R[:, 0], measured["facing"])[2]
    lasting = np.sqrt(problem.persistence)
    lean, facing = float(settings.pelvis.lean), 3 * float(settings.pelvis.facing)
    place, height = settings.ground.place, settings.ground.height
    bears = np.isin(skeleton.tree.groups_of_joints, ("spine", "head", "hip", "leg"))
    ease = np.where(bears, float(settings.posture.bearing), float(settings.posture.ease))
    usual = ease * np.asarray(skeleton.usual_deviations, float)
    at_ease, joint = np.array(skeleton.relaxed, float), skeleton.tree.joint
    knees = [
        pose.angles[joint(f"knee_flexion_{s}")] - at_ease[joint(f"knee_flexion_{s}")] for s in "lr"
    ]
    both = (knees[0] + knees[1] - np.hypot(np.subtract(*knees), 0.3) + 0.3) / 2
    at_ease[[joint(f"hip_flexion_{s}") for s in "lr"]] += settings.posture.hips * both
    at_markers = site_positions(skeleton, frames, model.markers)
    terms = {
        "markers": (at_markers - measured["markers"], settings.markers.deviation),
        "pelvis": ([*lasting * off_upright(lasting * lean, R, at), turn], [1, 1, 1, facing]),
        "posture": (pose.angles - at_ease, usual),
        "limits": (pose.angles - np.clip(pose.angles, low, high), settings.limits.deviation),
        "ground": (ankles - measured["ankles"], [place, place, height]),
        "ankles": (beyond_ankles(R, at, measured["ankles"]), settings.ankles.beyond),
        "balance": (centre_of_gravity(skeleton, frames)[:2] - base[:2], settings.balance.deviation),
        "elbows": (elbows - measured["elbows"], settings.elbows.deviation),
        "keypoints": (off_lines(problem, points, t), 1.0),
    }
    residuals = []
    for name, (off, deviation) in terms.items():
        often = lasting if name in LASTING else 1.0
        residuals += list(np.ravel(off / (often * np.asarray(deviation, float))))
    # What is missing counts nothing.
    return np.concatenate([np.nan_to_num(residuals), points.ravel()])


def off_upright(lean: float, R: np.ndarray, at: dict[str, np.ndarray]) -> np.ndarray:
    """(3,) of the trunk above a pelvis R (3, 3), in its deviations: back, too far ahead, aside.

    Whoever bends the legs may bow. Student's t's tails ahead and aside.
    """
    bent = []
    for side in "lr":
        hip, knee, ankle = (at[f"{joint}_{side}"] for joint in ("hip", "knee", "ankle"))
        stretched = np.linalg.norm(hip - knee) + np.linalg.norm(knee - ankle)
        bent.append(1 - np.linalg.norm(hip - ankle) / stretched)
    trunk = (at["neck"] - at["pelvis"]) / np.linalg.norm(at["neck"] - at["pelvis"])
    ahead = R[:2, 0] / np.linalg.norm(R[:2, 0])
    bow, aside = trunk[:2] @ ahead, trunk[:2] @ [-ahead[1], ahead[0]]
    too_far, back = ((x + np.hypot(x, 0.02)) / 2 for x in (bow - 1.8 * np.mean(bent), -bow))
    others = np.array([too_far, aside]) / lean
    others = np.sign(others) * np.sqrt(TAILS * np.log1p(others**2 / TAILS))
    return np.array([-back / lean, *others])


def beyond_ankles(R: np.ndarray, at: dict[str, np.ndarray], standing: np.ndarray) -> np.ndarray:
    """(2, 2) sines of shanks beyond 40 degrees ahead and 25 back of a pelvis R (3, 3).

    Less where an ankle is off its height (2, 3) on the ground.
    """
    ahead, result = R[:2, 0] / np.linalg.norm(R[:2, 0]), []
    for side, foot in zip("lr", standing, strict=True):
        shank = at[f"knee_{side}"] - at[f"ankle_{side}"]
        lean = shank[:2] @ ahead / np.linalg.norm(shank)
        flat = 1 / (1 + ((at[f"ankle_{side}"] - foot)[2] / 0.04) ** 2)
        result.append([flat * (x + np.hypot(x, 0.02)) / 2 for x in (lean - 0.64, -0.42 - lean)])
    return np.array(result)


def off_lines(problem: Problem, points: np.ndarray, t: int) -> np.ndarray:
    """Of landmarks (L, 3) from the lines of sight of a frame's key points, Student's t's tails."""
    lines, off = problem.measured["sight_lines"], []
    deviation = float(problem.settings.keypoints.deviation)
    for origin, ways, sure, _ in zip(*(np.asarray(part, float)[t] for part in lines), strict=True):
        across = np.cross(ways, points - origin) * sure[:, None] / deviation
        ratio = np.sum(across**2, 1, keepdims=True) / TAILS
        off.append(across * np.sqrt(np.log1p(ratio) / np.where(ratio > 0, ratio, 1)))
    return np.array(off)


def stack_residuals(problem: Problem, values: np.ndarray, logarithms: np.ndarray) -> np.ndarray:
    """All residuals, of (T, R + 3 L) ``frame_values`` and (P,) shared: linear in both."""
    count, times = 3 * len(LANDMARK_ENDS), problem.times
    rows = [values[:, :-count].ravel()]
    for t in range(1, len(times) - 1):
        before, now, after = values[t - 1 : t + 2, -count:]
        h1, h2 = times[t] - times[t - 1], times[t + 1] - times[t]
        acceleration = ((after - now) / h2 - (now - before) / h1) / ((h1 + h2) / 2)
        rows.append(acceleration * np.sqrt((h1 + h2) / 2) / float(problem.settings.acceleration))
    deviations = np.array([deviation for _, deviation in PROPORTIONS])[: problem.shared]
    rows.append(logarithms / deviations * np.sqrt(float(problem.settings.proportions)))
    return np.concatenate(rows)


def residuals(problem: Problem, x: np.ndarray) -> np.ndarray:
    """All whitened residuals (R,) of all frames."""
    values = [frame_values(problem, x, t) for t in range(len(problem.times))]
    return stack_residuals(problem, np.array(values), problem.split(x)[1])


def jacobian(problem: Problem, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Central differences of the residuals (R, U) and of the landmarks (T, 3 L, U), U = T N + P."""
    T, count = len(problem.times), 3 * len(LANDMARK_ENDS)
    size, steps = problem.split(x)[0].shape[1], STEP * np.eye(len(x))
    values = np.zeros((T, len(frame_values(problem, x, 0)), len(x)))
    for t in range(T):
        # Of what other frames have, this one does not depend.
        for k in [*range(t * size, (t + 1) * size), *range(T * size, len(x))]:
            ahead, behind = (frame_values(problem, x + sign * steps[k], t) for sign in (1, -1))
            values[t, :, k] = (ahead - behind) / (2 * STEP)
    by_shared = np.eye(len(x))[T * size :]
    columns = [stack_residuals(problem, values[:, :, k], by_shared[:, k]) for k in range(len(x))]
    return np.stack(columns, 1), values[:, -count:]


def step(problem: Problem, x: np.ndarray) -> np.ndarray:
    """Gauss and Newton's step (U,) from the dense normal equations."""
    J, _ = jacobian(problem, x)
    return -np.linalg.solve(J.T @ J, J.T @ residuals(problem, x))


def minimum(problem: Problem, iterations: int) -> np.ndarray:
    """The unknowns (U,) after so many steps from the start.

    Steps alone overshoot by half and settle slowly. So from the third on, each is corrected by how
    points and steps have changed before: Anderson's acceleration (Walker and Ni 2011, eq. 2.1).
    """
    x = np.zeros(len(problem.times) * (6 + problem.start.angles.shape[1]) + problem.shared)
    points, steps = [], []
    for i in range(iterations):
        points.append(x)
        steps.append(step(problem, x))
        x = x + steps[-1]
        if i > 1:
            moved, changed = np.diff(points, axis=0), np.diff(steps, axis=0)
            shares = np.linalg.lstsq(changed.T, steps[-1])[0]
            x = x - shares @ (moved + changed)
    return x


def deviations(problem: Problem, x: np.ndarray) -> np.ndarray:
    """Standard deviations (T, L, 3) of the landmarks by the dense inverse, metres."""
    J, points = jacobian(problem, x)
    covariance = np.linalg.inv(J.T @ J)
    variances = np.einsum("tiu,uv,tiv->ti", points, covariance, points, optimize=True)
    return np.sqrt(variances).reshape(len(points), -1, 3)
