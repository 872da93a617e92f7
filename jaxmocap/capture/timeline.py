"""The events that a tracker goes through: marker samples and video frames, in order of time.

INPUTS: marker times (T,) and each video's frame times, seconds of marker time.
OUTPUTS: a Timeline that says for each event which sample and which frame of each camera it has.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.time_series.tables import nearest_times, usual_step

Mode = Literal["own", "nearest", "causal"]
# Time stamps in files are rounded to a millisecond at worst: within it, things are simultaneous.
SIMULTANEOUS_S = 1e-3


@dataclass(frozen=True)
class Timeline:
    """E events in order of time, over T marker samples and C cameras."""

    # (E,) seconds of marker time; a sample's own time where there is a sample.
    event_times: np.ndarray
    sample_index: np.ndarray  # (E,) the marker sample that the event is, or -1
    frame_index: np.ndarray  # (E, C) the frame of each camera that it has, or -1


def build_timeline(
    marker_times: np.ndarray, video_times: Sequence[np.ndarray], mode: Mode = "own"
) -> Timeline:
    """Order samples and frames.

    Args:
        marker_times: (T,) seconds, ascending.
        video_times: frame times (F,) of each camera, seconds, ascending.
        mode: ``own`` has one event for every sample and every bundle of simultaneous frames, at
            the middle of the frames' times; ``causal`` likewise, but a bundle is complete only at
            its newest frame; ``nearest`` has the samples only, each with the frame nearest in
            time, if that is no further than one frame interval (a frame may serve twice).
    """
    marker_times = np.asarray(marker_times, float)
    frames = [np.asarray(times, float) for times in video_times]
    if mode == "nearest":
        columns = [_nearest_frames(marker_times, times) for times in frames]
        index = np.stack(columns, 1) if columns else np.empty((len(marker_times), 0), int)
        return Timeline(marker_times, np.arange(len(marker_times)), index)
    bundle_times, bundles = bundle_frames(frames, np.max if mode == "causal" else np.median)
    return _merge(marker_times, bundle_times, bundles)


def _nearest_frames(marker_times: np.ndarray, frame_times: np.ndarray) -> np.ndarray:
    """(T,) index of the frame nearest to each sample, -1 beyond one frame interval."""
    if not len(frame_times):
        return np.full(len(marker_times), -1)
    nearest, gap = nearest_times(frame_times, marker_times)
    return np.where(gap <= max(usual_step(frame_times), SIMULTANEOUS_S), nearest, -1)


def bundle_frames(video_times: Sequence[np.ndarray], when=np.median) -> tuple:
    """Put together what the cameras took at about the same time.

    A bundle starts with the earliest frame that is left and takes the other cameras' frames that
    follow within half a frame interval; no camera is in it twice.

    Args:
        video_times: (F,) seconds of each of the C cameras, ascending.
        when: what makes one time of the times of a bundle's frames.

    Returns:
        (N,) times of the bundles and (N, C) frame indices, -1 where a camera has none.
    """
    cameras = len(video_times)
    intervals = [usual_step(times) for times in video_times if len(times) > 1]
    reach = max(min(intervals, default=0.0) / 2, SIMULTANEOUS_S)
    every = sorted((t, c, i) for c, times in enumerate(video_times) for i, t in enumerate(times))
    times: list[list[float]] = []
    index: list[list[int]] = []
    for t, camera, i in every:
        if not times or t - times[-1][0] > reach or index[-1][camera] >= 0:
            times.append([])
            index.append([-1] * cameras)
        times[-1].append(t)
        index[-1][camera] = i
    return np.array([when(t) for t in times]), np.array(index, int).reshape(len(times), cameras)


def _merge(marker_times: np.ndarray, bundle_times: np.ndarray, bundles: np.ndarray) -> Timeline:
    """One event per sample and per bundle, but one for both where they are simultaneous."""
    count = len(marker_times)
    sample_frames = np.full((count, bundles.shape[1]), -1)
    nearest, gap = nearest_times(marker_times, bundle_times)
    # Of several bundles at one sample the nearest is merged, the others stay by themselves.
    order = np.lexsort((gap, nearest))
    first = np.r_[True, np.diff(nearest[order]) > 0] if len(order) else np.empty(0, bool)
    merged = np.zeros(len(bundle_times), bool)
    merged[order[first]] = True
    merged &= gap <= SIMULTANEOUS_S
    sample_frames[nearest[merged]] = bundles[merged]

    times = np.concatenate([marker_times, bundle_times[~merged]])
    samples = np.concatenate([np.arange(count), np.full((~merged).sum(), -1)])
    frames = np.concatenate([sample_frames, bundles[~merged]])
    ascending = np.argsort(times, kind="stable")
    return Timeline(times[ascending], samples[ascending], frames[ascending])


def check_overlap(marker_times: np.ndarray, video_times: np.ndarray, path) -> None:
    """InputError about ``path`` unless markers and a video, both in marker time, share some."""
    latest_start = max(marker_times[0], video_times[0])
    if latest_start > min(marker_times[-1], video_times[-1]):
        raise InputError(
            path,
            f"no overlap: the video lasts from {video_times[0]:.3f} to {video_times[-1]:.3f} s of "
            f"marker time, the markers from {marker_times[0]:.3f} to {marker_times[-1]:.3f} s; "
            "check the offset",
        )
