"""Where a person is as silhouettes begin: by the markers' first samples, or as somebody says.

INPUTS: a Recording; a place. OUTPUTS: a Pose of the whole body.
"""

import jax
import numpy as np

from jaxmocap.body.kinematics import landmarks
from jaxmocap.body.pose import Pose
from jaxmocap.formats.errors import InputError
from jaxmocap.formats.recording import Recording
from jaxmocap.hybrid.settings import Settings
from jaxmocap.hybrid.tracker import HybridTracker
from jaxmocap.run.recording import marker_sites
from jaxmocap.run.silhouette import whole_body
from jaxmocap.silhouette.start import pose_at, standing_pose

# Solves of one and the same sample, until it rests.
SOLVES = 5


def start_pose(recording: Recording, at: tuple[float, float, float] | None = None) -> Pose:
    """The first pose.

    Args:
        recording: with or without markers.
        at: x and y in metres and the direction that the person faces, degrees from x towards y,
            for somebody who stands upright; without it the markers say.

    Raises:
        InputError: neither a place nor markers.
    """
    if at is not None:
        return standing_pose(whole_body(recording.skeleton), at[0], at[1], np.radians(at[2]))
    if not recording.places:
        raise InputError(
            recording.path or recording.name,
            "no [markers] to begin from, expected --at X,Y,FACING of a person who stands upright",
        )
    return _by_markers(recording)


def _by_markers(recording: Recording) -> Pose:
    """The pose that the markers' inverse kinematics finds in the first sample that has most."""
    seen = np.isfinite(recording.positions_world).all(-1).sum(1)
    first = recording.positions_world[int(np.argmax(seen))]
    skeleton = recording.skeleton
    sites = marker_sites(skeleton, recording.places)
    tracker = HybridTracker(skeleton, None, Settings(), sites)
    state = tracker.init(first)
    for _ in range(SOLVES):
        state = tracker.step(state, 0.0, first)[0]
    points = jax.jit(landmarks)(tracker.skeleton, state.pose)
    return pose_at(whole_body(skeleton), np.asarray(points))
