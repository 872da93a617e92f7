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
# A closed terminal, where the system tells of it.
HANGUP = getattr(signal, "SIGHUP", signal.SIGTERM)


class Terminated(BaseException):
    """SIGTERM came, or the terminal was closed.

    Like KeyboardInterrupt it is no error, and nothing goes on after it.
    """


@contextmanager
def raise_on_sigterm() -> Iterator[None]:
    """Within it SIGTERM, or a closed terminal, raises ``Terminated``; no signal ends an import.

    A second one does not disturb what closes. What is ignored stays so, as ``nohup`` wants it.
    """

    def end(number: int, frame: Any) -> None:
        for each in handlers:
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
        HANGUP: end,
    }
    try:
        with _handled(handle):
            yield
    finally:
        for number, timer in again.items():
            if timer.is_alive():
                timer.cancel()
                raise KeyboardInterrupt if number == signal.SIGINT else Terminated


@contextmanager
def signals_deferred() -> Iterator[None]:
    """Within it Ctrl-C, SIGTERM and a closed terminal are deferred until its end."""
    received: list[int] = []
    try:
        with _handled(lambda number, frame: received.append(number)):
            yield
    finally:
        for number in received[:1]:
            signal.raise_signal(number)


@contextmanager
def _handled(handle: Callable[[int, Any], Any]) -> Iterator[None]:
    """Within it signals that end a program are handled, those that are not ignored.

    None are outside the main thread, which alone has signals.
    """
    is_main = threading.current_thread() is threading.main_thread()
    ending = {signal.SIGINT, signal.SIGTERM, HANGUP} if is_main else ()
    taken = [each for each in ending if signal.getsignal(each) is not signal.SIG_IGN]
    before = {each: signal.signal(each, handle) for each in taken}
    try:
        yield
    finally:
        for each, handler in before.items():
            signal.signal(each, signal.SIG_DFL if handler is None else handler)
