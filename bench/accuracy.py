"""``python -m bench.accuracy [RECORDINGS] [--json FILE]``: elbow errors without and with video.

INPUTS: the folder of real recordings, with ``balancing/recording_cam_0*.toml`` and
``balancing/truth.trc`` in it; without one the synthetic table tennis alone.
OUTPUTS: a table, and Metrics as JSON.
"""

import argparse
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bench.metrics import Metric, aligned, write_json
from jaxmocap.evaluation.errors import Errors
from jaxmocap.evaluation.motions import evaluate
from jaxmocap.formats.recording import Recording
from jaxmocap.hybrid.settings import Settings
from jaxmocap.run.compilation import keep_compiled
from jaxmocap.run.recording import track
from jaxmocap.synthetic.recording import write_table_tennis

REAL_ELBOWS = {"elbow_l": "LElbow", "elbow_r": "RElbow"}
ELBOWS = {"elbow_l": "elbow_l", "elbow_r": "elbow_r"}
FEET = ("ankle", "toe")  # parts of their markers' names
HEADINGS = [
    ["recording", "markers", "", "", "video", "", "", "better", "off markers", ""],
    ["", "mean", "median", "95 %", "mean", "median", "95 %", "by", "95 %", "max"],
]


@dataclass(frozen=True)
class Result:
    """One recording, tracked twice.

    Attributes:
        name: of the recording.
        alone: errors of the elbows by markers alone.
        video: the same with video.
        off: (T, M) distances from head and hands to their markers after refinement, metres.
    """

    name: str
    alone: Errors
    video: Errors
    off: np.ndarray

    @property
    def improvement(self) -> float:
        """By which share video lowers the mean error."""
        return 1 - self.video.mean / self.alone.mean

    def row(self) -> list[str]:
        """Centimetres, and the improvement in per cent."""
        cells = [f"{100 * v:.1f}" for e in (self.alone, self.video) for v in spread(e)]
        off = [100 * np.nanpercentile(self.off, 95), 100 * np.nanmax(self.off)]
        return [self.name, *cells, f"{self.improvement:.0%}", *(f"{v:.2f}" for v in off)]

    def metrics(self) -> list[Metric]:
        """The figures that a baseline holds."""
        off = 100 * float(np.nanmax(self.off))
        gain = 100 * self.improvement
        return [
            Metric(f"{self.name}, elbows, markers", 100 * self.alone.mean, "cm", tolerance=0.03),
            Metric(f"{self.name}, elbows, video", 100 * self.video.mean, "cm", tolerance=0.05),
            Metric(f"{self.name}, improvement", gain, "%", "higher", 0.1),
            Metric(f"{self.name}, farthest off a marker", off, "cm", tolerance=0.1),
        ]


def spread(errors: Errors) -> tuple[float, float, float]:
    """Mean, median and 95th percentile over both elbows, metres."""
    found = errors.distances[np.isfinite(errors.distances)]
    return errors.mean, float(np.median(found)), float(np.percentile(found, 95))


def compare(name: str, path: Path, truth: Path, pairs: dict[str, str]) -> Result:
    """Track a recording by markers alone and with video, and hold both against the truth."""
    recording = Recording.load(path)
    alone = track(recording, Settings(refine="none"))
    video = track(recording)
    assert video.report is not None
    upper = [not any(foot in name.lower() for foot in FEET) for name in video.report.markers]
    off = video.report.marker_errors[:, upper]
    return Result(name, evaluate(alone, truth, pairs), evaluate(video, truth, pairs), off)


def balancing(folder: Path) -> list[Result]:
    """One result for each camera of the real recording."""
    paths = sorted(folder.glob("recording_cam_0*.toml"))
    truth = folder / "truth.trc"
    return [
        compare(path.stem.removeprefix("recording_"), path, truth, REAL_ELBOWS) for path in paths
    ]


def table_tennis(seconds: float, seeds: range) -> list[Result]:
    """One result for each synthetic person."""
    results = []
    for seed in seeds:
        with tempfile.TemporaryDirectory() as folder:
            path = write_table_tennis(folder, seconds, seed)
            truth = path.with_name("truth.trc")
            results.append(compare(f"table tennis {seed}", path, truth, ELBOWS))
    return results


def mean_row(name: str, results: list[Result]) -> list[str]:
    """The means over some recordings, and by how much the mean error falls."""
    alone, video = (
        np.mean([spread(getattr(result, which)) for result in results], 0)
        for which in ("alone", "video")
    )
    cells = [f"{100 * v:.1f}" for v in (*alone, *video)]
    return [name, *cells, f"{1 - video[0] / alone[0]:.0%}", "", ""]


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.accuracy", description=__doc__)
    parser.add_argument("recordings", nargs="?", help="folder of the real recordings")
    parser.add_argument("--seconds", type=float, default=6.0, help="of table tennis, each")
    parser.add_argument("--seeds", type=int, default=2, help="of table tennis, how many")
    parser.add_argument("--json", metavar="FILE", help="write the metrics")
    options = parser.parse_args()
    keep_compiled()
    sets = {"table tennis, mean": table_tennis(options.seconds, range(options.seeds))}
    if options.recordings:
        sets["cameras, mean"] = balancing(Path(options.recordings) / "balancing")
    rows = list(HEADINGS)
    for name, results in sets.items():
        rows += [result.row() for result in results]
        rows.append(mean_row(name, results))
    print("elbows: distance from the truth, cm; off markers: head and hands, cm")
    print(aligned(rows))
    if options.json:
        write_json(
            (m for results in sets.values() for r in results for m in r.metrics()), options.json
        )


if __name__ == "__main__":
    main()
