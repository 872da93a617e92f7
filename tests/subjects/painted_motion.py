"""A given motion, painted: its markers and silhouettes, ready to be smoothed."""

from functools import cache
from types import SimpleNamespace
from typing import NamedTuple

import cv2
import jax
import jax.numpy as jnp
import numpy as np
from conftest import on_device
from drawn_arms import SIZE, arm_pose, camera_at
from drawn_body import paint, room

from jaxmocap.body.kinematics import forward, landmark_sites, landmarks, site_positions
from jaxmocap.body.model import Model
from jaxmocap.body.pose import Pose
from jaxmocap.body.proportions import PROPORTIONS
from jaxmocap.body.skeleton import LANDMARKS, Skeleton
from jaxmocap.capture.timeline import Timeline
from jaxmocap.evidence.markers import MarkerPositions
from jaxmocap.evidence.silhouettes import SilhouetteGrids, Silhouettes, project_limbs
from jaxmocap.evidence.terms import Measurements
from jaxmocap.geometry.cameras import Camera
from jaxmocap.geometry.outlines import Discs, touch
from jaxmocap.geometry.rotations import quaternion_to_matrix
from jaxmocap.images.regions import Region
from jaxmocap.images.silhouette_grid import Grid, cells
from jaxmocap.smoothing.problem import FirstPass, SmoothingProblem, Trajectory, Views
from jaxmocap.smoothing.settings import SmoothingSettings

PERSON = Skeleton.human(1.75, proportions="winter")
MARKERS = landmark_sites(PERSON, ("vertex", "wrist_l", "wrist_r"))
ELBOWS = [LANDMARKS.index(f"elbow_{side}") for side in "lr"]
CAMERAS = (
    camera_at((2.6, 0.4, 1.3), (0.0, 0.0, 1.15)),
    camera_at((1.2, -2.4, 1.4), (0.0, 0.0, 1.15)),
)
CELLS, CELL_PX, RATE = 48, 8, 30
SIDE_PX = CELLS * CELL_PX
CORNER = (np.array(SIZE) - SIDE_PX) // 2
# Stated, so that what is tested does not move with what is tuned on real people; who is painted as
# he is modelled errs hardly alike from cell to cell.
SETTINGS = SmoothingSettings(
    markers=MarkerPositions(deviation=0.004),
    silhouettes=Silhouettes(deviation=0.7, redundancy=4.0),
    acceleration=3.0,
    mismatch=1.0,
    persistence=1.0,
)
MODEL = Model.create(PERSON, MARKERS, CAMERAS)


class PaintedGrids(NamedTuple):
    """One camera's silhouettes in T frames: (T, S, S) each, and where the grids' corners lie."""

    person: np.ndarray
    forearms: np.ndarray
    origin: np.ndarray


def pose_at(time: float) -> Pose:
    """Both arms busy before the body, each in its own way."""
    swing, other = np.sin(4 * time), np.cos(5 * time)
    degrees = {
        "arm_flex": (25 + 15 * swing, 15 + 15 * other),
        "arm_abduct": (35 + 10 * other, 40 + 15 * swing),
        "arm_rot": (10 + 20 * swing, -20 + 15 * other),
        "elbow_flex": (80 + 15 * other, 75 + 20 * swing),
    }
    pose = arm_pose(PERSON, degrees)
    sway = np.array([0.0, 0.03 * np.sin(2 * time), 0.0])
    return pose._replace(position=pose.position + sway)


@cache
def truth(count: int) -> Pose:
    """The motion (T, ...)."""
    poses = [pose_at(i / RATE) for i in range(count)]
    return Pose(*(np.stack(part) for part in zip(*poses, strict=True)))


_points = jax.jit(jax.vmap(landmarks, (None, 0)))


@jax.jit
@jax.vmap
def places_of(pose: Pose) -> jax.Array:
    """Markers (T, M, 3)."""
    return site_positions(PERSON, forward(PERSON, pose), MARKERS)


_turns = jax.jit(jax.vmap(quaternion_to_matrix))


def points_of(poses: Pose) -> np.ndarray:
    """Landmarks (T, L, 3)."""
    return np.asarray(_points(PERSON, on_device(poses)))


def elbow_errors(poses: Pose) -> np.ndarray:
    """Distances (T, 2) of the elbows from the truth, metres."""
    expected = points_of(truth(len(poses.angles)))
    return np.linalg.norm(points_of(poses) - expected, axis=-1)[:, ELBOWS]


@jax.jit
def limb_distances(pose: Pose, camera: Camera, grids: SilhouetteGrids) -> jax.Array:
    """Distances (K, S, S), cells, of a grid's cells to the limbs, the nearest limb first."""
    _, discs, _ = project_limbs(PERSON, forward(PERSON, pose), camera, grids)
    each = Discs(*(part[:, None] for part in discs))
    distances = touch(each, *cells(CELLS, discs.near.dtype)).distance
    return jnp.sort(distances, 0).reshape(-1, CELLS, CELLS)


def per_metre(camera: int) -> np.ndarray:
    """() pixels of a metre at the person as the motion begins."""
    matrix, T_cam_world = (
        np.asarray(part) for part in (CAMERAS[camera].matrix, CAMERAS[camera].T_cam_world)
    )
    away = T_cam_world[2] @ np.append(pose_at(0.0).position, 1.0)
    return np.asarray(matrix[0, 0] / away, np.float32)


@cache
def painted_grids(camera: int, count: int) -> PaintedGrids:
    """The motion in one camera, on grids about the upper body."""
    person, forearms = np.stack([painted_frame(camera, i) for i in range(count)], 1)
    return PaintedGrids(person, forearms, np.tile(CORNER - 0.5, (count, 1)))


@cache
def painted_frame(camera: int, number: int) -> list[np.ndarray]:
    """The person and the forearms (S, S) of one of the frames, of which motions share the first."""
    shares = paint(CAMERAS[camera], PERSON, pose_at(number / RATE), room(SIZE))[1:]
    return [_averaged(share) for share in shares]


def _averaged(share: np.ndarray) -> np.ndarray:
    x, y = CORNER
    window = share[y : y + SIDE_PX, x : x + SIDE_PX]
    return cv2.resize(window, (CELLS, CELLS), interpolation=cv2.INTER_AREA)


def views(count: int, cameras=(0,), frames=None) -> Views:
    """Of cameras at the given frames, all by default."""
    parts = []
    for camera in cameras:
        chosen = np.arange(count) if frames is None else np.asarray(frames)
        painted = painted_grids(camera, count)
        grids = (Grid(part[chosen], np.ones_like(part[chosen])) for part in painted[:2])
        scale = np.full(len(chosen), CELL_PX, np.float32)
        region = Region(painted.origin[chosen].astype(np.float32), scale)
        cameras_of = np.full(len(chosen), camera)
        metres = np.full(len(chosen), per_metre(camera))
        parts.append(Views(chosen, cameras_of, SilhouetteGrids(region, *grids, metres)))
    return jax.tree.map(lambda *each: np.concatenate(each), *parts)


def measurements(count: int) -> Measurements:
    """Of each frame: markers on head and wrists, and what their own pose would be."""
    poses = on_device(truth(count))
    points = points_of(truth(count))
    R = np.asarray(_turns(poses.quaternion))
    ankles = points[:, [LANDMARKS.index(f"ankle_{side}") for side in "lr"]]
    unseen = np.full((count, 2, 3), np.nan)
    each = places_of(poses), R[:, :2, 2], R[:, :, 0], ankles, unseen
    return Measurements(*(np.array(part, np.float32) for part in each))


def problem(count: int, shown: Views, measured: Measurements | None = None) -> SmoothingProblem:
    """Everything that was measured of the motion."""
    measured = measurements(count) if measured is None else measured
    return SmoothingProblem(MODEL, SETTINGS, np.arange(count) / RATE, measured, shown)


def disturbed(count: int, degrees: float = 15.0) -> Trajectory:
    """A start whose arms are turned away from the truth."""
    poses, turn = truth(count), np.radians(degrees)
    angles = poses.angles.copy()
    for name, by in (
        ("arm_rot_l", turn),
        ("arm_rot_r", -turn),
        ("arm_abduct_l", turn),
        ("arm_abduct_r", turn),
    ):
        angles[:, PERSON.tree.joint(name)] += by
    start = Pose(*(np.asarray(part, np.float32) for part in poses._replace(angles=angles)))
    return Trajectory(start, np.zeros(len(PROPORTIONS), np.float32))


def first_pass(
    timeline: Timeline, markers_world: np.ndarray, marker_poses: Pose, poses: Pose, **more
) -> FirstPass:
    """What a tracker's steps at the events of a timeline would hand on to the smoothing."""
    return FirstPass(
        timeline.event_times,
        markers_world,
        timeline.frame_index,
        poses,
        SimpleNamespace(marker_pose=marker_poses),
        [[] for _ in timeline.event_times],
        **more,
    )
