"""A synthetic table-tennis recording, tracked with markers only and with video.

INPUTS: a folder, a duration, a seed.
OUTPUTS: in that folder the recording, everything that ``track`` writes, and elbow_errors.png.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from jaxmocap.body.kinematics import forward, site_positions
from jaxmocap.body.model import marker_sites
from jaxmocap.body.motion import Motion
from jaxmocap.body.pose import relaxed_pose
from jaxmocap.body.skeleton import WINTER, Skeleton
from jaxmocap.evaluation.errors import Errors, evaluate
from jaxmocap.evaluation.plots import plot_elbow_errors
from jaxmocap.evaluation.tables import format_table
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.files.output_folder import OutputFolder
from jaxmocap.formats.recordings.recording import MarkerPlace, Recording, VideoSource
from jaxmocap.hybrid.tracker import HybridTracker
from jaxmocap.pipelines.progress import progress_bar
from jaxmocap.pipelines.summary import frames_per_second
from jaxmocap.pipelines.tracking.track import track, track_both
from jaxmocap.pipelines.writing import MOTION, MOTION_FILES, write_tracked
from jaxmocap.synthetic.recording import (
    CAMERA,
    VIDEO_RATE,
    marker_places,
    webcam,
    write_table_tennis,
)

ELBOW_PAIRS = {"elbow_l": "elbow_l", "elbow_r": "elbow_r"}
HEIGHT_M = 1.75
# Seconds that are rendered.
LEAST_S, MOST_S = 0.1, 3600.0
# Of the player's mesh and clothes, which people look at.
DETAIL = 2
PLOT_FILE = "elbow_errors.png"
FILES = (*MOTION_FILES, "report.json", "recording.rrd", f"overlay_{CAMERA}.mp4", PLOT_FILE)
RECORDING_FILES = (
    *("recording.toml", "markers.trc", "static.trc", "truth.trc"),
    *("video.mp4", "calibration.toml"),
)


@dataclass(frozen=True)
class Demonstration:
    """The demo's results: motion, errors of the elbows without video and with it, files."""

    motion: Motion
    markers_only: Errors
    with_video: Errors
    files: list[Path]

    def table(self) -> str:
        """Elbow errors with video and without, and the rate of all passes, as text."""
        table = format_table(self.with_video, self.markers_only)
        rate = f"{frames_per_second(self.motion.report):.0f} frames per second"
        return f"{table}\n\n{rate}, compilation included"

    def as_dict(self) -> dict:
        """The same figures for JSON."""
        return {
            "markers_only": self.markers_only.as_dict(),
            "with_video": self.with_video.as_dict(),
            "improvement_share": 1 - self.with_video.mean / self.markers_only.mean,
            "frames_per_second": frames_per_second(self.motion.report),
            "files": [str(path) for path in self.files],
        }


def demonstrate(
    directory: str | Path, seconds: float = 6.0, seed: int = 0, progress: bool = False
) -> Demonstration:
    """Make a recording, track it, and compare both elbows with the truth; see ``jaxmocap demo``."""
    if not LEAST_S <= seconds <= MOST_S:
        raise InputError("--seconds", f"found {seconds:g}, expected {LEAST_S:g} to {MOST_S:g}")
    folder = OutputFolder(directory, MOTION, FILES)
    recording_folder = OutputFolder(folder.path / "recording", "recording", RECORDING_FILES)
    # The tracker compiles while the frames are rendered.
    with (
        recording_folder.writing() as stage,
        ThreadPoolExecutor(1) as renderer,
        progress_bar("rendering", progress) as show,
    ):
        person = {"height": HEIGHT_M, "progress": show, "detail": DETAIL}
        written = renderer.submit(write_table_tennis, stage, seconds, seed, **person)
        standing = standing_recording(1)
        tracker = HybridTracker.from_recording(standing)
        track(standing, tracker=tracker, progress=False)
        written.result()
    recording = Recording.load(recording_folder.path / "recording.toml")
    tracked = track_both(recording, progress=progress, tracker=tracker)
    truth = recording_folder.path / "truth.trc"
    before, after = (
        evaluate(motion, truth, ELBOW_PAIRS) for motion in (tracked.markers_only, tracked.motion)
    )

    def write(stage: Path) -> list[Path]:
        files = write_tracked(tracked.motion, tracked.recording, stage, tracker.settings, progress)
        curves = after.times, _by_joint(before), _by_joint(after)
        plot_elbow_errors(stage / PLOT_FILE, *curves, "Elbow errors")
        return [*files, stage / PLOT_FILE]

    return Demonstration(tracked.motion, before, after, folder.write(write))


def standing_recording(count: int) -> Recording:
    """Somebody with the demo's markers who stands still before a grey wall, for so many frames."""
    skeleton, camera = Skeleton.human(HEIGHT_M, proportions=WINTER), webcam()
    places = tuple(MarkerPlace(name, **place) for name, place in marker_places().items())
    sites = marker_sites(skeleton, places)
    points = site_positions(skeleton, forward(skeleton, relaxed_pose(skeleton)), sites)
    width, height = np.asarray(camera.size, int)
    times = np.arange(count) / VIDEO_RATE
    frames = (times, [np.full((height, width), 128, np.uint8)] * count)
    video = VideoSource(CAMERA, camera, frames=frames)
    positions_world = np.tile(np.asarray(points), (count, 1, 1))
    return Recording(skeleton, times, positions_world, places, (video,), "standing")


def _by_joint(errors: Errors) -> dict[str, np.ndarray]:
    return dict(zip(errors.joints, errors.distances.T, strict=True))
