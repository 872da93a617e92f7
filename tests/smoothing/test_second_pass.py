"""Smoothing of a whole recording: grids of the frames, what is missing, what is found."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import cache

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import on_device
from drawn_arms import SIZE
from drawn_body import Painted, paint, room, with_noise
from painted_motion import (
    CAMERAS,
    ELBOWS,
    MARKERS,
    PERSON,
    disturbed,
    first_pass,
    places_of,
    points_of,
    pose_at,
)  # fmt: skip
from small_recording import PLACES

from jaxmocap.body.model import Model
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import LANDMARKS, landmark_rows
from jaxmocap.capture.timeline import build_timeline
from jaxmocap.capture.video import MemoryVideo
from jaxmocap.evidence.appearance.hulls import draw_hulls
from jaxmocap.evidence.appearance.learned import ROWS, Drawing
from jaxmocap.formats.recordings.recording import MarkerPlace, Recording, VideoSource
from jaxmocap.geometry.cameras import project, turn_camera
from jaxmocap.hybrid.refine import StepReport
from jaxmocap.hybrid.tracker import HybridTracker
from jaxmocap.images.silhouette_grid import Grid
from jaxmocap.pipelines.tracking.motions import steps_as_trajectory
from jaxmocap.pipelines.tracking.track import track, track_both
from jaxmocap.smoothing import batch
from jaxmocap.smoothing.batch import CameraFrames, smooth_recording
from jaxmocap.smoothing.linearise import SmoothedPoses
from jaxmocap.smoothing.problem import SmoothingProblem, Trajectory
from jaxmocap.smoothing.settings import SmoothingSettings
from jaxmocap.smoothing.window.advance import DELAY_FRAMES
from jaxmocap.solvers.status import Status

# Seconds apart: frames, and the marker samples of which every other has a frame.
FRAMES, FRAME_S, SAMPLE_S = 20, 1 / 30, 1 / 60
CAMERA = CAMERAS[0]
TIMES = np.arange(2 * FRAMES) * SAMPLE_S


@cache
def painted() -> list[Painted]:
    """The frames."""
    wall = room(SIZE)
    frames = [paint(CAMERA, PERSON, pose_at(i * FRAME_S), wall) for i in range(FRAMES)]
    images = with_noise([frame.image for frame in frames], 1)
    return [frame._replace(image=image) for frame, image in zip(frames, images, strict=True)]


def images() -> list[np.ndarray | None]:
    return [frame.image for frame in painted()]


@cache
def true_poses() -> Pose:
    """Of all samples."""
    poses = [pose_at(time) for time in TIMES]
    return Pose(*(np.stack(part).astype(np.float32) for part in zip(*poses, strict=True)))


@cache
def markers_world() -> np.ndarray:
    """(E, M, 3) of head and wrists."""
    return np.asarray(places_of(on_device(true_poses())), float)


MODEL, SETTINGS = Model.create(PERSON, MARKERS, CAMERA), SmoothingSettings()


def second_pass(
    frames=None, mode="own", start=None, shown=None, settings=SETTINGS
) -> Trajectory | None:
    """The recording smoothed, from the true poses by default."""
    video = MemoryVideo(np.arange(FRAMES) * FRAME_S, frames or images())
    timeline = build_timeline(TIMES, [video.times], mode)
    start = true_poses() if start is None else start
    show = (lambda share: None) if shown is None else shown.append
    first = first_pass(timeline, markers_world(), true_poses(), start)
    return smooth_recording(MODEL, settings, first, [video], show)


@contextmanager
def unsolved() -> Iterator[list[SmoothingProblem]]:
    """What is to be smoothed, round by round, instead of smoothing it."""
    kept: list[SmoothingProblem] = []

    def keep(problem, start, *_, **__):
        kept.append(problem)
        points = np.zeros((len(problem.times), 3 * len(LANDMARKS)))
        return SmoothedPoses(start, 0.0, Status.CONVERGED, points[:, 0], points)

    def deviations(problem, actual, softness):
        shape = (len(problem.times), len(LANDMARKS))
        return actual._replace(deviations=np.full((*shape, 3), 0.02), from_prior=np.zeros(shape))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(batch, "smooth_poses", keep)
        patch.setattr(batch, "with_deviations", deviations)
        yield kept


@pytest.fixture
def problems():
    with unsolved() as kept:
        yield kept


@cache
def usual() -> list[SmoothingProblem]:
    """All rounds where nothing is missing: measured once, read by many tests."""
    with unsolved() as kept:
        second_pass()
    return kept


def grids(problem: SmoothingProblem) -> list[Grid]:
    """All of its grids."""
    own = problem.views.grids
    return [own.person, own.forearms, own.legs.person]


def on_grid(share: np.ndarray, region, i: int, cells: int) -> np.ndarray:
    """A painted share (h, w) averaged over the cells of the i-th grid."""
    side, scale = 4 * cells, float(region.scale[i]) / 4
    x, y = np.asarray(region.origin[i], float) + scale / 2
    fine = cv2.warpAffine(
        share,
        np.array([[scale, 0, x], [0, scale, y]]),
        (side, side),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
    )
    return cv2.resize(fine, (cells, cells), interpolation=cv2.INTER_AREA)


# The grids ---------------------------------------------------------------------------------------


def test_the_grids_show_the_person_and_the_bare_forearms():
    views = usual()[-1].views
    np.testing.assert_array_equal(views.frame, np.arange(0, 2 * FRAMES, 2))
    assert not views.camera.any()
    own = views.grids
    for region, grid, part in (
        (own.region, own.person, "person"),
        (own.region, own.forearms, "forearms"),
        (*own.legs, "person"),
    ):
        cells = grid.probability.shape[-1]
        for i in range(FRAMES):
            truth = on_grid(getattr(painted()[i], part), region, i, cells)
            sure_of = grid.weight[i] > 0.5
            inside, outside = sure_of & (truth > 0.95), sure_of & (truth < 0.05)
            assert inside.sum() > 10 and outside.sum() > 0.3 * truth.size
            assert (grid.probability[i][inside] > 0.5).mean() > 0.9, part
            assert (grid.probability[i][outside] < 0.5).mean() > 0.97, part


def test_a_head_and_a_pelvis_have_no_weight():
    measured = usual()[-1].views.grids
    for name in ("head", "pelvis"):
        point = points_of(true_poses())[0, LANDMARKS.index(name)]
        pixel = np.asarray(project(CAMERA, jnp.asarray(point, float)))
        scale, origin = measured.region.scale[0], measured.region.origin[0]
        column, row = np.round((pixel - origin) / scale - 0.5).astype(int)
        assert measured.person.weight[0, row, column] < 0.05
        assert measured.forearms.weight[0, row, column] < 0.05 or name == "pelvis"


def test_a_frame_that_cannot_be_read_or_is_black_has_no_weight(problems):
    broken, lost = images(), [0, 7, 12]
    broken[0], broken[7], broken[12] = None, None, np.full_like(painted()[0].image, 3)
    second_pass(broken)
    for grid in grids(problems[-1]):
        heaviest = grid.weight.reshape(FRAMES, -1).max(1)
        assert not heaviest[lost].any() and (np.delete(heaviest, lost) > 0.5).all()
        assert np.isfinite(grid.probability).all()


def test_without_any_frame_that_can_be_read_no_grid_has_weight(problems):
    later = np.arange(FRAMES + 1) * FRAME_S
    video = MemoryVideo(later, [*[None] * FRAMES, painted()[0].image])
    timeline = build_timeline(TIMES, [video.times[:-1]], "own")
    first = first_pass(timeline, markers_world(), true_poses(), true_poses())
    actual = smooth_recording(MODEL, SETTINGS, first, [video], lambda share: None)
    assert actual is not None
    for grid in grids(problems[-1]):
        assert grid.weight.shape[0] == FRAMES and not grid.weight.any()


def test_a_video_narrower_than_its_calibration_keeps_its_pixels_in_place(problems):
    uncropped = usual()[-1].views.grids
    second_pass([image[:, :-9] for image in images()])
    narrow = problems[-1].views.grids
    np.testing.assert_array_equal(narrow.region.origin, uncropped.region.origin)
    for grid, other in zip(narrow[1:3], uncropped[1:3], strict=True):
        both = (grid.weight > 0.5) & (other.weight > 0.5)
        assert both.mean() > 0.2
        difference = np.abs(grid.probability - other.probability)[both]
        assert difference.mean() < 0.01 and np.percentile(difference, 99) < 0.2


def test_a_frame_that_serves_several_samples_has_a_view_for_each(problems):
    second_pass(mode="nearest")
    views = problems[-1].views
    np.testing.assert_array_equal(views.frame, np.arange(2 * FRAMES))
    # The last sample of each pair has the frame of the first or of the next.
    region, person = views.grids.region, views.grids.person
    pairs = np.flatnonzero((np.diff(region.origin, axis=0) == 0).all(1))
    both = [(person.weight[i] > 0.5) & (person.weight[i + 1] > 0.5) for i in pairs]
    away = [np.abs(person.probability[i] - person.probability[i + 1]) for i in pairs]
    assert any(np.quantile(a[b], 0.95) < 1e-6 for a, b in zip(away, both, strict=True))
    own = np.arange(0, 2 * FRAMES, 2)
    # One of them has no views: the legs that silhouettes start from.
    assert len(problems) == 3 + len(batch.DECISIONS)
    alone = usual()[-1].views.grids.person.probability
    np.testing.assert_allclose(person.probability[own].mean(), alone.mean(), atol=0.01)


def test_frames_are_chosen_by_index_shrunk_and_repeated():
    tagged = [np.full((720, 960, 3), 10 * i, np.uint8) for i in range(6)]
    for each in tagged:
        each[360:] = 200
    video = MemoryVideo(np.arange(6) / 30, [*tagged[:4], None, tagged[5]])
    frames = CameraFrames(0, np.arange(7), np.array([0, 0, 1, 3, 3, 4, 5]), video)
    read = list(frames.images(np.arange(7)))
    assert [None if im is None else int(im[0, 0, 0]) for im in read] == [0, 0, 10, 30, 30, None, 50]
    assert all(im is None or im.shape == (ROWS, 480, 3) for im in read)
    few = list(frames.images(np.array([1, 3, 4])))
    assert [int(im[0, 0, 0]) for im in few if im is not None] == [0, 30, 30]


def test_frames_beyond_the_videos_end_cannot_be_read():
    video = MemoryVideo(np.arange(3) / 30, [room((96, 72))] * 3)
    frames = CameraFrames(0, np.arange(4), np.array([1, 2, 3, 4]), video)
    read = list(frames.images(np.arange(4)))
    assert [image is None for image in read] == [False, False, True, True]


def test_without_any_frame_there_is_nothing_to_do():
    video = MemoryVideo(100 + np.arange(FRAMES) * FRAME_S, images())
    index = np.full((len(TIMES), 1), -1)
    timeline = replace(build_timeline(TIMES, [np.zeros(0)], "own"), frame_index=index)
    first = first_pass(timeline, markers_world(), true_poses(), true_poses())
    assert smooth_recording(MODEL, SETTINGS, first, [video], lambda share: None) is None


# The body in the frames --------------------------------------------------------------------------


@pytest.fixture(scope="module")
def drawing() -> Drawing:
    poses = jax.tree.map(lambda part: part[::2], true_poses())
    return Drawing.of(PERSON, CAMERA, SIZE, poses)


def test_the_drawn_body_covers_the_painted_one(drawing):
    assert drawing.size == (480, 360)
    for i in (0, 10):
        share = cv2.resize(painted()[i].person, drawing.size, interpolation=cv2.INTER_AREA)
        mask = drawing.mask(i, 1.0)
        assert mask[share > 0.99].mean() > 0.97 and not mask[share == 0].mean() > 0.005
        wide = drawing.mask(i, 1.4, 5.0)
        assert wide[share > 0].all() and wide.sum() > 1.2 * mask.sum()


def test_parts_of_limbs_and_limbs_by_name_are_drawn(drawing):
    mask = drawing.mask(3, 1.0)
    forearm = drawing.mask(3, 1.0, only=("forearm",))
    rest = drawing.mask(3, 1.0, without=("forearm",))
    half = drawing.mask(3, 1.0, only=("forearm",), part=(0.5, 0.95))
    np.testing.assert_array_equal(mask, forearm | rest)
    assert 0 < half.sum() < 0.8 * forearm.sum()
    # The half's hull is rounded to pixels by itself.
    assert (half & ~forearm).sum() <= 0.05 * half.sum()
    rows = drawing.tree.bones_in("forearm")
    near, far, radii = (part[3][rows] for part in drawing.discs)
    np.testing.assert_array_equal(
        forearm, draw_hulls(type(drawing.discs)(near, far, radii), drawing.size)
    )


# What it finds -----------------------------------------------------------------------------------


def errors_of(poses: Pose) -> np.ndarray:
    """Distances (E, 2) of the elbows from the truth, metres."""
    off = points_of(poses) - points_of(true_poses())
    return np.linalg.norm(off, axis=-1)[:, ELBOWS]


@pytest.fixture(scope="module")
def smoothed_run():
    """The second pass from arms that are turned away, some frames unreadable; the shares shown."""
    angles, frames, shown = true_poses().angles.copy(), images(), []
    wrong = disturbed(1).poses.angles[0] - pose_at(0.0).angles
    frames[5] = None
    start = true_poses()._replace(angles=(angles + wrong).astype(np.float32))
    return second_pass(frames, start=start, shown=shown), start, shown


def test_elbows_that_the_frames_show_are_found_and_every_event_has_deviations(smoothed_run):
    smoothed, start, _ = smoothed_run
    before, after = errors_of(start), errors_of(smoothed.poses)
    assert before.mean() > 0.06
    assert after.mean() < 0.04 and after.mean() < 0.5 * before.mean()
    assert smoothed_run[0].turns_cam.shape == (1, 3)
    assert 0 < np.degrees(np.linalg.norm(smoothed_run[0].turns_cam)) < 0.2
    smoothed, events = smoothed_run[0], len(TIMES)
    assert smoothed.deviations.shape == (events, len(LANDMARKS), 3)
    assert (smoothed.deviations > 0).all()
    assert smoothed.from_prior.shape == (events, len(LANDMARKS))
    shown = smoothed_run[2]
    assert shown == sorted(shown) and shown[0] > 0 and shown[-1] == pytest.approx(1)


def test_calibrations_hold_where_the_settings_say_so(problems):
    smoothed = second_pass(settings=replace(SETTINGS, camera=0.0))
    assert problems and smoothed is not None and smoothed.turns_cam.shape == (0, 3)


def test_steps_have_deviations_of_the_elbows_only():
    spread, nothing = np.array([[0.01, 0.02], [0.05, 0.4]]), np.zeros((2, 2))
    still = Pose(*(part[0] for part in true_poses()))
    reports = StepReport(still, np.zeros((2, 3)), nothing, nothing, spread, *[nothing] * 4)
    first = first_pass(build_timeline(TIMES[:2], []), markers_world()[:2], still, still)
    actual = steps_as_trajectory(first._replace(reports=reports))
    assert actual.deviations is not None and actual.from_prior is not None
    np.testing.assert_allclose(np.linalg.norm(actual.deviations[:, ELBOWS], axis=-1), spread)
    others = np.delete(actual.deviations, ELBOWS, axis=1)
    assert np.isnan(others).all() and np.isnan(actual.from_prior).all()


# The whole way -----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def recording() -> Recording:
    """With the markers of the small recording, whose tracker is compiled already."""
    places = tuple(MarkerPlace(name, bone) for name, (bone, _) in PLACES.items())
    rows = landmark_rows(tuple(landmark for _, landmark in PLACES.values()))
    frames = (np.arange(FRAMES) * FRAME_S, images())
    video = VideoSource("cam", CAMERA, offset=0.0, frames=frames)
    positions = points_of(true_poses())[:, rows].astype(float)
    return Recording(PERSON, TIMES, positions, places, (video,), "painted")


@pytest.fixture(scope="module")
def both_passes(recording):
    own = HybridTracker.from_recording(recording)
    return [track_both(recording, mode=mode, tracker=own) for mode in ("own", "causal")]


def test_a_recording_is_smoothed_to_better_elbows_and_the_report_says_how_sure_they_are(
    both_passes,
):
    tracked, _ = both_passes
    alone, smoothed = (errors_of(motion.poses) for motion in (tracked.markers_only, tracked.motion))
    assert smoothed.mean() < 0.6 * alone.mean() and smoothed.mean() < 0.05
    assert tracked.motion.report.milliseconds["smooth"].shape == (1,)
    assert np.isfinite(tracked.motion.report.landmarks_std).all()
    assert np.isin(tracked.motion.report.from_prior, [0, 1]).all()
    report, events = both_passes[0].motion.report, len(TIMES)
    assert report.marker_errors.shape == (events, len(PLACES)) and report.marker_errors.max() < 0.03
    assert report.swivels.shape == report.elbow_deviations.shape == (events, 2)
    assert (report.elbow_deviations > 0).all()
    over_all, causal = (tracked.motion.report.run for tracked in both_passes)
    (turn,) = over_all.camera_turns_deg.values()
    assert list(over_all.camera_turns_deg) == ["cam"] and len(turn) == 3
    assert 0 < np.linalg.norm(turn) < 0.2
    assert causal.camera_turns_deg == {}


def test_a_camera_that_was_pushed_is_named_and_the_elbows_are_found(recording, both_passes):
    (video,), usual = recording.videos, both_passes[0].motion
    turn = np.radians(np.float32([1.5, -2.0, 0.0]))
    pushed = replace(video, camera=turn_camera(video.camera, turn))
    motion = track(replace(recording, videos=(pushed,)))
    assert errors_of(motion.poses).mean() < 1.5 * errors_of(usual.poses).mean()
    (warning,) = set(motion.report.run.warnings) - set(usual.report.run.warnings)
    assert "cam: turned by 2" in warning and "calibrate it again" in warning


def test_causally_each_pose_waits_for_two_frames_as_the_report_has_it(both_passes):
    motion = both_passes[1].motion
    report = motion.report
    assert report.run.latency["video frames"] == DELAY_FRAMES
    # At every frame but the first.
    assert report.milliseconds["smooth"].shape == (FRAMES - 1,)
    assert len(motion.times) == len(TIMES)
    assert all(np.isfinite(part).all() for part in motion.poses)
    assert np.isfinite(report.landmarks_std).all()
    alone = errors_of(both_passes[1].markers_only.poses)
    assert errors_of(motion.poses).mean() < 0.8 * alone.mean()


def test_legs_that_no_marker_holds_are_found_where_they_stand():
    """Whoever stands still would be furniture if the body were expected elsewhere."""
    kneeling = np.zeros(len(PERSON.tree.joints), np.float32)
    for name in ("hip_flexion_l", "hip_flexion_r"):
        kneeling[PERSON.tree.joints.index(name)] = 0.35
    start = true_poses()
    start = start._replace(angles=start.angles + kneeling)
    actual = second_pass(start=start)
    assert actual is not None
    ankles = [LANDMARKS.index(f"ankle_{side}") for side in "lr"]
    truth = points_of(true_poses())[:, ankles]
    before = np.linalg.norm(points_of(start)[:, ankles] - truth, axis=-1)
    after = np.linalg.norm(points_of(actual.poses)[:, ankles] - truth, axis=-1)
    assert before.min() > 0.29 and after.max() < 0.15


def test_frames_in_which_nobody_is_recognised_are_named():
    frames, strange = images(), (2, 5)
    for i in strange:
        frames[i] = np.random.default_rng(i).integers(0, 255, frames[i].shape, dtype=np.uint8)
    with unsolved():
        found = second_pass(frames)
    timeline = build_timeline(TIMES, [np.arange(FRAMES) * FRAME_S], "own")
    expected = np.isin(timeline.frame_index, strange)
    np.testing.assert_array_equal(found.unrecognised, expected)
