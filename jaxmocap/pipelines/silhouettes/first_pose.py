"""How silhouettes begin: where a person is, by the markers' first samples or as stated.

INPUTS: a Recording; a place; what is asked for. OUTPUTS: a Pose of the whole body; a Morphing.
"""

from pathlib import Path

import numpy as np

from jaxmocap.body.model import marker_sites
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton, with_joints
from jaxmocap.body.surfaces.loft import generic_surface
from jaxmocap.body.surfaces.morphing import Morphing, shoulders
from jaxmocap.body.surfaces.surface import Surface
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.recordings.morphing import read_morphing
from jaxmocap.formats.recordings.recording import Recording
from jaxmocap.formats.time_series.tables import usual_step
from jaxmocap.geometry.cameras import depth, project
from jaxmocap.hybrid.settings import Settings as Hybrid
from jaxmocap.hybrid.tracker import HybridTracker
from jaxmocap.pipelines.silhouettes.keypoints import has_keypoints
from jaxmocap.silhouette.first_pose import landmark_points, pose_at_landmarks, standing_pose_at
from jaxmocap.silhouette.settings import Settings

# Where the markers are so soon after a video has begun, the person is, seconds.
SOON_S = 0.5


def morphing_for(
    skeleton: Skeleton, surface: Surface | None, go_along: bool, file: str | Path | None
) -> Morphing:
    """What goes along with the joints of a person.

    Shoulders with raised arms, or what a file has, such as ``body/data/shoulder.toml``.

    Raises:
        InputError: the file cannot be used, or the body's shoulders cannot go along.
    """
    if file is None:
        morphing = shoulders() if go_along else Morphing()
        joints = skeleton.tree.joints
        if any(follower.joint not in joints for follower in morphing.followers):
            problem = "the body has no joints of the clavicles, expected torso, whole or supple"
            raise InputError("--shoulders", problem)
        return morphing
    worn = generic_surface(skeleton) if surface is None else surface
    return read_morphing(file, skeleton.tree, worn.patches)


def start_pose(
    recording: Recording, at: tuple[float, float, float] | None = None, body: str = Settings.body
) -> Pose | None:
    """The first pose; None where only the videos' key points say it.

    Args:
        recording: with or without markers.
        at: x and y in metres and the direction that the person faces, degrees from x towards y,
            for somebody who stands upright; without it as the markers are.
        body: file whose joints move the person.

    Raises:
        InputError: neither a place nor markers nor key points, or a place at which no camera looks.
    """
    skeleton = with_joints(recording.skeleton, body)
    if at is not None:
        x, y, _ = np.array([*at[:2], 0.0]) - recording.origin_world
        pose = standing_pose_at(skeleton, x, y, np.radians(at[2]))
    elif not recording.places:
        if has_keypoints(recording):
            return None
        problem = "no [markers] to begin from, expected --at X,Y,FACING of a person who stands"
        raise recording.error(f"{problem} upright, or key points ('jaxmocap keypoints')")
    else:
        pose = _by_markers(recording, skeleton)
    if recording.videos and not in_view(recording, skeleton, pose):
        x, y, _ = np.asarray(pose.position) + recording.origin_world
        names = ", ".join(source.camera_name for source in recording.videos)
        problem = f"the person begins at x = {x:.2f}, y = {y:.2f} m, where no camera looks"
        raise recording.error(f"{problem}, expected a place that one of {names} sees")
    return pose


def in_view(recording: Recording, skeleton: Skeleton, pose: Pose) -> bool:
    """Whether any camera sees any landmark of a skeleton's pose."""
    points = landmark_points(skeleton, pose)
    for source in recording.videos:
        depths = np.asarray(depth(source.camera, points))
        pixels = np.asarray(project(source.camera, points))
        within = ((pixels >= 0) & (pixels < np.asarray(source.camera.size))).all(1)
        if (within & (depths > 0)).any():
            return True
    return False


def _by_markers(recording: Recording, body: Skeleton) -> Pose:
    """The pose that the markers' inverse kinematics finds as the first video begins.

    Of the samples within ``SOON_S`` then the first that has most markers; of all, if these have
    none.
    """
    count = np.isfinite(recording.positions_world).all(-1).sum(1)
    begins = [
        source.offset + (0.0 if source.frames is None else float(source.frames[0][0]))
        for source in recording.videos
    ]
    since = recording.times - min(begins, default=0.0)
    soon = np.where((since >= -usual_step(recording.times)) & (since <= SOON_S), count, 0)
    first = recording.positions_world[int(np.argmax(soon if soon.any() else count))]
    skeleton = recording.skeleton
    tracker = HybridTracker(skeleton, None, Hybrid(), marker_sites(skeleton, recording.places))
    points = landmark_points(tracker.model.skeleton, tracker.init(first).pose)
    return pose_at_landmarks(body, np.asarray(points))
