"""A person's body in a file: written, read back, edited, and what each length rests on."""

import json
import tomllib

import numpy as np
import pytest
from conftest import complaint

from jaxmocap import Recording
from jaxmocap.body.skeleton import LANDMARK_PLACES, Skeleton, with_wrists
from jaxmocap.body.subject import bone_vectors, rest_joints
from jaxmocap.calibration.static_trial import measured_bones, scale_subject
from jaxmocap.cli.program import main
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.recordings.recording import write_recording
from jaxmocap.formats.recordings.subject import read_subject, write_subject
from jaxmocap.formats.time_series.trc import write_trc

NUMBERS = ("lengths", "masses", "diameters", "directions")


def standing(skeleton: Skeleton) -> dict[str, np.ndarray]:
    """Landmarks (3,) of a skeleton with all angles 0."""
    joints, reach = rest_joints(skeleton), bone_vectors(skeleton)
    return {
        name: joints[skeleton.tree.bone(bone)] + at * reach[skeleton.tree.bone(bone)]
        for name, (bone, at) in LANDMARK_PLACES.items()
    }


def read_back(path) -> Skeleton:
    return read_subject(path, "", {"file": path.name})


@pytest.mark.parametrize("wrists", [False, True])
def test_a_body_survives_its_file(tmp_path, wrists):
    body = Skeleton.human(1.83, 64.0)
    body = with_wrists(body) if wrists else body
    write_subject(tmp_path / "subject.toml", body, 1.83)
    back = read_back(tmp_path / "subject.toml")
    assert back.tree == body.tree
    for name in NUMBERS:
        np.testing.assert_allclose(getattr(back, name), getattr(body, name), atol=2e-5)


def test_a_recording_takes_a_file_in_which_one_bone_was_edited(tmp_path):
    out = tmp_path / "subject.toml"
    assert main(["scale", "--height", "1.80", "--mass", "75", "--out", str(out)]) == 0
    table = tomllib.loads(out.read_text())
    assert table["height"] == 1.8 and table["mass"] == 75
    length = table["bones"]["humerus_l"]["length"]
    out.write_text(out.read_text().replace(f"length = {length}", "length = 0.4", 1))
    out.write_text(
        out.read_text().replace("humerus_r = { length = 0.2628", "humerus_r = { length = 0.31")
    )
    write_trc(tmp_path / "markers.trc", np.zeros(1), {"Head": np.ones((1, 3))})
    path = write_recording(tmp_path, "markers.trc", {"Head": {"bone": "head"}},
                           subject={"file": "subject.toml"})  # fmt: skip
    body = Recording.load(path).skeleton
    changed = np.abs(np.asarray(body.lengths) - np.asarray(Skeleton.human(1.8, 75).lengths)) > 1e-5
    assert [n for n, c in zip(body.tree.bones, changed, strict=True) if c] == [
        "humerus_l",
        "humerus_r",
    ]


@pytest.mark.parametrize("factor", [0.001, 0.0254, 2.0])
def test_a_static_trial_in_another_unit_is_refused(tmp_path, refusal, factor):
    landmarks = {name: factor * at[None] for name, at in standing(Skeleton.human(1.7)).items()}
    write_trc(tmp_path / "static.trc", np.zeros(1), landmarks)
    asked = "--static", tmp_path / "static.trc", "--out", tmp_path / "subject.toml"
    sentence = f"shows a person {1.7 * factor:.3g} m tall, expected 0.5 to 2.5 m"
    assert sentence in refusal("scale", *asked)
    assert not (tmp_path / "subject.toml").exists()


def test_a_marker_that_is_stated_for_two_landmarks_is_refused(tmp_path, refusal):
    """The right upper arm would be as long as from the right shoulder to the left elbow."""
    write_trc(tmp_path / "static.trc", np.zeros(1),
              {name: at[None] for name, at in standing(Skeleton.human(1.7)).items()})  # fmt: skip
    names = ("neck", "shoulder_l", "shoulder_r", "hip_l", "hip_r", "elbow_l")
    out = ("--static", tmp_path / "static.trc", "--out", tmp_path / "subject.toml")
    stated = [f"{name}={name}" for name in names]
    asked = *out, "--landmarks", *stated
    assert "found marker 'elbow_l', which is elbow_l already" in refusal(
        "scale", *asked, "elbow_r=elbow_l"
    )
    # Nothing is measured by these.
    assert main(["scale", *map(str, asked), "head=neck", "pelvis=hip_l"]) == 0


def test_a_static_trial_says_what_each_length_rests_on(tmp_path, capsys):
    """Arms and trunk are measured, legs follow from the height that those suggest."""
    person = Skeleton.human(1.70)
    rng, frames = np.random.default_rng(0), 50
    landmarks = {name: at for name, at in standing(person).items()
            if not name.startswith(("knee", "ankle", "toe", "head"))}  # fmt: skip
    noisy = {n: at + rng.normal(0, 0.002, (frames, 3)) for n, at in landmarks.items()}
    write_trc(tmp_path / "static.trc", np.arange(frames) / 100, noisy)
    out = tmp_path / "subject.toml"
    given = ["scale", "--static", str(tmp_path / "static.trc"), "--out", str(out), "--json", "-"]
    assert main(given) == 0
    printed = capsys.readouterr()
    figures, body = json.loads(printed.out), read_back(out)
    for bone, length in zip(body.tree.bones, np.asarray(body.lengths), strict=True):
        figure = figures["bones"][bone]
        assert figure["length_m"] == pytest.approx(length, abs=1e-5)
        assert figure["measured"] == (not bone.startswith(("femur", "tibia", "foot"))), bone
        if figure["measured"]:
            assert 0.5e-3 < figure["std_m"] < 5e-3
    i = body.tree.bone("humerus_l")
    assert float(body.lengths[i]) == pytest.approx(float(person.lengths[i]), abs=2e-3)
    assert "femur_l     " in printed.err and "by height" in printed.err
    assert "in the proportions of the first paper" in printed.err


def test_a_body_by_height_and_sex_keeps_both(tmp_path):
    out = tmp_path / "subject.toml"
    assert main(["scale", "--height", "1.70", "--sex", "male", "--out", str(out)]) == 0
    assert tomllib.loads(out.read_text())["sex"] == "male"
    usual = Skeleton.human(1.7, proportions="male")
    np.testing.assert_allclose(read_back(out).lengths, usual.lengths, atol=2e-5)
    # All of them follow: none is taken for a measured one.
    write_trc(tmp_path / "markers.trc", np.zeros(1), {"Head": np.ones((1, 3))})
    subject = {"file": "subject.toml"}
    path = write_recording(tmp_path, "markers.trc", {"Head": {"bone": "head"}}, subject=subject)
    assert measured_bones(path) == ()


@pytest.mark.parametrize(
    ("subject", "message"),
    [
        ({"height": 1.7, "sex": "other"}, "sex: found 'other', expected one of female, male"),
        (
            {"height": 1.7, "sex": "male", "proportions": "winter"},
            "proportions: found beside sex, expected one of them",
        ),
    ],
)
def test_a_sex_that_is_no_table_is_refused(tmp_path, subject, message):
    with pytest.raises(InputError, match=message):
        read_subject(tmp_path / "recording.toml", "[subject]", subject)


def test_check_lists_which_lengths_were_measured(tmp_path, capsys):
    landmarks = {name: np.tile(at, (5, 1)) for name, at in standing(Skeleton.human(1.70)).items()}
    required = ("neck", "shoulder_l", "shoulder_r", "hip_l", "hip_r")
    arms = ("elbow_l", "elbow_r", "wrist_l", "wrist_r")
    expected = {
        required: "measured: spine1, spine2, spine3, clavicle, hip; by the height: neck, head,",
        (*required, *arms): "hip; by the height: neck, head, hand, femur, tibia, foot",
        (*required, *arms[:1]): "humerus_l, hip; by the height: neck, head, radius, hand, femur,",
    }
    write_trc(tmp_path / "static.trc", np.arange(5) / 100, landmarks)
    for stated, line in expected.items():
        subject = {"static": "static.trc", "landmarks": {name: name for name in stated}}
        path = write_recording(
            tmp_path, "static.trc", {"vertex": {"bone": "head"}}, subject=subject
        )
        assert main(["check", str(path), "--json", str(tmp_path / "c.json")]) == 0
        assert line in capsys.readouterr().out
        figures = json.loads((tmp_path / "c.json").read_text())
        assert {"spine1", "hip_l"} <= set(figures["measured_bones"])
    made = ["scale", "--height", "1.45", "--mass", "32.1", "--out", str(tmp_path / "s.toml")]
    assert main(made) == 0
    for subject in ({"height": 1.7}, {"file": "s.toml"}):
        on = {"vertex": {"bone": "head"}}
        path = write_recording(tmp_path, "static.trc", on, subject=subject)
        assert main(["check", str(path)]) == 0
        assert "lengths  all by the height" in capsys.readouterr().out


def test_a_real_static_trial_becomes_a_file(recordings, tmp_path):
    table = tomllib.loads((recordings / "balancing" / "recording_cam_01.toml").read_text())
    subject = table["subject"]
    static = recordings / "balancing" / subject["static"]
    scaled = scale_subject(tmp_path / "a.toml", None, static, subject["landmarks"], subject["up"])
    there = read_subject(recordings / "balancing" / "a.toml", "", subject)
    back = read_back(tmp_path / "a.toml")
    for name in NUMBERS:
        np.testing.assert_allclose(getattr(back, name), getattr(there, name), atol=2e-5)
    assert 1.4 < scaled.height < 2.1


@pytest.mark.parametrize(
    ("bones", "message"),
    [
        ({"wing": {"length": 0.3}}, "bones wing: unknown bone, expected one of spine1"),
        ({"hand_l": {"length": 30}}, "length: found 30, expected metres from 0.01 to 1"),
        ({"hand_l": {"size": 0.1}}, "unknown key 'size', expected length, mass"),
        ({"hand_l": {"diameter": [0.1, 0]}}, "expected metres above 0"),
        ({"hand_l": {"direction": [0, 0, 0]}}, "expected a direction"),
        ({"hand_l": 0.2}, "expected a table"),
    ],
)
def test_what_no_bone_can_be_is_refused_by_field(tmp_path, bones, message):
    table = {"height": 1.8, "bones": bones}
    assert message in complaint(read_subject, tmp_path / "a.toml", "[subject]", table)


def test_the_command_refuses_in_one_sentence(tmp_path, refusal):
    write_trc(tmp_path / "a.trc", np.zeros(1), {"Head": np.ones((1, 3))})
    out = ["--out", str(tmp_path / "b.toml")]
    for given, message in (
        (["--height", "1.8", "--up", "y"], "--landmarks, --up: found without --static"),
        ([], "expected --height, --static or --recording"),
        (["--height", "1.8", "--static", "a.trc"], "a.trc: found --height beside --static"),
        (["--recording", "a.toml", "--up", "y"], "do not go with --recording"),
        (["--static", "a.trc", "--sex", "male"], "a.trc: found --sex beside --static"),
        (["--recording", "a.toml", "--sex", "male"], "a.toml: found --sex without --height"),
        (["--height", "3"], "the person: height = 3.0: expected metres between 0.5 and 2.5"),
        (["--static", str(tmp_path / "none.trc")], "no such file"),
        (["--static", "a.trc", "--landmarks", "neck=A", "neck=B"], "found neck twice"),
        (["--static", str(tmp_path / "a.trc")], "no marker called as a landmark is"),
        (["--static", str(tmp_path / "a.trc"), "--landmarks", "neck=Head"], "needs the landmark"),
    ):
        assert message in refusal("scale", *given, *out)
    assert not (tmp_path / "b.toml").exists()


def test_a_picture_that_no_run_wrote_is_not_replaced_by_that_of_the_lengths(tmp_path, refusal):
    photograph = tmp_path / "anna.png"
    photograph.write_bytes(b"a photograph")
    refused = refusal("scale", "--recording", "a.toml", "--out", str(tmp_path / "anna.toml"))
    assert f"{photograph}: is there and no earlier run wrote it" in refused
    # Nor one that the recording names.
    (tmp_path / "anna.toml").write_text("height = 1.8\n")
    (tmp_path / "a.toml").write_text('[[video]]\nfile = "v.mp4"\nbackground = "anna.png"\n')
    names = "--recording", str(tmp_path / "a.toml"), "--out", str(tmp_path / "anna.toml")
    assert f"{photograph}: would be replaced while it is read" in refusal("scale", *names)
