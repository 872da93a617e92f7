"""A source of markers in a live run, and the table of the live file that asks for it.

INPUTS: a table. OUTPUTS: a thread that gives markers to a SampleAssembler.

A protocol is a file beside this one with both, and its name in ``pipelines/live/setup.py``.
"""

import math
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Collection, Mapping
from threading import Event, Thread
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np

from jaxmocap.capture.streams.osc import MAX_DISTANCE_M
from jaxmocap.capture.streams.sample_assembly import SampleAssembler
from jaxmocap.capture.streams.senders import PacketSenders
from jaxmocap.formats.files.toml import TomlTable


class Listener(ABC):
    """Takes in what comes, in a thread that ends with the process, until it is asked to stop."""

    def __init__(self, name: str, timeout_s: float):
        """Prepare a thread of that name, which takes so many seconds to end, at most."""
        self._stop, self._timeout_s = Event(), timeout_s
        self._thread = Thread(target=self._listen, name=name, daemon=True)

    def start(self) -> None:
        """Listen from now on."""
        self._thread.start()

    def ask_to_stop(self) -> None:
        """Listen no more, soon."""
        self._stop.set()

    def stop(self) -> None:
        """Listen no more; returns within the timeout, though a driver may never let go."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(self._timeout_s)

    @abstractmethod
    def _listen(self) -> None:
        """Take in what comes until ``_stop`` is set."""


class MarkerSource(Listener):
    """Listens for markers.

    Attributes:
        address: what is listened to.
        ignored: why -> how many packets, the whole of them or parts.
        hints: why -> what to do about it.
        packets: that came in.
        packets_used: those with a marker of ours.
        last_arrival: when a marker came in last, ``monotonic`` seconds; None before.
        last_look: when what had come in until then had last been read; a thread that has to wait
            for others says nothing about what comes in.
        problem: why nothing can come in, or None.
        senders: who sends, and their clocks.
        who_may_send: where the live file states that.
    """

    hints: ClassVar[dict[str, str]] = {
        "absurd": f"; expected positions in metres, within {MAX_DISTANCE_M:g} m of the origin"
    }
    who_may_send: ClassVar[str] = ""

    def __init__(self, address: Any, timeout_s: float, senders: PacketSenders):
        """Prepare a thread, which takes so many seconds to end, at most."""
        super().__init__("markers", timeout_s)
        self.address, self.senders = address, senders
        self.ignored, self.packets, self.packets_used = Counter[str](), 0, 0
        self.last_arrival: float | None = None
        self.last_look = -math.inf
        self.problem: str | None = None


class SourceTable(ABC):
    """A table of the live file that asks for a source."""

    kind: ClassVar[Callable[..., MarkerSource]]  # of the source
    keys: ClassVar[tuple[str, ...]]  # of the table
    aliases: Mapping[str, str] = MappingProxyType({})  # name that a sender uses -> marker
    # Names of markers whose axes are a head's: x ahead, y left, z up.
    headsets: Collection[str] = ()
    # (3, 3) to the world's axes, where [markers] states none.
    R_world_source: ClassVar[np.ndarray] = np.eye(3)

    @classmethod
    @abstractmethod
    def read(cls, fields: TomlTable, markers: Collection[str]) -> "SourceTable":
        """Read a table, for markers of these names; InputError where a field does not fit."""

    def open(self, assembler: SampleAssembler, now: Callable[[], float]) -> MarkerSource:
        """The source, not yet listening; InputError where it cannot be had."""
        return self.kind(self, assembler, now)
