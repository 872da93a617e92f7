"""The body drawn over its video: outlines, bones, joints and marker targets.

INPUTS: frames of one camera (seconds of marker time, BGR), the camera, a Motion.
OUTPUTS: an H.264 video in an MP4 file that browsers play, each frame at its own time.
"""

from collections.abc import Iterable, Iterator, Mapping
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
from av.container import OutputContainer
from av.video.stream import VideoStream

from jaxmocap.body.motion import Motion
from jaxmocap.formats.cameras.video_out import replacing_video
from jaxmocap.formats.files.errors import InputError
from jaxmocap.geometry.cameras import Camera
from jaxmocap.outputs.scene import BodyScene, limb_outlines, make_scene, pixels

# Colours are BGR.
BONE_COLOUR = (230, 230, 230)
JOINT_COLOUR = (255, 255, 255)
# Of the left and the right arm.
OUTLINE_COLOURS = {"l": (255, 200, 60), "r": (60, 160, 255)}
TARGET_COLOUR = (255, 60, 255)
# An elbow of this deviation is red, metres: little more than the markers' guess.
UNSURE_M = 0.1
# Of an unknown deviation.
UNKNOWN_COLOUR = (170, 170, 170)
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
        for time, canvas in artist.drawn(frames):
            if stream is None:
                first, stream = time, _add_stream(file.container, canvas, rate)
            # Two frames of the same time would not be a valid file.
            stamp = max(stamp + 1, round((time - first) * CLOCK_HZ))
            file.write(stream.encode(_video_frame(canvas, stamp)))
            count += 1
        if stream is None:
            raise InputError(path, "found no video frame to draw on")
        file.write(stream.encode(None))
    return count


def _video_frame(canvas: np.ndarray, stamp: int) -> av.VideoFrame:
    """A frame at so many ticks of ``CLOCK_HZ``."""
    frame = av.VideoFrame.from_ndarray(canvas, format="bgr24")
    frame.pts, frame.time_base = stamp, Fraction(1, CLOCK_HZ)
    return frame


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

    def drawn(
        self, frames: Iterable[tuple[float, np.ndarray | None]]
    ) -> Iterator[tuple[float, np.ndarray]]:
        """Time and canvas of each frame, with the body drawn over it."""
        for time, image in frames:
            canvas = self.canvas(image)
            self.draw(canvas, time)
            yield time, canvas

    def draw(self, canvas: np.ndarray, time: float) -> None:
        """Draw the body at that time, in place; beyond the motion only the legend."""
        size = max(1, round(min(canvas.shape[:2]) / 480))
        sample = int(np.argmin(np.abs(self.scene.times - time)))
        ends, deviations = self.scene.at(time), self._deviations(sample)
        if ends is not None:
            self._draw_outlines(canvas, *ends, size)
            self._draw_points(canvas, *ends, sample, size)
        _draw_legend(canvas, time, deviations, ends is not None, bool(self.targets))

    def _deviations(self, sample: int) -> dict[str, float]:
        report = self.motion.report
        left, right = (np.nan, np.nan) if report is None else report.elbow_deviations[sample]
        return {"l": float(left), "r": float(right)}

    def _draw_outlines(
        self, canvas: np.ndarray, near: np.ndarray, far: np.ndarray, size: int
    ) -> None:
        tree = self.scene.tree
        arms = tree.bones_in("arm")
        loops = limb_outlines(self.camera, near[arms], far[arms], self.scene.radii[arms])
        for bone, loop in zip(arms, loops, strict=True):
            _draw_line(canvas, loop, OUTLINE_COLOURS[tree.segments[bone].side], size)

    def _draw_points(
        self, canvas: np.ndarray, near: np.ndarray, far: np.ndarray, sample: int, size: int
    ) -> None:
        """Bones, joints and targets, projected in one go."""
        measured = [positions[sample] for positions in self.targets.values()]
        points = np.concatenate([near, far, np.reshape(measured, (-1, 3))])
        near_xy, far_xy, targets_xy = np.split(
            pixels(self.camera, points), [len(near), 2 * len(near)]
        )
        for line in np.stack([near_xy, far_xy], 1):
            _draw_line(canvas, line, BONE_COLOUR, size)
        deviations = self._deviations(sample)
        for segment, pixel in zip(self.scene.tree.segments, near_xy, strict=True):
            if segment.part == "forearm":
                _draw_dot(canvas, pixel, deviation_colour(deviations[segment.side]), 5 * size)
            else:
                _draw_dot(canvas, pixel, JOINT_COLOUR, 2 * size)
        for pixel in targets_xy:
            _draw_cross(canvas, pixel, TARGET_COLOUR, size)


def encode_jpeg(image: np.ndarray, quality: int) -> bytes:
    """A JPEG file of a BGR or grey uint8 image; quality from 1 to 100."""
    return cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()


def deviation_colour(deviation: float) -> tuple[int, int, int]:
    """BGR: from green at 0 over yellow to red at ``UNSURE_M`` and beyond; grey where unknown."""
    if not np.isfinite(deviation):
        return UNKNOWN_COLOUR
    part = 1 - float(np.clip(deviation / UNSURE_M, 0.0, 1.0))
    return 0, round(255 * min(1.0, 2 * part)), round(255 * min(1.0, 2 - 2 * part))


def _draw_line(canvas: np.ndarray, points: np.ndarray, colour: tuple, width: int) -> None:
    if np.isfinite(points).all():
        # OpenCV's fixed point overflows far outside the image.
        fixed = np.clip(points, -1e4, 1e4) * 2**SHIFT
        cv2.polylines(
            canvas, [fixed.round().astype(np.int32)], False, colour, width, cv2.LINE_AA, SHIFT
        )


def _draw_dot(canvas: np.ndarray, pixel: np.ndarray, colour: tuple, radius: int) -> None:
    if np.isfinite(pixel).all():
        fixed = (np.clip(pixel, -1e4, 1e4) * 2**SHIFT).round().astype(int).tolist()
        cv2.circle(canvas, fixed, radius << SHIFT, colour, -1, cv2.LINE_AA, SHIFT)


def _draw_cross(canvas: np.ndarray, pixel: np.ndarray, colour: tuple, size: int) -> None:
    if np.isfinite(pixel).all():
        at = np.clip(pixel, -1e4, 1e4).round().astype(int).tolist()
        cv2.drawMarker(canvas, at, colour, cv2.MARKER_CROSS, 12 * size, size + 1, cv2.LINE_AA)


def _draw_legend(
    canvas: np.ndarray, time: float, deviations: dict[str, float], tracked: bool, marked: bool
) -> None:
    """Time, both elbows' deviations in their colours, and what the colours and crosses mean."""
    scale = max(0.4, min(canvas.shape[:2]) / 1000)
    line, left = round(34 * scale), round(12 * scale)
    title = f"t = {time:.3f} s" + ("" if tracked else ", no pose")
    lines: list[tuple[str, tuple[int, int, int]]] = [(title, JOINT_COLOUR)]
    for side, name in (("l", "left"), ("r", "right")):
        value = deviations[side]
        sure = f"+/- {100 * value:.0f} cm" if np.isfinite(value) else "not estimated"
        lines.append((f"{name} elbow {sure}", deviation_colour(value)))
    for row, (text, colour) in enumerate(lines, 1):
        _write(canvas, text, (left, row * line), colour, scale)
    bottom = canvas.shape[0] - round(12 * scale)
    arms = [("left arm", OUTLINE_COLOURS["l"]), ("right arm", OUTLINE_COLOURS["r"])]
    for text, colour in [*arms, *([("+ marker", TARGET_COLOUR)] if marked else [])]:
        left += _write(canvas, text, (left, bottom), colour, scale) + line


def _write(
    canvas: np.ndarray, text: str, place: tuple[int, int], colour: tuple, scale: float
) -> int:
    """Write text with a dark rim, readable on any background; its width in pixels."""
    font, thick = cv2.FONT_HERSHEY_SIMPLEX, max(1, round(1.6 * scale))
    x, y = place
    # Shifted copies: a thicker stroke would be a wider text in OpenCV 5.
    for dx, dy in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
        rim = (x + dx * thick, y + dy * thick)
        cv2.putText(canvas, text, rim, font, scale, (0, 0, 0), thick, cv2.LINE_AA)
    cv2.putText(canvas, text, place, font, scale, colour, thick, cv2.LINE_AA)
    return cv2.getTextSize(text, font, scale, thick)[0][0]
