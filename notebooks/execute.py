"""Executes every notebook beside it, in a folder of its own, and leaves the files as they are.

INPUTS: the notebooks; JAXMOCAP_QUICK=1 in the environment makes them short.
OUTPUTS: what took how long; exit 1 with the cell's own error where one fails.
"""

import sys
import tempfile
from pathlib import Path
from time import perf_counter

import nbformat
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError, CellTimeoutError

# Of one cell, seconds.
TIMEOUT_S = 180


def main() -> int:
    for path in sorted(Path(__file__).parent.glob("*.ipynb")):
        began = perf_counter()
        notebook = nbformat.read(path, as_version=4)
        with tempfile.TemporaryDirectory() as folder:
            client = NotebookClient(
                notebook, timeout=TIMEOUT_S, resources={"metadata": {"path": folder}}
            )
            try:
                client.execute()
            except (CellExecutionError, CellTimeoutError) as error:
                print(f"{path.name}: {error}", file=sys.stderr)
                return 1
        print(f"{path.name}: {perf_counter() - began:.0f} s", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
