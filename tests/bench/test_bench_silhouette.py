"""The silhouette tracker's benchmark: its tables, and stages that make up the frame."""

from time import sleep

import numpy as np
import pytest

from bench.clips import true_skeleton
from bench.clock import REST, STAGES, WHOLE_FRAME, StageClock, stages_timed
from bench.evaluation import AccelerationAndLag
from bench.silhouette import Result, camera_rows, exercise_rows, metrics, real_rows
from jaxmocap.body.kinematics import landmarks
from jaxmocap.body.pose import relaxed_pose
from jaxmocap.body.skeleton import LANDMARKS, Skeleton
from jaxmocap.evaluation.errors import Errors
from jaxmocap.pipelines.silhouettes.demo import JOINTS
from jaxmocap.silhouette import tracker
from jaxmocap.silhouette.fit import cycles


def result(name: str, cameras: int, off_m: float, bend_deg: float) -> Result:
    """All joints so far off along x; elbows bent off by so much, knees by half of it."""
    offsets = np.zeros((3, len(JOINTS), 3))
    offsets[..., 0] = off_m
    bend = np.radians(bend_deg)
    off = {f"{h}_{s}": np.full(3, bend / k) for h, k in (("elbow", 1), ("knee", 2)) for s in "lr"}
    truths, still = np.full(len(JOINTS), 2.0), np.zeros(len(JOINTS))
    calm = AccelerationAndLag(1.5 * truths, truths, still, still)
    return Result(name, cameras, Errors(tuple(JOINTS), np.arange(3.0), offsets), off, calm)


def test_tables_show_degrees_and_centimetres_and_their_means():
    results = [result("walking", 4, 0.01, 2.0), result("turn", 4, 0.03, 4.0)]
    rows = exercise_rows(results)
    assert rows[2][:4] == ["walking", "2.0", "1.0", "1.0"]
    assert rows[-1] == ["mean", "3.0", "1.5", *["2.0"] * 7, "1.5"]
    fewer = [result("walking", 1, 0.05, 8.0), result("turn", 1, 0.05, 8.0)]
    rows = camera_rows([*results, *fewer])
    assert rows[0][1:] == ["4 cam.", "1 cam."] * 2
    assert rows[-1] == ["mean", "2.2", "6.0", "2.0", "5.0"]


def test_the_real_recording_is_judged_by_eight_joints():
    real = result("balancing", 4, 0.02, 5.0)
    places = [name.split("_")[0] in ("wrist", "ankle") for name in real.errors.joints]
    real.errors.offsets[:, places] = 1.0
    assert real_rows(real)[-1][-3:] == ["2.0", "5.0", "1.5"]
    named = {metric.name: metric.value for metric in metrics(real)}
    assert named["balancing, 4 cameras, all four kinds"] == pytest.approx(2.0)
    assert named["balancing, 4 cameras, joints"] > 30


def test_a_stage_does_not_count_those_that_it_calls():
    clock = StageClock()
    fit = clock.time_stage("fit", sleep)
    again = clock.time_stage("hypotheses", lambda: (sleep(0.002), fit(0.01)))
    clock.step(again)()
    (spent,) = clock.frames
    assert spent["fit"] >= 10 and spent["hypotheses"] >= 2
    assert spent[WHOLE_FRAME] == pytest.approx(sum(spent[k] for k in ("fit", "hypotheses", REST)))


def test_every_stage_is_there_to_be_timed_and_is_itself_again_afterwards():
    before = cycles.fit, tracker.SilhouetteTracker.step
    with stages_timed() as clock:
        assert cycles.fit is not before[0]
        assert tracker.SilhouetteTracker.step is not before[1]
    assert (cycles.fit, tracker.SilhouetteTracker.step) == before
    assert clock.frames == [] and {"rim", "segmentation", "fit"} < {*STAGES}


def test_who_lies_throughout_has_the_truths_bones_too():
    skeleton = Skeleton.human()
    here = np.asarray(landmarks(skeleton, relaxed_pose(skeleton)))[:, [2, 0, 1]]
    lying = {name: place[None] for name, place in zip(LANDMARKS, here, strict=True)}
    legs = skeleton.tree.bones_in("leg", side="l")[:2]
    found = true_skeleton(Skeleton.human(), lying)
    np.testing.assert_allclose(found.lengths[legs], skeleton.lengths[legs], rtol=1e-4)
