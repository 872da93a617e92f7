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
from test_rim import BODY, bent, ring
from test_silhouette_tracker import SMALL, WALL, painted, with_settings

from jaxmocap.body.pose import relaxed_pose, retract
from jaxmocap.body.skeleton import LANDMARKS
from jaxmocap.body.tree import ROOT_DOF
from jaxmocap.images.background_model import Background
from jaxmocap.images.regions import Region
from jaxmocap.silhouette.first_pose import landmark_points
from jaxmocap.silhouette.recovery import relocation
from jaxmocap.silhouette.recovery.limb_likelihood import LimbEvidence, explained_log_ratio
from jaxmocap.silhouette.recovery.limb_particle_filter import (
    DISTINCT_RAD,
    FITTED_PARTICLES,
    LimbSearchResult,
    distinct_particles,
    systematic_resampling,
)
from jaxmocap.silhouette.recovery.limbs import carrying_bones, limb_chains
from jaxmocap.silhouette.recovery.lost_limbs import (
    LEAST_GAIN,
    UNEXPLAINED_SHARE,
    LimbMemory,
    LimbProposal,
)
from jaxmocap.silhouette.recovery.part_appearance import YOUNGEST, PartAppearance
from jaxmocap.silhouette.recovery.projected_body import body_pixels
from jaxmocap.silhouette.segmentation.background_models import covered_cells
from jaxmocap.silhouette.segmentation.image_changes import ImageHistory
from jaxmocap.silhouette.settings import Settings
from jaxmocap.silhouette.tracker import SilhouetteTracker

WRIST = LANDMARKS.index("wrist_l")
DRAWN, DISTINCT = jax.jit(systematic_resampling), jax.jit(distinct_particles)
EXPLAINED = jax.jit(explained_log_ratio)


def lifted(degrees: float):
    """The relaxed pose, the left arm so far away from the body."""
    step = np.zeros(BODY.costs.shape, np.float32)
    step[ROOT_DOF + BODY.tree.joint("arm_abduct_l")] = np.radians(degrees)
    return retract(relaxed_pose(BODY), jnp.asarray(step))


def four_cameras() -> SilhouetteTracker:
    """Of four cameras."""
    return SilhouetteTracker(BODY, ring(4), SMALL)


def plain_walls(tracker: SilhouetteTracker) -> list[Background]:
    """Of all four cameras."""
    width, height = np.asarray(tracker.constants.cameras.size[0], int)
    flat, plain = np.ones((height, width), np.float32), np.ones((height, width, 3), np.float32)
    return 4 * [Background(plain * np.float32(WALL), 5 * flat, flat)]


def begun(tracker: SilhouetteTracker, pose):
    """The state before the first frame, all backgrounds learned."""
    return tracker.init(pose, backgrounds=plain_walls(tracker))


@pytest.fixture(scope="module")
def tracker() -> SilhouetteTracker:
    return four_cameras()


def wrist_off(tracker, count: int) -> float:
    """Metres, some frames after an arm that hung down is suddenly up, beyond what was looked at."""
    with_settings(tracker, replace(SMALL, particles=count))
    hanging, up = lifted(10.0), lifted(150.0)
    state = begun(tracker, hanging)
    shown = [painted(tracker, hanging)] + 4 * [painted(tracker, up)]
    for frame, images in enumerate(shown):
        state, pose, _ = tracker.step(state, frame / 30, images)
    actual, true = (landmark_points(BODY, each)[WRIST] for each in (pose, up))
    return float(np.linalg.norm(np.asarray(actual - true)))


def test_an_arm_that_one_hypothesis_loses_many_find_again(tracker):
    assert wrist_off(tracker, 1) > 0.4
    assert wrist_off(tracker, 128) < 0.1


@pytest.mark.parametrize(
    ("gains", "taken"),
    [({"first": 0.4, "best": 0.9, "last": 0.6}, "best"), ({"first": 0.1, "last": 0.14}, "found")],
)
def test_of_several_better_poses_the_best_is_taken_or_none(monkeypatch, gains, taken):
    """Each is fitted and compared with what was found, not with the one before it."""
    explained = {"found": 0.0, **gains}

    def ended(pose: str):
        result = SimpleNamespace(pose=pose)
        return SimpleNamespace(result=result, used=np.ones(1, bool), outlines=None)

    monkeypatch.setattr(relocation, "fit_pose", lambda model, body, frame, pose, _: ended(pose))
    proposal = LimbProposal(tuple(gains), (0,), LEAST_GAIN)  # type: ignore[arg-type]
    recovery = SimpleNamespace(
        joints_of=lambda limbs: np.full(4, bool(limbs)),
        projector=SimpleNamespace(project=lambda pose, *_: pose),
        propose=lambda memory, *_: (proposal, memory),
        gain=lambda limbs, before, after, appearance: explained[after] - explained[before],
        hidden_joints=lambda memory, projected, images, moved: (np.zeros(4, bool), projected),
    )
    constants, body = SimpleNamespace(settings=Settings()), SimpleNamespace(recovery=recovery)
    frame, memory = SimpleNamespace(images=[], backgrounds=[WALL]), SimpleNamespace(appearance=None)
    deviations = np.ones(ROOT_DOF + 4)
    end = relocation.recover_limbs(constants, body, memory, frame, ended("found"), deviations)  # type: ignore[arg-type]
    assert end.fitted.result.pose == end.limbs == taken
    assert end.relocated.all() == (taken != "found") and not end.resumed.any()


def found_at(gain: float, baseline: float) -> LimbSearchResult:
    """A search whose best particle explains so much."""
    nothing = jnp.zeros((1, 6))
    return LimbSearchResult(nothing, nothing, jnp.array([gain]), jnp.array(baseline))


@pytest.mark.parametrize(("gain", "waits"), [(0.05, True), (0.1, False)])
def test_a_limb_is_searched_for_again_at_once_where_a_place_was_nearly_better(
    tracker, monkeypatch, gain, waits
):
    recovery = tracker.body.recovery
    monkeypatch.setattr(recovery, "_search", lambda *_: found_at(0.3 + gain, 0.3))
    missing = 2 * UNEXPLAINED_SHARE
    proposal, after = proposed(recovery, monkeypatch, explained=0.3, missing=missing)
    assert proposal is None and after.waits.any() == after.failures.any() == waits


@pytest.mark.parametrize(
    ("explained", "missing", "contradicted"),
    [(0.15, 0.5, True), (0.25, 0.5, False), (0.15, 0.0, False), (-0.15, 0.0, True)],
)
def test_a_limb_that_explains_little_is_not_there_where_somebody_is_unexplained(
    tracker, monkeypatch, explained, missing, contradicted
):
    recovery = tracker.body.recovery
    monkeypatch.setattr(recovery, "_search", lambda *_: found_at(explained, explained))
    _, after = proposed(recovery, monkeypatch, explained, missing)
    assert (after.contradicted == contradicted).all()


@pytest.mark.parametrize("contradicted", [True, False])
def test_a_limb_whose_contradiction_ends_is_searched_for_once_more_and_at_once(
    tracker, monkeypatch, contradicted
):
    recovery, searched = tracker.body.recovery, []

    def search(number, *_):
        searched.append(number)
        return found_at(0.5, 0.5)

    monkeypatch.setattr(recovery, "_search", search)
    count = len(recovery.limbs)
    before = recovery.empty_memory()._replace(
        contradicted=np.full(count, contradicted), waits=np.full(count, 3)
    )
    _, after = proposed(recovery, monkeypatch, explained=0.5, missing=0.0, before=before)
    assert len(searched) == count * contradicted and not after.contradicted.any()
    proposed(recovery, monkeypatch, explained=0.5, missing=0.0, before=after)
    assert len(searched) == count * contradicted


def proposed(recovery, monkeypatch, explained: float, missing: float, before=None):
    """What becomes of limbs that all explain so much, while so much is unexplained."""
    finder = SimpleNamespace(
        unexplained_areas=lambda projected: np.full(4, missing),
        nearest_depths=lambda projected: None,
        of_limb=lambda *_: None,
    )
    monkeypatch.setattr(recovery, "evidence", finder)
    monkeypatch.setattr(recovery, "_explains", lambda *_: explained)
    memory = before if before is not None else LimbMemory(
        (None,) * 4, np.zeros(4, int), np.zeros(4, int), None, None, np.zeros(4, bool), 0,
    )  # type: ignore[arg-type]  # fmt: skip
    return recovery.propose(memory, SimpleNamespace(pose=None))


def test_a_forearm_laid_over_its_upper_arm_explains_nothing_twice(tracker):
    surface, cameras = tracker.body.shape.surface, tracker.constants.cameras
    limb = limb_chains(BODY, surface)["arm_l"]
    upper = carrying_bones(surface.points)[0] == limb.bones[0]
    region = Region(np.full((4, 2), -0.5, np.float32), np.full(4, 8.0, np.float32))
    pixels = np.asarray(body_pixels(BODY, bent(elbow_flex_l=0.0), cameras, surface.points)[0])[
        :, upper
    ]
    shown = [covered_cells(at, Region(*r), 128, 0) for at, *r in zip(pixels, *region, strict=True)]
    evidence = LimbEvidence(np.stack(shown).astype(np.float32), region, np.ones(4, bool))
    straight, folded = (
        float(EXPLAINED(BODY, cameras, bent(elbow_flex_l=degrees), limb, evidence))
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
        assert np.sqrt(np.mean((angles[one] - angles[other]) ** 2)) > DISTINCT_RAD - 1e-3
    skipped = np.setdiff1d(np.flatnonzero(worth > worth[chosen[-1]]), chosen)
    for index in skipped:
        away = np.sqrt(np.mean((angles[chosen] - angles[index]) ** 2, 1))
        assert away.min() < DISTINCT_RAD + 1e-3
    assert len(chosen) == FITTED_PARTICLES


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
    history = ImageHistory.empty(1)
    for image, accepted in ((room, True), (walked, True), (room, True), (other, False)):
        kept, history = history.accept([image], SMALL.changed_share, 3)
        assert (kept[0] is not None) == accepted
    torn = np.concatenate([room[:150], np.roll(room[150:], 200, 1)])
    for image, accepted in ((torn, False), (np.zeros_like(room), False), (other, True)):
        kept, history = history.accept([image], SMALL.changed_share, 3)
        assert (kept[0] is not None) == accepted
    assert history.accept([None], 0.25, 3)[0] == [None]


def test_a_camera_that_begins_black_or_comes_less_often_is_taken_when_it_shows_a_room():
    rng = np.random.default_rng(0)
    room, lit = (
        np.repeat(rng.integers(0, 255, (2, 30, 40, 3)), 16, 1).repeat(16, 2).astype(np.uint8)
    )
    history, kept = ImageHistory.empty(1), []
    for image in (np.full_like(room, 4), room, lit, None, lit, None, lit, None, lit):
        used, history = history.accept([image], SMALL.changed_share, 3)
        kept.append(used[0] is not None)
    assert kept == [False, True, False, False, False, False, False, False, True]


def test_a_box_before_a_part_is_recognised_by_its_colour_and_shade_is_not():
    image = np.full((40, 60, 3), (60, 90, 140), np.uint8)
    rows, columns = np.mgrid[10:20, 10:20]
    pixels = np.stack([columns.ravel(), rows.ravel()], 1)[None].repeat(3, 0)
    parts = np.ones((1, 100), bool)
    appearance = PartAppearance.empty(1, 3)
    for frame in range(YOUNGEST):
        darker = np.uint8(image * (1 - 0.1 * frame))
        other, appearance = appearance.compare(3 * [darker], pixels, parts)
        assert not other.any()
    box = image.copy()
    box[8:22, 8:22] = 200
    assert not appearance.compare(3 * [image], pixels, parts)[0].any()
    # One of three cameras is not enough.
    assert not appearance.compare([box, image, image], pixels, parts)[0].any()
    hidden, after = appearance.compare([box, box, image], pixels, parts)
    assert hidden.all() and (after.mean[:, :2] == appearance.mean[:, :2]).all()
    assert not appearance.compare(3 * [None], pixels, parts)[0].any()
