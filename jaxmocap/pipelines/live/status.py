"""What a live run tells: a line that stays up to date, sentences when something changes, figures.

INPUTS: outputs, counts, ages. OUTPUTS: text on a terminal; a dictionary of figures.

However long the run and whatever comes in, little is kept and little is said: what changes all the
time is said from time to time, and nothing that a stranger sent reaches the terminal unescaped.
"""

import sys
from collections import deque
from collections.abc import Mapping
from contextlib import suppress
from typing import Any, NamedTuple, TextIO

import numpy as np

from jaxmocap.capture.streams.senders import TokenBucket
from jaxmocap.formats.files.errors import printable, shortened
from jaxmocap.formats.files.short_repr import short_name

# Of what was said so many first and so many newest sentences are kept.
FIRST_KEPT = 500
NEWEST_KEPT = 500
# The state of one thing is said at each of so many changes, and then so often a second.
CHANGES = 20
CHANGES_A_SECOND = 0.1
# Latencies are told of so many of the newest outputs, and of these that line speaks of.
REMEMBERED, RECENT = 20_000, 300
# A terminal's line is drawn anew so often; elsewhere a line is written more rarely; seconds.
REDRAWN_S, WRITTEN_S = 0.25, 5.0


class Said(NamedTuple):
    """A sentence.

    Attributes:
        seconds: of the run.
        what: the sentence.
    """

    seconds: float
    what: str


class LiveStatus:
    """Keeps count of a run and says what happens.

    Attributes:
        outputs: how many poses went out.
        sentences: that were said.
    """

    def __init__(self, out: TextIO | None = None):
        """Write to a stream; standard error by default."""
        self._out = sys.stderr if out is None else out
        self._drawn = self._out.isatty()
        self.outputs = self.sentences = 0
        self._first: list[Said] = []
        self._newest: deque[Said] = deque(maxlen=NEWEST_KEPT)
        self._latencies: deque[float] = deque(maxlen=REMEMBERED)
        self._times: deque[float] = deque(maxlen=RECENT)
        self._states: dict[str, str] = {}
        self._shares: dict[str, TokenBucket] = {}
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

    @property
    def said(self) -> list[Said]:
        """What was said, but for what was between the first and the newest sentences."""
        return [*self._first, *self._newest]

    def state(self, now: float, of: str, state: str) -> None:
        """Say so when the state of something has changed; "" says nothing.

        What changes more often than ``CHANGES_A_SECOND`` is said later, as it then is. There are
        to be few things that have a state.
        """
        if state == self._states.get(of):
            return
        share = self._shares.setdefault(of, TokenBucket(CHANGES_A_SECOND, CHANGES, now))
        if not share.available(now):
            return
        share.take(1)
        self._states[of] = state
        if state:
            self.say(now, f"{of}: {state}")

    def say(self, now: float, sentence: str) -> None:
        """Say a sentence, with its time."""
        said = Said(round(now, 3), shortened(printable(sentence)))
        self.sentences += 1
        (self._first if len(self._first) < FIRST_KEPT else self._newest).append(said)
        self._print(f"{self._clear()}{now:8.2f} s  {said.what}\n")

    def _print(self, text: str) -> None:
        # A terminal that is gone, or a log on a full disk, ends no run.
        with suppress(OSError, ValueError):
            print(text, end="", file=self._out, flush=True)

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
            "age " + ", ".join(f"{short_name(name)} {_age(age)}" for name, age in ages.items()),
            "elbows " + " ".join(f"{100 * value:.0f} %" for value in confidence),
        ]
        end = "" if self._drawn else "\n"
        self._print(f"{self._clear()}{' | '.join(shown)}{end}")

    def _clear(self) -> str:
        return "\r\x1b[K" if self._drawn else ""

    def finish(self) -> None:
        """Leave the line."""
        if self._drawn:
            self._print("\n")

    def figures(self, seconds: float) -> dict[str, Any]:
        """What the run came to."""
        median, most = self.latency_ms()
        return {
            "seconds": seconds,
            "outputs": self.outputs,
            "rate_hz": self.outputs / seconds if seconds > 0 else 0.0,
            "latency_ms": {"median": median, "p99": most, "of": len(self._latencies)},
            "said": [said._asdict() for said in self.said],
            "sentences": self.sentences,
        }


def _age(age: float | None) -> str:
    if age is None:
        return "-"
    return f"{1e3 * age:.0f} ms" if age < 1 else f"{age:.0f} s"
