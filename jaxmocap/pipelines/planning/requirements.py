"""What a plan is for, and what it must keep to: joints, walls, lenses.

INPUTS: options. OUTPUTS: landmarks, bounds, cameras; InputError where there is nothing to plan.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jaxmocap.body.skeleton import LANDMARKS
from jaxmocap.calibration.fitting.camera_plan import placement
from jaxmocap.calibration.fitting.camera_plan.placement import Bounds, CameraPlace
from jaxmocap.formats.files.errors import InputError
from jaxmocap.geometry.cameras import Camera, camera_of_fov
from jaxmocap.geometry.lenses import FISHEYE

# Of a usual camera, pixels; its field of view along the longer side, degrees.
SIZE, FOV_DEG = (640, 480), 60.0


@dataclass(frozen=True)
class Requirements:
    """What a plan is for, and what it must keep to."""

    joints: tuple[str, ...] = ("elbows",)  # landmarks, or pairs of them in the plural: elbows
    cameras: int = 2  # to be placed, one after the other
    # How far a camera may stand ahead, behind, to the left, to the right, metres.
    free_m: tuple[float, ...] = (3.0, 3.0, 3.0, 3.0)
    # The lowest and the highest place of a camera above the floor, metres.
    heights_m: tuple[float, ...] = (0.4, 2.2)
    # Fields of view along the image's longer side, from and to, degrees; None is that of the
    # recording's first camera, or a usual one.
    fov_deg: tuple[float, ...] | None = None
    rate: float = 30.0  # frames a second

    def landmarks(self) -> tuple[str, ...]:
        """Of the joints.

        Raises:
            InputError: there is no such joint.
        """
        found: list[str] = []
        for name in self.joints:
            pair = tuple(f"{name.removesuffix('s')}_{side}" for side in "lr")
            if name in LANDMARKS:
                found.append(name)
            elif name.endswith("s") and set(pair) <= set(LANDMARKS):
                found += pair
            else:
                valid = "elbows, wrists, shoulders, hips, knees, ankles or one of "
                raise InputError(
                    "--joints", f"found {name!r}, expected {valid}{', '.join(LANDMARKS)}"
                )
        return tuple(dict.fromkeys(found))

    def bounds(self) -> Bounds:
        """Of a camera's place.

        Raises:
            InputError: there is no room.
        """
        ahead, behind, left, right = self.free_m
        low, high = self.heights_m
        if min(self.free_m) < 0:
            raise InputError("--room", f"found {min(self.free_m):g}, expected distances from 0 on")
        if not 0 <= low <= high:
            raise InputError("--heights", f"found {low:g} and {high:g}, expected the lower first")
        if max(np.hypot(a, b) for a in (ahead, behind) for b in (left, right)) < (
            least := placement.NEAREST_M
        ):
            raise InputError("--room", f"leaves no place {least:g} m from the person")
        # Over half a turn to either side, so that no seam lies where somebody stands.
        turn, steep = 2 * np.pi, placement.STEEPEST
        return Bounds(
            CameraPlace(-behind, -right, low, -turn, -steep, 0.0),
            CameraPlace(ahead, left, high, turn, steep, 0.0),
        )

    def lens(self, cameras: Sequence[Camera]) -> tuple[Camera, float]:
        """A camera with the widest lens, and by how much it zooms in (natural logarithm).

        Where none was asked for it is that of the first camera that stands already.

        Raises:
            InputError: no camera has that field of view.
        """
        if self.fov_deg is None:
            return (cameras[0] if cameras else camera_of_fov(SIZE, FOV_DEG)), 0.0
        width, height = map(float, cameras[0].size) if cameras else SIZE
        try:
            lenses = [camera_of_fov((width, height), fov) for fov in sorted(self.fov_deg)]
        except ValueError as error:
            raise InputError("--fov", str(error)) from None
        # The narrower field of view is the longer focal length.
        zoom = np.log(float(lenses[0].matrix[0, 0] / lenses[-1].matrix[0, 0]))
        return lenses[-1], float(zoom)


def fov_deg(camera: Camera, across: bool = False) -> float:
    """Field of view along the longer side, or from left to right, without distortion."""
    width, height = map(float, np.asarray(camera.size))
    half = (width if across else max(width, height)) / 2 / float(camera.matrix[0, 0])
    return float(np.degrees(2 * (half if camera.lens == FISHEYE else np.arctan(half))))
