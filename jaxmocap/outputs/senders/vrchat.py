"""Poses as VRChat's trackers: hip, chest, feet, elbows, knees; the head aligns the worlds.

    /tracking/trackers/1/position  metres         /tracking/trackers/1/rotation  degrees
    ... up to 8, and "head"

INPUTS: joints in Unity's frame. OUTPUTS: datagrams.
"""

from collections.abc import Sequence

import numpy as np

from jaxmocap.formats.armatures.joint_names import PELVIS
from jaxmocap.outputs.senders.osc import Bundle
from jaxmocap.outputs.senders.unity import Joints, UnityBody, euler_degrees

# Tracker -> joint of its position, joint of its rotation: those at elbow and knee sit above it.
_TRACKER_JOINTS = {
    "hip": (PELVIS, PELVIS),
    "chest": ("spine3", "spine3"),
    "head": ("head", "head"),
    **{f"foot_{s}": (f"foot_{s}", f"foot_{s}") for s in "lr"},
    **{f"elbow_{s}": (f"radius_{s}", f"humerus_{s}") for s in "lr"},
    **{f"knee_{s}": (f"tibia_{s}", f"femur_{s}") for s in "lr"},
}


class Trackers:
    """Makes bundles of one person's trackers."""

    def __init__(self, body: UnityBody, trackers: Sequence[str]):
        """Build the bundle.

        Args:
            body: of the person.
            trackers: names out of ``formats.live.TRACKED``; numbered in this order.
        """
        self._body = body
        joint_pairs = [_TRACKER_JOINTS[name] for name in trackers]
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

    def frame(self, local: Joints) -> bytes:
        """The bundle of a pose's joints in their parents."""
        world = self._body.in_world(local)
        degrees = euler_degrees(world.quaternions[self._rotation_joints])
        return self._bundle.filled(np.hstack([world.positions[self._position_joints], degrees]))
