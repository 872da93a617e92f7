"""Compiling ahead: what tracking and a live run will need is compiled and kept on disk.

INPUTS: a recording, of which half a second is tracked; the file of a live run; or none, for
somebody who stands before a grey wall.
OUTPUTS: JAX's compilation cache; how many programs were compiled, and how long it took.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import perf_counter

import jax
import numpy as np

from jaxmocap.capture.footage import open_footage
from jaxmocap.capture.timeline import Mode
from jaxmocap.formats.files.toml import read_toml
from jaxmocap.formats.recordings.recording import Recording
from jaxmocap.hybrid.settings import Settings, unused_setting
from jaxmocap.hybrid.tracker import HybridTracker
from jaxmocap.pipelines.demo import standing_recording
from jaxmocap.pipelines.kept_programs import keep_compiled
from jaxmocap.pipelines.live.setup import LiveSetup, load_live
from jaxmocap.pipelines.live.tracking import LiveTracking
from jaxmocap.pipelines.tracking.track import track

# Seconds of a recording that are tracked: enough frames that the smoother gives out poses.
TRACKED_S = 0.5
# Frames of the recording that stands in where none is named; as many.
STANDING_FRAMES = 16
# Mode of tracking -> its name in the output; a live run needs the programs of the second.
MODE_NAMES: dict[Mode, str] = {"own": "track", "causal": "track --causal"}
# Of settings that neither search nor smooth.
NEAREST_NAMES: dict[Mode, str] = {"nearest": "track"}
# The same of a live run, by whether it smooths.
LIVE_NAMES = {False: "live", True: "live --smooth"}
# JAX's names of the events that are counted.
COMPILE_EVENT = "/jax/core/compile/backend_compile_duration"
CACHE_HIT_EVENT = "/jax/compilation_cache/cache_hits"


@dataclass
class CompilationCounts:
    """What compiling for one mode of tracking took."""

    mode: str  # its name in the output
    seconds: float = 0.0  # in all, tracing and half a second of tracking included
    programs: int = 0  # that it needs and that were not yet in this process
    from_cache: int = 0  # how many of them an earlier run had compiled
    # Name -> seconds that the compiler took, the longest first.
    longest_s: dict[str, float] = field(default_factory=dict)

    def text(self) -> str:
        """One line."""
        names = ", ".join(f"{name} {spent:.1f} s" for name, spent in self.longest_s.items())
        counts = (
            f"{self.programs - self.from_cache} programs compiled, {self.from_cache} were there"
        )
        return f"{self.mode}: {self.seconds:.1f} s, {counts}; longest: {names or 'none'}"


def warm_up(recording: Recording, settings: Settings | None = None) -> list[CompilationCounts]:
    """Compile what tracking the recording needs, offline and causally where the settings allow it.

    Others with as many markers on the same bones and as many cameras need the same programs.
    """
    keep_compiled()
    short = first_half_second(recording)
    tracker = HybridTracker.from_recording(short, settings)
    chosen, found = tracker.settings, []
    for mode, name in (MODE_NAMES if chosen.search or chosen.smooth else NEAREST_NAMES).items():
        if unused_setting(chosen, chosen.smooth, mode == "causal"):
            continue
        with counting_compilations(name) as counts:
            track(short, tracker=tracker, mode=mode, progress=False)
        found.append(counts)
    return found


def warm_up_live(setup: LiveSetup, settings: Settings | None = None) -> list[CompilationCounts]:
    """Compile what a live run needs, with and without ``--smooth``; no device is opened.

    Raises:
        ValueError: settings with which there is no live run.
    """
    keep_compiled()
    chosen, found = settings or Settings(), []
    for smooth, name in LIVE_NAMES.items():
        if smooth and unused_setting(chosen, smooth, causal=True):
            continue
        with counting_compilations(name) as counts:
            LiveTracking(setup, chosen, smooth).wait_until_ready()
        found.append(counts)
    return found


def load_or_standing(path: str | None) -> Recording | LiveSetup:
    """A recording or a live run from its file, or somebody who stands before a grey wall."""
    if path is None:
        return standing_recording(STANDING_FRAMES)
    markers = read_toml(Path(path)).get("markers")
    if isinstance(markers, dict) and "file" not in markers:
        return load_live(path)
    return Recording.load(path)


def first_half_second(recording: Recording) -> Recording:
    """The first half second that markers and all videos have in common.

    Raises:
        InputError: there is none.
    """
    is_visible = np.isfinite(recording.require_markers().positions_world).all(-1).any(-1)
    starts = [video.times[0] for video in open_footage(recording)[0] if len(video)]
    begin = max([recording.times[is_visible.argmax()], *starts])
    chosen = (recording.times >= begin) & (recording.times < begin + TRACKED_S)
    if not (chosen & is_visible).any():
        raise recording.error("no marker was measured beside the video")
    return replace(
        recording, times=recording.times[chosen], positions_world=recording.positions_world[chosen]
    )


@contextmanager
def counting_compilations(mode: str) -> Iterator[CompilationCounts]:
    """Count what JAX compiles meanwhile, and what it reads from its cache; name the longest."""
    began, counts = perf_counter(), CompilationCounts(mode)
    spent: dict[str, float] = {}

    def on_duration(event: str, duration_secs: float, **kwargs: str | int) -> None:
        if event == COMPILE_EVENT:
            name = str(kwargs.get("fun_name", "")).removeprefix("jit(").removesuffix(")")
            spent[name] = spent.get(name, 0.0) + duration_secs
            counts.programs += 1

    def on_event(event: str, **kwargs: str | int) -> None:
        counts.from_cache += event == CACHE_HIT_EVENT

    jax.monitoring.register_event_duration_secs_listener(on_duration)
    jax.monitoring.register_event_listener(on_event)
    try:
        yield counts
    finally:
        jax.monitoring.unregister_event_duration_listener(on_duration)
        jax.monitoring.unregister_event_listener(on_event)
        longest = sorted(spent.items(), key=lambda pair: -pair[1])[:4]
        counts.longest_s.update({name.strip("_"): round(time, 3) for name, time in longest})
        counts.seconds = perf_counter() - began
