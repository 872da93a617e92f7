"""The track between a window's events: poses of the samples that lie between, near their markers.

INPUTS: WindowEvents, samples, corrections. OUTPUTS: poses to be given out.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.kinematics import forward, jacobian, site_positions
from jaxmocap.body.model import Model
from jaxmocap.body.pose import Pose, difference, pack, retract, unpack
from jaxmocap.body.tree import ROOT_DOF
from jaxmocap.compilation.batches import in_batches
from jaxmocap.compilation.programs import program
from jaxmocap.evidence.markers import are_present, off_targets
from jaxmocap.smoothing.window.events import WindowEvent
from jaxmocap.solvers.sdls import clamp_lengths, damped_step

# Poses per call, so that they compile once.
TRACK_A_CALL = 4
# Samples farther apart are a gap, seconds.
LONGEST_INTERVAL_S = 0.1
# In place of the seconds to an event that is not there.
ENDLESS_S = 1e6
# No point ends farther off its marker than this, metres. A limb that is pulled shakes its elbow.
# The head's is two degrees at an orientation's lever.
STRAY_M, HEAD_STRAY_M = 0.006, 0.004
# Deviations count them as so far off, metres.
OFF_MARKERS_M = 0.004
# Steps that bring points back, how far one goes at most, metres, and their damping, metres: enough
# for a stretched arm. A hand that is back from elsewhere would take the head along in one step.
HOLDING_STEPS = 3
HOLDING_STEP_M = 0.3
HOLDING_DAMPING = 0.03
# Pelvis and trunk follow so many times less than the limbs.
TRUNK_STIFFNESS = 10.0


class Sample(NamedTuple):
    """A step that brought markers: its number, seconds, (M, 3) metres; NaN where missing."""

    number: int
    time: float
    markers_world: np.ndarray


def markers_at(samples: Sequence[Sample], times: np.ndarray) -> np.ndarray:
    """Markers (E, M, 3), metres, at each of some times, on a cubic between each one's own samples.

    Beyond its last one straight on. NaN where its samples about the time are farther apart than
    ``LONGEST_INTERVAL_S``, or the last one is more than an interval ago.

    Args:
        samples: the newest, in order of time, at least one.
        times: (E,) seconds.
    """
    own_times = np.array([each.time for each in samples])
    points = np.stack([each.markers_world for each in samples])
    present = np.asarray(np.isfinite(points).all(-1))
    if present.all():
        return _on_cubic(own_times, points, times)
    # A device that is missing, or has packets of its own.
    own = [present[:, marker] for marker in range(points.shape[1])]
    each = [_on_cubic(own_times[o], points[o, m], times) for m, o in enumerate(own)]
    return np.stack(each, 1)


def _on_cubic(own_times: np.ndarray, points: np.ndarray, times: np.ndarray) -> np.ndarray:
    """``markers_at``, (E, ...), of points (S, ...) that are all present at their times (S,)."""
    if len(own_times) < 2:
        return np.full((len(times), *points.shape[1:]), np.nan)
    last = len(own_times) - 1
    start = np.clip(np.searchsorted(own_times, times, side="right"), 1, last) - 1
    rows = np.clip(start[:, None] + np.arange(-1, 3), 0, last)
    spans, ways = np.diff(own_times[rows]).T, np.diff(points[rows], axis=1).swapaxes(0, 1)
    share = (times - own_times[start]) / spans[1]
    is_near = (spans[1] <= LONGEST_INTERVAL_S) & (share >= -1) & (share <= 2)
    spans = np.where((spans > 0) & (spans <= LONGEST_INTERVAL_S), spans, ENDLESS_S)
    column = len(times), *[1] * (points.ndim - 1)
    t, s, near = spans.reshape(3, *column), share.reshape(column), is_near.reshape(column)
    first, way, last_way = ways
    on = np.where((s > 1) | (s < 0), s * way, cubic_step(first, way, last_way, t, s))
    return np.where(near, points[start] + on, np.nan)


def update_frames_markers(events: Sequence[WindowEvent], samples: Sequence[Sample]) -> None:
    """Give events that are no samples, frames between them, the markers that lie there.

    Args:
        events: of the window; those of a sample, and those before all of these, stay as they are.
        samples: the newest, in order of time.
    """
    if not samples:
        return
    numbers, first = {sample.number for sample in samples}, samples[0].time
    between = [each for each in events if each.time >= first and each.number not in numbers]
    if not between:
        return
    there = markers_at(samples, np.array([event.time for event in between]))
    for event, markers in zip(between, there, strict=True):
        event.markers_world = markers.astype(event.markers_world.dtype)


class TrackPose(NamedTuple):
    """A pose on the track between two events of a window, or on one of them."""

    number: int  # of the step, counted from 0
    time: float  # of it, seconds
    events: np.ndarray  # (4, 7 + D) packed poses of the two events before and the two after it
    # (3,) seconds between them; endless where there is no further event on that side.
    spans: np.ndarray
    share: float  # of the way between the middle two
    markers_world: np.ndarray  # (M, 3) metres; NaN where missing
    offset: np.ndarray = np.zeros(0)  # (6 + D,) to be moved by


def at_event(event: WindowEvent) -> TrackPose:
    """An event's own pose, before corrections."""
    there = np.stack([np.concatenate(event.pose)] * 4)
    spans, markers = np.full(3, ENDLESS_S), event.markers_world
    return TrackPose(event.number, event.time, there, spans, 0.0, markers)


def between_events(
    events: Sequence[WindowEvent],
    i: int,
    samples: Sequence[Sample],
) -> list[TrackPose]:
    """Samples before the ith event of a window, or straight on beyond the last one, likewise.

    Args:
        events: of the window.
        i: which; as many as there are for none of them.
        samples: that lie there.
    """
    if not samples:
        return []
    last = len(events) - 1
    end = min(i, last)
    start = max(end - 1, 0)
    sides = (max(start - 1, 0), min(end + 1, last)) if i <= last else (start, end)
    rows = [sides[0], start, end, sides[1]]
    times = np.array([events[row].time for row in rows])
    spans = np.where(np.diff(rows) > 0, np.diff(times), ENDLESS_S)
    poses = np.stack([np.concatenate(events[row].pose) for row in rows])
    return [
        TrackPose(number, time, poses, spans, (time - times[1]) / spans[1], markers)
        for number, time, markers in samples
    ]


def track_poses(model: Model, track: Sequence[TrackPose]) -> np.ndarray:
    """Packed poses (G, 7 + D), moved by their offsets, near their markers (``move_near_markers``).

    Args:
        model: M markers, D degrees of freedom.
        track: where they lie.
    """
    columns = zip(*(tuple(each)[2:] for each in track), strict=True)
    stacks = tuple(np.stack(column).astype(model.dtype) for column in columns)
    (poses,) = in_batches(lambda *some: (_track_poses(model, *some),), stacks, TRACK_A_CALL)
    return poses.astype(model.dtype)


@program("quick")
def _track_poses(
    model: Model,
    events: Array,
    spans: Array,
    share: Array,
    markers_world: Array,
    offset: Array,
) -> Array:
    """``track_poses`` of stacks."""

    def one(
        events: Array, spans: Array, share: Array, markers_world: Array, offset: Array
    ) -> Array:
        earlier, before, after, later = (unpack(each) for each in events)
        ways = (difference(before, earlier), difference(after, before), difference(later, after))
        there = retract(before, cubic_step(*ways, spans, share))
        return pack(move_near_markers(model, there, offset, markers_world))

    return jax.vmap(one)(events, spans, share, markers_world, offset)


def cubic_step(first: Any, way: Any, last: Any, spans: Any, share: Any) -> Any:
    """From the second of four places to one on a cubic between it and the third.

    Its slopes at those two are those of the parabolas through three of the four (Hermite's
    interpolation). On straight lines every second sample would jerk.

    Args:
        first: from the first place to the second.
        way: from the second to the third.
        last: from the third to the fourth.
        spans: seconds of these three.
        share: of the way.
    """
    t_first, t_way, t_last = spans

    def slope(beside: Any, t_beside: Any) -> Any:
        """At the end that another way adjoins, times the seconds of this one."""
        of_beside = t_way / (t_beside + t_way)
        return of_beside * beside * (t_way / t_beside) + (1 - of_beside) * way

    s = share
    return (
        s * (1 - s) ** 2 * slope(first, t_first)
        + s**2 * (3 - 2 * s) * way
        - s**2 * (1 - s) * slope(last, t_last)
    )


def move_near_markers(
    model: Model,
    pose: Pose,
    offset: Array,
    markers_world: Array,
) -> Pose:
    """A pose moved by a tangent vector, and its points near to their markers.

    What is near is left where it goes: a track that is continuous stays so.

    Args:
        model: M markers, D degrees of freedom.
        pose: to be moved.
        offset: (6 + D,) to move it by.
        markers_world: (M, 3) metres, to which points come as near as ``STRAY_M``. NaN where one is
            missing; its point goes along.
    """
    skeleton, sites = model.skeleton, model.markers
    pose = retract(pose, offset)
    points = site_positions(skeleton, forward(skeleton, pose), sites)
    of_head = np.isin(sites.bone_indices, skeleton.tree.bones_in("spine", "head"))
    stray = jnp.where(of_head, HEAD_STRAY_M, STRAY_M)[:, None]
    goals = markers_world + clamp_lengths(points - markers_world, stray)
    return on_markers(model, pose, goals)


def on_markers(model: Model, pose: Pose, markers_world: Array) -> Pose:
    """A pose moved as little as brings its points to markers (M, 3); NaN where one is missing."""
    skeleton, sites = model.skeleton, model.markers
    trunk = [group == "spine" for group in skeleton.tree.groups_of_joints]
    is_trunk = np.r_[np.ones(ROOT_DOF, bool), trunk]
    stiff = jnp.where(is_trunk, TRUNK_STIFFNESS, jnp.ones_like(skeleton.costs))

    def step(_: int, pose: Pose) -> Pose:
        frames = forward(skeleton, pose)
        points = site_positions(skeleton, frames, sites)
        present = are_present(markers_world)[:, None, None]
        J = jnp.where(present, jacobian(skeleton, frames, sites.bones, points) / stiff, 0.0)
        back = clamp_lengths(-off_targets(points, markers_world), HOLDING_STEP_M)
        J = J.reshape(-1, J.shape[-1])
        return retract(pose, damped_step(J, back.ravel(), HOLDING_DAMPING) / stiff)

    return jax.lax.fori_loop(0, HOLDING_STEPS, step, pose)
