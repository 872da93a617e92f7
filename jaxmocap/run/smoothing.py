"""The second pass over a recording: silhouettes from every video, then all poses at once.

    learn    some frames + where the poses put the body -> background, colours
    look     every frame -> two grids: the person, the forearms
    smooth   markers, grids -> poses; once roughly, and again with what the better poses taught

INPUTS: a recording, its events, the poses of the first pass. OUTPUTS: poses, their deviations.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy.ndimage import gaussian_filter1d

from jaxmocap.body.flesh import cones
from jaxmocap.body.kinematics import forward, landmarks
from jaxmocap.body.pose import Pose
from jaxmocap.body.proportions import PROPORTIONS, scaled
from jaxmocap.body.skeleton import LANDMARKS, Skeleton
from jaxmocap.capture.timeline import Timeline
from jaxmocap.capture.video import FrameSource
from jaxmocap.geometry.cameras import NEAREST_M, Camera, project, to_camera, to_pixels
from jaxmocap.geometry.outlines import Discs, project_limb
from jaxmocap.geometry.rotations import quaternion_to_matrix
from jaxmocap.hybrid.residuals import Known
from jaxmocap.hybrid.silhouette import FOREARMS, Sight, drawn_bones
from jaxmocap.hybrid.smoothing import Problem, Sights, Trajectory, smooth_poses
from jaxmocap.hybrid.tracker import HybridTracker
from jaxmocap.images.background import Background, spread
from jaxmocap.images.foreground import (
    Colours,
    learn_colours,
    learn_foreground,
    log_odds,
    person_grid,
    shrink,
    shrunk_size,
)
from jaxmocap.images.hulls import draw_hulls
from jaxmocap.images.parts import part_odds
from jaxmocap.images.regions import Region
from jaxmocap.images.silhouette import Grid
from jaxmocap.run.judging import Judged, judge

# Rows of the images that silhouettes are learned from; cells of the grid around the person.
ROWS, CELLS = 360, 64
# Around the person's upper half, as a share of its extent.
MARGIN = 0.12
# Cells over which silhouettes fade, from solve to solve: roughly first, then as seen.
ROUNDS = ((3.0, 1.5), (1.5, 0.8))
# Of a limb's thickness: its core, and wherever it may be; the pose errs by some centimetres.
CORE, WHEREVER, ERRING_M = 0.7, 1.4, 0.03
# Along the forearm: skin, whatever the sleeve; the markers hold its far half best.
BARE = (0.5, 0.95)
HEAD = ("head", "neck")
HEAD_GROWN = 1.6
BELOW = ("knee", "ankle", "toe")
FEET = ("tibia", "foot")
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


@dataclass(frozen=True)
class Appearance:
    """What one camera's frames taught.

    Attributes:
        background: without the person.
        person: colours against the rest.
        forearms: colours against the rest of the body.
    """

    background: Background
    person: Colours
    forearms: Colours


class FirstPass(NamedTuple):
    """What the first pass went through, and what it found there.

    Attributes:
        timeline: E events.
        markers_world: (E, M, 3); NaN where missing.
        alone: poses (E, ...) of the markers alone.
        refined: poses (E, ...) with what the video had to say of each.
    """

    timeline: Timeline
    markers_world: np.ndarray
    alone: Pose
    refined: Pose


class Smoothed(NamedTuple):
    """What the second pass found.

    Attributes:
        skeleton: of the person with the proportions found.
        poses: (E, ...).
        judged: how far to trust them.
    """

    skeleton: Skeleton
    poses: Pose
    judged: Judged


def smooth_recording(
    tracker: HybridTracker,
    videos: Sequence[FrameSource],
    first_pass: FirstPass,
    show: Callable[[float], None],
) -> Smoothed | None:
    """Smooth the poses of all events.

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
    known = _known(tracker, first_pass)
    no_change = np.zeros(len(PROPORTIONS), tracker.dtype)
    found, ended = Trajectory(first_pass.refined, no_change), None
    for number, softness in enumerate(ROUNDS):
        person, sights = scaled(tracker.skeleton, jnp.asarray(found.proportions)), []
        for look in looks:
            camera = jax.tree.map(lambda part, c=look.camera: part[c], tracker.cameras)
            there = jax.tree.map(lambda part, e=look.events: np.asarray(part)[e], found.poses)
            sights.append(_sights(person, camera, look, videos[look.camera], there))
            show((number + 0.5 * len(sights) / len(looks)) / len(ROUNDS))
        together = jax.tree.map(lambda *parts: np.concatenate(parts), *sights)
        problem = Problem(
            tracker.skeleton, tracker.cameras, tracker.markers, tracker.settings.over_time,
            first_pass.timeline.event_times, known, together,
        )  # fmt: skip
        ended = smooth_poses(problem, found, softness)
        found = ended.trajectory
        show((number + 1) / len(ROUNDS))
    assert ended is not None
    person = scaled(tracker.skeleton, jnp.asarray(found.proportions))
    return Smoothed(
        person,
        found.poses,
        judge(tracker, person, ended, first_pass.alone, first_pass.markers_world),
    )


def _looks(timeline: Timeline) -> list[Look]:
    """Each camera's events; a frame that serves several events is looked at for each."""
    columns = timeline.frame_index.T
    return [
        Look(camera, np.flatnonzero(column >= 0), column[column >= 0])
        for camera, column in enumerate(columns)
    ]


def _known(tracker: HybridTracker, first_pass: FirstPass) -> Known:
    """What is known of each event besides its sights."""
    times, alone = first_pass.timeline.event_times, first_pass.alone
    R = np.asarray(jax.vmap(quaternion_to_matrix)(jnp.asarray(alone.quaternion, float)))
    ahead = R[:, :2, 0]
    step = np.median(np.diff(times)) if len(times) > 1 else 1.0
    ahead = gaussian_filter1d(ahead, TURNING_S / step, axis=0, mode="nearest")
    ahead = ahead / np.maximum(np.linalg.norm(ahead, axis=1, keepdims=True), 1e-9)
    facing = np.pad(ahead, ((0, 0), (0, 1)))
    points = _landmarks(tracker.skeleton, alone)
    ankles = points[:, [list(LANDMARKS).index(name) for name in ("ankle_l", "ankle_r")]]
    names = [tracker.skeleton.tree.bones[bone] for bone in tracker.markers.bones]
    free = not any(name.startswith(FEET) for name in names)
    feet = np.full(len(times), float(free))
    parts = (first_pass.markers_world, R[:, :2, 2], facing, ankles, feet)
    return Known(*(np.asarray(part, tracker.dtype) for part in parts))


def _landmarks(skeleton: Skeleton, poses: Pose) -> np.ndarray:
    """(E, L, 3) of poses (E, ...)."""
    over = jax.vmap(landmarks, (None, 0))
    return np.asarray(over(skeleton, jax.tree.map(lambda part: jnp.asarray(part, float), poses)))


def _sights(
    skeleton: Skeleton, camera: Camera, look: Look, video: FrameSource, poses: Pose
) -> Sights:
    """Grids of all of one camera's frames, of a background learned from some of them."""
    # The frames' own size: a video may be cropped against its calibration.
    drawing = Drawing.of(skeleton, camera, video.size, poses)
    appearance = _learn(look, video, drawing)
    region = _regions(skeleton, camera, poses)
    grids = [
        _grids(image, appearance, drawing, i, Region(region.origin[i], region.scale[i]))
        for i, image in enumerate(look.frames(video, np.arange(len(look.events))))
    ]
    person, forearms = (
        Grid(*(np.stack(parts) for parts in zip(*each, strict=True)))
        for each in zip(*grids, strict=True)
    )
    cameras = np.full(len(look.events), look.camera)
    return Sights(look.events, cameras, Sight(region, person, forearms))


@dataclass(frozen=True)
class Drawing:
    """The body as poses put it into the shrunk images.

    Attributes:
        discs: (F, K) limbs, pixels of the shrunk images; the radii of all the limbs' ends.
        per_metre: (F,) pixels of a metre at the person.
        size: width and height of the shrunk images.
        ratio: (2,) their size over that of the full ones.
        names: of the K bones.
    """

    discs: Discs
    per_metre: np.ndarray
    size: tuple[int, int]
    ratio: np.ndarray
    names: list[str]

    @classmethod
    def of(
        cls, skeleton: Skeleton, camera: Camera, size: tuple[int, int], poses: Pose
    ) -> "Drawing":
        """The poses (F, ...) in a camera's frames, whose width and height is ``size``."""
        bones = drawn_bones(skeleton.tree)

        def of_pose(pose: Pose) -> tuple[Discs, Array]:
            flesh = cones(skeleton, forward(skeleton, pose), bones)
            ends = to_camera(camera, flesh.near), to_camera(camera, flesh.far)
            plane = project_limb(*ends, flesh.radii)
            depth = jnp.maximum(jnp.mean(ends[0][:, 2]), NEAREST_M)
            radii = plane.radii * camera.matrix[0, 0]
            discs = Discs(to_pixels(camera, plane.near), to_pixels(camera, plane.far), radii)
            return discs, camera.matrix[0, 0] / depth

        small = shrunk_size(size, ROWS)
        ratio = np.divide(small, size)
        there = jax.tree.map(lambda part: jnp.asarray(part, float), poses)
        found, per_metre = jax.device_get(jax.jit(jax.vmap(of_pose))(there))
        near, far = ((end + 0.5) * ratio - 0.5 for end in (found.near, found.far))
        names = [skeleton.tree.bones[bone] for bone in bones]
        return cls(
            Discs(near, far, found.radii * ratio[0]), per_metre * ratio[0], small, ratio, names
        )

    def mask(
        self,
        frame: int,
        share: float,
        more_px: float = 0.0,
        only: Sequence[str] | None = None,
        without: Sequence[str] = (),
        part: tuple[float, float] = (0.0, 1.0),
    ) -> np.ndarray:
        """Limbs (h, w) bool with their radii scaled and enlarged, or a part of their length."""
        kept = [n not in without and (only is None or n in only) for n in self.names]
        near, far, radii = (each[frame][kept] for each in self.discs)
        ends = [near + at * (far - near) for at in part]
        widths = radii[:, :1] + np.array(part) * (radii[:, 1:] - radii[:, :1])
        return draw_hulls(Discs(ends[0], ends[1], widths * share + more_px), self.size)


def _regions(skeleton: Skeleton, camera: Camera, poses: Pose) -> Region:
    """Where (F) the person's upper half is, all at one scale."""
    points = _landmarks(skeleton, poses)
    upper = [i for i, name in enumerate(LANDMARKS) if not name.startswith(BELOW)]
    pixels = np.asarray(project(camera, jnp.asarray(points[:, upper])))
    low, high = pixels.min(1), pixels.max(1)
    side = np.percentile((high - low).max(1), 95) * (1 + 2 * MARGIN)
    origin = np.round((low + high) / 2 - side / 2) - 0.5
    dtype = points.dtype
    return Region(origin.astype(dtype), np.full(len(origin), side / CELLS, dtype))


def _learn(look: Look, video: FrameSource, drawing: Drawing) -> Appearance | None:
    """Background and colours from frames spread over the recording; None if none can be read."""
    chosen = spread(len(look.events))
    pairs = zip(chosen, look.frames(video, chosen), strict=True)
    read = [(i, image) for i, image in pairs if image is not None]
    if not read:
        return None
    which, frames = [i for i, _ in read], np.stack([image for _, image in read])
    cores = np.stack([drawing.mask(i, CORE) for i in which])
    more_px = ERRING_M * drawing.per_metre
    bodies = np.stack([drawing.mask(i, WHEREVER, float(more_px[i])) for i in which])
    background, person = learn_foreground(frames, cores, bodies)
    odds = np.stack([log_odds(frame, background, person) for frame in frames])
    arms = np.stack([drawing.mask(i, CORE, only=FOREARMS[:2], part=BARE) for i in which])
    others = np.stack([drawing.mask(i, CORE, without=(*FOREARMS, *HEAD)) for i in which])
    near = np.stack([drawing.mask(i, 2.0, only=FOREARMS) for i in which])
    rest = others & ~near & (odds > -0.5)
    rest = rest if rest.any() else others
    forearms = learn_colours(frames, arms & (odds > -0.5), ~rest)
    return Appearance(background, person, forearms)


def _grids(
    image: np.ndarray | None, known: Appearance | None, drawing: Drawing, frame: int, region: Region
) -> tuple[Grid, Grid]:
    """The person and the forearms on the grid; nothing known where there is no image."""
    if image is None or known is None:
        nothing = Grid(*np.zeros((2, CELLS, CELLS), np.float32))
        return nothing, nothing
    person = log_odds(image, known.background, known.person)
    head = drawing.mask(frame, HEAD_GROWN, only=HEAD)
    forearms = part_odds(image, person, known.forearms, head)
    # Edges map onto edges.
    origin = (np.asarray(region.origin) + 0.5) * drawing.ratio - 0.5
    cell = float(region.scale) * drawing.ratio[0]
    whole, part = (Grid(*person_grid(odds, origin, cell, CELLS)) for odds in (person, forearms))
    return whole, part
