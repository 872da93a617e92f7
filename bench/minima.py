"""``python -m bench.minima [--json FILE]``: the descent to a pose's minimum, and optimistix'.

Both begin where algorithm 1 ends and minimise the same terms: goals, the secondary task, the
joints' ranges as prices. Ours keeps the ranges besides, which optimistix does not know, and costs
up to 3 % more for it where a hand is out of reach. Table tennis, as it is and with a hand out of
reach, in float32 and float64.

INPUTS: nothing. OUTPUTS: one table, and Metrics: milliseconds; how often the cost is within a
thousandth of the least that anybody found, and by how much it is above it.
"""

from collections.abc import Callable, Iterator
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bench.clock import timed
from bench.command_line import command
from bench.metrics import Metric, stage_metrics, table, write_json
from jaxmocap.body.kinematics import forward, landmark_sites
from jaxmocap.body.model import Model, on_unmarked_feet
from jaxmocap.body.pose import Pose, retract
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.evidence.limits import JointLimits
from jaxmocap.evidence.posture import EasyPosture, LastPose, NearPose, effort_shares
from jaxmocap.evidence.terms import Measurements, residuals
from jaxmocap.hybrid.feet import place
from jaxmocap.hybrid.ik import goals_of
from jaxmocap.hybrid.minimum import pose_at_minimum
from jaxmocap.hybrid.paper import ik as paper_ik
from jaxmocap.hybrid.settings import Settings
from jaxmocap.solvers.least_squares import least_squares
from jaxmocap.synthetic.movements.motions import table_tennis

NAMES = ("vertex", "wrist_l", "wrist_r")
# Samples, how far apart, and how far the left hand is moved ahead where it is out of reach, metres.
SAMPLES, APART_S, AHEAD_M = 24, 0.25, 0.6
# Steps of optimistix' solver: as many as the descent may take, and many more.
STEPS = (100, 1000)
# A cost this share above the least is as good.
AS_GOOD = 1e-3

Solve = Callable[[Pose, Measurements], Pose]


def problems(model: Model, markers: np.ndarray) -> Iterator[tuple[Pose, Measurements]]:
    """Where algorithm 1 ends, and what is to be met, sample by sample."""
    settings = Settings()

    @jax.jit
    def posed(targets: Array) -> tuple[Pose, Measurements]:
        placed, feet = place(model, settings.ik, targets)
        effort = effort_shares(model.skeleton, forward(model.skeleton, placed), "distal")
        goals = goals_of(model, settings.ik, feet, targets)
        start, _ = paper_ik.reach(model, settings.ik, {"goals": goals}, placed)
        return start, {"goals": goals, "last": LastPose(placed, effort, False)}

    for targets in markers:
        yield posed(jnp.asarray(targets, model.dtype))


def rivals(model: Model) -> tuple[dict[str, Solve], Callable[[Pose, Measurements], Array]]:
    """Ours and optimistix', and what all of them minimise."""
    terms = (Settings().ik.goals, EasyPosture(), JointLimits())
    scale = NearPose().deviations(model.skeleton)

    def whitened(pose: Pose, measured: Measurements) -> Array:
        return residuals(terms, model, pose, measured)

    def cost(pose: Pose, measured: Measurements) -> Array:
        return jnp.sum(whitened(pose, measured) ** 2) / 2

    def ours(pose: Pose, measured: Measurements) -> Pose:
        return pose_at_minimum(model, terms, measured, pose)[0]

    def optimistix(steps: int, pose: Pose, measured: Measurements) -> Pose:
        tolerance = float(jnp.finfo(scale.dtype).eps) ** 0.75
        found = least_squares(
            lambda point, _: whitened(retract(pose, scale * point), measured),
            jnp.zeros_like(scale), largest_steps=steps, relative=tolerance, absolute=tolerance,
        )  # fmt: skip
        return retract(pose, scale * found.point)

    each: dict[str, Solve] = {"ours": jax.jit(ours)}
    for steps in STEPS:
        each[f"optimistix, {steps} steps"] = jax.jit(partial(optimistix, steps))
    return each, jax.jit(cost)


def measure() -> Iterator[Metric]:
    """All rivals on all problems in both precisions."""
    times = APART_S * np.arange(SAMPLES)
    truth = table_tennis(SAMPLES * APART_S, seed=0).landmarks(times)
    within = np.stack([truth[name] for name in NAMES], 1)
    beyond = within + np.array([[0, 0, 0], [AHEAD_M, 0, 0], [0, 0, 0]])
    for bits in (32, 64):
        with jax.enable_x64(bits == 64):
            person = Skeleton.human(1.75)
            model = on_unmarked_feet(Model.create(person, landmark_sites(person, NAMES)))
            solves, cost = rivals(model)
            for kind, markers in (("within reach", within), ("out of reach", beyond)):
                given = list(problems(model, markers))
                yield from compared(f"float{bits}, {kind}", solves, cost, given)


def compared(
    kind: str,
    solves: dict[str, Solve],
    cost: Callable[[Pose, Measurements], Array],
    given: list[tuple[Pose, Measurements]],
) -> Iterator[Metric]:
    """One kind of problem: times, and costs beside the least."""
    spent, prices = {}, {}
    for name, solve in solves.items():
        jax.block_until_ready(solve(*given[0]))
        taken = [timed(solve, *problem) for problem in given]
        spent[name] = [span.wall for span, _ in taken]
        prices[name] = [
            float(cost(pose, problem[1])) for (_, pose), problem in zip(taken, given, strict=True)
        ]
    least = np.min(list(prices.values()), 0)
    for name in solves:
        above = np.array(prices[name]) / least - 1
        yield from stage_metrics(f"{kind}, {name}", spent[name])
        yield Metric(f"{kind}, {name}, as good as the best", 100 * np.mean(above < AS_GOOD), "%")
        yield Metric(f"{kind}, {name}, worst above the best", 100 * float(above.max()), "%")


def main() -> None:
    """Print the table."""
    parser = command("bench.minima", __doc__)
    parser.add_argument("--json", metavar="FILE", help="write the metrics")
    options = parser.parse_args()
    metrics = list(measure())
    print(table(metrics))
    if options.json:
        write_json(metrics, options.json)


if __name__ == "__main__":
    main()
