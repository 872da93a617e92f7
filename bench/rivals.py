"""What users would take instead, side by side: kinematics, inverse kinematics, simplex.

MuJoCo, mink, pink and Pinocchio come with ``pip install ".[bench]"``; who is missing is left out.

INPUTS: none. OUTPUTS: Metrics; names of who is missing.
"""

import sys
from collections.abc import Iterator
from importlib.util import find_spec

from bench import rival_simplex
from bench.metrics import Metric

# Module -> what of the benchmark needs it.
OPTIONAL = {"mujoco": "kinematics and IK", "mink": "IK", "pink": "IK", "pinocchio": "kinematics"}


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
    yield from rival_simplex.measure(quick)
    if "mujoco" not in without:
        from bench import rival_ik, rival_kinematics

        yield from rival_kinematics.measure(quick, set(without))
        yield from rival_ik.measure(quick, set(without))
