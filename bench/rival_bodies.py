"""Our skeleton as others model it: for MuJoCo (and mink), for Pinocchio (and pink).

INPUTS: a Skeleton. OUTPUTS: models of the same bones, hinges and limits; poses as they write them.
"""

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.body.tree import ROOT_DOF
from tests.subjects.mujoco_body import MujocoBody


def limited_mujoco(skeleton: Skeleton) -> MujocoBody:
    """MuJoCo's body, with our limits on its hinges."""
    body = MujocoBody(skeleton)
    body.model.jnt_limited[body.joint_ids] = 1
    body.model.jnt_range[body.joint_ids] = np.asarray(skeleton.limits, float)
    return body


def mujoco_vector(body: MujocoBody, pose: Pose) -> np.ndarray:
    """A pose as MuJoCo's qpos."""
    q = np.zeros(body.model.nq)
    q[:3], q[3:7], q[body.positions] = (np.asarray(part, float) for part in pose)
    return q


def mujoco_points(body: MujocoBody, q: np.ndarray) -> np.ndarray:
    """Positions (B, 3) of our bones' joints, world."""
    body.data.qpos[:] = q
    mujoco.mj_kinematics(body.model, body.data)
    return body.data.xpos[body.ids]


@dataclass
class PinocchioBody:
    """Pinocchio's view of a skeleton: a free flyer, then a hinge per degree of freedom.

    Attributes:
        model: with a frame at every bone's joint, named as the bone.
        data: of the model.
        frames: (B) indices of these frames.
        positions: (D) where our degrees of freedom are in its configuration.
    """

    model: Any
    data: Any
    frames: list[int]
    positions: list[int]

    @classmethod
    def of(cls, skeleton: Skeleton) -> "PinocchioBody":
        """The model of a skeleton; needs the package ``pin``."""
        import pinocchio as pin

        tree, model = skeleton.tree, pin.Model()
        ends = np.asarray(skeleton.lengths, float)[:, None] * np.asarray(skeleton.directions, float)
        axes, limits = np.asarray(skeleton.axes, float), np.asarray(skeleton.limits, float)
        root = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root")
        free, unmoved = np.full(1, 1e6), np.eye(3)
        carriers, frames, hinges = [], [], {}
        for bone, name in enumerate(tree.bones):
            parent = tree.parents[bone]
            # What carries the bone so far, and where the bone's joint lies on that.
            carrier, place = (root, np.zeros(3)) if parent < 0 else carriers[parent]
            place = place if parent < 0 else place + ends[parent]
            for dof in (d for d, turned in enumerate(tree.dof_bones) if turned == bone):
                hinge, bounds = pin.JointModelRevoluteUnaligned(axes[dof]), limits[dof]
                joint = tree.joints[dof]
                carrier = model.addJoint(
                    carrier, hinge, pin.SE3(unmoved, place), joint, free, free,
                    bounds[:1], bounds[1:],
                )  # fmt: skip
                hinges[dof], place = carrier, np.zeros(3)
            carriers.append((carrier, place))
            frame = pin.Frame(name, carrier, 0, pin.SE3(unmoved, place), pin.FrameType.OP_FRAME)
            frames.append(model.addFrame(frame))
        positions = [model.joints[hinges[dof]].idx_q for dof in range(len(tree.joints))]
        return cls(model, model.createData(), frames, positions)

    def vector(self, pose: Pose) -> np.ndarray:
        """A pose as Pinocchio's configuration: its quaternions have the real part last."""
        q = np.zeros(self.model.nq)
        position, (w, x, y, z), angles = (np.asarray(part, float) for part in pose)
        q[:3], q[3 : ROOT_DOF + 1], q[self.positions] = position, (x, y, z, w), angles
        return q

    def points(self, q: np.ndarray) -> np.ndarray:
        """Positions (B, 3) of our bones' joints, world."""
        import pinocchio as pin

        pin.framesForwardKinematics(self.model, self.data, q)
        return np.array([self.data.oMf[frame].translation for frame in self.frames])
