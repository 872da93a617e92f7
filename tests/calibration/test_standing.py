"""What a T or an I pose tells of body and devices, and the live file that takes it."""

import re
import tomllib
from codecs import BOM_UTF8
from dataclasses import replace
from importlib.resources import files
from io import StringIO
from pathlib import Path
from threading import Event, Thread
from time import monotonic
from types import SimpleNamespace
from typing import get_args

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import jaxmocap.pipelines.live.calibrating as calibrating
from jaxmocap.body.orientations import body_turns, quaternions
from jaxmocap.body.skeleton import Skeleton, with_wrists
from jaxmocap.calibration.devices.standing import (
    EYE_HEIGHT,
    STANCE_ANGLES_DEG,
    Stance,
    StandingError,
    calibrate_standing,
    stand,
)
from jaxmocap.capture.streams.sample_assembly import MarkerMeasurements, MarkerSample
from jaxmocap.capture.streams.udp import OscTable
from jaxmocap.formats.files.errors import OutputError
from jaxmocap.formats.recordings.marker_places import MarkerPlace
from jaxmocap.pipelines.live.setup import load_live
from jaxmocap.pipelines.live.status import LiveStatus

STANCES = get_args(Stance)
PLACES = (
    MarkerPlace("Hmd", "head", 0.7, (0.1, 0.0, 0.0), orientation=(1.0, 0.0, 0.0, 0.0)),
    MarkerPlace("Left", "hand_l", 0.6),
    MarkerPlace("Right", "hand_r", 0.6),
    MarkerPlace("Waist", "spine1", 0.0, (-0.1, 0.0, 0.0)),
)


def devices_of(
    body: Skeleton, stance: Stance, yaw: float, height: float, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions (M, 3) and orientations (M, 3, 3) of held devices, and how each is held."""
    angles = np.zeros((1, len(body.tree.joints)))
    for joint, degrees in STANCE_ANGLES_DEG[stance].items():
        angles[0, body.tree.joint(joint)] = np.radians(degrees)
    R_body = body_turns(body, angles)[0]
    R_world = Rotation.from_euler("z", yaw).as_matrix()
    along = np.asarray(body.lengths)[:, None] * np.asarray(body.directions)
    joints = np.zeros((len(R_body), 3))
    for bone, parent in enumerate(body.tree.parents):
        if parent >= 0:
            joints[bone] = joints[parent] + R_body[parent] @ along[parent]
    joints[:, 2] += (
        body.diameters[body.tree.bone("foot_l"), 0] - joints[body.tree.bone("foot_l"), 2]
    )
    held = Rotation.random(len(PLACES), rng=rng).as_matrix()
    held[0] = Rotation.from_euler("y", 8, degrees=True).as_matrix()
    positions, R = [], []
    for place, R_bone_device in zip(PLACES, held, strict=True):
        i = body.tree.bone(place.bone)
        point = joints[i] + R_body[i] @ (place.at * along[i] + np.array(place.offset))
        positions.append(R_world @ point + [0.4, -0.7, 0.0])
        R.append(R_world @ R_body[i] @ R_bone_device)
    positions[0][2] = EYE_HEIGHT * height
    return np.array(positions), np.array(R), held


def person(height: float, arms: float = 1.0) -> Skeleton:
    body = with_wrists(Skeleton.human(height))
    longer = [arms if n.split("_")[0] in ("humerus", "radius") else 1.0 for n in body.tree.bones]
    return replace(body, lengths=body.lengths * np.array(longer, np.float32))


@given(
    st.sampled_from(STANCES), st.floats(1.4, 2.1), st.floats(0.9, 1.1), st.floats(-3.1, 3.1),
    st.integers(0, 99),
)  # fmt: skip
@settings(max_examples=30, deadline=None)
def test_height_arms_and_how_devices_are_held_are_found(stance, height, arms, yaw, seed):
    arms = arms if stance == "t" else 1.0
    true = person(height, arms)
    devices = devices_of(true, stance, yaw, height, np.random.default_rng(seed))
    result = calibrate_standing(PLACES, *devices[:2], stance, person(1.75))
    assert result.height == pytest.approx(height, abs=1e-6) and not result.warnings
    if stance == "t":
        assert set(result.lengths) == {"humerus_l", "humerus_r", "radius_l", "radius_r"}
        for bone, length in result.lengths.items():
            assert length == pytest.approx(float(true.lengths[true.tree.bone(bone)]), abs=1e-5)
    for place, R in zip(PLACES, devices[2], strict=True):
        np.testing.assert_allclose(result.orientations[place.name], quaternions(R), atol=1e-5)
    np.testing.assert_allclose(result.offsets["Waist"], [-0.1, 0, 0], atol=1e-3)
    assert set(result.offsets) == {"Hmd", "Waist"}  # grips' offsets stay


def test_offsets_in_the_devices_own_axes_change_no_length():
    positions, R, _ = devices_of(person(1.62, 1.04), "t", 0.3, 1.62, np.random.default_rng(0))
    expected = calibrate_standing(PLACES, positions, R, "t", person(1.75))
    places, grip = list(PLACES), np.array([0.05, -0.1, 0.02])
    for i in (1, 2):
        places[i] = replace(PLACES[i], offset=tuple(grip.tolist()), offset_in="marker")
        positions[i] += R[i] @ grip
    result = calibrate_standing(places, positions, R, "t", person(1.75))
    assert result.lengths == pytest.approx(expected.lengths, abs=1e-6) and not result.warnings
    np.testing.assert_allclose(result.offsets["Waist"], expected.offsets["Waist"], atol=1e-6)


def test_what_is_worn_above_the_eyes_tells_no_stature_without_a_warning():
    positions, R, _ = devices_of(person(1.75), "t", 0.0, 1.75, np.random.default_rng(0))
    hat = [MarkerPlace("Hat", "head"), *PLACES[1:]]
    (warning,) = calibrate_standing(hat, positions, R, "t", person(1.75)).warnings
    assert "Hat is stated to be 10 cm above the eyes" in warning


@pytest.mark.parametrize("height", [1.5, 1.75, 1.95])
def test_the_pages_put_a_headset_at_the_eyes(height):
    docs, stated = files("jaxmocap") / "docs", set()
    for page in ("start_vr.md", "live_file.md", "recording_file.md", "programs.md"):
        text = (docs / page).read_text(encoding="utf-8")
        stated |= set(re.findall(r'bone = "head", at = ([\d.]+), offset = \[0.1, ', text))
    standing = stand(person(height), "i")
    for at in stated:
        eyes = standing.point(MarkerPlace("Hmd", "head", float(at)))[2]
        assert eyes == pytest.approx(EYE_HEIGHT * height, abs=0.01)
    assert stated


def test_a_stated_body_keeps_its_lengths():
    devices = devices_of(person(1.6), "t", 0.3, 1.6, np.random.default_rng(0))
    result = calibrate_standing(PLACES, *devices[:2], "t", person(1.6), scaled=False)
    assert result.height is None and not result.lengths and len(result.orientations) == 4


def test_arms_that_are_not_stretched_and_a_head_that_looks_aside_are_warnings():
    positions, R, _ = devices_of(person(1.75), "t", 0.0, 1.75, np.random.default_rng(0))
    positions[1:3, 1] *= 0.8
    R[0] = Rotation.from_euler("z", 40, degrees=True).as_matrix() @ R[0]
    result = calibrate_standing(PLACES, positions, R, "t", person(1.75))
    assert not result.lengths
    aside, apart = result.warnings
    assert "looks 40° away" in aside and "arms' lengths stay" in apart


@pytest.mark.parametrize(
    ("missing", "height", "message"),
    [((1, 0), 1.7, "neither both hands nor a headset's orientation"),
     ((), 0.4, "found the headset 0.37 m above the floor")],
)  # fmt: skip
def test_what_is_no_stance_is_refused(missing, height, message):
    positions, R, _ = devices_of(person(1.75), "i", 0.0, height, np.random.default_rng(0))
    positions[list(missing)] = np.nan
    R[list(missing)] = np.nan
    with pytest.raises(StandingError, match=message):
        calibrate_standing(PLACES, positions, R, "i", person(1.75))


@pytest.mark.parametrize(("stood", "stated"), [("i", "t"), ("t", "i")])
def test_hands_of_another_stance_are_refused(stood, stated):
    """Their orientations would be a quarter turn off."""
    for yaw in (0.0, 2.0):
        devices = devices_of(person(1.75), stood, yaw, 1.75, np.random.default_rng(0))[:2]
        with pytest.raises(StandingError, match=r"Left is [0-9]+ cm from where"):
            calibrate_standing(PLACES, *devices, stated, person(1.75))


# The live file -----------------------------------------------------------------------------------

FILE = """\
# My room
[markers.on]
Hmd = { bone = "head", at = 0.7, offset = [0.1, 0.0, 0.0] }   # on the head
Left = { bone = "hand_l", at = 0.6 }
# The right one
[markers.on.Right]
bone = "hand_r"   # held
at = 0.6

[markers.on.Waist]
bone = "spine1"
at = 0.0
turn = false

[osc]
listen = "127.0.0.1:39571"
"""
BY_HEIGHT = "\n[subject]\nheight = 1.75   # about\n[subject.bones]\nneck = { length = 0.1 }\n"


class Source:
    """Devices that stand still, or one that moves."""

    address = "127.0.0.1:1"
    problem = last_arrival = None
    ignored, hints, last_look = {}, {}, 0.0
    senders = SimpleNamespace(clock_rate=None, clock_jumps=0, refused_hosts=set())

    def __init__(self, assembler, now, devices, moves=0.0):
        self._send, self._now, self._devices = assembler._on_sample, now, devices
        self._moves, self._stopped = moves, Event()

    def start(self):
        self._thread = Thread(target=self._play, daemon=True)
        self._thread.start()

    def _play(self):
        while not self._stopped.wait(0.004):
            now = self._now()
            positions = self._devices[0] + [self._moves * np.sin(40 * now), 0, 0]
            there = MarkerMeasurements(positions, self._devices[1])
            self._send(MarkerSample(now, positions, now, there))

    def stop(self):
        self._stopped.set()
        self._thread.join()


def calibrated(folder: Path, monkeypatch, text: str, devices, moves=0.0) -> str:
    """The live file after a calibration in a T pose; what was shown is in ``shown.txt``."""
    monkeypatch.setattr(calibrating, "STILL_S", 0.2)
    monkeypatch.setattr(calibrating, "PATIENCE_S", 1.0)
    monkeypatch.setattr(calibrating, "POLL_S", 0.01)

    def source(table, assembler, now) -> Source:
        return Source(assembler, now, devices, moves)

    monkeypatch.setattr(OscTable, "open", source)
    path, shown = folder / "live.toml", StringIO()
    path.write_text(text)
    try:
        calibrating.calibrate_live(load_live(path), "t", LiveStatus(shown), Event(), 0.01)
    finally:
        (folder / "shown.txt").write_text(shown.getvalue())
    return path.read_text()


def test_the_live_file_takes_what_was_measured_and_keeps_the_rest(tmp_path, monkeypatch):
    devices = devices_of(person(1.62, 1.04), "t", 1.0, 1.62, np.random.default_rng(3))
    after = calibrated(tmp_path, monkeypatch, FILE + BY_HEIGHT, devices)
    top = tomllib.loads(after)
    assert "# My room" in after and "# The right one" in after and "# held" in after
    assert top["subject"]["height"] == pytest.approx(1.62, abs=1e-3)
    assert top["subject"]["bones"]["neck"] == {"length": 0.1}
    assert len(top["subject"]["bones"]) == 5
    for name in ("Hmd", "Left", "Right"):
        i = [place.name for place in PLACES].index(name)
        np.testing.assert_allclose(top["markers"]["on"][name]["turn"],
                                   quaternions(devices[2][i]), atol=1e-3)  # fmt: skip
    assert top["markers"]["on"]["Left"]["at"] == 0.6
    assert top["markers"]["on"]["Waist"]["turn"] is False
    setup = load_live(tmp_path / "live.toml")
    assert setup.places[1].orientation is not None and len(setup.skeleton.tree.joints) == 28
    shown = (tmp_path / "shown.txt").read_text()
    assert "stand upright, arms stretched" in shown and "height = 1.62 m, 1.75 m before" in shown
    # Again: the same devices, nothing else changes.
    again = calibrated(tmp_path, monkeypatch, after, devices)
    assert tomllib.loads(again)["markers"] == top["markers"] and again.count("\n") == after.count(
        "\n"
    )


def test_a_file_without_a_subject_gets_one(tmp_path, monkeypatch):
    devices = devices_of(person(1.62), "t", 1.0, 1.62, np.random.default_rng(3))
    top = tomllib.loads(calibrated(tmp_path, monkeypatch, FILE, devices))
    assert top["subject"]["height"] == pytest.approx(1.62, abs=1e-3)


def test_a_file_of_a_windows_editor_keeps_its_mark_and_the_ends_of_its_lines(tmp_path, monkeypatch):
    devices = devices_of(person(1.62), "t", 1.0, 1.62, np.random.default_rng(3))
    calibrated(tmp_path, monkeypatch, "\ufeff" + FILE.replace("\n", "\r\n"), devices)
    content = (tmp_path / "live.toml").read_bytes()
    assert content.startswith(BOM_UTF8) and b"height = 1.62" in content
    assert content.count(b"\r\n") == content.count(b"\n")


def test_who_moves_is_not_calibrated_and_the_file_stays(tmp_path, monkeypatch):
    devices = devices_of(person(1.62), "t", 1.0, 1.62, np.random.default_rng(3))
    with pytest.raises(OutputError, match=r"not calibrated: Hmd moved by .* cm within"):
        calibrated(tmp_path, monkeypatch, FILE, devices, moves=0.1)
    assert (tmp_path / "live.toml").read_text() == FILE


def test_the_error_tells_why_no_device_comes_in(tmp_path, monkeypatch):
    class Refused(Source):
        problem = "expected channels of numbers, found text"

    devices = devices_of(person(1.62), "t", 1.0, 1.62, np.random.default_rng(3))
    monkeypatch.setattr(
        OscTable, "open", lambda table, assembler, now: Refused(assembler, now, devices)
    )
    monkeypatch.setattr(Source, "_play", lambda self: None)
    (tmp_path / "live.toml").write_text(FILE)
    begun = monotonic()
    with pytest.raises(OutputError, match=r"no marker came in at .* expected channels of numbers"):
        calibrating.calibrate_live(
            load_live(tmp_path / "live.toml"), "i", LiveStatus(StringIO()), Event()
        )
    assert monotonic() - begun < 10.0


def test_without_devices_it_ends_with_a_sentence(tmp_path, monkeypatch):
    monkeypatch.setattr(calibrating, "PATIENCE_S", 0.2)
    (tmp_path / "live.toml").write_text(FILE)
    with pytest.raises(OutputError, match=r"no marker came in at 127\.0\.0\.1"):
        calibrating.calibrate_live(
            load_live(tmp_path / "live.toml"), "i", LiveStatus(StringIO()), Event()
        )
