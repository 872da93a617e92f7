"""What programs that receive VMC make of it: bones on an avatar of its own, and worlds aligned.

Written from what these publish, none of whose text is here; no program was run:

- EVMC4U 5.0a, ``ExternalReceiver.cs`` at 02c81e8 (github.com/gpsnmeajp/
  EasyVirtualMotionCaptureForUnity, MIT): the root's local pose, each bone's local rotation and, as
  an option, local position, by the name of Unity's HumanBodyBones; what types of arguments it asks;
- SlimeVR's server, ``vmc/input-decoder.kt`` at 2243e15 (MIT or Apache 2.0): the same in a
  right-handed frame with z backwards, accumulated from the hips;
- VRChat's page on OSC trackers (docs.vrchat.com/docs/osc-trackers).
"""

from typing import NamedTuple

import numpy as np
from pythonosc.osc_packet import OscPacket
from scipy.spatial.transform import Rotation

# A VRM's bones as they hang on one another: hips first, every parent before its children.
PARENTS = {
    "Hips": None,
    **dict(Spine="Hips", Chest="Spine", UpperChest="Chest", Neck="UpperChest", Head="Neck"),
    **{
        f"{side}{bone}": parent if parent in ("UpperChest", "Hips") else f"{side}{parent}"
        for side in ("Left", "Right")
        for bone, parent in (
            *(("Shoulder", "UpperChest"), ("UpperArm", "Shoulder"), ("LowerArm", "UpperArm")),
            *(("Hand", "LowerArm"), ("UpperLeg", "Hips"), ("LowerLeg", "UpperLeg")),
            ("Foot", "LowerLeg"),
        )
    },
}
# Where a bone points in the T pose, Unity's frame: x right, y up, z ahead.
_UP, _DOWN, _RIGHT = np.array([[0.0, 1, 0], [0, -1, 0], [1, 0, 0]])
DIRECTIONS = {
    **dict.fromkeys(("Spine", "Chest", "UpperChest", "Neck", "Head"), _UP),
    **{
        f"{side}{bone}": sign * _RIGHT
        for side, sign in (("Left", -1), ("Right", 1))
        for bone in ("UpperArm", "LowerArm", "Hand")
    },
    **{f"{s}{bone}": _DOWN for s in ("Left", "Right") for bone in ("UpperLeg", "LowerLeg")},
}
# Unity's left-handed frame and SlimeVR's right-handed one.
_MIRROR_Z = np.array([1.0, 1.0, -1.0])


class Avatar(NamedTuple):
    """What a receiver shows: positions and rotations in the world of every bone."""

    positions: dict[str, np.ndarray]
    rotations: dict[str, Rotation]


class Frame(NamedTuple):
    """One frame: root and bones, each position and quaternion xyzw; status; seconds."""

    root: tuple[np.ndarray, np.ndarray]
    bones: dict[str, tuple[np.ndarray, np.ndarray]]
    status: list[int]
    seconds: float


def received(datagrams: list[bytes]) -> Frame:
    """A frame's datagrams, by the checks of EVMC4U: number and types of arguments."""
    root, bones, status, seconds = None, {}, [], np.nan
    for message in (timed.message for one in datagrams for timed in OscPacket(one).messages):
        values = message.params
        if message.address == "/VMC/Ext/OK":
            assert len(values) >= 3 and all(type(value) is int for value in values)
            status = values
        elif message.address == "/VMC/Ext/T":
            assert type(values[0]) is float
            seconds = values[0]
        elif message.address in ("/VMC/Ext/Root/Pos", "/VMC/Ext/Bone/Pos"):
            name, *numbers = values
            assert type(name) is str and [type(value) for value in numbers] == [float] * 7
            pose = np.array(numbers[:3]), np.array(numbers[3:])
            if message.address == "/VMC/Ext/Root/Pos":
                root = pose
            else:
                bones[name] = pose
    assert root is not None
    return Frame(root, bones, status, seconds)


def on_avatar(frame: Frame, offsets: dict[str, np.ndarray] | None) -> Avatar:
    """In Unity's frame: with an avatar's own offsets, or None for the bones' positions as sent.

    The hips' position is the one that was sent in either case.
    """
    root_position, root_quaternion = frame.root
    positions, rotations = {}, {}
    for bone, parent in PARENTS.items():
        place, quaternion = frame.bones[bone]
        above = Rotation.from_quat(root_quaternion) if parent is None else rotations[parent]
        base = root_position if parent is None else positions[parent]
        offset = place if offsets is None or parent is None else offsets[bone]
        positions[bone] = base + above.apply(offset)
        rotations[bone] = above * Rotation.from_quat(quaternion)
    return Avatar(positions, rotations)


def as_slimevr(frame: Frame) -> Avatar:
    """As SlimeVR's server takes bones in, in its own frame: x right, y up, z backwards."""

    def taken(pose) -> tuple[np.ndarray, np.ndarray]:
        (x, y, z), (qx, qy, qz, qw) = pose
        return np.array([x, y, -z]), np.array([qx, qy, -qz, -qw])

    bones = {name: taken(pose) for name, pose in frame.bones.items()}
    return on_avatar(Frame(taken(frame.root), bones, frame.status, frame.seconds), None)


def mirrored(points: np.ndarray) -> np.ndarray:
    """Points of Unity's frame in SlimeVR's, and back."""
    return points * _MIRROR_Z


def vrchat_aligned(datagram: bytes, head_position: np.ndarray, heading: Rotation):
    """Trackers' positions and rotations where VRChat puts them, by number.

    VRChat turns the sender's world about the vertical and moves it, so that ``head/position`` is at
    the root of the avatar's head and ``head/rotation`` has its heading.
    """
    values = {t.message.address: np.array(t.message.params) for t in OscPacket(datagram).messages}
    own = values["/tracking/trackers/head/position"]
    ahead = euler(values["/tracking/trackers/head/rotation"]).apply([0.0, 0.0, 1.0])
    yaw = Rotation.from_rotvec([0.0, np.arctan2(ahead[0], ahead[2]), 0.0])
    turn = heading * yaw.inv()
    trackers = {}
    for number in range(1, 9):
        if (address := f"/tracking/trackers/{number}") + "/position" in values:
            place = head_position + turn.apply(values[f"{address}/position"] - own)
            trackers[number] = place, turn * euler(values[f"{address}/rotation"])
    return trackers


def euler(degrees: np.ndarray) -> Rotation:
    """Unity's Euler angles: about z, then x, then y, of fixed axes."""
    return Rotation.from_euler("zxy", degrees[[2, 0, 1]], degrees=True)
