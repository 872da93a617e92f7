"""How sure landmarks would be without each marker, camera and prior."""

from dataclasses import replace

import numpy as np
import pytest
from painted_motion import SETTINGS, measurements, problem, truth, views

from jaxmocap.body.skeleton import LANDMARKS
from jaxmocap.evidence.posture import RelaxedPosture
from jaxmocap.smoothing import uncertainty
from jaxmocap.smoothing.linearise import smooth_poses
from jaxmocap.smoothing.problem import LeftOut, SmoothingProblem, Trajectory
from jaxmocap.smoothing.uncertainty import deviations_without, leave_one_out, with_deviations

COUNT, SOFTNESS = 9, 0.8
BOTH = (0, 1)
ARMS = [LANDMARKS.index(f"{part}_{side}") for part in ("elbow", "wrist") for side in "lr"]


def start() -> Trajectory:
    return Trajectory(truth(COUNT), np.zeros(0, np.float32))


def found(given: SmoothingProblem) -> tuple[LeftOut, ...]:
    shares: list[float] = []
    parts = leave_one_out(given, start(), SOFTNESS, shares.append).left_out
    assert shares[-1] == 1 and parts
    return parts


@pytest.fixture(scope="module")
def left_out() -> tuple[LeftOut, ...]:
    return found(problem(COUNT, views(COUNT, BOTH)))


def of(left_out, kind, which=None) -> np.ndarray:
    (part,) = (part for part in left_out if (part.kind, part.which) == (kind, which))
    return part.deviations


def stated(given: SmoothingProblem, trajectory: Trajectory | None = None) -> np.ndarray:
    """Medians (L,) of what is stated of a problem."""
    three = with_deviations(given, trajectory or start(), SOFTNESS).deviations
    assert three is not None
    return np.median(np.linalg.norm(three, axis=-1), 0)


def test_what_is_left_out_counts_as_if_it_had_not_been_there(left_out):
    everything = problem(COUNT, views(COUNT, BOTH))
    np.testing.assert_allclose(of(left_out, "nothing"), stated(everything), rtol=1e-5)
    fewer = measurements(COUNT)
    fewer.markers[:, 1] = np.nan
    without = problem(COUNT, views(COUNT, BOTH), fewer)
    np.testing.assert_allclose(of(left_out, "marker", 1), stated(without), rtol=1e-5)
    for camera, other in ((0, 1), (1, 0)):
        alone = problem(COUNT, views(COUNT, (other,)))
        np.testing.assert_allclose(of(left_out, "camera", camera), stated(alone), rtol=1e-5)
    vain = replace(SETTINGS, posture=RelaxedPosture(*[np.float32(1e4)] * 2))
    expected = stated(replace(everything, settings=vain))
    np.testing.assert_allclose(of(left_out, "prior", "posture"), expected, rtol=1e-4)


def test_a_solve_without_a_camera_is_as_unsure_as_was_foretold(left_out):
    alone = problem(COUNT, views(COUNT, (1,)))
    solved = smooth_poses(alone, start(), (SOFTNESS,)).trajectory
    actual, foretold = stated(alone, solved)[ARMS], of(left_out, "camera", 0)[ARMS]
    np.testing.assert_allclose(actual, foretold, rtol=0.15)


def test_with_less_evidence_nothing_is_surer(left_out):
    everything = of(left_out, "nothing")
    for part in left_out:
        # In moments by themselves what is usual counts fully: feet that nothing shows are surer.
        which = ARMS if part.which == "motion" else slice(None)
        assert (part.deviations > everything - 1e-5)[which].all(), (part.kind, part.which)
    wrist = LANDMARKS.index("wrist_l")
    assert of(left_out, "marker", 1)[wrist] > 3 * everything[wrist]


def test_of_a_long_recording_its_middle_is_taken(left_out, monkeypatch):
    monkeypatch.setattr(uncertainty, "MOST_EVENTS", 5)
    some = found(problem(COUNT, views(COUNT, BOTH)))
    for part in some:
        whole = of(left_out, part.kind, part.which)
        np.testing.assert_allclose(part.deviations, whole, rtol=0.6)


def test_only_what_a_landmark_depends_on_is_listed_and_by_its_name(left_out):
    listed = deviations_without(left_out, ("Hat", "Left", "Right"), ("front", "side"))
    assert list(listed) == list(LANDMARKS)
    assert next(iter(listed["wrist_l"])) == "nothing"
    assert "marker Left" in listed["wrist_l"] and "marker Right" not in listed["wrist_l"]
    assert {"camera front", "camera side"} <= set(listed["elbow_l"])
    assert deviations_without((), (), ()) == {}
