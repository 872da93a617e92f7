"""``python -m bench.paper``: the first paper's loop, live, and what its simplex is worth.

Table tennis as in the paper, the camera in front, in a bare and in a furnished room. Every video
frame is one step: inverse kinematics by SDLS, regions and edges, the chamfer sum (13) minimised
from the markers' pose, balance. The sum is drawn as a raster, or integrated over points. The
simplex over both arms stands beside least squares over the whole body, which always integrate.

INPUTS: seeds of players. OUTPUTS: a table, and Metrics as JSON: elbows' mean errors, steps' times.
"""

import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from time import perf_counter

import jax
import numpy as np

from bench import command, seeds
from bench.figures import Metric, aligned, write_json
from jaxmocap.body.kinematics import landmarks
from jaxmocap.body.skeleton import LANDMARKS
from jaxmocap.capture.markers import interpolate_markers
from jaxmocap.capture.video import open_video
from jaxmocap.formats.recordings.recording import Recording
from jaxmocap.formats.time_series.markers import read_markers
from jaxmocap.hybrid.paper.chamfer import Chamfer
from jaxmocap.hybrid.settings import Settings
from jaxmocap.hybrid.tracker import HybridTracker
from jaxmocap.pipelines.kept_programs import keep_compiled
from jaxmocap.synthetic.recording import write_table_tennis

PAPER = Settings.paper()
INTEGRATED = replace(PAPER, edges=Chamfer(drawn=False))
WAYS = {
    "markers": replace(PAPER, refine="none"),
    "simplex, drawn": PAPER,
    "simplex, integrated": INTEGRATED,
    "least squares, integrated": replace(INTEGRATED, refine="gradient"),
}
ELBOWS = [LANDMARKS.index(f"elbow_{side}") for side in "lr"]
# Steps that compile, or wait for memory.
WARM = 5
HEADINGS = [["room", "way", "left", "right", "against", "ms a step", "", "frames"],
            ["", "", "cm", "cm", "markers", "median", "99 %", "per s"]]  # fmt: skip
_LANDMARKS = jax.jit(landmarks)


def steps(path: Path, settings: Settings) -> tuple[np.ndarray, np.ndarray]:
    """Elbows' distances (F, 2) from the truth, cm, and what the F steps took, ms."""
    recording = Recording.load(path)
    tracker, truth = (
        HybridTracker.from_recording(recording, settings),
        read_markers(path.parent / "truth.trc"),
    )
    true = np.stack([truth.points()[name] for name in ("elbow_l", "elbow_r")], 1)
    frames = list(open_video(recording.videos[0]).frames())
    times = np.array([time for time, _ in frames])
    markers = interpolate_markers(recording.times, recording.positions_world, times)
    there = interpolate_markers(truth.times, true, times)
    state, off, spent = tracker.init(markers[0]), [], []
    images = [[image] if tracker.model.camera_count else None for _, image in frames]
    for time, points, elbows, image in zip(times, markers, there, images, strict=True):
        began = perf_counter()
        state, pose, _ = jax.block_until_ready(tracker.step(state, time, points, image))
        spent.append(1e3 * (perf_counter() - began))
        found = np.asarray(_LANDMARKS(tracker.model.skeleton, pose))[ELBOWS]
        off.append(100 * np.linalg.norm(found - elbows, axis=-1))
    return np.array(off), np.array(spent)


def measure(
    players: list[int], seconds: float, folder: Path
) -> Iterator[tuple[list, list[Metric]]]:
    """A row and its metrics, for each room and way."""
    for room in ("bare", "furnished"):
        paths = [
            write_table_tennis(
                folder / room / str(seed), seconds, seed=seed, furnished=room == "furnished"
            )
            for seed in players
        ]
        alone = np.nan
        for way, settings in WAYS.items():
            each = [steps(path, settings) for path in paths]
            left, right = np.mean([np.nanmean(off, 0) for off, _ in each], 0)
            alone = right if way == "markers" else alone
            spent = np.concatenate([times[WARM:] for _, times in each])
            median, late = np.percentile(spent, [50, 99])
            name = f"paper, {room}, {way}"
            yield (
                [room, way, f"{left:.1f}", f"{right:.1f}", f"{right / alone - 1:+.0%}",
                 f"{median:.1f}", f"{late:.1f}", f"{1e3 / median:.0f}"],
                [Metric(f"{name}, right elbow", float(right), "cm"),
                 Metric(f"{name}, left elbow", float(left), "cm"),
                 Metric(f"{name}, step, median", float(median), "ms"),
                 Metric(f"{name}, step, 99 %", float(late), "ms", tolerance=1.0)],
            )  # fmt: skip


def main() -> None:
    command_line = command("bench.paper", __doc__)
    add = command_line.add_argument
    add("--seeds", type=seeds, default=seeds("0-4"), metavar="0-4", help="of the players")
    add("--seconds", type=float, default=6.0, help="of each clip; default: %(default)s")
    options = command_line.parse_args()
    keep_compiled()
    with tempfile.TemporaryDirectory() as folder:
        rows, metrics = zip(*measure(options.seeds, options.seconds, Path(folder)), strict=True)
    print(aligned([*HEADINGS, *rows]))
    write_json((metric for each in metrics for metric in each), options.json)


if __name__ == "__main__":
    main()
