"""An arm of which no silhouette tells: its hue does, and that it cannot be within the trunk."""

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_lost_limbs import EXPLAINED, begun, four_cameras, plain_walls
from test_rim import BODY, bent
from test_silhouette_tracker import SMALL, WALL

from jaxmocap.body.kinematics import forward
from jaxmocap.body.pose import Pose, retract
from jaxmocap.body.skeleton import LANDMARKS
from jaxmocap.body.surfaces.loft import generic_surface
from jaxmocap.body.surfaces.surface import pose_points
from jaxmocap.body.tree import ROOT_DOF
from jaxmocap.silhouette.first_pose import landmark_points
from jaxmocap.silhouette.fit.cycles import fit
from jaxmocap.silhouette.recovery.chromaticity import BodyAppearance
from jaxmocap.silhouette.recovery.limb_likelihood import (
    Obstacles,
    obstacle_rings,
    penetrating_share,
)
from jaxmocap.silhouette.recovery.limbs import bone_ends, carrying_bones, halves_of, limb_chains
from jaxmocap.silhouette.recovery.projected_body import ProjectedBody, body_pixels
from jaxmocap.silhouette.segmentation.outlines import find_outlines
from jaxmocap.silhouette.state import State
from jaxmocap.silhouette.tracker import SilhouetteTracker

WRIST = LANDMARKS.index("wrist_l")
SHIRT, SKIN = (120, 50, 30), (80, 110, 170)
# Of a hue more like skin than like the shirt, and not that of skin.
NEITHER = (108, 117, 135)


def standing(**degrees: float) -> Pose:
    """Facing the first camera, which sees nothing but hands of arms stretched towards it."""
    step = np.zeros(BODY.costs.shape, np.float32)
    step[5] = 0.4
    return retract(bent(**degrees), jnp.asarray(step))


HANGING = standing()
AHEAD = standing(arm_flex_l=90, arm_flex_r=90, arm_abduct_l=0, arm_abduct_r=0)
LOST = standing(arm_flex_r=90, arm_abduct_r=0, arm_flex_l=0, elbow_flex_l=0)
ASIDE = standing(arm_abduct_l=90)
CROSSED = standing(arm_flex_l=35, arm_abduct_l=0, arm_rot_l=70, elbow_flex_l=100)
SIDES = np.array([False, True, False, True])
FOREARM = ("radius_l", "hand_l")


@pytest.fixture(scope="module")
def tracker() -> SilhouetteTracker:
    return four_cameras()


def dressed(tracker: SilhouetteTracker, pose: Pose) -> list[np.ndarray]:
    """The body painted point by point, the farthest first; forearms and hands are bare."""
    points = tracker.body.shape.surface.points
    bare = [BODY.tree.bone(f"{bone}_{side}") for bone in ("radius", "hand") for side in "lr"]
    skin = np.isin(carrying_bones(points)[0], bare)
    images = []
    for pixels, depths in zip(
        *body_pixels(BODY, pose, tracker.constants.cameras, points), strict=True
    ):
        image = np.full((480, 640, 3), WALL, np.uint8)
        places = np.rint(np.asarray(pixels)).astype(int)
        for i in np.argsort(-np.asarray(depths)):
            cv2.circle(image, places[i].tolist(), 2, SKIN if skin[i] else SHIRT, -1)
        images.append(image)
    return images


def off(poses) -> float:
    """Metres from the nearest of some left wrists to the true one."""
    true = np.asarray(landmark_points(BODY, AHEAD))[WRIST]
    actual = [np.asarray(landmark_points(BODY, pose))[WRIST] for pose in poses]
    return float(np.linalg.norm(np.array(actual) - true, axis=1).min())


@pytest.fixture(scope="module")
def state(tracker) -> State:
    """After some frames that show which hues the body has."""
    state, hanging = begun(tracker, HANGING), dressed(tracker, HANGING)
    for _ in range(2):
        state, _, _ = tracker.step(state, 0.0, hanging)
        state = state._replace(time=None)
    return state


def projected_over(tracker, state, pose: Pose, images, used=(True,) * 4) -> ProjectedBody:
    """A pose laid over what cameras show."""
    constants, walls = tracker.constants, plain_walls(tracker)
    rim = constants.finder.find(state.body.shape, pose, constants.cameras)
    outlines = find_outlines(images, walls, rim, state.histograms, SMALL)
    return state.body.recovery.projector.project(pose, outlines, np.array(used), images, walls)


def test_an_arm_that_no_silhouette_misses_is_missed_by_its_colour(tracker, state):
    memory, recovery, images = state.limbs, tracker.body.recovery, dressed(tracker, AHEAD)
    left = recovery.names.index("arm_l")
    # From both sides one arm is before the other, and the lost one before or behind the trunk.
    aside = projected_over(tracker, state, LOST, images, SIDES)
    proposal, after = recovery.propose(memory, aside)
    assert after.contradicted[left] and proposal is not None and proposal.limbs == (left,)
    assert off(proposal.poses) < 0.5 < 0.8 < off([LOST])
    count = len(memory.appearance.frames)
    unknown = memory._replace(appearance=BodyAppearance.empty(count))
    proposal, after = recovery.propose(unknown, aside)
    assert proposal is None and not after.contradicted.any()
    # From ahead it would be seen before the wall.
    every = projected_over(tracker, state, LOST, images)
    assert recovery.propose(unknown, every)[1].contradicted[left]


def boxed(tracker: SilhouetteTracker, *bones: str) -> list[np.ndarray]:
    """Arms ahead, a box before some bones in all images: from both sides, before both arms."""
    images, points = dressed(tracker, AHEAD), tracker.body.shape.surface.points
    behind = np.isin(carrying_bones(points)[0], [BODY.tree.bone(bone) for bone in bones])
    for image, pixels in zip(
        images if bones else (),
        body_pixels(BODY, AHEAD, tracker.constants.cameras, points)[0],
        strict=False,
    ):
        at = np.asarray(pixels)[behind]
        low, high = at.min(0).astype(int) - 5, at.max(0).astype(int) + 5
        image[low[1] : high[1], low[0] : high[0]] = 90
    return images


@pytest.mark.parametrize("box", [False, True])
def test_an_arm_behind_a_box_is_not_seen_and_stays(tracker, state, box):
    recovery, images = tracker.body.recovery, boxed(tracker, *FOREARM if box else ())
    true = projected_over(tracker, state, AHEAD, images)
    proposal, after = recovery.propose(state.limbs, true)
    assert after.contradicted.any() == box and proposal is None
    hidden, _ = recovery.hidden_joints(after, true, images)
    assert hidden[[BODY.tree.joint(f"elbow_flex_{side}") for side in "lr"]].tolist() == [box, box]
    assert not hidden[BODY.tree.joint("knee_flexion_l")]


@pytest.mark.parametrize("box", [False, True])
def test_the_outlines_of_what_hides_an_arm_tell_nothing_of_it(tracker, state, box):
    compiled = fit.kinds
    before = state._replace(pose=AHEAD)
    after, _, report = tracker.step(before, 0.0, boxed(tracker, *FOREARM if box else ()))
    elbow, knee = (ROOT_DOF + BODY.tree.joint(name) for name in ("elbow_flex_l", "knee_flexion_l"))
    precision = np.diagonal(report.information)
    assert precision[knee] > 1e3 and (precision[elbow] == 0 if box else precision[elbow] > 1e3)
    # The next frame's pose has it where it is expected.
    assert after.determined[elbow] != box and after.determined[knee]
    assert fit.kinds == compiled


@pytest.mark.parametrize(("half", "unseen"), [(0, {0, 1}), (1, {1})])
def test_a_forearm_is_not_seen_where_its_upper_arm_is_not(
    tracker, state, monkeypatch, half, unseen
):
    images, recovery = dressed(tracker, ASIDE), tracker.body.recovery
    projected = projected_over(tracker, state, ASIDE, images)
    shown = np.where(np.arange(8) == half, -1.0, 1.0)
    monkeypatch.setattr(
        "jaxmocap.silhouette.recovery.lost_limbs._log_ratios_of_parts", lambda *_: shown
    )
    hidden, _ = recovery.hidden_joints(state.limbs, projected, images)
    np.testing.assert_array_equal(hidden, np.any(recovery.joints[list(unseen)], 0))


def test_an_arm_that_was_learned_as_background_is_not_better_off_unseen(tracker, state):
    recovery = tracker.body.recovery
    left = recovery.names.index("arm_l")
    projected = projected_over(tracker, state, ASIDE, dressed(tracker, ASIDE))
    arms = projected.covered_cells(np.any(recovery.evidence.nodes[:4], 0))
    log_ratios = np.where(arms, np.float32(-2), projected.log_ratios)
    learned = projected._replace(log_ratios=log_ratios)
    proposal, after = recovery.propose(state.limbs, learned)
    assert after.contradicted[left] and proposal is None


@pytest.mark.parametrize(("colour", "low", "high"), [(SKIN, 1.0, 2.5), (NEITHER, -0.1, 0.3)])
def test_what_lies_before_the_trunk_is_the_arm_only_in_its_hue(tracker, state, colour, low, high):
    recovery, images = tracker.body.recovery, dressed(tracker, HANGING)
    points = tracker.body.shape.surface.points
    forearm = np.isin(
        carrying_bones(points)[0], [BODY.tree.bone("radius_l"), BODY.tree.bone("hand_l")]
    )
    pixels, _ = body_pixels(BODY, CROSSED, tracker.constants.cameras, points)
    for image, at in zip(images, np.asarray(pixels)[:, forearm], strict=True):
        for place in np.rint(at).astype(int):
            cv2.circle(image, place.tolist(), 4, colour, -1)
    projected = projected_over(tracker, state, HANGING, images)
    projected = projected._replace(used=np.arange(4) == 0)
    left = recovery.names.index("arm_l")
    finder = recovery.evidence
    depths = finder.nearest_depths(projected)
    evidence = finder.of_limb(left, projected, state.limbs.appearance, depths)
    below = halves_of(recovery.limbs[left])[1]
    cameras = tracker.constants.cameras
    actual = float(EXPLAINED(BODY, cameras, CROSSED, below, evidence))
    assert low < actual < high


@pytest.mark.parametrize(
    ("pose", "low", "high"),
    [(HANGING, 0, 0.02), (AHEAD, 0, 0), (standing(arm_abduct_l=-35, elbow_flex_l=20), 0.3, 1)],
)
def test_an_arm_can_touch_the_trunk_and_not_be_within_it(pose, low, high):
    surface = generic_surface(BODY)
    limb = limb_chains(BODY, surface)["arm_l"]
    around = obstacle_rings(surface, "arm_l")

    @jax.jit
    def share(pose: Pose):
        others = Obstacles.of(pose_points(forward(BODY, pose), around))
        return penetrating_share(*bone_ends(BODY, pose, limb), jnp.asarray(limb.radii), others)

    assert low <= float(share(pose)) <= high
