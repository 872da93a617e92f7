"""The parts of the benchmark, one after the other.

INPUTS: a folder for what is made on the way. OUTPUTS: Metrics, and which rivals are missing.
"""

import sys
from pathlib import Path

from bench import against_reference, frame_rate
from bench.metrics import Metric

# Seconds of the clip.
CLIP_S = {"quick": 1.5, "full": 2.0}


def run(folder: Path, quick: bool, only: str | None = None) -> tuple[list[Metric], list[str]]:
    """All parts, or one.

    Args:
        folder: to put recordings in.
        quick: only what takes less than a minute.
        only: of "frame rate", "rivals" and "growth".

    Returns:
        The figures, and the rivals that are not installed.
    """
    metrics: list[Metric] = []
    skipped: list[str] = []
    if only in (None, "frame rate"):
        _say("frame rate")
        metrics += frame_rate.measure(folder, CLIP_S["quick" if quick else "full"], quick)
        metrics += against_reference.measure(folder, quick)
    return metrics, skipped


def _say(part: str) -> None:
    print(f"measuring {part}", file=sys.stderr, flush=True)
