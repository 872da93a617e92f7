"""The benchmark's rivals work on the same problem, and solve it."""

from importlib.util import find_spec

import jax.numpy as jnp
import numpy as np
import pytest

from bench import growth, rival_ik, rival_kinematics, rival_simplex, rivals
from bench.gate import failures, read_baseline
from bench.rival_bodies import PinocchioBody
from jaxmocap.body.kinematics import forward
from jaxmocap.body.pose import Pose
from jaxmocap.hybrid.settings import IKSettings

STEPS = 12
needs = {
    name: pytest.mark.skipif(
        find_spec(name) is None, reason=f'{name} is not installed: pip install ".[bench]" brings it'
    )
    for name in ("mink", "pink", "pinocchio")
}


def test_everybodys_joints_are_where_ours_are(monkeypatch):
    """The measurement itself raises where they differ."""
    monkeypatch.setattr(rival_kinematics, "POSES", 16)
    absent = {name for name in ("pinocchio",) if find_spec(name) is None}
    names = [metric.name for metric in rival_kinematics.measure(True, absent)]
    assert "kinematics_mujoco_over_ours" in names
    assert ("kinematics_pinocchio_over_ours" in names) == (not absent)
    monkeypatch.setattr(rival_kinematics, "SAME_M", 1e-12)
    with pytest.raises(RuntimeError, match="m from ours"):
        list(rival_kinematics.measure(True, absent))


@needs["pinocchio"]
def test_pinocchio_minds_our_limits_in_our_order(skeleton):
    body = PinocchioBody.of(skeleton)
    limits = np.asarray(skeleton.limits, float)
    lower, upper = body.model.lowerPositionLimit, body.model.upperPositionLimit
    np.testing.assert_allclose(lower[body.positions], limits[:, 0])
    np.testing.assert_allclose(upper[body.positions], limits[:, 1])


def test_targets_move_and_can_all_be_reached(skeleton):
    start, targets = rival_ik.motion(skeleton, STEPS)
    assert targets.shape == (STEPS, len(rival_ik.REACHING), 3)
    apart = np.linalg.norm(np.diff(targets, axis=0), axis=-1)
    assert 0.002 < apart.max() < 0.1
    rows = [skeleton.tree.bone(name) for name in rival_ik.REACHING]
    there = np.asarray(forward(skeleton, start).joints_world)[rows]
    assert np.linalg.norm(there - targets[0], axis=-1).max() < 0.05


WAYS = {
    "ours": lambda *given: rival_ik.ours(*given, IKSettings()),
    "MuJoCo and NumPy": lambda *given: rival_ik.damped_steps(*given),
    "SciPy": lambda *given: rival_ik.by_scipy(*given, limits=False),
    "SciPy, limits": lambda *given: rival_ik.by_scipy(*given, limits=True),
    "mink": lambda *given: rival_ik.by_mink(*given, limits=False),
    "mink, limits": lambda *given: rival_ik.by_mink(*given, limits=True),
    "pink": lambda *given: rival_ik.by_pink(*given, limits=False),
    "pink, limits": lambda *given: rival_ik.by_pink(*given, limits=True),
}


@pytest.mark.parametrize(
    "way", [pytest.param(w, marks=needs.get(w.split(",")[0], ())) for w in WAYS]
)
def test_everybody_follows_the_same_targets_within_a_millimetre(skeleton, way):
    start, targets = rival_ik.motion(skeleton, STEPS)
    follow = WAYS[way](skeleton, start)
    for goal in targets:
        missed = np.linalg.norm(follow(goal) - goal, axis=-1).max()
        assert missed < 1.05 * rival_ik.TOLERANCE_M


def test_who_is_missing_is_said_and_left_out(monkeypatch, capsys):
    monkeypatch.setattr(rivals, "find_spec", lambda name: None)
    monkeypatch.setattr(rivals.rival_simplex, "measure", lambda quick: iter(()))
    absent = rivals.missing()
    assert absent == list(rivals.OPTIONAL)
    lines = capsys.readouterr().err.splitlines()
    assert lines[1] == "mink is not installed: left out of IK"
    assert list(rivals.measure(True, absent)) == []
    committed = [m for m in read_baseline("quick") if m.name.startswith(("ik_", "kinematics_"))]
    assert committed and failures([], committed, rivals.unmeasured(absent)) == []
    others = [m for m in committed if "mink" not in m.name]
    assert len(failures([], committed, rivals.unmeasured(["mink"]))) == len(others)
    assert len(others) < len(committed)


# The simplex -------------------------------------------------------------------------------------


def test_the_cost_is_the_same_in_numpy_and_jax_and_least_at_the_truth():
    fields, grips = rival_simplex.scene()
    for field, grip, truth, start in zip(
        fields, grips, rival_simplex.TRUTH, rival_simplex.START, strict=True
    ):
        there, away = (rival_simplex.arm_cost(np, field, grip, h) for h in (truth, start))
        assert there < 1 < 5 < away
        ours = rival_simplex.arm_cost(jnp, field, grip, jnp.asarray(start, jnp.float32))
        assert float(ours) == pytest.approx(away, rel=1e-3)


def test_our_simplex_and_scipys_find_the_same_minima():
    fields, grips = rival_simplex.scene()
    ours = rival_simplex.ours(fields, grips)()
    theirs = rival_simplex.by_scipy(fields, grips)()
    for field, grip, a, b in zip(fields, grips, ours, theirs, strict=True):
        costs = [rival_simplex.arm_cost(np, field, grip, np.asarray(h, float)) for h in (a, b)]
        assert costs[0] == pytest.approx(costs[1], abs=0.05)


# Growth ------------------------------------------------------------------------------------------


def test_a_chain_has_so_many_hinges_in_a_row():
    skeleton = growth.chain(10)
    still = Pose(jnp.zeros(3), jnp.eye(4)[0], jnp.zeros(10))
    joints = np.asarray(forward(skeleton, still).joints_world)
    np.testing.assert_allclose(joints[:, 2], 0.1 * np.arange(10), atol=1e-6)


def test_growth_by_hinges_measures_every_length(monkeypatch):
    monkeypatch.setattr(growth, "HINGES", (3, 6))
    monkeypatch.setattr(growth, "ROUNDS", 2)
    actual = list(growth.by_hinges())
    assert [m.name for m in actual] == [f"growth: IK step, hinges {n}" for n in (3, 6)]
    assert all(metric.value > 0 for metric in actual)
