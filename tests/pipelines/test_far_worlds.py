"""Worlds whose origin is far away: results as good as near it, in the world's own coordinates."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_recording import CAMERA, small_recording, write_small_recording

from jaxmocap.body.motion import Motion
from jaxmocap.capture.checks.markers import check_markers
from jaxmocap.cli.program import main
from jaxmocap.formats.cameras.calibration import write_camera
from jaxmocap.formats.convert import convert_file
from jaxmocap.formats.motion_npz import load_motion
from jaxmocap.formats.recordings.recording import Recording
from jaxmocap.formats.time_series.markers import read_markers
from jaxmocap.formats.time_series.mot import motion_from_angles, read_mot
from jaxmocap.formats.time_series.trc import write_trc
from jaxmocap.geometry.origin import local_origin
from jaxmocap.hybrid.settings import Settings
from jaxmocap.hybrid.tracker import HybridTracker
from jaxmocap.pipelines.tracking.track import track
from jaxmocap.pipelines.writing import write_motion

# Some place in Germany by its geodetic coordinates, and as high as it lies.
PLACE = np.array([566_214.0, 5_934_087.0, 0.0])


def far_recording(folder: Path) -> Path:
    """The small recording, with markers and camera in coordinates of that place."""
    path = write_small_recording(folder)
    small = small_recording()
    moved = np.moveaxis(small.positions_world + PLACE, 1, 0)
    write_trc(
        folder / "markers.trc", small.times, dict(zip(small.marker_names, moved, strict=True))
    )
    R, t = (np.asarray(CAMERA.T_cam_world, float)[:3, part] for part in (slice(3), 3))
    # As what computes in double precision writes it.
    u, _, vt = np.linalg.svd(R)
    write_camera(
        folder / "calibration.toml", "cam", {"rotation": u @ vt, "translation": t - u @ vt @ PLACE}
    )
    return path


@pytest.fixture(scope="module")
def far(tmp_path_factory) -> Recording:
    return Recording.load(far_recording(tmp_path_factory.mktemp("far")))


@pytest.fixture(scope="module")
def both(far) -> tuple[Motion, Motion]:
    """The motion tracked there, and that of the same markers near the origin."""
    small, settings = small_recording(), Settings(refine="none")
    tracker = HybridTracker.from_recording(small, settings)
    return tuple(track(replace(each, videos=()), tracker=tracker) for each in (far, small))


@pytest.mark.parametrize(
    ("point", "origin"),
    [
        ((0.0, 2.0, 1.0), (0, 0, 0)),
        ((99.0, -99.0, 1.0), (0, 0, 0)),
        ((-3000.6, 2.0, 1.0), (-3001, 0, 0)),
        ((np.nan, 2.0, 1.0), (0, 0, 0)),
    ],
)
def test_an_origin_is_whole_metres_and_only_where_points_are_far(point, origin):
    points = np.full((5, 3, 3), np.nan)
    points[:, 1] = point
    assert local_origin(points).tolist() == list(origin)
    assert local_origin(np.zeros((0, 3))).tolist() == [0, 0, 0]


def test_a_recording_far_away_is_the_same_seen_from_a_local_origin(far):
    small = small_recording()
    np.testing.assert_array_equal(far.origin_world, PLACE)
    np.testing.assert_allclose(far.positions_world, small.positions_world, atol=2e-6)
    T_far, T_near = far.videos[0].camera.T_cam_world, CAMERA.T_cam_world
    np.testing.assert_allclose(T_far, T_near, atol=2e-6)
    (warning,) = far.warnings
    assert "the world's origin is 5961 km away" in warning
    assert "(566214, 5934087, 0) m" in warning


def test_joints_are_in_the_world_and_as_good_as_near_its_origin(both):
    motion, near = both
    np.testing.assert_array_equal(motion.origin_world, PLACE)
    for name, points in near.joints().items():
        actual = motion.joints()[name]
        assert actual.dtype == np.float64
        np.testing.assert_allclose(actual - PLACE, points, atol=1e-4)
    assert np.nanmax(motion.report.marker_errors) < np.nanmax(near.report.marker_errors) + 1e-4


def test_every_file_is_in_the_world_and_reads_back(both, tmp_path):
    motion = both[0]
    write_motion(motion, tmp_path)
    joints = motion.joints()
    written = read_markers(tmp_path / "joints.trc")
    wrists = written.positions[:, written.names.index("wrist_l")]
    np.testing.assert_allclose(wrists, joints["wrist_l"], atol=1e-6)
    times, columns = read_mot(tmp_path / "angles.mot")
    np.testing.assert_allclose(columns["pelvis_ty"], motion.positions_world[:, 1], atol=1e-6)
    with np.load(tmp_path / "motion.npz") as arrays:
        np.testing.assert_allclose(arrays["pose.position"], motion.positions_world, atol=1e-6)
    for again in (
        load_motion(tmp_path / "motion.npz"),
        motion_from_angles("angles.mot", times, columns, motion.skeleton),
    ):
        np.testing.assert_allclose(again.joints()["wrist_l"], joints["wrist_l"], atol=1e-5)
    for name in ("motion.bvh", "motion.glb"):
        convert_file(tmp_path / name, tmp_path / f"{name}.npz")
        again = load_motion(tmp_path / f"{name}.npz")
        np.testing.assert_allclose(again.joints()["wrist_l"], joints["wrist_l"], atol=1e-3)


def test_the_command_says_where_it_tracks_from(tmp_path, capsys):
    assert main(["check", str(far_recording(tmp_path))]) == 0
    printed = capsys.readouterr().out
    assert "tracked from (566214, 5934087, 0) m" in printed and "error" not in printed


def test_a_recording_made_in_memory_far_away_is_a_warning():
    small = small_recording()
    positions = small.positions_world + np.array([1e6, 0, 0])
    away = replace(small, positions_world=positions, videos=())
    (finding,) = check_markers(away)
    assert not finding.fatal
    assert "the markers are 1000 km from the origin" in finding.sentence
    assert "keeps 62 mm" in finding.sentence


@pytest.mark.parametrize("count", [2900, 3300, 6400])
def test_the_origin_is_found_where_the_first_marker_is_missing(count):
    points = np.random.default_rng(0).normal(PLACE, 1.0, (count, 5, 3))
    points[:, 0] = np.nan
    assert np.abs(local_origin(points) - PLACE).max() < 1
