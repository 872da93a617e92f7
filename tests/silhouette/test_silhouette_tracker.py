"""The silhouette tracker: a painted person before plain walls, seen by four cameras."""

from dataclasses import replace
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from conftest import complaint
from small_recording import small_recording
from test_rim import BODY, ring

from jaxmocap.body.pose import relaxed_pose, retract
from jaxmocap.body.skeleton import LANDMARKS, Skeleton
from jaxmocap.body.tree import ROOT_DOF
from jaxmocap.formats.recordings.recording import Recording
from jaxmocap.images.canvases import full_mask, silhouette_distance
from jaxmocap.images.regions import Region
from jaxmocap.pipelines.silhouettes.first_pose import start_pose
from jaxmocap.silhouette.first_pose import landmark_points, pose_at_landmarks, standing_pose_at
from jaxmocap.silhouette.fit import cycles
from jaxmocap.silhouette.fit.correspond import Contour
from jaxmocap.silhouette.fit.cycles import contours_apart, fit, has_settled
from jaxmocap.silhouette.segmentation.background_models import BackgroundLearner, OnlineBackground
from jaxmocap.silhouette.segmentation.segment import SegmentationPlan, Stage
from jaxmocap.silhouette.settings import FAR_OFF, Cycle, Settings, progressive
from jaxmocap.silhouette.surfaces.body_shape import FULL
from jaxmocap.silhouette.surfaces.rim import RimSettings
from jaxmocap.silhouette.tracker import SilhouetteTracker

# Plain walls need few steps, which compile sooner.
PLAIN = SegmentationPlan(background=False, stages=(Stage(10, 2.0, 2.0, gap=1.0),))
SMALL = Settings(
    body="whole.toml",
    rim=RimSettings(size=128, outer=128, inner=32, spacing=0.012, margin=0.1),
    plan=PLAIN,
)
PERSON, WALL = (40, 60, 150), (190, 180, 170)
POINTS = landmark_points


@pytest.fixture(scope="module")
def tracker() -> SilhouetteTracker:
    return SilhouetteTracker(BODY, ring(4), SMALL)


@pytest.fixture(scope="module")
def truth():
    off = np.zeros(BODY.costs.shape, np.float32)
    off[ROOT_DOF + BODY.tree.joint("arm_abduct_l")] = 0.9
    off[ROOT_DOF + BODY.tree.joint("elbow_flex_l")] = 0.8
    return retract(relaxed_pose(BODY), jnp.asarray(off))


def painted(tracker, pose) -> list[np.ndarray]:
    """The body itself, painted on walls with noise."""
    cameras = tracker.constants.cameras
    rim = tracker.constants.finder.find(tracker.body.shape, pose, cameras)
    rng, shown = np.random.default_rng(0), []
    for camera, mask in enumerate(rim.masks):
        width, height = np.asarray(cameras.size[camera], int)
        region = Region(*(np.asarray(part)[camera] for part in rim.region))
        body = full_mask(silhouette_distance(mask), region, (height, width))
        image = np.where(body[..., None], PERSON, WALL) + rng.normal(0, 5, (height, width, 3))
        shown.append(np.clip(image, 0, 255).astype(np.uint8))
    return shown


@pytest.fixture(scope="module")
def images(tracker, truth) -> list[np.ndarray]:
    return painted(tracker, truth)


def off_by(pose, truth) -> np.ndarray:
    """Distances (L,) of the landmarks, metres."""
    return np.linalg.norm(np.asarray(POINTS(BODY, pose) - POINTS(BODY, truth)), axis=1)


def with_settings(tracker, settings) -> None:
    """Other settings, the same compiled programs."""
    tracker.constants = tracker.constants._replace(settings=settings)


def started(tracker, truth):
    """A state whose limbs are all a little off."""
    step = np.random.default_rng(1).choice([-0.06, 0.06], BODY.costs.shape)
    step[:3] = 0.02
    return tracker.init(retract(truth, jnp.asarray(step, jnp.float32)))


def test_a_person_is_found_and_then_kept_without_the_cameras_that_fail(tracker, truth, images):
    state = started(tracker, truth)
    before = off_by(state.pose, truth).mean()
    state, _, _ = tracker.step(state, 0.0, images)
    state, _, _ = tracker.step(state, 1 / 30, images)
    state, pose, report = tracker.step(state, 2 / 30, images)
    assert report.used.all() and report.matched_shares.min() > 0.7
    actual = off_by(pose, truth)
    assert actual.mean() < 0.5 * before and actual.mean() < 0.03
    compiled = fit.kinds
    black = [np.zeros_like(images[0]), None, *images[2:]]
    state, pose, report = tracker.step(state, 0.1, black)
    np.testing.assert_array_equal(report.used, [False, False, True, True])
    assert off_by(pose, truth).mean() < 0.04
    assert fit.kinds == compiled


def test_starts_far_off_are_found_coarse_to_fine_and_not_by_the_full_surface_alone(
    tracker, truth, images
):
    """Two of those whose limbs no wrong outline catches; which those are, rounding decides."""
    left = {FAR_OFF: [], (): []}
    for seed in (2, 5):
        step = np.random.default_rng(seed).choice([-0.15, 0.15], BODY.costs.shape)
        step[:3] = 0.06
        start = retract(truth, jnp.asarray(step, jnp.float32))
        assert off_by(start, truth).mean() > 0.15
        for starting, actual in left.items():
            with_settings(tracker, replace(SMALL, starting_cycles=starting))
            state = tracker.init(start)
            for _ in range(3):
                state, pose, _ = tracker.step(state, 0.0, images)
                state = state._replace(time=None)
            actual.append(off_by(pose, truth).mean())
    assert max(left[FAR_OFF]) < 0.025 < 0.035 < np.mean(left[()])


def test_segmentation_and_pose_alternate_until_both_settle_whatever_levels_come_first(
    tracker, truth, images, monkeypatch
):
    segmented = []
    find = cycles.find_outlines
    monkeypatch.setattr(cycles, "find_outlines", lambda *a: segmented.append(1) or find(*a))
    coarse_to_fine = progressive(SMALL.cycles, 2, len(SMALL.rim.levels))
    monkeypatch.setattr(cycles, "POSE_M", 0.005)
    for rounds, most in ((0, 1), (1, 2), (9, 9)):
        with_settings(tracker, replace(SMALL, cycles=coarse_to_fine, settling_rounds=rounds))
        segmented.clear()
        _, pose, report = tracker.step(started(tracker, truth), 0.0, images)
        assert min(rounds, 1) < len(segmented) <= most
        assert report.used.all() and off_by(pose, truth).mean() < 0.03
    with_settings(tracker, SMALL)


def test_without_any_image_the_pose_is_held_and_every_joint_said_to_be_unseen(tracker, truth):
    state = tracker.init(truth)
    state, _, _ = tracker.step(state, 0.0, [None] * 4)
    state, pose, report = tracker.step(state, 1 / 30, [None] * 4)
    assert not report.used.any() and not report.observed.any() and not state.velocity.any()
    assert off_by(pose, truth).max() < 1e-3


def test_a_pose_is_placed_at_given_landmarks(truth):
    points = np.array(POINTS(BODY, truth))
    assert off_by(pose_at_landmarks(BODY, points), truth).mean() < 0.01
    few = np.where(np.isin(list(LANDMARKS), ["head", "wrist_l"])[:, None], np.nan, points)
    assert off_by(pose_at_landmarks(BODY, few), truth).mean() < 0.05
    with pytest.raises(ValueError, match="neither both hips"):
        pose_at_landmarks(BODY, np.full_like(points, np.nan))


def test_a_person_stands_on_the_floor_where_it_was_said():
    pose = standing_pose_at(BODY, 1.0, -2.0, np.pi / 2)
    points = dict(zip(LANDMARKS, np.asarray(POINTS(BODY, pose)), strict=True))
    assert min(point[2] for point in points.values()) == pytest.approx(0, abs=1e-4)
    np.testing.assert_allclose(points["pelvis"][:2], [1.0, -2.0], atol=1e-4)
    left = points["hip_l"] - points["hip_r"]
    assert left[0] < 0 and abs(left[1]) < 1e-4


# Of a small image: cells of two pixels, an empty room, and a level set without anybody.
REGION = Region(np.full(2, -0.5, np.float32), np.array(2.0, np.float32))
ROOM, NOBODY = np.full((60, 80, 3), 120, np.uint8), np.full((40, 40), -8.0, np.float32)


def test_a_room_is_learned_where_the_person_was_not():
    learner = BackgroundLearner(8)
    for i in range(8):
        image, phi = ROOM.copy(), NOBODY.copy()
        left = 4 + 6 * i
        image[20:40, left : left + 8] = 10
        phi[10:20, left // 2 : left // 2 + 4] = 8.0
        learner.add_frame(image, phi, REGION)
    learned = learner.background()
    assert learned is not None and learned.colour.shape == ROOM.shape
    assert np.abs(learned.colour[learned.certainty > 0.5] - 120).max() < 2
    assert (learned.certainty > 0.5).mean() > 0.9
    assert BackgroundLearner(8).background() is None


def test_what_a_shadow_lay_on_for_most_of_the_time_is_learned_as_it_is_lit():
    learner = BackgroundLearner(10)
    for i in range(10):
        image = ROOM.copy()
        image[40:, : 80 if i < 6 else 40] = 80
        learner.add_frame(image, NOBODY, REGION)
    learned = learner.background()
    assert learned is not None
    assert (learned.colour[:, 41:] > 115).all() and (learned.colour[41:, :39] < 85).all()


def test_a_hand_that_stands_still_is_no_room_where_the_body_has_it_and_segmentation_has_not():
    image = ROOM.copy()
    image[20:30, 40:50] = 10
    rows, columns = np.mgrid[20:30:3, 40:50:3]
    hand = np.stack([columns.ravel(), rows.ravel()], 1).astype(float)
    learned = {}
    for is_masked in (False, True):
        learner = BackgroundLearner(8)
        for _ in range(8):
            learner.add_frame(image, NOBODY, REGION, hand if is_masked else None)
        learned[is_masked] = learner.background()
    assert (learned[False].certainty > 0.5).all()
    assert (
        not learned[True].certainty[20:30, 40:50].any()
        and learned[True].certainty[5:15, 5:75].all()
    )


def test_a_room_is_learned_from_first_frames_but_about_the_person_and_there_once_they_have_left():
    running = OnlineBackground()
    for left in (10, 10, 10, 50, 50, 50):
        image = ROOM.copy()
        image[20:40, left : left + 8] = 10
        rows, columns = np.mgrid[20:40:4, left : left + 8 : 4]
        body = np.stack([columns.ravel(), rows.ravel()], 1).astype(float)
        room = running.update(image, NOBODY, REGION, body)
        assert np.abs(room.colour[room.certainty > 0] - 120).max() < 2
        assert (
            room.certainty[20:40, 10:18].any() == (left == 50)
            and room.certainty[20:40, 50:58].any()
        )
    assert (room.certainty == 1).all()


def test_a_start_needs_markers_or_a_place():
    empty = Recording(Skeleton.human(1.75), np.zeros(0), np.zeros((0, 0, 3)), ())
    assert "expected --at X,Y,FACING" in complaint(start_pose, empty)
    assert np.asarray(start_pose(empty, (1.0, 2.0, 0.0)).position)[0] == pytest.approx(1.0)


def test_a_start_by_markers_is_where_they_are_as_the_video_begins():
    walks = small_recording()
    before = walks.positions_world - [2.0, 0, 0]
    times = np.concatenate([walks.times, walks.times + walks.times[-1] + 0.1])
    late = replace(walks.videos[0], offset=float(times[len(walks.times)]))
    positions = np.concatenate([before, walks.positions_world])
    # A marker less than before.
    positions[len(before) :, 0] = np.nan
    there = replace(walks, times=times, positions_world=positions, videos=(late,))
    expected = start_pose(replace(walks, positions_world=positions[len(before) :]))
    np.testing.assert_allclose(start_pose(there).position, expected.position, atol=1e-5)


# When a frame has settled -------------------------------------------------------------------------


NOTHING = Contour(np.zeros((0, 2)), np.zeros((0, 2)))


def circle(radius: float, points: int, phase: float = 0.0) -> Contour:
    """About the origin."""
    phi = 2 * np.pi * np.arange(points) / points + phase
    outwards = np.stack([np.cos(phi), np.sin(phi)], 1)
    return Contour(radius * outwards, outwards)


def test_contours_are_apart_by_what_they_moved_across_however_they_were_sampled():
    one = [circle(50.0, 400), NOTHING]
    scales, moved = (2.0, 1.0), [circle(52.0, 300, 0.1), NOTHING]
    assert contours_apart(one, [circle(50.0, 300, 0.1), NOTHING], scales) < 0.01
    assert contours_apart(one, moved, scales) == pytest.approx(1.0, abs=0.01)
    assert contours_apart(one, [circle(50.0, 300), circle(9.0, 50)], scales) == np.inf
    assert contours_apart([NOTHING], [NOTHING], (1.0,)) == 0


def test_a_round_has_settled_where_neither_pose_nor_contour_moved():
    pose = relaxed_pose(BODY)
    turned = pose._replace(angles=pose.angles.at[BODY.tree.joint("elbow_flex_l")].add(0.1))
    region = SimpleNamespace(scale=(2.0,))
    near, far = (
        SimpleNamespace(contours=[circle(radius, 400)], region=region) for radius in (50.0, 51.0)
    )
    assert has_settled(BODY, (pose, pose), (near, near))
    assert not has_settled(BODY, (pose, turned), (near, near))
    assert not has_settled(BODY, (pose, pose), (near, far))


@pytest.mark.parametrize(
    ("count", "levels", "deviations"),
    [
        (0, [FULL, FULL, FULL], [0.03, 0.008, 0.004]),
        (2, [1, 2, FULL], [0.03, 0.008, 0.004]),
        (3, [0, 1, 2, FULL], [0.03, 0.03, 0.008, 0.004]),
    ],
)
def test_frequencies_are_added_cycle_by_cycle_and_the_last_has_them_all(count, levels, deviations):
    cycles = progressive(Settings().cycles, count, available=3)
    assert [cycle.level for cycle in cycles] == levels
    assert [cycle.deviation for cycle in cycles] == deviations
    assert [cycle.segments for cycle in cycles] == [True] + [False] * (len(cycles) - 1)


def test_more_levels_than_there_are_are_refused():
    with pytest.raises(ValueError, match="found 4 levels, expected 3 at most"):
        progressive((Cycle(0.01),), 4, len(Settings().rim.levels))
    assert {cycle.level for cycle in FAR_OFF} == {0}
