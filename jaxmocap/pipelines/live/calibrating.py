"""``live --calibrate``: the person stands still, and the live file learns how devices are held.

INPUTS: a live file, a stance, the devices' stream. OUTPUTS: the live file with height, arms'
lengths, orientations and offsets; figures.
"""

import threading
import tomllib
from collections import deque
from collections.abc import Mapping
from time import monotonic
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from jaxmocap.calibration.devices.standing import (
    Stance,
    StandingCalibration,
    StandingError,
    calibrate_standing,
)
from jaxmocap.capture.streams.sample_assembly import MarkerSample, SampleAssembler
from jaxmocap.formats.cameras.toml_sections import replace_entries, rewrite_toml
from jaxmocap.formats.files.errors import InputError, OutputError, comma_list
from jaxmocap.formats.files.toml import toml_value
from jaxmocap.formats.files.writing import check_target
from jaxmocap.pipelines.live.setup import LiveSetup
from jaxmocap.pipelines.live.status import LiveStatus, stream_states

# What the person is asked to do.
INSTRUCTIONS: dict[Stance, str] = {
    "t": "stand upright, arms stretched to the sides, palms down, and look straight ahead",
    "i": "stand upright, arms hanging, thumbs ahead, and look straight ahead",
}
# Seconds from the command to the stance.
COUNTDOWN_S = 5.0
# Seconds of standing still that are used.
STILL_S = 2.0
# Samples of each device within them, at least.
MIN_SAMPLES = 10
# As many as all senders together may send while somebody stands still.
MOST_SAMPLES = 10_000
# Devices stand still where they move by less: metres and degrees (RMS).
STILL_M = 0.015
STILL_DEG = 4.0
# Seconds that the devices are waited for, and that somebody may take to stand still.
PATIENCE_S = 30.0
# Seconds between lines while devices are waited for.
WAITING_LINE_S = 5.0
# Seconds between looks at the samples.
POLL_S = 0.1
_DECIMALS = {"height": 3, "length": 4, "turn": 4, "offset": 4}


def calibrate_live(
    setup: LiveSetup,
    stance: Stance,
    status: LiveStatus,
    stop: threading.Event,
    countdown: float = COUNTDOWN_S,
) -> dict[str, Any]:
    """Measure somebody who stands still, and put it into the live file.

    ``status`` takes what the person is to do, and what was measured.

    Returns:
        Figures; empty where it was stopped.

    Raises:
        InputError: the live file cannot be changed in place; or an address cannot be had.
        OutputError: no device came in, nobody stood still, or what was measured is no stance.
    """
    check_target(setup.path)
    listening = _Listening(setup, status, stop)
    try:
        if not listening.wait_for_devices():
            return {}
        status.log(listening.now(), f"in {countdown:.0f} s {INSTRUCTIONS[stance]}")
        if stop.wait(countdown):
            return {}
        still = listening.stand_still()
    finally:
        listening.close()
    if still is None:
        return {}
    try:
        # Height and arms may be measured where neither a static trial nor a file states them.
        by_height = not setup.subject or "height" in setup.subject
        result = calibrate_standing(setup.places, *_mean(*still), stance, setup.skeleton, by_height)
    except StandingError as error:
        raise OutputError(setup.path, f"not calibrated: {error}") from None
    _put_into(setup, result)
    for line in _summary(setup, result):
        status.log(listening.now(), line)
    status.ring()
    return {
        "height_m": result.height,
        "lengths_m": dict(result.lengths),
        "turn_wxyz": {name: list(each) for name, each in result.orientations.items()},
        "offset_m": {name: list(each) for name, each in result.offsets.items()},
        "warnings": list(result.warnings),
    }


class _Listening:
    """Samples of the devices, the newest ones."""

    def __init__(self, setup: LiveSetup, status: LiveStatus, stop: threading.Event):
        self._began, self._setup, self._status, self._stop = monotonic(), setup, status, stop
        self._samples: deque[MarkerSample] = deque(maxlen=MOST_SAMPLES)
        assembler = SampleAssembler(
            setup.marker_names, setup.source.aliases, setup.R_world_source, self._samples.append
        )
        self._source = setup.source.open(assembler, self.now)
        self._source.start()
        self._assembler = assembler
        status.log(0.0, f"listening at {self._source.address}")

    def now(self) -> float:
        """Seconds since it began."""
        return monotonic() - self._began

    def close(self) -> None:
        self._source.stop()

    def wait_for_devices(self) -> bool:
        """Wait until every device has come, or the first ones have for some seconds."""
        until = self.now() + PATIENCE_S
        missing, next_line = set(self._setup.marker_names), 1.0
        while missing and self.now() < until and self._source.problem is None:
            if self.now() >= next_line:
                next_line += WAITING_LINE_S
                self._status.log(
                    self.now(),
                    f"waiting for {comma_list(sorted(missing))}, {until - self.now():.0f} s more"
                    f"{self._others()}",
                )
            if self._stop.wait(POLL_S):
                return False
            missing = set(self._setup.marker_names)
            if recent := self._recent():
                has_come = np.isfinite(_stack_samples(recent)[0]).all(-1).any(0)
                missing -= {self._setup.marker_names[i] for i in np.flatnonzero(has_come)}
        if missing == set(self._setup.marker_names):
            raise OutputError(
                self._setup.path,
                f"not calibrated: no marker came in at {self._source.address} within "
                f"{PATIENCE_S:.0f} s{self._others()}",
            )
        if missing:
            self._status.log(self.now(), f"missing: {comma_list(sorted(missing))}{self._others()}")
        return True

    def _others(self) -> str:
        """Why a marker may not come in, as ``live`` shows it."""
        states = stream_states(self._source, self._assembler, (), self.now())
        about = [f"; {of}: {state}" for of, state in states if of not in ("markers", "missing")]
        return "".join([f"; {self._source.problem}"] if self._source.problem else about)

    def stand_still(self) -> tuple[np.ndarray, np.ndarray] | None:
        """The samples of the first seconds in which all devices stood still."""
        self._status.log(self.now(), "stand still")
        until, problem = self.now() + PATIENCE_S, "too few samples came in"
        self._samples.clear()
        while self.now() < until:
            if self._stop.wait(POLL_S):
                return None
            recent = self._recent()
            if len(recent) < MIN_SAMPLES or recent[-1].arrived - recent[0].arrived < 0.9 * STILL_S:
                continue
            samples = _stack_samples(recent)
            problem = _movement(self._setup, *samples)
            if not problem:
                return samples
        problem = f"not calibrated: {problem} within {STILL_S:.0f} s; stand still"
        raise OutputError(self._setup.path, problem)

    def _recent(self) -> list[MarkerSample]:
        newest = [each for each in list(self._samples) if each.measurements is not None]
        return [each for each in newest if self.now() - each.arrived < STILL_S]


def _stack_samples(samples: list[MarkerSample]) -> tuple[np.ndarray, np.ndarray]:
    """Positions (T, M, 3), metres, and R_world_marker (T, M, 3, 3); NaN where missing."""
    measured = [each.measurements for each in samples if each.measurements is not None]
    return (
        np.stack([each.positions_world for each in measured]),
        np.stack([each.orientations_world for each in measured]),
    )


def _movement(setup: LiveSetup, positions_world: np.ndarray, R_world_marker: np.ndarray) -> str:
    """Which device moves, in a sentence; empty where all stand still."""
    columns = positions_world.swapaxes(0, 1), R_world_marker.swapaxes(0, 1)
    for name, points, R in zip(setup.marker_names, *columns, strict=True):
        points = points[np.isfinite(points).all(-1)]
        moved = np.sqrt(np.sum(np.var(points, 0))) if len(points) else 0.0
        if moved > STILL_M:
            return f"{name} moved by {100 * moved:.0f} cm"
        R = R[np.isfinite(R).all((1, 2))]
        if len(R):
            each = Rotation.from_matrix(R)
            turned = np.degrees(np.sqrt(np.mean((each.mean().inv() * each).magnitude() ** 2)))
            if turned > STILL_DEG:
                return f"{name} turned by {turned:.0f}°"
    return ""


def _mean(positions_world: np.ndarray, R_world_marker: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Median positions (M, 3) and mean orientations (M, 3, 3); NaN where there were none."""
    count = positions_world.shape[1]
    positions, R_mean = np.full((count, 3), np.nan), np.full((count, 3, 3), np.nan)
    for i in range(count):
        points, R = positions_world[:, i], R_world_marker[:, i]
        points, R = points[np.isfinite(points).all(-1)], R[np.isfinite(R).all((1, 2))]
        if len(points) >= MIN_SAMPLES:
            positions[i] = np.median(points, 0)
        if len(R) >= MIN_SAMPLES:
            R_mean[i] = Rotation.from_matrix(R).mean().as_matrix()
    return positions, R_mean


def _put_into(setup: LiveSetup, result: StandingCalibration) -> None:
    """Write it into the live file; comments and all other keys stay."""

    def change(text: str) -> str:
        try:
            return _with_result(text, result)
        except ValueError as error:
            lines = "; ".join(_summary(setup, result))
            raise InputError(setup.path, f"{error}: put the lines in by hand: {lines}") from None

    rewrite_toml(setup.path, change)


def _with_result(text: str, result: StandingCalibration) -> str:
    """The live file's text with it.

    Raises:
        ValueError: what is to change is not written so that it can be.
    """
    top = tomllib.loads(text)
    for name, entry in top["markers"]["on"].items():
        changes: dict[str, Any] = {}
        if name in result.orientations and entry.get("turn") is not False:
            changes["turn"] = _round_value("turn", result.orientations[name])
        if name in result.offsets:
            changes["offset"] = _round_value("offset", result.offsets[name])
        if changes:
            text = _with_marker(text, name, {**entry, **changes}, changes)
    if result.height is not None:
        text = replace_entries(text, "subject", {"height": _round_value("height", result.height)})
    if result.lengths:
        bones = top.get("subject", {}).get("bones", {})
        lengths = {
            name: {**bones.get(name, {}), "length": _round_value("length", length)}
            for name, length in result.lengths.items()
        }
        text = replace_entries(text, ("subject", "bones"), lengths)
    return text


def _with_marker(text: str, name: str, entry: Mapping[str, Any], changes: Mapping[str, Any]) -> str:
    """A marker's entry replaced: a section of its own, or a line of [markers.on]."""
    try:
        return replace_entries(text, ("markers", "on", name), changes)
    except ValueError:
        return replace_entries(text, ("markers", "on"), {name: dict(entry)})


def _round_value(key: str, value: Any) -> Any:
    return np.round(value, _DECIMALS[key]).tolist()


def _summary(setup: LiveSetup, result: StandingCalibration) -> list[str]:
    """What was measured, a line each."""
    lines = []
    if result.height is not None:
        stated = (setup.subject or {}).get("height")
        before = f", {stated:g} m before" if isinstance(stated, (int, float)) else ""
        lines.append(f"height = {_round_value('height', result.height)} m{before}")
    if result.lengths:
        arm = sum(length for name, length in result.lengths.items() if name.endswith("_l"))
        lines.append(f"arms: {100 * arm:.1f} cm from shoulder to wrist")
    for name in setup.marker_names:
        measured = []
        if name in result.orientations:
            measured.append(f"turn = {toml_value(_round_value('turn', result.orientations[name]))}")
        if name in result.offsets:
            measured.append(f"offset = {toml_value(_round_value('offset', result.offsets[name]))}")
        if measured:
            lines.append(f"{name}: {', '.join(measured)}")
    return [*lines, *(f"warning: {each}" for each in result.warnings), f"written  {setup.path}"]
