"""The process in which ezc3d reads a C3D file: it may hang, take all memory, or die of the file.

INPUTS: a file's path, bytes of memory that may be used; this is run as a script, by ``c3d`` alone.
OUTPUTS: on standard output a line of JSON, then the points (3, M, T) as float64, NaN where missing.
Exit code 3 where there is not memory enough, 4 without ezc3d, 1 where the file cannot be read.
"""

import json
import sys
from typing import Any

EXIT_TOO_LARGE, EXIT_NO_READER = 3, 4
WORD = 0xFFFF
# What stands among the points and is none, by the groups that name it.
OTHERS = ("ANGLES", "FORCES", "MOMENTS", "POWERS", "SCALARS")


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


def frame_number(parameters: Any, name: str, in_header: int) -> int:
    """A frame's number from 1; TRIAL has the one that the header's 16 bits cannot count."""
    trial = parameters.get("TRIAL", {})
    words = [int(word) & WORD for word in trial[name]["value"]] if name in trial else []
    low, high = (*words, 0, 0)[:2]
    is_same = low == in_header or in_header >= WORD
    return low + (high << 16) if high and is_same else in_header


def read_to_stdout(path: str, most: int) -> int:
    """Read a file and hand it on; the exit code."""
    limit_memory(most)
    try:
        import ezc3d
        import numpy as np

        file = ezc3d.c3d(path)
        points, parameters = file["data"]["points"][:3], file["parameters"]
        residuals = file["data"]["meta_points"]["residuals"][0]
        points[:, residuals < 0] = np.nan
        group = parameters["POINT"]
        labels = stored_labels(group, points.shape[1])
        names = {str(n).strip() for kind in OTHERS if kind in group for n in group[kind]["value"]}
        is_point = np.array([label not in names for label in labels], bool)
        # A selection takes its memory once more.
        points = points if is_point.all() else points[:, is_point]
        header = file["header"]["points"]
        first, last = (int(header[key]) + 1 for key in ("first_frame", "last_frame"))
        first = frame_number(parameters, "ACTUAL_START_FIELD", first)
        last = frame_number(parameters, "ACTUAL_END_FIELD", last)
        units = group["UNITS"]["value"] if "UNITS" in group else []
        times = parameters["EVENT"].get("TIMES", {}) if "EVENT" in parameters else {}
        head = {
            "shape": points.shape[1:],
            "rate": float(header["frame_rate"]),
            "first": first - 1,
            "frames": last - first + 1,
            "unit": str(units[0]).strip() if len(units) else "",
            "labels": [label for label, own in zip(labels, is_point, strict=True) if own],
            "others": [label for label, own in zip(labels, is_point, strict=True) if not own],
            "has_residuals": bool((residuals > 0).any()),
            "analog_channels": file["data"]["analogs"].shape[1],
            "events": len(times.get("value", ())),
        }
        output = sys.stdout.buffer
        output.write(json.dumps(head).encode() + b"\n")
        output.write(np.ascontiguousarray(points, np.float64).data)
        output.flush()
    except MemoryError:
        return EXIT_TOO_LARGE
    except ModuleNotFoundError:
        return EXIT_NO_READER
    # ezc3d raises whatever its parser met: OSError, RuntimeError, ValueError, IndexError, ...
    except Exception:
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(read_to_stdout(sys.argv[1], int(sys.argv[2])))
