"""Calibrations of other systems become ours: the same points fall on the same pixels."""

import pickle
import re
import tomllib
from functools import partial

import cv2
import numpy as np
import pytest
from calibrations_of_others import (
    LENS,
    MATRIX,
    R_Y_UP,
    SIZE,
    WRITERS,
    Place,
    anipose,
    by_opencv,
    easymocap,
    freemocap,
    motive,
    opencap,
    opencap_table,
    place,
    points_before,
    qualisys,
    vicon,
)
from conftest import complaint, read_calibration
from scipy.spatial.transform import Rotation

from jaxmocap.cli.program import main, make_parser
from jaxmocap.formats.calibrations.registry import R_WORLD_OF_SOURCE_UP, convert_calibration

refused = partial(complaint, convert_calibration)

CAMERAS = {f"cam_{i}": place(i) for i in range(1, 4)}
# Pixels; of a Vicon lens the fit's own residual comes on top.
CLOSE, CLOSE_BY_FIT = 1e-3, 0.05
# The first camera of Pose2Sim's demonstration, `Demo_SinglePerson/calibration/Calib.qca.txt`:
# Copyright (c) 2022 perfanalytics (D. Pagnon), BSD 3-Clause License, provided "as is" without
# warranty of any kind.
PUBLISHED = """<?xml version='1.0' encoding='ASCII'?>
<calibration source="calibration_qca_rotated.qca.txt" type="regular">
  <cameras>
    <camera active="1" avg-residual="0.402000" model="none" serial="cam_01" viewrotation="0">
      <fov_video bottom="1919" left="0" right="1087" top="0"/>
      <transform r11="0.5536380477336265" r12="0.8046719867383512" r13="0.2144479094331626"
        r21="-0.4345300743838753" r22="0.05946489349975602" r23="0.8986921279821063"
        r31="0.7104002579937896" r32="-0.5907342212870501" r33="0.3825762057979294"
        x="1460.2323709212087" y="-1909.1590482454608" z="1896.5058524092062"/>
      <intrinsic centerPointU="34110.316406" centerPointV="60680.792969"
        focalLengthU="107599.671875" focalLengthV="107588.828125" focallength="9.314096596679686"
        radialDistortion1="-0.046183" radialDistortion2="0.139983" radialDistortion3="0.000000"
        sensorMaxU="69568" sensorMaxV="122816" sensorMinU="0.000000" sensorMinV="0.000000"
        skew="0.000000" tangentalDistortion1="0.000608" tangentalDistortion2="0.00069"/>
    </camera>
  </cameras>
</calibration>
"""


def pixels(section: dict, points: np.ndarray) -> np.ndarray:
    """Where a section's camera has points, by OpenCV and from the file alone."""
    matrix, lens = np.array(section["matrix"]), np.array(section["distortions"])
    vector, t = np.array(section["rotation"]), np.array(section["translation"])
    return cv2.projectPoints(points, vector, t, matrix, lens)[0].reshape(-1, 2)


def farthest(path, project, cameras=CAMERAS) -> float:
    """Pixels between the file's projections and the system's own, over all cameras."""
    sections = tomllib.loads(path.read_text())
    assert list(sections) == list(cameras)
    return max(
        np.abs(pixels(sections[name], points) - project(camera, points)).max()
        for name, camera in cameras.items()
        for points in [points_before(camera, 7)]
    )


@pytest.mark.parametrize("writer", WRITERS, ids=lambda writer: writer.__name__)
def test_points_fall_on_the_same_pixels_as_in_the_other_system(tmp_path, writer):
    source, project = writer(tmp_path, CAMERAS)
    size = SIZE if writer is easymocap else None
    target = tmp_path / "ours.toml"
    convert_calibration(source, target, size=size)
    assert farthest(target, project) < (CLOSE_BY_FIT if writer is vicon else CLOSE)
    cameras = read_calibration(target)
    assert list(cameras) == list(CAMERAS)
    for name, camera in cameras.items():
        assert camera.size.tolist() == list(SIZE)
        np.testing.assert_allclose(camera.position_world, CAMERAS[name].position, atol=1e-5)


def test_a_fit_of_a_vicon_lens_states_what_it_leaves(tmp_path):
    source, project = vicon(tmp_path, CAMERAS)
    notes = convert_calibration(source, tmp_path / "ours.toml")
    (note,) = [note for note in notes if note.startswith("lenses")]
    stated = float(note.split("within ")[1].split()[0])
    assert farthest(tmp_path / "ours.toml", project) <= stated < CLOSE_BY_FIT
    assert "left out: 1 cameras that take no video" in notes


def test_the_older_radial_terms_of_vicon_are_about_the_principal_point(tmp_path):
    source, _ = vicon(tmp_path, {"cam_1": CAMERAS["cam_1"]})
    text = source.read_text()
    start = text.index("VICON_RADIAL2=")
    end = text.index("WORLD_ERROR")
    source.write_text(text[:start] + 'VICON_RADIAL="4e-08 0" ' + text[end:])
    convert_calibration(source, tmp_path / "ours.toml")
    section = tomllib.loads((tmp_path / "ours.toml").read_text())["cam_1"]
    corner = np.array([0.0, 0.0])
    matrix, lens = np.array(section["matrix"]), np.array(section["distortions"])
    ideal = cv2.undistortPoints(corner[None], matrix, lens, P=matrix).ravel()
    offset = corner - matrix[:2, 2]
    np.testing.assert_allclose(ideal, matrix[:2, 2] + offset * (1 + 4e-8 * offset @ offset),
                               atol=0.05)  # fmt: skip


@pytest.mark.parametrize("radial", ["-2e-06 0", "nan 0", "1e-08", "1e-06 1e-9"])
def test_a_lens_that_opencv_cannot_describe_is_refused(tmp_path, radial):
    source, _ = vicon(tmp_path, CAMERAS)
    text = source.read_text()
    start, end = text.index("VICON_RADIAL2="), text.index("WORLD_ERROR")
    source.write_text(f'{text[:start]}VICON_RADIAL="{radial}" {text[end:]}')
    target = tmp_path / "ours.toml"
    assert "VICON_RADIAL" in refused(source, target)
    assert not target.exists()


def test_the_published_calibration_is_the_recordings_own(tmp_path, recordings):
    """All but the lens: Pose2Sim divides the coefficients by 64, which pixels are counted in."""
    (tmp_path / "lab.qca.txt").write_text(PUBLISHED)
    convert_calibration(tmp_path / "lab.qca.txt", tmp_path / "ours.toml")
    ours = tomllib.loads((tmp_path / "ours.toml").read_text())["cam_01"]
    theirs = tomllib.loads((recordings / "balancing" / "calibration.toml").read_text())["cam_01"]
    for field in ("size", "matrix", "rotation", "translation"):
        np.testing.assert_allclose(ours[field], theirs[field], rtol=0, atol=1e-12)
    np.testing.assert_allclose(ours["distortions"], np.multiply(theirs["distortions"], 64))


def test_photographs_by_such_a_camera_show_its_coefficients_undivided(recordings):
    """OpenCV's own k1, k2 from the chessboard, held to -0.046, 0.14 and to a 64th of them."""
    corners = np.zeros((28, 3), np.float32)
    corners[:, :2] = np.mgrid[0:4, 0:7].T.reshape(-1, 2)
    found = []
    for path in sorted((recordings / "calibration").glob("cam01_*.jpg")):
        picture = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        detected, at = cv2.findChessboardCornersSB(picture, (4, 7))
        if detected:
            found.append(at)
    flags = cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST
    size = (1088, 1920)
    lens = cv2.calibrateCamera([corners] * len(found), found, size, None, None, flags=flags)[2]
    k1, k2 = lens.ravel()[:2]
    assert abs(k1 + 0.046183) < abs(k1 + 0.046183 / 64)
    assert abs(k2 - 0.139983) < abs(k2 - 0.139983 / 64) + 0.02


def test_axes_and_unit_are_as_the_user_states(tmp_path):
    """A calibration in millimetres, Y up, whose file says neither."""
    turned = {name: camera.in_world(R_Y_UP, 1000) for name, camera in CAMERAS.items()}
    source, project = anipose(tmp_path, turned)
    target = tmp_path / "ours.toml"
    assert "--unit" in refused(source, target)
    convert_calibration(source, target, unit="mm", up="y")
    # The cameras stand where they stood.
    assert farthest(target, project) < CLOSE


def test_an_axis_that_leaves_no_picture_upright_brings_a_warning(tmp_path):
    """A camera that looks along the world's y, its picture's downward axis along -z or along y."""
    upright = Place(np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]), np.array([0, 0, 3.0]))
    warned = []
    for camera in (upright, Place(np.eye(3), upright.t)):
        source, _ = anipose(tmp_path, {"cam_1": camera})
        notes = convert_calibration(source, tmp_path / "ours.toml")
        warned.append(any(note.startswith("warning: no camera's picture") for note in notes))
    assert warned == [False, True]


def test_one_camera_in_opencvs_yaml_becomes_a_section(tmp_path):
    camera, path = place(2), tmp_path / "left.yml"
    file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    file.write("image_width", SIZE[0])
    file.write("image_height", SIZE[1])
    file.write("camera_matrix", MATRIX)
    file.write("distortion_coefficients", LENS[None])
    file.write("rvec", cv2.Rodrigues(camera.R)[0])
    file.write("tvec", camera.t[:, None])
    file.release()
    convert_calibration(path, tmp_path / "ours.toml")
    assert farthest(tmp_path / "ours.toml", by_opencv, {"left": camera}) < CLOSE


def test_every_axis_that_can_be_stated_becomes_the_worlds_z():
    (action,) = [each for each in make_parser()._subparsers._group_actions[0].choices[
        "convert"]._actions if each.dest == "source_up"]  # fmt: skip
    assert set(action.choices) == set(R_WORLD_OF_SOURCE_UP)
    for name, R in R_WORLD_OF_SOURCE_UP.items():
        up = np.eye(3)["xyz".index(name[-1])] * (-1 if name.startswith("minus") else 1)
        np.testing.assert_allclose(R @ up, [0, 0, 1])
        np.testing.assert_allclose(R @ R.T, np.eye(3))
        assert np.linalg.det(R) > 0


def test_what_a_system_leaves_open_is_said(tmp_path):
    """A camera that is not calibrated, a picture that was rotated, a square of no entered size."""
    source, _ = qualisys(tmp_path, CAMERAS)
    text = source.read_text().replace('calibrated="true"', 'calibrated="false"', 1)
    source.write_text(text.replace('viewrotation="0"', 'viewrotation="90"'))
    notes = convert_calibration(source, tmp_path / "ours.toml")
    assert list(read_calibration(tmp_path / "ours.toml")) == ["cam_2", "cam_3"]
    assert "left out: not calibrated: cam_1" in notes
    assert any(note.startswith("viewrotation: cam_2, cam_3: ") for note in notes)
    source, _ = freemocap(tmp_path, CAMERAS)
    source.write_text(source.read_text().replace("size = 58.0", "size = 1"))
    notes = convert_calibration(source, tmp_path / "ours.toml")
    assert any("charuco_square_size is 1" in note for note in notes)


def test_freemocap_without_a_ground_plane_takes_the_first_camera_as_level(tmp_path):
    level = Place(np.eye(3), np.zeros(3))
    source, _ = freemocap(tmp_path, {"cam_0": level}, on_ground=False)
    notes = convert_calibration(source, tmp_path / "ours.toml")
    assert any("stands level" in note for note in notes)
    camera = read_calibration(tmp_path / "ours.toml")["cam_0"]
    # Its picture's downward axis is the world's.
    np.testing.assert_allclose(np.asarray(camera.T_cam_world)[1, :3], [0, 0, -1], atol=1e-6)


def test_an_opencap_board_that_is_upside_down_points_up(tmp_path):
    session, _ = opencap(tmp_path, {"Cam0": place(0)})
    path = session / "Videos" / "Cam0" / "cameraIntrinsicsExtrinsics.pickle"
    table = opencap_table(place(0))
    for R, up in ((np.eye(3), "-y up"), (Rotation.from_rotvec([0, 0, np.pi]).as_matrix(), "y up")):
        path.write_bytes(pickle.dumps(table | {"rotation": R}))
        notes = convert_calibration(session, tmp_path / "ours.toml")
        assert notes[0].endswith(f"mm, {up}")
        camera = read_calibration(tmp_path / "ours.toml")["Cam0"]
        np.testing.assert_allclose(np.asarray(camera.T_cam_world)[1, :3], [0, 0, -1], atol=1e-6)


def test_one_pickle_alone_is_named_after_its_folder(tmp_path):
    session, _ = opencap(tmp_path, {"Cam7": place(0)})
    path = session / "Videos" / "Cam7" / "cameraIntrinsicsExtrinsics.pickle"
    convert_calibration(path, tmp_path / "ours.toml")
    assert list(read_calibration(tmp_path / "ours.toml")) == ["Cam7"]


def test_a_pickle_by_an_older_numpy_is_read(tmp_path):
    content = pickle.dumps(opencap_table(place(1)), protocol=2)
    assert b"numpy._core.multiarray" in content
    path = tmp_path / "cam00.pickle"
    path.write_bytes(content.replace(b"numpy._core.multiarray", b"numpy.core.multiarray"))
    convert_calibration(path, tmp_path / "ours.toml")
    camera = read_calibration(tmp_path / "ours.toml")["cam00"]
    np.testing.assert_allclose(camera.position_world, place(1).position, atol=1e-5)


def test_pictures_size_is_asked_for_once_and_only_where_it_is_missing(tmp_path):
    without, _ = easymocap(tmp_path, CAMERAS)
    target = tmp_path / "ours.toml"
    assert "--size" in refused(without, target)
    assert "--size does not apply" in refused(motive(tmp_path, CAMERAS)[0], target, size=SIZE)
    assert "--unit does not apply" in refused(qualisys(tmp_path, CAMERAS)[0], target, unit="m")
    text = (tmp_path / "intri.yml").read_text()
    sides = "".join(f"H_{name}: 1080\nW_{name}: 1920\n" for name in CAMERAS)
    (tmp_path / "intri.yml").write_text(text + sides)
    convert_calibration(tmp_path / "extri.yml", target)
    assert read_calibration(target)["cam_1"].size.tolist() == list(SIZE)


def test_a_folder_of_easymocap_needs_both_files(tmp_path):
    easymocap(tmp_path, CAMERAS)
    convert_calibration(tmp_path, tmp_path / "ours.toml", size=SIZE)
    (tmp_path / "extri.yml").unlink()
    assert "extri.yml: no such file" in refused(tmp_path, tmp_path / "ours.toml", size=SIZE)


def test_the_file_of_easymocap_that_is_named_is_read(tmp_path):
    easymocap(tmp_path, CAMERAS)
    text, target = (tmp_path / "intri.yml").read_text(), tmp_path / "ours.toml"
    convert_calibration(tmp_path / "intri.yml", target, size=SIZE)
    focal = float(read_calibration(target)["cam_1"].matrix[0, 0])
    changed = re.sub(r"(K_cam_1:.*?data: *\[ *)[^,]+,", r"\g<1>1234.,", text, flags=re.DOTALL)
    (tmp_path / "intri_new.yml").write_text(changed)
    convert_calibration(tmp_path / "intri_new.yml", target, size=SIZE)
    assert float(read_calibration(target)["cam_1"].matrix[0, 0]) == 1234 != focal


def test_the_command_says_what_it_read_and_wrote(tmp_path, capsys, refusal):
    source, _ = qualisys(tmp_path, CAMERAS)
    target = tmp_path / "ours.toml"
    assert main(["convert", str(source), str(target)]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "read     Qualisys (.qca.txt): mm, z up",
        "cameras  cam_1, cam_2, cam_3",
        f"written  {target}",
    ]
    for asked, says in (
        ([source, tmp_path / "ours.csv"], "a calibration is made into .toml"),
        ([source, target, "--rate", "60"], "--rate does not apply to a calibration"),
        ([tmp_path / "none.xcp", target], "no such file"),
    ):
        assert says in refusal("convert", *asked)
