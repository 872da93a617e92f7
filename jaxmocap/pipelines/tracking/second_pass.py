"""The second pass over a recording: silhouettes from every video, then all poses at once.

    learn    some frames + where the poses put the body -> background, colours
    see      every frame -> two grids: the person, the forearms
    smooth   markers, grids -> poses, roughly
    decide   every frame's candidates for the elbows -> the cheapest path, which the poses follow

and again with what the better poses taught, the last solve as finely as was seen.

INPUTS: a recording, its events, the poses of the first pass. OUTPUTS: poses, their deviations.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.ndimage import gaussian_filter1d

from jaxmocap.body.motion import landmarks_over_time
from jaxmocap.body.pose import Pose
from jaxmocap.body.proportions import PROPORTIONS, scaled
from jaxmocap.body.skeleton import Skeleton, landmark_rows
from jaxmocap.capture.frame_cache import cached_frames
from jaxmocap.capture.timeline import Timeline
from jaxmocap.capture.video import FrameSource
from jaxmocap.evidence.appearance.learned import ROWS, Drawing, Regions, learn_appearance, see
from jaxmocap.evidence.keypoints import Lines
from jaxmocap.evidence.residuals import GROUND, NO_GOALS, Known, feet_free
from jaxmocap.geometry.cameras import Camera
from jaxmocap.geometry.rotations import quaternion_to_matrix
from jaxmocap.hybrid.tracker import HybridTracker
from jaxmocap.images.background_model import spread
from jaxmocap.images.foreground import shrink
from jaxmocap.pipelines.tracking.report_figures import Judged, judge
from jaxmocap.smoothing.elbow_viterbi import elbow_goals
from jaxmocap.smoothing.fixed_lag import Given
from jaxmocap.smoothing.linearise import Problem, Sights, smooth_poses
from jaxmocap.smoothing.trajectory import TURN, UNTURNED, Trajectory, all_turned
from jaxmocap.smoothing.uncertainty import trust_in

# Cells over which silhouettes fade, from solve to solve: roughly first, in the end as seen.
ROUGHLY, DECIDING, FINELY = (3.0, 1.5), (1.5,), (1.5, 0.8)
# A solve that only prepares the next look ends where the cost falls by no more than this share.
PREPARED = 1e-3
# So many times candidates decide where the elbows are.
DECISIONS = 2
# Over so many seconds the markers' facing is averaged: a person turns more slowly than it errs.
TURNING_S = 0.5


@dataclass(frozen=True)
class Look:
    """One camera's frames among the events.

    Attributes:
        camera: its index.
        events: (F,) events that have a frame of it, ascending.
        indices: (F,) which frames.
    """

    camera: int
    events: np.ndarray
    indices: np.ndarray

    def frames(self, video: FrameSource, chosen: np.ndarray) -> Iterator[np.ndarray | None]:
        """The chosen (of F) frames, shrunk, BGR; None where one cannot be read."""
        wanted = self.indices[chosen]
        position = 0
        for index, (_, image) in enumerate(video.frames()):
            while position < len(wanted) and wanted[position] == index:
                yield None if image is None else shrink(np.atleast_3d(image), ROWS)
                position += 1
            if position == len(wanted):
                return
        for _ in range(position, len(wanted)):
            yield None


class FirstPass(NamedTuple):
    """What the first pass went through, and what it found there.

    Attributes:
        timeline: E events.
        markers_world: (E, M, 3); NaN where missing.
        alone: poses (E, ...) of the markers alone.
        refined: poses (E, ...) with what the video had to say of each.
        lines: of sight of the landmarks (E, ...), where the recording brings key points.
    """

    timeline: Timeline
    markers_world: np.ndarray
    alone: Pose
    refined: Pose
    lines: Lines | None = None


class Smoothed(NamedTuple):
    """What the second pass found.

    Attributes:
        skeleton: of the person with the proportions found.
        poses: (E, ...).
        judged: how far to trust them.
        turns_cam: (C, 3) by which each camera was found turned against its calibration, rotation
            vectors in its own frame, radians; ``UNTURNED`` where that was not asked.
    """

    skeleton: Skeleton
    poses: Pose
    judged: Judged
    turns_cam: np.ndarray = UNTURNED


class Solved(NamedTuple):
    """How the poses of all events were found.

    Attributes:
        problem: what was known of them, by the last look.
        trajectory: that solves it, seen with the last softness of ``FINELY``.
    """

    problem: Problem
    trajectory: Trajectory


def smooth_recording(
    tracker: HybridTracker,
    videos: Sequence[FrameSource],
    first_pass: FirstPass,
    show: Callable[[float], None],
) -> Smoothed | None:
    """Smooth the poses of all events; see ``solve_recording``."""
    solved = solve_recording(tracker, videos, first_pass, show)
    if solved is None:
        return None
    problem, found = solved
    trust = trust_in(problem, found, FINELY[-1])
    show(1.0)
    person = scaled(tracker.skeleton, jnp.asarray(found.proportions))
    smoothed = _judged(tracker, person, found.poses, trust, first_pass)
    return smoothed._replace(turns_cam=np.asarray(found.turns_cam))


def solve_recording(
    tracker: HybridTracker,
    videos: Sequence[FrameSource],
    first_pass: FirstPass,
    show: Callable[[float], None],
) -> Solved | None:
    """Look at all frames and find the poses of all events.

    Args:
        tracker: its person, cameras, markers and settings.
        videos: one per camera.
        first_pass: E events, and the poses to start from.
        show: called with the share done.

    Returns:
        None where no camera has a frame.
    """
    assert tracker.cameras is not None
    looks = [look for look in _looks(first_pass.timeline) if len(look.events)]
    if not looks:
        return None
    cameras, videos = tracker.cameras, cached_frames(videos, ROWS)
    known, times = _known(tracker, first_pass), first_pass.timeline.event_times

    def looked(found: Trajectory) -> Problem:
        return Problem(
            tracker.skeleton, cameras, tracker.markers, tracker.settings.over_time,
            times, known, _all_sights(tracker, looks, videos, found),
        )  # fmt: skip

    def decided(problem: Problem, found: Trajectory) -> Trajectory:
        goals = elbow_goals(problem, found, tracker.grips)
        hoped = replace(problem, known=known._replace(goals=goals))
        return smooth_poses(hoped, found, DECIDING, PREPARED).trajectory

    no_change = np.zeros(len(PROPORTIONS), tracker.dtype)
    found = Trajectory(first_pass.refined, no_change, _as_calibrated(tracker))
    problem = looked(found)
    found = smooth_poses(problem, found, ROUGHLY, PREPARED, coarse=True).trajectory
    show(0.3)
    for turn in range(DECISIONS):
        found = decided(problem, found)
        # Better poses teach better what the person looks like.
        problem = looked(found)
        show(0.3 + 0.4 * (turn + 1) / DECISIONS)
    return Solved(problem, smooth_poses(problem, found, FINELY).trajectory)


def _as_calibrated(tracker: HybridTracker) -> np.ndarray:
    """Cameras that are not turned yet, and may be where the settings say so."""
    assert tracker.cameras is not None
    turns = np.zeros((len(tracker.cameras.matrix), TURN), tracker.dtype)
    return turns if float(tracker.settings.over_time.camera) > 0 else UNTURNED


def gathered(tracker: HybridTracker, given: Sequence[Given], first_pass: FirstPass) -> Smoothed:
    """What a ``FixedLagSmoother`` gave out of all events, in order."""
    poses = jax.tree.map(lambda *parts: np.stack(parts), *(each.pose for each in given))
    trust = np.stack([g.deviations for g in given]), np.stack([g.from_prior for g in given])
    return _judged(tracker, tracker.skeleton, poses, trust, first_pass)


def _judged(
    tracker: HybridTracker,
    person: Skeleton,
    poses: Pose,
    trust: tuple[np.ndarray, np.ndarray],
    first_pass: FirstPass,
) -> Smoothed:
    judged = judge(tracker, person, poses, trust, first_pass.alone, first_pass.markers_world)
    return Smoothed(person, poses, judged)


def _looks(timeline: Timeline) -> list[Look]:
    """Each camera's events; a frame that serves several events is looked at for each."""
    columns = timeline.frame_index.T
    return [
        Look(camera, np.flatnonzero(column >= 0), column[column >= 0])
        for camera, column in enumerate(columns)
    ]


# As one program: step by step each step would compile for every number of events.
_turns = jax.jit(jax.vmap(quaternion_to_matrix))


def _known(tracker: HybridTracker, first_pass: FirstPass) -> Known:
    """What is known of each event besides its sights."""
    times, alone = first_pass.timeline.event_times, first_pass.alone
    R = np.asarray(_turns(jnp.asarray(alone.quaternion, float)))
    ahead = R[:, :2, 0]
    step = np.median(np.diff(times)) if len(times) > 1 else 1.0
    ahead = gaussian_filter1d(ahead, TURNING_S / step, axis=0, mode="nearest")
    ahead = ahead / np.maximum(np.linalg.norm(ahead, axis=1, keepdims=True), 1e-9)
    facing = np.pad(ahead, ((0, 0), (0, 1)))
    points = landmarks_over_time(tracker.skeleton, alone)
    ankles = points[:, landmark_rows(GROUND)]
    feet = np.full(len(times), feet_free(tracker.skeleton, tracker.markers))
    goals = np.full((len(times), *NO_GOALS.shape), np.nan)
    known = Known(
        first_pass.markers_world, R[:, :2, 2], facing, ankles, feet, goals, first_pass.lines
    )
    return jax.tree.map(lambda part: np.asarray(part, tracker.dtype), known)


def _all_sights(
    tracker: HybridTracker, looks: Sequence[Look], videos: Sequence[FrameSource], found: Trajectory
) -> Sights:
    """What all cameras see, by what the poses found so far teach."""
    assert tracker.cameras is not None
    person, sights = scaled(tracker.skeleton, jnp.asarray(found.proportions)), []
    cameras = all_turned(tracker.cameras, found.turns_cam)
    astray = feet_free(person, tracker.markers) > 0
    for look in looks:
        camera = jax.tree.map(lambda part, c=look.camera: part[c], cameras)
        there = jax.tree.map(lambda part, e=look.events: np.asarray(part)[e], found.poses)
        sights.append(_sights(person, camera, look, videos[look.camera], there, astray))
    return jax.tree.map(lambda *parts: np.concatenate(parts), *sights)


def _sights(
    skeleton: Skeleton, camera: Camera, look: Look, video: FrameSource, poses: Pose, astray: bool
) -> Sights:
    """Grids of all of one camera's frames, of a background learned from some of them."""
    # The frames' own size: a video may be cropped against its calibration.
    drawing, chosen = Drawing.of(skeleton, camera, video.size, poses), spread(len(look.events))
    appearance = learn_appearance(drawing, chosen, look.frames(video, chosen), astray)
    every = look.frames(video, np.arange(len(look.events)))
    sight = see(every, appearance, drawing, Regions.around(skeleton, camera, poses))
    return Sights(look.events, np.full(len(look.events), look.camera), sight)
