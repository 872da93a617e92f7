"""A source that takes in what comes, in a thread of its own, until it is asked to stop.

INPUTS: what ``_listen`` of a kind of source does. OUTPUTS: its thread, begun and ended.
"""

from abc import ABC, abstractmethod
from threading import Event, Thread


class Listener(ABC):
    """Listens in a thread that ends with the process."""

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
