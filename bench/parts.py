"""The parts of the benchmark, one after the other.

INPUTS: a folder for what is made on the way. OUTPUTS: Metrics, and which rivals are missing.
"""

import sys
from pathlib import Path

import cv2

from bench import against_reference, frame_rate, growth, rivals
from bench.footage import film
from bench.metrics import Metric

# Seconds of the clip: quickly, and in full.
CLIP_S = {True: 1.5, False: 2.0}


def run(
    folder: Path, quick: bool, only: str | None = None, samples: int = growth.SAMPLES
) -> tuple[list[Metric], list[str]]:
    """All parts, or one.

    Args:
        folder: to put recordings in.
        quick: only what takes less than a minute.
        only: of "frame rate", "rivals" and "growth".
        samples: of the long run.

    Returns:
        The figures, and the rivals that are not installed.
    """
    cv2.setNumThreads(1)
    metrics: list[Metric] = []
    skipped: list[str] = []
    footage = film(folder, CLIP_S[quick])
    if only in (None, "frame rate"):
        _say("frame rate")
        metrics += frame_rate.measure(footage, quick)
        metrics += against_reference.measure(footage, quick)
    if only in (None, "rivals"):
        _say("rivals")
        skipped = rivals.missing()
        metrics += rivals.measure(quick, skipped)
    if only == "growth" or (only is None and not quick):
        _say("growth")
        metrics += growth.measure(footage, samples)
    return metrics, skipped


def _say(part: str) -> None:
    print(f"measuring {part}", file=sys.stderr, flush=True)
