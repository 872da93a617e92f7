"""``silhouette model``: photographs become files; bad ones are one sentence and exit code 2."""

import json
import shutil

import cv2
import numpy as np
import pytest
import trimesh
from conftest import read_calibration

from bench.modelling import MeasuredPerson
from jaxmocap.body.subject import rest_joints
from jaxmocap.body.surfaces.surface import rest_nodes
from jaxmocap.capture.photographs import png_of
from jaxmocap.cli.program import main
from jaxmocap.formats.cameras.calibration import write_calibration
from jaxmocap.formats.files.errors import InputError
from jaxmocap.pipelines.silhouettes.person import read_person
from jaxmocap.synthetic.photographs import PHOTOGRAPHS, person_in_stance


def read(path):
    image = cv2.imread(str(path))
    assert image is not None
    return image


def asked(shots, out, **instead):
    """The command's arguments, with other files in some photographs' place."""
    files = {name: shots / f"{name}.png" for name in PHOTOGRAPHS}
    files |= {"calibration": shots / "calibration.toml"} | instead
    options = [str(part) for name, file in files.items() for part in (_option(name), file)]
    return ["silhouette", "model", *options, "--out", str(out)]


def _option(name):
    return "--" + name.replace("_", "-")


@pytest.fixture(scope="module")
def made(shots, tmp_path_factory):
    out = tmp_path_factory.mktemp("made") / "model"
    # The arms' photographs were the front's camera: their sections may be missing.
    cameras = read_calibration(shots / "calibration.toml")
    two = shots / "two.toml"
    write_calibration(two, {name: cameras[name] for name in ("front", "side")})
    assert main([*asked(shots, out, calibration=two), "--json", str(out / "figures.json")]) == 0
    return out


def test_the_folder_holds_model_report_and_a_picture_of_every_step(made):
    for name in (*PHOTOGRAPHS, "model"):
        picture = read(made / f"{name}.png")
        assert picture.std() > 10
    report = json.loads((made / "report.json").read_text(encoding="utf-8"))
    figures = json.loads((made / "figures.json").read_text(encoding="utf-8"))
    assert str(made / "model.npz") in figures.pop("files") and report == figures
    assert set(report) == {"reading", "lengths_m", "girths_m", "joints_m", "seconds"}
    assert report["reading"] == "own"


def test_the_person_has_their_colours_on(made):
    body = trimesh.load_scene(made / "model.glb").geometry["body"]
    colours = body.visual.to_color().vertex_colors[:, :3].astype(float)
    _, up, ahead = np.asarray(body.vertices).T
    low, high = up.min(), up.max()
    tall = (up - low) / (high - low)
    # A red shirt over blue trousers, from ahead, below the hands.
    shirt = colours[(tall > 0.65) & (tall < 0.75) & (ahead > 0.02)].mean(0)
    trousers = colours[(tall > 0.3) & (tall < 0.42) & (ahead > 0.02)].mean(0)
    assert shirt[0] > 1.8 * shirt[2] and trousers[2] > 1.2 * trousers[0]
    assert read(made / "texture.png").shape[1] > 300
    assert read(made / "person.png").std() > 10


def test_other_commands_find_the_person_in_the_folder(made, tmp_path):
    person = read_person(made)
    assert person.picture == (made / "texture.png").read_bytes()
    report = json.loads((made / "report.json").read_text(encoding="utf-8"))
    radius = float(person.skeleton.lengths[person.skeleton.tree.bone("radius_l")])
    assert abs(radius - report["lengths_m"]["radius_l"]) < 0.02
    nodes = rest_nodes(person.surface, rest_joints(person.skeleton))
    assert 1.4 < np.ptp(nodes[:, 2]) < 1.9
    with pytest.raises(InputError, match=r"found no subject.toml, expected what 'silhouette mod"):
        read_person(tmp_path)
    for name in ("subject.toml", "surface.npz"):
        shutil.copy(made / name, tmp_path)
    assert read_person(tmp_path).picture is None
    for content, problem in (
        (b"no picture", "is not a PNG file"),
        (png_of(np.zeros((5, 6, 3), np.uint8)), r"a texture of 6 x 5 texels, expected \d+ x \d+"),
    ):
        (tmp_path / "texture.png").write_bytes(content)
        with pytest.raises(InputError, match=problem):
            read_person(tmp_path)


def test_the_files_hold_the_person(made, slim_woman):
    report = json.loads((made / "report.json").read_text(encoding="utf-8"))
    body = MeasuredPerson.of(person_in_stance(slim_woman, "front"))
    truth = body.landmarks()
    for side in "lr":
        humerus = np.linalg.norm(truth[f"shoulder_{side}"] - truth[f"elbow_{side}"])
        assert abs(report["lengths_m"][f"humerus_{side}"] - humerus) < 0.02
        girth = report["girths_m"][f"upper_arm_{side}"]["girth"]
        assert abs(girth / body.arm("humerus", side, 0.5).girth - 1) < 0.08
    heights = np.linspace(truth["pelvis"][2] + 0.05, truth["shoulder_l"][2] - 0.12, 30)
    waist = min(body.trunk(height).girth for height in heights)
    assert abs(report["girths_m"]["waist"]["girth"] / waist - 1) < 0.06
    with np.load(made / "model.npz") as data:
        parts = trimesh.Trimesh(data["vertices"], data["faces"], process=False).split()
        assert len(parts) == 3 and all(part.is_watertight for part in parts)
        assert data["joints"].shape == (2, 4, 3)


def test_a_photograph_of_another_size_is_refused(shots, tmp_path, refusal):
    small = tmp_path / "small.png"
    cv2.imwrite(str(small), read(shots / "side.png")[::2, ::2])
    message = refusal(*asked(shots, tmp_path / "out", side=small))
    assert "small.png" in message and "480 × 360" in message and "960 × 720" in message


def test_what_is_no_image_is_refused(shots, tmp_path, refusal):
    message = refusal(*asked(shots, tmp_path / "out", joint=shots / "calibration.toml"))
    assert "calibration.toml: is not an image" in message


def test_a_background_with_a_pattern_is_refused_with_a_picture(shots, tmp_path, refusal):
    image = read(shots / "front.png")
    checks = (np.indices(image.shape[:2]) // 30).sum(0) % 2 == 0
    image[checks] //= 2
    patterned, out = tmp_path / "patterned.png", tmp_path / "out"
    cv2.imwrite(str(patterned), image)
    message = refusal(*asked(shots, out, front=patterned))
    assert "patterned.png: the background is not uniform" in message
    assert read(out / "front_refused.png").shape == image.shape


def test_arms_against_the_body_are_refused(shots, tmp_path, refusal):
    image, hanging = read(shots / "front.png"), tmp_path / "hanging.png"
    # What lies between arms and trunk, painted over.
    between = np.array([[300, 300], [660, 300], [700, 560], [260, 560]])
    cv2.fillConvexPoly(image, between, (60, 60, 190))
    cv2.imwrite(str(hanging), image)
    message = refusal(*asked(shots, tmp_path / "out", front=hanging))
    assert "hanging.png: found no gap between" in message


def test_a_calibration_without_the_side_camera_is_refused(shots, tmp_path, refusal):
    cameras = read_calibration(shots / "calibration.toml")
    write_calibration(tmp_path / "one.toml", {"front": cameras["front"]})
    message = refusal(*asked(shots, tmp_path / "out", calibration=tmp_path / "one.toml"))
    assert "one.toml: section [side] is missing" in message


def test_three_photographs_are_refused(shots, tmp_path, refusal):
    arguments = asked(shots, tmp_path / "out")
    at = arguments.index("--arm-side")
    assert "--arm-side" in refusal(*arguments[:at], *arguments[at + 2 :])
