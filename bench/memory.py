"""``python -m bench.memory SAMPLES... [--track] [--json FILE] [--plot FILE]``: memory.

INPUTS: how many samples of three markers at 90 Hz, without a video; of several, one after another.
OUTPUTS: a process's memory over time and its peak, GB, while the files of a long motion are
written, and while it is converted to each format of markers; with ``--track`` while the command
``track`` runs instead, which takes an hour or more for a million; Metrics.
"""

import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from time import monotonic, sleep
from typing import Any, NamedTuple

import matplotlib.pyplot as plt
import numpy as np

from bench import command
from bench.figures import Metric, write_json
from jaxmocap.body.motion import Motion, Report
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import LANDMARKS, Skeleton
from jaxmocap.formats.motion_npz import load_motion, save_motion
from jaxmocap.formats.recordings.recording import Recording, write_recording
from jaxmocap.formats.time_series.csv import write_csv
from jaxmocap.pipelines.writing import write_outputs
from jaxmocap.synthetic.people.clothed_person import MARKERS
from jaxmocap.synthetic.recording import MARKER_RATE, marker_places

# Between two looks at a process, seconds.
INTERVAL_S = 0.1
# Lines of the table over time.
LINES = 24
GB = 1e9
# What a million samples may take.
MOST_GB = 2.0
# What a process runs: the command, and what it does once it has tracked.
COMMAND = "from jaxmocap.cli import enter; raise SystemExit(enter())"
WRITE = "import sys; from bench.memory import write_tracked; write_tracked(*sys.argv[1:])"


class Use(NamedTuple):
    """What a process had, seconds after its start."""

    seconds: float
    bytes: int


class Watched(NamedTuple):
    """A process that has ended: what it had over its time, and the most by the system's account."""

    uses: list[Use]
    peak_bytes: int


def write_long(folder: Path, samples: int) -> None:
    """A person who sways for so many samples: ``recording.toml`` and ``motion.npz``."""
    skeleton, times = Skeleton.human(1.75), np.arange(samples) / MARKER_RATE
    limits, relaxed = np.asarray(skeleton.limits), np.asarray(skeleton.relaxed)
    phases = np.random.default_rng(0).uniform(0, 6, len(relaxed))
    swaying = 0.15 * np.ptp(limits, axis=1) * np.sin(times[:, None] + phases)
    parts: list[Any] = [
        np.tile([0.0, 0.0, 0.95], (samples, 1)),
        np.tile([1.0, 0.0, 0.0, 0.0], (samples, 1)),
        np.clip(relaxed + swaying, *limits.T),
    ]
    # In the precision that tracking has.
    parts = [part.astype(np.float32) for part in parts]
    shape = samples, len(LANDMARKS)
    report = Report(
        markers=tuple(MARKERS),
        marker_errors=np.full((samples, len(MARKERS)), 0.002, np.float32),
        arm_costs=np.full((samples, 2), np.nan, np.float32),
        swivels=np.zeros((samples, 2), np.float32),
        landmarks_std=np.full((*shape, 3), 0.05, np.float32),
        from_prior=np.zeros(shape, np.float32),
        statuses=((),) * samples,
        milliseconds={"solve": np.ones(samples)},
    )
    motion = Motion(skeleton, times, Pose(*parts), report)
    save_motion(folder / "motion.npz", motion)
    ends = dict(zip(MARKERS, ("vertex", "hand_l", "hand_r"), strict=True))
    joints = motion.joints()
    write_csv(folder / "markers.csv", times, {name: joints[end] for name, end in ends.items()})
    write_recording(folder, "markers.csv", marker_places(), subject={"height": 1.75})


def write_tracked(recording: str, motion: str, out: str) -> None:
    """What ``track`` does at its end."""
    write_outputs(load_motion(motion), Recording.load(recording), out, progress=False)


def watch(code: str, arguments: Sequence[str]) -> Watched:
    """Run Python code with arguments, and look at its memory until it ends.

    Raises:
        CalledProcessError: it did not end well.
    """
    start, uses = monotonic(), []
    process = subprocess.Popen([sys.executable, "-c", code, *arguments])
    while not (waited := os.wait4(process.pid, os.WNOHANG))[0]:
        if resident := resident_bytes(process.pid):
            uses.append(Use(monotonic() - start, resident))
        sleep(INTERVAL_S)
    _, status, usage = waited
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise subprocess.CalledProcessError(process.returncode, arguments)
    return Watched(uses, 1024 * usage.ru_maxrss)


def resident_bytes(process: int) -> int:
    """Of a process; 0 where it has ended."""
    try:
        lines = Path(f"/proc/{process}/status").read_text().splitlines()
    except OSError:
        return 0
    found = [line.split()[1] for line in lines if line.startswith("VmRSS:")]
    return 1024 * int(found[0]) if found else 0


def over_time(uses: Sequence[Use]) -> list[Use]:
    """The most within each of ``LINES`` parts of the time, at its end."""
    edges = np.linspace(0, uses[-1].seconds, LINES + 1)
    most = []
    for start, end in pairwise(edges):
        within = [use.bytes for use in uses if start <= use.seconds <= end]
        if within:
            most.append(Use(float(end), max(within)))
    return most


def draw(runs: Mapping[str, Sequence[Use]], path: str | Path) -> None:
    """A picture of the memory that each of some runs had over its time."""
    figure, panels = plt.subplots(
        1, len(runs), figsize=(9, 2.8), sharey=True, layout="constrained", squeeze=False
    )
    for axes, (name, uses) in zip(panels[0], runs.items(), strict=True):
        axes.stairs([use.bytes / GB for use in uses], [0.0, *(use.seconds / 60 for use in uses)])
        axes.axhline(MOST_GB, color="0.6", linestyle=":")
        axes.set(title=name, xlabel="minutes", ylim=(0, None))
    panels[0][0].set_ylabel("memory, GB")
    figure.savefig(path, dpi=110)


def runs_of(folder: Path, track: bool) -> dict[str, tuple[str, list[str]]]:
    """Name -> code and arguments, of what is done with a folder of ``write_long``."""
    recording, motion = str(folder / "recording.toml"), str(folder / "motion.npz")
    if track:
        return {"track": (COMMAND, ["track", recording, "--out", str(folder / "tracked")])}
    runs = {"write": (WRITE, [recording, motion, str(folder / "written")])}
    for suffix in ("trc", "csv"):
        arguments = ["convert", motion, str(folder / f"joints.{suffix}")]
        runs[f"convert to {suffix}"] = (COMMAND, arguments)
    return runs


def main() -> None:
    """Write and convert, or track; print."""
    parser = command("bench.memory", __doc__)
    parser.add_argument("samples", type=int, nargs="+")
    parser.add_argument("--track", action="store_true", help="track, and nothing else")
    parser.add_argument("--plot", metavar="FILE", help="draw the memory over time")
    options = parser.parse_args()
    metrics, drawn = [], {}
    peaks: dict[str, list[int]] = {}
    for samples in options.samples:
        with tempfile.TemporaryDirectory() as directory:
            folder = Path(directory)
            write_long(folder, samples)
            for name, run in runs_of(folder, options.track).items():
                watched = watch(*run)
                most = watched.peak_bytes / GB
                print(f"{name}: {samples} samples, most memory {most:.2f} GB", flush=True)
                drawn[name] = over_time(watched.uses)
                for end in drawn[name]:
                    print(f"{end.seconds:8.1f} s  {end.bytes / GB:5.2f} GB", flush=True)
                metrics.append(Metric(f"memory: {name}, {samples} samples", most, "GB"))
                peaks.setdefault(name, []).append(watched.peak_bytes)
            (size,) = (path.stat().st_size for path in folder.glob("*/recording.rrd"))
            print(f"recording.rrd: {size / GB:.2f} GB")
    for name, of_name in peaks.items():
        if len(of_name) > 1:
            more = options.samples[-1] - options.samples[0]
            slope = (of_name[-1] - of_name[0]) / more / 1e3
            print(f"{name}: {slope:.2f} kB more for each further sample")
    if options.plot:
        draw(drawn, options.plot)
    write_json(metrics, options.json)


if __name__ == "__main__":
    main()
