"""Wrong turns: where video made a joint worse than the markers alone had it.

INPUTS: errors of the same joints by markers alone and with video, at the same times.
OUTPUTS: WrongTurns.
"""

from dataclasses import dataclass

import numpy as np

from jaxmocap.evaluation.series import sample_step

WORSE_BY_M = 0.05


@dataclass(frozen=True)
class WrongTurns:
    """Where J joints were worse with video.

    Attributes:
        share: (J,) of the samples; NaN for a joint without data.
        longest: (J,) the longest stretch without a good sample, seconds: how long it takes to
            recover.
    """

    share: np.ndarray
    longest: np.ndarray


def wrong_turns(
    times: np.ndarray, alone: np.ndarray, video: np.ndarray, worse_by: float = WORSE_BY_M
) -> WrongTurns:
    """Samples at which video's error exceeds the other by more than ``worse_by``.

    Args:
        times: (N,) seconds.
        alone: (N, J) errors by markers alone, metres; NaN where unknown.
        video: (N, J) errors with video, likewise. Unknown samples count neither way.
        worse_by: metres.
    """
    is_measured = np.isfinite(alone) & np.isfinite(video)
    wrong = is_measured & (video > alone + worse_by)
    counts = is_measured.sum(0)
    share = np.where(counts > 0, wrong.sum(0) / np.maximum(counts, 1), np.nan)
    step = sample_step(times)
    longest = [
        _longest(times[rows], bad[rows], step)
        for rows, bad in zip(is_measured.T, wrong.T, strict=True)
    ]
    return WrongTurns(share, np.array(longest))


def _longest(times: np.ndarray, bad: np.ndarray, step: float) -> float:
    """Seconds from the first to the last sample of the longest run of bad ones, and one sample."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], bad, [False]]).astype(int)))
    starts, ends = edges[::2], edges[1::2] - 1
    return float((times[ends] - times[starts]).max() + step) if len(starts) else 0.0
