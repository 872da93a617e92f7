"""Processes that run commands, watched: each command has a limit of time and memory.

INPUTS: command lines. OUTPUTS: exit codes, what was printed, seconds, memory.
"""

import json
import os
import queue
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

HERE = Path(__file__).parent
LIMIT_S = 60.0
MOST_BYTES = 2 * 2**30
# Before it harms the machine.
KILLED_AT_BYTES = 3 * 2**30
# A process that has kept so much of what it did is replaced.
KEPT_BYTES = 2**30
BUILD_LIMIT_S = 300.0


@dataclass
class Answer:
    """What came of a command."""

    code: int | None  # exit code; None where it was ended, or died
    seconds: float  # that it took
    memory: int | None  # the most that a process of its own would take, bytes; None: not measured
    out: str  # what it printed
    err: str  # what it printed to stderr
    left: tuple[str, ...] = ()  # names of threads that do not end
    ended: str | None = None  # why it was ended, or how it died


class Worker:
    """One process."""

    def __init__(self, sandbox: Path):
        sandbox.mkdir(parents=True, exist_ok=True)
        self.process = subprocess.Popen(
            [sys.executable, str(HERE / "hostile_worker.py")],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            stderr=(sandbox / "worker.log").open("ab"),
            env=environment(sandbox), cwd=sandbox, start_new_session=True,
        )  # fmt: skip
        self._answers: queue.Queue[bytes] = queue.Queue()
        threading.Thread(target=self._listen, daemon=True).start()
        self.fresh: int | None = None

    def _listen(self) -> None:
        for line in self.process.stdout:
            self._answers.put(line)
        self._answers.put(b"")

    def ask(self, question: dict[str, Any], limit_s: float = LIMIT_S) -> dict[str, Any] | str:
        """Its answer; or why there is none, and then the process is no more."""
        began = perf_counter()
        try:
            self.process.stdin.write(json.dumps(question).encode() + b"\n")
            self.process.stdin.flush()
        except OSError:
            return self.end("died before")
        while True:
            try:
                line = self._answers.get(timeout=0.05)
            except queue.Empty:
                if perf_counter() - began > limit_s:
                    return self.end(f"no end within {limit_s:g} s")
                if (held := self._held()) > KILLED_AT_BYTES:
                    return self.end(f"took {held / 2**30:.1f} GB")
                continue
            if line:
                return json.loads(line)
            return self.end(f"died with {self.process.wait()}")

    def _held(self) -> int:
        """Bytes of memory that the process holds now; 0 where the system does not say."""
        try:
            pages = Path(f"/proc/{self.process.pid}/statm").read_text().split()[1]
        except OSError:
            return 0
        return int(pages) * os.sysconf("SC_PAGE_SIZE")

    def end(self, why: str = "") -> str:
        """End the process and all that it started."""
        try:
            os.killpg(self.process.pid, signal.SIGKILL)
        except (OSError, AttributeError):
            self.process.kill()
        self.process.wait()
        return why


def environment(sandbox: Path) -> dict[str, str]:
    """No display, a home of its own, and what conftest says of compiling."""
    kept = {key: value for key, value in os.environ.items() if "DISPLAY" not in key}
    kept["PYTHONPATH"] = os.pathsep.join(filter(None, [kept.get("PYTHONPATH"), *sys.path]))
    kept.setdefault("JAX_COMPILATION_CACHE_DIR", str(sandbox / "compiled"))
    kept.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
    return kept | {"HOME": str(sandbox), "XDG_CACHE_HOME": str(sandbox)}


class Pool:
    """Several processes; the first writes the inputs that all cases start from."""

    def __init__(self, folder: Path, count: int = 2):
        self.bases, self._folder, self._count = folder / "bases", folder, count
        self._free: queue.Queue[Worker] = queue.Queue()
        self._executor = ThreadPoolExecutor(count)

    def __enter__(self) -> "Pool":
        self.bases.mkdir(parents=True)
        first = self._new()
        answer = first.ask({"build": str(self.bases)}, BUILD_LIMIT_S)
        if isinstance(answer, str):
            raise RuntimeError(f"{answer}: {(self._folder / 'home' / 'worker.log').read_text()}")
        for worker in [first, *(self._new() for _ in range(self._count - 1))]:
            self._free.put(worker)
        return self

    def __exit__(self, *_) -> None:
        self._executor.shutdown(cancel_futures=True)
        while not self._free.empty():
            self._free.get().end()

    def _new(self) -> Worker:
        return Worker(self._folder / "home")

    def each(self, act: Callable[[int], Any], numbers: Iterable[int]) -> list:
        """Do something for each number, side by side; in their order."""
        return list(self._executor.map(act, numbers))

    def run(self, arguments: list[str], inside: Path, folder: Path) -> Answer:
        """Run a command in a folder; its streams go to another."""
        paths = {name: folder.with_name(f"{folder.name}.{name}") for name in ("out", "err")}
        question = {"arguments": arguments, "folder": str(inside)}
        worker, began = self._free.get(), perf_counter()
        reply = worker.ask(question | {name: str(path) for name, path in paths.items()})
        texts = {name: _text(path) for name, path in paths.items()}
        for path in paths.values():
            path.unlink(missing_ok=True)
        if isinstance(reply, str):
            self._free.put(self._new())
            return Answer(None, perf_counter() - began, None, **texts, ended=reply)
        if worker.fresh is None:
            worker.fresh = reply["held"]
        memory = None if reply["grown"] is None else worker.fresh + reply["grown"]
        if reply["left"] or (reply["held"] or 0) > (worker.fresh or 0) + KEPT_BYTES:
            worker.end()
            worker = self._new()
        self._free.put(worker)
        left = tuple(reply["left"])
        return Answer(reply["code"], reply["seconds"], memory, **texts, left=left)


def _text(path: Path) -> str:
    return path.read_bytes().decode("utf-8", "replace") if path.exists() else ""
