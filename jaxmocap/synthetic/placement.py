"""Where the camera stands: at any azimuth about the person.

The room turns with the camera: it lies behind the person as cluttered from every side, and never
between the two.

INPUTS: an azimuth, degrees from frontal, positive to the person's left.
OUTPUTS: the camera in the world; a mover as the room sees it.
"""

from dataclasses import dataclass

import numpy as np

from jaxmocap.geometry.cameras import Camera
from jaxmocap.synthetic.drawing_camera import look_at
from jaxmocap.synthetic.people.meshes import SkinnedMesh
from jaxmocap.synthetic.renderer import Mover

# Far enough for the whole person, from shoes to a raised hand, wherever the arms point.
DISTANCE_M, HEIGHT_M, TARGET_M = 3.6, 1.30, 1.0


def camera_at(azimuth: float) -> Camera:
    """A camera that looks at a person at the world's origin, who faces +x."""
    turn = np.deg2rad(azimuth)
    position = (DISTANCE_M * np.cos(turn), DISTANCE_M * np.sin(turn), HEIGHT_M)
    return look_at(position, (0.0, 0.0, TARGET_M))


@dataclass(frozen=True)
class RotatedMover:
    """A mover turned about the world's vertical, as it stands before a camera that stays.

    Attributes:
        mover: who moves.
        azimuth: of the camera about the mover, degrees.
    """

    mover: Mover
    azimuth: float

    @property
    def mesh(self) -> SkinnedMesh:
        """At rest."""
        return self.mover.mesh

    def vertices(self, times: np.ndarray) -> np.ndarray:
        """(T, V, 3) where the camera at azimuth 0 sees what the turned one sees, metres."""
        return self.mover.vertices(times) @ self.turn.T

    @property
    def turn(self) -> np.ndarray:
        """(3, 3) from the world to the room before the camera at azimuth 0."""
        cosine, sine = np.cos(np.deg2rad(self.azimuth)), np.sin(np.deg2rad(self.azimuth))
        return np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])
