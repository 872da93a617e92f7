"""Intrinsics from photographs of a board: what is found, what is left out, what is refused."""

import json
import tomllib
from dataclasses import replace

import cv2
import numpy as np
import pytest
from conftest import read_calibration
from drawn_boards import (
    BOARD,
    CHARUCO,
    FISHEYE_LENS,
    LENS,
    SIZE,
    WALL,
    draw,
    held,
    pixels_of,
    views,
    write_views,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxmocap.calibration.board.boards import Board
from jaxmocap.calibration.board.corners import find_corners
from jaxmocap.calibration.board.opencv_lenses import LensKind, candidate_poses, project_points
from jaxmocap.calibration.calibrate import calibrate_camera
from jaxmocap.calibration.extrinsics import board_to_world
from jaxmocap.calibration.intrinsics import (
    BoardView,
    estimate_intrinsics,
    image_coverage,
    intrinsics_warnings,
)
from jaxmocap.cli.program import main
from jaxmocap.formats.cameras.calibration import Intrinsics, read_intrinsics
from jaxmocap.geometry.lenses import FISHEYE

PARAMETERS = LensKind().parameters
BOARD_OPTIONS = ["--board", "4x7", "--square", "0.06", "--camera", "cam"]
TRUTH = np.array([620.0, 615, 335, 228, -0.12, 0.05, 0.001, -0.0005, 0])
OTHER = """# measured on Monday
[other]   # the other camera
size = [ 640.0, 480.0]
matrix = [
  [600.0, 0.0, 320.0],
  [0.0, 600.0, 240.0],
  [0.0, 0.0, 1.0]
]
serial = "12-A"

[cam]
name = "cam"
fisheye = false
owner = 'me'   # unknown to us
date = 2024-05-01
rotation = [0.1, 0.2, 0.3]

# says how it was made
[metadata]
adjusted = false
error = 0.0
"""


@pytest.fixture(scope="module")
def photographs(tmp_path_factory):
    """Seven photographs of the chessboard; their paths."""
    return write_views(tmp_path_factory.mktemp("photographs"))


def calibrate_in(folder, photographs, *more: str) -> dict:
    """Figures of the command, which writes all that it can into a folder."""
    written = ["--out", str(folder / "c.toml"), "--pictures", str(folder / "drawn")]
    figures = folder / "figures.json"
    given = [*photographs, *BOARD_OPTIONS, *more, *written, "--json", str(figures)]
    assert main(["calibrate", "intrinsics", *given]) == 0
    return json.loads(figures.read_text())


@pytest.fixture(scope="module")
def calibrated(photographs, tmp_path_factory):
    """Folder in which the command has written all that it can, and its figures."""
    folder = tmp_path_factory.mktemp("calibrated")
    (folder / "c.toml").write_text(OTHER)
    return folder, calibrate_in(folder, photographs)


def noisy_views(noise: float = 0.1, seed: int = 0, fisheye: bool = False) -> list[BoardView]:
    points, lens = BOARD.points_board, FISHEYE_LENS if fisheye else LENS
    return [
        BoardView(f"view {i}", points, pixels_of(points, T, noise, seed + i, lens))
        for i, T in enumerate(views(fisheye=fisheye))
    ]


# What is found -----------------------------------------------------------------------------------


def test_known_intrinsics_are_recovered_within_their_deviations(calibrated):
    _, figures = calibrated
    actual = figures["parameters"]
    values = np.array([actual[name]["value"] for name in PARAMETERS])
    doubt = np.array([max(actual[n]["std"], actual[n]["jackknife_std"]) for n in PARAMETERS])
    assert np.abs(values[:2] / TRUTH[:2] - 1).max() < 0.002
    assert np.abs(values[2:4] - TRUTH[2:4]).max() < 2.0
    # Four standard deviations; k3 is not asked for and has none.
    assert (np.abs(values - TRUTH)[:8] < 4 * doubt[:8]).all()
    assert values[8] == 0 and figures["rms_px"] < 0.1 and figures["used"] == 7


def test_every_picture_is_told_with_its_error_and_the_tilt_it_was_held_at(calibrated):
    _, figures = calibrated
    truth = [np.degrees(np.arccos(-T[2, 2])) for T in views()]
    actual = [picture["tilt_deg"] for picture in figures["pictures"]]
    np.testing.assert_allclose(actual, truth, atol=0.5)
    assert all(picture["rms_px"] < 0.1 for picture in figures["pictures"])


def test_every_picture_is_drawn_with_what_was_found(calibrated, photographs):
    folder, figures = calibrated
    drawn = sorted((folder / "drawn").glob("*.jpg"))
    assert len(drawn) == len(photographs) + 1 and drawn[-1].name == "coverage.jpg"
    assert set(map(str, drawn)) < set(figures["files"])
    for path, photograph in zip(drawn, photographs, strict=False):
        picture, plain = cv2.imread(str(path)), cv2.imread(photograph)
        assert picture.shape == plain.shape
        # Corners, axes and words: some, and not the whole picture.
        assert 0.005 < (np.abs(picture.astype(int) - plain).max(-1) > 60).mean() < 0.2


def test_only_the_cameras_own_entries_change(calibrated):
    folder, _ = calibrated
    text = (folder / "c.toml").read_text()
    before, after = tomllib.loads(OTHER), tomllib.loads(text)
    changed = {"name", "size", "matrix", "distortions", "fisheye"}
    assert after["cam"].keys() == before["cam"].keys() | changed
    for key in changed | {"name"}:
        before["cam"].pop(key, None)
        after["cam"].pop(key)
    assert after == before
    for comment in ("# measured on Monday", "# the other camera", "# unknown to us", "# says how"):
        assert comment in text


def test_what_was_found_with_other_intrinsics_is_said_to_be_old(calibrated):
    _, figures = calibrated
    assert any("rotation and translation were kept" in message for message in figures["warnings"])


def test_a_calibration_that_differs_from_the_files_by_more_than_chance_is_said_to(
    photographs, tmp_path, capsys
):
    out = tmp_path / "c.toml"
    entries = LENS.entries() | {"matrix": np.array([[620.0, 0, 305], [0, 615, 228], [0, 0, 1]])}
    lines = [f"{key} = {np.asarray(value).tolist()}".lower() for key, value in entries.items()]
    out.write_text("\n".join(["[cam]", *lines]))
    assert main(["calibrate", "intrinsics", *photographs, *BOARD_OPTIONS, "--out", str(out)]) == 0
    message = capsys.readouterr().out
    assert "differs from the calibration that the file held, cx by +2" in message
    assert "fx by" not in message and "systematically" in message
    assert main(["calibrate", "intrinsics", *photographs, *BOARD_OPTIONS, "--out", str(out)]) == 0
    assert "differs from" not in capsys.readouterr().out


@pytest.mark.parametrize("board", [BOARD, Board(7, 4, 0.05), Board(4, 5, 0.07)], ids=str)
@pytest.mark.parametrize("turn", [0, 90, 180, 270])
def test_the_origin_is_found_however_the_board_is_turned(board, turn):
    T_cam_board = held(board, 20, -15, turn)
    corners = find_corners(draw(board, T_cam_board), board)
    assert corners is not None and not corners.orders
    np.testing.assert_allclose(
        corners.pixels_xy, pixels_of(board.points_board, T_cam_board), atol=0.3
    )


def test_a_board_that_looks_the_same_turned_is_told_in_every_reading():
    for board, count in ((Board(5, 7, 0.05), 2), (Board(5, 5, 0.06), 4)):
        T_cam_board = held(board, 20, -15, 100)
        corners = find_corners(draw(board, T_cam_board), board)
        assert corners is not None and len(corners.orders) + 1 == count
        truth = pixels_of(board.points_board, T_cam_board)
        errors = [np.abs(o - truth).max() for o in (corners.pixels_xy, *corners.orders)]
        assert sorted(errors)[0] < 0.3 and sorted(errors)[1] > 50


def test_a_charuco_board_calibrates_though_parts_of_it_are_hidden(tmp_path):
    paths = write_views(tmp_path, CHARUCO)
    for path, T_cam_board in zip(paths[:3], views(CHARUCO), strict=False):
        image = cv2.imread(path)
        image[int(pixels_of(CHARUCO.points_board, T_cam_board)[:, 1].mean()) + 20 :] = WALL
        cv2.imwrite(path, image)
    out = tmp_path / "c.toml"
    actual = calibrate_camera(paths, CHARUCO, "cam", out)
    assert (
        min(len(view.pixels_xy) for view in actual.detections.views) < 28
        and len(actual.detections.views) == 7
    )
    np.testing.assert_allclose(actual.estimate.values[:2], TRUTH[:2], rtol=0.004)
    np.testing.assert_allclose(read_intrinsics(out, "cam").matrix, actual.estimate.lens.matrix)


def test_of_a_video_sharp_frames_that_differ_are_chosen(tmp_path):
    path = str(tmp_path / "board.avi")
    writer = cv2.VideoWriter(path, cv2.VideoWriter_fourcc(*"MJPG"), 30, SIZE)
    for i, T in enumerate(views()):
        sharp = draw(BOARD, T, seed=i)
        # Blurred while it moves, then held still for two frames, then gone.
        for frame in (cv2.blur(sharp, (7, 7)), sharp, sharp, np.full_like(sharp, int(WALL))):
            writer.write(frame)
    writer.release()
    actual = calibrate_camera([path], BOARD, "cam", tmp_path / "c.toml")
    numbers = [int(view.name.split()[-1]) for view in actual.detections.views]
    assert sorted(n // 4 for n in numbers) == list(range(7))
    assert all(n % 4 in (1, 2) for n in numbers)
    np.testing.assert_allclose(actual.estimate.values[:2], TRUTH[:2], rtol=0.005)
    assert "board found in 21 of 28 frames examined, 7 blurred, 7 chosen" in actual.warnings[0]


def test_distortion_that_turns_back_within_the_image_is_said():
    actual = estimate_intrinsics(noisy_views(), SIZE)
    coverage = image_coverage(noisy_views(), SIZE)
    assert not any("turns back" in message for message in intrinsics_warnings(actual, coverage))
    folded = Intrinsics(LENS.size, LENS.matrix, np.array([-0.9, 0.0, 0.0, 0.0]))
    assert any(
        "turns back" in message
        for message in intrinsics_warnings(replace(actual, lens=folded), coverage)
    )


def test_files_of_one_name_from_two_folders_are_told_apart(photographs, tmp_path):
    (tmp_path / "other").mkdir()
    image = cv2.imread(photographs[6])
    cv2.imwrite(str(tmp_path / "other" / "view_1.png"), image)
    paths = [*photographs[:4], tmp_path / "other" / "view_1.png"]
    actual = calibrate_camera(paths, BOARD, "cam", tmp_path / "c.toml", pictures=tmp_path / "d")
    names = [view.name for view in actual.detections.views]
    assert names[0] == photographs[0] and names[-1].endswith("other/view_1.png")
    assert len(set(names)) == 5 and len(list((tmp_path / "d").glob("*.jpg"))) == 6


def test_coverage_names_the_parts_of_the_image_where_no_board_was():
    left = [
        BoardView(
            "a",
            BOARD.points_board,
            pixels_of(BOARD.points_board, held(BOARD, 0, 0, 0, (-0.35, 0.0, 1.2)), 0.1),
        )
    ]
    coverage = image_coverage(left, SIZE)
    assert coverage.empty and all("left" not in name for name in coverage.empty if "right" in name)
    assert {"top right", "middle right", "bottom right"} <= set(coverage.empty)
    width, height = np.ptp(left[0].pixels_xy, axis=0) / SIZE
    assert coverage.share == pytest.approx(width * height, rel=0.1)


# What is left out --------------------------------------------------------------------------------


@settings(max_examples=8)
@given(st.integers(0, 6), st.integers(0, 27), st.floats(0, 6.2), st.floats(8, 200))
def test_one_wrong_corner_leaves_its_view_out_and_nothing_else(view, corner, direction, pixels):
    given = noisy_views()
    wrong = given[view].pixels_xy.copy()
    wrong[corner] += pixels * np.array([np.cos(direction), np.sin(direction)])
    given[view] = BoardView("wrong", BOARD.points_board, wrong)
    actual = estimate_intrinsics(given, SIZE)
    assert [i for i, used in enumerate(actual.used) if not used] == [view]
    np.testing.assert_allclose(actual.values[:2], TRUTH[:2], rtol=0.01)


def test_a_view_of_nonsense_spoils_nothing():
    given = noisy_views()
    nonsense = np.random.default_rng(1).uniform(0, 400, (28, 2))
    clean = estimate_intrinsics(given, SIZE)
    actual = estimate_intrinsics(
        [*given, BoardView("nonsense", BOARD.points_board, nonsense)], SIZE
    )
    assert actual.used == (*clean.used, False)
    # OpenCV sums in parallel, in no fixed order, and stops a little elsewhere each time: a
    # thousandth of a value's accuracy is far more than that and far less than the spoilt one.
    assert (np.abs(actual.values - clean.values) <= 1e-3 * clean.std).all()


def test_a_false_detection_is_named_with_its_error(photographs, tmp_path, capsys):
    y, x = np.indices(SIZE[::-1], np.float32)
    # A board that is bent like a wave: its corners are found, and are no plane's.
    bent = cv2.remap(cv2.imread(photographs[0]), x + 8 * np.sin(y / 40), y, cv2.INTER_LINEAR)
    cv2.imwrite(str(tmp_path / "bent.png"), bent)
    given = [*photographs, str(tmp_path / "bent.png"), *BOARD_OPTIONS]
    assert main(["calibrate", "intrinsics", *given, "--out", str(tmp_path / "c.toml")]) == 0
    message = capsys.readouterr().out
    line = next(line for line in message.splitlines() if line.startswith("  bent.png"))
    assert "LEFT OUT: its corners do not fit" in line and "7 of 8 pictures used" in message
    matrix = read_intrinsics(tmp_path / "c.toml", "cam").matrix
    np.testing.assert_allclose([matrix[0, 0], matrix[1, 1]], TRUTH[:2], rtol=0.003)


def test_the_jackknife_sees_what_views_have_in_common():
    exact = estimate_intrinsics(noisy_views(0.0), SIZE)
    noisy = estimate_intrinsics(noisy_views(0.2), SIZE)
    assert exact.jackknife_std[:4].max() < 0.05 < noisy.jackknife_std[:4].min()
    assert (noisy.jackknife_std[:4] / noisy.std[:4] > 0.2).all()
    assert noisy.leave_one_out.shape == (7, 9)


# What is refused ---------------------------------------------------------------------------------


@pytest.fixture
def uncalibrated(refusal, tmp_path):
    """What such pictures and options are refused with; nothing is written."""

    def refused(*given: str, out: str = "c.toml") -> str:
        before = {path: path.read_bytes() for path in tmp_path.glob(out)}
        message = refusal("calibrate", "intrinsics", *given, "--out", tmp_path / out)
        assert {path: path.read_bytes() for path in tmp_path.glob(out)} == before
        return message

    return refused


@pytest.fixture
def wall(tmp_path) -> str:
    """A photograph without a board."""
    cv2.imwrite(str(tmp_path / "wall.png"), np.full((480, 640, 3), 120, np.uint8))
    return str(tmp_path / "wall.png")


@pytest.mark.parametrize(
    ("shown", "board", "says"),
    [
        ((0, 1, 2, "wall"), "4x7",
         "in 3 different pictures of 4; no board in wall.png; expected 5 or more"),
        ((0, 1, 2, 3, 0, 1), "4x7",
         "4 different pictures of 6; the same as an earlier one: view_1.png, view_2.png"),
        ((0, 1), "5x8", "view_1.png shows a 4x7 board: inner corners are counted"),
    ],
)  # fmt: skip
def test_too_few_boards_are_refused_with_the_files_that_show_none_or_no_other(
    photographs, wall, uncalibrated, shown, board, says
):
    paths = [wall if each == "wall" else photographs[each] for each in shown]
    assert says in uncalibrated(*paths, "--board", board, *BOARD_OPTIONS[2:])


def test_what_is_refused_is_drawn_too(photographs, wall, tmp_path, uncalibrated):
    drawn = tmp_path / "drawn"
    given = [*photographs[:2], wall, *BOARD_OPTIONS, "--pictures", str(drawn)]
    uncalibrated(*given)
    assert [p.name for p in sorted(drawn.glob("*.jpg"))] == [
        "01_view_1.jpg",
        "02_view_2.jpg",
        "03_wall.jpg",
    ]


def test_counts_of_a_charuco_board_that_are_exchanged_get_a_hint(tmp_path, uncalibrated):
    paths = write_views(tmp_path, CHARUCO)[:2]
    exchanged = ["--board", "7x4", *BOARD_OPTIONS[2:], "--charuco", "5X5_100,0.045"]
    message = uncalibrated(*paths, *exchanged)
    assert "shows a 4x7 board: the first number runs along the markers' upper edges" in message


def test_a_video_without_a_board_is_refused_with_what_was_looked_at(tmp_path, uncalibrated):
    path = str(tmp_path / "empty.avi")
    writer = cv2.VideoWriter(path, cv2.VideoWriter_fourcc(*"MJPG"), 30, SIZE)
    for _ in range(4):
        writer.write(np.full((*SIZE[::-1], 3), int(WALL), np.uint8))
    writer.release()
    message = uncalibrated(path, *BOARD_OPTIONS)
    assert "0 different pictures of 0; empty.avi: board found in 0 of 4 frames examined" in message


def test_boards_that_are_all_parallel_are_refused(tmp_path, uncalibrated):
    paths = []
    for i, at in enumerate(
        [(-0.2, 0, 0.9), (0.2, 0, 0.9), (0, -0.05, 0.8), (0, 0, 1), (0.1, 0, 1)]
    ):
        paths.append(str(tmp_path / f"{i}.png"))
        cv2.imwrite(paths[-1], draw(BOARD, held(BOARD, 20, 0, 0, at), seed=i))
    message = uncalibrated(*paths, *BOARD_OPTIONS)
    assert "the views are too alike: they leave the focal length open by" in message


def test_pictures_of_another_size_are_refused_by_name(photographs, tmp_path, uncalibrated):
    cv2.imwrite(str(tmp_path / "small.png"), np.zeros((240, 320, 3), np.uint8))
    given = [*photographs, str(tmp_path / "small.png"), *BOARD_OPTIONS]
    message = uncalibrated(*given)
    assert "differ in size" in message and "view_1.png 640 × 480, small.png 320 × 240" in message


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("notes.jpg", b"no picture", "notes.jpg: is neither an image nor a video"),
        ("empty.png", b"", "empty.png: is neither an image nor a video"),
        ("missing.png", None, "missing.png: no such file"),
        (".", None, "is a folder, expected images or a video"),
    ],
)
def test_what_is_no_picture_is_refused(tmp_path, uncalibrated, name, content, says):
    if content is not None:
        (tmp_path / name).write_bytes(content)
    assert says in uncalibrated(str(tmp_path / name), *BOARD_OPTIONS)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--board", "4x7", "--square", "60", "--camera", "cam"], "expected metres (60 mm is 0.06"),
        (["--board", "2x7", "--square", "0.06", "--camera", "cam"], "at least 3 x 3 inner corners"),
        ([*BOARD_OPTIONS[:-1], "metadata"], "'metadata' as a camera's name"),
        ([*BOARD_OPTIONS, "--charuco", "5X5_100,0.07"], "expected less than its square (0.06 m)"),
        ([*BOARD_OPTIONS, "--charuco", "9X9,0.04"], "unknown, expected 4X4_100, "),
        ([*BOARD_OPTIONS, "--charuco", "5X5_100"], "'5X5_100', expected a dictionary and metres"),
    ],
)
def test_senseless_boards_and_names_are_refused(wall, uncalibrated, options, says):
    assert says in uncalibrated(wall, *options)


@pytest.mark.parametrize(
    ("out", "text", "says"),
    [
        ("c.yml", None, "c.yml: cannot be written to, expected a .toml file"),
        ("c.toml", "[cam\n", "c.toml: not TOML"),
        ("c.toml", "cam = 3\n", "[cam]: found 3, expected a table"),
        ("c.toml", "[subject]\nheight = 1.75\n", "c.toml: is there and is no calibration"),
    ],
)
def test_files_that_cannot_take_the_camera_are_refused(
    wall, tmp_path, uncalibrated, out, text, says
):
    if text is not None:
        (tmp_path / out).write_text(text)
    assert says in uncalibrated(wall, *BOARD_OPTIONS, out=out)


@pytest.mark.parametrize("value", ["4", "4x", "x7", "axb", "4x7x2", f"4x{'9' * 5000}"])
def test_a_board_that_is_no_pair_of_counts_is_refused_by_the_parser(value, refusal):
    given = ["calibrate", "intrinsics", "a.jpg", "--board", value, *BOARD_OPTIONS[2:]]
    assert "expected inner corners such as 4x7" in refusal(*given)


# Real photographs --------------------------------------------------------------------------------


@pytest.mark.parametrize(("camera", "found_in"), [(1, 7), (2, 6)])
def test_real_photographs_agree_with_the_optical_systems_calibration(
    recordings, tmp_path, camera, found_in
):
    paths = sorted((recordings / "calibration").glob(f"cam0{camera}_*.jpg"))
    out = tmp_path / "c.toml"
    given = recordings / "balancing" / "calibration.toml"
    out.write_bytes(given.read_bytes())
    actual = calibrate_camera(paths, BOARD, f"cam_0{camera}", out)
    result = actual.estimate
    assert sum(result.used) >= 6 and len(actual.detections.views) == found_in and result.rms < 0.2
    truth = read_intrinsics(given, f"cam_0{camera}").matrix
    focal = np.array([truth[0, 0], truth[1, 1]])
    np.testing.assert_allclose(result.values[:2], focal, rtol=0.01)
    assert (result.max_std[:2] < 5).all() and (result.max_std[2:4] < 5).all()
    # The principal points do differ, by far more than either deviation: systematically.
    centre = np.array([truth[0, 2], truth[1, 2]])
    assert 20 < np.linalg.norm(result.values[2:4] - centre) < 45
    message = " ".join(actual.warnings)
    assert "cx by +2" in message and "differ systematically" in message
    assert "determine the principal point poorly" in message
    assert tomllib.loads(out.read_text())["cam_03"] == tomllib.loads(given.read_text())["cam_03"]


# A fisheye ----------------------------------------------------------------------------------------


FISHEYE_TRUTH = np.array([310.0, 308, 325, 236, *FISHEYE_LENS.distortions])
FISHEYE_KIND = LensKind(4, fisheye=True)


@pytest.fixture(scope="module")
def fisheye(tmp_path_factory):
    """The same of a fisheye."""
    folder = tmp_path_factory.mktemp("fisheye")
    return folder, calibrate_in(folder, write_views(folder, fisheye=True), "--fisheye")


def test_a_fisheye_is_recovered_within_its_deviations(fisheye):
    folder, figures = fisheye
    actual = figures["parameters"]
    assert list(actual) == ["fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4"]
    values = np.array([figure["value"] for figure in actual.values()])
    deviations = [max(each["std"], each["jackknife_std"]) for each in actual.values()]
    assert np.abs(values[:4] - FISHEYE_TRUTH[:4]).max() < 1.5
    assert (np.abs(values - FISHEYE_TRUTH) < 4 * np.array(deviations)).all()
    assert figures["used"] == 9 and figures["rms_px"] < 0.25
    lens = read_intrinsics(folder / "c.toml", "cam")
    assert lens.fisheye and len(lens.distortions) == 4


def test_a_fisheyes_deviations_are_what_repeated_calibrations_scatter_by():
    actual = [
        estimate_intrinsics(noisy_views(0.1, 100 * seed, True), SIZE, FISHEYE_KIND)
        for seed in range(6)
    ]
    scatter = np.std([each.values for each in actual], axis=0, ddof=1)
    stated = np.mean([each.std for each in actual], axis=0)
    assert (scatter / stated > 0.3).all() and (scatter / stated < 2.5).all()


def test_fewer_coefficients_leave_the_others_at_zero():
    actual = estimate_intrinsics(noisy_views(0.05, fisheye=True), SIZE, LensKind(2, fisheye=True))
    assert (actual.values[6:] == 0).all() and (actual.std[6:] == 0).all()
    assert (actual.std[:6] > 0).all()


def test_the_camera_is_placed_through_its_fisheye(fisheye, tmp_path):
    folder, _ = fisheye
    T_cam_board = views(fisheye=True)[4]
    pose = (0.4, -0.2, 0.0, 0.0, 0.0, 90.0)
    T_cam_world = T_cam_board @ np.linalg.inv(board_to_world(pose))
    cv2.imwrite(str(tmp_path / "floor.png"), draw(BOARD, T_cam_board, fisheye=True))
    out = tmp_path / "c.toml"
    out.write_text((folder / "c.toml").read_text())
    given = [str(tmp_path / "floor.png"), *BOARD_OPTIONS, "--out", str(out)]
    pictures = ["--pictures", str(tmp_path / "drawn")]
    at = ",".join(map(str, pose))
    assert main(["calibrate", "extrinsics", *given, "--pose", at, *pictures]) == 0
    camera = read_calibration(out)["cam"]
    assert camera.lens == FISHEYE
    expected = -T_cam_world[:3, :3].T @ T_cam_world[:3, 3]
    assert np.linalg.norm(np.asarray(camera.position_world) - expected) < 0.01


def test_a_poses_jacobian_is_the_derivative_of_its_pixels():
    (view, *_), (T, *_) = noisy_views(0.0, fisheye=True), views(fisheye=True)
    rvec = cv2.Rodrigues(T[:3, :3])[0].ravel()
    at = np.concatenate([rvec, T[:3, 3]])
    _, J = project_points(view.points_board, at[:3], at[3:], FISHEYE_LENS)
    for i, step in enumerate(1e-6 * np.eye(6)):
        ahead, behind = (
            project_points(view.points_board, pose[:3], pose[3:], FISHEYE_LENS)[0]
            for pose in (at + step, at - step)
        )
        np.testing.assert_allclose(J[:, i], (ahead - behind).ravel() / 2e-6, rtol=1e-4, atol=1e-3)


def test_both_poses_of_a_board_before_a_fisheye_explain_its_picture():
    for view, T in zip(noisy_views(0.0, fisheye=True), views(fisheye=True), strict=True):
        best, *_ = candidate_poses(view.points_board, view.pixels_xy, FISHEYE_LENS)
        np.testing.assert_allclose(best.matrix, T, atol=1e-5)


def test_a_fisheye_has_no_fifth_coefficient(tmp_path, refusal):
    given = ["calibrate", "intrinsics", "board.jpg", *BOARD_OPTIONS, "--fisheye"]
    message = refusal(*given, "--distortions", 5, "--out", tmp_path / "c.toml")
    assert "found 5, expected at most 4 of a fisheye" in message
