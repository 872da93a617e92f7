"""Forward kinematics of OpenSim's full-body model, by its own joints and nothing of ours."""

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

_JOINTS = tomllib.loads((Path(__file__).parent / "rajagopal2016.toml").read_text())["joint"]


def coordinates() -> set[str]:
    """The model's coordinates, but for the patellae's."""
    return {a["coordinate"] for j in _JOINTS for a in (*j.get("turn", ()), *j.get("shift", ()))}


def body_frames(values: dict[str, float], scales: dict[str, Any]) -> dict[str, tuple]:
    """Body -> its rotation (3, 3) and origin (3,) in the ground, metres.

    Args:
        values: coordinate -> radians or metres.
        scales: body -> a factor, or three along its axes; 1 where missing.
    """
    frames = {"ground": (np.eye(3), np.zeros(3))}
    for joint in _JOINTS:
        R, p = frames[joint["parent"]]
        parent_scale = np.ones(3) * scales.get(joint["parent"], 1.0)
        child_scale = np.ones(3) * scales.get(joint["child"], 1.0)
        R_parent, p_parent = _frame(joint["in_parent"], parent_scale)
        R_child, p_child = _frame(joint["in_child"], child_scale)
        turn, shift = np.eye(3), np.zeros(3)
        for axis in joint.get("turn", ()):
            angle = _value(axis, values)
            turn = turn @ Rotation.from_rotvec(angle * _unit(axis["axis"])).as_matrix()
        for axis in joint.get("shift", ()):
            shift += _value(axis, values) * np.array(axis["axis"], float)
        # Shifts grow with the parent's body, but the ground's do not.
        R_body = R @ R_parent @ turn @ R_child.T
        origin = p + R @ (p_parent + parent_scale * (R_parent @ shift))
        frames[joint["child"]] = R_body, origin - R_body @ p_child
    return frames


def _frame(numbers: list[float], scale: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return Rotation.from_euler("XYZ", numbers[3:]).as_matrix(), scale * numbers[:3]


def _unit(axis: list[float]) -> np.ndarray:
    return np.array(axis, float) / np.linalg.norm(axis)


def _value(axis: dict[str, Any], values: dict[str, float]) -> float:
    value = values[axis["coordinate"]]
    if "factor" in axis:
        return axis["factor"] * value
    x, y = np.array(axis["spline"]).T
    spline, within = CubicSpline(x, y), np.clip(value, x[0], x[-1])
    return float(spline(within) + spline(within, 1) * (value - within))
