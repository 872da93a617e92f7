"""The hybrid tracker as pure functions of arrays: no memory, differentiable, jit and vmap.

Each checks its arguments and is one compiled program, alone or within another.

    solve      markers -> the pose at the optimum of inverse kinematics
    observe    images -> fields, on the host (OpenCV)
    refine     pose, fields -> the pose whose arms lie on the edges
    landmarks  pose -> points
    smooth     all events of a recording -> all poses at once

``HybridTracker`` calls the same frame after frame, with a memory.

INPUTS: a Model, Settings, markers, images. OUTPUTS: poses, points.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body import kinematics
from jaxmocap.body.arms import Arms, arms_of
from jaxmocap.body.kinematics import forward, site_positions
from jaxmocap.body.model import Model
from jaxmocap.body.pose import Pose, difference, retract
from jaxmocap.compilation.arguments import (
    check_kind,
    check_shape,
    is_traced,
)
from jaxmocap.compilation.programs import Program, program
from jaxmocap.evidence.edges import EdgeFields, WeightedEdges
from jaxmocap.evidence.markers import Goals
from jaxmocap.evidence.shapes import (
    check_arguments,
    check_markers,
    check_model,
    check_pose,
    in_precision,
)
from jaxmocap.hybrid.elbow_search import no_belief
from jaxmocap.hybrid.feet import standing
from jaxmocap.hybrid.fit import Aims, arms_at_minimum, refine_arms, refine_body
from jaxmocap.hybrid.ik import goals_of, solve_ik
from jaxmocap.hybrid.observe import arm_regions, edge_fields, images_of, no_thresholds
from jaxmocap.hybrid.refine import follow_elbows, search_elbows
from jaxmocap.hybrid.settings import Settings
from jaxmocap.hybrid.step import nowhere
from jaxmocap.images.regions import Region
from jaxmocap.smoothing.functions import Events, SmoothMotion, check_events, smooth_events


def landmarks(model: Model, pose: Pose) -> Array:
    """Positions (L, 3) of the ``LANDMARKS``, in their order, world, metres, of the model's dtype.

    Raises:
        TypeError, ValueError: no pose of this skeleton, or several at once.

    Example:
        >>> from jaxmocap import LANDMARKS, Model, Skeleton, landmarks
        >>> from jaxmocap.body.pose import relaxed_pose
        >>> model = Model.create(Skeleton.human(1.75))
        >>> points_world = landmarks(model, relaxed_pose(model.skeleton))
        >>> points_world.shape == (len(LANDMARKS), 3)
        True
    """
    model = check_model(model)
    pose = check_pose("pose", model, pose)
    return _LANDMARKS(model.skeleton, pose)


_LANDMARKS = Program(kinematics.landmarks, "landmarks", effort="quick")


def solve(
    model: Model, settings: Settings, markers_world: Array | np.ndarray, start: Pose | None = None
) -> Pose:
    """Markers to the pose at the optimum of inverse kinematics (section 4).

    It is the minimum of the markers' goals and of the secondary task within the joints' limits.
    The derivatives are the minimum's, by the implicit function theorem: by the model, the settings,
    the markers and, where there is one, the start. What no marker determines is at ease. With a
    start it stays near that, as ``settings.ik.memory`` says: this is the step of ``HybridTracker``.

    Args:
        model: of the person and M markers.
        settings: ``ik`` of them is read.
        markers_world: (M, 3) any real numbers or lists of them, world, metres; NaN where missing.
        start: the last pose, whose feet stand; without it the body is placed by the markers.

    Returns:
        The pelvis in the world, metres and a unit quaternion, and (D,) angles, radians, of the
        model's dtype.

    Raises:
        TypeError, ValueError: other markers than the model's (M, 3), several samples at once.

    Example:
        >>> from jaxmocap import Model, Settings, Skeleton, solve
        >>> model = Model.create(Skeleton.human(1.75))  # markers: head and both wrists
        >>> markers_world = [[0, 0, 1.7], [0.3, 0.3, 1.0], [0.3, -0.3, 1.1]]
        >>> pose = solve(model, Settings(), markers_world)
        >>> pose.angles.shape
        (21,)
    """
    model, settings = check_arguments(model, settings, Settings)
    markers = check_markers(model, markers_world)
    return _solve_pose(model, settings, markers, start and check_pose("start", model, start))


@program("quick")
def _solve_pose(model: Model, settings: Settings, markers: Array, start: Pose | None) -> Pose:
    before = nowhere(model) if start is None else (start, standing(model, start))
    return solve_ik(model, settings.ik, *before, markers).pose


class Observation(NamedTuple):
    """What images show about a pose: measurements, by each of which ``refine`` is differentiable.

    Attributes:
        edges: distance fields of both arms, and how much each point of an outline counts.
        elbows: (2, 3) where the search over the fields expects the elbows, world, metres.
    """

    edges: WeightedEdges
    elbows: Array


def observe(
    model: Model,
    settings: Settings,
    pose: Pose,
    images: np.ndarray | Sequence[np.ndarray | None] | None,
) -> Observation:
    """What images show around the arms of a pose; on the host, by OpenCV.

    Args:
        model: of the person, the markers and C cameras.
        settings: of the tracker.
        pose: of the markers.
        images: BGR or grey uint8 of each camera, None where there is none; of one camera alone, it.

    Raises:
        TypeError, ValueError: other than one image a camera, or a pose of another skeleton.

    Example:
        >>> import numpy as np
        >>> from jaxmocap import Model, Recording, Settings, observe
        >>> from jaxmocap.body.pose import relaxed_pose
        >>> model = Model.of(Recording.load("recording.toml"))
        >>> settings, pose = Settings(refine="search"), relaxed_pose(model.skeleton)
        >>> observe(model, settings, pose, np.zeros((480, 640), np.uint8)).elbows.shape
        (2, 3)
    """
    model, settings = check_arguments(model, settings, Settings)
    pose = check_pose("pose", model, pose)
    if model.cameras is None:
        raise ValueError("model.cameras: found None, expected at least one camera")
    each = images_of(model.cameras, images)
    region = _regions(model, settings, pose)
    fields, _ = edge_fields(settings, no_thresholds(model.camera_count), each, region)
    return _search_elbows(model, settings, pose, in_precision(model, fields))


@program("quick")
def _regions(model: Model, settings: Settings, pose: Pose) -> Region:
    assert model.cameras is not None
    arms = _arms(model, pose)
    return arm_regions(model.cameras, arms, settings.samples, settings.margin, settings.spacing)


@program("quick")
def _search_elbows(model: Model, settings: Settings, pose: Pose, fields: EdgeFields) -> Observation:
    """The fields, where the search has the elbows, and the outlines as they then show."""
    arms, belief = _arms(model, pose), no_belief(settings.elbow_search, pose)
    elbows = arms.elbow
    if settings.search:
        _, elbows = search_elbows(model, settings, arms, fields, belief)
    followed = _follow_elbows(model, settings, pose, elbows)
    return Observation(settings.edges.weigh(model, fields, followed), elbows)


def refine(model: Model, settings: Settings, pose: Pose, observation: Observation) -> Pose:
    """The pose whose arms lie on the edges that were observed (section 5.2).

    Markers stay where the pose has them. With ``settings.refine`` "gradient" the whole body goes to
    the minimum of ``settings.gradient_terms`` (the tracker ends near it, where its method, steps
    and tolerance say). With "simplex" the body follows the elbows, and each arm goes where the
    downhill simplex ends. Its iterations have no derivative; the minimum
    beside which it ends has one, by the cost's own Hessian, and 0 in directions in which it is not
    curved upwards. With "search" the body follows the elbows only. With "none", or without an
    image, the pose stays.

    Args:
        model: of the person, the markers and the cameras.
        settings: of the tracker; ``refine`` of them is static.
        pose: of the markers.
        observation: of ``observe``, by the same cameras and settings.

    Raises:
        TypeError, ValueError: a pose of another skeleton, an observation of other cameras.

    Example:
        >>> from jaxmocap import Model, Recording, Settings, observe, refine
        >>> from jaxmocap.body.pose import relaxed_pose
        >>> model = Model.of(Recording.load("recording.toml"))
        >>> settings, pose = Settings(refine="search"), relaxed_pose(model.skeleton)
        >>> observation = observe(model, settings, pose, None)
        >>> refine(model, settings, pose, observation).angles.shape
        (21,)
    """
    model, settings = check_arguments(model, settings, Settings)
    pose = check_pose("pose", model, pose)
    if settings.refine == "none" or model.cameras is None:
        return pose
    return _refine_pose(model, settings, pose, _check_observation(model, settings, observation))


@program("quick")
def _refine_pose(model: Model, settings: Settings, pose: Pose, observed: Observation) -> Pose:
    held = jax.lax.stop_gradient((model, settings, pose, observed.elbows))
    followed = _follow_elbows(*held)
    if settings.refine == "search":
        refined = _going_along(pose, followed)
    elif settings.refine == "gradient":
        aims = Aims(_own_goals(model, settings, pose), observed.elbows, pose, None)
        refined, _ = refine_body(model, settings, observed.edges, followed, aims, exact=True)
    else:
        refined = _by_simplex(model, settings, pose, observed, followed)
    has_image = jnp.any(jnp.asarray(observed.edges.fields.available))
    return jax.tree.map(lambda new, old: jnp.where(has_image, new, old), refined, pose)


def _follow_elbows(model: Model, settings: Settings, pose: Pose, elbows: Array) -> Pose:
    """The body with its elbows where they are expected, its markers held."""
    if not settings.search:
        return pose
    goals = _own_goals(model, settings, pose)
    return follow_elbows(model, settings, goals, pose, None, elbows)


def _by_simplex(
    model: Model, settings: Settings, pose: Pose, observed: Observation, start: Pose
) -> Pose:
    fields, grip = observed.edges.fields, _arms(model, pose).grip
    held = jax.lax.stop_gradient((model, settings, fields, start, grip, observed.elbows))
    found = _going_along(pose, refine_arms(*held))
    start = _going_along(pose, start)
    return arms_at_minimum(model, settings, fields, start, grip, observed.elbows, found)


def _going_along(pose: Pose, end: Pose) -> Pose:
    """The end, which moves as the pose does: what the body did to get there is held."""
    return retract(pose, jax.lax.stop_gradient(difference(end, pose)))


def smooth(model: Model, settings: Settings, events: Events) -> SmoothMotion:
    """All poses at once, by what was measured and because people move smoothly.

    See ``smoothing.functions.smooth_events``; ``settings.smoothing`` is read.

    Args:
        model: of the person and the markers.
        settings: of the tracker.
        events: of ``first_pass``, or of one's own arrays.

    Returns:
        T poses, and (T, L, 3) landmarks, world, metres, of the model's dtype.

    Raises:
        TypeError, ValueError: fewer than 3 events, times that do not ascend, or an array without a
            row for each of them.

    Example:
        >>> from jaxmocap import Model, Recording, Settings, first_pass, smooth
        >>> recording = Recording.load("recording.toml")
        >>> settings = Settings(refine="none")
        >>> events = first_pass(recording, settings)
        >>> motion = smooth(Model.of(recording), settings, events)
        >>> motion.joints()["elbow_r"].shape == (len(events.times), 3)
        True
    """
    model, settings = check_arguments(model, settings, Settings)
    motion = _SMOOTH(model, settings.smoothing, check_events(model, events))
    return motion if is_traced(events.times) else motion._replace(times=events.times)


_SMOOTH = Program(smooth_events, "smooth", effort="quick")


def _check_observation(model: Model, settings: Settings, observation: Any) -> Observation:
    """What ``observe`` found of this model's cameras, by these settings."""
    check_kind("observation", observation, Observation)
    C, K, S = model.camera_count, settings.directions, settings.samples
    distances, elbows = np.shape(observation.edges.fields.distances), np.shape(observation.elbows)
    check_shape("observation.edges.fields.distances", distances, (C, 2, K, S, S), model)
    check_shape("observation.elbows", elbows, (2, 3))
    return in_precision(model, observation)


def _own_goals(model: Model, settings: Settings, pose: Pose) -> Goals:
    """The pose's own points of markers and unmarked feet, to be held."""
    points = site_positions(model.skeleton, forward(model.skeleton, pose), model.markers)
    return goals_of(model, settings.ik, standing(model, pose), points)


def _arms(model: Model, pose: Pose) -> Arms:
    return arms_of(model.skeleton, forward(model.skeleton, pose), model.grips)
