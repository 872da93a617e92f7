"""The end of the process, whatever its threads are doing.

INPUTS: an exit code. OUTPUTS: the process ends with it, soon.

Where the interpreter ends while a daemon thread is in foreign code (a driver that does not answer,
a viewer's library), it unwinds that thread through C++, which aborts the process. And where a
command is interrupted, the interpreter would wait for what still compiles.
"""

import os
import sys
import threading
from contextlib import suppress
from typing import NoReturn

# Exit codes above this are of processes that a signal stopped: this and the signal's number.
SIGNAL_EXIT_CODE = 128
# A process that a signal stopped waits so long for its other threads, seconds.
LONGEST_WAIT_S = 5.0


def end_process(code: int) -> NoReturn:
    """End the process; called last, when everything that matters is closed."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):
            stream.flush()
    others = set(threading.enumerate()) - {threading.current_thread()}
    if any(thread.daemon for thread in others):
        os._exit(code)
    if others and code > SIGNAL_EXIT_CODE:
        timer = threading.Timer(LONGEST_WAIT_S, os._exit, (code,))
        timer.daemon = True
        timer.start()
    sys.exit(code)
