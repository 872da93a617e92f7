"""The benchmark's rivals work on the same problem, and solve it."""

from importlib.util import find_spec

import numpy as np
import pytest

from bench import rival_ik, rivals
from bench.figures import failures, read_baseline
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
    monkeypatch.setattr(rivals, "POSES", 16)
    absent = {name for name in ("pinocchio",) if find_spec(name) is None}
    names = [metric.name for metric in rivals.kinematics(True, absent)]
    assert "kinematics_mujoco_over_ours" in names
    assert ("kinematics_pinocchio_over_ours" in names) == (not absent)
    monkeypatch.setattr(rivals, "SAME_M", 1e-12)
    with pytest.raises(RuntimeError, match="m from ours"):
        list(rivals.kinematics(True, absent))


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
    monkeypatch.setattr(rivals, "simplex", lambda quick: iter(()))
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


def test_our_simplex_and_scipys_find_the_same_minima():
    fields, grips = rivals.scene()
    ours = rivals.ours(fields, grips)()
    theirs = rivals.by_scipy(fields, grips)()
    for field, grip, a, b in zip(fields, grips, ours, theirs, strict=True):
        costs = [rivals.arm_cost(np, field, grip, np.asarray(h, float)) for h in (a, b)]
        assert costs[0] == pytest.approx(costs[1], abs=0.05)
