"""The events of a recording: what a tracker goes through, and what they lack.

Warnings are sentences that a user reads in the report. They hold no figures, so that the report can
count them.

INPUTS: a Recording; a StepReport, images. OUTPUTS: its open files, RecordingEvents; warnings.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from jaxmocap.body.motion import UNDETERMINED_M
from jaxmocap.calibration.clock_check import check_clocks
from jaxmocap.calibration.static_trial import measured_bones
from jaxmocap.capture.checks.lengths import check_stretched_arms
from jaxmocap.capture.filters import Cleaning, filter_markers
from jaxmocap.capture.footage import open_footage
from jaxmocap.capture.keypoints import open_keypoints
from jaxmocap.capture.markers import interpolate_markers
from jaxmocap.capture.timeline import Mode, Timeline, build_timeline
from jaxmocap.capture.video import FrameSource, open_video
from jaxmocap.evidence.markers import measured_noise
from jaxmocap.formats.recordings.keypoints import Detections
from jaxmocap.formats.recordings.recording import Recording
from jaxmocap.formats.time_series.tables import usual_step
from jaxmocap.hybrid.refine import StepReport
from jaxmocap.images.foreground import is_blank
from jaxmocap.outputs.report import SIDES
from jaxmocap.solvers.status import SENTENCES, Status

# A frame further away than this many of its video's intervals is not near.
NEAR_INTERVALS = 1.5


@dataclass(frozen=True)
class RecordingEvents:
    """The E events of a recording, from the first sample with a marker to the last sample."""

    recording: Recording  # what is tracked
    timeline: Timeline  # its events
    markers_world: np.ndarray  # (E, M, 3) there; NaN where missing
    before: int  # how many samples lie before the first event; none of them has a marker
    without_video: list[np.ndarray]  # C of (T,), whether no frame of a camera lies near each sample
    cleaning: Cleaning | None = None  # what filters did to the markers, or None

    @classmethod
    def of(
        cls,
        recording: Recording,
        videos: Sequence[FrameSource],
        mode: Mode,
        cleaning: Cleaning | None = None,
    ) -> "RecordingEvents":
        """The events of a recording, and the markers at them."""
        times, causal = recording.times, mode == "causal"
        line = build_timeline(times, [video.times for video in videos], mode)
        first = int(np.isfinite(recording.positions_world).all(-1).any(-1).argmax())
        start = int(np.flatnonzero(line.sample_index == first)[0])
        events = slice(start, int(np.flatnonzero(line.sample_index >= 0)[-1]) + 1)
        parts = (line.event_times, line.sample_index, line.frame_index)
        line = Timeline(*(part[events] for part in parts))
        if (line.sample_index >= 0).all():
            # Nothing between the samples: none of them is in memory twice.
            markers = recording.positions_world[first:][: len(line.sample_index)]
        else:
            positions = recording.positions_world
            markers = interpolate_markers(times, positions, line.event_times, causal)
        lacking = [without_video(times, video.times, causal) for video in videos]
        return cls(recording, line, markers, first, lacking, cleaning)

    @property
    def times(self) -> np.ndarray:
        """(E,) seconds since the first event."""
        return self.timeline.event_times - self.timeline.event_times[0]

    def image_warnings(self, event: int, images: Sequence[np.ndarray | None]) -> Iterator[str]:
        """Which of an event's images, one per camera, cannot be read or show nothing."""
        frames = self.timeline.frame_index[event]
        for source, frame, image in zip(self.recording.videos, frames, images, strict=False):
            if frame >= 0 and image is None:
                yield f"{source.camera_name}: the video frame cannot be read"
            elif image is not None and is_blank(image):
                yield f"{source.camera_name}: the video frame is black or blank"

    def sample_warnings(self, of_events: Sequence[Sequence[str]]) -> Iterator[tuple[str, ...]]:
        """Warnings about every sample; what happened since the one before belongs to it."""
        gathered: list[str] = []
        for sample, own in zip(self.timeline.sample_index.tolist(), of_events, strict=True):
            gathered += own
            if sample >= 0:
                yield tuple(dict.fromkeys([*gathered, *self._about_sample(sample)]))
                gathered = []

    def _about_sample(self, sample: int) -> Iterator[str]:
        positions = self.recording.positions_world[sample]
        for name, position in zip(self.recording.marker_names, positions, strict=True):
            if not np.isfinite(position).all():
                yield f"marker {name} is missing"
        yield from self.cleaning.statuses(sample) if self.cleaning else ()
        for source, missing in zip(self.recording.videos, self.without_video, strict=False):
            if missing[sample]:
                yield f"{source.camera_name}: no video frame near this sample"


class Opened(NamedTuple):
    """A recording, its files open and its markers cleaned."""

    recording: Recording  # with cleaned markers
    videos: list[FrameSource]  # one per camera
    keypoints: tuple[Detections | None, ...]  # of each video; None where it has none
    cleaning: Cleaning  # what filters did to the markers
    noise: float  # white, in each coordinate of the markers, metres
    warnings: tuple[str, ...]  # for the user


def open_recording(recording: Recording, mode: Mode = "own") -> Opened:
    """Open a recording's videos and key points, and clean its markers.

    All that can be wrong with them is found before anything takes its time.

    Raises:
        InputError: a video or key points that cannot be used with the recording.
    """
    videos, warnings = open_footage(recording.require_markers())
    if recording.path is not None and recording.videos:
        stretched = check_stretched_arms(recording, measured_bones(recording.path))
        warnings += tuple(f"{recording.path}: {finding.sentence}" for finding in stretched)
    recording, cleaning = filter_markers(recording, causal=mode == "causal")
    warnings += cleaning.warnings
    noise = measured_noise(recording.times, recording.positions_world)
    keypoints = tuple(map(open_keypoints, recording.videos, videos))
    warnings += tuple(warning for each in keypoints if each for warning in each.warnings)
    return Opened(recording, videos, keypoints, cleaning, noise, warnings)


def with_checked_clocks(opened: Opened, corrects: bool) -> Opened:
    """The same with warnings about the videos' clocks; where asked for, by the offsets found."""
    recording, warnings = check_clocks(opened.recording, opened.videos)
    if warnings and corrects:
        opened = opened._replace(
            recording=recording, videos=[open_video(source) for source in recording.videos]
        )
    return opened._replace(warnings=opened.warnings + warnings)


def step_warnings(report: StepReport) -> Iterator[str]:
    """What the tracker did to the body."""
    if report.placed:
        yield "the body was placed again"
    if report.planted:
        yield "the feet were planted again"
    if sentence := SENTENCES[Status(int(report.status))]:
        yield f"the refinement {sentence}"


def elbow_warnings(deviations: np.ndarray) -> Iterator[str]:
    """Which of the two elbows nothing determines, by their deviations (2,), metres."""
    for side, value in zip(SIDES, deviations, strict=True):
        if value > UNDETERMINED_M:
            yield f"{side} elbow: not determined within {100 * UNDETERMINED_M:.0f} cm"


def without_video(times: np.ndarray, video_times: np.ndarray, causal: bool = False) -> np.ndarray:
    """(T,) whether no frame lies near each of the samples at (T,) seconds."""
    after = np.searchsorted(video_times, times, side="right")
    padded = np.concatenate([[-np.inf], video_times, [np.inf]])
    away = times - padded[after]
    if not causal:
        away = np.minimum(away, padded[after + 1] - times)
    return away > NEAR_INTERVALS * usual_step(video_times)
