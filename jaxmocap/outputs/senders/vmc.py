"""Poses as the Virtual Motion Capture protocol has them: one or two bundles a frame.

    /VMC/Ext/Bone/Pos for each bone its name in Unity, position and rotation in its parent
    /jaxmocap/Elbows  standard deviations of left and right elbow, metres; receivers ignore it
    /VMC/Ext/Root/Pos where the model's root lies: at the world's origin
    /VMC/Ext/OK       loaded, calibrated, mode, whether the person is tracked
    /VMC/Ext/T        seconds; the last of a frame

The last bundle has all but the bones, as VirtualMotionCapture sends them; see
https://protocol.vmc.info/english.

INPUTS: ``[vmc]`` of a live file; poses in Unity's frame. OUTPUTS: datagrams.

Rotations are from the T pose, in Unity's frame, as a VRM model's normalised bones have them; the
hips' position is that of the tracked person, metres.
"""

from dataclasses import dataclass

import numpy as np

from jaxmocap.formats.armatures.joint_names import CONVENTIONS
from jaxmocap.formats.files.addresses import Address
from jaxmocap.outputs.senders.osc import UNSTATED, Bundle, Sender, SenderTable
from jaxmocap.outputs.senders.unity import Joints, UnityBody

# The port of its receivers.
DEFAULT_SEND = Address(port=39539)
# First values of /VMC/Ext/OK: the model is loaded, it is calibrated, the mode is the normal one.
_READY = [1, 3, 0]
# How sure the elbows are; -1 where nothing states it.
ELBOWS_ADDRESS = "/jaxmocap/Elbows"
# Bones in one bundle: more would not fit into 1200 bytes, and networks cut longer datagrams up.
BONES_IN_BUNDLE = 13
# No translation, no rotation (xyzw).
_IDENTITY = [0.0] * 3 + [0.0, 0.0, 0.0, 1.0]


class VMC(Sender):
    """Makes bundles of one person's poses."""

    def __init__(self, table: "VmcTable", body: UnityBody):
        """Build the bundles."""
        # Unity's names are VRM's with a capital.
        names = [CONVENTIONS["vrm"][joint] for joint in body.joints]
        places = [[name[0].upper() + name[1:], *_IDENTITY] for name in names]
        bones = [("/VMC/Ext/Bone/Pos", place) for place in places]
        self._starts = range(0, len(bones), BONES_IN_BUNDLE)
        status = [
            (ELBOWS_ADDRESS, [0.0, 0.0]),
            ("/VMC/Ext/Root/Pos", ["root", *_IDENTITY]),
            ("/VMC/Ext/OK", [*_READY, 1]),
            ("/VMC/Ext/T", [0.0]),
        ]
        self._tracked = [
            Bundle(bones[start : start + BONES_IN_BUNDLE] + status * (start == self._starts[-1]))
            for start in self._starts
        ]
        self._lost = Bundle([("/VMC/Ext/OK", [*_READY, 0]), ("/VMC/Ext/T", [0.0])])

    def frame(self, time: float, local: Joints, deviations: np.ndarray = UNSTATED) -> list[bytes]:
        """The bundles of a pose; elbows whose deviations nothing states have -1."""
        bones = np.hstack([local.positions, local.quaternions])
        parts: list[list] = [[bones[start : start + BONES_IN_BUNDLE]] for start in self._starts]
        stated = np.where(np.isfinite(deviations), deviations, -1.0)
        parts[-1] += [stated, np.array(_IDENTITY), time]
        return [bundle.fill(*part) for bundle, part in zip(self._tracked, parts, strict=True)]

    def lost_messages(self, time: float) -> list[bytes]:
        """The bundle for a moment at which nobody is tracked."""
        return [self._lost.fill(time)]


@dataclass(frozen=True)
class VmcTable(SenderTable):
    """``[vmc]``."""

    send: Address = DEFAULT_SEND
    kind, title, is_default = VMC, "VMC", True
