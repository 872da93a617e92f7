"""A process that runs one command after another, as the program would, and says what each took.

INPUTS: a line of JSON for each: arguments, the folder to be in, files for its two streams.
OUTPUTS: a line of JSON for each: exit code, seconds, memory; both streams in the files.

JAX does not survive a fork, and importing it takes seconds: so it is one process for many commands,
which whoever started it ends when a command takes too long, and replaces now and then.
"""

import json
import os
import sys
import threading
import traceback
import warnings
from concurrent.futures.thread import _threads_queues
from pathlib import Path
from time import perf_counter

# A command's threads must end with it, seconds: the program would wait for them.
THREADS_END_S = 10.0
_STATUS = Path("/proc/self/status")


def main() -> None:
    """Answer until nothing more comes in."""
    asked, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.dup2(2, 1)
    # A terminal's encoding has no way to print what is no text.
    sys.stdout.reconfigure(errors="strict", line_buffering=True)
    for line in asked:
        question = json.loads(line)
        answer = _built(question) if "build" in question else _ran(question)
        answers.write(json.dumps(answer).encode() + b"\n")
        answers.flush()


def _built(question: dict) -> dict:
    """Write the inputs that all cases start from."""
    from hostile_bases import write_bases

    write_bases(Path(question["build"]))
    return {"memory": _memory("VmRSS")}


def _ran(question: dict) -> dict:
    """Run a command."""
    os.chdir(question["folder"])
    _forget_peak()
    before, began = _memory("VmRSS"), perf_counter()
    with _Streams(question["out"], question["err"]):
        code = _exit_code(question["arguments"])
        left = _threads_left()
    # What earlier commands hold is not this one's.
    peak = None if before is None else _memory("VmHWM") - before
    seconds = perf_counter() - began
    return {"code": code, "seconds": seconds, "grown": peak, "left": left, "held": before}


def _exit_code(arguments: list[str]) -> int:
    from jaxmocap.cli.program import main as command

    with warnings.catch_warnings():
        warnings.simplefilter("always")
        for quiet in (DeprecationWarning, PendingDeprecationWarning, ImportWarning):
            warnings.simplefilter("ignore", quiet)
        warnings.simplefilter("ignore", ResourceWarning)
        try:
            return command(arguments)
        except SystemExit as end:
            return end.code if isinstance(end.code, int) else int(end.code is not None)
        except BaseException:
            traceback.print_exc()
            return 1


def _threads_left() -> list[str]:
    """Threads that the program's end would wait for, and that do not end."""
    until, left = perf_counter() + THREADS_END_S, []
    for thread in threading.enumerate():
        if thread is not threading.main_thread() and not thread.daemon:
            # Those of pools wait for work and are told to end at the program's end.
            if thread in _threads_queues:
                continue
            thread.join(max(0.0, until - perf_counter()))
            left += [thread.name] if thread.is_alive() else []
    return left


class _Streams:
    """Both streams, C libraries' too, into files."""

    def __init__(self, out: str, err: str):
        self._paths = {1: out, 2: err}

    def __enter__(self) -> None:
        self._kept = {number: os.dup(number) for number in self._paths}
        for number, path in self._paths.items():
            file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
            os.dup2(file, number)
            os.close(file)

    def __exit__(self, *_) -> None:
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
        for number, kept in self._kept.items():
            os.dup2(kept, number)
            os.close(kept)


def _forget_peak() -> None:
    """Linux: begin to measure the most memory from now on."""
    if _STATUS.exists():
        Path("/proc/self/clear_refs").write_text("5")


def _memory(name: str) -> int | None:
    """Bytes of this process by a name of Linux's; None elsewhere."""
    if not _STATUS.exists():
        return None
    line = next(line for line in _STATUS.read_text().splitlines() if line.startswith(name))
    return int(line.split()[1]) * 1024


if __name__ == "__main__":
    main()
