"""A frame's two functions of arrays, and the programs that they are for everybody alike.

    solve    markers -> pose (section 4), and the regions where it puts the arms
    refine   pose, fields -> search and simplex (5.1, 5.2), balance (5.3) -> pose, belief

Who is tracked, by what cameras and where on the bones the markers sit are arguments: another person
needs no new program. On which bones they sit is static.

INPUTS: a Skeleton, cameras, Settings, markers, the last state. OUTPUTS: Solved; pose and report.
"""

from functools import lru_cache, partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.arms import arms_of
from jaxmocap.body.kinematics import Sites, forward
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.compilation.programs import Effort, Program
from jaxmocap.evidence.edges import outline_px
from jaxmocap.geometry.cameras import Camera
from jaxmocap.hybrid.balance import bow_on_feet
from jaxmocap.hybrid.elbow_search import Belief, carried, confidence_of, no_belief
from jaxmocap.hybrid.feet import Effectors, Stance, place
from jaxmocap.hybrid.gradient import Aims, refine_body
from jaxmocap.hybrid.ik import IKResult, goal_distances, goals_of, reach, solve_ik
from jaxmocap.hybrid.observe import Observation, arm_regions
from jaxmocap.hybrid.refine import elbow_wishes, look_for_elbows, refine_arms, remember, swivels
from jaxmocap.hybrid.scan import refined_over_time, solved_over_time
from jaxmocap.hybrid.settings import Settings
from jaxmocap.images.regions import Region
from jaxmocap.solvers.status import Status

# Markers farther than this from the last pose's points: the body is placed anew, metres.
LOST_M = 0.6


class State(NamedTuple):
    """What a frame leaves to the next.

    Attributes:
        pose: of the markers alone.
        stance: where the feet stand.
        belief: what the video has told of the elbows.
    """

    pose: Pose
    stance: Stance
    belief: Belief


class StepReport(NamedTuple):
    """How far to trust a step.

    Attributes:
        pose: of the markers alone.
        distances: (M,) of the markers from their points on the refined body, metres; NaN where
            missing.
        arm_costs: (2,) mean distance of each arm's outline to the edges, pixels; NaN unseen.
        swivels: (2,) turn of each elbow that the video added, radians.
        spread: (2,) standard deviation of the elbows, metres.
        iterations: () of the inverse kinematics.
        planted: () whether the feet were planted anew.
        placed: () whether the body was placed anew.
        balanced: () whether balance bowed the spine.
        ending: () int32 ``Status`` of the gradient refinement.
    """

    pose: Pose
    distances: Array
    arm_costs: Array
    swivels: Array
    spread: Array
    iterations: Array
    planted: Array
    placed: Array
    balanced: Array
    ending: Array

    @property
    def confidence(self) -> Array | np.ndarray:
        """(2,) in the elbows, 0 to 1."""
        return confidence_of(self.spread)


class Solved(NamedTuple):
    """What ``solve`` hands on: the markers' pose, whether it was placed anew, and the regions."""

    ik: IKResult
    placed: Array
    region: Region | None


class Held(NamedTuple):
    """What is held where.

    Attributes:
        effectors: the markers, and the feet that carry none.
        grips: the point of each arm that its marker holds.
    """

    effectors: Effectors
    grips: Sites


class Programs(NamedTuple):
    """The functions of a tracker, and both over many events (``whole``)."""

    start: Program
    solve: Program
    refine: Program
    solve_all: Program
    refine_all: Program


def programs_of(held: Held) -> Programs:
    """For a tracker of these markers; all that hold the same bones share what is compiled."""
    sites = held.effectors.sites, held.grips
    bones = (tuple(np.asarray(part.bones).tolist()) for part in sites)
    shared = _programs(*bones, held.effectors.held)
    return Programs(*(each.after(tuple(part[1:] for part in sites)) for each in shared))


@lru_cache
def _programs(
    held_bones: tuple[int, ...], grip_bones: tuple[int, ...], feet: tuple[str, ...]
) -> Programs:
    """Each takes where on the bones points sit, before everything else."""

    def held_at(places: tuple) -> Held:
        sites, grips = (
            Sites(np.array(bones, np.int32), *part)
            for bones, part in zip((held_bones, grip_bones), places, strict=True)
        )
        return Held(Effectors(sites, feet), grips)

    functions = {
        "start": lambda places, *rest: start(held_at(places), *rest),
        "solve": lambda places, *rest: solve(held_at(places), *rest),
        "refine": lambda places, *rest: refine(held_at(places), *rest),
        "solve_all": lambda places, *rest: solved_over_time(partial(solve, held_at(places)), *rest),
        "refine_all": lambda places, *rest: refined_over_time(
            partial(refine, held_at(places)), *rest
        ),
    }
    # Live, the tenth that an image's refinement would take longer counts; offline the first start.
    efforts: dict[str, Effort] = {"start": "once", "refine": "full"}
    static = held_bones, grip_bones, feet
    return Programs(
        *(Program(run, name, static, efforts.get(name, "quick")) for name, run in functions.items())
    )


def start(held: Held, skeleton: Skeleton, settings: Settings, targets: Array) -> State:
    """Place the body by its first markers."""
    mask = jnp.all(jnp.isfinite(targets), -1)
    pose, stance = place(skeleton, held.effectors, settings.ik, targets, mask)
    return State(pose, stance, no_belief(settings.look, pose))


def solve(
    held: Held,
    skeleton: Skeleton,
    cameras: Camera | None,
    settings: Settings,
    pose: Pose,
    stance: Stance,
    targets: Array,
) -> Solved:
    """Markers to pose and regions."""
    mask = jnp.all(jnp.isfinite(targets), -1)
    goals = goals_of(skeleton, held.effectors, settings.ik, stance, targets, mask)
    placed = jnp.max(goal_distances(skeleton, goals, pose)[: mask.shape[0]]) > LOST_M
    pose, stance = jax.lax.cond(
        placed,
        lambda: place(skeleton, held.effectors, settings.ik, targets, mask),
        lambda: (pose, stance),
    )
    ik = solve_ik(skeleton, held.effectors, settings.ik, pose, stance, targets, mask)
    if cameras is None:
        return Solved(ik, placed, None)
    arms = arms_of(skeleton, forward(skeleton, ik.pose), held.grips)
    return Solved(
        ik, placed,
        arm_regions(cameras, arms, settings.samples, settings.margin, settings.spacing),
    )  # fmt: skip


def refine(
    held: Held,
    skeleton: Skeleton,
    cameras: Camera | None,
    settings: Settings,
    factors: Array,
    solved: Solved,
    targets: Array,
    seen: Observation | None,
    belief: Belief,
    time: Array,
) -> tuple[Belief, Pose, StepReport]:
    """The markers' pose and what was seen to the refined pose and the new belief."""
    mask = jnp.all(jnp.isfinite(targets), -1)
    pose, ik = solved.ik.pose, settings.ik
    goals = goals_of(skeleton, held.effectors, ik, solved.ik.stance, targets, mask)
    arms = arms_of(skeleton, forward(skeleton, pose), held.grips)
    costs = jnp.full(2, jnp.nan, targets.dtype)
    balanced, free = jnp.zeros((), bool), jnp.ones(skeleton.costs.shape, bool)
    centre, ending = pose, jnp.asarray(int(Status.CONVERGED), jnp.int32)
    elbows = arms.elbow
    if cameras is not None and seen is not None and settings.refine != "none":
        # From its own last pose, so that the trunk that video has found stays found.
        fresh = goal_distances(skeleton, goals, belief.pose)[: mask.shape[0]]
        lost = jnp.max(fresh) > LOST_M
        pose = jax.tree.map(lambda new, old: jnp.where(lost, new, old), pose, belief.pose)
        belief, elbows = look_for_elbows(settings, cameras, arms, seen, belief, time)
    if settings.balance:
        # From the markers' pose: one bow on another would pile up.
        bowed, free, balanced = bow_on_feet(skeleton, ik, solved.ik.pose, factors)
        pose, centre = (
            jax.tree.map(lambda new, old: jnp.where(balanced, new, old), bowed, before)
            for before in (pose, centre)
        )
    if cameras is not None and seen is not None and settings.refine != "none":
        pose, _ = reach(skeleton, goals, ik, pose, free, elbow_wishes(skeleton, elbows))
        if settings.refine == "gradient":
            aims = Aims(goals, elbows, centre, free)
            pose, *_, ending = refine_body(
                settings, skeleton, cameras, seen, pose, held.grips, aims
            )
        else:
            pose = refine_arms(
                settings, skeleton, cameras, seen, pose, held.grips, arms.grip, elbows
            )
        found = arms_of(skeleton, forward(skeleton, pose), held.grips)
        belief = remember(belief, arms, found, seen, pose)
        costs = outline_px(settings.fit, cameras, seen, found)
    elif settings.balance:
        again = lambda: reach(skeleton, goals, ik, pose, free)[0]  # noqa: E731
        pose = jax.lax.cond(balanced, again, lambda: pose)
    refined = arms_of(skeleton, forward(skeleton, pose), held.grips)
    distances = goal_distances(skeleton, goals, pose)[: mask.shape[0]]
    return (
        belief,
        pose,
        StepReport(
            solved.ik.pose,
            jnp.where(mask, distances, jnp.nan),
            costs,
            swivels(arms, refined),
            carried(settings.look, belief, time)[1],
            solved.ik.iterations,
            solved.ik.planted,
            solved.placed,
            balanced,
            ending,
        ),
    )
