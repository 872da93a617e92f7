"""The command line. Begin with ``program``; ``tracking.track`` is one command from end to end.

Commands are imported within ``enter``: Ctrl-C ends them with one line from the first moment on.
"""

import os
import sys
from typing import NoReturn

INTERRUPTED = 130  # 128 and the number of SIGINT


def enter() -> NoReturn:
    """The program: run the command that its arguments name, and end the process."""
    try:
        from jaxmocap.cli.process_exit import end_process
        from jaxmocap.cli.program import main

        code = main()
    except KeyboardInterrupt:
        print("jaxmocap: interrupted", file=sys.stderr, flush=True)
        os._exit(INTERRUPTED)
    end_process(code)
