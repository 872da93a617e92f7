"""A body's arms drawn on a plain wall, without anything of the tracker: what a camera would see."""

import cv2
import numpy as np
from drawn_body import contours

from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.geometry.cameras import Camera
from jaxmocap.reference import kinematics as reference

SIZE = (640, 480)
MATRIX = np.array([[560.0, 0, 320], [0, 560, 240], [0, 0, 1]])
LIMBS = ("humerus", "radius", "hand")
WALL, SLEEVE = 60, 190


def camera_at(eye=(2.6, 0.0, 1.1), target=(0.0, 0.0, 1.1), distortion=()) -> Camera:
    """A webcam at ``eye`` that looks at ``target``, upright."""
    eye, target = np.array(eye), np.array(target)
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    R = np.stack([right, np.cross(forward, right), forward])
    return Camera.create(SIZE, MATRIX, distortion, R, -R @ eye)


def arm_pose(skeleton: Skeleton, degrees: dict[str, tuple[float, float]]) -> Pose:
    """Standing on the ground at the origin, facing +x, arms by joint: (left, right) degrees."""
    angles = np.array(skeleton.relaxed, float)
    for name, pair in degrees.items():
        for side, value in zip("lr", pair, strict=True):
            angles[skeleton.tree.joint(f"{name}_{side}")] = np.radians(value)
    pose = Pose(np.zeros(3), np.array([1.0, 0, 0, 0]), angles)
    ankle = reference.forward(skeleton, pose).joints_world[skeleton.tree.bone("foot_l"), 2]
    foot = float(skeleton.diameters[skeleton.tree.bone("foot_l"), 0])
    return pose._replace(position=np.array([0.0, 0.0, foot - ankle]))


def limbs_of(skeleton: Skeleton, pose: Pose):
    """Ends (3,), (3,) and radii (2,) of both arms' limbs: left, then right."""
    frames = reference.forward(skeleton, pose)
    for side in "lr":
        for limb in LIMBS:
            bone = skeleton.tree.bone(f"{limb}_{side}")
            near = frames.joints_world[bone]
            far = near + frames.R_world_bone[bone] @ reference.bone_vector(skeleton, bone)
            yield near, far, np.asarray(skeleton.diameters[bone], float) / 2


def draw(camera: Camera, limbs) -> np.ndarray:
    """A grey picture (480, 640), uint8, of limbs (near, far, radii) before a wall."""
    fine = 4
    image = np.full((SIZE[1] * fine, SIZE[0] * fine), WALL, np.uint8)
    for near, far, radii in limbs:
        share = np.linspace(0, 1, 15)[:, None]
        spheres = near + share * (far - near), radii[0] + share[:, 0] * (radii[1] - radii[0])
        corners = (np.concatenate(contours(camera, *spheres, 59)[1]) + 0.5) * fine - 0.5
        hull = cv2.convexHull(np.round(corners).astype(np.int32))
        cv2.fillConvexPoly(image, hull, SLEEVE)
    return cv2.resize(image, SIZE, interpolation=cv2.INTER_AREA)
