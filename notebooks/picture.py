"""Draws the README's picture: a frame of the demo's overlay beside the right elbow's error.

INPUTS: none. OUTPUTS: ``images/demo.png`` beside this file.
"""

import tempfile
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from jaxmocap.capture.video import Video
from jaxmocap.evaluation.plots import MARKERS_ONLY, WITH_VIDEO
from jaxmocap.pipelines.demo import Demonstration, demonstrate
from jaxmocap.pipelines.kept_programs import keep_compiled

PICTURE = Path(__file__).parent / "images" / "demo.png"
RIGHT = 1
# Rows and columns of the frame that hold the person.
PERSON = np.s_[70:450, 130:510]


def draw(shown: Demonstration, folder: Path) -> Figure:
    """A frame in which video helps the right elbow much, and the errors over time."""
    before, after = (e.distances[:, RIGHT] for e in (shown.markers_only, shown.with_video))
    times = shown.with_video.times
    best = times[np.argmax(before - 3 * after)]
    # The overlay's clock starts at its first frame.
    frames = list(Video(folder / "overlay.mp4", offset=float(times[0])).frames())
    _, image = min(frames, key=lambda frame: abs(frame[0] - best))
    assert image is not None
    figure = Figure(figsize=(11, 3.7), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2, width_ratios=(4, 7))
    left.imshow(image[PERSON][..., ::-1])
    left.axis("off")
    for name, errors, style in (
        ("markers only", before, MARKERS_ONLY),
        ("with video", after, WITH_VIDEO),
    ):
        mean = 100 * np.nanmean(errors)
        right.plot(times, 100 * errors, label=f"{name}: mean {mean:.1f} cm", **style)
    right.axvline(best, color="#888888", linewidth=0.8)
    right.set(xlabel="time [s]", ylabel="right elbow, error [cm]", ylim=(0, None))
    right.spines[["top", "right"]].set_visible(False)
    right.margins(x=0)
    right.grid(color="#dddddd", linewidth=0.6)
    right.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), frameon=False, ncols=2)
    return figure


def main() -> None:
    keep_compiled()
    with tempfile.TemporaryDirectory() as folder:
        figure = draw(demonstrate(folder, progress=True), Path(folder))
    PICTURE.parent.mkdir(exist_ok=True)
    figure.savefig(PICTURE, dpi=110)


if __name__ == "__main__":
    main()
