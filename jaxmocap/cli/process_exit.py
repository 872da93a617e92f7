"""The end of the process, whatever its threads are at.

INPUTS: an exit code. OUTPUTS: the process ends with it, soon.

Where the interpreter ends while a daemon thread is in foreign code (a driver that does not answer,
a viewer's library), that thread is torn out of C++, which aborts the process. And where a command
is interrupted, the interpreter would wait for what still compiles.
"""

import os
import sys
import threading
import time
from contextlib import suppress
from typing import NoReturn

# Exit codes of what was stopped from outside: 128 and the signal's number.
STOPPED = 128
# Who was stopped waits so long for other threads, seconds.
PATIENCE_S = 5.0


def leave(code: int) -> NoReturn:
    """End the process; called last, when everything that matters is closed."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):
            stream.flush()
    others = set(threading.enumerate()) - {threading.current_thread()}
    if any(thread.daemon for thread in others):
        os._exit(code)
    if others and code > STOPPED:
        threading.Thread(target=_end_later, args=(code,), daemon=True).start()
    sys.exit(code)


def _end_later(code: int) -> None:
    time.sleep(PATIENCE_S)
    os._exit(code)
