"""Draws the README's moving picture: the demo's overlay beside the right elbow's error.

INPUTS: none. OUTPUTS: ``images/demo.gif`` beside this file.
"""

import tempfile
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from jaxmocap.capture.video import Video
from jaxmocap.evaluation.plots import MARKERS_ONLY, WITH_VIDEO
from jaxmocap.pipelines.demo import Demonstration, demonstrate
from jaxmocap.pipelines.kept_programs import keep_compiled
from jaxmocap.synthetic.recording import CAMERA

PICTURE = Path(__file__).parent / "images" / "demo.gif"
RIGHT = 1
# Rows and columns of the frame that hold the person; height in the picture, pixels.
PERSON, HEIGHT = np.s_[55:455, 150:490], 300
# One frame in so many is shown, for so many milliseconds; seconds in all.
EVERY, SHOWN_MS, SECONDS = 3, 100, 4.5
COLOURS = 96


def curves(shown: Demonstration) -> np.ndarray:
    """The right elbow's errors over time, (h, w, 3) RGB, and a function of time to a column."""
    before, after = (e.distances[:, RIGHT] for e in (shown.markers_only, shown.with_video))
    times = shown.with_video.times
    figure = Figure(figsize=(4.6, 3.0), dpi=100, layout="constrained")
    canvas, axes = FigureCanvasAgg(figure), figure.subplots()
    for name, errors, style in (
        ("markers only", before, MARKERS_ONLY),
        ("with video", after, WITH_VIDEO),
    ):
        mean = 100 * np.nanmean(errors)
        axes.plot(times, 100 * errors, label=f"{name}: mean {mean:.1f} cm", **style)
    axes.set(xlabel="time [s]", ylabel="right elbow, position error [cm]", ylim=(0, None))
    axes.set_xlim(times[0], times[0] + SECONDS)
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(color="#dddddd", linewidth=0.6)
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), frameon=False, ncols=2, fontsize=8)
    canvas.draw()
    picture = np.asarray(canvas.buffer_rgba())[..., :3].copy()
    left, right = (int(axes.transData.transform((t, 0))[0]) for t in axes.get_xlim())
    top, bottom = (len(picture) - int(axes.get_window_extent().get_points()[i, 1]) for i in (1, 0))
    return picture, (left, right, top, bottom)


def frames(shown: Demonstration, folder: Path) -> Iterator[np.ndarray]:
    """Overlay and curves, side by side, (h, w, 3) RGB."""
    picture, (left, right, top, bottom) = curves(shown)
    for number, (time, image) in enumerate(Video(folder / f"overlay_{CAMERA}.mp4").frames()):
        if number % EVERY or image is None:
            continue
        if time > SECONDS:
            return
        person = image[PERSON]
        width = round(HEIGHT * person.shape[1] / person.shape[0])
        person = cv2.resize(person, (width, HEIGHT), interpolation=cv2.INTER_AREA)
        beside = picture.copy()
        column = round(left + (right - left) * time / SECONDS)
        beside[top:bottom, column : column + 2] = 120
        yield np.hstack([person[..., ::-1], beside])


def main() -> None:
    keep_compiled()
    with tempfile.TemporaryDirectory() as folder:
        shown = demonstrate(folder, progress=True)
        images = [Image.fromarray(frame) for frame in frames(shown, Path(folder))]
    palette = images[len(images) // 2].quantize(COLOURS)
    first, *rest = (image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images)
    PICTURE.parent.mkdir(exist_ok=True)
    first.save(PICTURE, save_all=True, append_images=rest, duration=SHOWN_MS, loop=0)


if __name__ == "__main__":
    main()
