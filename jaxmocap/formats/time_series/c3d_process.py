"""The process in which ezc3d reads a C3D file: it may hang, take all memory, or die of the file.

INPUTS: a file's path, bytes of memory that may be used; this is run as a script, by ``c3d`` alone.
OUTPUTS: on standard output a line of JSON, then the points (3, M, T) and their residuals (M, T) as
float64. Exit code 3 where there is not memory enough, 1 where the file cannot be read.
"""

import json
import sys
from typing import Any

EXIT_TOO_LARGE = 3


def limit_memory(max_bytes: int) -> None:
    """Let this process have so many bytes, where the system can hold it to that."""
    try:
        import resource
    except ImportError:
        return
    resource.setrlimit(resource.RLIMIT_AS, (max_bytes, max_bytes))


def stored_labels(group: Any, count: int) -> list[str]:
    """A name for every point; beyond 255 they go on in LABELS2, LABELS3, ..."""
    keys = ["LABELS", *(f"LABELS{i}" for i in range(2, 2 + count // 255))]
    labels = [str(name).strip() for key in keys if key in group for name in group[key]["value"]]
    names = [name or f"point{i}" for i, name in enumerate(labels[:count], 1)]
    return names + [f"point{i}" for i in range(len(names) + 1, count + 1)]


def read_to_stdout(path: str, most: int) -> int:
    """Read a file and hand it on; the exit code."""
    limit_memory(most)
    try:
        import ezc3d
        import numpy as np

        file = ezc3d.c3d(path)
        points, parameters = file["data"]["points"], file["parameters"]
        group = parameters["POINT"]
        units = group["UNITS"]["value"] if "UNITS" in group else []
        times = parameters["EVENT"].get("TIMES", {}) if "EVENT" in parameters else {}
        head = {
            "shape": points.shape[1:],
            "rate": float(file["header"]["points"]["frame_rate"]),
            "first": int(file["header"]["points"]["first_frame"]),
            "unit": str(units[0]).strip() if len(units) else "",
            "labels": stored_labels(group, points.shape[1]),
            "analog_channels": file["data"]["analogs"].shape[1],
            "events": len(times.get("value", ())),
        }
        output = sys.stdout.buffer
        output.write(json.dumps(head).encode() + b"\n")
        for array in (points[:3], file["data"]["meta_points"]["residuals"][0]):
            output.write(np.ascontiguousarray(array, np.float64).data)
        output.flush()
    except MemoryError:
        return EXIT_TOO_LARGE
    # ezc3d raises whatever its parser met: OSError, RuntimeError, ValueError, IndexError, ...
    except Exception:
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(read_to_stdout(sys.argv[1], int(sys.argv[2])))
