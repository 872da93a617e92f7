"""Poses as the Virtual Motion Capture protocol has them: one bundle a frame.

    /VMC/Ext/OK       loaded, calibrated, mode, whether there is anything to track by
    /VMC/Ext/T        seconds
    /VMC/Ext/Root/Pos where the model's root lies: at the world's origin
    /VMC/Ext/Bone/Pos for each bone its name in Unity, place and turn in its parent

INPUTS: a Skeleton; poses. OUTPUTS: datagrams.

Turns are against the T pose and in Unity's frame, as a VRM model's normalised bones have them; the
hips' place is that of the tracked person, metres.
"""

import numpy as np

from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.formats.animation.joint_names import CONVENTIONS
from jaxmocap.outputs.osc import Bundle
from jaxmocap.outputs.unity import Joints, UnityBody

# Loaded, calibrated, in the usual mode; the last says whether there is anything to track by.
_LOADED, _CALIBRATED, _MODE = 1, 3, 0
_NOTHING = [0.0] * 3 + [0.0, 0.0, 0.0, 1.0]


class VMC:
    """Makes bundles of one person's poses.

    Attributes:
        body: in Unity's frame.
        names: of the bones, as Unity calls them.
    """

    def __init__(self, skeleton: Skeleton):
        """Lay the bundles out."""
        self.body = UnityBody(skeleton)
        self.names = tuple(_in_unity(joint) for joint in self.body.joints)
        bones = [("/VMC/Ext/Bone/Pos", [name, *_NOTHING]) for name in self.names]
        self._tracked = Bundle(
            [
                ("/VMC/Ext/OK", [_LOADED, _CALIBRATED, _MODE, 1]),
                ("/VMC/Ext/T", [0.0]),
                ("/VMC/Ext/Root/Pos", ["root", *_NOTHING]),
                *bones,
            ]
        )
        lost = [_LOADED, _CALIBRATED, _MODE, 0]
        self._lost = Bundle([("/VMC/Ext/OK", lost), ("/VMC/Ext/T", [0.0])])

    def frame(self, time: float, pose: Pose) -> tuple[bytes, Joints]:
        """The bundle of a pose, and the pose's joints in their parents.

        Args:
            time: seconds since the run began.
            pose: of the person.
        """
        local = self.body.local(pose)
        bones = np.hstack([local.positions, local.quaternions])
        return self._tracked.filled(time, np.array(_NOTHING), bones), local

    def lost(self, time: float) -> bytes:
        """The bundle that says that nothing is tracked at the moment."""
        return self._lost.filled(time)


def _in_unity(joint: str) -> str:
    """Unity's name of a joint: VRM's with a capital."""
    name = CONVENTIONS["vrm"][joint]
    return name[0].upper() + name[1:]
