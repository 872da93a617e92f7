"""The body drawn over its video: outlines, bones, joints, uncertainty and marker targets.

INPUTS: frames of one camera (seconds of marker time, BGR), the camera, a Motion.
OUTPUTS: an H.264 video in an MP4 file that browsers play, each frame at its own time.
"""

from collections.abc import Iterable, Mapping
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
from av.container import OutputContainer
from av.video.stream import VideoStream

from jaxmocap.body.motion import UNDETERMINED_M, Motion
from jaxmocap.formats.cameras.video_out import replacing_video
from jaxmocap.formats.files.errors import InputError
from jaxmocap.geometry.cameras import Camera, visible_pixels
from jaxmocap.outputs.ellipses import SIGMAS, ellipses_in, uncertainty_of
from jaxmocap.outputs.scene import BodyScene, limb_outlines, make_scene

# BGR.
Colour = tuple[int, int, int]
BONE_COLOUR = (230, 230, 230)
JOINT_COLOUR = (255, 255, 255)
# Of the left and the right arm.
OUTLINE_COLOURS = {"l": (255, 200, 60), "r": (60, 160, 255)}
ELBOW_COLOURS = {f"elbow_{side}": colour for side, colour in OUTLINE_COLOURS.items()}
TARGET_COLOUR = (255, 60, 255)
# Of the ellipses of other landmarks than elbows, and their opacity within.
ELLIPSE_COLOUR, ELLIPSE_OPACITY = (200, 190, 190), 0.18
# Brightness that the image keeps behind the legend.
LEGEND_BACKGROUND = 0.45
# Ticks per second of the file's clock.
CLOCK_HZ = 90_000
# Fractional bits of OpenCV's drawing.
SHIFT = 4
# Browsers need the table of contents at the file's beginning.
_MP4_OPTIONS = {"movflags": "faststart"}


def write_overlay(
    path: str | Path,
    frames: Iterable[tuple[float, np.ndarray | None]],
    camera: Camera,
    motion: Motion,
    targets: Mapping[str, np.ndarray] | None = None,
    rate: float = 30.0,
) -> int:
    """Write a video with the body drawn over every frame.

    Args:
        path: of the .mp4 file; it appears when it is complete.
        frames: seconds of marker time, rising, and image (H, W, 3) BGR uint8; None is black.
        camera: that took the frames.
        motion: drawn where it is at each frame's time.
        targets: marker -> (T, 3) measured positions at the motion's times, world, metres.
        rate: nominal frames per second.

    Returns:
        The number of frames written.

    Raises:
        InputError: not one frame to draw on.
        OutputError: it cannot be written completely; what was there before is as it was.
    """
    artist = OverlayArtist(camera, motion, targets)
    count, first, stamp, stream = 0, 0.0, -1, None
    with replacing_video(path, format="mp4", options=_MP4_OPTIONS) as file:
        for time, image in frames:
            canvas = artist.canvas(image)
            artist.draw(canvas, time)
            if stream is None:
                first, stream = time, _add_stream(file.container, canvas, rate)
            # Two frames of the same time would not be a valid file.
            stamp = max(stamp + 1, round((time - first) * CLOCK_HZ))
            frame = av.VideoFrame.from_ndarray(canvas, format="bgr24")
            frame.pts, frame.time_base = stamp, Fraction(1, CLOCK_HZ)
            file.write(stream.encode(frame))
            count += 1
        if stream is None:
            raise InputError(path, "found no video frame to draw on")
        file.write(stream.encode(None))
    return count


def _add_stream(container: OutputContainer, canvas: np.ndarray, rate: float) -> VideoStream:
    stream = container.add_stream(
        "libx264",
        rate=Fraction(rate).limit_denominator(1001),
        options={"preset": "superfast", "crf": "21"},
    )
    stream.height, stream.width = canvas.shape[:2]
    stream.pix_fmt = "yuv420p"
    stream.codec_context.time_base = Fraction(1, CLOCK_HZ)
    return stream


class OverlayArtist:
    """Draws one motion into the images of one camera."""

    def __init__(
        self, camera: Camera, motion: Motion, targets: Mapping[str, np.ndarray] | None = None
    ):
        self.camera, self.motion = camera, motion
        self.targets = dict(targets or {})
        self.scene: BodyScene = make_scene(motion)
        self.uncertainty = uncertainty_of(motion)
        self._shape: tuple[int, int] | None = None

    def canvas(self, image: np.ndarray | None) -> np.ndarray:
        """A copy of the image on a canvas with even sides, as H.264 needs; all of one size."""
        if self._shape is None:
            width, height = np.asarray(self.camera.size, int)
            height, width = (height, width) if image is None else image.shape[:2]
            self._shape = (int(height + height % 2), int(width + width % 2))
        canvas = np.zeros((*self._shape, 3), np.uint8)
        if image is not None:
            rows, columns = np.minimum(image.shape[:2], self._shape)
            canvas[:rows, :columns] = image[:rows, :columns]
        return canvas

    def draw(self, canvas: np.ndarray, time: float) -> None:
        """Draw the body at that time, in place; without a pose only the legend."""
        size = max(1, round(min(canvas.shape[:2]) / 480))
        sample = int(np.argmin(np.abs(self.scene.times - time)))
        ends = self.scene.at(time)
        ends = None if ends is None or not np.isfinite(ends).all() else ends
        if ends is not None:
            if self.uncertainty is not None:
                for landmark, loop in ellipses_in(self.camera, self.uncertainty, time).items():
                    colour = ELBOW_COLOURS.get(landmark, ELLIPSE_COLOUR)
                    _tint(canvas, loop, colour)
                    _draw_line(canvas, loop, colour, size)
            near, far = ends
            tree, arms = self.scene.tree, self.scene.tree.bones_in("arm")
            loops = limb_outlines(self.camera, near[arms], far[arms], self.scene.radii[arms])
            for bone, loop in zip(arms, loops, strict=True):
                _draw_line(canvas, loop, OUTLINE_COLOURS[tree.segments[bone].side], size)
            self._draw_points(canvas, *ends, sample, size)
        title = f"{time:.2f} s" + ("" if ends is not None else ", no pose")
        legend = [] if ends is None else self._legend(sample)
        draw_legend(canvas, [(title, JOINT_COLOUR), *legend])

    def _legend(self, sample: int) -> list[tuple[str, Colour]]:
        """What the colours, the ellipses and the crosses are."""
        report = self.motion.report
        deviations = (np.nan, np.nan) if report is None else report.elbow_deviations[sample]
        lines = []
        for side, name, value in zip("lr", ("left", "right"), deviations, strict=True):
            stated = f" +/- {100 * value:.0f} cm" if np.isfinite(value) else ""
            if value > UNDETERMINED_M:
                stated = f" > {100 * UNDETERMINED_M:.0f} cm"
            lines.append((f"{name} elbow{stated}", OUTLINE_COLOURS[side]))
        if np.isfinite(deviations).any():
            lines.append((f"ellipses: {SIGMAS:.0f} std. dev.", ELLIPSE_COLOUR))
        return [*lines, *([("+ marker", TARGET_COLOUR)] if self.targets else [])]

    def _draw_points(
        self, canvas: np.ndarray, near: np.ndarray, far: np.ndarray, sample: int, size: int
    ) -> None:
        """Bones, joints and targets, projected in one go."""
        measured = [positions[sample] for positions in self.targets.values()]
        points = np.concatenate([near, far, np.reshape(measured, (-1, 3))])
        near_xy, far_xy, targets_xy = np.split(
            visible_pixels(self.camera, points), [len(near), 2 * len(near)]
        )
        for line in np.stack([near_xy, far_xy], 1):
            _draw_line(canvas, line, BONE_COLOUR, size)
        for at in _to_fixed_point(near_xy, SHIFT).tolist():
            cv2.circle(canvas, at, 2 * size << SHIFT, JOINT_COLOUR, -1, cv2.LINE_AA, SHIFT)
        mark, width = (cv2.MARKER_CROSS, 12 * size), size + 1
        for at in _to_fixed_point(targets_xy).tolist():
            cv2.drawMarker(canvas, at, TARGET_COLOUR, *mark, width, cv2.LINE_AA)


def encode_jpeg(image: np.ndarray, quality: int) -> bytes:
    """A JPEG file of a BGR or grey uint8 image; quality from 1 to 100."""
    return cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()


def _tint(canvas: np.ndarray, points: np.ndarray, colour: Colour) -> None:
    """Lay a colour thinly over what a closed line (P, 2) holds."""
    height, width = canvas.shape[:2]
    left, top = np.maximum(np.floor(points.min(0)), 0).astype(int)
    right, bottom = np.minimum(np.ceil(points.max(0)) + 1, [width, height]).astype(int)
    if left >= right or top >= bottom:
        return
    part = canvas[top:bottom, left:right]
    tinted = part.copy()
    cv2.fillPoly(tinted, [_to_fixed_point(points - [left, top], SHIFT)], colour, cv2.LINE_AA, SHIFT)
    cv2.addWeighted(tinted, ELLIPSE_OPACITY, part, 1 - ELLIPSE_OPACITY, 0, part)


def _draw_line(canvas: np.ndarray, points: np.ndarray, colour: Colour, width: int) -> None:
    if np.isfinite(points).all():
        cv2.polylines(
            canvas, [_to_fixed_point(points, SHIFT)], False, colour, width, cv2.LINE_AA, SHIFT
        )


def _to_fixed_point(points: np.ndarray, bits: int = 0) -> np.ndarray:
    """(P, 2) int32, so many bits of them fractions, of those that are finite."""
    # OpenCV's fixed point overflows far outside the image.
    points = np.clip(points[np.isfinite(points).all(-1)], -1e4, 1e4)
    return (points * 2**bits).round().astype(np.int32)


def draw_legend(canvas: np.ndarray, lines: list[tuple[str, Colour]]) -> None:
    """Lines of text in their colours, small and on a darkened part of the image's corner."""
    scale = max(0.33, min(canvas.shape[:2]) / 1400)
    font, thick = cv2.FONT_HERSHEY_SIMPLEX, max(1, round(1.5 * scale))
    sizes = [cv2.getTextSize(text, font, scale, thick)[0] for text, _ in lines]
    row, margin = round(1.7 * max(height for _, height in sizes)), round(18 * scale)
    width = max(width for width, _ in sizes) + 2 * margin
    part = canvas[: row * len(lines) + 2 * margin, :width]
    part[:] = LEGEND_BACKGROUND * part
    for number, (text, colour) in enumerate(lines, 1):
        place = (margin, margin + number * row - (row - sizes[0][1]) // 2)
        cv2.putText(canvas, text, place, font, scale, colour, thick, cv2.LINE_AA)
