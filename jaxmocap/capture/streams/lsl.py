"""Markers of a Lab Streaming Layer stream, in a thread of its own.

INPUTS: the name of a stream whose channels are labelled ``Name.x``, ``Name.y``, ``Name.z``, in
metres unless a channel's unit says millimetres, and after them, where a marker has an
orientation, ``Name.qx``, ``Name.qy``, ``Name.qz``, ``Name.qw``, a quaternion from its axes to the
stream's. OUTPUTS: samples.

pylsl is loaded when a stream is asked for; it is the extra ``lsl``.
"""

import math
from collections.abc import Callable, Collection
from dataclasses import dataclass
from time import monotonic
from typing import Any

from jaxmocap.capture.streams.osc import MAX_DISTANCE_M, MarkerMessage, unit_quaternion
from jaxmocap.capture.streams.sample_assembly import SampleAssembler
from jaxmocap.capture.streams.senders import PacketSenders
from jaxmocap.capture.streams.source import MarkerSource, SourceTable
from jaxmocap.formats.files.errors import InputError, comma_list, short_repr
from jaxmocap.formats.files.toml import TomlTable

# A stream that is not there is asked for again and again, for so many seconds at a time.
RESOLVE_TIMEOUT_S = 1.0
# A sample is waited for so many seconds at a time.
PULL_TIMEOUT_S = 0.2
# No stream of markers has more channels,
MAX_CHANNELS = 4096
# or longer labels and units.
MAX_LABEL_CHARACTERS = 200
MAX_STREAM_CHARACTERS = 200
METRES_PER_UNIT = dict.fromkeys(("", "m", "meter", "meters", "metre", "metres"), 1.0)
METRES_PER_UNIT |= dict.fromkeys(
    ("mm", "millimeter", "millimeters", "millimetre", "millimetres"), 1e-3
)


class MarkerStream(MarkerSource):
    """Listens to a stream; LSL itself decides who may send."""

    def __init__(
        self, table: "LslTable", assembler: SampleAssembler, now: Callable[[], float] = monotonic
    ):
        """Prepare, the clock in seconds; InputError where pylsl is not installed."""
        try:
            import pylsl
        except (ImportError, RuntimeError):
            raise InputError("[lsl]", "pylsl is missing: pip install 'jaxmocap[lsl]'") from None
        address = f"the LSL stream {short_repr(table.stream)}"
        super().__init__(address, RESOLVE_TIMEOUT_S + 1.0, PacketSenders())
        self._lsl: Any = pylsl
        self._numeric = {pylsl.cf_float32, pylsl.cf_double64, pylsl.cf_int64}
        self._numeric |= {pylsl.cf_int32, pylsl.cf_int16, pylsl.cf_int8}
        self._name, self._assembler, self._now = table.stream, assembler, now

    def _listen(self) -> None:
        while not self._stop.is_set() and self.problem is None:
            try:
                looked = self._now()
                streams = self._lsl.resolve_byprop("name", self._name, timeout=RESOLVE_TIMEOUT_S)
                if streams:
                    inlet = self._lsl.StreamInlet(streams[0], max_buflen=1, recover=False)
                    try:
                        self._take(inlet)
                    finally:
                        inlet.close_stream()
                else:
                    self.last_look = looked
            except (RuntimeError, ValueError):
                # Who sent has gone, maybe somebody comes back; or it describes itself in bytes
                # that are not UTF-8.
                self._stop.wait(PULL_TIMEOUT_S)

    def _take(self, inlet: Any) -> None:
        """All samples of a stream, until it is lost."""
        channels = self._channels(inlet.info(timeout=RESOLVE_TIMEOUT_S))
        while not self._stop.is_set() and self.problem is None:
            looked = self._now()
            values, stamp = inlet.pull_sample(timeout=PULL_TIMEOUT_S)
            if values is None:
                self.last_look = looked
                continue
            arrived = self._now()
            self.packets += 1
            sender = self.senders.sender_at(self._name, arrived)
            messages, is_absurd = [], False
            for name, (first, scales, has_orientation) in channels.items():
                x, y, z = (values[first + axis] * scale for axis, scale in enumerate(scales))
                if max(abs(x), abs(y), abs(z)) > MAX_DISTANCE_M:
                    is_absurd = True
                elif math.isfinite(x + y + z):
                    quaternion = (
                        unit_quaternion(values[first + 3 : first + 7]) if has_orientation else None
                    )
                    messages.append(MarkerMessage((name,), (x, y, z), quaternion))
            self.ignored["absurd"] += is_absurd
            if messages:
                is_prompt = not inlet.samples_available()
                time = sender.time(arrived, stamp, is_prompt)
                if self._assembler.add(messages, time, arrived, True):
                    self.last_arrival = arrived
                    self.packets_used += 1
            self.last_look = arrived

    def _channels(self, info: Any) -> dict[str, tuple[int, tuple[float, ...], bool]]:
        """Marker -> index of its x, metres per unit of x, y, z, whether its quaternion follows."""
        if info.channel_format() not in self._numeric:
            self.problem = "expected channels of numbers, found text"
            return {}
        labels, units = [], []
        channel = info.desc().child("channels").child("channel")
        for _ in range(min(info.channel_count(), MAX_CHANNELS)):
            labels.append(channel.child_value("label")[:MAX_LABEL_CHARACTERS])
            units.append(channel.child_value("unit")[:MAX_LABEL_CHARACTERS].lower())
            channel = channel.next_sibling("channel")
        channels_of = {}
        for i, label in enumerate(labels):
            name = label.removesuffix(".x")
            if labels[i : i + 3] == [f"{name}.{axis}" for axis in "xyz"]:
                scales = tuple(METRES_PER_UNIT.get(unit, math.nan) for unit in units[i : i + 3])
                if any(map(math.isnan, scales)):
                    # Something else may have any unit.
                    if self._assembler.has_marker(name):
                        found = " ".join(map(short_repr, units[i : i + 3]))
                        self.problem = f"{name}: found the units {found}, expected m or mm"
                    continue
                has_orientation = labels[i + 3 : i + 7] == [f"{name}.q{part}" for part in "xyzw"]
                channels_of[name] = i, scales, has_orientation
        if not channels_of and self.problem is None:
            found_labels = comma_list(labels[:6]) or "none"
            expected = "expected channels Name.x, Name.y, Name.z in m or mm"
            self.problem = f"{expected}, found {found_labels}"
        return channels_of


@dataclass(frozen=True)
class LslTable(SourceTable):
    """``[lsl]``: the name of a stream."""

    stream: str
    kind, keys = MarkerStream, ("stream",)

    @classmethod
    def read(cls, fields: TomlTable, markers: Collection[str]) -> "LslTable":
        """Read it; a query has the name in quotes."""
        name = fields.text("stream")
        if not name.isprintable() or "'" in name or len(name) > MAX_STREAM_CHARACTERS:
            expected = f"at most {MAX_STREAM_CHARACTERS} printable characters and no '"
            raise fields.error("stream", f"found {short_repr(name)}, expected {expected}")
        return cls(name)
