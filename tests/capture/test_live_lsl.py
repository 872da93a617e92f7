"""Markers of a real LSL stream, sent and heard on this machine."""

import time

import numpy as np
import pytest
from conftest import complaint, wait_for

from jaxmocap.capture.streams.lsl import LslTable, MarkerStream
from jaxmocap.capture.streams.sample_assembly import MarkerSample, SampleAssembler
from jaxmocap.pipelines.live.setup import load_live

try:
    import pylsl
except (ImportError, RuntimeError):
    pytest.skip('pylsl is not installed: pip install ".[lsl]" brings it', allow_module_level=True)

MARKERS = ("Head", "LWrist")


def outlet(name: str, labels: list[str], unit="millimetres", kind: str = "float32"):
    """A stream of 90 samples a second."""
    info = pylsl.StreamInfo(name, "MoCap", len(labels), 90, kind, f"{name}-1")
    channels = info.desc().append_child("channels")
    units = [unit] * len(labels) if isinstance(unit, str) else unit
    for label, of in zip(labels, units, strict=True):
        channel = channels.append_child("channel")
        channel.append_child_value("label", label).append_child_value("unit", of)
    sends = pylsl.StreamOutlet(info)
    if not pylsl.resolve_byprop("name", name, timeout=10.0):
        pytest.skip("an LSL stream of this very machine is not found: it lets no multicast through")
    return sends


def listening(name: str) -> tuple[MarkerStream, list[MarkerSample]]:
    samples: list[MarkerSample] = []
    stream = MarkerStream(LslTable(name), SampleAssembler(MARKERS, {}, np.eye(3), samples.append))
    stream.start()
    return stream, samples


def test_markers_of_a_real_stream_come_in_with_its_rhythm_and_its_gaps():
    name = f"jaxmocap test {time.time_ns()}"
    sends = outlet(name, [f"{m}.{axis}" for m in ("Other", *MARKERS) for axis in "xyz"])
    stream, samples = listening(name)
    try:
        assert sends.wait_for_consumers(15.0)
        began = pylsl.local_clock()
        for i in range(60):
            wrist = [np.nan] * 3 if i == 30 else [10.0 * i, 20.0, 1e9 if i == 40 else 30.0]
            sends.push_sample([0.0] * 3 + [1000.0, 2000.0, 1500.0 + i] + wrist, began + i / 90)
            time.sleep(0.002)
        wait_for(lambda: len(samples) == 60, 15.0)
        assert stream.packets == 60
    finally:
        stream.stop()
    positions = np.stack([sample.positions_world for sample in samples])
    np.testing.assert_allclose(positions[:, 0, 2], 1.5 + np.arange(60) / 1000, atol=1e-6)
    np.testing.assert_allclose(positions[20, 1], [0.2, 0.02, 0.03], atol=1e-6)
    assert np.flatnonzero(np.isnan(positions[:, 1]).all(-1)).tolist() == [30, 40]
    assert stream.ignored["absurd"] == 1 and stream.problem is None
    assert (np.diff([sample.time for sample in samples]) > 0).all()


def test_a_marker_of_a_stream_may_say_how_it_is_turned():
    name = f"jaxmocap test {time.time_ns()}"
    parts = [*"xyz", *(f"q{part}" for part in "xyzw")]
    sends = outlet(name, [f"Head.{part}" for part in parts] + [f"LWrist.{axis}" for axis in "xyz"])
    stream, samples = listening(name)
    quarter = [0.0, 0.0, 0.5**0.5, 0.5**0.5]
    try:
        assert sends.wait_for_consumers(15.0)
        for turn in (quarter, [0.0] * 4, [np.nan] * 4):
            sends.push_sample([0.0, 0.0, 1700.0, *turn, 300.0, 400.0, 1000.0])
        wait_for(lambda: len(samples) == 3, 15.0)
    finally:
        stream.stop()
    orientations = np.stack([sample.measurements.orientations_world for sample in samples])
    np.testing.assert_allclose(orientations[0, 0] @ [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], atol=1e-6)
    assert np.isnan(orientations[:, 1]).all()
    np.testing.assert_allclose([s.positions_world[1, 0] for s in samples], 0.3, atol=1e-6)


def test_a_stream_without_such_channels_is_said():
    name = f"jaxmocap test {time.time_ns()}"
    _sends = outlet(name, ["EEG1", "EEG2", "EEG3"], "microvolts")
    stream, samples = listening(name)
    try:
        wait_for(lambda: stream.problem is not None, 15.0)
    finally:
        stream.stop()
    assert "found EEG1, EEG2, EEG3" in str(stream.problem) and not samples


def test_other_channels_may_have_other_units_and_a_markers_may_not():
    labels = [f"{name}.{axis}" for name in ("Head", "Gyro") for axis in "xyz"]
    for units, problem in ((["m"] * 3 + ["deg/s"] * 3, None), (["km"] * 3 + ["m"] * 3, "'km'")):
        name = f"jaxmocap test {time.time_ns()}"
        sends = outlet(name, labels, units)
        stream, samples = listening(name)
        try:
            assert problem is not None or sends.wait_for_consumers(15.0)
            for i in range(40):
                sends.push_sample([1.0, 2.0, 3.0, 7.0, 8.0, 9.0], pylsl.local_clock() + i / 90)
                time.sleep(0.002)
            wait_for(lambda s=stream, got=samples: got or s.problem is not None, 15.0)
        finally:
            stream.stop()
        if problem is None:
            assert stream.problem is None and samples
        else:
            assert problem in str(stream.problem) and "Head" in str(stream.problem) and not samples


def test_a_stream_of_text_is_refused_and_its_labels_are_no_commands_to_a_terminal():
    for kind, label, message in (
        ("string", "Head", "found text"),
        ("float32", "\x1b[2JHead", "\\x1b[2JHead"),
    ):
        name = f"jaxmocap test {time.time_ns()}"
        _sends = outlet(name, [label] * 3, kind=kind)
        stream, samples = listening(name)
        try:
            wait_for(lambda stream=stream: stream.problem is not None, 15.0)
        finally:
            stream.stop()
        assert message in str(stream.problem) and str(stream.problem).isprintable() and not samples


@pytest.mark.parametrize("name", ["it's", "\\u001b[2J", "x" * 300])
def test_a_name_that_no_stream_has_is_refused(tmp_path, name):
    path = tmp_path / "live.toml"
    path.write_text(f'[markers.on]\nHead = {{ bone = "head" }}\n[lsl]\nstream = "{name}"\n')
    assert "stream: found" in complaint(load_live, path)


def test_a_live_runs_file_may_name_a_stream_which_is_z_up(tmp_path):
    path = tmp_path / "live.toml"
    path.write_text("[markers.on]\nHead = { bone = 'head' }\n[lsl]\nstream = 'mocap'\n")
    setup = load_live(path)
    assert setup.source == LslTable("mocap")
    np.testing.assert_array_equal(setup.R_world_source, np.eye(3))
