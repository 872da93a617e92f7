"""How far a long run has come.

INPUTS: numbers of steps. OUTPUTS: progress bars.
"""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Event, Thread

from tqdm import tqdm

# Seconds between two looks of a bar that waits for its first step.
TICK_S = 0.5
# Called with the steps done and their total.
Progress = Callable[[int, int], None]


@contextmanager
def progress_bar(
    label: str, progress: Progress | bool | None, before: str = ""
) -> Iterator[Progress]:
    """What to call with the steps done: the caller's own, a bar on stderr, or nothing.

    Args:
        label: of the bar.
        progress: the caller's own; True shows a bar, False none, None one where stderr is a
            terminal.
        before: what is done before the first step; the bar shows it, and the seconds that pass.
    """
    if progress is None:
        progress = sys.stderr is not None and sys.stderr.isatty()
    if progress is not True:
        yield progress or (lambda done, total: None)
        return
    waiting = f"{label}: {before} first" if before else label
    begun = Event()
    with tqdm(desc=waiting, leave=True) as bar:

        def show(done: int, total: int) -> None:
            if not begun.is_set():
                begun.set()
                bar.set_description(label, refresh=False)
            bar.total = total
            bar.update(done - bar.n)

        def tick() -> None:
            # Until the first step a bar in a terminal shows the time.
            while not begun.wait(TICK_S):
                bar.refresh()

        beside = Thread(target=tick, name="progress", daemon=True)
        if bar.fp.isatty():
            beside.start()
        try:
            yield show
        finally:
            begun.set()
            if beside.is_alive():
                beside.join()
