"""From a few posture channels to every bone's frame, in closed form.

Feet stay planted: legs are two-bone chains from the moving hips to standing ankles. Arms are
two-bone chains from the shoulder to a wrist, turned about that axis by a swivel of their own.
Unlike the tracker's model the trunk twists, the collarbones glide, and the wrist is not stiff.

INPUTS: a Skeleton and posture channels (T, C). OUTPUTS: BoneFrames over T instants, world, Z up.
"""

from dataclasses import dataclass, fields
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from jaxmocap.body.skeleton import LANDMARK_PLACES, Skeleton
from jaxmocap.body.subject import bone_vectors
from jaxmocap.synthetic.movements.splines import Channels, KeyPosture

# Shortest distance of the wrist from the shoulder, arm lengths: a folded arm would collide with
# itself.
NEAREST_REACH = 0.30
# The longest: a straight arm has no elbow plane.
FARTHEST_REACH = 0.975
# Rotation of the collarbone by an arm's length of reach, radians.
CLAVICLE_GLIDE = np.deg2rad(9.0)
ANKLE_HEIGHT = 0.039  # of the body height (Winter's Fig. 4.1)
FOOT_PITCH = np.deg2rad(17.0)
UPRIGHT = 0.985  # of the leg's length, hip over ankle: knees are not locked
HEAD_STEADINESS = 0.75  # how much of the trunk's turn the head undoes, to keep its eyes on the ball


@dataclass(frozen=True)
class Posture(KeyPosture):
    """One key posture. Lengths in metres, angles in degrees.

    Arms are mirrored: ``out`` is the body's own side for either.
    """

    pelvis: tuple[float, float, float] = (0.0, 0.0, 0.0)  # forward, left, up, from upright standing
    yaw: float = 0.0  # of the pelvis, to the left
    pitch: float = 0.0  # of the pelvis, forward
    flexion: float = 0.0  # of the spine, forward
    twist: float = 0.0  # of the spine, to the left
    bend: float = 0.0  # of the spine, to the right
    gaze: tuple[float, float] = (0.0, 0.0)  # yaw and pitch of the head on top of looking ahead
    # Forward, out, up from the shoulder, in arm lengths, in the chest's frame.
    reach_l: tuple[float, float, float] = (0.45, 0.10, -0.45)
    reach_r: tuple[float, float, float] = (0.45, 0.10, -0.45)  # likewise
    # Of the elbow about the line from shoulder to wrist; 0 behind a hanging arm and below a raised
    # one, positive outward and up.
    swivel_l: float = 40.0
    swivel_r: float = 40.0  # likewise
    wrist_l: tuple[float, float] = (0.0, 0.0)  # flexion and pronation of the hand on the forearm
    wrist_r: tuple[float, float] = (0.0, 0.0)  # likewise

    def channels(self) -> np.ndarray:
        """(22,) the attributes in their order, angles in radians."""
        metric = ("pelvis", "reach_l", "reach_r")
        parts = []
        for field in fields(self):
            value = np.atleast_1d(np.asarray(getattr(self, field.name), float))
            parts.append(value if field.name in metric else np.deg2rad(value))
        return np.concatenate(parts)


class BoneFrames(NamedTuple):
    """Frames of B bones over T instants: joints (T, B, 3), metres, and rotations (T, B, 3, 3)."""

    joints_world: np.ndarray
    R_world_bone: np.ndarray


@dataclass(frozen=True)
class Figure:
    """A person of given bones, standing at the world's origin and facing +x."""

    skeleton: Skeleton  # true lengths of this person
    height: float  # body height, metres
    ankles: dict[str, np.ndarray]  # side -> (3,) where the ankle stands, metres
    toes_out: float = 0.2  # how far the feet turn outward, radians

    @classmethod
    def standing(cls, skeleton: Skeleton, height: float, stance: float = 0.34) -> "Figure":
        """Feet ``stance`` metres apart, the right one a little behind."""
        up = ANKLE_HEIGHT * height
        ankles = {"l": (0.03, stance / 2, up), "r": (-0.03, -stance / 2, up)}
        return cls(skeleton, height, {side: np.array(at) for side, at in ankles.items()})

    @cached_property
    def reaches(self) -> np.ndarray:
        """(B, 3) from each bone's joint to its far end, in its own frame, metres."""
        return bone_vectors(self.skeleton)

    def reach(self, bone: str) -> np.ndarray:
        """(3,) the same of one bone."""
        return self.reaches[self.skeleton.tree.bone(bone)]

    def length(self, bone: str) -> float:
        """Length of a bone, metres."""
        return float(np.linalg.norm(self.reach(bone)))

    def place(self, channels: Channels) -> BoneFrames:
        """Frames of all bones.

        Raises:
            ValueError: the pelvis rises beyond what the legs reach with planted feet.
        """
        frames: dict[str, tuple[np.ndarray, np.ndarray]] = {}
        leg = self.length("femur_l") + self.length("tibia_l")
        upright = ANKLE_HEIGHT * self.height + UPRIGHT * leg
        root = channels.pelvis + np.array([0.0, 0.0, upright])
        R_pelvis = _turns("zy", channels.yaw, channels.pitch)
        self._trunk(frames, root, R_pelvis, channels)
        for side in "lr":
            self._leg(frames, root, R_pelvis, side)
            self._arm(frames, channels, side)
        placed = [frames[name] for name in self.skeleton.tree.bones]
        return BoneFrames(np.stack([p for p, _ in placed], 1), np.stack([R for _, R in placed], 1))

    def _trunk(self, frames: dict, at: np.ndarray, R: np.ndarray, channels: Channels) -> None:
        """Spine, neck and head, from the pelvis up."""
        for bone in ("spine1", "spine2", "spine3"):
            R = R @ _turns("zyx", channels.twist / 3, channels.flexion / 3, channels.bend / 3)
            frames[bone] = (at, R)
            at = at + R @ self.reach(bone)
        yaw = channels.gaze[:, 0] - HEAD_STEADINESS * (channels.yaw + channels.twist)
        pitch = channels.gaze[:, 1] - HEAD_STEADINESS * (channels.pitch + channels.flexion)
        for bone in ("neck", "head"):
            R = R @ _turns("zy", yaw / 2, pitch / 2)
            frames[bone] = (at, R)
            at = at + R @ self.reach(bone)

    def _leg(self, frames: dict, root: np.ndarray, R_pelvis: np.ndarray, side: str) -> None:
        """Hip, thigh, shank and foot of one side; the ankle stays where it stands."""
        hip, femur, tibia, foot = (f"{bone}_{side}" for bone in ("hip", "femur", "tibia", "foot"))
        frames[hip] = (root, R_pelvis)
        start = root + R_pelvis @ self.reach(hip)
        ankle = np.broadcast_to(self.ankles[side], start.shape)
        toes = np.array([self.toes_out if side == "l" else -self.toes_out])
        R_foot = _turns("zy", toes, np.array([FOOT_PITCH]))
        forward = np.broadcast_to(_turns("z", toes)[:, :, 0], start.shape)
        lengths = self.length(femur), self.length(tibia)
        if (np.linalg.norm(ankle - start, axis=-1) > 0.9995 * sum(lengths)).any():
            raise ValueError(
                "the pelvis is out of reach of the planted feet: lower the key posture"
            )
        knee = middle_joint(start, ankle, lengths, forward)
        frames[femur] = (start, _frame(start - knee, forward))
        frames[tibia] = (knee, _frame(knee - ankle, forward))
        frames[foot] = (ankle, np.broadcast_to(R_foot, (len(start), 3, 3)))

    def _arm(self, frames: dict, channels: Channels, side: str) -> None:
        """Collarbone, upper arm, forearm and hand of one side."""
        out = 1.0 if side == "l" else -1.0
        clavicle, humerus, radius = (f"{bone}_{side}" for bone in ("clavicle", "humerus", "radius"))
        reach, swivel, wrist = (
            getattr(channels, f"{name}_{side}") for name in ("reach", "swivel", "wrist")
        )
        chest, R_chest = frames["spine3"]
        neck = chest + R_chest @ self.reach("spine3")
        lengths = self.length(humerus), self.length(radius)
        target = reach * [1.0, out, 1.0] * sum(lengths)
        # The shoulder glides up and forward after the hand.
        lift = CLAVICLE_GLIDE * np.maximum(reach[:, 2] + 0.5, 0.0) * out
        protraction = -CLAVICLE_GLIDE * reach[:, 0] * out
        R_clavicle = R_chest @ _turns("zx", protraction, lift)
        shoulder = neck + (R_clavicle @ self.reach(clavicle))
        rest = neck + R_chest @ self.reach(clavicle)
        towards = rest + np.einsum("tij,tj->ti", R_chest, target) - shoulder
        axis, distance = _saturate_reach(towards, sum(lengths))
        side_chest = _elbow_side(np.einsum("tji,tj->ti", R_chest, axis), out * swivel)
        bend = np.einsum("tij,tj->ti", R_chest, side_chest)
        end = shoulder + distance * axis
        elbow = middle_joint(shoulder, end, lengths, bend)
        R_radius = _frame(elbow - end, -bend)
        frames[clavicle] = (neck, R_clavicle)
        frames[humerus] = (shoulder, _frame(shoulder - elbow, -bend))
        frames[radius] = (elbow, R_radius)
        frames[f"hand_{side}"] = (end, R_radius @ _turns("yz", -wrist[:, 0], -out * wrist[:, 1]))

    def points(
        self, bones: BoneFrames, bone: str, at: float, offset: tuple = (0, 0, 0)
    ) -> np.ndarray:
        """(T, 3) a point fixed to a bone, at a fraction of its length plus an offset, metres."""
        i = self.skeleton.tree.bone(bone)
        local = at * self.reach(bone) + np.asarray(offset, float)
        return bones.joints_world[:, i] + bones.R_world_bone[:, i] @ local

    def landmarks(self, bones: BoneFrames) -> dict[str, np.ndarray]:
        """Landmark name -> (T, 3) world, metres."""
        return {name: self.points(bones, *on) for name, on in LANDMARK_PLACES.items()}


def _turns(axes: str, *angles: np.ndarray) -> np.ndarray:
    """Product (T, 3, 3) of turns about the named axes, left to right."""
    return Rotation.from_euler(axes.upper(), np.stack(angles, -1)).as_matrix()


def unit(vectors: np.ndarray) -> np.ndarray:
    """Vectors (..., 3) of length 1."""
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def basis(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """(..., 3, 3) orthonormal columns: along ``first``, and across it towards ``second``."""
    x = unit(first)
    z = unit(np.cross(x, second))
    return np.stack([x, np.cross(z, x), z], -1)


def _frame(up: np.ndarray, ahead: np.ndarray) -> np.ndarray:
    """Frames (T, 3, 3) with z along ``up`` and x as near to ``ahead`` as can be."""
    return basis(up, ahead)[..., [1, 2, 0]]


def middle_joint(
    start: np.ndarray, end: np.ndarray, lengths: tuple[float, float], towards: np.ndarray
) -> np.ndarray:
    """The middle joint (T, 3) of a two-bone chain, bent ``towards`` a direction."""
    a, b = lengths
    axis = end - start
    d = np.linalg.norm(axis, axis=-1, keepdims=True)
    u = axis / d
    side = unit(towards - np.sum(towards * u, -1, keepdims=True) * u)
    along = (a * a - b * b + d * d) / (2 * d)
    return start + along * u + np.sqrt(np.maximum(a * a - along * along, 0.0)) * side


def _saturate_reach(vectors: np.ndarray, length: float) -> tuple[np.ndarray, np.ndarray]:
    """Directions, and lengths (T, 1) kept smoothly within what an arm of that length reaches."""
    d = np.linalg.norm(vectors, axis=-1, keepdims=True)
    near, far, softness = NEAREST_REACH * length, FARTHEST_REACH * length, 0.02 * length
    kept = far - softness * np.logaddexp(0.0, (far - d) / softness)
    return vectors / d, near + softness * np.logaddexp(0.0, (kept - near) / softness)


def _elbow_side(axis: np.ndarray, swivel: np.ndarray) -> np.ndarray:
    """Unit directions (T, 3) of the elbow from the arm's axis, chest frame.

    At swivel 0 it is what the shortest turn of a hanging arm (axis -z, elbow behind) gives: smooth
    for every direction but straight up.
    """
    hanging, behind = np.array([0.0, 0.0, -1.0]), np.array([-1.0, 0.0, 0.0])
    middle = axis + hanging
    share = (axis @ behind) / np.maximum(1 + axis @ hanging, 1e-3)
    side = behind - share[:, None] * middle
    return np.cos(swivel)[:, None] * side + np.sin(swivel)[:, None] * np.cross(axis, side)
