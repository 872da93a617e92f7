"""Compiling ahead: what tracking and a live run will need is compiled and kept on disk.

INPUTS: a recording, of which half a second is tracked; or somebody who stands before a grey wall.
OUTPUTS: JAX's compilation cache; how many programs were compiled, and how long it took.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from time import perf_counter

import jax
import numpy as np

from jaxmocap.capture.footage import open_footage
from jaxmocap.capture.timeline import Mode
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.recordings.recording import Recording
from jaxmocap.hybrid.settings import Settings
from jaxmocap.pipelines.demo import standing
from jaxmocap.pipelines.kept_programs import cache_folder, keep_compiled
from jaxmocap.pipelines.tracking.track import make_tracker, track

# Of a recording so much is tracked: enough frames that the smoother gives out poses.
ENOUGH_S, STANDING_FRAMES = 0.5, 16
# What each way of tracking is called here; a live run takes the steps of the second.
WAYS: dict[Mode, str] = {"own": "track", "causal": "track --causal, live"}
# JAX's names of what is counted.
COMPILED, HIT = "/jax/core/compile/backend_compile_duration", "/jax/compilation_cache/cache_hits"


@dataclass
class Warmed:
    """What one way of tracking took.

    Attributes:
        way: which one.
        seconds: in all, tracing and half a second of tracking included.
        programs: that it needs and that were not yet in this process.
        found: how many of them an earlier run had compiled.
        longest: name -> seconds that the compiler took, the longest first.
    """

    way: str
    seconds: float = 0.0
    programs: int = 0
    found: int = 0
    longest: dict[str, float] = field(default_factory=dict)

    def text(self) -> str:
        """One line to read."""
        names = ", ".join(f"{name} {spent:.1f} s" for name, spent in self.longest.items())
        counts = f"{self.programs - self.found} programs compiled, {self.found} were there"
        return f"{self.way}: {self.seconds:.1f} s, {counts}; longest: {names or 'none'}"


def warm_up(recording: Recording, settings: Settings | None = None) -> list[Warmed]:
    """Compile what tracking the recording needs, offline and causally.

    Args:
        recording: with or without videos; other recordings with as many markers on the same bones
            and as many cameras need the same programs.
        settings: of the tracker.
    """
    keep_compiled()
    short, ways = opening(recording), []
    tracker = make_tracker(short, settings)
    for mode, way in WAYS.items():
        began, warmed = perf_counter(), Warmed(way)
        with counted(warmed):
            track(short, tracker=tracker, mode=mode)
        ways.append(replace(warmed, seconds=perf_counter() - began))
    return ways


def asked_for(path: str | None) -> Recording:
    """The recording named, or somebody with headset and controllers before a grey wall."""
    return Recording.load(path) if path else standing(STANDING_FRAMES)


def opening(recording: Recording) -> Recording:
    """The first half second that markers and all videos have in common.

    Raises:
        InputError: there is none.
    """
    seen = np.isfinite(recording.require_markers().positions_world).all(-1).any(-1)
    starts = [video.times[0] for video in open_footage(recording)[0] if len(video)]
    begin = max([recording.times[seen.argmax()], *starts])
    chosen = (recording.times >= begin) & (recording.times < begin + ENOUGH_S)
    if not (chosen & seen).any():
        raise InputError(recording.path or recording.name, "no marker is seen beside the video")
    return replace(
        recording,
        times=recording.times[chosen],
        positions_world=recording.positions_world[chosen],
    )


@contextmanager
def counted(warmed: Warmed, most: int = 4) -> Iterator[None]:
    """Count what JAX compiles meanwhile, and what it finds compiled."""
    spent: dict[str, float] = {}

    def on_duration(event: str, duration_secs: float, **kwargs: str | int) -> None:
        if event == COMPILED:
            name = str(kwargs.get("fun_name", "")).removeprefix("jit(").removesuffix(")")
            spent[name] = spent.get(name, 0.0) + duration_secs
            warmed.programs += 1

    def on_event(event: str, **kwargs: str | int) -> None:
        warmed.found += event == HIT

    jax.monitoring.register_event_duration_secs_listener(on_duration)
    jax.monitoring.register_event_listener(on_event)
    try:
        yield
    finally:
        jax.monitoring.unregister_event_duration_listener(on_duration)
        jax.monitoring.unregister_event_listener(on_event)
        longest = sorted(spent.items(), key=lambda pair: -pair[1])[:most]
        warmed.longest.update({name.strip("_"): round(time, 3) for name, time in longest})


def text(ways: list[Warmed]) -> str:
    """What was compiled, and where it is kept."""
    return "\n".join([*(warmed.text() for warmed in ways), f"kept in {cache_folder()}"])


def figures(ways: list[Warmed]) -> dict:
    """What JSON takes."""
    return {"ways": [asdict(warmed) for warmed in ways]}
