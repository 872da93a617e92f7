"""Forward kinematics of thousands of poses at once, against others one pose after the other.

INPUTS: a skeleton, random poses within its limits. OUTPUTS: Metrics.
"""

from collections.abc import Callable, Iterator

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bench.clock import interleaved, ratio
from bench.metrics import Metric, stage_metrics
from bench.rival_bodies import PinocchioBody, limited_mujoco, mujoco_points, mujoco_vector
from jaxmocap.body.kinematics import Frames
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.body.tree import Tree
from jaxmocap.geometry.rotations import quaternion_to_matrix

POSES, ROUNDS = 4096, {True: 3, False: 15}
# Positions agree within this, metres.
SAME_M = 1e-5


def sine_cosine(angles: Array) -> tuple[Array, Array]:
    """Sines and cosines of many angles, radians, to float32's rounding within some turns.

    By polynomials about the nearest quarter turn, which go through many angles at once, where the
    library's functions take one after the other, ten times as long. In double precision: theirs.
    """
    if angles.dtype != jnp.float32:
        return jnp.sin(angles), jnp.cos(angles)
    quarters = jnp.round(angles * (2 / jnp.pi))
    # A quarter turn in two parts: the first has so few digits that its multiples are exact.
    rest = (angles - quarters * 1.5703125) - quarters * (jnp.pi / 2 - 1.5703125)
    squared = rest * rest
    odd = 1 + squared * (-1 / 6 + squared * (1 / 120 + squared * (-1 / 5040 + squared / 362880)))
    sine = rest * odd
    cosine = 1 + squared * (
        -1 / 2 + squared * (1 / 24 + squared * (-1 / 720 + squared * (1 / 40320)))
    )
    turn = quarters.astype(jnp.int32)
    swapped, below = (turn & 1) == 1, (turn & 2) == 2
    s, c = jnp.where(swapped, cosine, sine), jnp.where(swapped, -sine, cosine)
    return jnp.where(below, -s, s), jnp.where(below, -c, c)


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
    batched = jax.jit(lambda skeleton, poses: forward_many(skeleton, poses).joints_world)
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
            yield Metric(f"kinematics_{name}_over_ours", faster, "x", "higher")


def forward_many(skeleton: Skeleton, poses: Pose) -> Frames:
    """``forward`` of N poses (N, ...) at once, their N before every axis of the frames.

    Bone after bone down the tree, with all poses' numbers side by side: for thousands of poses six
    times as fast as ``jax.vmap`` of ``forward``, which is the faster for one.
    """
    tree, axes = skeleton.tree, skeleton.axes
    reach = (skeleton.lengths[:, None] * skeleton.directions)[..., None]
    position, angles = (jnp.moveaxis(part, -1, 0) for part in (poses.position, poses.angles))
    s, c = sine_cosine(angles)
    # Columns (3, N) of rotations.
    root = list(jnp.moveaxis(quaternion_to_matrix(poses.quaternion), 0, -1).swapaxes(0, 1))
    turned, joints, hinges = [], [], []
    for bone, parent in enumerate(tree.parents):
        R = root if parent < 0 else turned[parent]
        at = position if parent < 0 else joints[parent] + _along(R, reach[parent])
        for d in _dofs_of(tree, bone):
            x, y, z = axes[d]
            hinge = _along(R, axes[d])
            hinges.append(hinge)
            # Rodrigues' formula, each column turned about the axis.
            across = (R[1] * z - R[2] * y, R[2] * x - R[0] * z, R[0] * y - R[1] * x)
            lifted = (1 - c[d]) * hinge
            R = [c[d] * R[i] + s[d] * across[i] + lifted * axes[d, i] for i in range(3)]
        turned.append(R)
        joints.append(at)
    order = np.argsort([d for bone in range(len(tree.bones)) for d in _dofs_of(tree, bone)])
    return Frames(
        poses.position,
        jnp.moveaxis(jnp.stack([jnp.stack(R, 1) for R in turned]), -1, 0),
        jnp.moveaxis(jnp.stack(joints), -1, 0),
        jnp.moveaxis(jnp.stack([hinges[i] for i in order]), -1, 0),
    )


def _dofs_of(tree: Tree, bone: int) -> list[int]:
    """A bone's degrees of freedom, in the order in which they turn it."""
    return [d for d, on in enumerate(tree.dof_bones) if on == bone]


def _along(columns: list[Array], vector: Array) -> Array:
    """A rotation's columns (3, N) by a vector (3) of the turned frame."""
    return columns[0] * vector[0] + columns[1] * vector[1] + columns[2] * vector[2]


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
