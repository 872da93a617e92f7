"""What users would take instead, side by side: kinematics, inverse kinematics, simplex.

Kinematics of thousands of poses at once stand here beside others', one pose after the other. The
downhill simplex stands beside SciPy's and optimistix': both arms, the same cost, the same first
simplices. The cost is of the tracker's kind and size: an arm of four hinges, some 150 points along
the outline of three limbs, looked up in a distance field, and how far the hand is from where it
belongs. It is written once, for NumPy and for JAX. Inverse kinematics are in ``rival_ik``. MuJoCo,
mink, pink and Pinocchio come with ``pip install ".[bench]"``; who is missing is left out.

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
import optimistix
from scipy.optimize import minimize

from bench.clock import interleaved, ratio
from bench.figures import OF_OTHERS, Metric, stage_metrics
from jaxmocap.body.kinematics import forward
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.body.tree import ROOT_DOF
from jaxmocap.solvers.simplex import downhill_simplex, initial_simplex

# Module -> what of the benchmark needs it.
OPTIONAL = {"mujoco": "kinematics and IK", "mink": "IK", "pink": "IK", "pinocchio": "kinematics"}
POSES, ROUNDS = 4096, {True: 3, False: 15}
# Positions agree within this, metres.
SAME_M = 1e-5
# Of the simplex.
SIDE, POINTS, ARMS, HINGES = 160, 25, 2, 4
FOCAL_PX, DEPTH_M = 260.0, 3.0
LENGTHS, RADII = (0.32, 0.26, 0.18), (0.05, 0.04, 0.04)
EDGE, STEPS, TOLERANCE = 0.2, 200, 1e-4
HOLD_PX = 200.0
SIMPLEX_ROUNDS = {True: 3, False: 20}
# What the arms' true hinges are, and where everybody begins.
TRUTH = np.array([[0.3, -0.2, 0.4, 0.9], [-0.4, 0.25, -0.3, 1.1]])
START = TRUTH + np.array([[0.25, -0.15, 0.2, -0.2], [-0.2, 0.2, 0.15, 0.25]])


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
    yield from simplex(quick)
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


# The simplex --------------------------------------------------------------------------------------


def turn(xp: Any, axis: int, angle: Any) -> Any:
    """(3, 3) about a coordinate axis."""
    c, s, zero, one = xp.cos(angle), xp.sin(angle), 0 * angle, 0 * angle + 1
    rows = [[c, -s, zero], [s, c, zero], [zero, zero, one]]
    order = [(i - axis - 1) % 3 for i in range(3)]
    return xp.stack([xp.stack([rows[i][j] for j in order]) for i in order])


def joints(xp: Any, hinges: Any) -> Any:
    """(4, 3) shoulder, elbow, wrist and fingertip before the camera, metres."""
    R_upper = turn(xp, 1, hinges[0]) @ turn(xp, 0, hinges[1]) @ turn(xp, 2, hinges[2])
    R_fore = R_upper @ turn(xp, 1, hinges[3])
    down = xp.asarray(np.array([0.0, 1.0, 0.0], np.float32))
    across = xp.asarray(np.array([1.0, 0.0, 0.0], np.float32))
    shoulder = xp.asarray(np.array([0.0, -0.3, DEPTH_M], np.float32))
    elbow = shoulder + LENGTHS[0] * (R_upper @ down)
    fore = R_fore @ (0.6 * down + 0.8 * across)
    return xp.stack([shoulder, elbow, elbow + LENGTHS[1] * fore, elbow + sum(LENGTHS[1:]) * fore])


def outline(xp: Any, hinges: Any) -> Any:
    """(3 * 2 * POINTS, 2) pixels along both sides of the limbs."""
    at = joints(xp, hinges)
    pixels = FOCAL_PX * at[:, :2] / at[:, 2:] + SIDE / 2
    along = pixels[1:] - pixels[:-1]
    normal = xp.stack([-along[:, 1], along[:, 0]], -1)
    normal = normal / xp.sqrt(xp.sum(normal**2, -1, keepdims=True) + 1e-6)
    share = xp.asarray(np.linspace(0.1, 0.9, POINTS, dtype=np.float32))[None, :, None]
    radii = xp.asarray(np.array(RADII, np.float32))[:, None, None] * FOCAL_PX / DEPTH_M
    middle = pixels[:-1, None] + share * along[:, None]
    sides = [middle + radii * normal[:, None], middle - radii * normal[:, None]]
    return xp.stack(sides).reshape(-1, 2)


def look_up(xp: Any, field: Any, pixels: Any) -> Any:
    """(K,) bilinear; the border goes on outside."""
    inside = xp.clip(pixels, 0.0, SIDE - 1.001)
    low = xp.floor(inside)
    part = inside - low
    x, y = low[:, 0].astype(np.int32), low[:, 1].astype(np.int32)
    u, v = part[:, 0], part[:, 1]
    above = (1 - u) * field[y, x] + u * field[y, x + 1]
    below = (1 - u) * field[y + 1, x] + u * field[y + 1, x + 1]
    return (1 - v) * above + v * below


def arm_cost(xp: Any, field: Any, grip: Any, hinges: Any) -> Any:
    """Mean distance of the outline to the edges, pixels, and of the wrist from its marker."""
    apart = joints(xp, hinges)[2] - grip
    return xp.mean(look_up(xp, field, outline(xp, hinges))) + HOLD_PX * xp.sqrt(
        xp.sum(apart**2) + 1e-12
    )


def scene() -> tuple[np.ndarray, np.ndarray]:
    """Distance fields (2, S, S) of the true outlines, and the wrists (2, 3), float32."""
    rows, columns = np.mgrid[:SIDE, :SIDE]
    grid = np.stack([columns, rows], -1)[:, :, None]
    fields = [
        np.linalg.norm(grid - outline(np, hinges), axis=-1).min(-1).clip(max=20.0)
        for hinges in TRUTH
    ]
    wrists = [joints(np, hinges)[2] for hinges in TRUTH]
    return np.asarray(fields, np.float32), np.asarray(wrists, np.float32)


def simplex(quick: bool) -> Iterator[Metric]:
    """Everybody in turn on both arms; the costs reached beside the times."""
    fields, grips = scene()
    ways = {
        "ours": ours(fields, grips),
        "scipy": by_scipy(fields, grips),
        "optimistix": by_optimistix(fields, grips),
    }
    spans = interleaved(ways, SIMPLEX_ROUNDS[quick], warm=1)
    for name, way in ways.items():
        yield from stage_metrics(f"simplex, both arms, {name}", spans[name][:, 0])
        worst = max(
            float(arm_cost(np, *problem)) for problem in zip(fields, grips, way(), strict=True)
        )
        yield Metric(f"simplex, worse arm's cost, {name}", worst, "px")
    for name in ("scipy", "optimistix"):
        faster = ratio(spans[name], spans["ours"])
        yield Metric(f"simplex_{name}_over_ours", faster, "x", "higher", OF_OTHERS)


def ours(fields: np.ndarray, grips: np.ndarray) -> Callable[[], np.ndarray]:
    """Both arms side by side."""

    @jax.jit
    def solve(fields, grips, start):
        cost = jax.vmap(lambda field, grip, hinges: arm_cost(jnp, field, grip, hinges))
        simplices = initial_simplex(start, EDGE * jnp.eye(HINGES))
        return downhill_simplex(
            lambda points: cost(fields, grips, points), simplices, STEPS, TOLERANCE, TOLERANCE
        ).points

    start = START.astype(np.float32)
    return lambda: np.asarray(solve(fields, grips, start))


def by_scipy(fields: np.ndarray, grips: np.ndarray) -> Callable[[], np.ndarray]:
    """``scipy.optimize.minimize``, one arm after the other, the cost in NumPy."""

    def one(field: np.ndarray, grip: np.ndarray, start: np.ndarray) -> np.ndarray:
        first = np.vstack([start, start + EDGE * np.eye(HINGES)])
        options = {
            "initial_simplex": first, "maxiter": STEPS, "xatol": TOLERANCE, "fatol": TOLERANCE
        }  # fmt: skip
        return minimize(
            lambda hinges: arm_cost(np, field, grip, hinges), start,
            method="Nelder-Mead", options=options,
        ).x  # fmt: skip

    return lambda: np.stack([one(*problem) for problem in zip(fields, grips, START, strict=True)])


def by_optimistix(fields: np.ndarray, grips: np.ndarray) -> Callable[[], np.ndarray]:
    """``optimistix.NelderMead`` on each hinge as a leaf (as one array it starts degenerate)."""
    solver = optimistix.NelderMead(rtol=TOLERANCE, atol=TOLERANCE)

    @jax.jit
    def solve(fields, grips, start):
        def one(field, grip, start):
            def cost(hinges, _):
                return arm_cost(jnp, field, grip, jnp.stack(hinges))

            solution = optimistix.minimise(
                cost, solver, tuple(start), max_steps=STEPS, throw=False
            ).value
            return jnp.stack(solution)

        return jax.vmap(one)(fields, grips, start)

    start = START.astype(np.float32)
    return lambda: np.asarray(solve(fields, grips, start))
