"""Forward kinematics of thousands of poses at once, against others one pose after the other.

INPUTS: a skeleton, random poses within its limits. OUTPUTS: Metrics.
"""

from collections.abc import Callable, Iterator

import jax
import jax.numpy as jnp
import numpy as np

from bench.clock import interleaved, ratio
from bench.metrics import OF_OTHERS, Metric, stage_metrics
from bench.rival_bodies import PinocchioBody, limited_mujoco, mujoco_points, mujoco_vector
from jaxmocap.body.kinematics import forward
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton

POSES, ROUNDS = 4096, {True: 3, False: 15}
# Positions agree within this, metres.
SAME_M = 1e-5


def random_poses(skeleton: Skeleton, count: int, seed: int = 0) -> Pose:
    """Poses (N, ...) anywhere within the limits, float32."""
    rng = np.random.default_rng(seed)
    low, high = np.asarray(skeleton.limits, float).T
    quaternions = rng.normal(size=(count, 4))
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    angles = rng.uniform(low, high, (count, len(low)))
    parts = (rng.uniform(-1, 1, (count, 3)), quaternions, angles)
    return Pose(*(jnp.asarray(part, jnp.float32) for part in parts))


def measure(quick: bool, without: set[str]) -> Iterator[Metric]:
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


def in_mujoco(skeleton: Skeleton, poses: Pose) -> Callable[[], np.ndarray]:
    """One ``mj_kinematics`` after the other."""
    body = limited_mujoco(skeleton)
    vectors = np.stack([mujoco_vector(body, Pose(*pose)) for pose in zip(*poses, strict=True)])
    return lambda: np.stack([mujoco_points(body, q) for q in vectors])


def in_pinocchio(skeleton: Skeleton, poses: Pose) -> Callable[[], np.ndarray]:
    """One ``framesForwardKinematics`` after the other."""
    body = PinocchioBody.of(skeleton)
    vectors = np.stack([body.vector(Pose(*pose)) for pose in zip(*poses, strict=True)])
    return lambda: np.stack([body.points(q) for q in vectors])
