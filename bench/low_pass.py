"""``python -m bench.low_pass RECORDINGS``: a low-pass on poses that are found frame by frame.

The first paper's section 7 proposes it against oscillations that video brings. Five table-tennis
players, 6 s, and the four cameras of the real recording, by ``--paper`` and by our own way without
smoothing: the elbows' mean error, its part above 0.3 Hz, and their acceleration by the truth's.

INPUTS: the folder of recordings; without one the synthetic ones alone. OUTPUTS: a table, and
Metrics.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from bench import command, kept, seeds
from bench.clips import Clip, real, synthetic
from bench.evaluation import calm_of
from bench.figures import Metric, aligned, write_json
from jaxmocap.body.motion import Motion
from jaxmocap.evaluation.motions import evaluate
from jaxmocap.formats.recordings.recording import Recording
from jaxmocap.hybrid.settings import Settings
from jaxmocap.pipelines.kept_programs import keep_compiled
from jaxmocap.pipelines.tracking.motions import low_passed
from jaxmocap.pipelines.tracking.track import track

CUTOFFS = (0.0, 1.0, 2.0, 4.0, 6.0)
AZIMUTHS = (0.0, -60.0, 60.0, -30.0, 30.0)
FIGURES = {"mean": "cm", "above 0.3 Hz": "cm", "acceleration": "truth's"}


def figures(motion: Motion, clip: Clip) -> tuple[float, float, float]:
    """Of both elbows."""
    errors = evaluate(motion, clip.truth, clip.pairs)
    fast = float(np.sqrt(np.nanmean(errors.high_passed**2)))
    return 100 * errors.mean, 100 * fast, calm_of(motion, clip).ratio


def measured(clips: Sequence[Clip]) -> Iterator[tuple[str, np.ndarray]]:
    """Way by way the mean figures over all clips, (cut-offs, 3)."""
    for name, settings in (("--paper", Settings.paper()), ("ours", Settings(smooth=False))):
        rows = []
        for clip in clips:
            mode = "nearest" if name == "--paper" else "own"
            motion = track(Recording.load(clip.path), settings, mode=mode)
            rows.append([figures(_passed(motion, cutoff), clip) for cutoff in CUTOFFS])
        yield name, np.mean(rows, 0)


def _passed(motion: Motion, cutoff: float) -> Motion:
    if not cutoff:
        return motion
    poses = low_passed(motion.times, motion.poses, motion.skeleton, cutoff)
    return replace(motion, poses=poses)


def main() -> None:
    """Track, filter, compare, print."""
    parser = command("bench.low_pass", __doc__)
    parser.add_argument("recordings", nargs="?", help="folder of the real recordings")
    parser.add_argument("--seeds", type=seeds, default=seeds("0-4"), metavar="0-4", help="players")
    parser.add_argument("--keep", metavar="DIR", help="keep rendered recordings here")
    options = parser.parse_args()
    keep_compiled()
    cells, metrics = [["", "Hz", *(f"{name}, {unit}" for name, unit in FIGURES.items())]], []
    with kept(options.keep) as keep:
        groups = {"tennis": synthetic("tennis", options.seeds, AZIMUTHS, 6.0, keep)}
        if options.recordings:
            groups["balancing"] = real(Path(options.recordings))
        for group, clips in groups.items():
            for way, values in measured(clips):
                for cutoff, row in zip(CUTOFFS, values, strict=True):
                    hertz = f"{cutoff:g}" if cutoff else "-"
                    cells.append([f"{group}, {way}", hertz, *(f"{v:.1f}" for v in row)])
                    metrics += [
                        Metric(f"low-pass, {group}, {way}, {hertz} Hz, {name}", float(v), unit)
                        for (name, unit), v in zip(FIGURES.items(), row, strict=True)
                    ]
    print(aligned(cells))
    write_json(metrics, options.json)


if __name__ == "__main__":
    main()
