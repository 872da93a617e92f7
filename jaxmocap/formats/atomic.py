"""Files that appear whole or not at all.

INPUTS: the path that a file shall have.
OUTPUTS: a path beside it to write to; the file is moved into place when the writer is done.
"""

import os
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """Write beside ``path`` and replace it at the end; after an error it is as it was before.

    The temporary name keeps the suffix, by which libraries choose a format. Missing folders are
    made.

    Yields:
        The temporary path, in the same folder: a move within one file system is atomic.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    beside = path.with_name(f".{path.stem}.{uuid.uuid4().hex[:8]}{path.suffix}")
    try:
        yield beside
        os.replace(beside, path)
    finally:
        beside.unlink(missing_ok=True)
