"""A Skeleton as a MuJoCo model: the independent reference of kinematics and mass."""

from dataclasses import dataclass

import mujoco
import numpy as np

from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton

ROOT = "pelvis"


def mjcf(skeleton: Skeleton) -> str:
    """The model's XML: a free joint at the pelvis, a hinge per degree of freedom, masses."""
    tree = skeleton.tree
    reach = np.asarray(skeleton.lengths)[:, None] * np.asarray(skeleton.directions)
    axes = np.asarray(skeleton.axes)

    def text(vector: np.ndarray) -> str:
        return " ".join(repr(float(x)) for x in vector)

    def inertia(mass: float, centre: np.ndarray) -> str:
        return f'<inertial pos="{text(centre)}" mass="{mass!r}" diaginertia="1e-3 1e-3 1e-3"/>'

    def bodies(parent: int) -> str:
        start = np.zeros(3) if parent < 0 else reach[parent]
        lines = []
        for i, name in enumerate(tree.bones):
            if tree.parents[i] != parent:
                continue
            lines.append(f'<body name="{name}" pos="{text(start)}">')
            lines.append(inertia(float(skeleton.masses[i]), float(skeleton.centres[i]) * reach[i]))
            for dof, bone in enumerate(tree.dof_bones):
                if bone == i:
                    lines.append(f'<joint name="{tree.joints[dof]}" axis="{text(axes[dof])}"/>')
            lines.append(bodies(i) + "</body>")
        return "\n".join(lines)

    # MuJoCo wants a mass wherever something moves; the virtual root has none to speak of.
    root = f'<body name="{ROOT}"><freejoint/>{inertia(1e-12, np.zeros(3))}{bodies(-1)}</body>'
    return (
        '<mujoco><compiler angle="radian"/><default><joint type="hinge" limited="false"/></default>'
        f"<worldbody>{root}</worldbody></mujoco>"
    )


@dataclass
class MujocoBody:
    """MuJoCo's view of a skeleton in one pose at a time."""

    skeleton: Skeleton

    def __post_init__(self):
        self.model = mujoco.MjModel.from_xml_string(mjcf(self.skeleton))
        self.data = mujoco.MjData(self.model)
        names = self.skeleton.tree.bones
        self.ids = [self.model.body(name).id for name in names]
        joints = [self.model.joint(name) for name in self.skeleton.tree.joints]
        self.joint_ids = [joint.id for joint in joints]
        self.positions = [joint.qposadr[0] for joint in joints]
        self.velocities = [joint.dofadr[0] for joint in joints]

    def move(self, pose: Pose) -> None:
        """Take a pose and compute positions, orientations and centres of gravity."""
        self.data.qpos[:3] = pose.position
        self.data.qpos[3:7] = pose.quaternion
        self.data.qpos[self.positions] = pose.angles
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)

    def jacobian(self, bone: int, point_world: np.ndarray) -> np.ndarray:
        """(3, 6 + D) in our order: shifts and turns along the world's axes, then the hinges."""
        J = np.zeros((3, self.model.nv))
        mujoco.mj_jac(self.model, self.data, J, None, point_world, self.ids[bone])
        # MuJoCo turns a free body about its own axes, we about the world's.
        R_world_root = self.data.body(ROOT).xmat.reshape(3, 3)
        return np.hstack([J[:, :3], J[:, 3:6] @ R_world_root.T, J[:, self.velocities]])
