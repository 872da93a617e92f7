"""A shoulder girdle that goes along with the arm: how far, and what it takes with it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxmocap.synthetic.movements.exercises import exercise
from jaxmocap.synthetic.people.rigged_mesh import load_rig
from jaxmocap.synthetic.people.shoulder_girdle import girdle_angles, girdle_turn

TIMES = np.linspace(0.0, 3.0, 91)


@pytest.fixture(scope="module")
def rig(recordings):
    return load_rig(recordings / "person" / "person.npz", "woman")


def pointing(elevation):
    """A left upper arm raised sideways by so many degrees."""
    turn = np.radians(elevation)
    return np.array([[0.0, np.sin(turn), -np.cos(turn)]])


def test_the_girdle_rests_until_30_degrees_and_reaches_the_published_angles_at_150():
    up, back = girdle_angles(np.array([0.0, 15.0, 150.0]))
    assert up[0] < 0.01 and back[1] < 0.2
    assert 11 <= up[2] <= 15.001 and 15 <= back[2] <= 29


@given(st.floats(0, 175), st.floats(0.5, 5))
def test_who_raises_an_arm_further_raises_the_girdle_further(elevation, more):
    lower, higher = (girdle_angles(np.array(e)) for e in (elevation, elevation + more))
    assert lower[0] < higher[0] and lower[1] < higher[1]


@given(st.floats(0, 180))
def test_left_and_right_girdle_mirror_each_other_and_go_up_and_back(elevation):
    mirror = np.diag([1.0, -1.0, 1.0])
    left = girdle_turn(pointing(elevation), 1.0)[0]
    right = girdle_turn(pointing(elevation) @ mirror, -1.0)[0]
    np.testing.assert_allclose(right, mirror @ left @ mirror, atol=1e-12)
    x, _, z = left @ [0.0, 1.0, 0.0]
    assert x < 0 < z


def test_raised_arms_take_the_shoulders_up_in_and_back_and_point_where_they_did(rig):
    fixed = exercise(rig, "arm_raises").landmarks(TIMES)
    moving = exercise(rig, "arm_raises", girdle=True).landmarks(TIMES)
    at = {name: moving[name] - moving["neck"] for name in moving}
    still = {name: fixed[name] - fixed["neck"] for name in fixed}
    arm = still["elbow_l"] - still["shoulder_l"]
    np.testing.assert_allclose(at["elbow_l"] - at["shoulder_l"], arm, atol=1e-9)
    highest = np.argmax(arm[:, 2])
    gone = (at["shoulder_l"] - still["shoulder_l"])[highest]
    assert gone[0] < -0.03 and -0.03 < gone[1] < -0.004 and 0.03 < gone[2] < 0.07
    lowest = np.argmin(arm[:, 2])
    assert np.linalg.norm((at["shoulder_l"] - still["shoulder_l"])[lowest]) < 0.003
    reach = np.linalg.norm(moving["shoulder_l"] - moving["neck"], axis=1)
    assert np.ptp(reach) > 0.005
