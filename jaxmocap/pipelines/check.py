"""What ``check`` reports of a recording: the person, the markers, what each camera sees of them.

INPUTS: a Recording. OUTPUTS: plain text; a dict for JSON; InputError where tracking is hopeless.
"""

from dataclasses import asdict, dataclass
from itertools import islice
from typing import Any

import numpy as np

from jaxmocap.body.subject import skeleton_stature
from jaxmocap.calibration.clock_check import check_clocks
from jaxmocap.calibration.static_trial import measured_bones
from jaxmocap.capture.checks import Finding
from jaxmocap.capture.checks.cameras import MarkerVisibility, check_recording, marker_visibility
from jaxmocap.capture.checks.lengths import bone_list, check_stretched_arms
from jaxmocap.capture.filters import BUTTERWORTH, check_cutoff
from jaxmocap.capture.footage import open_unchecked
from jaxmocap.capture.keypoints import open_keypoints
from jaxmocap.capture.photographs import read_empty_room
from jaxmocap.formats.recordings.recording import Recording
from jaxmocap.formats.time_series.tables import usual_step

# Frames of a video that are decoded, from its first: 100 s at 30 Hz.
MOST_DECODED = 3000


@dataclass(frozen=True)
class RecordingCheck:
    """What was found in a recording: fatal findings first, what each camera sees of the markers."""

    recording: Recording
    findings: list[Finding]
    views: list[MarkerVisibility]
    warnings: tuple[str, ...]
    measured_bones: tuple[str, ...] = ()

    def figures(self) -> dict[str, Any]:
        """Plain figures: metres, seconds, samples per second."""
        times, interval = self.recording.times, usual_step(self.recording.times)
        used = self.recording.marker_set
        return {
            "stature_m": skeleton_stature(self.recording.skeleton),
            "measured_bones": list(self.measured_bones),
            "samples": len(times),
            "start_s": float(times[0]),
            "end_s": float(times[-1]),
            "rate_hz": 1 / interval if interval else None,
            "markers": list(self.recording.marker_names),
            "marker_set": used
            and {
                "name": used.name,
                "found": list(used.entries),
                "missing": list(used.missing),
                "unused": list(used.unused),
            },
            "cameras": [asdict(view) for view in self.views],
            "findings": [asdict(finding) for finding in self.findings],
            "warnings": list(self.warnings),
        }

    def text(self) -> str:
        """The same figures as lines of text."""
        figures = self.figures()
        rate = f" at {figures['rate_hz']:.4g} Hz" if figures["rate_hz"] else ""
        # The first error ends the command, with its sentence.
        others = self.findings[bool(self.findings and self.findings[0].fatal) :]
        lines = [
            f"person   {figures['stature_m']:.2f} m tall",
            f"lengths  {self._lengths()}",
            f"markers  {', '.join(figures['markers'])}: {figures['samples']} samples{rate}, "
            f"{figures['start_s']:.2f} to {figures['end_s']:.2f} s",
            *([f"set      {used.sentence()}"] if (used := self.recording.marker_set) else []),
            *(
                f"camera   {view.camera}: {view.distance_m:.2f} m from the markers, of which "
                f"{_shown(view)}, during {100 * view.covered_share:.0f} % of the samples"
                for view in self.views
            ),
            *(f"warning  {sentence}" for sentence in self.warnings),
            *(f"{'error' if f.fatal else 'warning':7}  {f.sentence}" for f in others),
        ]
        is_sound = not (self.findings or self.warnings)
        return "\n".join([*lines, "nothing wrong was found"] if is_sound else lines)

    def _lengths(self) -> str:
        """Which bones' lengths were measured and which follow from the height."""
        if not self.measured_bones:
            return "all by the height"
        bones = self.recording.skeleton.tree.bones
        rest = [bone for bone in bones if bone not in self.measured_bones]
        parts = {"measured": self.measured_bones, "by the height": rest}
        return "; ".join(f"{basis}: {bone_list(each)}" for basis, each in parts.items() if each)

    def raise_if_fatal(self) -> None:
        """InputError with the first finding, if it is fatal."""
        if self.findings and self.findings[0].fatal:
            raise self.recording.error(self.findings[0].sentence)


def _shown(view: MarkerVisibility) -> str:
    """How much a camera shows of the markers that are measured while it films, if any is."""
    if np.isnan(view.shown_share):
        return "none is measured while it films"
    return f"it shows {100 * view.shown_share:.0f} %"


def check(recording: Recording) -> RecordingCheck:
    """Check a recording as ``track`` does before it begins, and what its videos hold.

    Raises:
        InputError: a file of it cannot be used.
    """
    videos, warnings = open_unchecked(recording.require_markers())
    if recording.filters.butterworth is not None:
        check_cutoff(recording, recording.filters.butterworth, BUTTERWORTH)
    times = [video.times for video in videos]
    for source, video in zip(recording.videos, videos, strict=True):
        if source.background is not None:
            read_empty_room(source.background, video.size)
        keypoints = open_keypoints(source, video)
        warnings += () if keypoints is None else tuple(keypoints.warnings)
        images = islice((image for _, image in video.frames(luma=True)), MOST_DECODED)
        undecoded = [image is None for image in images]
        if broken := sum(undecoded):
            problem = f"{broken} of {len(undecoded)} frames cannot be decoded, they are missing"
            warnings += (f"{video.name}: {problem}",)
    views = [
        marker_visibility(recording, *each) for each in zip(recording.videos, times, strict=True)
    ]
    if not any(view.shown_share == 0 for view in views):
        warnings += check_clocks(recording, videos)[1]
    measured = () if recording.path is None else measured_bones(recording.path)
    findings = [*check_recording(recording, times), *check_stretched_arms(recording, measured)]
    return RecordingCheck(recording, findings, views, warnings, measured)
