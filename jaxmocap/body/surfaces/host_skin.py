"""A surface over time, in double precision on the host: for files and pictures.

INPUTS: a Skeleton, poses (T, ...), a Surface's points. OUTPUTS: nodes (T, N, 3) in the world, NaN
where the pose is unknown; ``surface.posed`` is for what is traced.
"""

import numpy as np

from jaxmocap.body.orientations import body_turns, matrices
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.body.surfaces.surface import BodyPoints


def bones_over_time(skeleton: Skeleton, poses: Pose) -> tuple[np.ndarray, np.ndarray]:
    """Orientations (T, B, 3, 3) of the bones and places (T, B, 3) of their joints, world."""
    root = matrices(np.asarray(poses.quaternion, float))
    R = root[:, None] @ body_turns(skeleton, np.asarray(poses.angles, float))
    reach = np.asarray(skeleton.lengths, float)[:, None] * np.asarray(skeleton.directions, float)
    joints = np.repeat(np.asarray(poses.position, float)[:, None], len(reach), 1)
    for bone, parent in enumerate(skeleton.tree.parents):
        if parent >= 0:
            joints[:, bone] = joints[:, parent] + R[:, parent] @ reach[parent]
    return R, joints


def nodes_over_time(
    points: BodyPoints, R_world_bone: np.ndarray, joints_world: np.ndarray
) -> np.ndarray:
    """Nodes (T, N, 3) of ``bones_over_time``'s bones: linear blend skinning."""
    bones, shares = np.asarray(points.bones), np.asarray(points.shares, float)
    places = np.asarray(points.points_bone, float)
    nodes = np.zeros((len(joints_world), len(bones), 3))
    for k in range(bones.shape[1]):
        turned = np.einsum("tnij,nj->tni", R_world_bone[:, bones[:, k]], places[:, k])
        nodes += shares[:, k, None] * (joints_world[:, bones[:, k]] + turned)
    return nodes
