"""A rigged mesh that moves through key stances: its joints at any time.

The whole body moves, legs too, and whatever is lowest touches the floor. Planted hands stay where
they are and bend the elbows.

INPUTS: a rig, stances over time. OUTPUTS: an Exerciser: vertices and landmarks at any time.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from jaxmocap.synthetic.movements.splines import Channels, KeyStance, Spline
from jaxmocap.synthetic.people.figure import basis, middle_joint, unit
from jaxmocap.synthetic.people.rigged_mesh import RiggedMesh, rotation_between, rotation_onto
from jaxmocap.synthetic.people.shoulder_girdle import girdle_turn

# Joint -> how far below it the skin touches the floor, metres.
SKIN_DEPTHS_M = {
    **{f"{side}ToeBase": 0.027 for side in ("Left", "Right")},
    **{f"{side}Foot": 0.072 for side in ("Left", "Right")},
    **{f"{side}UpLeg": 0.095 for side in ("Left", "Right")},
    **{f"{side}Arm": 0.07 for side in ("Left", "Right")},
}
# Width of the smooth minimum over these heights, metres.
SOFT_MINIMUM_M = 0.01
# Angle between the foot and the horizontal at rest, radians.
FOOT_PITCH_RAD = np.deg2rad(17.0)
# Rotation from rest, facing -y, to facing +x.
R_FORWARD_REST = Rotation.from_euler("z", 90, degrees=True).as_matrix()


@dataclass(frozen=True)
class Exerciser(RiggedMesh):
    """A rigged mesh that moves through key stances."""

    curves: Spline  # channels of ``KeyStance`` over time
    # (2, 3) where left and right wrist are planted, world, metres; None: nowhere.
    hands: np.ndarray | None = None
    # Whether the shoulders go with raised arms, or stay on the chest.
    girdle: bool = False

    def rig(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Turns (T, J, 3, 3) from rest, and positions (T, J, 3), of the joints."""
        channels = self.curves(np.atleast_1d(times))
        return self.rig_at(channels, self.places(channels))

    def places(self, channels: np.ndarray) -> np.ndarray:
        """(T, 3) of the hips' middle by channels (T, 28), the lowest point as high as they say."""
        stance = KeyStance.split(channels)
        _, joints = self.chain_turns(self._joint_turns(stance), np.zeros((len(channels), 3)))
        soles = [joints[:, self.body.names.index(name), 2] - r for name, r in SKIN_DEPTHS_M.items()]
        # The skin's lowest point, smooth in time.
        lowest = -SOFT_MINIMUM_M * np.logaddexp.reduce(-np.array(soles) / SOFT_MINIMUM_M, 0)
        return np.append(stance.place, (stance.lift - lowest)[:, None], -1)

    def rig_at(self, channels: np.ndarray, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """``rig`` by channels (T, 28), the hips' middle at places (T, 3)."""
        turned = self._joint_turns(KeyStance.split(channels))
        R, joints = self.chain_turns(turned, np.zeros((len(channels), 3)))
        joints = joints + places[:, None]
        if self.hands is None:
            return R, joints
        for side, out, hand in (("Left", 1.0, self.hands[0]), ("Right", -1.0, self.hands[1])):
            shoulder = joints[:, self.body.names.index(side + "Arm")]
            turned |= self._plant_arm(turned["Hips"], shoulder, hand, side, out)
        return self.chain_turns(turned, places)

    def _joint_turns(self, stance: Channels) -> dict[str, np.ndarray]:
        """Joint -> its turn (T, 3, 3) from rest, where it differs from its parent's."""
        hips = Rotation.from_euler("ZYX", stance.turn, degrees=True).as_matrix()
        chest = hips @ Rotation.from_euler("YXZ", stance.back, degrees=True).as_matrix()
        head = chest @ Rotation.from_euler("Y", stance.neck[:, None], degrees=True).as_matrix()
        hips, chest, head = hips @ R_FORWARD_REST, chest @ R_FORWARD_REST, head @ R_FORWARD_REST
        turned = {
            **{"Hips": hips, "Spine1": chest, "Head": head},
            "LowerBack": rotation_between(hips, chest, 1 / 3),
            "Spine": rotation_between(hips, chest, 2 / 3),
            "Neck1": rotation_between(chest, head, 0.5),
        }
        for side, out in (("Left", 1.0), ("Right", -1.0)):
            turned |= self._leg(stance, turned["Hips"], side, out)
            turned |= self._arm(stance, turned["Spine1"], side, out)
        return turned

    def _arm(self, stance: Channels, chest: np.ndarray, side: str, out: float) -> dict:
        upper, elbow = np.split(getattr(stance, f"arm_{side[0].lower()}"), [3], 1)
        R = chest @ R_FORWARD_REST.T @ _ball(upper, out)
        straight, hinge = np.array([0.0, 0.0, -1.0]), np.array([0.0, -1.0, 0.0])
        lower = Rotation.from_euler("Y", -elbow, degrees=True).as_matrix() @ straight
        along = self._arm_along(side, R @ straight, np.einsum("tij,tj->ti", R, lower), R @ hinge)
        if not self.girdle:
            return along
        carried = girdle_turn(_ball(upper, out) @ straight, out)
        return along | {side + "Shoulder": chest @ R_FORWARD_REST.T @ carried @ R_FORWARD_REST}

    def _arm_along(
        self, side: str, upper: np.ndarray, lower: np.ndarray, hinge: np.ndarray
    ) -> dict[str, np.ndarray]:
        """Turns of an arm by the directions (T, 3) of its bones and of its elbow's axis."""
        shoulder, elbow, wrist = (self.at(side + joint) for joint in ("Arm", "ForeArm", "Hand"))
        rest = np.cross(elbow - shoulder, wrist - elbow)
        return {
            side + "Arm": rotation_onto(upper, hinge, elbow - shoulder, rest),
            side + "ForeArm": rotation_onto(lower, hinge, wrist - elbow, rest),
        }

    def _plant_arm(
        self, hips: np.ndarray, shoulder: np.ndarray, hand: np.ndarray, side: str, out: float
    ) -> dict[str, np.ndarray]:
        """Turns of an arm whose wrist stands at ``hand`` (3,), its elbow out and back."""
        joints = [self.at(side + joint) for joint in ("Arm", "ForeArm", "Hand")]
        upper_m, lower_m = (float(np.linalg.norm(b - a)) for a, b in pairwise(joints))
        left = hips[:, :, 0]
        ahead = unit(np.cross(left, [0.0, 0.0, 1.0]))
        wrist = np.broadcast_to(hand, shoulder.shape)
        elbow = middle_joint(shoulder, wrist, (upper_m, lower_m), out * left - 0.7 * ahead)
        upper, lower = elbow - shoulder, wrist - elbow
        turned = self._arm_along(side, upper, lower, np.cross(upper, lower))
        finger = self.at(side + "HandFinger1") - joints[2]
        down, rest_across = np.array([0.0, 0.0, -1.0]), np.cross(finger, [0.0, 0.0, 1.0])
        across = np.cross(ahead - 0.1 * out * left, down)
        return turned | {
            side + "Hand": basis(ahead - 0.1 * out * left, -across) @ basis(finger, rest_across).T
        }

    def _leg(self, stance: Channels, hips: np.ndarray, side: str, out: float) -> dict:
        thigh, knee, ankle = np.split(getattr(stance, f"leg_{side[0].lower()}"), [3, 4], 1)
        R = hips @ R_FORWARD_REST.T @ _ball(thigh, out)
        bent = R @ Rotation.from_euler("Y", knee, degrees=True).as_matrix()
        stretched = bent @ Rotation.from_euler("Y", ankle, degrees=True).as_matrix()
        down, left = np.array([0.0, 0.0, -1.0]), np.array([0.0, 1.0, 0.0])
        directions = {
            "UpLeg": ("Leg", R @ down),
            "Leg": ("Foot", bent @ down),
            "Foot": ("ToeBase", stretched @ [np.cos(FOOT_PITCH_RAD), 0.0, -np.sin(FOOT_PITCH_RAD)]),
        }
        rest_left = np.array([1.0, 0.0, 0.0])
        return {
            side + bone: rotation_onto(
                now, R @ left, self.at(side + end) - self.at(side + bone), rest_left
            )
            for bone, (end, now) in directions.items()
        }


def _ball(angles: np.ndarray, out: float) -> np.ndarray:
    """Turns (T, 3, 3) by flexion, abduction and rotation (T, 3), degrees, from hanging."""
    flexion, abduction, rotation = angles.T
    euler = np.stack([out * abduction, -flexion, -out * rotation], -1)
    return Rotation.from_euler("XYZ", euler, degrees=True).as_matrix()
