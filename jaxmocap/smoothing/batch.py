"""Smoothing of a whole recording: silhouettes from every video, then all poses at once.

    learn    some frames + where the poses put the body -> background, colours
    measure  every frame -> grids: the person, the forearms, the legs
    smooth   markers, grids -> poses, roughly
    decide   every frame's candidates for the elbows -> the cheapest path, which the poses follow
             wherever that costs less

and in the end once more, learned and measured by the better poses and solved as finely.

INPUTS: a model, a first pass, the videos' frames. OUTPUTS: a Trajectory with deviations.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol

import jax
import numpy as np
from scipy.ndimage import binary_dilation, label

from jaxmocap.body.arms import ELBOW, GRIP, SHOULDER, unmarked_arms
from jaxmocap.body.model import Model
from jaxmocap.body.motion import landmarks_over_time
from jaxmocap.body.pose import Pose
from jaxmocap.body.proportions import PROPORTIONS
from jaxmocap.body.skeleton import ELBOWS
from jaxmocap.evidence.appearance.learned import (
    ROWS,
    Drawing,
    Regions,
    learn_appearance,
    silhouette_grids,
)
from jaxmocap.evidence.silhouettes import SilhouetteGrids
from jaxmocap.evidence.terms import Measurements
from jaxmocap.images.background_model import spread
from jaxmocap.images.foreground import is_blank, shrink
from jaxmocap.images.silhouette_grid import blur_grid
from jaxmocap.smoothing.elbow_viterbi import elbow_path, turn_arms_along
from jaxmocap.smoothing.facing import facing_in_time, references
from jaxmocap.smoothing.linearise import rows_of, smooth_poses
from jaxmocap.smoothing.problem import (
    TURN,
    UNTURNED,
    FirstPass,
    SmoothingProblem,
    Trajectory,
    Views,
    all_turned,
)
from jaxmocap.smoothing.settings import SmoothingSettings, weigh_by_time
from jaxmocap.smoothing.uncertainty import leave_one_out, with_deviations

# Cells over which silhouettes fade, from solve to solve: roughly at first,
ROUGHLY = (1.5,)
# while elbows are decided,
DECIDING = (1.5,)
# and in the end as they were measured.
FINELY = (0.8,)
# A solve that only prepares the next look ends where the cost falls by no more than this share.
PREPARED = 1e-3
# Rough solves at most, while a camera is found to be turned by more than this in one of them.
ROUGH_SOLVES, PUSHED_RAD = 3, 0.009
# Background and colours are learned from so many frames.
LEARNED_FRAMES = 30
# An elbow was led elsewhere where it is farther away than that, metres; events beside it count too.
APART_M, BESIDE = 0.1, 3
# So many times candidates decide where the elbows are, turned about what the arms' markers hold,
DECISIONS = (GRIP, GRIP)
# or, where an arm carries none, first all of it and then its forearm.
FREE_DECISIONS = (SHOULDER, ELBOW, SHOULDER, ELBOW)


class VideoFrames(Protocol):
    """A video whose frames can be gone through again and again."""

    size: tuple[int, int]  # width and height of the full frames

    def frames(self) -> Iterator[tuple[float, np.ndarray | None]]:
        """Each frame's time and its BGR or grey image; None where it cannot be read."""
        ...


@dataclass(frozen=True)
class CameraFrames:
    """One camera's frames among the events."""

    camera: int  # its index
    events: np.ndarray  # (F,) events that have a frame of it, ascending
    indices: np.ndarray  # (F,) which frames
    video: VideoFrames  # that they are of

    def images(self, chosen: np.ndarray) -> Iterator[np.ndarray | None]:
        """The chosen (of F) frames, shrunk, BGR; None where one cannot be read or is blank."""
        wanted = self.indices[chosen]
        position = 0
        for index, (_, image) in enumerate(self.video.frames()):
            while position < len(wanted) and wanted[position] == index:
                if image is None or is_blank(image):
                    yield None
                else:
                    yield shrink(np.atleast_3d(image), ROWS)
                position += 1
            if position == len(wanted):
                return
        for _ in range(position, len(wanted)):
            yield None


class SolvedProblem(NamedTuple):
    """A problem as it was last measured, and the trajectory that solves it."""

    problem: SmoothingProblem  # of all events
    trajectory: Trajectory  # of them, drawn with the last softness of ``FINELY``


def smooth_recording(
    model: Model,
    settings: SmoothingSettings,
    first_pass: FirstPass,
    videos: Sequence[VideoFrames],
    show: Callable[[float], None],
    why: bool = False,
) -> Trajectory | None:
    """The poses of all events and how sure they are; see ``solve_recording``.

    With ``why`` also how sure without each part of the evidence.
    """
    solved = solve_recording(model, settings, first_pass, videos, show)
    if solved is None:
        return None
    trajectory = with_deviations(*solved, FINELY[-1])
    views, unrecognised = solved.problem.views, np.zeros(first_pass.frame_index.shape, bool)
    unrecognised[views.frame, views.camera] = ~views.grids.recognised
    trajectory = trajectory._replace(unrecognised=unrecognised)
    if why:
        solved = solved._replace(trajectory=trajectory)
        trajectory = leave_one_out(*solved, FINELY[-1], lambda done: show(0.8 + 0.2 * done))
    show(1.0)
    return trajectory


def solve_recording(
    model: Model,
    settings: SmoothingSettings,
    first_pass: FirstPass,
    videos: Sequence[VideoFrames],
    show: Callable[[float], None],
) -> SolvedProblem | None:
    """Look at all frames and find the poses of all events.

    Args:
        model: of the person, the markers and the cameras.
        settings: of the smoothing.
        first_pass: E events, and the poses to start from.
        videos: one per camera.
        show: called with the share done.

    Returns:
        None where no camera has a frame.
    """
    cameras = _frames_of_cameras(first_pass.frame_index, videos)
    if not cameras:
        return None
    measured = measurements_of(model, first_pass)
    stated, settings = settings, weigh_by_time(settings, first_pass.times)
    if model.no_foot_is_marked:
        by_markers = first_pass.marker_poses
        facing = facing_in_time(model, stated, first_pass.times, measured, by_markers)
        measured = measured._replace(facing=facing)

    def measured_about(trajectory: Trajectory) -> SmoothingProblem:
        views = _views(model, cameras, trajectory)
        return SmoothingProblem(model, settings, first_pass.times, measured, views)

    def decided(problem: SmoothingProblem, trajectory: Trajectory, pivot: int) -> Trajectory:
        path = elbow_path(problem, trajectory, np.where(unmarked, pivot, GRIP))
        guided = problem.with_measured(elbows=path.goals)
        start = turn_arms_along(model, trajectory, path)
        led = smooth_poses(guided, start, DECIDING, PREPARED).trajectory
        return cheaper_by_stretch(problem, trajectory, led)

    poses = first_pass.poses
    if model.no_foot_is_marked:
        poses = _with_usual_legs(model, settings, first_pass, measured)
    no_change = np.zeros(len(PROPORTIONS), model.dtype)
    trajectory = Trajectory(poses, no_change, _as_calibrated(model, settings))
    problem = measured_about(trajectory)
    for _ in range(ROUGH_SOLVES):
        before = trajectory.turns_cam
        trajectory = smooth_poses(problem, trajectory, ROUGHLY, PREPARED, coarse=True).trajectory
        if not (np.linalg.norm(trajectory.turns_cam - before, axis=-1) > PUSHED_RAD).any():
            break
        # The person was looked for beside where this camera has them.
        problem = measured_about(trajectory)
    show(0.3)
    unmarked = unmarked_arms(model.skeleton.tree, model.markers, first_pass.markers_world)
    pivots = FREE_DECISIONS if unmarked.any() else DECISIONS
    for turn, pivot in enumerate(pivots):
        trajectory = decided(problem, trajectory, pivot)
        show(0.3 + 0.3 * (turn + 1) / len(pivots))
    # Better poses teach better what the person looks like.
    problem = measured_about(trajectory)
    show(0.7)
    return SolvedProblem(problem, smooth_poses(problem, trajectory, FINELY).trajectory)


def cheaper_by_stretch(
    problem: SmoothingProblem, before: Trajectory, led: Trajectory
) -> Trajectory:
    """Poses that were led, and those from before wherever these cost less.

    A search prices an arm with the rest of the body where it is, so that a solve that follows it
    may end higher than one that does not.

    Args:
        problem: the recording, without goals for elbows.
        before: T events, where the arms were.
        led: the same T events after a solve with goals.
    """
    if not _apart(*(_elbows_of(problem, each) for each in (before, led))).any():
        return led
    each = [smooth_poses(problem, start, DECIDING, PREPARED) for start in (before, led)]
    stayed, moved = (one.trajectory for one in each)
    apart = _apart(*(_elbows_of(problem, one) for one in (stayed, moved)))
    stretches, count = label(binary_dilation(apart, iterations=BESIDE))  # type: ignore[misc]
    keeps = np.zeros(len(apart), bool)
    for number in range(1, count + 1):
        rows = np.flatnonzero(stretches == number)
        prior = replace(problem, times=problem.times[rows]).motion_prior()
        costs = [one.costs[rows].sum() + prior.cost(one.points[rows].astype(float)) for one in each]
        keeps[rows] = costs[0] < costs[1]

    def chosen(kept: np.ndarray, other: np.ndarray) -> np.ndarray:
        return np.where(keeps.reshape(-1, *[1] * (np.ndim(kept) - 1)), kept, other)

    return moved._replace(poses=jax.tree.map(chosen, stayed.poses, moved.poses))


def _elbows_of(problem: SmoothingProblem, trajectory: Trajectory) -> np.ndarray:
    """(T, 2, 3) world, metres."""
    person = trajectory.person(problem.model.skeleton)
    return landmarks_over_time(person, trajectory.poses, ELBOWS)


def _apart(elbows: np.ndarray, others: np.ndarray) -> np.ndarray:
    """(T,) where either of two elbows is far from where others have it."""
    return (np.linalg.norm(elbows - others, axis=-1) > APART_M).any(-1)


def _with_usual_legs(
    model: Model,
    settings: SmoothingSettings,
    first_pass: FirstPass,
    measured: Measurements,
) -> Pose:
    """Poses (E, ...) with trunk and legs as is usual of them, elbows where the first pass has them.

    Without the images: from legs that are folded as nobody's are, silhouettes end far off.
    """
    elbows = landmarks_over_time(model.skeleton, first_pass.poses, ELBOWS).astype(model.dtype)
    measured = measured._replace(elbows=elbows)
    problem = SmoothingProblem(model, settings, first_pass.times, measured, Views.no_cameras())
    no_change = np.zeros(len(PROPORTIONS), model.dtype)
    start = Trajectory(first_pass.marker_poses, no_change, UNTURNED)
    return smooth_poses(problem, start, FINELY, PREPARED).trajectory.poses


def _as_calibrated(model: Model, settings: SmoothingSettings) -> np.ndarray:
    """Cameras that are not turned yet, and may be where the settings allow it."""
    turns = np.zeros((model.camera_count, TURN), model.dtype)
    return turns if float(settings.camera) > 0 else UNTURNED


def _frames_of_cameras(
    frame_index: np.ndarray, videos: Sequence[VideoFrames]
) -> list[CameraFrames]:
    """The frames of each camera that has some; one that serves several events counts for each."""
    result = [
        CameraFrames(camera, np.flatnonzero(column >= 0), column[column >= 0], video)
        for camera, (column, video) in enumerate(zip(frame_index.T, videos, strict=True))
    ]
    return [each for each in result if len(each.events)]


def measurements_of(model: Model, first_pass: FirstPass) -> Measurements:
    """What was measured of each event besides its silhouettes."""
    measured = references(model.skeleton, first_pass.times, first_pass.marker_poses)
    # No goals yet: what is there from the start needs no second program later.
    none = np.broadcast_to(np.asarray(np.nan, model.dtype), (len(first_pass.times), 2, 3))
    markers, lines = first_pass.markers_world, first_pass.sight_lines
    markers, lines = jax.tree.map(lambda part: np.asarray(part, model.dtype), (markers, lines))
    return measured._replace(markers=markers, elbows=none, sight_lines=lines)


def silhouettes_of(
    model: Model, first_pass: FirstPass, videos: Sequence[VideoFrames]
) -> SilhouetteGrids | None:
    """What the cameras (C) show at each event (E), by the poses of the first pass; on the host.

    Returns:
        (E, C, ...), as the last solve draws them; of weight 0 where a camera has no frame. None
        where no camera has one.
    """
    cameras = _frames_of_cameras(first_pass.frame_index, videos)
    if not cameras:
        return None
    lengths = np.zeros(len(PROPORTIONS), model.dtype)
    views = _views(model, cameras, Trajectory(first_pass.poses, lengths))
    rows = np.zeros(first_pass.frame_index.shape, int)
    rows[views.frame, views.camera] = np.arange(len(views.frame))
    soft = views.grids.each_grid(lambda grid: blur_grid(grid, FINELY[-1]))
    is_there = (first_pass.frame_index >= 0)[..., None, None].astype(np.float32)
    grids = jax.tree.map(lambda part: part[rows], soft)
    return grids.each_grid(lambda grid: grid._replace(weight=is_there * grid.weight))


def _views(model: Model, cameras: Sequence[CameraFrames], trajectory: Trajectory) -> Views:
    """What all cameras show, by what the poses estimated so far teach."""
    turned = all_turned(model.cameras, trajectory.turns_cam)
    person = replace(model, skeleton=trajectory.person(model.skeleton), cameras=turned)
    each = [_views_of(person, own, rows_of(trajectory.poses, own.events)) for own in cameras]
    return jax.tree.map(lambda *parts: np.concatenate(parts), *each)


def _views_of(person: Model, own: CameraFrames, poses: Pose) -> Views:
    """Grids of all of one camera's frames, of a background learned from some of them."""
    camera, skeleton = rows_of(person.cameras, own.camera), person.skeleton
    # The frames' own size: a video may be cropped against its calibration.
    drawing = Drawing.of(skeleton, camera, own.video.size, poses)
    chosen = spread(len(own.events), LEARNED_FRAMES)
    feet_astray = person.no_foot_is_marked
    appearance = learn_appearance(drawing, chosen, own.images(chosen), feet_astray)
    every = own.images(np.arange(len(own.events)))
    regions = Regions.around(skeleton, camera, poses)
    grids = silhouette_grids(every, appearance, drawing, regions)
    return Views(own.events, np.full(len(own.events), own.camera), grids)
