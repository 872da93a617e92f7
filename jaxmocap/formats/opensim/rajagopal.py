"""The joints of OpenSim's full-body model, and how its two-segment limbs bend.

A. Rajagopal, C. L. Dembia, M. S. DeMers, D. D. Delp, J. L. Hicks and S. L. Delp, "Full-body
musculoskeletal model for muscle-driven simulation of human gait", IEEE Trans. Biomed. Eng. 63
(2016) 2068-2079; the numbers are those of its file, ``Rajagopal2016.osim`` (MIT licence).

INPUTS: none. OUTPUTS: places and axes in the model's own bodies (metres; x forward, y up along the
segment, z to the right); for arm and leg the bend between its two segments by the hinge's
coordinate. All of it is of the right side: the left one is its mirror image.

The model's elbow axis is oblique, and its knee turns and shifts the shank while it bends. Where
the middle joint of a limb is, is then a choice, and here it is one that lets the limb be straight
and the far segment keep its length:

- the elbow: the point of the elbow's axis at which shoulder, elbow and wrist can be in one line;
- the knee: a point on the line from hip to ankle of the straight leg.
"""

from functools import cache
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

# In the pelvis, whose origin lies between the front spines of the hip bones.
HIP = np.array([-0.056276, -0.07849, 0.07726])
# In the thigh: where the shank's joint frame begins, and how it is turned.
_KNEE_IN_FEMUR = np.array([-0.00809, -0.40796, -0.00275])
_KNEE_IN_TIBIA = np.array([-0.00808954, -0.0035348, -0.00148474])
_KNEE_TURN = (-1.64157, 1.44618, 1.5708)
_ANKLE_IN_TIBIA = np.array([-0.01, -0.4, 0.0])
_KNEE_ANGLES = (
    *(0, 0.174533, 0.349066, 0.523599, 0.698132, 0.872665, 1.0472),
    *(1.22173, 1.39626, 1.5708, 1.74533, 1.91986, 2.0944),
)
# What comes with bending: turns about the joint's third and second axis, shifts along them.
_KNEE_TURNS_3 = (
    *(0, 0.0126809, 0.0226969, 0.0296054, 0.0332049, 0.0335354, 0.0308779),
    *(0.0257548, 0.0189295, 0.011407, 0.00443314, -0.00050475, -0.0016782),
)
_KNEE_TURNS_2 = (
    *(0, 0.059461, 0.109399, 0.150618, 0.18392, 0.210107, 0.229983),
    *(0.24435, 0.254012, 0.25977, 0.262428, 0.262788, 0.261654),
)
_KNEE_SHIFTS_2 = (
    *(0, 0.000479, 0.000835, 0.001086, 0.001251, 0.001346, 0.001391),
    *(0.001403, 0.0014, 0.0014, 0.001421, 0.001481, 0.001599),
)
_KNEE_SHIFTS_3 = (
    *(0, 0.000988, 0.001899, 0.002734, 0.003492, 0.004173, 0.004777),
    *(0.005305, 0.005756, 0.00613, 0.006427, 0.006648, 0.006792),
)
# The knee on the line from hip to ankle: the share at which the shank's length changes least.
_KNEE_SHARE = 0.5072
_ANKLE_TURN, _SUBTALAR_TURN = (0.175895, -0.105208, 0.0186622), (-1.76819, 0.906223, 1.8196)
_ELBOW_IN_HUMERUS = np.array([0.013144, -0.286273, -0.009595])
_ELBOW_TURN, _PRO_SUP_TURN = (-0.0228627, 0.228018, 0.0051689), (-1.56884, 0.056428, 1.53614)
_RADIUS_IN_ULNA = np.array([-0.006727, -0.013007, 0.026083])
_WRIST_IN_RADIUS = np.array([-0.008797, -0.235841, 0.01361])
# Thumbs forward with the arms hanging, as our bodies have them; 0 is supinated.
THUMB_FORWARD = np.pi / 2
# Beyond what people bend, so that no table ends too early.
_LEAST_ANGLE, _MOST_ANGLE, _STEP = np.radians([-30.0, 175.0, 0.25])
# Nearer to straight than this, radians, the plane of bending is taken from either side.
_ALMOST_STRAIGHT = 0.03


def _axis(turn: tuple[float, float, float]) -> np.ndarray:
    """The z axis (3,) of a joint's frame, in its body."""
    return Rotation.from_euler("XYZ", turn).as_matrix()[:, 2]


ELBOW_AXIS, PRO_SUP_AXIS = _axis(_ELBOW_TURN), _axis(_PRO_SUP_TURN)
ANKLE_AXIS, SUBTALAR_AXIS = _axis(_ANKLE_TURN), _axis(_SUBTALAR_TURN)


class Limb(NamedTuple):
    """A limb of two segments, over K values of the coordinate between them."""

    near: np.ndarray  # (3,) unit vector along the near segment, in its body
    length: float  # of that segment in the unscaled model, metres
    angles: np.ndarray  # (K,) of the coordinate, radians, ascending
    bends: np.ndarray  # (K,) between the two segments' lines, radians, ascending; 0 is straight
    normals: np.ndarray  # (K, 3) unit axes about which the far segment is bent, in the near body

    def bend_at(self, bends: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The coordinate (T,) and the axis (T, 3) at (T,) bends, radians."""
        normals = np.stack([np.interp(bends, self.bends, axis) for axis in self.normals.T], -1)
        return np.interp(bends, self.bends, self.angles), normals


def _limb(middle: np.ndarray, ends: np.ndarray, angles: np.ndarray, axis: np.ndarray) -> Limb:
    """A limb by its middle joint (3,), its far end (K, 3) at each angle, roughly about an axis."""
    length = float(np.linalg.norm(middle))
    near = middle / length
    across, along = np.cross(near, ends - middle), (ends - middle) @ near
    signs = np.where(across @ axis < 0, -1.0, 1.0)
    size = np.linalg.norm(across, axis=-1)
    bends, normals = signs * np.arctan2(size, along), signs[:, None] * across / size[:, None]
    clear = np.abs(bends) > _ALMOST_STRAIGHT
    normals = np.stack([np.interp(angles, angles[clear], each[clear]) for each in normals.T], -1)
    return Limb(near, length, angles, bends, normals)


def _angles() -> np.ndarray:
    # Half a step aside, so that none is exactly straight.
    return np.arange(_LEAST_ANGLE + _STEP / 2, _MOST_ANGLE, _STEP)


@cache
def leg() -> Limb:
    """Thigh and shank by ``knee_angle``."""
    angles = _angles()
    ends = _ankles(angles)
    return _limb(_KNEE_SHARE * _ankles(np.zeros(1))[0], ends, angles, np.array([0, 0, -1.0]))


def _ankles(angles: np.ndarray) -> np.ndarray:
    """The ankle (K, 3) in the thigh by ``knee_angle``; straight on beyond the model's range."""
    tables = _KNEE_TURNS_3, _KNEE_TURNS_2, _KNEE_SHIFTS_2, _KNEE_SHIFTS_3
    spline = CubicSpline(_KNEE_ANGLES, tables, axis=1)
    within = np.clip(angles, _KNEE_ANGLES[0], _KNEE_ANGLES[-1])
    turn_3, turn_2, shift_2, shift_3 = spline(within) + spline(within, 1) * (angles - within)
    joint = Rotation.from_euler("XYZ", _KNEE_TURN)
    turn = joint * Rotation.from_euler("XZY", np.stack([angles, turn_3, turn_2], -1)) * joint.inv()
    shifts = joint.apply(np.stack([np.zeros(len(angles)), shift_2, shift_3], -1))
    return _KNEE_IN_FEMUR + shifts + turn.apply(_ANKLE_IN_TIBIA - _KNEE_IN_TIBIA)


@cache
def arm() -> Limb:
    """Upper arm and forearm by ``elbow_flex``, thumbs as the body has them."""
    pronated = Rotation.from_rotvec(THUMB_FORWARD * PRO_SUP_AXIS)
    wrist = _RADIUS_IN_ULNA + pronated.apply(_WRIST_IN_RADIUS)

    def kink(slide: float) -> float:
        """By how much the two segments differ in their slope to the axis."""
        near, far = _ELBOW_IN_HUMERUS + slide * ELBOW_AXIS, wrist - slide * ELBOW_AXIS
        return near @ ELBOW_AXIS / np.linalg.norm(near) - far @ ELBOW_AXIS / np.linalg.norm(far)

    slide = brentq(kink, -0.05, 0.05) * ELBOW_AXIS
    angles = _angles()
    far = Rotation.from_rotvec(angles[:, None] * ELBOW_AXIS).apply(wrist - slide)
    middle = _ELBOW_IN_HUMERUS + slide
    return _limb(middle, middle + far, angles, np.array([0, 0, 1.0]))
