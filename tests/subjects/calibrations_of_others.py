"""Calibrations as other systems write them, each by that system's own maths; nothing of ours.

A writer takes cameras whose place in our world (metres, Z up) is known, writes the system's file,
and returns it with the system's own projection of world points to pixels.
"""

import pickle
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

SIZE = (1920, 1080)
FOCAL, CENTRE = np.array([1500.25, 1498.5]), np.array([970.5, 531.25])
MATRIX = np.array([[FOCAL[0], 0, CENTRE[0]], [0, FOCAL[1], CENTRE[1]], [0, 0, 1]])
# k1 k2 p1 p2 k3
LENS = np.array([-0.12, 0.08, 0.0011, -0.0007, -0.02])
VICON_CENTRE = CENTRE + np.array([3.5, -2.25])
VICON_RADIAL = (3.1e-8, 2.2e-15, 1.5e-21)


@dataclass(frozen=True)
class Place:
    """Where a camera stands in our world: OpenCV's rotation and translation, metres."""

    R: np.ndarray
    t: np.ndarray

    @property
    def position(self) -> np.ndarray:
        return -self.R.T @ self.t

    def in_world(self, R_other_world: np.ndarray, per_metre: float) -> "Place":
        """The same camera in a world of other axes and another unit."""
        return Place(self.R @ R_other_world.T, self.t * per_metre)


Projection = Callable[[Place, np.ndarray], np.ndarray]
Made = tuple[Path, Projection]

# Rows: the other world's axes in ours. OptiTrack's up is y: ours is (z, x, y) of it.
R_Y_UP = np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]])
# A board on end whose y points down: ours is (-x, -z, -y) of it.
R_BOARD = np.array([[-1.0, 0, 0], [0, 0, -1], [0, -1, 0]])


def place(seed: int) -> Place:
    """A camera some metres from the origin that looks at its surroundings."""
    rng = np.random.default_rng(seed)
    R = Rotation.from_rotvec(rng.normal(0, 1, 3)).as_matrix()
    return Place(R, rng.normal(0, 0.3, 3) + np.array([0, 0, 4]))


def points_before(camera: Place, seed: int, count: int = 60) -> np.ndarray:
    """World points (N, 3) that the picture shows."""
    rng = np.random.default_rng(seed)
    plane = rng.uniform([-0.6, -0.33], [0.6, 0.33], (count, 2))
    depth = rng.uniform(2, 6, (count, 1))
    return (np.concatenate([plane, np.ones((count, 1))], 1) * depth - camera.t) @ camera.R


def brown(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Brown's distortion (N, 2) by the five coefficients."""
    k1, k2, p1, p2, k3 = LENS
    r2 = x**2 + y**2
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    across = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2)
    down = y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y
    return np.stack([across, down], -1)


def looking_back(camera: Place, points: np.ndarray) -> np.ndarray:
    """Pixels by a frame whose axes are right, up and back, as Qualisys and OpenGL have it."""
    axes = np.stack([camera.R[0], -camera.R[1], -camera.R[2]])
    right, up, back = ((points - camera.position) @ axis for axis in axes)
    return brown(right / -back, -up / -back) * FOCAL + CENTRE


def by_opencv(camera: Place, points: np.ndarray) -> np.ndarray:
    """Pixels by OpenCV."""
    vector = cv2.Rodrigues(camera.R)[0]
    return cv2.projectPoints(points, vector, camera.t, MATRIX, LENS)[0].reshape(-1, 2)


def numbers(values) -> str:
    return " ".join(f"{float(value):.17g}" for value in np.ravel(values))


def attributes(**values) -> str:
    return " ".join(f'{name}="{float(value):.17g}"' for name, value in values.items())


def qualisys(folder: Path, cameras: dict[str, Place], left: int = 40, top: int = 8) -> Made:
    """1/64 pixels of a sensor of 2048 x 1152, of which the video shows a part; millimetres."""
    text = ""
    for name, camera in cameras.items():
        axes = np.stack([camera.R[0], -camera.R[1], -camera.R[2]])
        rows = {f"r{i + 1}{j + 1}": axes[i, j] for i in range(3) for j in range(3)}
        place = attributes(**dict(zip("xyz", camera.position * 1000, strict=True)), **rows)
        fov = attributes(left=left, top=top, right=left + SIZE[0] - 1, bottom=top + SIZE[1] - 1)
        sub = attributes(
            focallength=9.2, sensorMinU=0, sensorMaxU=2048 * 64 - 1, sensorMinV=0,
            sensorMaxV=1152 * 64 - 1, focalLengthU=FOCAL[0] * 64, focalLengthV=FOCAL[1] * 64,
            centerPointU=(CENTRE[0] + left) * 64, centerPointV=(CENTRE[1] + top) * 64, skew=0,
            radialDistortion1=LENS[0], radialDistortion2=LENS[1], radialDistortion3=LENS[4],
            tangentalDistortion1=LENS[2], tangentalDistortion2=LENS[3])  # fmt: skip
        text += f"""
    <camera active="1" calibrated="true" serial="{name}" model="Miqus Video" viewrotation="0">
      <fov_marker {fov}/> <fov_video {fov}/>
      <transform {place}/>
      <intrinsic {sub}/>
    </camera>"""
    path = folder / "lab.qca.txt"
    path.write_text(
        f'<calibration type="regular">\n  <cameras>{text}\n  </cameras>\n</calibration>'
    )
    return path, looking_back


def vicon_project(camera: Place, points: np.ndarray) -> np.ndarray:
    """Pixels whose correction by Vicon's polynomial gives the ideal ones: solved for each."""
    x, y, z = camera.R @ (points - camera.position).T
    offsets = np.stack([x / z, y / z], -1) * FOCAL[0] + CENTRE - VICON_CENTRE
    k1, k2, k3 = VICON_RADIAL
    ideal = np.linalg.norm(offsets, axis=1)

    def beyond(raw: float, goal: float) -> float:
        return raw * (1 + k1 * raw**2 + k2 * raw**4 + k3 * raw**6) - goal

    raw = [brentq(beyond, 0, goal, args=(goal,), xtol=1e-12) for goal in ideal]
    return VICON_CENTRE + offsets * (np.array(raw) / ideal)[:, None]


def vicon(folder: Path, cameras: dict[str, Place]) -> Made:
    """Millimetres; a quaternion with its real part last; an optical camera beside the others."""
    text = ""
    for name, camera in cameras.items():
        quaternion = numbers(Rotation.from_matrix(camera.R).as_quat())
        radial = f"Vicon3Parameter {numbers(VICON_CENTRE)} {numbers(VICON_RADIAL)}"
        text += f"""
  <Camera DEVICEID="{name}" DISPLAY_TYPE="Vue" NAME="" PIXEL_ASPECT_RATIO="1"
    SENSOR_SIZE="{SIZE[0]} {SIZE[1]}" SKEW="0" TYPE="Vue_VIDEO" USERID="1">
    <KeyFrames>
      <KeyFrame FOCAL_LENGTH="{FOCAL[0]}" FRAME="0" IMAGE_ERROR="0.2" ORIENTATION="{quaternion}"
        POSITION="{numbers(camera.position * 1000)}" PRINCIPAL_POINT="{numbers(CENTRE)}"
        VICON_RADIAL2="{radial}" WORLD_ERROR="0.3"/>
    </KeyFrames>
  </Camera>"""
    optical = '<Camera DEVICEID="77" SENSOR_SIZE="4096 4096" TYPE="Vantage16"><KeyFrames/></Camera>'
    path = folder / "lab.xcp"
    path.write_text(f'<Cameras NAME="" VERSION="1.0">{text}\n  {optical}\n</Cameras>')
    return path, vicon_project


def motive(folder: Path, cameras: dict[str, Place]) -> Made:
    """Metres, Y up, UTF-16; the matrix leads from a right, up, back frame to the world."""
    text = ""
    for name, camera in cameras.items():
        there = camera.in_world(R_Y_UP, 1)
        axes = np.stack([there.R[0], -there.R[1], -there.R[2]], 1)
        place = dict(zip("XYZ", there.position, strict=True))
        matrix = {f"OrientMatrix{i}": value for i, value in enumerate(axes.ravel())}
        lens = attributes(
            LensCenterX=CENTRE[0], LensCenterY=CENTRE[1], HorizontalFocalLength=FOCAL[0],
            VerticalFocalLength=FOCAL[1], k1=LENS[0], k2=LENS[1], k3=LENS[4],
            TangentialX=LENS[2], TangentialY=LENS[3])  # fmt: skip
        text += f"""
      <Camera Serial="{name}">
        <Properties CameraID="6"/>
        <Attributes ImagerPixelWidth="{SIZE[0]}" ImagerPixelHeight="{SIZE[1]}"/>
        <Intrinsic LensCenterX="1" LensCenterY="2" HorizontalFocalLength="3"/>
        <IntrinsicStandardCameraModel {lens}/>
        <Extrinsic {attributes(**place, **matrix)}/>
      </Camera>"""
    path = folder / "lab.mcal"
    content = f"""<?xml version="1.0" encoding="UTF-16LE"?>
<calibrationProfile version="1">
  <Calibration>
    <Cameras Count="{len(cameras)}">{text}
    </Cameras>
  </Calibration>
</calibrationProfile>"""
    path.write_bytes(b"\xff\xfe" + content.encode("utf-16-le"))
    return path, looking_back


def opencap_table(camera: Place) -> dict:
    there = camera.in_world(R_BOARD, 1000)
    return {
        "distortion": LENS[None].copy(), "intrinsicMat": MATRIX.copy(),
        "imageSize": np.array([[SIZE[1]], [SIZE[0]]]), "rotation": there.R,
        "translation": there.t[:, None], "rotation_EulerAngles": cv2.Rodrigues(there.R)[0],
    }  # fmt: skip


def opencap(folder: Path, cameras: dict[str, Place]) -> Made:
    """Millimetres; a folder for each camera; pickled by every protocol in turn."""
    for number, (name, camera) in enumerate(cameras.items()):
        inside = folder / "session" / "Videos" / name
        inside.mkdir(parents=True)
        content = pickle.dumps(opencap_table(camera), protocol=2 + number % 4)
        (inside / "cameraIntrinsicsExtrinsics.pickle").write_bytes(content)
    return folder / "session", by_opencv


def easymocap(folder: Path, cameras: dict[str, Place]) -> Made:
    """Written by OpenCV's own FileStorage, without the pictures' size."""
    files = [cv2.FileStorage(str(folder / name), cv2.FILE_STORAGE_WRITE)
             for name in ("intri.yml", "extri.yml")]  # fmt: skip
    for file in files:
        file.startWriteStruct("names", cv2.FILE_NODE_SEQ)
        for name in cameras:
            file.write("", name)
        file.endWriteStruct()
    for name, camera in cameras.items():
        files[0].write(f"K_{name}", MATRIX)
        files[0].write(f"dist_{name}", LENS[None])
        files[1].write(f"R_{name}", cv2.Rodrigues(camera.R)[0])
        files[1].write(f"Rot_{name}", camera.R)
        files[1].write(f"T_{name}", camera.t[:, None])
    for file in files:
        file.release()
    return folder / "intri.yml", by_opencv


def section(header: str, camera: Place, *more: str, as_matrix: bool = False) -> str:
    rotation = camera.R.tolist() if as_matrix else cv2.Rodrigues(camera.R)[0].ravel().tolist()
    lines = [f"[{header}]", f"size = [ {SIZE[0]}, {SIZE[1]},]", f"matrix = {MATRIX.tolist()}",
             f"distortions = {LENS.tolist()}", f"rotation = {rotation}",
             f"translation = {camera.t.tolist()}", *more]  # fmt: skip
    return "\n".join(lines) + "\n\n"


def caliscope(folder: Path, cameras: dict[str, Place]) -> Made:
    """camera_array.toml, as of version 0.11: cameras by their numbers; metres."""
    path = folder / "camera_array.toml"
    text = "".join(
        section(f"cameras.{name.removeprefix('cam_')}", camera, "rotation_count = 0",
                "error = 0.19", "grid_count = 24", "fisheye = false")
        for name, camera in cameras.items())  # fmt: skip
    path.write_text(text)
    return path, by_opencv


def old_caliscope(folder: Path, cameras: dict[str, Place]) -> Made:
    """config.toml before that: rotations as matrices; a camera that is ignored."""
    path = folder / "config.toml"
    text = "CreationDate = 2023-05-06T11:12:27.631355\nfps_recording = 24\n\n"
    for name, camera in cameras.items():
        more = ("port = 0", "rotation_count = 0", "grid_count = 24", "ignore = false")
        text += section(name, camera, *more, as_matrix=True)
    text += section("cam_9", place(9), "port = 9", "ignore = true", as_matrix=True)
    path.write_text(text + '[charuco]\ncolumns = 4\nunits = "inch"\n')
    return path, by_opencv


def freemocap(folder: Path, cameras: dict[str, Place], on_ground: bool = True) -> Made:
    """Millimetres, with the camera's own place beside anipose's fields."""
    path, text = folder / "sesh_camera_calibration.toml", ""
    for name, camera in cameras.items():
        there = camera.in_world(np.eye(3), 1000)
        own = (f"world_orientation = {there.R.T.tolist()}",
               f"world_position = {there.position.tolist()}", f'name = "sesh_{name}"')  # fmt: skip
        text += section(name, there, *own)
    ground = str(on_ground).lower()
    path.write_text(
        f"{text}[metadata]\ncharuco_square_size = 58.0\ngroundplane_calibration = {ground}\n"
    )
    return path, by_opencv


def anipose(folder: Path, cameras: dict[str, Place]) -> Made:
    """Anipose's own layout; lengths in the unit of its board, here metres."""
    path = folder / "anipose.toml"
    text = "".join(section(name, camera, f'name = "{name}"') for name, camera in cameras.items())
    path.write_text(text + "[metadata]\nadjusted = false\nerror = 0.3\n")
    return path, by_opencv


WRITERS = (qualisys, vicon, motive, opencap, easymocap, caliscope, old_caliscope, freemocap,
           anipose)  # fmt: skip
