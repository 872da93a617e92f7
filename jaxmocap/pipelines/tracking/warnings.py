"""Warnings about a sample: sentences that a user reads in the report.

They hold no figures, so that the report can count them.

INPUTS: a StepReport, images, frame times. OUTPUTS: sentences.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from jaxmocap.body.motion import UNDETERMINED_M
from jaxmocap.capture.markers import median_interval
from jaxmocap.hybrid.refine import StepReport
from jaxmocap.solvers.status import SENTENCES, Status

SIDES = ("left", "right")
# An image whose brightness varies by less (of 255) shows nothing.
BLANK_RANGE = 12
# A frame further away than this many of its video's intervals is not near.
NEAR_INTERVALS = 1.5


def of_step(report: StepReport) -> Iterator[str]:
    """What the tracker did to the body."""
    if report.placed:
        yield "the body was placed again"
    if report.planted:
        yield "the feet were planted again"
    if sentence := SENTENCES[Status(int(report.status))]:
        yield f"the refinement {sentence}"


def of_markers(names: Sequence[str], positions_world: np.ndarray) -> Iterator[str]:
    """Which of the (M, 3) markers are missing."""
    for name, position in zip(names, positions_world, strict=True):
        if not np.isfinite(position).all():
            yield f"marker {name} is missing"


def of_images(
    names: Sequence[str], due: Sequence[bool], images: Sequence[np.ndarray | None]
) -> Iterator[str]:
    """Which of the cameras' images that were due cannot be read or show nothing."""
    for name, expected, image in zip(names, due, images, strict=True):
        if expected and image is None:
            yield f"{name}: the video frame cannot be read"
        elif image is not None and np.ptp(image[::8, ::8]) < BLANK_RANGE:
            yield f"{name}: the video frame is black or blank"


def of_elbows(deviations: np.ndarray) -> Iterator[str]:
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
    return away > NEAR_INTERVALS * median_interval(video_times)
