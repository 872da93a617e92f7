"""The four photographs of a person from which a model is made, before a plain backdrop.

The person stands with arms slightly lifted for the front view; holds the upper arms level and the
forearms up for the joint view; and spreads the arms, thumbs up, for the arms' side view and for the
side view, in which they then hide nothing of the trunk. Two cameras, far away and nearly at right
angles, saw them.

INPUTS: a rig, a photograph's name, a seed.
OUTPUTS: images (H, W, 3), BGR uint8; their cameras; who stood there; four ``.png`` and a
``calibration.toml`` with a section for each photograph.
"""

from pathlib import Path

import cv2
import numpy as np

from jaxmocap.formats.cameras.calibration import write_calibration
from jaxmocap.formats.files.writing import write_bytes
from jaxmocap.geometry.cameras import Camera
from jaxmocap.synthetic.drawing_camera import look_around
from jaxmocap.synthetic.movements.exerciser import Exerciser
from jaxmocap.synthetic.movements.splines import KeyStance, Spline
from jaxmocap.synthetic.people.rigged_mesh import Rig
from jaxmocap.synthetic.renderer import RotatedMover, Scene, Sensor, exposure

_LEG = (0.0, 7.0, -4.0, 0.0, 0.0)
# Arms of the stances, as in ``KeyStance``, degrees.
_LIFTED = (-3.0, 36.0, 0.0, 6.0)
_BENT = (0.0, 84.0, -90.0, 80.0)
_SPREAD = (0.0, 88.0, 0.0, 6.0)
# Photograph -> left and right arm of the stance, and the camera's azimuth, degrees.
PHOTOGRAPHS: dict[str, tuple[tuple[float, float, float, float], float]] = {
    "front": (_LIFTED, 3.0),
    "side": (_SPREAD, 88.0),
    "joint": (_BENT, 3.0),
    "arm_side": (_SPREAD, 3.0),
}
# Width and height, pixels.
SIZE = (960, 720)
# From the camera to the person, metres.
DISTANCE_M = 8.0
# Height of the camera's target, a share of the stature.
TARGET_SHARE = 0.75
# Share of the stature that fits into the image's height.
VISIBLE_SHARE = 0.84
BACKDROP_BGR = np.array([118.0, 146.0, 92.0])
# By this share the backdrop is darker at its sides.
SHADING = 0.16
# Standard deviation of its grain, grey levels.
GRAIN = 1.5
# Of its slow waves, grey levels.
WAVES = 2.5


def rest_height(rig: Rig) -> float:
    """Height of a person at rest, metres."""
    return float(np.ptp(rig.mesh.vertices[:, 2]))


def person_in_stance(rig: Rig, photograph: str) -> Exerciser:
    """A person as they stand for a photograph: facing +x, hips above the origin."""
    arm, _ = PHOTOGRAPHS[photograph]
    stance = KeyStance(back=(0.0, 0.0, 0.0), arm_l=arm, arm_r=arm, leg_l=_LEG, leg_r=_LEG)
    times = np.linspace(-1.0, 1.0, 5)
    return Exerciser(rig, Spline(times, np.tile(stance.channels(), (5, 1))))


def camera_of(rig: Rig, photograph: str) -> Camera:
    """The camera that took a photograph of a person."""
    return _camera(rest_height(rig), PHOTOGRAPHS[photograph][1])


def _camera(height: float, azimuth: float) -> Camera:
    """At an azimuth about the origin, degrees."""
    focal = SIZE[1] * DISTANCE_M / (VISIBLE_SHARE * height)
    how = {"size": SIZE, "focal": focal, "distortion": (-0.05, 0.02, 0.0003, -0.0002)}
    target = (0.0, 0.0, TARGET_SHARE * height)
    return look_around(azimuth, DISTANCE_M, 0.8 * height, target, **how)


def photograph(rig: Rig, name: str, seed: int):
    """One photograph (H, W, 3), BGR uint8, of a person: front, side, joint or arm_side."""
    rng = np.random.default_rng([seed, list(PHOTOGRAPHS).index(name)])
    background = backdrop(rng)
    # The backdrop stands behind the person as the camera sees it.
    turned = RotatedMover(person_in_stance(rig, name), PHOTOGRAPHS[name][1])
    camera = _camera(rest_height(rig), 0.0)
    scene = Scene(camera, background, turned)
    return Sensor.create(SIZE, rng).expose(exposure(scene, 0.0))


def backdrop(rng: np.random.Generator) -> np.ndarray:
    """(H, W, 3) uint8, a sheet of one colour, lit unevenly, hanging in slight waves."""
    width, height = SIZE
    x, y = np.meshgrid(np.linspace(-1, 1, width), np.linspace(-1, 1, height))
    shade = 1 - SHADING * (0.7 * x**2 + 0.3 * (y - 0.2) ** 2)
    waves = sum(
        np.cos(rng.uniform(2, 9) * x + rng.uniform(-1, 1) * y + rng.uniform(0, 2 * np.pi))
        for _ in range(4)
    )
    sheet = (BACKDROP_BGR + WAVES * np.asarray(waves)[..., None] / 2) * shade[..., None]
    return np.clip(sheet + GRAIN * rng.standard_normal(sheet.shape), 0, 255).astype(np.uint8)


def write_photographs(directory: str | Path, rig: Rig, seed: int = 0) -> Path:
    """Write a person's four photographs and their calibration; the path of ``calibration.toml``."""
    directory = Path(directory)
    directory.mkdir(parents=True, exist_ok=True)
    for name in PHOTOGRAPHS:
        content = cv2.imencode(".png", photograph(rig, name, seed))[1].tobytes()
        write_bytes(directory / f"{name}.png", content)
    cameras = {name: camera_of(rig, name) for name in PHOTOGRAPHS}
    write_calibration(directory / "calibration.toml", cameras)
    return directory / "calibration.toml"
