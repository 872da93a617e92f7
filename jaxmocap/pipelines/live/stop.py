"""The signals that end a live run: Ctrl-C, SIGTERM, or a terminal that is closed.

INPUTS: signals. OUTPUTS: an event that they set.
"""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


class Stop(threading.Event):
    """The event that ends a run.

    Attributes:
        terminated: whether by SIGTERM or a closed terminal, not by Ctrl-C.
    """

    terminated = False


@contextmanager
def stopped_by_signals() -> Iterator[Stop]:
    """An event that the signals set; a second Ctrl-C interrupts as ever.

    Signals that are ignored stay so, as ``nohup`` wants it. Outside the main thread, which alone
    has signals, it is an event like any other.
    """
    stop = Stop()

    def set_stop(number: int, frame: Any) -> None:
        stop.terminated |= number != signal.SIGINT
        stop.set()
        if number == signal.SIGINT:
            signal.signal(signal.SIGINT, signal.default_int_handler)

    signals = {signal.SIGINT, signal.SIGTERM, getattr(signal, "SIGHUP", signal.SIGTERM)}
    if threading.current_thread() is not threading.main_thread():
        signals = set()
    taken = [each for each in signals if signal.getsignal(each) is not signal.SIG_IGN]
    before = {each: signal.signal(each, set_stop) for each in taken}
    try:
        yield stop
    finally:
        for each, handler in before.items():
            signal.signal(each, signal.SIG_DFL if handler is None else handler)
