"""A device's offset from the joint it turns about, its deviation, and when it is open."""

import json
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from held_devices import DEVICES, pivoting
from scipy.spatial.transform import Rotation

from jaxmocap.calibration.devices.offsets import (
    DeviceOffset,
    estimate_offsets,
    offsets_text,
    toml_line,
)
from jaxmocap.cli.program import main
from jaxmocap.formats.files.toml import read_toml
from jaxmocap.formats.recordings.marker_places import MarkerPlace, read_place
from jaxmocap.formats.recordings.recording import write_recording
from jaxmocap.formats.time_series.csv import write_csv
from jaxmocap.formats.time_series.tables import Markers

TIMES = np.arange(20 * 90) / 90
PLACES = [MarkerPlace(name, device.bone, 0.0) for name, device in DEVICES.items()]
TRUTH = {n: d.R_bone_device.T @ d.offset_bone for n, d in DEVICES.items()}


def markers_of(points: dict[str, np.ndarray], turns: dict[str, np.ndarray]) -> Markers:
    stacked = [np.stack(list(each.values()), 1) for each in (points, turns)]
    return Markers(TIMES, tuple(points), stacked[0], orientations=stacked[1])


def device_offsets(**clip) -> dict[str, DeviceOffset]:
    held = estimate_offsets(markers_of(*pivoting(TIMES, **clip)), PLACES)
    return {each.place.name: each for each in held}


def test_offsets_are_found_within_millimetres_and_their_deviations_are_honest():
    """Twenty clips of a consumer headset's noise, with joints that wander by millimetres."""
    errors, deviations = [], []
    for seed in range(20):
        for name, held in device_offsets(seed=seed).items():
            assert held.warnings == () and held.windows == 20
            errors.append(held.offset - TRUTH[name])
            deviations.append(held.std)
    errors, deviations = np.array(errors), np.array(deviations)
    assert np.abs(errors).max() < 0.008
    # Of a normal error with these deviations 68 % lie within one and 95 % within two.
    assert 0.5 < (np.abs(errors) < deviations).mean() < 0.85
    assert (np.abs(errors) < 2 * deviations).mean() > 0.85


def test_turning_about_one_axis_leaves_the_offset_along_it_open_and_says_so():
    for name, held in device_offsets(seed=1, swing_deg=(35.0, 0.0, 0.0)).items():
        (warning,) = held.warnings
        assert "not determined along" in warning and "rotate it about the others too" in warning
        # About the bone's left axis, seen in the marker's.
        axis = DEVICES[name].R_bone_device.T @ [0.0, 1.0, 0.0]
        assert axis @ held.covariance @ axis > 0.9
        across = np.linalg.svd(axis[None])[2][1:]
        errors = across @ (held.offset - TRUTH[name])
        assert np.abs(errors).max() < 0.008


def test_an_arm_that_moves_as_a_whole_is_no_wrist_and_is_doubted():
    """Hand and forearm as one about the elbow: the point that rests lies 35 cm away."""
    points, turns = pivoting(TIMES, 2)
    longer = {
        n: points[n] + turns[n] @ (TRUTH[n] / np.linalg.norm(TRUTH[n]) * 0.26) for n in points
    }
    for held in estimate_offsets(markers_of(longer, turns), PLACES):
        assert np.linalg.norm(held.offset) > 0.3
        assert any("hardly the joint" in warning for warning in held.warnings)


def test_a_device_at_the_wrist_end_of_a_forearm_gets_no_offset_from_the_elbow():
    """It turned about the wrist; a line for radius_l counts from the elbow, 25 cm away."""
    markers = markers_of(*pivoting(TIMES, 2))
    for at, is_usable in ((1.0, False), (0.0, True)):
        places = [PLACES[0], MarkerPlace("LeftController", "radius_l", at), PLACES[2]]
        _, offset, _ = estimate_offsets(markers, places)
        assert any('state bone = "hand_l"' in each for each in offset.warnings) != is_usable
        assert ("LeftController = " in offsets_text([offset])) == is_usable


def test_a_joint_that_strays_is_doubted_and_single_jerks_weigh_little():
    (held, *_) = device_offsets(seed=3, stray_m=0.2).values()
    assert any("rest it" in warning for warning in held.warnings)
    points, turns = pivoting(TIMES, 3)
    jerk = 0.2 * np.sin(5 * TIMES)[:, None] * ((TIMES > 4) & (TIMES < 6))[:, None]
    moved = {name: place + jerk for name, place in points.items()}
    for held in estimate_offsets(markers_of(moved, turns), PLACES):
        assert np.abs(held.offset - TRUTH[held.place.name]).max() < 0.008


def test_standing_still_tells_how_the_devices_are_held():
    points, turns = pivoting(TIMES, 4)
    still, facing = TIMES > 18, Rotation.from_euler("z", 70, degrees=True).as_matrix()
    for name, device in DEVICES.items():
        turns[name][still] = facing @ device.R_bone_device
        side = {"hand_l": 0.25, "hand_r": -0.25}.get(device.bone, 0.0)
        points[name][still] = facing @ [0.0, side, 0.8]
    markers = markers_of(points, turns)
    for held in estimate_offsets(markers, PLACES, (18.1, 19.9), (0.0, 17.9)):
        assert held.orientation is not None and held.windows == 18
        np.testing.assert_allclose(
            held.orientation, DEVICES[held.place.name].R_bone_device, atol=1e-3
        )
        # What is printed is what a recording takes.
        entry = tomllib.loads(toml_line(held))[held.place.name]
        place = read_place(Path("a.toml"), held.place.name, entry)
        np.testing.assert_allclose(place.offset, held.offset, atol=1e-4)
        assert place.offset_in == "marker" and place.orientation is not None
        # Whatever a device is called.
        for name in ("Left Hand", "VIVE.L", "Führ"):
            renamed = replace(held, place=replace(held.place, name=name))
            assert set(tomllib.loads(toml_line(renamed))) == {name}
    with pytest.raises(ValueError, match="a marker on hand_l and one on hand_r"):
        estimate_offsets(markers, [PLACES[0]] * 3, (18.1, 19.9))


def test_what_a_clip_does_not_determine_is_left_out_or_refused():
    points, turns = pivoting(TIMES, 5)
    markers = markers_of(points, turns)
    for name in ("Headset", "LeftController"):
        turns[name][TIMES >= 4] = np.nan
    with pytest.raises(ValueError, match="Headset: found 4 seconds with places and turns, exp"):
        estimate_offsets(markers_of(points, turns), PLACES)
    turns["Headset"][:], turns["LeftController"][:] = np.nan, np.nan
    (held,) = estimate_offsets(markers_of(points, turns), PLACES)
    assert held.place.name == "RightController"
    with pytest.raises(ValueError, match="no marker has an orientation"):
        estimate_offsets(Markers(TIMES, markers.names, markers.positions), PLACES)
    doubted = device_offsets(seed=1, swing_deg=(35.0, 0.0, 0.0))["Headset"]
    assert offsets_text([doubted]).endswith("no line for [markers.on]: every device has a warning")


def test_the_command_prints_lines_for_the_recording(tmp_path, refusal, capsys):
    write_csv(tmp_path / "markers.csv", TIMES, *pivoting(TIMES, 6))
    on = {place.name: {"bone": place.bone, "at": 0.0} for place in PLACES}
    path = write_recording(tmp_path, "markers.csv", on)
    assert main(["offsets", str(path), "--json", str(tmp_path / "a.json")]) == 0
    printed = capsys.readouterr().out
    lines = tomllib.loads(printed[printed.index("[markers.on]") :])["markers"]["on"]
    figures = json.loads((tmp_path / "a.json").read_text())
    for name, truth in TRUTH.items():
        np.testing.assert_allclose(lines[name]["offset"], truth, atol=0.008)
        np.testing.assert_allclose(figures[name]["offset_m"], truth, atol=0.008)
        assert max(figures[name]["std_m"]) < 0.005 and figures[name]["warnings"] == []
    # They go into the recording as they are.
    assert set(read_toml(path)["markers"]["on"]) == set(lines)
    assert "expected 8 or more" in refusal("offsets", path, "--turning", "0,3")
