"""A frame of the first paper's way: IK (4), a simplex over each arm by (13), (14), balance (5.3).

The arms swing about the axis from shoulder to grip, and bend at shoulder and elbow, as in the
tracker; the search and its memory are not mirrored.

INPUTS: a skeleton, settings, goals, the fields of both arms in a camera. OUTPUTS: poses; float64.
"""

from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from jaxmocap.reference import cameras
from jaxmocap.reference.hybrid import balance, ik, raster
from jaxmocap.reference.kinematics import bone_vector, forward, rotate_vectors, site_positions

LIMBS = ("humerus", "radius", "hand")


class ArmView(NamedTuple):
    """One arm in a camera's image: origin (2,) and scale of its region, its plain field (S, S)."""

    camera: Any
    origin: np.ndarray
    scale: float
    field: np.ndarray


def grips_of(skeleton: Any, pose: Any, grip_sites: Any) -> np.ndarray:
    """The two points (2, 3) that the markers hold, world, metres."""
    return site_positions(skeleton, forward(skeleton, pose), grip_sites)


def refine(
    skeleton: Any,
    settings: Any,
    factors: np.ndarray,
    markers_pose: Any,
    views: list[ArmView | None],
    grip_sites: Any,
) -> ik.Pose:
    """The markers' pose after video, and then balance of the spine alone.

    Args:
        skeleton: D degrees of freedom.
        settings: a Settings' attributes.
        factors: (3,) of balance.
        markers_pose: of inverse kinematics: the search begins there in every frame.
        views: left and right; None where an arm has no image.
        grip_sites: the points that the markers hold.
    """
    hands, pose = grips_of(skeleton, markers_pose, grip_sites), ik.as_pose(markers_pose)
    angles = pose.angles.copy()
    for arm, view in enumerate(views):
        if view is not None:
            dofs, costs = refine_arm(
                skeleton, settings, pose, "lr"[arm], view, grip_sites, hands[arm]
            )
            angles[dofs] = costs
    refined = ik.Pose(pose.position, pose.quaternion, angles)
    return balance.bow_on_feet(skeleton, settings.ik, refined, factors)[0]


def arm_dofs(skeleton: Any, side: str) -> list[int]:
    """Degrees of freedom of one arm, shoulder to elbow."""
    bones = [skeleton.tree.bone(f"{limb}_{side}") for limb in LIMBS]
    return [d for d, bone in enumerate(skeleton.tree.dof_bones) if bone in bones]


def swing(
    skeleton: Any, pose: Any, side: str, grip_sites: Any, moves: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """An arm's joints (4, 3) from shoulder to fingertip, its grip (3,) and its angles (4,).

    Args:
        skeleton: D degrees of freedom.
        pose: to start from.
        side: "l" or "r".
        grip_sites: of both arms.
        moves: (4,) the swivel, then additions to two angles of the shoulder and to the elbow's.
    """
    dofs = arm_dofs(skeleton, side)
    added = np.array([moves[1], moves[2], 0.0, moves[3]])
    angles = np.array(pose.angles, float)
    angles[dofs] += added
    frames = forward(skeleton, ik.Pose(pose.position, pose.quaternion, angles))
    bones = [skeleton.tree.bone(f"{limb}_{side}") for limb in LIMBS]
    tip = frames.joints_world[bones[2]] + frames.R_world_bone[bones[2]] @ bone_vector(
        skeleton, bones[2]
    )
    joints = np.array([*frames.joints_world[bones], tip])
    grip = site_positions(skeleton, frames, grip_sites)["lr".index(side)]
    axis = (grip - joints[0]) / np.linalg.norm(grip - joints[0])
    swung = joints[0] + rotate_vectors(joints - joints[0], axis, moves[0])
    R_humerus = rotate_vectors(frames.R_world_bone[bones[0]].T, axis, moves[0]).T
    carrier = skeleton.tree.parents[bones[0]]
    R_local = frames.R_world_bone[carrier].T @ R_humerus
    shoulder = hinge_angles(R_local, np.asarray(skeleton.axes, float)[dofs[:3]], angles[dofs[:3]])
    return swung, grip, np.append(shoulder, angles[dofs[3]])


def hinge_angles(R: np.ndarray, axes: np.ndarray, near: np.ndarray) -> np.ndarray:
    """Angles (3,) of three hinges whose product is ``R``, of both answers the nearer one."""
    handed = np.linalg.det(axes)
    one = handed * Rotation.from_matrix(axes @ R @ axes.T).as_euler("XYZ")
    other = np.array([one[0] + np.pi, np.pi - one[1], one[2] + np.pi])
    answers = [near + (answer - near + np.pi) % (2 * np.pi) - np.pi for answer in (one, other)]
    return min(answers, key=lambda answer: float(np.sum((answer - near) ** 2)))


def refine_arm(
    skeleton: Any,
    settings: Any,
    pose: Any,
    side: str,
    view: ArmView,
    grip_sites: Any,
    hand: np.ndarray,
) -> tuple[list[int], np.ndarray]:
    """The degrees of freedom of one arm and their angles where (14) is least."""
    dofs, own = arm_dofs(skeleton, side), settings.simplex
    limits = np.asarray(skeleton.limits, float)[dofs]

    begun = swing(skeleton, pose, side, grip_sites, np.zeros(4))[0]
    at_depth = float(np.mean(camera_depths(view.camera, begun)[:-1]))

    def cost(moves: np.ndarray) -> float:
        joints, grip, angles = swing(skeleton, pose, side, grip_sites, moves)
        beyond = np.maximum(limits[:, 0] - angles, 0) + np.maximum(angles - limits[:, 1], 0)
        off_edges = raster_distance(skeleton, settings, side, view, joints, at_depth)
        off_marker = float(own.hold) * float(np.linalg.norm(hand - grip))
        return (
            off_edges / float(settings.edges.scale) + off_marker + float(own.limit) * beyond.sum()
        )

    edges = np.diag([float(own.swivel_edge)] + 3 * [float(own.other_edge)])
    first = np.vstack([np.zeros(4), edges])
    # SciPy counts the first simplex as an iteration.
    often = {"initial_simplex": first, "maxiter": int(own.iterations) + 1, "xatol": 0, "fatol": 0}
    moves = minimize(cost, first[0], method="Nelder-Mead", options=often).x
    angles = swing(skeleton, pose, side, grip_sites, moves)[2]
    return dofs, np.clip(angles, limits[:, 0], limits[:, 1])


def raster_distance(
    skeleton: Any, settings: Any, side: str, view: ArmView, joints: np.ndarray, at_depth: float
) -> float:
    """Equation (13) over the side-on area of the arm, a pixel measured at a depth."""
    bones = [skeleton.tree.bone(f"{limb}_{side}") for limb in LIMBS]
    radii = np.asarray(skeleton.diameters, float)[bones] / 2
    in_region = (cameras.project(view.camera, joints) - view.origin) / view.scale - 0.5
    depths = camera_depths(view.camera, joints)
    matrix = np.asarray(view.camera.matrix, float)
    focal = (matrix[0, 0] + matrix[1, 1]) / 2 / view.scale
    projected = focal * radii / np.stack([depths[:-1], depths[1:]], 1)
    covered = raster.coverage(
        view.field.shape, in_region[:-1], in_region[1:], projected, float(settings.edges.softness)
    )
    samples_per_metre = matrix[0, 0] / max(at_depth, 0.1) / view.scale
    lengths = np.linalg.norm(np.diff(joints, axis=0), axis=1)
    area = np.sum(lengths * radii.sum(1)) * samples_per_metre**2
    return raster.chamfer(covered, view.field) / area / samples_per_metre


def camera_depths(camera: Any, points: np.ndarray) -> np.ndarray:
    """Depths (K,) of points (K, 3), world; metres."""
    return np.maximum(cameras.to_camera(camera, points)[:, 2], cameras.NEAREST_M)
