"""SIGTERM and SIGHUP as an exception: what is open is closed, nothing half-written is left.

INPUTS: the signals. OUTPUTS: Terminated, raised in the main thread.
"""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


class Terminated(BaseException):
    """SIGTERM came, or the terminal was closed.

    Like KeyboardInterrupt it is no error, and nothing goes on after it.
    """


@contextmanager
def raised_on_sigterm() -> Iterator[None]:
    """Within it SIGTERM, or a closed terminal, raises ``Terminated``.

    A second one does not disturb what closes. What is ignored stays so, as ``nohup`` wants it.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def end(number: int, frame: Any) -> None:
        for each in before:
            signal.signal(each, signal.SIG_IGN)
        raise Terminated

    ending = {signal.SIGTERM, getattr(signal, "SIGHUP", signal.SIGTERM)}
    taken = [each for each in ending if signal.getsignal(each) is not signal.SIG_IGN]
    before = {each: signal.signal(each, end) for each in taken}
    try:
        yield
    finally:
        for each, handler in before.items():
            signal.signal(each, signal.SIG_DFL if handler is None else handler)


@contextmanager
def signals_deferred() -> Iterator[None]:
    """Within it Ctrl-C, SIGTERM and a closed terminal are deferred until its end."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    received: list[int] = []
    ending = {signal.SIGINT, signal.SIGTERM, getattr(signal, "SIGHUP", signal.SIGTERM)}
    deferred = [each for each in ending if callable(signal.getsignal(each))]
    before = {
        each: signal.signal(each, lambda number, frame: received.append(number))
        for each in deferred
    }
    try:
        yield
    finally:
        for each, handler in before.items():
            signal.signal(each, handler)
        for number in received[:1]:
            signal.raise_signal(number)
