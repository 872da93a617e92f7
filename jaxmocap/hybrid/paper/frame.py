"""A frame as the first paper has it (Fig. 3): inverse kinematics, then video, then balance.

    the paper                                    ours                    reference.hybrid
    solve by SDLS: algorithm 1, (1) to (9)       paper.ik.reach          ik.reach
    observe: regions, edges, distances (10)      hybrid.observe
    chamfer sum (13) of drawn cylinders (12)     paper.chamfer           pipeline.raster_distance
    lambda of (14), the joints' ranges           hybrid.fit.refine_arms  pipeline.refine_arm
    downhill simplex, vmapped over both arms     solvers.simplex         SciPy's
    balance (5.3)                                hybrid.balance          balance.bow_on_feet
    report                                       hybrid.refine.report_of

From frame to frame nothing is remembered but the pose that algorithm 1 begins with. ``jaxmocap
track --paper`` and ``Settings.paper()`` take this way.

INPUTS: what ``solve`` found, distance fields of edges. OUTPUTS: the refined pose, a report.
"""

import jax.numpy as jnp
from jax import Array

from jaxmocap.body.arms import arms_of
from jaxmocap.body.kinematics import forward
from jaxmocap.body.model import Model
from jaxmocap.body.pose import Pose
from jaxmocap.evidence.edges import EdgeFields
from jaxmocap.hybrid.balance import bow_on_feet
from jaxmocap.hybrid.elbow_search import ElbowBelief
from jaxmocap.hybrid.fit import Aims, no_status
from jaxmocap.hybrid.ik import goals_of
from jaxmocap.hybrid.refine import Solved, StepReport, fit, report_of
from jaxmocap.hybrid.settings import Settings


def refine_frame(
    model: Model,
    settings: Settings,
    bow_factors: Array,
    solved: Solved,
    targets: Array,
    fields: EdgeFields | None,
    belief: ElbowBelief,
    elapsed: Array,
) -> tuple[ElbowBelief, Pose, StepReport]:
    """The markers' pose and the edges to the refined pose; arguments as of ``refine_event``.

    Each arm is fitted by itself, from the markers' pose, and holds its hand where the markers have
    it. Last the spine bows, and nothing else moves. The belief stays as it is.
    """
    del elapsed
    pose, status = solved.ik.pose, no_status()
    edges = None if settings.refine == "none" or model.cameras is None else fields
    if edges is not None:
        arms = arms_of(model.skeleton, forward(model.skeleton, pose), model.grips)
        goals = goals_of(model, settings.ik, solved.ik.feet, targets)
        aims = Aims(goals, arms.elbow, pose, None)
        pose, status = fit(model, settings, edges, pose, aims, arms.grip)
    balanced = jnp.zeros((), bool)
    if settings.balance:
        pose, _, balanced = bow_on_feet(model.skeleton, settings.ik, pose, bow_factors)
    report = report_of(model, settings, solved, targets, edges, pose)
    return belief, pose, report._replace(balanced=balanced, status=status)
