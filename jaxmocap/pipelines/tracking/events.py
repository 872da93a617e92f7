"""The events of a recording: what a tracker goes through, and what they lack.

INPUTS: a Recording, its videos. OUTPUTS: RecordingEvents; warnings for the report.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from jaxmocap.capture.filters import Cleaning
from jaxmocap.capture.markers import interpolate_markers
from jaxmocap.capture.timeline import Mode, Timeline, build_timeline
from jaxmocap.capture.video import FrameSource
from jaxmocap.formats.recordings.recording import Recording
from jaxmocap.pipelines.tracking import warnings


@dataclass(frozen=True)
class RecordingEvents:
    """The E events of a recording, from the first sample with a marker to the last sample.

    Attributes:
        recording: what is tracked.
        timeline: its events.
        markers_world: (E, M, 3) there; NaN where missing.
        before: how many samples lie before the first event; none of them has a marker.
        without_video: C of (T,), whether no frame of a camera lies near each sample.
        cleaning: what filters did to the markers, or None.
    """

    recording: Recording
    timeline: Timeline
    markers_world: np.ndarray
    before: int
    without_video: list[np.ndarray]
    cleaning: Cleaning | None = None

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
        without_video = [warnings.without_video(times, video.times, causal) for video in videos]
        return cls(recording, line, markers, first, without_video, cleaning)

    @property
    def times(self) -> np.ndarray:
        """(E,) seconds since the first event."""
        return self.timeline.event_times - self.timeline.event_times[0]

    def image_warnings(self, event: int, images: Sequence[np.ndarray | None]) -> list[str]:
        """Warnings about the images that an event has, one per camera."""
        names = [source.camera_name for source in self.recording.videos][: len(images)]
        due = (self.timeline.frame_index[event] >= 0).tolist()
        return list(warnings.of_images(names, due, images))

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
        yield from warnings.of_markers(self.recording.marker_names, positions)
        yield from self.cleaning.statuses(sample) if self.cleaning else ()
        for source, missing in zip(self.recording.videos, self.without_video, strict=False):
            if missing[sample]:
                yield f"{source.camera_name}: no video frame near this sample"
