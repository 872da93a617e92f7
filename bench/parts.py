"""The parts of the benchmark, one after the other.

INPUTS: a folder for what is made on the way. OUTPUTS: Metrics, and which rivals are missing.
"""

from collections.abc import Iterator
from pathlib import Path

import cv2
from tqdm import tqdm

from bench import against_reference, frame_rate, growth, headline, rivals
from bench.footage import film
from bench.metrics import Metric

# Seconds of the clip: quickly, and in full.
CLIP_S = {True: 1.5, False: 2.0}


def run(
    folder: Path,
    quick: bool,
    only: str | None = None,
    samples: int = growth.SAMPLES,
    recordings: Path | None = None,
    detector_python: str | None = None,
) -> tuple[list[Metric], list[str]]:
    """All parts, or one.

    Args:
        folder: to put recordings in.
        quick: only what takes less than a minute.
        only: of "frame rate", "rivals", "growth" and "headline"; the last by its name alone.
        samples: of the long run.
        recordings: real ones, for the headline.
        detector_python: of an environment with MediaPipe, for the headline.

    Returns:
        The figures, and parts of the names of ratios that rivals not installed leave out.
    """
    cv2.setNumThreads(1)
    metrics: list[Metric] = []
    skipped: list[str] = []
    if only == "headline":
        found = headline.measure(folder, recordings, detector_python)
        return list(shown("headline", found)), skipped
    footage = film(folder, CLIP_S[quick])
    if only in (None, "frame rate"):
        metrics += shown("frame rate", frame_rate.measure(footage, quick))
        metrics += shown("against the reference", against_reference.measure(footage, quick))
    if only in (None, "rivals"):
        absent = rivals.missing()
        skipped = rivals.unmeasured(absent)
        metrics += shown("rivals", rivals.measure(quick, absent))
    if only == "growth" or (only is None and not quick):
        metrics += shown("growth", growth.measure(footage, samples))
    return metrics, skipped


def shown(part: str, metrics: Iterator[Metric]) -> Iterator[Metric]:
    """The same, with how far it has come on stderr."""
    with tqdm(metrics, desc=part, unit=" figures") as bar:
        for metric in bar:
            bar.set_postfix_str(metric.name)
            yield metric
