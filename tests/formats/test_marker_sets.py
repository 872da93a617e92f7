"""Sets of markers: a recording in three lines, and what is wrong with those lines."""

import argparse
import json

import numpy as np
import pytest
from conftest import complaint

from jaxmocap.body.skeleton import Skeleton, with_joints, with_wrists
from jaxmocap.cli.program import main
from jaxmocap.cli.recording_options import recording_of
from jaxmocap.formats.files.toml import TomlTable
from jaxmocap.formats.marker_sets.sets import read_set, set_file, set_names
from jaxmocap.formats.recordings.recording import load_recording
from jaxmocap.formats.time_series.trc import write_trc
from jaxmocap.pipelines.tracking.track import track

BODY = ("C7", "CLAV", "LASI", "RASI", "LKNE", "RKNE", "LWRA", "RWRA", "LTOE", "LTHI")


def found(labels, skeleton=None, **fields):
    table = TomlTable("r.toml", "[markers]", {"set": "plug-in-gait", **fields})  # type: ignore
    marker_set = read_set(table, labels, skeleton or Skeleton.human(1.7))
    assert marker_set is not None
    return marker_set


def recording(folder, fields: str, labels=BODY):
    times = np.arange(5) / 50
    points = {label: np.tile([0.1 * i, 0.0, 1.0], (5, 1)) for i, label in enumerate(labels)}
    write_trc(folder / "markers.trc", times, points)
    (folder / "r.toml").write_text(f'[markers]\nfile = "markers.trc"\n{fields}\n')
    return folder / "r.toml"


@pytest.mark.parametrize("name", set_names())
def test_every_marker_of_a_set_sits_on_its_own_side_of_an_upright_person(name):
    skeleton = Skeleton.human(1.7)
    tree = skeleton.tree
    reach = np.asarray(skeleton.lengths)[:, None] * np.asarray(skeleton.directions)
    markers, unused = set_file(name)
    assert not set(markers) & set(unused) and len(markers) > 15

    def place(marker):
        """Upright, from the pelvis: the bones up to its own are added, all unturned."""
        *above, own = tree.chain(markers[marker]["bone"])
        along = sum((reach[bone] for bone in above), np.zeros(3))
        return along + markers[marker]["at"] * reach[own] + markers[marker]["offset"]

    for marker in markers:
        forward, left, height = place(marker)
        assert -0.95 < height < 0.85 and abs(left) < 0.3 and -0.2 < forward < 0.25
        if markers[marker]["bone"].endswith("_l") and "R" + marker[1:] in markers:
            assert left > 0
            assert place("R" + marker[1:]) == pytest.approx([forward, -left, height], abs=1e-6)


def test_a_set_places_the_markers_that_the_file_has():
    found_set = found(BODY)
    assert set(found_set.entries) == set(BODY) - {"LTOE", "LTHI"}
    assert set(found_set.unused) == {"LTOE", "LTHI"}
    assert "LELB" in found_set.missing and "RTOE" not in found_set.missing
    assert "8 of 24 markers; missing LFHD" in found_set.sentence()


def test_markers_of_hand_and_foot_serve_bodies_with_these_joints():
    assert "LTOE" in found(BODY, with_joints(Skeleton.human(1.7), "whole.toml")).entries
    labels = (*BODY, "LFIN")
    assert "LFIN" not in found(labels).entries
    assert "LFIN" in found(labels, with_wrists(Skeleton.human(1.7))).entries


def test_offsets_grow_with_the_person():
    small, tall = (found(BODY, Skeleton.human(h)).entries["LASI"]["offset"] for h in (1.7, 2.04))
    assert np.array(small) == pytest.approx([0.066, 0.128, 0.097], abs=1e-4)
    assert np.array(tall) == pytest.approx(1.2 * np.array(small), rel=1e-4)


def test_a_height_of_the_command_line_is_that_of_the_subject(tmp_path):
    labels = [label for part in set_file("plug-in-gait") for label in part]
    other = recording(tmp_path, 'set = "plug-in-gait"\n[subject]\nheight = 1.85', labels)
    expected = load_recording(other)
    path = recording(tmp_path, 'set = "plug-in-gait"', labels)
    actual = recording_of(argparse.Namespace(recording=path, cameras=None, height=1.85))
    assert len(expected.skeleton.tree.joints) > len(Skeleton.human(1.85).tree.joints)
    assert actual.skeleton.tree.joints == expected.skeleton.tree.joints
    np.testing.assert_array_equal(actual.skeleton.lengths, expected.skeleton.lengths)
    assert actual.warnings == expected.warnings == ()
    for ours, theirs in zip(actual.places, expected.places, strict=True):
        assert ours.name == theirs.name
        np.testing.assert_array_equal(ours.offset, theirs.offset)


def test_a_persons_name_may_precede_the_labels_and_tells_two_people_apart():
    labels = [f"{person}:{marker}" for person in ("Ann", "Bob") for marker in BODY]
    assert "Ann:LASI" in found(labels[: len(BODY)]).entries
    assert "several people, Ann, Bob: state one as prefix" in complaint(found, labels)
    assert set(found(labels, prefix="Bob").entries) <= {f"Bob:{marker}" for marker in BODY}
    assert "prefix: found 'Cid', the file has Ann, Bob" in complaint(found, labels, prefix="Cid")


def test_single_markers_are_placed_otherwise_added_or_skipped(tmp_path):
    fields = 'set = "plug-in-gait"\nskip = ["CLAV"]\n[markers.on]\n'
    fields += 'LKNE = { bone = "tibia_l", at = 0.0 }\nLTHI = { bone = "femur_l", at = 0.5 }'
    places = {place.name: place for place in load_recording(recording(tmp_path, fields)).places}
    assert places["LKNE"].bone == "tibia_l" and places["LTHI"].at == 0.5
    assert "CLAV" not in places and "C7" in places


@pytest.mark.parametrize(
    ("fields", "problem"),
    [
        ('set = "plugin"', "set: found 'plugin', expected one of helen-hayes, opensim-rajagopal"),
        ("set = 3", "set: found 3"),
        ('set = "helen-hayes"', "none of the markers of helen-hayes is in the file, found C7"),
        ('set = "plug-in-gait"\nskip = ["LASIS"]', "skip: found 'LASIS', expected some of"),
        ('set = "plug-in-gait"\nskip = "LASI"', "skip: found 'LASI', expected a list of markers"),
        ('skip = ["LASI"]\n[markers.on]\nC7 = { bone = "head" }', "skip: needs 'set'"),
        ('set = "plug-in-gait"\non = 3', "[markers.on]: found 3, expected a table"),
    ],
)
def test_what_is_wrong_is_named(fields, problem, tmp_path):
    assert problem in complaint(load_recording, recording(tmp_path, fields))


def test_check_shows_what_the_file_has_of_the_set(tmp_path, capsys):
    path = recording(tmp_path, 'set = "plug-in-gait"')
    main(["check", str(path), "--json", str(tmp_path / "check.json")])
    assert "set      plug-in-gait: 8 of 24 markers; missing" in capsys.readouterr().out
    figures = json.loads((tmp_path / "check.json").read_text())["marker_set"]
    assert figures["name"] == "plug-in-gait" and "LELB" in figures["missing"]


def serve_by_three_lines(recordings, folder):
    serve = (recordings / "motions" / "tennis_serve.c3d").as_posix()
    text = f'[markers]\nfile = "{serve}"\nset = "plug-in-gait"\n[subject]\nheight = 1.7\n'
    (folder / "r.toml").write_text(text)
    return load_recording(folder / "r.toml")


def test_three_lines_place_the_markers_of_a_recorded_serve(recordings, tmp_path):
    serve = serve_by_three_lines(recordings, tmp_path)
    assert len(serve.places) == 30 and serve.marker_set and not serve.marker_set.missing
    assert np.isfinite(serve.positions_world).mean() > 0.95


@pytest.mark.slow
def test_every_marker_of_a_recorded_serve_is_met_without_a_joint_turned_round(recordings, tmp_path):
    motion = track(serve_by_three_lines(recordings, tmp_path))
    report, angles = motion.report, np.degrees(motion.poses.angles)
    assert np.abs(np.diff(angles, axis=0)).max() < 60
    low, high = np.degrees(motion.skeleton.limits).T
    assert np.maximum(low - angles, angles - high).max() < 20
    assert report is not None
    assert np.nanmean(report.marker_errors, 0).max() < 0.03
    assert np.nanpercentile(report.marker_errors, 95, axis=0).max() < 0.06
