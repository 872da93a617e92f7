"""How a model is made of silhouettes: as the second paper has it (2.1), or as measured people need.

INPUTS: a name. OUTPUTS: a Reading; closed rings within a slice's four corners.

The paper puts an elbow half-way between the axis' corner and the rim (Fig. 3), and makes a slice of
the four points where its rays intersect: control points of a B-spline. It leaves the degree open:
the quadratic one is the only one that touches all four rays. Ours were fitted to two people whose
joints and girths were measured, on whom nothing is tested.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline

# Nodes of the trunk's rings.
RING_NODES = 48
# Control points of a superellipse's spline.
CONTROL_POINTS = 16


@dataclass(frozen=True)
class Reading:
    """Which places joints have on what a silhouette shows, and how full its slices are."""

    towards_rim: float  # an elbow's joint lies so far from the axis' corner towards the rim
    # The axis turns before the elbow, by this share of its way from shoulder to tip.
    elbow_beyond_corner: float
    # The wrist's joint lies so far beyond the thinnest place before the palm, by the same share.
    wrist_beyond_thinnest: float
    elbow_above: float  # a stretched arm's elbow above its axis, the hinge upright, by the stature
    # Slices are superellipses as full as people's there; otherwise B-splines of four control
    # points.
    as_full_as_people: bool


# The two people's elbows lay 0.37 and 0.14 towards the rim.
OWN = Reading(0.25, 0.007, 0.022, 0.0024, True)
PAPER = Reading(0.5, 0.0, 0.0, 0.0, False)
READINGS = {"own": OWN, "paper": PAPER}


def slice_ring(
    corners: np.ndarray, fullness: float, reading: Reading, nodes: int = RING_NODES
) -> np.ndarray:
    """(N, 2) a closed curve within a quadrilateral (4, 2), which it touches on all sides.

    From the middle of the front to the left; corners are front left, back left, back right, front
    right. ``fullness`` is that of people's slices there.
    """
    if reading.as_full_as_people:
        return superellipse_ring(corners, fullness, nodes)
    return spline_ring(corners, nodes)


def spline_ring(corners: np.ndarray, nodes: int = RING_NODES) -> np.ndarray:
    """(N, 2) the closed quadratic B-spline of four control points (4, 2), by De Boor's recursion.

    It touches the quadrilateral in its sides' middles, and is as full as a superellipse of power
    2.4.
    """
    spline = BSpline(np.arange(-2.0, 7), corners[[3, 0, 1, 2, 3, 0]], 2)
    return spline(4 * np.arange(nodes) / nodes)


def superellipse_ring(corners: np.ndarray, fullness: float, nodes: int = RING_NODES) -> np.ndarray:
    """(N, 2) a closed cubic B-spline about a superellipse within a quadrilateral (4, 2).

    ``fullness`` is 2 for an ellipse, more is boxier.
    """
    angle = 2 * np.pi * np.arange(CONTROL_POINTS) / CONTROL_POINTS
    c, s = np.cos(angle), np.sin(angle)
    u, v = (np.sign(t) * np.abs(t) ** (2 / fullness) for t in (c, s))
    u, v = (1 + u)[:, None] / 2, (1 + v)[:, None] / 2
    front_left, back_left, back_right, front_right = corners
    places = v * (u * front_left + (1 - u) * back_left)
    places = places + (1 - v) * (u * front_right + (1 - u) * back_right)
    closed = np.concatenate([places, places[:1]])
    spline = make_interp_spline(
        np.linspace(0, 1, CONTROL_POINTS + 1), closed, k=3, bc_type="periodic"
    )
    return spline(np.arange(nodes) / nodes)
