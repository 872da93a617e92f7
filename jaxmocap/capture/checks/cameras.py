"""Does a camera stand where it can see the person? See ``checks``.

INPUTS: a Recording, and the times of each video's frames.
OUTPUTS: Findings about calibration and offset; the share of the markers that an image shows.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from jaxmocap.capture.checks import Finding
from jaxmocap.capture.checks.body_reach import standing_points
from jaxmocap.capture.checks.markers import check_markers
from jaxmocap.capture.checks.sides import facing_of_pairs
from jaxmocap.formats.recordings.recording import Recording, VideoSource
from jaxmocap.formats.time_series.tables import usual_step
from jaxmocap.geometry.cameras import Camera, on_host, visible_pixels

# Nobody is filmed from further away; a calibration in millimetres puts the camera there.
MAX_DISTANCE_M = 150.0
# How far below the floor, which is uncertain by some centimetres, a camera may come out.
MAX_BELOW_FLOOR_M = 0.15
# Share of the markers that the image must show while the video runs.
MIN_VISIBLE_SHARE = 0.5
# Share of the marker samples that must have a video.
MIN_COVERED_SHARE = 0.5
# Other axes that show so much explain why these do not.
MIN_EXPLAINED_SHARE = 0.9


@dataclass(frozen=True)
class MarkerVisibility:
    """How much of the markers a camera covers in time and shows in its image."""

    camera: str  # its name
    covered_share: float  # share of the marker samples that lie within its video's time
    # Share of the markers present in these samples that its image shows; NaN without any.
    shown_share: float
    distance_m: float  # metres from the camera to the middle of the markers, median


def check_recording(recording: Recording, video_times: Sequence[np.ndarray]) -> list[Finding]:
    """All that is wrong, what is fatal first; ``video_times`` (F,) of each video, seconds."""
    findings = check_markers(recording)
    if not any(finding.fatal for finding in findings):
        views = [
            marker_visibility(recording, source, times)
            for source, times in zip(recording.videos, video_times, strict=True)
        ]
        nowhere = all(view.shown_share == 0 for view in views)
        for source, view in zip(recording.videos, views, strict=True):
            findings += _camera_findings(recording, source, view, nowhere)
    return sorted(findings, key=lambda finding: not finding.fatal)


def marker_visibility(
    recording: Recording, source: VideoSource, video_times: np.ndarray
) -> MarkerVisibility:
    """How much of the markers one camera covers and shows."""
    times, positions = recording.times, recording.positions_world
    half = max(usual_step(video_times), usual_step(times)) / 2
    inside = (times >= video_times[0] - half) & (times <= video_times[-1] + half)
    is_present = np.asarray(np.isfinite(positions).all(-1))
    middle = np.median(positions[is_present], 0)
    in_video = positions[inside][is_present[inside]]
    return MarkerVisibility(
        source.camera_name,
        float(inside.mean()),
        float(points_in_image(source.camera, in_video).mean()) if len(in_video) else float("nan"),
        float(np.linalg.norm(on_host(source.camera).position_world - middle)),
    )


def points_in_image(camera: Camera, points_world: np.ndarray) -> np.ndarray:
    """(N,) whether (N, 3) world points lie before the camera and within its image."""
    xy = visible_pixels(camera, points_world)
    return np.asarray(((xy >= -0.5) & (xy <= np.asarray(camera.size, float) - 0.5)).all(-1))


def _camera_findings(
    recording: Recording, source: VideoSource, view: MarkerVisibility, is_fatal: bool
) -> Iterator[Finding]:
    section = f"[{source.camera_name}] of the calibration"
    if view.distance_m > MAX_DISTANCE_M:
        yield Finding(
            "unit",
            f"{section}: the camera is {view.distance_m:.4g} m away from the markers, expected at "
            f"most {MAX_DISTANCE_M:g} m; translation must be in metres",
            fatal=True,
        )
        return
    height, floor = float(on_host(source.camera).position_world[2]), _floor(recording)
    if height < floor - MAX_BELOW_FLOOR_M:
        yield Finding(
            "camera below the floor",
            f"{section}: the camera stands at z = {height:.2f} m, below the floor, which the "
            f"markers put at {floor:.2f} m; rotation and translation must take the world (Z up) to "
            "the camera, not the camera to the world",
        )
    if view.shown_share < MIN_VISIBLE_SHARE:
        axes, share, mirrored = _other_axes(recording, source.camera)
        kind = "a mirror image, left-handed" if mirrored else "turned"
        better = f"; with {axes} in place of x, y, z ({kind}) it would be {100 * share:.0f} %"
        suggestion = better if share > MIN_EXPLAINED_SHARE else ""
        yield Finding(
            "handedness" if mirrored and share > MIN_EXPLAINED_SHARE else "person out of the image",
            f"{section}: its image shows {100 * view.shown_share:.0f} % of the markers, expected "
            f"{100 * MIN_VISIBLE_SHARE:.0f} % or more; check rotation and translation, [[video]] "
            f"camera, and [markers] up or to_world{suggestion}",
            fatal=is_fatal,
        )
    if view.covered_share < MIN_COVERED_SHARE:
        yield Finding(
            "rate",
            f"[[video]] {source.camera_name}: the video lasts during "
            f"{100 * view.covered_share:.0f} % of the marker samples; if it should be all, check "
            "offset and the video's frame rate",
        )


def _other_axes(recording: Recording, camera: Camera) -> tuple[str, float, bool]:
    """Which turn about the vertical by right angles, or mirror image, the camera shows most of.

    Returns:
        The axes that x, y, z would be, the share of the markers shown, whether it is a mirror
        image. Where several do as well, it is a mirror image if left and right fit it.
    """
    facing = facing_of_pairs(recording)
    expected = bool(facing) and all(reason for _, reason in facing)
    positions = recording.positions_world.reshape(-1, 3)
    positions = positions[np.isfinite(positions).all(-1)]
    options = []
    for first, second in ((0, 1), (1, 0)):
        for a, b in ((1, 1), (-1, 1), (1, -1), (-1, -1)):
            signs, columns = np.array([a, b, 1]), [first, second, 2]
            mirrored = a * b * (1 if first == 0 else -1) < 0
            share = float(points_in_image(camera, positions[:, columns] * signs).mean())
            names = [
                f"{'-' if s < 0 else ''}{'xyz'[c]}" for s, c in zip(signs, columns, strict=True)
            ]
            changes = (signs < 0).sum() + 2 * first
            options.append((round(share, 2), mirrored == expected, -changes, names, mirrored))
    share, _, _, names, mirrored = max(options)
    return ", ".join(names), share, mirrored


def _floor(recording: Recording) -> float:
    """Height on which the person stands, if upright, as the lowest of the markers has it, m."""
    heights = standing_points(recording.skeleton, recording.places)[:, 2]
    is_present = np.isfinite(recording.positions_world[..., 2]).any(0)
    levels = recording.positions_world[:, is_present, 2] - heights[is_present]
    return float(np.nanmedian(levels, axis=0).min())
