"""Where a camera stands: by a board or by listed points, and when that is ambiguous."""

import json
import tomllib

import cv2
import drawn_boards
import numpy as np
import pytest
from conftest import read_calibration
from drawn_boards import BOARD, CHARUCO, LENS, SIZE, draw
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from jaxmocap.calibration.board.boards import Board
from jaxmocap.calibration.extrinsics import board_to_world, estimate_placement, position_world_of
from jaxmocap.cli.program import main
from jaxmocap.formats.cameras.calibration import read_intrinsics, write_camera

CAMERA = ["--camera", "cam"]
CHESS = ["--board", "4x7", "--square", "0.06"]
# The board on the floor, its y along the world's -x.
POSE = (0.4, -0.2, 0.0, 0.0, 0.0, 90.0)


def looking(at_world, from_world) -> np.ndarray:
    """T_cam_world of a camera at a place, upright, that looks at another."""
    z = np.subtract(at_world, from_world)
    z = z / np.linalg.norm(z)
    x = np.cross(z, [0, 0, 1.0])
    x = x / np.linalg.norm(x)
    R = np.stack([x, np.cross(z, x), z])
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, -R @ from_world
    return T


T_CAM_WORLD = looking((0.22, -0.1, 0.0), (0.9, -0.5, 0.8))


def pixels_of(points_world, T_cam_world=T_CAM_WORLD, noise: float = 0.0) -> np.ndarray:
    return drawn_boards.pixels_of(points_world, T_cam_world, noise)


def corners_world(pose=POSE, board: Board = BOARD) -> np.ndarray:
    T = board_to_world(pose)
    return board.points_board @ T[:3, :3].T + T[:3, 3]


@pytest.fixture
def folder(tmp_path):
    """Intrinsics of a camera that has not been placed, and a photograph of the board."""
    write_camera(tmp_path / "c.toml", "cam", LENS.entries())
    image = draw(BOARD, T_CAM_WORLD @ board_to_world(POSE))
    cv2.imwrite(str(tmp_path / "floor.png"), image)
    return tmp_path


def command(folder, *given: str, image: str = "floor.png") -> list[str]:
    out = [*CAMERA, "--out", str(folder / "c.toml")]
    return ["calibrate", "extrinsics", str(folder / image), *given, *out]


def run(folder, *given: str, image: str = "floor.png") -> int:
    return main(command(folder, *given, image=image))


@pytest.fixture
def unplaced(folder, refusal):
    """What a photograph with such options is refused with; nothing is written."""

    def refused(*given: str, image: str = "floor.png") -> str:
        before = (folder / "c.toml").read_bytes()
        message = refusal(*command(folder, *given, image=image))
        assert (folder / "c.toml").read_bytes() == before
        return message

    return refused


def check_place(folder, place_world=(0.9, -0.5, 0.8), atol=0.004):
    """The camera of the file, which stands there."""
    camera = read_calibration(folder / "c.toml")["cam"]
    np.testing.assert_allclose(camera.position_world, place_world, atol=atol)
    return camera


def numbers(pose) -> str:
    return ",".join(map(repr, map(float, pose)))


def points_file(folder, points_world, pixels_xy, header="x,y,z,u,v") -> str:
    rows = np.concatenate([points_world, pixels_xy], axis=1)
    lines = [header, *(",".join(f"{value:.6f}" for value in row) for row in rows)]
    (folder / "points.csv").write_text("\n".join(lines) + "\n")
    return str(folder / "points.csv")


# By a board --------------------------------------------------------------------------------------


def test_a_board_at_a_measured_place_places_the_camera(folder, capsys):
    figures, drawn = folder / "figures.json", folder / "drawn"
    options = ["--pose", numbers(POSE), "--pictures", str(drawn), "--json", str(figures)]
    assert run(folder, *CHESS, *options) == 0
    camera = check_place(folder)
    np.testing.assert_allclose(camera.T_cam_world[:3, :3], T_CAM_WORLD[:3, :3], atol=0.005)
    np.testing.assert_allclose(camera.matrix, LENS.matrix, rtol=1e-6)
    actual = json.loads(figures.read_text())
    assert actual["rms_px"] < 0.2 and len(actual["points"]) == 28 and actual["warnings"] == []
    error = np.subtract(actual["position_m"], [0.9, -0.5, 0.8])
    assert (np.abs(error) < 5 * np.array(actual["position_std_m"])).all()
    assert "stands at (0.9" in capsys.readouterr().out
    picture = cv2.imread(str(drawn / "floor_placed.jpg"))
    plain = cv2.imread(str(folder / "floor.png"))
    assert 0.005 < (np.abs(picture.astype(int) - plain).max(-1) > 60).mean() < 0.2


def test_a_charuco_board_places_the_camera_though_half_is_hidden(folder):
    image = draw(CHARUCO, T_CAM_WORLD @ board_to_world(POSE))
    hidden = int(pixels_of(corners_world())[:, 0].mean())
    image[:, hidden + 20 :] = 120
    cv2.imwrite(str(folder / "floor.png"), image)
    charuco = ["--charuco", "DICT_5X5_100,0.045"]
    assert run(folder, *CHESS, *charuco, "--pose", numbers(POSE)) == 0
    check_place(folder, atol=0.015)


def test_what_was_measured_with_y_up_is_turned_to_z_up(folder):
    # The same board given in a system of y up: world = (z, x, y) of the file.
    from_world = np.eye(3)[[1, 2, 0]]
    T = board_to_world(POSE)
    angles = Rotation.from_matrix(from_world @ T[:3, :3]).as_euler("xyz", degrees=True)
    pose = numbers([*(from_world @ T[:3, 3]), *angles])
    assert run(folder, *CHESS, "--pose", pose, "--up", "y") == 0
    check_place(folder)


@given(*[st.floats(-180, 180)] * 3)
def test_the_pose_turns_about_the_worlds_x_then_y_then_z(rx, ry, rz):
    x, y, z = np.radians([rx, ry, rz])
    Rx = [[1, 0, 0], [0, np.cos(x), -np.sin(x)], [0, np.sin(x), np.cos(x)]]
    Ry = [[np.cos(y), 0, np.sin(y)], [0, 1, 0], [-np.sin(y), 0, np.cos(y)]]
    Rz = [[np.cos(z), -np.sin(z), 0], [np.sin(z), np.cos(z), 0], [0, 0, 1]]
    T = board_to_world((1, 2, 3, rx, ry, rz))
    np.testing.assert_allclose(T[:3, :3], np.array(Rz) @ Ry @ Rx, atol=1e-12)
    np.testing.assert_array_equal(T[:3, 3], [1, 2, 3])


def test_a_pose_may_begin_with_a_minus(folder):
    moved = (-0.6, *POSE[1:])
    assert run(folder, *CHESS, "--pose", numbers(moved)) == 0
    check_place(folder, [-0.1, -0.5, 0.8])


def test_intrinsics_may_come_from_opencvs_yaml(folder):
    file = cv2.FileStorage(str(folder / "lens.yml"), cv2.FILE_STORAGE_WRITE)
    for name, value in (("image_width", SIZE[0]), ("image_height", SIZE[1])):
        file.write(name, value)
    file.write("camera_matrix", LENS.matrix)
    file.write("distortion_coefficients", LENS.distortions.reshape(1, -1))
    file.release()
    (folder / "c.toml").unlink()
    options = ["--pose", numbers(POSE), "--intrinsics", str(folder / "lens.yml")]
    assert run(folder, *CHESS, *options) == 0
    check_place(folder)
    np.testing.assert_allclose(read_intrinsics(folder / "c.toml", "cam").matrix, LENS.matrix)


def test_only_rotation_and_translation_change(folder):
    text = (folder / "c.toml").read_text()
    (folder / "c.toml").write_text(text + "owner = 'me'\n\n[metadata]\nerror = 0.0\n")
    before = tomllib.loads((folder / "c.toml").read_text())
    assert run(folder, *CHESS, "--pose", numbers(POSE)) == 0
    after = tomllib.loads((folder / "c.toml").read_text())
    assert after["cam"].pop("rotation") and after["cam"].pop("translation")
    assert after == before


# When it cannot be, or could be another ----------------------------------------------------------


def test_a_board_told_print_down_puts_the_camera_below_the_floor(folder, unplaced, capsys):
    flipped = ["--pose", numbers((*POSE[:3], 180.0, 0.0, 90.0))]
    says = "rotated by 180° about its own x axis the camera would stand at (0.90, -0.50, 0.80) m"
    assert says in unplaced(*CHESS, *flipped)
    assert run(folder, *CHESS, *flipped, "--upside-down") == 0
    assert "the camera comes out below the floor, at z = -0.80 m" in capsys.readouterr().out


WALL = (0.0, 1.0, 1.2, 90.0, 0.0, 0.0)
WALL_UPSIDE_DOWN = (*WALL[:3], -90.0, 0.0, 180.0)


@pytest.fixture
def wall(folder):
    """The same, and a photograph of the board on a wall, by a camera that stands upright."""
    T_cam_world = looking((0.1, 1.0, 1.4), (0.3, 0.1, 1.6))
    cv2.imwrite(str(folder / "wall.png"), draw(BOARD, T_cam_world @ board_to_world(WALL)))
    return folder


def test_a_camera_that_comes_out_upside_down_is_refused(wall, unplaced, capsys):
    message = unplaced(*CHESS, "--pose", numbers(WALL_UPSIDE_DOWN), image="wall.png")
    assert "wall.png: the camera comes out upside down" in message and "--upside-down" in message
    says = "rotated by 180° about its own z axis the camera would stand at (0.30, 0.10, 1.60)"
    assert says in message
    assert run(wall, *CHESS, "--pose", numbers(WALL), image="wall.png") == 0
    assert "note:" not in capsys.readouterr().out


def test_a_camera_that_hangs_upside_down_is_written_where_the_user_says_so(wall, unplaced, capsys):
    upside_down = cv2.rotate(cv2.imread(str(wall / "wall.png")), cv2.ROTATE_180)
    cv2.imwrite(str(wall / "hanging.png"), upside_down)
    pose = ["--pose", numbers(WALL), "--origin", "500,500"]
    unplaced(*CHESS, *pose, image="hanging.png")
    assert run(wall, *CHESS, *pose, "--upside-down", image="hanging.png") == 0
    assert "note:" not in capsys.readouterr().out
    # The picture was turned about its centre, not about the lens's.
    camera = check_place(wall, [0.3, 0.1, 1.6], atol=0.05)
    assert float(camera.T_cam_world[1, 2]) > 0.9
    turned = ["--pose", numbers(WALL), "--upside-down"]
    assert "comes out upright" in unplaced(*CHESS, *turned, image="wall.png")


@pytest.mark.parametrize("roll", [90.0, -90.0])
def test_a_camera_on_its_side_is_neither(folder, roll):
    """As a telephone that stands upright."""
    turn = np.eye(4)
    turn[:2, :2] = Rotation.from_euler("z", roll, degrees=True).as_matrix()[:2, :2]
    points = corners_world()
    points_file(folder, points, pixels_of(points, turn @ T_CAM_WORLD))
    assert run(folder, "--points", str(folder / "points.csv")) == 0


def test_of_two_mirrored_answers_the_one_above_the_floor_is_taken_and_said():
    # Small, far off, upright on the floor, seen from above: mirrored it is seen from below.
    points = 0.3 * corners_world((0, 0, 0.0, 90, 0, 0))
    T = looking((0, 0, 0), (0.3, -3.0, 1.2))
    rises = 0
    for seed in range(6):
        noise = np.random.default_rng(seed).normal(0, 0.3, (28, 2))
        actual = estimate_placement(points, pixels_of(points, T) + noise, LENS)
        assert actual.mirrored is not None
        below = position_world_of(actual.mirrored)[2]
        if below < 0:
            rises += 1
            assert actual.position_world[2] > 0
            assert "two cameras explain the picture alike" in actual.warnings[0]
            assert "taken is the one that is above the floor" in actual.warnings[0]
    assert rises >= 3


def test_a_mirrored_answer_that_nothing_rules_out_is_said_to_be_one():
    # At a wall, seen from the right: mirrored it is seen from the left.
    points = 0.3 * corners_world((0, 0, 0.0, 90, 0, 0)) + (0, 0, 1)
    T = looking((0, 0, 1), (1.2, -3.0, 1.0))
    actual = estimate_placement(points, pixels_of(points, T, noise=0.2), LENS)
    assert actual.mirrored is not None
    np.testing.assert_allclose(position_world_of(actual.mirrored), [-1.2, -3, 1], atol=0.3)
    assert actual.mirrored_ratio < 2 and "which may be wrong" in actual.warnings[0]
    assert "bring it nearer" in actual.warnings[0]


def test_a_camera_that_is_only_roughly_placed_is_said_to_be():
    points = 0.25 * corners_world((0, 0, 1.0, 0, 0, 0))
    T = looking((0, 0, 1), (0.05, 0.3, 4.0))
    actual = estimate_placement(points, pixels_of(points, T, noise=0.2), LENS)
    assert actual.std_m.max() > 0.2 and "only roughly estimated" in " ".join(actual.warnings)


def test_a_board_seen_well_leaves_no_doubt():
    actual = estimate_placement(corners_world(), pixels_of(corners_world(), noise=0.2), LENS)
    assert actual.mirrored_ratio > 4 and actual.warnings == ()
    error = actual.position_world - position_world_of(T_CAM_WORLD)
    assert (np.abs(error) < 4 * actual.std_m).all() and actual.std_m.max() < 0.01


def test_deviations_are_as_large_as_errors_are():
    errors, claimed = [], []
    for seed in range(40):
        noise = np.random.default_rng(seed).normal(0, 0.5, (28, 2))
        actual = estimate_placement(corners_world(), pixels_of(corners_world()) + noise, LENS)
        errors.append(actual.position_world - position_world_of(T_CAM_WORLD))
        claimed.append(actual.std_m)
    ratio = np.std(errors, axis=0) / np.mean(claimed, axis=0)
    assert (ratio > 0.7).all() and (ratio < 1.4).all()


def test_a_board_that_looks_the_same_turned_needs_to_be_told_its_origin(folder, unplaced):
    board = Board(5, 7, 0.05)
    cv2.imwrite(str(folder / "floor.png"), draw(board, T_CAM_WORLD @ board_to_world(POSE)))
    given = ["--board", "5x7", "--square", "0.05", "--pose", numbers(POSE)]
    message = unplaced(*given)
    origin = pixels_of([POSE[:3]])[0]
    here = f"--origin {origin[0]:.0f},{origin[1]:.0f}"
    assert "looks the same when it is rotated" in message and here in message
    assert run(folder, *given, *here.split()) == 0
    check_place(folder)


# By points ---------------------------------------------------------------------------------------

SPREAD = np.array(
    [[0, 0, 0], [0.6, 0, 0], [0.5, -0.4, 0.1], [0, -0.4, 0.2], [0.3, -0.1, 0.3], [0.1, 0.1, 0.1]]
)
SPREAD = np.vstack([SPREAD, [[0.4, 0.1, 0.05], [0.2, -0.3, 0.0]]])


def test_listed_points_place_the_camera(folder):
    points = points_file(folder, SPREAD, pixels_of(SPREAD, noise=0.3))
    assert run(folder, "--points", points) == 0
    check_place(folder, atol=0.01)


def test_four_points_on_the_floor_are_enough(folder):
    corners = np.array([[0, 0, 0], [0.5, 0, 0], [0.5, -0.4, 0], [0, -0.4, 0.0]])
    assert run(folder, "--points", points_file(folder, corners, pixels_of(corners))) == 0
    check_place(folder, atol=0.001)


def test_a_point_at_the_wrong_pixel_is_left_out_and_named(folder, capsys):
    pixels = pixels_of(SPREAD, noise=0.3)
    pixels[4] += (60, -25)
    points = points_file(folder, SPREAD, pixels)
    assert run(folder, "--points", points) == 0
    message = capsys.readouterr().out
    assert "line 6 was left out: 6" in message and "over 7 of 8 points" in message
    check_place(folder, atol=0.015)


def test_points_may_have_names(folder, capsys):
    rows = np.concatenate([SPREAD, pixels_of(SPREAD)], axis=1)
    rows[3, 3] += 90
    lines = [f"tip {i}," + ",".join(f"{v:.6f}" for v in row) for i, row in enumerate(rows)]
    (folder / "points.csv").write_text("\n".join(["name,x,y,z,u,v", *lines]))
    assert run(folder, "--points", str(folder / "points.csv")) == 0
    assert "tip 3 was left out" in capsys.readouterr().out


# What is refused ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("points", "says"),
    [
        (SPREAD[:3], "found 3 points, expected at least 4"),
        (SPREAD[:5], "5 points that are not on a plane, expected at least 6"),
        (np.linspace([0, 0, 0], [0.5, -0.2, 0.1], 6), "all points lie on one line"),
        (np.zeros((6, 3)), "all points lie on one line"),
    ],
)
def test_points_that_do_not_determine_a_camera_are_refused(folder, unplaced, points, says):
    file = points_file(folder, points, pixels_of(points))
    message = unplaced("--points", file)
    assert "points.csv: " in message and says in message


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("a,b\n1,2\n", "line 1: found 'a,b', expected 'x,y,z,u,v'"),
        ("x,y,z,u,v\n1,2,3,4\n", "line 2: found 4 columns, expected 5"),
        ("x,y,z,u,v\n1,2,3,4,\n", "line 2: a number is missing"),
        ("x,y,z,u,v\n1,2,3,4,five\n", "line 2: found 'five', expected a number"),
    ],
)
def test_bad_files_of_points_are_refused_with_the_line(folder, unplaced, text, says):
    (folder / "points.csv").write_text(text)
    assert says in unplaced("--points", str(folder / "points.csv"))


def test_a_photograph_without_the_board_is_refused(unplaced):
    squares = ["--board", "5x8", "--square", "0.06", "--pose", numbers(POSE)]
    message = unplaced(*squares)
    assert "found no 5x8 board; floor.png shows a 4x7 board" in message


def test_a_photograph_of_another_resolution_is_refused(folder, unplaced):
    image = cv2.imread(str(folder / "floor.png"))
    cv2.imwrite(str(folder / "floor.png"), cv2.resize(image, (1280, 960)))
    message = unplaced(*CHESS, "--pose", numbers(POSE))
    assert "is 1280 × 960, its calibration 640 × 480 pixels" in message


def test_a_photograph_a_little_narrower_is_taken_as_cropped_and_said(folder, capsys):
    image = cv2.imread(str(folder / "floor.png"))
    cv2.imwrite(str(folder / "floor.png"), image[:, :-6])
    assert run(folder, *CHESS, "--pose", numbers(POSE)) == 0
    assert "taken as cropped on the right" in capsys.readouterr().out


def test_a_pose_needs_its_board_and_a_camera_its_intrinsics(folder, unplaced, refusal):
    assert "expected --board and --square too" in unplaced("--pose", numbers(POSE))
    found = unplaced(*CHESS, "--points", str(folder / "points.csv"))
    assert "--points: takes no board, found --board, --square" in found
    (folder / "c.toml").write_text("[other]\nsize = [640, 480]\n")
    message = unplaced(*CHESS, "--pose", numbers(POSE))
    assert "section [cam] is missing, found other" in message
    (folder / "c.toml").write_text("[cam]\nfisheye = 'yes'\n")
    message = unplaced(*CHESS, "--pose", numbers(POSE))
    assert "[cam]: 'size' is missing" in message
    (folder / "c.toml").unlink()
    message = refusal(*command(folder, *CHESS, "--pose", numbers(POSE)))
    assert "c.toml: no such file, expected the intrinsics of cam there" in message


@pytest.mark.parametrize("pose", ["1,2,3", "1,2,3,4,5,x", "1,2,3,4,5,nan", ""])
def test_a_pose_that_is_no_six_numbers_is_refused_by_the_parser(unplaced, pose):
    assert "expected 6 numbers" in unplaced(*CHESS, "--pose", pose)
