"""Several hypotheses: a limb that one hypothesis loses for good is found again by many."""

from dataclasses import replace
from itertools import combinations
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from test_rim import BODY, ring
from test_silhouette_tracker import SMALL, WALL, painted

from jaxmocap.body.pose import relaxed_pose, retract
from jaxmocap.body.skeleton import LANDMARKS, ROOT_DOF
from jaxmocap.images.background_model import Background
from jaxmocap.images.regions import Region
from jaxmocap.silhouette.first_pose import landmark_points
from jaxmocap.silhouette.recovery.limb_particle_filter import (
    APART,
    KEPT,
    LimbEvidence,
    LimbSearchResult,
    distinct_particles,
    explained_log_ratio,
    systematic_resampling,
)
from jaxmocap.silhouette.recovery.limbs import carriers, limb_chains
from jaxmocap.silhouette.recovery.lost_limbs import UNEXPLAINED, LimbProposal
from jaxmocap.silhouette.recovery.part_appearance import YOUNG, PartAppearance
from jaxmocap.silhouette.recovery.projected_body import project_points
from jaxmocap.silhouette.segmentation.canvas_coverage import covered_cells
from jaxmocap.silhouette.segmentation.image_changes import ImageHistory
from jaxmocap.silhouette.segmentation.segment import SegmentationPlan, Stage
from jaxmocap.silhouette.settings import Settings
from jaxmocap.silhouette.tracker import SilhouetteTracker

pytestmark = pytest.mark.usefixtures("plainly_compiled")
WRIST = list(LANDMARKS).index("wrist_l")
DRAWN, DISTINCT, EXPLAINED = (
    jax.jit(systematic_resampling),
    jax.jit(distinct_particles),
    jax.jit(explained_log_ratio),
)


def lifted(degrees: float):
    """The relaxed pose, the left arm so far away from the body."""
    step = np.zeros(BODY.costs.shape, np.float32)
    step[ROOT_DOF + BODY.tree.joint("arm_abduct_l")] = np.radians(degrees)
    return retract(relaxed_pose(BODY), jnp.asarray(step))


def bent(degrees: float):
    """The relaxed pose, the left elbow bent so far."""
    pose = relaxed_pose(BODY)
    joint = BODY.tree.joint("elbow_flex_l")
    return pose._replace(angles=pose.angles.at[joint].set(np.radians(degrees)))


def in_known_rooms() -> SilhouetteTracker:
    """Of four cameras, whose rooms are known to be of one plain colour."""
    made = SilhouetteTracker(BODY, ring(4), SMALL)
    made.plan = SegmentationPlan(background=False, stages=(Stage(10, 2.0, 2.0, gap=1.0),))
    width, height = np.asarray(made.cameras.size[0], int)
    flat, plain = np.ones((height, width), np.float32), np.ones((height, width, 3), np.float32)
    made.rooms = 4 * [Background(plain * np.float32(WALL), 5 * flat, flat)]
    return made


@pytest.fixture(scope="module")
def tracker() -> SilhouetteTracker:
    return in_known_rooms()


def wrist_off(tracker, count: int) -> float:
    """Metres, some frames after an arm that hung down is suddenly up, beyond what was looked at."""
    tracker.settings = replace(SMALL, hypotheses=count)
    hanging, up = lifted(10.0), lifted(150.0)
    state = tracker.init(hanging)
    shown = [painted(tracker, hanging)] + 4 * [painted(tracker, up)]
    for frame, images in enumerate(shown):
        state, pose, _ = tracker.step(state, frame / 30, images)
    found, true = (landmark_points(BODY, each)[WRIST] for each in (pose, up))
    return float(np.linalg.norm(np.asarray(found - true)))


def test_an_arm_that_one_hypothesis_loses_many_find_again(tracker):
    assert wrist_off(tracker, 1) > 0.4
    assert wrist_off(tracker, 128) < 0.1


@pytest.mark.parametrize(
    ("gains", "taken"),
    [({"first": 0.4, "best": 0.9, "last": 0.6}, "best"), ({"first": 0.1, "last": 0.14}, "found")],
)
def test_of_several_better_poses_the_best_is_taken_or_none(gains, taken):
    """Each is fitted and held against what was found, not against the one before it."""
    told = {"found": 0.0, **gains}
    chooser = SilhouetteTracker.__new__(SilhouetteTracker)
    chooser.settings, chooser.rooms = Settings(), [WALL]  # type: ignore[list-item]

    def ended(pose: str, *_):
        result = SimpleNamespace(pose=pose)
        return SimpleNamespace(result=result, used=np.ones(1, bool), outlines=None)

    chooser._fitted = lambda shown, pose, _: ended(pose)
    chooser._doubter = SimpleNamespace(
        joints_of=lambda limbs: np.full(4, bool(limbs)),
        sight=lambda pose, *_: pose,
        better=lambda doubts, *_: (LimbProposal(tuple(gains), (0,)), doubts),
        gain=lambda limbs, before, after, known: told[after] - told[before],
        hidden=lambda doubts, sight, images, moved: (np.zeros(4, bool), sight),
    )
    nothing = SimpleNamespace(images=[], known=None)
    end = chooser._reconsidered(nothing, nothing, ended("found"), np.ones(ROOT_DOF + 4))
    assert end.fitted.result.pose == end.doubts == taken
    assert end.moved.all() == (taken != "found") and not end.resumed.any()


@pytest.mark.parametrize(("gain", "waits"), [(0.05, True), (0.1, False)])
def test_a_limb_is_looked_for_again_at_once_where_a_place_was_nearly_better(
    tracker, monkeypatch, gain, waits
):
    doubter = tracker._doubter
    found = LimbSearchResult(
        jnp.zeros((1, 6)), jnp.zeros((1, 6)), jnp.array([0.3 + gain]), jnp.array(0.3)
    )
    monkeypatch.setattr(doubter, "_search", lambda *_: found)
    better, after = judged(doubter, monkeypatch, worth=0.3, missing=2 * UNEXPLAINED)
    assert better is None and after.waits.any() == after.failures.any() == waits


@pytest.mark.parametrize(
    ("worth", "missing", "denied"),
    [(0.15, 0.5, True), (0.25, 0.5, False), (0.15, 0.0, False), (-0.15, 0.0, True)],
)
def test_a_limb_that_explains_little_is_not_there_where_somebody_is_unexplained(
    tracker, monkeypatch, worth, missing, denied
):
    doubter = tracker._doubter
    nothing = LimbSearchResult(
        jnp.zeros((1, 6)), jnp.zeros((1, 6)), jnp.array([worth]), jnp.array(worth)
    )
    monkeypatch.setattr(doubter, "_search", lambda *_: nothing)
    _, after = judged(doubter, monkeypatch, worth, missing)
    assert (after.denied == denied).all()


@pytest.mark.parametrize("denied", [True, False])
def test_a_limb_whose_denial_ends_is_looked_for_once_more_and_at_once(tracker, monkeypatch, denied):
    doubter, searched = tracker._doubter, []
    nothing = LimbSearchResult(
        jnp.zeros((1, 6)), jnp.zeros((1, 6)), jnp.array([0.5]), jnp.array(0.5)
    )
    monkeypatch.setattr(doubter, "_search", lambda number, *_: searched.append(number) or nothing)
    count = len(doubter.limbs)
    before = doubter.none()._replace(denied=np.full(count, denied), waits=np.full(count, 3))
    _, after = judged(doubter, monkeypatch, worth=0.5, missing=0.0, before=before)
    assert len(searched) == count * denied and not after.denied.any()
    judged(doubter, monkeypatch, worth=0.5, missing=0.0, before=after)
    assert len(searched) == count * denied


def judged(doubter, monkeypatch, worth: float, missing: float, before=None):
    """What becomes of limbs that all explain so much, while so much is unexplained."""
    monkeypatch.setattr(doubter, "_unexplained", lambda sight: np.full(4, missing))
    monkeypatch.setattr(doubter, "_nearest", lambda sight: None)
    monkeypatch.setattr(doubter, "_left_for", lambda *_: None)
    monkeypatch.setattr(doubter, "_explains", lambda *_: worth)
    return doubter.better(before or doubter.none(), SimpleNamespace(pose=None), SMALL.limb_search)


def test_a_forearm_laid_over_its_upper_arm_explains_nothing_twice(tracker):
    surface = tracker.finder.surface
    limb = limb_chains(BODY, surface)["arm_l"]
    upper = carriers(surface.points) == limb.bones[0]
    region = Region(np.full((4, 2), -0.5, np.float32), np.full(4, 8.0, np.float32))
    pixels = np.asarray(project_points(BODY, bent(0.0), tracker.cameras, surface.points)[0])[
        :, upper
    ]
    shown = [covered_cells(at, Region(*r), 128, 0) for at, *r in zip(pixels, *region, strict=True)]
    evidence = LimbEvidence(np.stack(shown).astype(np.float32), region, np.ones(4, bool))
    straight, folded = (
        float(EXPLAINED(BODY, tracker.cameras, bent(degrees), limb, evidence))
        for degrees in (0.0, 150.0)
    )
    assert straight > 0.1 and folded < 1.2 * straight


@given(st.integers(0, 2**31 - 1))
def test_of_the_worthiest_particles_those_are_fitted_that_differ(seed):
    rng = np.random.default_rng(seed)
    angles, worth = rng.uniform(-2, 2, (40, 6)), rng.permutation(40).astype(np.float32)
    chosen = np.asarray(DISTINCT(jnp.asarray(angles, jnp.float32), jnp.asarray(worth)))
    assert chosen[0] == worth.argmax() and (np.diff(worth[chosen]) < 0).all()
    for one, other in combinations(chosen, 2):
        assert np.sqrt(np.mean((angles[one] - angles[other]) ** 2)) > APART - 1e-3
    skipped = np.setdiff1d(np.flatnonzero(worth > worth[chosen[-1]]), chosen)
    for index in skipped:
        away = np.sqrt(np.mean((angles[chosen] - angles[index]) ** 2, 1))
        assert away.min() < APART + 1e-3
    assert len(chosen) == KEPT


@given(st.integers(0, 2**31 - 1), st.lists(st.floats(0.01, 1.0), min_size=8, max_size=8))
def test_systematic_resampling_draws_each_as_often_as_it_weighs(seed, weights):
    shares = np.array(weights, np.float32) / np.sum(weights, dtype=np.float32)
    drawn = np.asarray(DRAWN(jax.random.PRNGKey(seed), jnp.asarray(shares)))
    often = np.bincount(drawn, minlength=8)
    assert len(drawn) == 8 and (np.abs(often - 8 * shares) < 1 + 1e-3).all()
    again = DRAWN(jax.random.PRNGKey(seed), jnp.asarray(shares))
    np.testing.assert_array_equal(drawn, again)


def test_a_body_covers_the_cells_about_its_points_and_no_others():
    region = Region(np.array([9.5, -0.5], np.float32), np.array(2.0, np.float32))
    # The middle of cell (3, 5) and a point beside the canvas.
    mask = covered_cells(np.array([[16.5, 10.5], [500.0, 3.0]]), region, 12, 1)
    expected = np.zeros((12, 12), bool)
    expected[4:7, 2:5] = True
    np.testing.assert_array_equal(mask, expected)


def test_torn_black_and_exchanged_frames_are_passed_over_until_patience_ends():
    rng = np.random.default_rng(0)
    room, other = rng.integers(0, 255, (2, 48, 64, 3)).astype(np.uint8)
    room, other = (np.repeat(np.repeat(image, 8, 0), 8, 1) for image in (room, other))
    walked = room.copy()
    walked[100:300, 200:260] = 0
    glances = ImageHistory.empty(1)
    for image, believed in ((room, True), (walked, True), (room, True), (other, False)):
        kept, glances = glances.accepted([image], SMALL.changed_share, 3)
        assert (kept[0] is not None) == believed
    torn = np.concatenate([room[:150], np.roll(room[150:], 200, 1)])
    for image, believed in ((torn, False), (np.zeros_like(room), False), (other, True)):
        kept, glances = glances.accepted([image], SMALL.changed_share, 3)
        assert (kept[0] is not None) == believed
    assert glances.accepted([None], 0.25, 3)[0] == [None]


def test_a_box_before_a_part_is_told_by_its_hue_and_shade_is_not():
    image = np.full((40, 60, 3), (60, 90, 140), np.uint8)
    rows, columns = np.mgrid[10:20, 10:20]
    pixels = np.stack([columns.ravel(), rows.ravel()], 1)[None].repeat(3, 0)
    parts = np.ones((1, 100), bool)
    looks = PartAppearance.empty(1, 3)
    for frame in range(YOUNG):
        darker = np.uint8(image * (1 - 0.1 * frame))
        other, looks = looks.compared(3 * [darker], pixels, parts)
        assert not other.any()
    box = image.copy()
    box[8:22, 8:22] = 200
    assert not looks.compared(3 * [image], pixels, parts)[0].any()
    # One of three cameras is not enough.
    assert not looks.compared([box, image, image], pixels, parts)[0].any()
    hidden, after = looks.compared([box, box, image], pixels, parts)
    assert hidden.all() and (after.mean[:, :2] == looks.mean[:, :2]).all()
    assert not looks.compared(3 * [None], pixels, parts)[0].any()
