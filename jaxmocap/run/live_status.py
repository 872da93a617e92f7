"""What a live run tells: a line that stays up to date, sentences when something changes, figures.

INPUTS: outputs, counts, ages. OUTPUTS: text on a terminal; a dictionary of figures.
"""

import sys
from collections import deque
from collections.abc import Mapping
from typing import Any, TextIO

import numpy as np

# Latencies are told of so many of the newest outputs, and of these that line speaks of.
REMEMBERED, RECENT = 20_000, 300
# A terminal's line is drawn anew so often; elsewhere a line is written more rarely; seconds.
REDRAWN_S, WRITTEN_S = 0.25, 5.0


class LiveStatus:
    """Keeps count of a run and says what happens.

    Attributes:
        outputs: how many poses went out.
        said: (seconds, sentence) of everything that changed.
    """

    def __init__(self, out: TextIO | None = None):
        """Write to a stream; standard error by default."""
        self._out = sys.stderr if out is None else out
        self._drawn = self._out.isatty()
        self.outputs = 0
        self.said: list[tuple[float, str]] = []
        self._latencies: deque[float] = deque(maxlen=REMEMBERED)
        self._times: deque[float] = deque(maxlen=RECENT)
        self._states: dict[str, str] = {}
        self._next = 0.0

    def output(self, now: float, latency: float) -> None:
        """A pose went out, so many seconds after its sample came in."""
        self.outputs += 1
        self._latencies.append(1e3 * latency)
        self._times.append(now)

    @property
    def newest_latency(self) -> float:
        """Of the newest output, seconds; NaN before the first."""
        return self._latencies[-1] / 1e3 if self._latencies else float("nan")

    def state(self, now: float, of: str, state: str) -> None:
        """Say so when the state of something has changed; "" says nothing."""
        before = self._states.get(of)
        self._states[of] = state
        if state and state != before:
            self.say(now, f"{of}: {state}")

    def say(self, now: float, sentence: str) -> None:
        """Say a sentence, with its time."""
        self.said.append((round(now, 3), sentence))
        print(f"{self._clear()}{now:8.2f} s  {sentence}", file=self._out, flush=True)

    def latency_ms(self, count: int | None = None) -> tuple[float, float]:
        """Median and 99th percentile of the newest outputs; NaN before the first."""
        newest = list(self._latencies)[-(count or REMEMBERED) :]
        if not newest:
            return float("nan"), float("nan")
        median, most = np.percentile(newest, [50, 99])
        return float(median), float(most)

    def rate(self, now: float) -> float:
        """Poses that went out within the last second."""
        return float(sum(now - time <= 1.0 for time in self._times))

    def show(
        self,
        now: float,
        ages: Mapping[str, float | None],
        dropped: Mapping[str, int],
        confidence: np.ndarray,
    ) -> None:
        """Draw the line, if it is time to.

        Args:
            now: seconds.
            ages: stream -> seconds since something came, None before.
            dropped: what -> how many.
            confidence: (2,) in the elbows.
        """
        if now < self._next:
            return
        self._next = now + (REDRAWN_S if self._drawn else WRITTEN_S)
        median, most = self.latency_ms(RECENT)
        shown = [
            f"{self.rate(now):3.0f} /s",
            f"latency {median:.1f} ms, 99 % {most:.1f} ms",
            "dropped " + ", ".join(f"{count} {what}" for what, count in dropped.items()),
            "age " + ", ".join(f"{name} {_age(age)}" for name, age in ages.items()),
            "elbows " + " ".join(f"{100 * value:.0f} %" for value in confidence),
        ]
        end = "" if self._drawn else "\n"
        print(f"{self._clear()}{' | '.join(shown)}", end=end, file=self._out, flush=True)

    def _clear(self) -> str:
        return "\r\x1b[K" if self._drawn else ""

    def finish(self) -> None:
        """Leave the line."""
        if self._drawn:
            print(file=self._out)

    def figures(self, seconds: float) -> dict[str, Any]:
        """What the run came to."""
        median, most = self.latency_ms()
        return {
            "seconds": seconds,
            "outputs": self.outputs,
            "rate_hz": self.outputs / seconds if seconds > 0 else 0.0,
            "latency_ms": {"median": median, "p99": most, "of": len(self._latencies)},
            "said": [{"seconds": at, "what": what} for at, what in self.said],
        }


def _age(age: float | None) -> str:
    if age is None:
        return "-"
    return f"{1e3 * age:.0f} ms" if age < 1 else f"{age:.0f} s"
