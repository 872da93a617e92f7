"""Does a camera stand where it can see the person? See ``checks``.

INPUTS: a Recording, and the times of each video's frames.
OUTPUTS: Findings about calibration and offset; the share of the markers that an image shows.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from jaxmocap.capture.checks.body_reach import standing_points
from jaxmocap.capture.checks.markers import MOST, Finding, check_markers, facing
from jaxmocap.capture.markers import median_interval
from jaxmocap.formats.recordings.recording import Recording, VideoSource
from jaxmocap.geometry.cameras import (
    NEAREST_M,
    Camera,
    camera_components,
    on_host,
    pinhole_components,
    pixel_components,
)
from jaxmocap.geometry.lenses import FISHEYE

# Nobody is filmed from further away; a calibration in millimetres puts the camera there.
FARTHEST_M = 150.0
# How far below the floor, which is known to some centimetres, a camera may come out.
BELOW_M = 0.15
# Of the markers while the video runs, the share that its image must show; of the samples, the
# share that must have a video.
SHOWN, COVERED = 0.5, 0.5
# Other axes that show so much explain why these do not.
SURE = 0.9
# Lenses bend lines; beyond this much of the image's size their formula means nothing.
BEYOND = 0.5


@dataclass(frozen=True)
class View:
    """What a camera has of the markers.

    Attributes:
        camera: its name.
        covered: share of the marker samples that lie within its video's time.
        shown: share of the markers seen in these samples that its image shows; NaN without any.
        distance: metres from the camera to the middle of the markers, median.
    """

    camera: str
    covered: float
    shown: float
    distance: float


def check_recording(recording: Recording, video_times: Sequence[np.ndarray]) -> list[Finding]:
    """All that is wrong with a recording, what is fatal first.

    Args:
        recording: with its cameras.
        video_times: (F,) seconds of marker time of each video's frames.
    """
    found = check_markers(recording)
    if not any(finding.fatal for finding in found):
        views = [
            view(recording, source, times)
            for source, times in zip(recording.videos, video_times, strict=True)
        ]
        nowhere = all(seen.shown == 0 for seen in views)
        for source, seen in zip(recording.videos, views, strict=True):
            found += _camera(recording, source, seen, nowhere)
    return sorted(found, key=lambda finding: not finding.fatal)


def view(recording: Recording, source: VideoSource, video_times: np.ndarray) -> View:
    """What one camera has of the markers."""
    times, positions = recording.times, recording.positions_world
    half = max(median_interval(video_times), median_interval(times)) / 2
    inside = (times >= video_times[0] - half) & (times <= video_times[-1] + half)
    seen = np.asarray(np.isfinite(positions).all(-1))
    middle = np.median(positions[seen], 0)
    during = positions[inside][seen[inside]]
    return View(
        source.camera_name,
        float(inside.mean()),
        float(in_image(source.camera, during).mean()) if len(during) else float("nan"),
        float(np.linalg.norm(np.asarray(source.camera.position_world) - middle)),
    )


def pixels_of(camera: Camera, points_world: np.ndarray) -> np.ndarray:
    """(N, 2) pixels of (N, 3) world points, in double precision; NaN behind the camera."""
    pinhole_xy, bent_xy = _projections(camera, points_world)
    if camera.lens == FISHEYE:
        return bent_xy
    size = np.asarray(camera.size, float)
    near = np.asarray((np.abs(pinhole_xy - size / 2) <= (0.5 + BEYOND) * size).all(-1))
    return np.where(near[:, None], bent_xy, pinhole_xy)


def _projections(camera: Camera, points_world: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    camera = on_host(camera)
    x, y, z = camera_components(camera, *np.asarray(points_world, float).T)
    ahead = z > NEAREST_M
    depths = np.where(ahead, z, 1.0)
    both = [
        np.where(ahead, components(camera, x / depths, y / depths), np.nan).T
        for components in (pinhole_components, pixel_components)
    ]
    return both[0], both[1]


def in_image(camera: Camera, points_world: np.ndarray) -> np.ndarray:
    """(N,) whether (N, 3) world points lie before the camera and within its image."""
    xy = pixels_of(camera, points_world)
    return np.asarray(((xy >= -0.5) & (xy <= np.asarray(camera.size, float) - 0.5)).all(-1))


def _camera(
    recording: Recording, source: VideoSource, seen: View, nowhere: bool
) -> Iterator[Finding]:
    section = f"[{source.camera_name}] of the calibration"
    if seen.distance > FARTHEST_M:
        yield Finding(
            "unit",
            f"{section}: the camera is {seen.distance:.4g} m away from the markers, expected at "
            f"most {FARTHEST_M:g} m; translation must be in metres",
            fatal=True,
        )
        return
    height, floor = float(np.asarray(source.camera.position_world)[2]), _floor(recording)
    if height < floor - BELOW_M:
        yield Finding(
            "camera below the floor",
            f"{section}: the camera stands at z = {height:.2f} m, below the floor, which the "
            f"markers put at {floor:.2f} m; rotation and translation must take the world (Z up) to "
            "the camera, not the camera to the world",
        )
    if seen.shown < SHOWN:
        axes, share, mirrored = _other_axes(recording, source.camera)
        kind = "a mirror image, left-handed" if mirrored else "turned"
        rather = f"; with {axes} in place of x, y, z ({kind}) it would be {100 * share:.0f} %"
        yield Finding(
            "handedness" if mirrored and share > SURE else "person out of the image",
            f"{section}: its image shows {100 * seen.shown:.0f} % of the markers, expected "
            f"{100 * SHOWN:.0f} % or more; check rotation and translation, [[video]] camera, and "
            f"[markers] up or to_world{rather if share > SURE else ''}",
            fatal=nowhere,
        )
    if seen.covered < COVERED:
        yield Finding(
            "rate",
            f"[[video]] {source.camera_name}: the video lasts during {100 * seen.covered:.0f} % of "
            "the marker samples; if it should be all, check offset and the video's frame rate",
        )


def _other_axes(recording: Recording, camera: Camera) -> tuple[str, float, bool]:
    """Which turn about the vertical by right angles, or mirror image, the camera shows most of.

    Returns:
        The axes that x, y, z would be, the share of the markers shown, whether it is a mirror
        image. Where several do as well, it is a mirror image if left and right say so.
    """
    told = facing(recording)
    expected = bool(told) and all(share <= 1 - MOST for _, share, _ in told)
    positions = recording.positions_world.reshape(-1, 3)
    positions = positions[np.isfinite(positions).all(-1)]
    options = []
    for first, second in ((0, 1), (1, 0)):
        for a, b in ((1, 1), (-1, 1), (1, -1), (-1, -1)):
            signs, columns = np.array([a, b, 1]), [first, second, 2]
            mirrored = a * b * (1 if first == 0 else -1) < 0
            share = float(in_image(camera, positions[:, columns] * signs).mean())
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
    seen = np.isfinite(recording.positions_world[..., 2]).any(0)
    levels = recording.positions_world[:, seen, 2] - heights[seen]
    return float(np.nanmedian(levels, axis=0).min())
