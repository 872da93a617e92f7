"""Executes the notebooks beside it, each in a folder of its own.

    python notebooks/execute.py                      # all, files stay as they are
    python notebooks/execute.py --write 02_simplex   # replaces the stored outputs

INPUTS: beginnings of notebooks' names, all by default; JAXMOCAP_QUICK=1 in the environment makes
them short. OUTPUTS: what took how long; exit 1 with the cell's own error where one fails.
"""

import argparse
import os
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from importlib.metadata import version
from pathlib import Path
from time import perf_counter

import nbformat
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError, CellTimeoutError

# Of one cell, seconds.
TIMEOUT_S = 600
AT_A_TIME = 2
FLAGS = "--xla_cpu_use_fusion_emitters=false --xla_cpu_parallel_codegen_split_count=1"


def executed(path: Path, write: bool) -> str:
    """What went wrong in a notebook; nothing where nothing did. Its outputs are stored if asked."""
    began = perf_counter()
    notebook = nbformat.read(path, as_version=4)
    with tempfile.TemporaryDirectory() as folder:
        client = NotebookClient(
            notebook,
            timeout=TIMEOUT_S,
            record_timing=False,
            coalesce_streams=True,
            resources={"metadata": {"path": folder}},
        )
        try:
            client.execute()
        except (CellExecutionError, CellTimeoutError) as error:
            return f"{path.name}: {error}"
    if write:
        for cell in notebook.cells:
            cell.metadata.pop("execution", None)
        nbformat.write(notebook, path)
    print(f"{path.name}: {perf_counter() - began:.0f} s", flush=True)
    return ""


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("names", nargs="*", default=[""], help="beginnings of notebooks' names")
    parser.add_argument("--write", action="store_true", help="store the outputs")
    asked = parser.parse_args()
    if os.environ.get("JAXMOCAP_QUICK"):
        # Much is compiled then and little of it computed. Optimised, as users run it, the benchmark
        # runs it.
        os.environ.setdefault("JAX_DISABLE_MOST_OPTIMIZATIONS", "1")
        # As the tests have it: the older emitters compile in two thirds of the time, and two
        # notebooks use both cores. A release that does not know the flags would not start.
        if version("jaxlib").startswith("0.10."):
            os.environ.setdefault("XLA_FLAGS", FLAGS)
    notebooks = sorted(Path(__file__).parent.glob("*.ipynb"))
    paths = [path for path in notebooks if path.name.startswith(tuple(asked.names))]
    # Much of a notebook's time one core waits for the compiler.
    with ThreadPoolExecutor(AT_A_TIME) as beside:
        work = partial(executed, write=asked.write)
        wrong = [problem for problem in beside.map(work, paths) if problem]
    print(*wrong, sep="\n", end="", file=sys.stderr)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
