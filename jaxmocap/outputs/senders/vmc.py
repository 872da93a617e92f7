"""Poses as the Virtual Motion Capture protocol has them: one or two bundles a frame.

    /VMC/Ext/Bone/Pos for each bone its name in Unity, position and rotation in its parent
    /VMC/Ext/Root/Pos where the model's root lies: at the world's origin
    /VMC/Ext/OK       loaded, calibrated, mode, whether the person is tracked
    /VMC/Ext/T        seconds; the last of a frame

The last bundle has all but the bones, as VirtualMotionCapture sends them; see
https://protocol.vmc.info/english.

INPUTS: a Skeleton; poses. OUTPUTS: datagrams.

Rotations are from the T pose, in Unity's frame, as a VRM model's normalised bones have them; the
hips' position is that of the tracked person, metres.
"""

import numpy as np

from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.formats.armatures.joint_names import CONVENTIONS
from jaxmocap.outputs.senders.osc import Bundle
from jaxmocap.outputs.senders.unity import Joints, UnityBody

# Values of /VMC/Ext/OK: the model is loaded.
_LOADED = 1
# It is calibrated.
_CALIBRATED = 3
# In the normal mode.
_MODE = 0
# Bones in one bundle: more would not fit into 1200 bytes, and networks cut longer datagrams up.
BONES_IN_BUNDLE = 13
# No translation, no rotation (xyzw).
_IDENTITY = [0.0] * 3 + [0.0, 0.0, 0.0, 1.0]


class VMC:
    """Makes bundles of one person's poses.

    Attributes:
        body: in Unity's frame.
        names: of the bones, as Unity calls them.
    """

    def __init__(self, skeleton: Skeleton):
        """Build the bundles."""
        self.body = UnityBody(skeleton)
        self.names = tuple(_in_unity(joint) for joint in self.body.joints)
        bones = [("/VMC/Ext/Bone/Pos", [name, *_IDENTITY]) for name in self.names]
        self._starts = range(0, len(bones), BONES_IN_BUNDLE)
        status = [
            ("/VMC/Ext/Root/Pos", ["root", *_IDENTITY]),
            ("/VMC/Ext/OK", [_LOADED, _CALIBRATED, _MODE, 1]),
            ("/VMC/Ext/T", [0.0]),
        ]
        self._tracked = [
            Bundle(bones[start : start + BONES_IN_BUNDLE] + status * (start == self._starts[-1]))
            for start in self._starts
        ]
        lost = [_LOADED, _CALIBRATED, _MODE, 0]
        self._lost = Bundle([("/VMC/Ext/OK", lost), ("/VMC/Ext/T", [0.0])])

    def frame(self, time: float, pose: Pose) -> tuple[list[bytes], Joints]:
        """The bundles of a pose, and the pose's joints in their parents.

        Args:
            time: seconds since the run began.
            pose: of the person.
        """
        local = self.body.local(pose)
        bones = np.hstack([local.positions, local.quaternions])
        parts: list[list] = [[bones[start : start + BONES_IN_BUNDLE]] for start in self._starts]
        parts[-1] += [np.array(_IDENTITY), time]
        datagrams = [
            bundle.filled(*part) for bundle, part in zip(self._tracked, parts, strict=True)
        ]
        return datagrams, local

    def lost(self, time: float) -> bytes:
        """The bundle for a moment at which nobody is tracked."""
        return self._lost.filled(time)


def _in_unity(joint: str) -> str:
    """Unity's name of a joint: VRM's with a capital."""
    name = CONVENTIONS["vrm"][joint]
    return name[0].upper() + name[1:]
