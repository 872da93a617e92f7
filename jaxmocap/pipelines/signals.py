"""SIGTERM and SIGHUP as an exception: what is open is closed, nothing half-written is left.

INPUTS: the signals. OUTPUTS: Terminated, raised in the main thread.
"""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from types import FrameType
from typing import Any

# A signal that comes within an import comes again after so many seconds.
AGAIN_AFTER_S = 0.05
IMPORTING = "<frozen importlib._bootstrap>"


class Terminated(BaseException):
    """SIGTERM came, or the terminal was closed.

    Like KeyboardInterrupt it is no error, and nothing goes on after it.
    """


@contextmanager
def raise_on_sigterm() -> Iterator[None]:
    """Within it SIGTERM, or a closed terminal, raises ``Terminated``; no signal ends an import.

    A second one does not disturb what closes. What is ignored stays so, as ``nohup`` wants it.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def end(number: int, frame: Any) -> None:
        for each in before:
            signal.signal(each, signal.SIG_IGN)
        raise Terminated

    def handle(number: int, frame: FrameType | None) -> None:
        # Where a library imports, an exception would become another, end nothing, or crash it.
        above = frame
        while above is not None and above.f_code.co_filename != IMPORTING:
            above = above.f_back
        if above is None:
            handlers[number](number, frame)
        again[number] = threading.Timer(AGAIN_AFTER_S, raise_again, (number,))
        again[number].daemon = True
        again[number].start()

    again: dict[int, threading.Timer] = {}
    raise_again: Callable[[int], Any] = signal.raise_signal
    if hasattr(signal, "pthread_kill"):
        raise_again = partial(signal.pthread_kill, threading.get_ident())
    handlers: dict[int, Callable[[int, Any], Any]] = {
        signal.SIGINT: signal.default_int_handler,
        signal.SIGTERM: end,
        getattr(signal, "SIGHUP", signal.SIGTERM): end,
    }
    taken = [each for each in handlers if signal.getsignal(each) is not signal.SIG_IGN]
    before = {each: signal.signal(each, handle) for each in taken}
    try:
        yield
    finally:
        for each, handler in before.items():
            signal.signal(each, signal.SIG_DFL if handler is None else handler)
        for number, timer in again.items():
            if timer.is_alive():
                timer.cancel()
                raise KeyboardInterrupt if number == signal.SIGINT else Terminated


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
