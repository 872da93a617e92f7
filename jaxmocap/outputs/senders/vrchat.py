"""Poses as VRChat's trackers: hip, chest, feet, elbows, knees; the head aligns the worlds.

    /tracking/trackers/1/position  metres         /tracking/trackers/1/rotation  degrees
    ... up to 8, and "head"

INPUTS: ``[vrchat]`` of a live file; joints in Unity's frame. OUTPUTS: datagrams.
"""

from dataclasses import dataclass

import numpy as np

from jaxmocap.formats.armatures.joint_names import PELVIS
from jaxmocap.formats.files.addresses import Address, read_address
from jaxmocap.formats.files.errors import short_repr
from jaxmocap.formats.files.toml import TomlTable
from jaxmocap.outputs.senders.osc import UNSTATED, Bundle, Sender, SenderTable
from jaxmocap.outputs.senders.unity import Joints, UnityBody, euler_degrees

DEFAULT_SEND = Address(port=9000)
# What VRChat takes trackers of -> joint of its position, joint of its rotation: those at elbow and
# knee sit above it. By the head it finds where our world lies in its own.
TRACKED = {
    "hip": (PELVIS, PELVIS),
    "chest": ("spine3", "spine3"),
    **{f"foot_{s}": (f"foot_{s}", f"foot_{s}") for s in "lr"},
    **{f"elbow_{s}": (f"radius_{s}", f"humerus_{s}") for s in "lr"},
    **{f"knee_{s}": (f"tibia_{s}", f"femur_{s}") for s in "lr"},
    "head": ("head", "head"),
}
# Feet and hips determine the knees well enough.
DEFAULT_TRACKED = tuple(name for name in TRACKED if not name.startswith("knee"))


class Trackers(Sender):
    """Makes bundles of one person's trackers."""

    def __init__(self, table: "VrchatTable", body: UnityBody):
        """Build the bundle, its trackers numbered in the table's order."""
        self._body, trackers = body, table.trackers
        joint_pairs = [TRACKED[name] for name in trackers]
        self._position_joints, self._rotation_joints = (
            [body.joints.index(joint) for joint in joints]
            for joints in zip(*joint_pairs, strict=True)
        )
        numbers = iter(range(1, len(trackers) + 1))
        names = [name if name == "head" else str(next(numbers)) for name in trackers]
        self._bundle = Bundle(
            [
                (f"/tracking/trackers/{name}/{kind}", [0.0] * 3)
                for name in names
                for kind in ("position", "rotation")
            ]
        )

    def frame(self, time: float, local: Joints, deviations: np.ndarray = UNSTATED) -> list[bytes]:
        """The bundle of a pose's joints in their parents; VRChat takes no deviations."""
        world = self._body.in_world(local)
        degrees = euler_degrees(world.quaternions[self._rotation_joints])
        return [self._bundle.fill(np.hstack([world.positions[self._position_joints], degrees]))]


@dataclass(frozen=True)
class VrchatTable(SenderTable):
    """``[vrchat]``: which of ``TRACKED`` are sent, each once."""

    send: Address = DEFAULT_SEND
    trackers: tuple[str, ...] = DEFAULT_TRACKED
    kind, title, keys = Trackers, "VRChat", ("send", "trackers")

    @classmethod
    def read(cls, fields: TomlTable) -> "VrchatTable":
        """Read it."""
        send = read_address(fields, "send", cls.send)
        chosen = fields.entries.get("trackers", list(DEFAULT_TRACKED))
        is_valid = isinstance(chosen, list) and all(name in list(TRACKED) for name in chosen)
        if not is_valid or not 0 < len(chosen) == len(set(chosen)):
            expected = f"a list of some of {', '.join(TRACKED)}, each once"
            raise fields.error("trackers", f"found {short_repr(chosen)}, expected {expected}")
        return cls(send, tuple(chosen))
