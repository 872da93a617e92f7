"""The public functions' doors: what does not fit is refused at once, in one sentence."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxmocap
from jaxmocap import Events, HybridTracker, Model, Pose, Settings, Skeleton
from jaxmocap.compilation.programs import Program, keep_in
from jaxmocap.compilation.settings import settings, traced
from jaxmocap.evidence.terms import Measurements
from jaxmocap.geometry.cameras import Camera, stack_cameras
from jaxmocap.hybrid.observe import images_of
from jaxmocap.pipelines.kept_programs import keep_compiled
from jaxmocap.smoothing.functions import check_events

MODEL, CHOSEN = Model.create(Skeleton.human(1.75)), Settings()
MARKERS = np.array([[0, 0, 1.7], [0.3, 0.3, 1.0], [0.3, -0.3, 1.1]])
LENGTHS = MODEL.skeleton.lengths
POSE = Pose(np.zeros(3), np.eye(4)[0], np.zeros(21))
BATCH = "jax.vmap takes several at once"


def several(tree, count=3):
    return jax.tree.map(lambda part: np.stack([np.asarray(part)] * count), tree)


def with_skeleton(**parts):
    return replace(MODEL, skeleton=replace(MODEL.skeleton, **parts))


@pytest.mark.parametrize(
    ("markers", "error", "sentence"),
    [
        (MARKERS[:2], ValueError, r"found shape \(2, 3\), expected \(3, 3\).*on head, hand_l"),
        (several(MARKERS), ValueError, rf"found shape \(3, 3, 3\), expected \(3, 3\); {BATCH}"),
        (np.zeros((3, 4)), ValueError, r"found shape \(3, 4\)"),
        ([[1.0, 2.0], [3.0]], TypeError, "found list, expected an array of real numbers"),
        ("markers", TypeError, "expected an array of real numbers"),
        (1j * MARKERS, TypeError, "found an array of complex128"),
        (None, TypeError, "found NoneType"),
    ],
)
def test_markers_that_do_not_fit_are_refused_in_one_sentence(markers, error, sentence):
    with pytest.raises(error, match=f"^markers_world: .*{sentence}"):
        jaxmocap.solve(MODEL, CHOSEN, markers)


def test_a_trace_is_refused_at_the_door_too():
    with pytest.raises(ValueError, match=r"^markers_world: found shape"):
        jax.jit(jaxmocap.solve)(MODEL, CHOSEN, MARKERS[:2])


@pytest.mark.parametrize(
    ("arguments", "error", "sentence"),
    [
        ((MODEL.skeleton, CHOSEN), TypeError, "model: found Skeleton, expected Model"),
        ((MODEL, None), TypeError, "settings: found NoneType, expected Settings"),
        ((with_skeleton(lengths=several(LENGTHS)), CHOSEN), ValueError, BATCH),
        ((with_skeleton(lengths=[0.3] * 21), CHOSEN), TypeError, "model.skeleton.lengths: found"),
        ((with_skeleton(masses=np.ones(3)), CHOSEN), ValueError, "model.skeleton.masses: found"),
        ((MODEL, replace(CHOSEN, margin=np.ones(4))), ValueError, "settings.margin: found shape"),
    ],
)
def test_models_and_settings_that_do_not_fit_are_refused(arguments, error, sentence):
    with pytest.raises(error, match=sentence):
        jaxmocap.solve(*arguments, MARKERS)


@pytest.mark.parametrize(
    ("pose", "error", "sentence"),
    [
        (tuple(POSE), TypeError, "pose: found tuple, expected Pose"),
        (several(POSE), ValueError, BATCH),
        (POSE._replace(angles=np.zeros(20)), ValueError, r"pose.angles: found shape \(20,\)"),
    ],
)
def test_poses_that_do_not_fit_are_refused(pose, error, sentence):
    with pytest.raises(error, match=sentence):
        jaxmocap.landmarks(MODEL, pose)


def measured(count, **others):
    shapes = {"markers": (3, 3), "upright": (2,), "facing": (3,), "ankles": (2, 3)}
    zeros = {name: np.zeros((count, *shape)) for name, shape in shapes.items()}
    return Measurements(**(zeros | others))


@pytest.mark.parametrize(
    ("events", "error", "sentence"),
    [
        (None, TypeError, "events: found NoneType, expected Events"),
        (Events(np.arange(2.0), measured(2), several(POSE, 2)), ValueError, "found 2, expected 3"),
        (Events(np.arange(4.0), Measurements(), several(POSE, 4)), ValueError, "markers is miss"),
        (Events(np.arange(4.0), {}, several(POSE, 4)), TypeError, "expected Measurements"),
        (Events(np.ones(4), measured(4), several(POSE, 4)), ValueError, "seconds that ascend"),
        (
            Events(np.arange(4.0), measured(4, markers=np.zeros((4, 2, 3))), several(POSE, 4)),
            ValueError,
            r"measured.markers: found shape \(4, 2, 3\), expected \(4, 3, 3\)",
        ),
        (Events(np.arange(4.0), measured(4), several(POSE, 5)), ValueError, "events.poses"),
        (Events(np.zeros((2, 4)), measured(4), several(POSE, 4)), ValueError, BATCH),
    ],
)
def test_events_that_do_not_fit_are_refused(events, error, sentence):
    with pytest.raises(error, match=sentence):
        jaxmocap.smooth(MODEL, CHOSEN, events)


@pytest.mark.parametrize("begun", [0.0, 50_000.0, 1.7e9])
def test_only_the_time_between_events_counts(begun):
    times = begun + np.arange(4) / 30
    events = Events(times, measured(4), several(POSE, 4))
    np.testing.assert_allclose(check_events(MODEL, events).times, np.arange(4) / 30, atol=1e-6)
    given = jax.jit(lambda times: check_events(MODEL, events._replace(times=times)).times)
    np.testing.assert_array_equal(given(jnp.arange(4.0)), np.arange(4))


def test_images_that_are_no_images_of_the_cameras_are_refused():
    matrix = np.array([[600.0, 0, 320], [0, 600, 240], [0, 0, 1]])
    camera = stack_cameras([Camera.create((640, 480), matrix)])
    grey = np.zeros((480, 640), np.uint8)
    for image in (grey, np.zeros((480, 640, 3), np.uint8), np.zeros((478, 640), np.uint8)):
        (found,) = images_of(camera, [image])
        assert found is image
    assert images_of(camera, grey)[0] is grey and images_of(None, []) == []
    assert images_of(camera, None) is None and images_of(camera, [None]) == [None]
    for images in (jnp.asarray(grey), [jnp.asarray(grey)]):
        assert [type(image) for image in images_of(camera, images)] == [np.ndarray]
    for images, sentence in (
        ([grey, grey], "found 2 images, expected one for each of the model's 1 cameras"),
        ([grey[::2, ::2]], "found an image of 320 × 240 pixels, calibrated for 640 × 480"),
        ([grey.astype(float)], r"found an image of shape \(480, 640\) and float64, expected"),
        ([np.zeros((480, 640, 2), np.uint8)], r"shape \(480, 640, 2\)"),
    ):
        with pytest.raises(ValueError, match=sentence):
            images_of(camera, images)


def test_whole_numbers_and_lists_are_taken_and_a_solve_alone_is_compiled_once():
    whole = np.array([[0, 0, 2], [0, 1, 1], [0, -1, 1]])
    expected = jaxmocap.solve(MODEL, CHOSEN, whole.astype(float))
    for same in (whole, whole.tolist()):
        pose = jaxmocap.solve(MODEL, CHOSEN, same)
        np.testing.assert_array_equal(pose.angles, expected.angles)
    assert expected.angles.dtype == MODEL.dtype


def test_bones_get_other_lengths_by_name():
    longer = MODEL.with_lengths(humerus_l=0.31, humerus_r=1)
    tree = MODEL.skeleton.tree
    changed = np.flatnonzero(np.asarray(longer.skeleton.lengths != LENGTHS))
    assert set(changed) == {tree.bone("humerus_l"), tree.bone("humerus_r")}
    slope = jax.grad(lambda x: MODEL.with_lengths(femur_l=x).skeleton.lengths.sum())(0.4)
    assert float(slope) == 1
    each = jax.vmap(lambda x: MODEL.with_lengths(femur_l=x).skeleton.lengths)(jnp.arange(3.0))
    assert each.shape == (3, len(LENGTHS))
    with pytest.raises(KeyError, match="unknown bone 'humerus'; the bones are spine1"):
        MODEL.with_lengths(humerus=0.3)
    with pytest.raises(ValueError, match=rf"femur_l: found shape \(2,\), .*{BATCH}"):
        MODEL.with_lengths(femur_l=[0.4, 0.5])


def test_the_tracker_names_what_can_be_traced_in_its_place():
    tracker = HybridTracker(Skeleton.human(1.75))
    with pytest.raises(TypeError, match=r"HybridTracker.init .*jaxmocap.solve, refine"):
        jax.jit(tracker.init)(MARKERS)
    with pytest.raises(TypeError, match=r"HybridTracker.step .*cannot be traced"):
        jax.lax.scan(lambda state, m: tracker.step(state, 0.0, m)[:2], None, several(MARKERS))
    with pytest.raises(ValueError, match=r"markers_world: found shape \(2, 3\)"):
        tracker.init(MARKERS[:2])


class InMemory(dict):
    """A store of programs."""

    def read(self, name, key):
        return self.get(key)

    def write(self, name, key, content):
        self[key] = content


def test_a_program_with_a_users_own_class_is_traced_again_at_every_start():
    """Its code may have changed since."""
    keep_in(store := InMemory())
    try:
        for factor in (2.0, 3.0):

            @settings
            class Own:
                scale: jax.Array = traced(1.0, "of it")

                def scaled(self, x, factor=factor):
                    return factor * self.scale * x

            own = Program(lambda own, x: own.scaled(x), "own")
            assert float(own(Own(), np.float32(1))) == factor
        assert not store
        assert float(Program(lambda x: 2 * x, "ours")(np.float32(1))) == 2 and store
    finally:
        keep_compiled()
