"""The first pass over a recording, as arrays for the pure functions.

INPUTS: a Recording. OUTPUTS: Events.
"""

import jax
import numpy as np

from jaxmocap.body.motion import landmarks_over_time
from jaxmocap.body.skeleton import ELBOWS
from jaxmocap.capture.footage import cached_frames, forward_readers
from jaxmocap.compilation.arrays import on_device
from jaxmocap.compilation.clock import Clock
from jaxmocap.evidence.appearance.learned import ROWS
from jaxmocap.formats.recordings.recording import Recording
from jaxmocap.hybrid.settings import Settings
from jaxmocap.hybrid.tracker import HybridTracker
from jaxmocap.pipelines.progress import Progress, progress_bar
from jaxmocap.pipelines.tracking.events import RecordingEvents
from jaxmocap.pipelines.tracking.first_pass import scanned
from jaxmocap.pipelines.tracking.track import make_tracker, open_recording
from jaxmocap.smoothing.batch import measurements_of, silhouettes_of
from jaxmocap.smoothing.functions import Events


def first_pass(
    recording: Recording,
    settings: Settings | None = None,
    *,
    progress: Progress | bool | None = None,
    tracker: HybridTracker | None = None,
) -> Events:
    """The events of a recording, and where the tracker puts the body event by event.

    Elbows count as measured at events with a video frame, where the first pass had them. So do the
    silhouettes there, learned as in the second pass of ``track``.

    Args:
        recording: markers, and any number of videos.
        settings: of the tracker; ``refine="none"`` leaves the videos out.
        progress: called with the events done and their total; True shows a bar
            on stderr; None does so on a terminal.
        tracker: of ``make_tracker`` for this recording; its settings hold.

    Raises:
        InputError: a video or key points that cannot be used with the recording.

    Returns:
        T events in the model's dtype: times from the first one on, seconds; world, metres.

    Example:
        >>> from jaxmocap import Recording, Settings, first_pass
        >>> recording = Recording.load("recording.toml")
        >>> events = first_pass(recording, Settings(refine="none"))
        >>> events.measured["markers"].shape == recording.positions_world.shape
        True
    """
    opened = open_recording(recording)
    tracker = tracker or make_tracker(opened.recording, settings)
    used = opened.videos if tracker.model.camera_count else []
    events = RecordingEvents.of(opened.recording, used, "own", opened.cleaning)
    with progress_bar("tracking", progress) as show, forward_readers(used) as readers:
        found = scanned(events, tracker, readers, show, Clock())
    measured = measurements_of(tracker.model, found)
    points = landmarks_over_time(tracker.model.skeleton, found.poses)
    filmed = np.any(found.frame_index >= 0, -1, keepdims=True)[..., None]
    measured["elbows"] = np.where(filmed, points[:, ELBOWS], np.nan)
    grids = silhouettes_of(tracker.model, found, cached_frames(used, ROWS)) if used else None
    parts = (found.times - found.times[0], dict(measured), found.poses, grids)
    dtype = tracker.model.dtype
    return Events(*jax.tree.map(lambda part: on_device(part, dtype), parts))
