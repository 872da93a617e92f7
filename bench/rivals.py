"""What users would take instead, side by side: kinematics, inverse kinematics, simplex.

Kinematics of thousands of poses at once stand here beside others', one pose after the other.
Inverse kinematics are in ``rival_ik``, the simplex in ``algorithms``. MuJoCo, mink, pink and
Pinocchio come with ``pip install ".[bench]"``; who is missing is left out.

INPUTS: none. OUTPUTS: Metrics; names of who is missing.
"""

import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from bench import algorithms
from bench.clock import interleaved, ratio
from bench.figures import OF_OTHERS, Metric, stage_metrics
from jaxmocap.body.kinematics import forward
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.body.tree import ROOT_DOF

# Module -> what of the benchmark needs it.
OPTIONAL = {"mujoco": "kinematics and IK", "mink": "IK", "pink": "IK", "pinocchio": "kinematics"}
POSES, ROUNDS = 4096, {True: 3, False: 15}
# Positions agree within this, metres.
SAME_M = 1e-5


def missing() -> list[str]:
    """Rivals that are not installed, each with a line on stderr."""
    absent = [name for name in OPTIONAL if find_spec(name) is None]
    for name in absent:
        print(f"{name} is not installed: left out of {OPTIONAL[name]}", file=sys.stderr)
    return absent


def unmeasured(absent: list[str]) -> list[str]:
    """Parts of the names of ratios that are not measured without them."""
    # The bodies of all of these begin with MuJoCo's.
    return [*absent, *(("ik_", "kinematics_pinocchio") if "mujoco" in absent else ())]


def measure(quick: bool, without: list[str]) -> Iterator[Metric]:
    """Everybody who is there."""
    yield from algorithms.simplex(quick)
    if "mujoco" not in without:
        from bench import rival_ik

        yield from kinematics(quick, set(without))
        yield from rival_ik.measure(quick, set(without))


def random_poses(skeleton: Skeleton, count: int, seed: int = 0) -> Pose:
    """Poses (N, ...) anywhere within the limits, float32."""
    rng = np.random.default_rng(seed)
    low, high = np.asarray(skeleton.limits, float).T
    quaternions = rng.normal(size=(count, 4))
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    angles = rng.uniform(low, high, (count, len(low)))
    parts = (rng.uniform(-1, 1, (count, 3)), quaternions, angles)
    return Pose(*(jnp.asarray(part, jnp.float32) for part in parts))


def kinematics(quick: bool, without: set[str]) -> Iterator[Metric]:
    """Ours batched, MuJoCo and Pinocchio in a loop; to the same positions, else it raises."""
    skeleton = Skeleton.human(1.75)
    poses = random_poses(skeleton, POSES)
    batched = jax.jit(
        jax.vmap(lambda skeleton, pose: forward(skeleton, pose).joints_world, (None, 0))
    )
    ways: dict[str, Callable] = {
        "ours": lambda: np.asarray(batched(skeleton, poses)),
        "mujoco": in_mujoco(skeleton, poses),
    }
    if "pinocchio" not in without:
        ways["pinocchio"] = in_pinocchio(skeleton, poses)
    expected = ways["ours"]()
    for name, way in ways.items():
        apart = float(np.abs(way() - expected).max())
        if apart > SAME_M:
            raise RuntimeError(f"{name}: joints {apart:.1e} m from ours")
    spans = interleaved(ways, ROUNDS[quick], warm=1)
    for name, times in spans.items():
        yield from stage_metrics(f"kinematics of {POSES} poses, {name}", times[:, 0])
    for name in ways:
        if name != "ours":
            faster = ratio(spans[name], spans["ours"])
            yield Metric(f"kinematics_{name}_over_ours", faster, "x", "higher", OF_OTHERS)


@dataclass
class PinocchioBody:
    """Pinocchio's view of a skeleton: a free flyer, then a hinge per degree of freedom.

    Attributes:
        model: with a frame at every bone's joint, named as the bone.
        data: of the model.
        translations: (B) of (3,), where these frames are: views of the data, whose every reading
            through Python takes longer than the kinematics.
        positions: (D) where our degrees of freedom are in its configuration.
    """

    model: Any
    data: Any
    translations: list[np.ndarray]
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
        data = model.createData()
        return cls(model, data, [data.oMf[frame].translation for frame in frames], positions)

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
        return np.array(self.translations)


def each(poses: Pose) -> Iterator[Pose]:
    """One pose after the other, on the host: JAX takes long to hand over a row at a time."""
    return (Pose(*pose) for pose in zip(*map(np.asarray, poses), strict=True))


def in_mujoco(skeleton: Skeleton, poses: Pose) -> Callable[[], np.ndarray]:
    """One ``mj_kinematics`` after the other."""
    from bench.rival_ik import limited_mujoco, mujoco_points, mujoco_vector

    body = limited_mujoco(skeleton)
    vectors = np.stack([mujoco_vector(body, pose) for pose in each(poses)])
    return lambda: np.stack([mujoco_points(body, q) for q in vectors])


def in_pinocchio(skeleton: Skeleton, poses: Pose) -> Callable[[], np.ndarray]:
    """One ``framesForwardKinematics`` after the other."""
    body = PinocchioBody.of(skeleton)
    vectors = np.stack([body.vector(pose) for pose in each(poses)])
    return lambda: np.stack([body.points(q) for q in vectors])
