"""The default's search for an elbow: all candidates before the edges, a Bayes filter over time.

INPUTS: a skeleton, poses of the markers alone, one camera's fields of edges, settings (anything
with their attributes). OUTPUTS: candidates, costs (nats), beliefs, elbows (world, metres); float64.
"""

from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

from jaxmocap.reference import cameras
from jaxmocap.reference.hybrid.pipeline import LIMBS, swing
from jaxmocap.reference.kinematics import forward

FARTHEST_DEG, SPACING_DEG = 75.0, 10.0
# Outline points on each side of a limb. Each end has one more, on the limb's axis.
POINTS = 8
# Pixels this near to the image's border are not scored.
BORDER_PX = 2.0


class EdgeView(NamedTuple):
    """One arm's fields (K, S, S) of K directions, samples; origin (2,) and scale of the region."""

    camera: Any
    origin: np.ndarray
    scale: float
    fields: np.ndarray


class Arm(NamedTuple):
    """Joints (4, 3) from shoulder to fingertip, grip (3,), the forearm's R (3, 3), radii (3, 2)."""

    joints: np.ndarray
    grip: np.ndarray
    R_world_radius: np.ndarray
    radii: np.ndarray


class Belief(NamedTuple):
    """Log-weights (K,) of the candidates, the expected turn (3,), the elbow's deviation, metres."""

    log_weights: np.ndarray
    turn: np.ndarray
    deviation: float


def arm_of(skeleton: Any, pose: Any, grip_sites: Any, side: str) -> Arm:
    """An arm, "l" or "r", of a pose."""
    joints, grip, _ = swing(skeleton, pose, side, grip_sites, np.zeros(4))
    bones = [skeleton.tree.bone(f"{limb}_{side}") for limb in LIMBS]
    R_world_radius = forward(skeleton, pose).R_world_bone[bones[1]]
    return Arm(joints, grip, R_world_radius, np.asarray(skeleton.diameters, float)[bones] / 2)


def forearm_turns() -> np.ndarray:
    """Rotation vectors (K, 3), radians, about the forearm's x and y: a hexagonal grid."""
    turns, height = [], SPACING_DEG * np.sin(np.pi / 3)
    for column in range(-20, 21):
        for row in range(-20, 21):
            turn = [SPACING_DEG * (column + row % 2 / 2), height * row, 0.0]
            if np.linalg.norm(turn) <= FARTHEST_DEG:
                turns.append(turn)
    return np.radians(turns)


def turn_forearm(arm: Arm, turn: np.ndarray) -> tuple[np.ndarray, float]:
    """Joints (4, 3) with the forearm turned about its grip; what the shoulder gives way, metres."""
    R = arm.R_world_radius @ Rotation.from_rotvec(turn).as_matrix() @ arm.R_world_radius.T
    elbow, wrist, tip = (arm.grip + R @ (point - arm.grip) for point in arm.joints[1:])
    upper, length = arm.joints[0] - elbow, np.linalg.norm(arm.joints[1] - arm.joints[0])
    apart = np.linalg.norm(upper)
    return np.array([elbow + upper * length / apart, elbow, wrist, tip]), float(apart - length)


def outline(near: np.ndarray, far: np.ndarray, radii: np.ndarray, tip: bool) -> list[tuple]:
    """A hull's outline on the plane z = 1: points (2,), normals (2,), lengths that they stand for.

    Args:
        near: (2,) centre of the first circle.
        far: (2,) of the second one.
        radii: (2,).
        tip: whether the outline goes around the far end, which else shows only where the limb
            points at the camera.
    """
    length = np.linalg.norm(far - near)
    along = (far - near) / length
    aside = np.array([-along[1], along[0]])
    taper = np.arcsin(np.clip((radii[0] - radii[1]) / length, -0.999, 0.999))
    points = []
    each = length * np.cos(taper) / POINTS
    for sign in (1, -1):
        normal = np.sin(taper) * along + sign * np.cos(taper) * aside
        ends = near + radii[0] * normal, far + radii[1] * normal
        for t in (np.arange(POINTS) + 0.5) / POINTS:
            points.append(((1 - t) * ends[0] + t * ends[1], normal, each))
    end_on = np.clip(1 - length / radii.sum(), 0, 1)
    arcs = (np.pi + 2 * taper) * radii[0] * end_on, (np.pi - 2 * taper) * radii[1]
    points.append((near - radii[0] * along, -along, arcs[0]))
    points.append((far + radii[1] * along, along, arcs[1] * (1 if tip else end_on)))
    return points


def off_edges(view: EdgeView, joints: np.ndarray, radii: np.ndarray, truncation: float) -> float:
    """Mean distance, metres, of an arm's outline to edges that run its way."""
    in_cam, last = cameras.to_camera(view.camera, joints), np.asarray(view.camera.size, float) - 1
    plane, total, length = cameras.normalise(in_cam), 0.0, 0.0
    for limb, counts in enumerate((1.0, 1.0, 0.5)):
        ends = in_cam[limb : limb + 2, 2]
        metres_per_px = ends.mean() / float(view.camera.matrix[0, 0])
        hull = outline(plane[limb], plane[limb + 1], radii[limb] / ends, limb == 2)
        points, normals, weights = (np.array(part) for part in zip(*hull, strict=True))
        pixels = cameras.to_pixels(view.camera, points)
        inside = np.all((pixels >= BORDER_PX) & (pixels <= last - BORDER_PX), axis=1)
        weights = weights * inside * counts
        distances = metres_per_px * look_up_distances(view, pixels, _normals(view, points, normals))
        total += float(weights @ np.minimum(distances, truncation))
        length += float(weights.sum())
    return total / length if length > 1e-6 else truncation


def _normals(view: EdgeView, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Normals (N, 2) in the image: across a small step along the outline there."""
    step = 1e-4 * np.stack([-normals[:, 1], normals[:, 0]], 1)
    ahead, behind = (cameras.to_pixels(view.camera, points + sign * step) for sign in (1, -1))
    return np.stack([(ahead - behind)[:, 1], -(ahead - behind)[:, 0]], 1)


def look_up_distances(view: EdgeView, pixels: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Distances (N,), pixels, in the fields of the normals' directions: bilinear."""
    count, size, _ = view.fields.shape
    turns = np.arctan2(normals[:, 1], normals[:, 0]) % np.pi / np.pi
    channel = np.minimum((turns * count).astype(int), count - 1)
    places = np.clip((pixels - view.origin) / view.scale - 0.5, 0, size - 1.001)
    (column, row), (right, down) = places.astype(int).T, (places % 1).T
    above, below = (
        view.fields[channel, row + k, column] * (1 - right)
        + view.fields[channel, row + k, column + 1] * right
        for k in (0, 1)
    )
    return view.scale * (above * (1 - down) + below * down)


def candidate_costs(settings: Any, view: EdgeView, arm: Arm) -> tuple[np.ndarray, np.ndarray]:
    """Costs (K,) in nats of all candidates, and their elbows (K, 3)."""
    own, edges, costs, elbows = settings.elbow_search, settings.edges, [], []
    for turn in forearm_turns():
        joints, slack = turn_forearm(arm, turn)
        by_image = off_edges(view, joints, arm.radii, float(edges.truncation))
        away = np.linalg.norm(joints[1] - arm.joints[1]) / float(own.elbow_prior)
        # Student's t with three degrees of freedom.
        prior = 2 * np.log(1 + away**2 / 3) + (slack / float(own.shoulder_slack)) ** 2 / 2
        costs.append(by_image / float(edges.scale) + prior)
        elbows.append(joints[1])
    return np.array(costs), np.array(elbows)


def filter_weights(
    settings: Any, view: EdgeView, arm: Arm, log_weights: np.ndarray, elapsed: float
) -> Belief:
    """A step of the Bayes filter: each candidate's share spreads, then the image weighs it."""
    turns, own = forearm_turns(), settings.elbow_search
    costs, elbows = candidate_costs(settings, view, arm)
    chords = 2 * np.sin(cdist(turns, turns) / 2) * np.linalg.norm(arm.joints[1] - arm.grip)
    price = (chords / (float(own.elbow_speed) * elapsed)) ** 2 / 2
    kernel = np.exp(-np.minimum(price, float(own.surprise)))
    shares = np.exp(log_weights) / np.exp(log_weights).sum()
    posterior = np.log(kernel / kernel.sum(0) @ shares + 1e-20) - costs
    posterior -= posterior.max()
    shares = np.exp(posterior) / np.exp(posterior).sum()
    spread = np.sum((elbows - shares @ elbows) ** 2, 1)
    return Belief(posterior, shares @ turns, float(np.sqrt(shares @ spread)))
