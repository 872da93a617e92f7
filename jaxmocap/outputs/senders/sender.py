"""What sends poses in a live run, and the table of the live file that asks for it.

INPUTS: a table; poses in Unity's frame. OUTPUTS: datagrams.

A protocol is a file beside this one with both, and its name in ``pipelines/live/setup.py``.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from jaxmocap.formats.files.addresses import Address, read_address
from jaxmocap.formats.files.toml import TomlTable
from jaxmocap.outputs.senders.unity import Joints, UnityBody

# Where nothing states how sure the elbows are.
UNSTATED = np.full(2, np.nan)


class Sender(ABC):
    """Makes datagrams of one person's poses."""

    @abstractmethod
    def frame(
        self, time: float, local: Joints, deviations: np.ndarray = UNSTATED
    ) -> Sequence[bytes]:
        """Those of a pose.

        Args:
            time: seconds since the run began.
            local: its joints in their parents.
            deviations: (2,) standard deviations of left and right elbow, metres; NaN unstated.
        """

    def lost(self, time: float) -> Sequence[bytes]:
        """Those for a moment at which nobody is tracked."""
        return ()


@dataclass(frozen=True)
class SenderTable:
    """A table of the live file that asks for a sender.

    Attributes:
        send: where poses go.
        kind: of the sender.
        title: of the protocol.
        keys: of the table.
        is_default: whether poses go there where the file has no such table.
    """

    send: Address
    kind: ClassVar[Callable[..., Sender]]
    title: ClassVar[str]
    keys: ClassVar[tuple[str, ...]] = ("send",)
    is_default: ClassVar[bool] = False

    @classmethod
    def read(cls, fields: TomlTable) -> "SenderTable":
        """Read a table, empty where the file has none; InputError where a field does not fit."""
        return cls(read_address(fields, "send", cls.send))

    def sender(self, body: UnityBody) -> Sender:
        """What makes datagrams of this person's poses."""
        return self.kind(self, body)
