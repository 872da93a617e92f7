"""Executes every notebook beside it, in a folder of its own, and leaves the files as they are.

INPUTS: the notebooks; JAXMOCAP_QUICK=1 in the environment makes them short.
OUTPUTS: what took how long; exit 1 with the cell's own error where one fails.
"""

import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from time import perf_counter

import nbformat
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError, CellTimeoutError

# Of one cell, seconds.
TIMEOUT_S = 180
AT_A_TIME = 2


def executed(path: Path) -> str:
    """What went wrong in a notebook; nothing where nothing did."""
    began = perf_counter()
    notebook = nbformat.read(path, as_version=4)
    with tempfile.TemporaryDirectory() as folder:
        client = NotebookClient(
            notebook, timeout=TIMEOUT_S, resources={"metadata": {"path": folder}}
        )
        try:
            client.execute()
        except (CellExecutionError, CellTimeoutError) as error:
            return f"{path.name}: {error}"
    print(f"{path.name}: {perf_counter() - began:.0f} s", flush=True)
    return ""


def main() -> int:
    paths = sorted(Path(__file__).parent.glob("*.ipynb"))
    # Much of a notebook's time one core waits for the compiler.
    with ThreadPoolExecutor(AT_A_TIME) as beside:
        wrong = [problem for problem in beside.map(executed, paths) if problem]
    print(*wrong, sep="\n", end="", file=sys.stderr)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
