"""Where a camera stands in the world, from one view of a board or of points at measured places.

INPUTS: points (metres, world, Z up), their pixels, Intrinsics. OUTPUTS: a Placement.

As the paper's section 3 has it: the board lies where it was measured in the marker system's world,
so its corners' places in the world are given, and the camera follows from them.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from jaxmocap.calibration.board.opencv_lenses import (
    FLAT_THICKNESS,
    CameraPose,
    candidate_poses,
    project_points,
    relative_thickness,
    rms_length,
)
from jaxmocap.formats.cameras.calibration import Intrinsics

# The mirrored solution is ambiguous where its residual is less than this times the better one's.
AMBIGUOUS_RATIO = 2.0
# Points are on one line where their breadth is less than this part of their length.
_LINE_BREADTH = 1e-3
# With at least so many points, one that errs is found:
_MIN_POINTS_FOR_OUTLIER = 6
# without it the residual falls to less than this share.
_OUTLIER_RATIO = 0.25
# A camera is upside down for certain where the picture's vertical lies within 45° of the world's,
# unless it looks almost straight up or down: this much of the vertical must show in the picture.
_MIN_VERTICAL_SHOWN = 0.1
# A place with a larger standard deviation gets a warning, metres.
_UNCERTAIN_M = 0.05


@dataclass(frozen=True)
class Placement:
    """A camera in the world."""

    T_cam_world: np.ndarray  # (4, 4) float64, metres
    residuals_xy: np.ndarray  # (N, 2) reprojected minus detected, pixels, of all points
    used: np.ndarray  # (N,) which points the pose rests on
    # (3,) standard deviation of the camera's place, metres, by the corners' noise alone.
    std_m: np.ndarray
    std_deg: float  # of its direction, the largest of the three axes, degrees
    mirrored: np.ndarray | None  # the other solution that a flat target has, T_cam_world, or None
    mirrored_ratio: float  # its residual over that of the one taken
    warnings: tuple[str, ...]  # sentences that a user should see

    @property
    def rms(self) -> float:
        """Root mean square residual of the points used, pixels."""
        return rms_length(self.residuals_xy[self.used])

    @property
    def position_world(self) -> np.ndarray:
        """(3,) metres."""
        return position_world_of(self.T_cam_world)

    @property
    def rotation(self) -> np.ndarray:
        """(3,) Rodrigues vector, world to camera."""
        return Rotation.from_matrix(self.T_cam_world[:3, :3]).as_rotvec()

    def entries(self) -> dict[str, np.ndarray]:
        """Its fields in a section of the calibration file."""
        return {"rotation": self.rotation, "translation": self.T_cam_world[:3, 3]}


def board_to_world(pose: tuple[float, ...]) -> np.ndarray:
    """(4, 4) T_world_board of x, y, z (metres) and rx, ry, rz (degrees).

    The board is turned about the world's fixed x axis first, then y, then z (extrinsic xyz):
    R = Rz Ry Rx; then it is moved to x, y, z.
    """
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("xyz", pose[3:], degrees=True).as_matrix()
    T[:3, 3] = pose[:3]
    return T


def position_world_of(T_cam_world: np.ndarray) -> np.ndarray:
    """(3,) the camera's place in the world, metres."""
    return -T_cam_world[:3, :3].T @ T_cam_world[:3, 3]


def estimate_placement(
    points_world: np.ndarray, pixels_xy: np.ndarray, lens: Intrinsics, upside_down: bool = False
) -> Placement:
    """Place a camera that sees (N, 3) points at (N, 2) pixels.

    Of two solutions that explain the picture alike, the one above the floor and upright (or upside
    down, where that is expected) is taken where that distinguishes them.

    Raises:
        ArithmeticError: fewer than four points, all on one line, or no answer.
    """
    _check_points(points_world)
    used = np.ones(len(points_world), bool)
    poses = candidate_poses(points_world, pixels_xy, lens)
    if poses and len(points_world) >= _MIN_POINTS_FOR_OUTLIER:
        used, poses = _without_outlier(points_world, pixels_xy, lens, poses)
    if not poses:
        raise ArithmeticError("no camera sees these points there: pixels or places are exchanged")
    best, warnings = _chosen_pose(poses, upside_down)
    mirrored = next((pose for pose in poses if pose is not best), None)
    std_m, std_deg = _deviations(best, points_world[used], lens)
    if std_m.max() >= _UNCERTAIN_M:
        warnings.append(
            f"the camera's place is only roughly estimated, ± {100 * std_m.max():.0f} cm: the "
            "board or the points fill too little of the picture, or lie square to the view"
        )
    warnings += _implausibility_warnings(best.matrix, upside_down)
    residuals_xy = project_points(points_world, best.rvec, best.tvec, lens)[0] - pixels_xy
    other = None if mirrored is None else mirrored.matrix
    ratio = np.inf if mirrored is None else mirrored.rms / max(best.rms, 1e-9)
    measured = best.matrix, residuals_xy, used, std_m, std_deg
    return Placement(*measured, other, ratio, tuple(warnings))


def _chosen_pose(poses: list[CameraPose], upside_down: bool) -> tuple[CameraPose, list[str]]:
    """Of poses, the best first, the one that is plausible; a warning where two fit alike."""
    best = poses[0]
    alike = [pose for pose in poses[1:] if pose.rms < AMBIGUOUS_RATIO * max(best.rms, 0.05)]
    if not alike:
        return best, []
    pair = best, alike[0]
    faults = [len(_implausibility_warnings(pose.matrix, upside_down)) for pose in pair]
    best, other = pair if faults[0] <= faults[1] else pair[::-1]
    why = f"the one that is above the floor and {'upside down' if upside_down else 'upright'}"
    if faults[0] == faults[1]:
        why = "the one that fits better, which may be wrong"
    return best, [
        f"two cameras explain the picture alike, at {_position_text(best.matrix)} ({best.rms:.2f} "
        f"pixels) and at {_position_text(other.matrix)} ({other.rms:.2f} pixels); taken is {why}. "
        "Tilt the board against the view, bring it nearer, or give points that are not on one plane"
    ]


def _check_points(points_world: np.ndarray) -> None:
    if len(points_world) < 4:
        raise ArithmeticError(f"found {len(points_world)} points, expected at least 4")
    extents = np.linalg.svd(points_world - points_world.mean(0), compute_uv=False)
    if extents[1] <= _LINE_BREADTH * extents[0]:
        raise ArithmeticError("all points lie on one line, expected them spread in two directions")
    if (
        len(points_world) < _MIN_POINTS_FOR_OUTLIER
        and relative_thickness(points_world) >= FLAT_THICKNESS
    ):
        # Four or five points in space fit too many cameras for a wrong one to show.
        raise ArithmeticError(
            f"found {len(points_world)} points that are not on a plane, "
            f"expected at least {_MIN_POINTS_FOR_OUTLIER}"
        )


def _without_outlier(
    points_world: np.ndarray, pixels_xy: np.ndarray, lens: Intrinsics, poses: list[CameraPose]
) -> tuple[np.ndarray, list[CameraPose]]:
    """Leave out the one point without which the rest fits far better, if there is one."""
    used = np.ones(len(points_world), bool)
    without = []
    for i in range(len(points_world)):
        rest = np.arange(len(points_world)) != i
        without.append(candidate_poses(points_world[rest], pixels_xy[rest], lens))
    errors = [pose[0].rms if pose else np.inf for pose in without]
    i = int(np.argmin(errors))
    if poses[0].rms > 1.0 and errors[i] < _OUTLIER_RATIO * poses[0].rms:
        used[i] = False
        return used, without[i]
    return used, poses


def _position_text(T_cam_world: np.ndarray) -> str:
    return "({:.2f}, {:.2f}, {:.2f}) m".format(*position_world_of(T_cam_world))


def _implausibility_warnings(T_cam_world: np.ndarray, upside_down: bool) -> list[str]:
    """What cannot be so of a camera in a room."""
    warnings = []
    if (height := position_world_of(T_cam_world)[2]) < 0:
        warnings.append(f"the camera comes out below the floor, at z = {height:.2f} m")
    # The camera's y points down in its picture.
    if (T_cam_world[1, 2] > 0) != upside_down:
        warnings.append(f"the camera comes out {'upright' if upside_down else 'upside down'}")
    return warnings


def is_wrong_way_up(T_cam_world: np.ndarray, upside_down: bool) -> bool:
    """Whether a camera is certainly upside down, or upright where it hangs upside down."""
    # The world's vertical, as the picture's x and y show it.
    x, y = T_cam_world[:2, 2] * (-1.0 if upside_down else 1.0)
    return bool(y >= abs(x) and np.hypot(x, y) > _MIN_VERTICAL_SHOWN)


def advice_on_board_pose(
    T_cam_world: np.ndarray, T_world_board: np.ndarray, upside_down: bool = False
) -> str | None:
    """Which half turn of the board would put a doubtful camera above the floor and upright."""
    if not _implausibility_warnings(T_cam_world, upside_down):
        return None
    T_cam_board = T_cam_world @ T_world_board
    for axis in "zxy":
        half = np.eye(4)
        half[:3, :3] = Rotation.from_euler(axis, 180, degrees=True).as_matrix()
        other = T_cam_board @ np.linalg.inv(T_world_board @ half)
        if not _implausibility_warnings(other, upside_down):
            return (
                "the board is the other way round than --pose states, or upside down: with it "
                f"rotated by 180° about its own {axis} axis the camera would stand at "
                f"{_position_text(other)}; see the axes in the picture"
            )
    return "see the axes in the picture: --pose does not fit it, or the world's z is not up"


def _deviations(
    pose: CameraPose, points_world: np.ndarray, lens: Intrinsics
) -> tuple[np.ndarray, float]:
    """Standard deviations of place (3,), metres, and direction, degrees, from the residuals."""
    _, J = project_points(points_world, pose.rvec, pose.tvec, lens)
    freedom = max(1, J.shape[0] - 6)
    covariance = np.linalg.pinv(J.T @ J) * (pose.residuals_xy**2).sum() / freedom
    steps, here = 1e-6 * np.eye(6), np.concatenate([pose.rvec, pose.tvec])
    moved = np.array([replace(pose, rvec=at[:3], tvec=at[3:]).matrix for at in here + steps])
    places = [position_world_of(T) - position_world_of(pose.matrix) for T in moved]
    turns = Rotation.from_matrix(moved[:, :3, :3] @ pose.matrix[:3, :3].T).as_rotvec()
    slopes = np.concatenate([places, turns], 1).T / 1e-6
    std = np.sqrt(np.diag(slopes @ covariance @ slopes.T))
    return std[:3], float(np.degrees(std[3:].max()))
