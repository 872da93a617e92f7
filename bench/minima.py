"""``python -m bench.minima [--each N] [--recordings DIR] [--json FILE]``: where ``solve`` ends.

Random problems of inverse kinematics, three and five markers: people rendered and, with
``--recordings``, real ones; from nothing or from a last pose; markers missing, arms straight, hands
anywhere within reach or out of it, starts far away. Cost where ours ends in float32 and float64
beside SciPy's least squares with the same limits and optimistix' Levenberg-Marquardt, whose limits
are prices, all from the same start; and ours' derivatives in float32 beside float64.

INPUTS: real recordings, none needed. OUTPUTS: one table, and Metrics: milliseconds; how often a
cost is within 1 % of the least that anybody found, and twice it; relative errors of gradients.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy.optimize import least_squares as scipys

from bench import command
from bench.clock import timed
from bench.figures import Metric, table, write_json
from jaxmocap import LANDMARKS, Model, Recording, Settings, Skeleton, landmarks, solve
from jaxmocap.body.kinematics import forward, landmark_sites
from jaxmocap.body.model import on_unmarked_feet
from jaxmocap.body.pose import Pose, difference, relaxed_pose, retract
from jaxmocap.body.skeleton import WINTER
from jaxmocap.evidence.expansion import expand_terms
from jaxmocap.evidence.limits import JointLimits
from jaxmocap.evidence.posture import EasyPosture, LastPose, NearPose, effort_shares
from jaxmocap.evidence.terms import Measurements, residuals
from jaxmocap.hybrid.feet import place, standing
from jaxmocap.hybrid.ik import goals_of, reach
from jaxmocap.pipelines.progress import progress_bar
from jaxmocap.solvers.least_squares import least_squares
from jaxmocap.synthetic.movements import motions

NAMES = ("vertex", "wrist_l", "wrist_r", "ankle_l", "ankle_r")
# Movements, statures in metres, samples a second.
PEOPLE = (
    (motions.table_tennis, 1.75), (motions.thrust, 1.62), (motions.squat, 1.86),
    (motions.reaching, 1.7), (motions.table_tennis, 1.9), (motions.thrust, 1.8),
)  # fmt: skip
SECONDS, RATE_HZ = 12.0, 30.0
KINDS = ("usual", "markers missing", "straight arms", "hands anywhere", "out of reach", "far start")
WRISTS = {"l": 1, "r": 2}
# A cost this share above the least is as good.
AS_GOOD = 0.01
SETTINGS = Settings(refine="none")


class Problem(NamedTuple):
    """What is to be solved.

    Attributes:
        kind: of ``KINDS``, and whether there is a last pose.
        model: of the person and the markers.
        markers: (M, 3) world, metres; NaN where missing.
        start: the last pose, or None.
    """

    kind: str
    model: Model
    markers: np.ndarray
    start: Pose | None


def filmed(folder: Path | None) -> Iterator[tuple[Model, np.ndarray]]:
    """People: models, and (T, M, 3) markers."""
    for seed, (movement, stature) in enumerate(PEOPLE):
        times = np.arange(0, SECONDS, 1 / RATE_HZ)
        truth = movement(SECONDS, seed=seed, height=stature).landmarks(times)
        skeleton = Skeleton.human(stature, proportions=WINTER)
        for count in (3, 5):
            model = Model.create(skeleton, landmark_sites(skeleton, NAMES[:count]))
            markers = np.stack([truth[name] for name in NAMES[:count]], 1)
            yield on_unmarked_feet(model), markers
    for path in sorted(folder.rglob("recording_*.toml")) if folder else ():
        recording = Recording.load(path)
        model = Model.of(replace(recording, videos=()))
        if len(model.markers.bone_indices) in (3, 5):
            yield model, np.asarray(recording.positions_world)


def problems(people: Iterator[tuple[Model, np.ndarray]], each: int) -> list[Problem]:
    """So many of each kind for every person."""
    rng, posed, points = np.random.default_rng(5), jax.jit(solve), jax.jit(landmarks)
    made = []
    for model, samples in people:
        samples = samples[np.isfinite(samples).all((1, 2))].astype(np.float32)
        at = partial(posed, model, SETTINGS)
        bones = np.array(model.skeleton.tree.bones_in("arm", side="l"))[:2]
        arm = float(jnp.sum(model.skeleton.lengths[bones]))
        for kind in KINDS:
            for turn in range(each):
                row = int(rng.integers(1, len(samples)))
                markers, before = samples[row].copy(), max(row - int(rng.integers(1, 4)), 0)
                start = at(samples[before]) if turn % 2 else None
                if kind == "far start":
                    start = at(samples[rng.integers(len(samples))])
                    off = 0.4 * (turn % 2) * rng.normal(size=start.angles.shape)
                    start = start._replace(angles=start.angles + off.astype(np.float32))
                if kind == "markers missing":
                    count = int(rng.integers(1, len(markers) - 1))
                    markers[rng.choice(len(markers), count, replace=False)] = np.nan
                if kind in ("straight arms", "hands anywhere", "out of reach"):
                    there = np.asarray(points(model, at(markers)))
                    for side, wrist in WRISTS.items():
                        shoulder = there[LANDMARKS.index(f"shoulder_{side}")]
                        markers[wrist] = _hand(kind, markers[wrist], shoulder, arm, rng)
                ending = "" if start is None else ", from a last pose"
                made.append(Problem(kind + ending, model, markers, start))
    return made


def _hand(
    kind: str, wrist: np.ndarray, shoulder: np.ndarray, arm: float, rng: np.random.Generator
) -> np.ndarray:
    """A wrist's marker (3,) moved; in a third of the cases it stays."""
    way = rng.normal(size=3)
    way /= np.linalg.norm(way)
    if kind == "straight arms":
        way = (wrist - shoulder) / np.linalg.norm(wrist - shoulder)
        return shoulder + way * arm * rng.uniform(0.97, 1.03)
    if rng.random() < 1 / 3:
        return wrist
    if kind == "hands anywhere":
        return shoulder + way * arm * rng.uniform(0.2, 0.95)
    return wrist + way * rng.uniform(0.3, 0.9)


class Objective(NamedTuple):
    """What ``solve`` minimises, and from where.

    Attributes:
        start: to descend from.
        measured: ``goals`` and ``last``.
    """

    start: Pose
    measured: Measurements


@jax.jit
def objective(model: Model, settings: Settings, markers: Array, start: Pose | None) -> Objective:
    """What ``solve`` minimises."""
    relaxed = relaxed_pose(model.skeleton)
    pose, feet = place(model, settings.ik, markers)
    frames, remembered = forward(model.skeleton, relaxed), start is not None
    if start is not None:
        pose, feet, frames = start, standing(model, start), forward(model.skeleton, start)
    effort = effort_shares(model.skeleton, frames, settings.ik.augmented_body)
    goals = goals_of(model, settings.ik, feet, markers)
    return Objective(pose, Measurements(goals=goals, last=LastPose(pose, effort, remembered)))


def terms(settings: Settings) -> tuple:
    """That cost."""
    ik = settings.ik
    return *ik.terms, EasyPosture(ik.relaxation, ik.uprightness, ik.memory)


@jax.jit
def local(model: Model, settings: Settings, aim: Objective, pose: Pose) -> tuple[Array, Array]:
    """Residuals (R,) and their Jacobian (R, 6 + D)."""
    return expand_terms(terms(settings), model, pose, aim.measured, bends=False)[:2]


@jax.jit
def ours(model: Model, settings: Settings, aim: Objective) -> Pose:
    """Where ``solve`` ends."""
    remembered = aim.measured.last.remembered
    return reach(model, settings.ik, aim.measured, aim.start, remembered=remembered)


@jax.jit
def optimistixs(model: Model, settings: Settings, aim: Objective) -> Pose:
    """Where Levenberg-Marquardt ends, 1000 steps at most; clipped to the limits."""
    scale = NearPose().deviations(model.skeleton)
    priced = (*terms(settings), JointLimits())
    found = least_squares(
        lambda x, _: residuals(priced, model, retract(aim.start, scale * x), aim.measured),
        jnp.zeros_like(scale), largest_steps=1000, tolerance=1e-6,
    )  # fmt: skip
    pose, limits = retract(aim.start, scale * found.point), model.skeleton.limits
    return pose._replace(angles=jnp.clip(pose.angles, *limits.T))


def by_scipy(model: Model, settings: Settings, aim: Objective) -> Pose:
    """Where SciPy's trust region ends, by tangent vectors about the start, within the limits."""
    low, high = np.asarray(model.skeleton.limits, float).T
    start = aim.start._replace(angles=jnp.clip(aim.start.angles, low, high))
    bounds = (
        np.concatenate([np.full(6, -np.inf), low - np.asarray(start.angles) - 1e-9]),
        np.concatenate([np.full(6, np.inf), high - np.asarray(start.angles) + 1e-9]),
    )
    along = partial(_along, model, settings, aim, start)
    try:
        found = scipys(
            lambda x: np.asarray(along(x)[0]), np.zeros(len(low) + 6),
            lambda x: np.asarray(along(x)[1]),  # pyright: ignore
            bounds, xtol=1e-12, ftol=1e-12, gtol=1e-12, x_scale="jac", max_nfev=500,
        )  # fmt: skip
    except np.linalg.LinAlgError:
        # Its own singular value decomposition did not converge.
        return start
    return retract(start, jnp.asarray(found.x))


@jax.jit
def _along(
    model: Model, settings: Settings, aim: Objective, start: Pose, x: Array
) -> tuple[Array, Array]:
    """Residuals where a tangent vector leads, and their Jacobian by it."""
    r, J = local(model, settings, aim, retract(start, x))
    turned = jax.jacfwd(lambda more: difference(retract(start, x + more), retract(start, x)))
    return r, J @ turned(jnp.zeros_like(x))


def cost(model: Model, settings: Settings, aim: Objective, pose: Pose) -> float:
    """In nats."""
    return float(jnp.sum(local(model, settings, aim, pose)[0] ** 2) / 2)


@jax.jit
def gradient(model: Model, settings: Settings, markers: Array, start: Pose | None, by: Array):
    """Of landmarks times ``by`` (L, 3): by markers, lengths, marker offsets, settings."""

    ik = settings.ik

    def weighed(markers: Array, lengths: Array, offsets: Array, gains: Array) -> Array:
        skeleton = replace(model.skeleton, lengths=lengths)
        own = replace(model, skeleton=skeleton, markers=replace(model.markers, offsets=offsets))
        chosen = replace(ik, **dict(zip(GAINS, gains, strict=True)))
        return jnp.sum(
            by * landmarks(own, solve(own, replace(settings, ik=chosen), markers, start))
        )

    gains = jnp.stack([getattr(ik, name) for name in GAINS])
    arguments = markers, model.skeleton.lengths, model.markers.offsets, gains
    return jax.grad(weighed, (0, 1, 2, 3))(*arguments)


GAINS = ("relaxation", "uprightness", "memory")
GRADIENTS = ("markers", "bone lengths", "marker offsets", "settings")


def cast(tree: Any, dtype: Any) -> Any:
    """The same numbers in another precision."""
    return jax.tree.map(
        lambda leaf: jnp.asarray(leaf, dtype if np.asarray(leaf).dtype.kind == "f" else None), tree
    )


def measure(cases: list[Problem]) -> Iterator[Metric]:
    """All solvers and gradients on all problems."""
    solvers: dict[str, tuple[Callable, Any]] = {
        "ours, float32": (ours, jnp.float32), "ours, float64": (ours, jnp.float64),
        "optimistix, float64": (optimistixs, jnp.float64),
        "SciPy, float64": (by_scipy, jnp.float64),
    }  # fmt: skip
    spent, costs = {name: [] for name in solvers}, {name: [] for name in solvers}
    wrong = {name: [] for name in GRADIENTS}
    rng = np.random.default_rng(6)
    with jax.enable_x64(True), progress_bar("problems", None) as show:
        for done, problem in enumerate(cases):
            show(done, len(cases))
            wide = cast((problem[1], SETTINGS, *problem[2:]), jnp.float64)
            model, settings, markers, start = wide
            at = objective(model, settings, markers, start)
            for name, (solver, dtype) in solvers.items():
                span, pose = timed(solver, *cast((model, settings, at), dtype))
                spent[name].append(span.wall)
                costs[name].append(cost(model, settings, at, cast(pose, jnp.float64)))
            by = rng.normal(size=(len(LANDMARKS), 3))
            single = gradient(*cast((*wide, by), jnp.float32))
            for name, a, b in zip(GRADIENTS, single, gradient(*wide, by), strict=True):
                wrong[name].append(float(jnp.linalg.norm(a - b) / (jnp.linalg.norm(b) + 1e-9)))
    least, kinds = np.min(list(costs.values()), 0), np.array([each.kind for each in cases])
    for name, each in costs.items():
        over = np.array(each) / np.maximum(least, 1e-4)
        yield Metric(name, float(np.median(spent[name])), "ms")
        as_good = 100 * float(np.mean(over <= 1 + AS_GOOD))
        yield Metric(f"{name}, within 1 % of the least", as_good, "%", "higher")
        yield Metric(f"{name}, over twice the least", float(np.sum(over > 2)), "")
    above = np.array(costs["ours, float32"]) / np.maximum(costs["ours, float64"], 1e-4)
    yield Metric("float32 within 1 % of float64", 100 * float(np.mean(above <= 1.01)), "%")
    for name, each in wrong.items():
        each = 100 * np.array(each)
        for ending, part in (("", kinds != ""), (", usual", np.char.startswith(kinds, "usual"))):
            median, late = np.percentile(each[part], [50, 99])
            yield Metric(f"gradient by {name}{ending}, error, median", float(median), "%")
            yield Metric(f"gradient by {name}{ending}, error, 99 %", float(late), "%")


def main() -> None:
    """Print the table."""
    parser = command("bench.minima", __doc__)
    parser.add_argument("--each", type=int, default=10, help="problems of a kind and a person")
    parser.add_argument("--recordings", metavar="DIR", type=Path, help="real recordings")
    options = parser.parse_args()
    cases = problems(filmed(options.recordings), options.each)
    print(f"{len(cases)} problems")
    metrics = list(measure(cases))
    print(table(metrics))
    write_json(metrics, options.json)


if __name__ == "__main__":
    main()
