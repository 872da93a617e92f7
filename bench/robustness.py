"""``python -m bench.robustness FOLDER...``: silhouettes through corrupted and missing images.

Each folder holds ``recording.toml`` and ``truth.trc`` of an exercise that was rendered, such as
the folder ``recording`` in what ``jaxmocap silhouette demo`` writes. Joints are back to their usual
error where none of twelve is farther off than a centimetre more than in 95 % of the frames without
the fault; of a camera that stays away the usual is that of the cameras left.

INPUTS: folders. OUTPUTS: a table, and Metrics as JSON.
"""

import argparse
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from bench import command
from bench.clips import in_memory, true_skeleton
from bench.figures import Metric, write_json
from bench.silhouette import true_start
from jaxmocap.body.motion import Motion
from jaxmocap.cli.recording_options import select_cameras
from jaxmocap.evaluation.tables import align_columns
from jaxmocap.formats.recordings.recording import Recording, VideoSource, load_recording
from jaxmocap.formats.time_series.trc import read_trc
from jaxmocap.geometry.cameras import project
from jaxmocap.pipelines.kept_programs import keep_compiled
from jaxmocap.pipelines.silhouettes.track import track_silhouettes
from jaxmocap.silhouette.settings import Settings

JOINTS = tuple(
    f"{joint}_{side}"
    for joint in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
    for side in "lr"
)
# Back is who stays within this much more than usual for so many frames; and how soon is asked.
MORE_M, STAYS, ASKED_S = 0.01, 3, 0.5
# One frame of so many is corrupted, and which of a second's frames a limb is hidden from.
EVERY, HIDDEN_FROM, HIDDEN_S = 10, 0.2, 1.0
# Around a hidden limb, pixels; the box is of a plain grey.
AROUND, GREY = 22, 128
LIMB = ("elbow_l", "wrist_l", "hand_l")
# Joints whose angles nobody can tell while that limb is hidden.
HIDDEN_JOINTS = ("elbow_flex_l",)


class Span(NamedTuple):
    """A fault of frames ``start`` to ``stop`` (excluded).

    Attributes:
        start: the first frame.
        stop: the frame after the last, or after the first of a fault that stays.
        cameras: names of those that show nothing of use.
        joints: that no camera can show.
    """

    start: int
    stop: int
    cameras: tuple[str, ...] = ()
    joints: tuple[str, ...] = ()


class Faulty(NamedTuple):
    """Videos with faults.

    Attributes:
        videos: one of each camera.
        spans: in order of time.
        fewer: cameras that are left from the fault on, where it stays.
    """

    videos: tuple[VideoSource, ...]
    spans: tuple[Span, ...]
    fewer: tuple[str, ...] = ()


Truth = dict[str, np.ndarray]
Fault = Callable[[Sequence[VideoSource], Truth], Faulty]


class Outcome(NamedTuple):
    """What became of one recording with one kind of fault.

    Attributes:
        name: exercise and fault.
        usual: mean error of the joints without it, metres.
        worst: the largest mean error while it lasts and until the joints are back, metres.
        back: seconds of each fault from its end until they are.
        reported: share of the frames with a fault of which the report lists what was not visible.
        false: share of the other frames of which it says so.
    """

    name: str
    usual: float
    worst: float
    back: np.ndarray
    reported: float
    false: float

    def row(self) -> list[str]:
        """Of the table."""
        late = np.max(self.back)
        return [
            self.name,
            f"{100 * self.usual:.1f}",
            f"{100 * self.worst:.1f}",
            f"{np.median(self.back):.2f}",
            f"{late:.2f}" if math.isfinite(late) else "never",
            f"{np.mean(self.back <= ASKED_S):.0%}",
            f"{self.reported:.0%}",
            f"{self.false:.0%}",
        ]

    def metrics(self) -> list[Metric]:
        """Figures for JSON; what never came back is left out of the worst time."""
        late = self.back[np.isfinite(self.back)]
        result = [
            Metric(f"{self.name}, worst error", 100 * self.worst, "cm"),
            Metric(
                f"{self.name}, back in time",
                100 * float(np.mean(self.back <= ASKED_S)),
                "%",
                "higher",
            ),
            Metric(f"{self.name}, reported", 100 * self.reported, "%", "higher"),
            Metric(f"{self.name}, reported falsely", 100 * self.false, "%"),
        ]
        return result + ([Metric(f"{self.name}, back after", late.max(), "s")] if len(late) else [])


# What goes wrong with cameras ---------------------------------------------------------------------


def one_corrupted(videos: Sequence[VideoSource], truth: Truth) -> Faulty:
    """Every tenth frame of one camera after the other is torn, black or another camera's."""
    return _corrupted(videos, lambda number: [number % len(videos)])


def all_corrupted(videos: Sequence[VideoSource], truth: Truth) -> Faulty:
    """The same of all cameras at once."""
    return _corrupted(videos, lambda number: range(len(videos)))


def _corrupted(
    videos: Sequence[VideoSource], which: Callable[[int], Sequence[int] | range]
) -> Faulty:
    images, spans = [_frames(video)[1] for video in videos], []
    old = [list(each) for each in images]
    for number, frame in enumerate(range(EVERY, len(images[0]), EVERY)):
        broken = which(number // 3 if len(which(0)) == 1 else number)
        for camera in broken:
            image, other = old[camera][frame], old[(camera + 1) % len(old)][frame]
            images[camera][frame] = (torn(image), np.zeros_like(image), other)[number % 3]
        spans.append(Span(frame, frame + 1, tuple(videos[c].camera_name for c in broken)))
    return Faulty(_with(videos, images), tuple(spans))


def torn(image: np.ndarray) -> np.ndarray:
    """The lower part of an image shifted by a third of its width, as of a frame that came late."""
    cut = image.shape[0] * 2 // 5
    return np.concatenate([image[:cut], np.roll(image[cut:], image.shape[1] // 3, 1)])


def camera_lost(videos: Sequence[VideoSource], truth: Truth) -> Faulty:
    """The second camera ends midway."""
    gone = videos[1 % len(videos)]
    times, images = _frames(gone)
    middle = len(times) // 2
    cut = replace(gone, frames=(times[:middle], images[:middle]))
    left = tuple(video.camera_name for video in videos if video is not gone)
    span = Span(middle, middle + 1, (gone.camera_name,))
    return Faulty(tuple(cut if video is gone else video for video in videos), (span,), left)


def limb_hidden(videos: Sequence[VideoSource], truth: Truth) -> Faulty:
    """A box lies over the left forearm and hand in every camera for a second."""
    times, _ = _frames(videos[0])
    start = int(np.searchsorted(times, times[0] + HIDDEN_FROM))
    stop = min(int(np.searchsorted(times, times[start] + HIDDEN_S)), len(times) - 1)
    points = np.stack([truth[name] for name in LIMB], 1)
    images = [_frames(video)[1] for video in videos]
    for video, shown in zip(videos, images, strict=True):
        pixels = np.asarray(project(video.camera, jnp.asarray(points, video.camera.matrix.dtype)))
        low = np.maximum(np.floor(pixels.min(1) - AROUND).astype(int), 0)
        high = np.maximum(np.ceil(pixels.max(1) + AROUND).astype(int), 0)
        for frame in range(start, stop):
            shown[frame] = shown[frame].copy()
            shown[frame][low[frame, 1] : high[frame, 1], low[frame, 0] : high[frame, 0]] = GREY
    return Faulty(_with(videos, images), (Span(start, stop, (), HIDDEN_JOINTS),))


def _frames(video: VideoSource) -> tuple[np.ndarray, list[np.ndarray]]:
    """Times and images of a video in memory."""
    assert video.frames is not None
    times, images = video.frames
    return np.asarray(times), list(images)  # type: ignore[arg-type]


def _with(videos: Sequence[VideoSource], images: list[list]) -> tuple[VideoSource, ...]:
    """The videos with other images."""
    return tuple(
        replace(video, frames=(_frames(video)[0], shown))
        for video, shown in zip(videos, images, strict=True)
    )


FAULTS = {
    "one camera corrupted": one_corrupted,
    "all cameras corrupted": all_corrupted,
    "a camera lost": camera_lost,
    "a limb hidden": limb_hidden,
}


# What becomes of it -------------------------------------------------------------------------------

HEADINGS = [
    ["exercise and fault", "usual", "worst", "back after", "", "in 0.5 s", "reported", "falsely"],
    ["", "cm", "cm", "median s", "at most s", "", "", ""],
]


def measured(folder: Path, faults: Sequence[str], settings: Settings) -> list[Outcome]:
    """All outcomes of a recording."""
    recording, truth = loaded(folder)
    clean = errors(tracked(recording, truth, settings), truth)
    result = []
    for name in faults:
        faulty = FAULTS[name](recording.videos, truth)
        usual = clean
        if faulty.fewer:
            fewer = tracked(select_cameras(recording, faulty.fewer), truth, settings)
            usual = np.maximum(clean, errors(fewer, truth))
        motion = tracked(replace(recording, videos=faulty.videos), truth, settings)
        result.append(
            evaluated(f"{folder.name}, {name}", motion, errors(motion, truth), usual, faulty)
        )
        print(align_columns([result[-1].row()]), flush=True)
    return result


def loaded(folder: Path) -> tuple[Recording, Truth]:
    """A recording, its frames in memory and its person of the true lengths; and the truth."""
    recording, reference = load_recording(folder / "recording.toml"), read_trc(folder / "truth.trc")
    truth = dict(zip(reference.names, np.moveaxis(reference.positions, 1, 0), strict=True))
    skeleton = true_skeleton(recording.skeleton, truth)
    videos = tuple(in_memory(video) for video in recording.videos)
    return replace(recording, skeleton=skeleton, videos=videos), truth


def tracked(recording: Recording, truth: Truth, settings: Settings) -> Motion:
    """The motion that silhouettes tell, from the true place of the first frame."""
    start = true_start(recording.skeleton, truth, settings)
    return track_silhouettes(recording, start, settings).motion


def errors(motion: Motion, truth: Truth) -> np.ndarray:
    """(T, J) metres."""
    joints, count = motion.joints(), len(motion.times)
    off = [np.linalg.norm(joints[name] - truth[name][:count], axis=1) for name in JOINTS]
    return np.stack(off, 1)


def evaluated(
    name: str, motion: Motion, off: np.ndarray, usual: np.ndarray, faulty: Faulty
) -> Outcome:
    """Compare errors (T, J) with the usual ones."""
    most = np.maximum(np.percentile(usual, 95, 0), usual) + MORE_M
    within = np.all(off <= most, 1)
    ends = [span.start for span in faulty.spans[1:]] + [len(off)]
    frames = [back_at(within, span.stop, end) for span, end in zip(faulty.spans, ends, strict=True)]
    times = np.append(motion.times, np.inf)
    after = [
        times[min(b, len(off))] - times[s.stop - 1]
        for b, s in zip(frames, faulty.spans, strict=True)
    ]
    troubled = [
        off[span.start : max(min(b, end), span.stop)].mean(1).max()
        for span, b, end in zip(faulty.spans, frames, ends, strict=True)
    ]
    reported_share, false = reported(motion, faulty)
    return Outcome(name, usual.mean(), max(troubled), np.array(after), reported_share, false)


def back_at(within: np.ndarray, start: int, end: int) -> int:
    """The first frame from ``start`` from which on all is well for some time; a far one if none."""
    for frame in range(start, end):
        if within[frame : min(frame + STAYS, end)].all():
            return frame
    return 10**9


def reported(motion: Motion, faulty: Faulty) -> tuple[float, float]:
    """Shares of frames with and without a fault of which the report lists what is not visible."""
    assert motion.report is not None
    statuses = motion.report.statuses
    stays, named = bool(faulty.fewer), [set[str]() for _ in statuses]
    for span in faulty.spans:
        for frame in range(span.start, len(statuses) if stays else span.stop):
            named[frame] |= unseen(span)
    expected = set[str]().union(*named)
    during = [names <= set(status) for names, status in zip(named, statuses, strict=True) if names]
    other = [
        bool(expected & set(status))
        for names, status in zip(named, statuses, strict=True)
        if not names
    ]
    return float(np.mean(during)), float(np.mean(other or [False]))


def unseen(span: Span) -> set[str]:
    """The sentences that a report should have."""
    cameras = {f"{name}: left out" for name in span.cameras}
    return cameras | {f"held, not visible: {joint}" for joint in span.joints}


def parser() -> argparse.ArgumentParser:
    """The command line."""
    result = command(
        "bench.robustness",
        __doc__,
        epilog="example: python -m bench.robustness demo/recording --only 'a limb hidden'",
    )
    add = result.add_argument
    add("folders", nargs="+", type=Path, metavar="FOLDER", help="of a rendered exercise")
    add("--only", action="append", choices=tuple(FAULTS), help="this fault; may be repeated")
    return result


def main(arguments: Sequence[str] | None = None, settings: Settings | None = None) -> None:
    options = parser().parse_args(arguments)
    keep_compiled()
    faults, outcomes = options.only or list(FAULTS), []
    for folder in options.folders:
        outcomes += measured(folder, faults, settings or Settings())
    print(align_columns([*HEADINGS, *(outcome.row() for outcome in outcomes)]))
    write_json([metric for outcome in outcomes for metric in outcome.metrics()], options.json)


if __name__ == "__main__":
    main()
