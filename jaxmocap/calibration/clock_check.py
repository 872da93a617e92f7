"""Does a video move as the markers do, at the offset that is stated?

A few lively frames are checked before a recording is tracked. Where they move with the hands at
another time the offset is estimated by more of them.

INPUTS: a Recording, its videos. OUTPUTS: the recording, offsets that are surely wrong replaced;
sentences about these, and about videos that move otherwise.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from jaxmocap.calibration.hand_flow import HandFlow, MarkerPath, correlations
from jaxmocap.calibration.sync import MIN_CORRELATION, hand_paths, liveliest_frames, video_offset
from jaxmocap.capture.video import FrameSource
from jaxmocap.formats.recordings.recording import Recording, VideoSource

# A stated offset is checked by so many frames, the liveliest ones of the first so many, within so
# many seconds.
CHECKED_FRAMES, CHECKED_AMONG, CHECKED_SEARCH_S = 45, 300, 0.25
# From such a lag on the offset is estimated by all stretches,
CHECKED_LAG_S = 0.03
# and is another where it is so far off, and by so many standard deviations.
WRONG_S, SURE_DEVIATIONS = 0.015, 3.0
# Where hands are so fast, pixels per frame, in so many pairs of frames,
CHECKED_SPEED_PX, CHECKED_PAIRS = 1.0, 20
# the right one has a correlation of 0.73 and more in 13 clips; half a second beside it, of 0.67 in
# one that swings in time, and of 0.41 and less in the others.
MIN_STATED_CORRELATION = 0.4


def check_clocks(
    recording: Recording, videos: Sequence[FrameSource]
) -> tuple[Recording, tuple[str, ...]]:
    """With other offsets of those videos that surely move with the hands at another time.

    And a sentence about each of these, and about each that does not move as the hands do.
    """
    paths, sources, sentences = hand_paths(recording), [], []
    for source, video in zip(recording.videos, videos, strict=True):
        problem, offset = _wrong_clock(source, video, paths) if paths else ("", source.offset)
        sources.append(replace(source, offset=offset) if offset != source.offset else source)
        sentences += [f"{source.camera_name}: {problem}"] if problem else []
    return replace(recording, videos=tuple(sources)), tuple(sentences)


def _wrong_clock(
    source: VideoSource, video: FrameSource, paths: Sequence[MarkerPath]
) -> tuple[str, float]:
    """What is wrong with a video's clock, empty for nothing; the offset to take."""
    times = video.times[:CHECKED_AMONG]
    first, count = liveliest_frames(times, paths, 0, len(times), CHECKED_FRAMES)
    if count < CHECKED_PAIRS:
        return "", source.offset
    flow = HandFlow.of_frames(source.camera, video, paths, first, count)
    lags, scores = correlations(flow, CHECKED_SEARCH_S)
    best = int(np.argmax(scores))
    if scores[best] >= MIN_CORRELATION and abs(lags[best]) >= CHECKED_LAG_S:
        found = video_offset(source, paths, CHECKED_SEARCH_S)
        off = abs(found.offset_s - source.offset)
        if found.is_found and off > max(WRONG_S, SURE_DEVIATIONS * found.std_s):
            return (
                f"the image moves with the hands at offset = {found.offset_s:.4f} (± "
                f"{found.std_s:.4f} s), where the recording states {source.offset:g}: write it "
                "into the file; what is smoothed as a whole is by it already"
            ), found.offset_s
    predicted, stated = flow.flow_pair(0.0).predicted, scores[np.abs(lags).argmin()]
    squared = (predicted[np.isfinite(predicted).all(-1)] ** 2).sum(-1)
    is_fast = len(squared) >= CHECKED_PAIRS and squared.mean() >= CHECKED_SPEED_PX**2
    if is_fast and stated < MIN_STATED_CORRELATION:
        return (
            "where the hands are the image does not move as they do (correlation "
            f"{stated:.2f}, 0.7 and more where all fits): check offset, which "
            "'jaxmocap sync' finds, the calibration, and whether the video is this recording's"
        ), source.offset
    return "", source.offset
