"""The status of a live run: a line that is kept up to date, messages, figures.

INPUTS: outputs, counts, ages; the streams. OUTPUTS: text on a terminal; a dictionary of figures.

Memory and output stay bounded, however long the run: a state that changes all the time is printed
at a limited rate, and a count changes its state at every tenfold, not at every packet. Nothing that
was received reaches the terminal unescaped.
"""

import sys
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from typing import Any, TextIO

import numpy as np

from jaxmocap.body.motion import UNDETERMINED_M
from jaxmocap.capture.streams.cameras import LiveCamera
from jaxmocap.capture.streams.sample_assembly import SampleAssembler
from jaxmocap.capture.streams.senders import TokenBucket
from jaxmocap.capture.streams.source import MarkerSource
from jaxmocap.formats.files.errors import comma_list, printable, short_name, shorten_text
from jaxmocap.formats.recordings.marker_places import MarkerPlace

# Messages that are kept: of the first ones.
FIRST_KEPT = 500
# And of the newest ones.
NEWEST_KEPT = 500
# Changes of a subject's state that are printed without a limit of their rate.
STATE_CHANGES_AT_ONCE = 20
# Changes a second that are printed after these.
STATE_CHANGES_HZ = 0.1
# Newest outputs whose latencies the figures are of.
LATENCIES_KEPT = 20_000
# Newest outputs whose latencies the status line is of.
LATENCIES_SHOWN = 300
# Seconds between updates of the status line on a terminal.
TERMINAL_INTERVAL_S = 0.25
# The same where the output is no terminal.
LOG_INTERVAL_S = 5.0
# The state of a subject of which there is nothing to say, as at first.
NOTHING = "none"
# A stream that received nothing for so many seconds is silent; no pose is sent then.
SILENT_S = 0.3
# A camera without a frame for so many seconds is quiet.
QUIET_S = 2.0


class LiveStatus:
    """Counts the outputs of a run and prints its messages."""

    def __init__(self, out: TextIO | None = None):
        """Write to a stream; standard error by default."""
        self._out = sys.stderr if out is None else out
        self._is_terminal = self._out.isatty()
        self.outputs = self.message_count = 0
        self._first: list[dict[str, Any]] = []
        self._newest: deque[dict[str, Any]] = deque(maxlen=NEWEST_KEPT)
        self._latencies: deque[float] = deque(maxlen=LATENCIES_KEPT)
        self._times: deque[float] = deque(maxlen=LATENCIES_SHOWN)
        self._states: dict[str, str] = {}
        self._state_rates: dict[str, TokenBucket] = {}
        self._next_line_at = 0.0

    def count_output(self, now: float, latency: float) -> None:
        """Count a pose that was sent so many seconds after its sample arrived."""
        self.outputs += 1
        self._latencies.append(1e3 * latency)
        self._times.append(now)

    @property
    def newest_latency(self) -> float:
        """Of the newest output, seconds; NaN before the first."""
        return self._latencies[-1] / 1e3 if self._latencies else float("nan")

    @property
    def messages(self) -> list[dict[str, Any]]:
        """The first and the newest messages: "seconds" since the run began, "what" it is."""
        return [*self._first, *self._newest]

    def set_state(self, now: float, subject: str, state: str) -> None:
        """Log the state of a subject when it has changed; "" is not printed, nor a first "none".

        A state that changes more often than ``STATE_CHANGES_HZ`` is logged later, as it is then.
        Memory grows with the number of subjects.
        """
        if state == self._states.get(subject, NOTHING):
            return
        share = self._state_rates.setdefault(
            subject, TokenBucket(STATE_CHANGES_HZ, STATE_CHANGES_AT_ONCE, now)
        )
        if not share.available(now):
            return
        share.take(1)
        self._states[subject] = state
        if state:
            self.log(now, f"{subject}: {state}")

    def log(self, now: float, sentence: str) -> None:
        """Print a message with its time."""
        message = {"seconds": round(now, 3), "what": shorten_text(printable(sentence))}
        self.message_count += 1
        (self._first if len(self._first) < FIRST_KEPT else self._newest).append(message)
        self._print(f"{self._clear()}{now:8.2f} s  {message['what']}\n")

    def _print(self, text: str) -> None:
        # A terminal that is gone, or a log on a full disk, ends no run.
        with suppress(OSError, ValueError):
            print(text, end="", file=self._out, flush=True)

    def latency_ms(self, count: int | None = None) -> tuple[float, float]:
        """Median and 99th percentile of the newest outputs; NaN before the first."""
        newest = list(self._latencies)[-(count or LATENCIES_KEPT) :]
        if not newest:
            return float("nan"), float("nan")
        median, most = np.percentile(newest, [50, 99])
        return float(median), float(most)

    def update_line(
        self,
        now: float,
        ages: Mapping[str, float | None],
        dropped: Mapping[str, int],
        deviations: np.ndarray,
        is_ready: bool = True,
    ) -> None:
        """Print the status line, if it is due.

        Args:
            now: seconds.
            ages: stream -> seconds since it last received something, None before that.
            dropped: kind -> number of dropped ones.
            deviations: (2,) standard deviations of the elbows, metres; NaN where unknown.
            is_ready: whether all is compiled.
        """
        if now < self._next_line_at:
            return
        self._next_line_at = now + (TERMINAL_INTERVAL_S if self._is_terminal else LOG_INTERVAL_S)
        median, most = self.latency_ms(LATENCIES_SHOWN)
        latency = f"latency {median:.1f} ms, 99 % {most:.1f} ms" if np.isfinite(median) else ""
        shown = [
            "" if is_ready else f"compiling {now:.0f} s",
            f"{sum(now - time <= 1.0 for time in self._times):3.0f} /s",
            latency,
            "dropped " + ", ".join(f"{count} {what}" for what, count in dropped.items()),
            "age " + ", ".join(f"{short_name(name)} {_age(age)}" for name, age in ages.items()),
            "elbows " + ", ".join(dict.fromkeys(map(_plus_minus, deviations))),
        ]
        end = "" if self._is_terminal else "\n"
        self._print(f"{self._clear()}{' | '.join(filter(None, shown))}{end}")

    def ring(self) -> None:
        """Ring a terminal's bell, for who wears a headset."""
        if self._is_terminal:
            self._print("\a")

    def _clear(self) -> str:
        return "\r\x1b[K" if self._is_terminal else ""

    def end_line(self) -> None:
        """End the status line."""
        if self._is_terminal:
            self._print("\n")

    def figures(self, seconds: float) -> dict[str, Any]:
        """The run's figures."""
        median, most = self.latency_ms()
        return {
            "seconds": seconds,
            "outputs": self.outputs,
            "rate_hz": self.outputs / seconds if seconds > 0 else 0.0,
            "latency_ms": {"median": median, "p99": most, "of": len(self._latencies)},
            "warnings": self.messages,
            "message_count": self.message_count,
        }


def _plus_minus(deviation: float) -> str:
    if not np.isfinite(deviation):
        return "by markers alone"
    undetermined = " (not determined)" if deviation > UNDETERMINED_M else ""
    return f"± {100 * deviation:.0f} cm{undetermined}"


def _age(age: float | None) -> str:
    if age is None:
        return "-"
    return f"{1e3 * age:.0f} ms" if age < 1 else f"{age:.0f} s"


def stream_states(
    markers: MarkerSource,
    gathering: SampleAssembler,
    cameras: Sequence[LiveCamera],
    now: float,
    places: Sequence[MarkerPlace] = (),
) -> Iterator[tuple[str, str]]:
    """The state of every stream at a time, seconds."""
    yield "markers", _markers_state(markers)
    yield "missing", comma_list(gathering.missing(now)) or NOTHING
    frozen = comma_list(gathering.frozen_markers())
    frozen = frozen and f"{frozen}; repeats the last place, which is not used"
    yield "frozen", frozen or NOTHING
    yield from _orientation_states(gathering, places)
    if (rate := markers.senders.clock_rate) is not None:
        how = f"runs {rate:.2g} times as fast as this machine's"
        yield "the sender's clock", f"{how}; its stamps are not used"
    elif jumps := markers.senders.clock_jumps:
        yield "the sender's clock", f"was set, {tenfold(jumps)} times"
    for why, count in list(markers.ignored.items()):
        # Who sends markers sends bones, expressions and settings as well: that is worth a line only
        # while no marker comes.
        if count and not (why in ("foreign", "scaled") and markers.last_arrival is not None):
            yield f"{why} packets ignored", f"{tenfold(count)}{markers.hints.get(why, '')}"
    if refused := markers.senders.refused_hosts:
        hosts = comma_list(sorted(refused.copy()))
        yield "strangers", f"{hosts}; {markers.who_may_send}"
    if gathering.unknown_names:
        yield "no markers of ours", comma_list(sorted(gathering.unknown_names.copy()))
    for camera in cameras:
        reason = f" ({camera.reason})" if camera.reason else ""
        is_quiet = camera.last_arrival is not None and now - camera.last_arrival > QUIET_S
        status = "nothing comes in" if is_quiet and camera.status == "on" else camera.status
        yield short_name(camera.name), camera.problem or f"{status}{reason}"


def _orientation_states(
    gathering: SampleAssembler, places: Sequence[MarkerPlace]
) -> Iterator[tuple[str, str]]:
    """Orientations that come and are not used, and those that are and do not come."""
    placed, oriented = gathering.placed_markers(), gathering.oriented_markers()
    unused = [
        place.name
        for place in places
        if not (place.needs_orientation or place.states_no_turn) and place.name in oriented
    ]
    if unused:
        how = "'jaxmocap live LIVE.toml --calibrate' measures how they are held"
        yield "orientations not used", f"{comma_list(unused)}; {how}"
    absent = [p.name for p in places if p.needs_orientation and p.name in placed - oriented]
    if any(place.needs_orientation for place in places):
        yield "orientations missing", comma_list(absent) or NOTHING


def _markers_state(markers: MarkerSource) -> str:
    if markers.problem is not None:
        return markers.problem
    if markers.last_arrival is None:
        return "waiting for the first"
    is_silent = markers.last_look - markers.last_arrival > SILENT_S
    return "nothing comes in" if is_silent else "coming in"


def tenfold(count: int) -> str:
    """A count by its power of ten."""
    return f"{10 ** (len(str(count)) - 1)} or more"
