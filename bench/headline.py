"""What users pay: four figures, with the errors without which they do not count.

    core_share_720p       processor time per second of a live stream, 1280 x 720 at 30 Hz
    frame_p99_ms          how long the slowest frame in a hundred of it takes
    offline_core_seconds  processor time per second of video, the whole recording smoothed
    ours_over_detector    a causal frame's processor time over MediaPipe's, in turn

Decoding is included but in the last. The stream counts from its third second on, when what compiles
and what is learned fast is over.

INPUTS: a folder, real recordings, the Python of a detector. OUTPUTS: Metrics.
"""

from collections.abc import Callable, Iterator
from pathlib import Path
from time import process_time

import numpy as np

from bench.clips import AZIMUTHS, REAL_LANDMARKS, Clip, Footage, at_size, film, real, synthetic
from bench.clock import Stopwatch, settle_garbage
from bench.figures import Metric
from bench.frame_rate import Pace, causal
from bench.rival_detector import detector
from jaxmocap.capture.footage import forward_readers, open_footage
from jaxmocap.evaluation.errors import evaluate
from jaxmocap.formats.recordings.recording import Recording
from jaxmocap.hybrid.tracker import HybridTracker
from jaxmocap.pipelines.tracking.track import track

# Seconds of the stream, of which the first are left out, and of each recording that is judged.
STREAM_S, FIRST_S, CLIP_S = 32.0, 3.0, 6.0
WIDTH, HEIGHT = 1280, 720
SEEDS = range(5)
# Frames that the detector looks at; those of the first seconds are left out as well.
DETECTED = 300
NAMES = ("core_share_720p", "frame_p99_ms", "offline_core_seconds", "ours_over_detector")


def measure(
    folder: Path, recordings: Path | None = None, detector_python: str | None = None
) -> Iterator[Metric]:
    """The four figures and the errors.

    Args:
        folder: to put recordings in.
        recordings: real ones, with ``balancing`` in it; left out without.
        detector_python: of an environment with MediaPipe; its figure is left out without.
    """
    stream = film(folder / "stream", STREAM_S)
    large = at_size(stream, WIDTH, HEIGHT)
    tracker = HybridTracker.from_recording(large.recording)
    yield from _live(tracker, large)
    if detector_python is None:
        print("ours_over_detector: left out, --detector-python names no environment", flush=True)
    else:
        yield from _over_detector(tracker, large, detector_python)
    yield from _offline(stream)
    yield from _errors(folder, recordings)


def _live(tracker: HybridTracker, large: Footage) -> Iterator[Metric]:
    """As a live run, the video decoded on the way."""
    run_through(tracker, large, frames=90)
    settle_garbage()
    began = 0.0
    first = int(FIRST_S * 30)

    def note(frame: int) -> None:
        nonlocal began
        if frame == first:
            began = process_time()

    pace = run_through(tracker, large, note)
    seconds = pace.duration_s - large.times[first]
    yield Metric("core_share_720p", (process_time() - began) / seconds, "x")
    late = float(np.percentile(pace.wall("frame")[first:], 99))
    yield Metric("frame_p99_ms", late, "ms", tolerance=1.0)


def run_through(
    tracker: HybridTracker,
    large: Footage,
    after: Callable[[int], object] = lambda frame: None,
    frames: int | None = None,
) -> Pace:
    """Causally, and what is called after each frame; the first so many frames alone."""
    videos, _ = open_footage(large.recording)
    some = large if frames is None else large.first(frames)
    with forward_readers(videos, colour=True) as (reader,):
        return causal(tracker, some, reader.at, after)


def _over_detector(tracker: HybridTracker, large: Footage, python: str) -> Iterator[Metric]:
    """Frames that are decoded already, in turn."""
    path = large.recording.videos[0].path
    assert path is not None
    some = large.first(DETECTED)
    with detector(python, Path(path)) as rival:
        pace = causal(tracker, some, some.images.__getitem__, rival.detect)
    first = int(FIRST_S * 30)
    # The samples since the last frame belong to it.
    samples = pace.of("sample")[:, 1].sum() / len(some.images)
    ours = float(np.median(pace.of("frame")[first:, 1])) + samples
    theirs = float(np.median(rival.milliseconds[first:]))
    yield Metric("a causal frame beside the detector, processor", ours, "ms")
    yield Metric("the detector's frame, processor", theirs, "ms")
    yield Metric("ours_over_detector", ours / theirs, "x")


def _offline(stream: Footage) -> Iterator[Metric]:
    """The default over the whole recording, once its programs are there."""
    first = stream.first(30)
    tracker = HybridTracker.from_recording(stream.recording)
    track(first.recording, tracker=tracker)
    watch = Stopwatch()
    track(stream.recording, tracker=tracker)
    yield Metric("offline_core_seconds", watch.read().busy / 1e3 / STREAM_S, "s")


def _errors(folder: Path, recordings: Path | None) -> Iterator[Metric]:
    """Of the causal track, over players from all sides and over real cameras."""
    groups = {"5 players": synthetic("tennis", SEEDS, AZIMUTHS, CLIP_S, folder)}
    if recordings is not None:
        groups["real"] = real(recordings)
    for name, clips in groups.items():
        each = np.array([_errors_of(clip) for clip in clips])
        elbows, knees, acceleration = np.nanmean(each, 0)
        yield Metric(f"causal, {name}: elbows, mean error", elbows, "cm")
        yield Metric(f"causal, {name}: knees, mean error", knees, "cm")
        yield Metric(f"causal, {name}: elbows, mean acceleration", acceleration, "m/s²")


def _errors_of(clip: Clip) -> tuple[float, float, float]:
    """Elbows and knees, centimetres; the elbows' mean acceleration, m/s^2."""
    motion = track(Recording.load(clip.path), mode="causal")
    marks = REAL_LANDMARKS if clip.group == "balancing" else clip.landmarks
    off = [
        100 * evaluate(motion, clip.truth, {f"{part}_{s}": marks[f"{part}_{s}"] for s in "lr"}).mean
        for part in ("elbow", "knee")
    ]
    joints = motion.joints()
    points = np.stack([joints["elbow_l"], joints["elbow_r"]], 1)
    second = np.diff(points, 2, axis=0) / np.median(np.diff(motion.times)) ** 2
    return off[0], off[1], float(np.nanmean(np.linalg.norm(second, axis=-1)))
