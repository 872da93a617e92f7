"""What a live run says of markers that no body has, and of clocks that run at another rate."""

import socket
import threading
import time
from io import StringIO

import numpy as np
import pytest
from small_recording import small_recording
from test_live_markers import packet
from test_live_network import Line
from test_live_run import Standing, packets_of, small_setup

import jaxmocap.pipelines.live.loop
from jaxmocap.capture.streams.sample_assembly import MarkerSample
from jaxmocap.capture.streams.stream_clock import RATE_WINDOW_S, RATE_WINDOWS, StreamClock
from jaxmocap.pipelines.live.loop import Live
from jaxmocap.pipelines.live.marker_states import (
    MIN_SAMPLES,
    UPRIGHT_SAMPLES,
    ReachState,
    UprightState,
)
from jaxmocap.pipelines.live.status import LiveStatus

FOUND_WITHIN_S = (RATE_WINDOWS + 0.5) * RATE_WINDOW_S
ARRIVALS = np.arange(0, 30, 1 / 90)


# Clocks ------------------------------------------------------------------------------------------


def times_of(clock: StreamClock, arrivals: np.ndarray, stamps: np.ndarray) -> np.ndarray:
    return np.array([clock.time(*pair) for pair in zip(arrivals, stamps, strict=True)])


@pytest.mark.parametrize("rate", [10.0, 0.1, 1000.0, 1.5])
def test_a_clock_of_another_rate_is_found_and_not_used(rate):
    clock = StreamClock()
    times = times_of(clock, ARRIVALS, 500 + rate * ARRIVALS)
    assert clock.rate == pytest.approx(rate, rel=1e-3)
    is_late = ARRIVALS > FOUND_WITHIN_S
    np.testing.assert_array_equal(times[is_late], ARRIVALS[is_late])
    jumps = clock.jumps
    times_of(clock, ARRIVALS + 30, 500 + rate * (ARRIVALS + 30))
    assert clock.jumps == jumps


def test_a_clock_that_is_right_again_is_used_again():
    clock, rng = StreamClock(), np.random.default_rng(0)
    times_of(clock, ARRIVALS, 10 * ARRIVALS)
    arrivals = ARRIVALS + 30 + rng.exponential(0.004, len(ARRIVALS))
    times = times_of(clock, arrivals, 300 + ARRIVALS)
    assert clock.rate is None
    assert np.diff(times)[1500:].std() < 3e-4


@pytest.mark.parametrize("seed", range(5))
def test_what_networks_and_people_do_to_stamps_is_no_other_rate(seed):
    """Delays up to a quarter of a second, clocks that are set, a sender that pauses or stands."""
    rng = np.random.default_rng(seed)
    arrivals = np.maximum.accumulate(ARRIVALS + rng.uniform(0, 0.25, len(ARRIVALS)))
    late = np.where((ARRIVALS > 5) & (ARRIVALS < 9), 9.0, ARRIVALS)
    for arrived, stamps in (
        (arrivals, ARRIVALS),
        (ARRIVALS, ARRIVALS + (ARRIVALS > 10) * rng.uniform(-20, 20)),
        (ARRIVALS + (ARRIVALS > 10) * 7.0, ARRIVALS),
        (late, ARRIVALS),
        (ARRIVALS, np.full_like(ARRIVALS, 7.0)),
        (ARRIVALS, ARRIVALS * (1 + rng.uniform(-1e-3, 1e-3))),
        (ARRIVALS, rng.uniform(0, 100, len(ARRIVALS))),
    ):
        clock, rates = StreamClock(), set()
        for pair in zip(arrived, stamps, strict=True):
            clock.time(*pair)
            rates.add(clock.rate)
        assert rates == {None}


def test_a_fast_clock_is_reported_once_and_in_one_sentence():
    line, status = Line(), LiveStatus(StringIO())
    for at in ARRIVALS:
        line.bring(packet(0.0, at=at, stamp=10 * at), packet(0.0, 5001, at=at, stamp=at))
        line.report_to(status)
    lines = [each for each in status.messages if "clock" in each["what"]]
    assert [each["what"] for each in lines] == [
        "the sender's clock: runs 10 times as fast as this machine's; its stamps are not used"
    ]
    assert lines[0]["seconds"] < FOUND_WITHIN_S


# Reach -------------------------------------------------------------------------------------------


def test_a_head_that_jumps_is_reported_while_it_runs(tmp_path, monkeypatch):
    """Every fiftieth sample has it 90 m away."""
    monkeypatch.setattr(jaxmocap.pipelines.live.loop, "LiveTracking", Standing)
    status, recording = LiveStatus(StringIO()), small_recording()
    live = Live(small_setup(tmp_path), status=status)
    names, packet_of = recording.marker_names, packets_of(recording.marker_names)
    stop = threading.Event()

    def found() -> list[str]:
        return [each["what"] for each in status.messages if each["what"].startswith("out of reach")]

    def play() -> None:
        sender, i = socket.socket(socket.AF_INET, socket.SOCK_DGRAM), 0
        # A busy machine drops some of them.
        while not found() and not stop.is_set() and (i := i + 1):
            points = recording.positions_world[i % len(recording.times)].copy()
            points[0] += [90.0 if i % 50 == 49 else 0.0, 0.0, 0.0]
            sender.sendto(packet_of(points), tuple(live.address))
            time.sleep(1 / 400)
        stop.set()

    player = threading.Thread(target=play)
    player.start()
    live.run(seconds=30.0, stop=stop)
    stop.set()
    player.join()
    (sentence,) = found()
    first, second = sentence.split(" from ")
    assert first.startswith(f"out of reach: {names[0]} is up to ") and first.endswith(" m")
    assert "this body reaches" in second and second.endswith("(10 or more samples)")


def test_every_tenfold_of_samples_beyond_reach_is_a_state_and_few_are_none():
    recording = small_recording()
    state, points = ReachState(recording.skeleton, recording.places), recording.positions_world
    states = []
    for i in range(20 * MIN_SAMPLES):
        sample = points[i % len(points)].copy()
        sample[0, 2] += 90.0 * (i % 2)
        state.add(MarkerSample(i / 90, sample, i / 90))
        states.append(state.state)
    assert not any(states[: 2 * MIN_SAMPLES - 1]) and len(set(states)) == 3
    still = ReachState(recording.skeleton, recording.places)
    for sample in points:
        still.add(MarkerSample(0.0, sample, 0.0))
    assert still.state == ""


@pytest.mark.parametrize(("axes", "along"), [([0, 1, 2], ""), ([2, 0, 1], "x"), ([1, 2, 0], "y")])
def test_a_person_who_lies_along_another_axis_is_reported_once(axes, along):
    """As of a sender whose axes are not those that its protocol states."""
    recording = small_recording()
    state, points = UprightState(recording.skeleton, recording.places), recording.positions_world
    states = []
    for i in range(3 * UPRIGHT_SAMPLES):
        state.add(MarkerSample(i / 90, points[i % len(points)][:, axes], i / 90))
        states.append(state.state)
    assert not any(states[: UPRIGHT_SAMPLES - 1])
    (sentence,) = set(states[UPRIGHT_SAMPLES:])
    assert sentence == "" if not along else f"stands along the world's {along} (" in sentence


def test_places_that_no_room_has_are_named_with_what_is_expected():
    """As of a sender of millimetres."""
    line, status = Line(), LiveStatus(StringIO())
    for at in ARRIVALS[:40]:
        line.bring(packet(1700.0, at=at, stamp=at))
    line.report_to(status)
    expected = "expected positions in metres, within 100 m of the origin"
    assert any(each["what"].endswith(expected) for each in status.messages)
