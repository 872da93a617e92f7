"""Show what was written, in the rerun viewer.

INPUTS: a folder that ``track`` wrote. OUTPUTS: a window, or how to open one elsewhere.
"""

import os
import subprocess
import sys
from pathlib import Path

from jaxmocap.formats.errors import InputError


def recording_in(directory: str | Path) -> Path:
    """The folder's recording.rrd; InputError where there is none."""
    path = Path(directory) / "recording.rrd"
    if not path.is_file():
        raise InputError(path, "no such file, expected a folder that 'jaxmocap track' wrote")
    return path


def has_display() -> bool:
    """Whether a window can be shown: on Linux a display server must be named."""
    if not sys.platform.startswith("linux"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def open_viewer(path: Path) -> str:
    """Open a recording in a viewer of its own where there is a display; a sentence about it."""
    if not has_display():
        return f"{path}\nno display here; where there is one: rerun {path.name}"
    subprocess.Popen([sys.executable, "-m", "rerun", str(path)], start_new_session=True)
    return f"{path}\nopened in the rerun viewer"
