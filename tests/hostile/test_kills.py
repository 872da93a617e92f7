"""Commands that are killed while they work: nothing is lost, broken or left behind.

Run by name, some twenty minutes: pytest -m slow tests/hostile/test_kills.py -s; or in parts, each
of a few minutes: -k "silhouette and lot0".
"""

import hashlib
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from small_recording import write_small_recording

from jaxmocap.capture.video import Video
from jaxmocap.formats.animation.bvh import read_bvh
from jaxmocap.formats.animation.gltf_in import read_gltf
from jaxmocap.formats.files.output_folder import LIST_NAME, read_list
from jaxmocap.formats.motion_npz import load_motion
from jaxmocap.formats.time_series.mot import read_mot
from jaxmocap.formats.time_series.trc import read_trc
from jaxmocap.synthetic.four_cameras import write_four_cameras
from jaxmocap.synthetic.movements import motions
from jaxmocap.synthetic.people.clothed_person import clothed_actor

# Of each command: so many lots of so many.
LOTS, KILLS = 4, 10
pytestmark = [
    pytest.mark.slow,
    pytest.mark.parametrize("lot", range(LOTS), ids=lambda lot: f"lot{lot}"),
]

# Every second kill comes within so many seconds after the first hidden file.
WRITING_S = 1.5
READERS = {".trc": read_trc, ".mot": read_mot, ".bvh": read_bvh, ".glb": read_gltf, ".mp4": Video}


def digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def digests(folder: Path) -> dict[str, str]:
    return {str(p.relative_to(folder)): digest(p) for p in folder.rglob("*") if p.is_file()}


def run(arguments: Sequence[object]) -> float:
    """Run a command to its end; seconds."""
    began = time.monotonic()
    done = subprocess.run(command(arguments), capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return time.monotonic() - began


def command(arguments: Sequence[object]) -> list[str]:
    return [sys.executable, "-m", "jaxmocap.cli", *map(str, arguments)]


def killed(arguments: Sequence[object], after_s: float, writing: Path | None) -> bool:
    """Kill a command and all its processes after so many seconds; was it still at work?

    Where a folder is given, the seconds count from when something hidden is in it.
    """
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    process = subprocess.Popen(command(arguments), start_new_session=True, **quiet)
    before = set(hidden_in(writing)) if writing else set()
    while writing and process.poll() is None and not set(hidden_in(writing)) - before:
        time.sleep(0.005)
    try:
        process.wait(after_s)
        return False
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        return True


def hidden_in(folder: Path) -> list[str]:
    try:
        return [str(path) for path in folder.rglob(".jaxmocap-*")]
    except FileNotFoundError:
        # It has just gone.
        return []


def check(out: Path, earlier: set[str]) -> int:
    """Every file is whole, in a list, and none of the earlier ones is missing; how many hidden."""
    hidden, actual = 0, set()
    for path in out.rglob("*"):
        within = path.relative_to(out)
        if any(part.startswith(".") for part in within.parts):
            hidden += len(within.parts) and within.parts[-1].startswith(".jaxmocap-")
            continue
        if path.is_file() and path.name not in (LIST_NAME, "notes.txt"):
            assert digest(path) in read_list(path.parent)[path.name].digests, within
            if path.suffix in READERS:
                READERS[path.suffix](path)
            elif path.name == "motion.npz":
                load_motion(path)
            actual.add(str(within))
    assert earlier <= actual, f"lost: {earlier - actual}"
    assert (out / "notes.txt").read_text() == "mine"
    return hidden


def rehearse(lot: int, inputs: Path, out: Path, arguments: Sequence[object]) -> None:
    """Run, kill, look, run again."""
    run(arguments)
    (out / "notes.txt").write_text("mine")
    earlier = {
        str(p.relative_to(out)) for p in out.rglob("*") if p.is_file() and p.name != LIST_NAME
    } - {"notes.txt"}
    seconds, rng = run(arguments), np.random.default_rng(lot)
    at_work = left = 0
    for number, share in enumerate(rng.uniform(0.0, 1.0, KILLS)):
        late = number % 2
        after_s = share * (WRITING_S if late else seconds)
        # What has not changed a batch does not track again.
        for path in inputs.rglob("recording.toml"):
            path.write_text(f"{path.read_text()}# {number}\n")
        before = digests(inputs)
        at_work += killed(arguments, after_s, out if late else None)
        left += check(out, earlier) > 0
        assert digests(inputs) == before
    run(arguments)
    assert check(out, earlier) == 0 and digests(inputs) == before
    print(f"\n{KILLS} kills, {at_work} at work, {left} left hidden files until the next run")
    assert at_work > KILLS // 2


def test_track_is_killed(tmp_path, lot):
    (tmp_path / "in").mkdir()
    recording = write_small_recording(tmp_path / "in")
    rehearse(
        lot, tmp_path / "in", tmp_path / "out", ["track", recording, "--out", tmp_path / "out"]
    )


def test_silhouette_track_is_killed(tmp_path, lot):
    performer = clothed_actor(motions.squat(0.2, 0, 1.75), 0)
    recording = write_four_cameras(tmp_path / "in", performer, 0.2)
    arguments = ["silhouette", "track", recording, "--at", "0,0,0", "--once"]
    rehearse(lot, tmp_path / "in", tmp_path / "out", [*arguments, "--out", tmp_path / "out"])


def test_batch_is_killed(tmp_path, lot):
    (tmp_path / "in/one").mkdir(parents=True)
    write_small_recording(tmp_path / "in/one")
    shutil.copytree(tmp_path / "in/one", tmp_path / "in/two")
    arguments = ["batch", tmp_path / "in", "--out", tmp_path / "out", "--workers", 2]
    rehearse(lot, tmp_path / "in", tmp_path / "out", [*arguments, "--refine", "none"])
