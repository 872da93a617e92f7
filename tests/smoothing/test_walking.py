"""What walkers do, where head and hands leave a body open."""

import jax
import numpy as np
import pytest

from bench.people import as_toml, learned, walks
from jaxmocap.body.model import Model
from jaxmocap.body.model_files import data_of
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.evidence.posture import USUAL, UsualPlaces
from jaxmocap.evidence.terms import Measurements, posed_body
from jaxmocap.hybrid.functions import solve
from jaxmocap.hybrid.settings import Settings
from jaxmocap.smoothing.walking import Walk, usual_habits, walkers_measurements

TIMES, STATURE = np.arange(200) / 100, 1.5
STEPS = {"walks": (1.3, 0.0), "stands": (0.0, 0.0), "walks backwards": (-1.3, 0.0)}


def markers(velocity, lift: float = 0.0, turned: float = 0.0) -> np.ndarray:
    """(T, 3, 3) crown, left and right hand of somebody who faces +x; hands err by a turn, radians.

    Args:
        velocity: metres a second.
        lift: of the hands, metres.
        turned: of the line between the hands.
    """
    usual = usual_habits().hand[0] * STATURE
    c, s = np.cos(turned), np.sin(turned)
    sides = ([usual[0], usual[1]], [usual[0], -usual[1]])
    hands = [[x * c - y * s, x * s + y * c, usual[2] + lift] for x, y in sides]
    crown = np.array([0.0, 0.0, STATURE])
    still = crown + np.array([[0.0, 0.0, 0.0], *hands])
    return still + TIMES[:, None, None] * np.array([*velocity, 0.0])


def measured(velocity, **how) -> tuple[dict, float]:
    model = Model.create(Skeleton.human(STATURE))
    points = markers(velocity, **how)
    turn = how.get("turned", 0.0)
    pose = solve(model, Settings(), points[0].astype(np.float32))
    poses = jax.tree.map(lambda part: np.repeat(np.asarray(part)[None], len(TIMES), 0), pose)
    moved = poses._replace(position=poses.position + (points - points[:1])[:, 0])
    ahead = np.tile([np.cos(turn), np.sin(turn), 0.0], (len(TIMES), 1))
    return walkers_measurements(model, TIMES, points, moved, ahead, usual_habits())


def test_walkers_face_where_they_walk_and_not_where_hands_swing():
    points = markers((1.3, 0.0), turned=0.5)
    ahead = np.tile([np.cos(0.5), np.sin(0.5)], (len(TIMES), 1))
    walk = Walk.of(TIMES, ahead, points[:, 0], [points[:, 1], points[:, 2]], STATURE)
    facing = walk.axes[:, 0]
    assert np.degrees(np.arccos(facing[:, 0])).max() < 10
    assert walk.goes.min() == 1.0


@pytest.mark.parametrize("step", ["stands", "walks backwards"])
def test_who_does_not_walk_ahead_is_left_alone(step):
    assert measured(STEPS[step]) == ({}, 0.0)


def test_lifted_hands_leave_nothing_usual():
    hanging, samples = measured(STEPS["walks"])
    lifted, fewer = measured(STEPS["walks"], lift=0.4)
    assert samples > 0.9 * len(TIMES) and fewer < 0.01 * len(TIMES)
    size = [np.abs(each["usual"].roots[:]).max((1, 2, 3)).mean() for each in (hanging, lifted)]
    assert size[1] < 0.01 * size[0]


def test_elbows_are_behind_the_line_from_shoulder_to_hand_on_either_side():
    usual = measured(STEPS["walks"])[0]["usual"]
    left, right = (usual.places[100, USUAL.index(f"elbow_{side}")] for side in "lr")
    np.testing.assert_allclose(left[[0, 2]], right[[0, 2]], atol=1e-4)
    assert left[1] == pytest.approx(-right[1], abs=1e-4) and left[1] > 0.1
    crown = markers(STEPS["walks"])[100, 0]
    assert left[0] < crown[0] - 0.04


def test_the_term_is_white_about_the_usual_places():
    model = Model.create(Skeleton.human(STATURE))
    usual = measured(STEPS["walks"])[0]["usual"]
    pose = solve(model, Settings(), markers(STEPS["walks"])[100].astype(np.float32))
    term, own = UsualPlaces(), type(usual)(*(part[100] for part in usual))

    @jax.jit
    def residual_of(pose, measured):
        return term.residual(model, posed_body(model, pose), measured)

    residual = np.asarray(residual_of(pose, Measurements(usual=own)))
    assert residual.shape == (len(USUAL), 3)
    # Of ankles and pelvis the height is open.
    np.testing.assert_allclose(residual[2:, 2], 0.0, atol=1e-5)
    assert len(residual_of(pose, Measurements())) == 0


def test_the_numbers_are_those_of_the_people(recordings):
    people = sorted((recordings / "people").glob("person_*"))
    stated, habits = data_of("walking.toml"), learned([walks(folder) for folder in people])
    for name in ("elbow", "ankle", "pelvis"):
        for key, values in getattr(habits, name)._asdict().items():
            np.testing.assert_allclose(stated[name][key], values, atol=1e-4, err_msg=name)
    np.testing.assert_allclose(stated["hand"]["place"], habits.hand[0], atol=1e-4)
    assert "[elbow]" in as_toml(habits)
