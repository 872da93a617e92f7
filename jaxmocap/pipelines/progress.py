"""How far a long run has come.

INPUTS: numbers of steps. OUTPUTS: progress bars.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from tqdm import tqdm

# Called with the steps done and their total.
Progress = Callable[[int, int], None]


@contextmanager
def progress_bar(label: str, progress: Progress | bool | None) -> Iterator[Progress]:
    """What to call with the steps done: the caller's own, a bar on stderr for True, or nothing."""
    if progress is not True:
        yield progress or (lambda done, total: None)
        return
    with tqdm(desc=label, leave=True) as bar:

        def show(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)

        yield show
