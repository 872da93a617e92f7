"""The command line. Begin with ``program``; ``tracking.track`` is one command from end to end.

Everything is imported within ``enter``: Ctrl-C ends it with one line from the first moment on.
"""

import io
import os
import sys

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any, NoReturn

INTERRUPTED = 130  # 128 and the number of SIGINT
# A process waits so long for its other threads, seconds.
LONGEST_WAIT_S = 5.0


def enter() -> "NoReturn":
    """The program: run the command that its arguments name, and end the process."""
    # XLA's log is for developers: "Very slow compile?" asks users to file a bug.
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    try:
        import signal

        # Python makes other errors of an exception within some imports.
        is_ignored = signal.getsignal(signal.SIGINT) is signal.SIG_IGN
        if not is_ignored:
            signal.signal(signal.SIGINT, _end_interrupted)
        from jaxmocap.cli.program import main

        for stream in (sys.stdout, sys.stderr):
            # A pipe of a system whose encoding lacks a character shows its number.
            if isinstance(stream, io.TextIOWrapper):
                stream.reconfigure(errors="backslashreplace")
        if not is_ignored:
            signal.signal(signal.SIGINT, signal.default_int_handler)
        code = main()
    except KeyboardInterrupt:
        _end_interrupted()
    end_process(code)


def _end_interrupted(*_: "Any") -> "NoReturn":
    os.write(2, b"jaxmocap: interrupted\n")
    os._exit(INTERRUPTED)


def end_process(code: int) -> "NoReturn":
    """End the process soon, whatever its threads do; called last, when all that matters is closed.

    Where the interpreter ends while a daemon thread is in foreign code (a driver that does not
    answer, a viewer's library), it unwinds that thread through C++, which aborts the process. And
    it would wait for what still compiles.
    """
    import threading
    from contextlib import suppress

    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):
            stream.flush()
    others = set(threading.enumerate()) - {threading.current_thread()}
    if any(thread.daemon for thread in others):
        os._exit(code)
    if others:
        timer = threading.Timer(LONGEST_WAIT_S, os._exit, (code,))
        timer.daemon = True
        timer.start()
    sys.exit(code)
