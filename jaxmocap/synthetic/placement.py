"""The camera's position: at any azimuth about the person.

The room turns with the camera: it lies behind the person as cluttered from every side, and never
between the two.

INPUTS: an azimuth, degrees from frontal, positive to the person's left.
OUTPUTS: the camera in the world; a mover in the room's frame.
"""

from dataclasses import dataclass

import numpy as np

from jaxmocap.geometry.cameras import Camera
from jaxmocap.synthetic.drawing_camera import look_at
from jaxmocap.synthetic.people.meshes import SkinnedMesh
from jaxmocap.synthetic.renderer import Mover

# From the person, metres: far enough for the whole of them, from shoes to a raised hand.
DISTANCE_M = 3.6
# Of the camera, metres.
HEIGHT_M = 1.30
# Of the point that it looks at, metres.
TARGET_HEIGHT_M = 1.0


def camera_at(azimuth: float) -> Camera:
    """A camera that looks at a person at the world's origin, who faces +x."""
    turn = np.deg2rad(azimuth)
    position = (DISTANCE_M * np.cos(turn), DISTANCE_M * np.sin(turn), HEIGHT_M)
    return look_at(position, (0.0, 0.0, TARGET_HEIGHT_M))


@dataclass(frozen=True)
class RotatedMover:
    """A mover rotated about the world's vertical, before a camera that stays in place.

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
        """(T, V, 3) metres; the camera at azimuth 0 sees them as the rotated one sees the mover."""
        return self.mover.vertices(times) @ self.turn.T

    @property
    def turn(self) -> np.ndarray:
        """(3, 3) from the world to the room before the camera at azimuth 0."""
        cosine, sine = np.cos(np.deg2rad(self.azimuth)), np.sin(np.deg2rad(self.azimuth))
        return np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])
