"""``python -m bench [--quick] [--json FILE]``: speed, in one table."""

import argparse
import os
import tempfile
from pathlib import Path

import jax

from bench.frame_rate import measure
from bench.metrics import write_json
from jaxmocap.run.compilation import keep_compiled

# Seconds of the clip and solves by the reference: in full, and quickly.
FULL, QUICK = (20.0, 300), (2.0, 40)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a short clip")
    parser.add_argument("--json", metavar="FILE", help="write the metrics")
    options = parser.parse_args()
    if os.environ.get("JAX_COMPILATION_CACHE_DIR"):
        keep_compiled()
    device = jax.devices()[0]
    print(f"frame rate, on {os.cpu_count()} cores, {device.platform}", flush=True)
    with tempfile.TemporaryDirectory() as folder:
        metrics, table = measure(Path(folder), *(QUICK if options.quick else FULL))
    print(table)
    if options.json:
        write_json(metrics, options.json)


if __name__ == "__main__":
    main()
