"""A fisheye calibrated from photographs of a board, placed, and read again."""

import json

import cv2
import numpy as np
import pytest
from conftest import read_calibration
from drawn_boards import BOARD, FISHEYE_LENS, SIZE, draw, views, write_views

from jaxmocap.calibration.board.opencv_lenses import LensKind, candidate_poses, project_points
from jaxmocap.calibration.extrinsics import board_to_world
from jaxmocap.calibration.intrinsics import BoardView, estimate_intrinsics
from jaxmocap.cli.program import main
from jaxmocap.formats.cameras.calibration import read_intrinsics
from jaxmocap.geometry.lenses import FISHEYE

BOARD_OPTIONS = ["--board", "4x7", "--square", "0.06", "--camera", "cam"]
TRUTH = np.array([310.0, 308, 325, 236, *FISHEYE_LENS.distortions])
KIND = LensKind(4, fisheye=True)


def noisy_views(noise: float, seed: int = 0) -> list[BoardView]:
    rng, given = np.random.default_rng(seed), []
    for i, T in enumerate(views(fisheye=True)):
        rvec, _ = cv2.Rodrigues(T[:3, :3])
        pixels, _ = project_points(BOARD.points_board, rvec, T[:3, 3], FISHEYE_LENS)
        noisy = pixels + rng.normal(0, noise, pixels.shape)
        given.append(BoardView(f"view {i}", BOARD.points_board, noisy))
    return given


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory):
    """Folder in which the command has written, and its figures."""
    folder = tmp_path_factory.mktemp("fisheye")
    photographs = write_views(folder, fisheye=True)
    written = ["--out", str(folder / "c.toml"), "--pictures", str(folder / "drawn")]
    figures = ["--json", str(folder / "figures.json")]
    given = ["calibrate", "intrinsics", *photographs, *BOARD_OPTIONS, "--fisheye"]
    assert main([*given, *written, *figures]) == 0
    return folder, json.loads((folder / "figures.json").read_text())


def test_a_fisheye_is_recovered_within_its_deviations(calibrated):
    folder, figures = calibrated
    actual = figures["parameters"]
    assert list(actual) == ["fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4"]
    values = np.array([figure["value"] for figure in actual.values()])
    deviations = [max(each["std"], each["jackknife_std"]) for each in actual.values()]
    assert np.abs(values[:4] - TRUTH[:4]).max() < 1.5
    assert (np.abs(values - TRUTH) < 4 * np.array(deviations)).all()
    assert figures["used"] == 9 and figures["rms_px"] < 0.25
    lens = read_intrinsics(folder / "c.toml", "cam")
    assert lens.fisheye and len(lens.distortions) == 4


def test_the_deviations_are_what_repeated_calibrations_scatter_by():
    actual = [estimate_intrinsics(noisy_views(0.1, seed), SIZE, KIND) for seed in range(6)]
    scatter = np.std([each.values for each in actual], axis=0, ddof=1)
    stated = np.mean([each.std for each in actual], axis=0)
    assert (scatter / stated > 0.3).all() and (scatter / stated < 2.5).all()


def test_fewer_coefficients_leave_the_others_at_zero():
    actual = estimate_intrinsics(noisy_views(0.05), SIZE, LensKind(2, fisheye=True))
    assert (actual.values[6:] == 0).all() and (actual.std[6:] == 0).all()
    assert (actual.std[:6] > 0).all()


def test_the_camera_is_placed_through_its_fisheye(calibrated, tmp_path):
    folder, _ = calibrated
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
    (view, *_), (T, *_) = noisy_views(0.0), views(fisheye=True)
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
    for view, T in zip(noisy_views(0.0), views(fisheye=True), strict=True):
        best, *_ = candidate_poses(view.points_board, view.pixels_xy, FISHEYE_LENS)
        np.testing.assert_allclose(best.matrix, T, atol=1e-5)


def test_a_fisheye_has_no_fifth_coefficient(tmp_path, refusal):
    given = ["calibrate", "intrinsics", "board.jpg", *BOARD_OPTIONS, "--fisheye"]
    message = refusal(*given, "--distortions", 5, "--out", tmp_path / "c.toml")
    assert "found 5, expected at most 4 of a fisheye" in message
