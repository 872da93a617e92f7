"""A full set of markers: the body is fitted to them, follows the trunk's turn, and ± follows."""

import tomllib
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from held_devices import write_turning_head

from jaxmocap import Recording, Settings
from jaxmocap.body.kinematics import forward, landmarks, site_positions
from jaxmocap.body.model import marker_sites
from jaxmocap.body.pose import Pose, beyond_limits
from jaxmocap.body.skeleton import LANDMARKS, Skeleton
from jaxmocap.calibration.fitting.marker_poses import FIT_POSES, TAILS
from jaxmocap.formats.recordings.recording import load_recording
from jaxmocap.formats.time_series.markers import read_markers
from jaxmocap.formats.time_series.trc import write_trc
from jaxmocap.hybrid.tracker import HybridTracker
from jaxmocap.outputs.report import misfit
from jaxmocap.pipelines.summary import summary
from jaxmocap.pipelines.tracking.marked import cheapest
from jaxmocap.pipelines.tracking.track import track

SET = '[markers]\nfile = "markers.trc"\nset = "plug-in-gait"\n'
SUBJECT = "[subject]\nheight = 1.7\n"


@pytest.fixture(scope="module")
def twisted(tmp_path_factory):
    """Somebody of another build, markers 1.5 cm elsewhere, who twists the trunk and swings arms."""
    folder = tmp_path_factory.mktemp("twisted")
    labels = labels_of_set()
    times = np.arange(160) / 50
    write_trc(folder / "markers.trc", times, {label: np.ones((160, 3)) for label in labels})
    (folder / "recording.toml").write_text(SET + SUBJECT)
    stated = load_recording(folder / "recording.toml")
    random = np.random.default_rng(3)
    skeleton = replace(stated.skeleton, lengths=stated.skeleton.lengths * 1.04)
    sites = marker_sites(skeleton, stated.places)
    shift = 0.015 * random.normal(size=(len(stated.places), 3)) / np.sqrt(3)
    sites = replace(sites, offsets=sites.offsets + jnp.asarray(shift, sites.offsets.dtype))
    angles = np.tile(np.asarray(skeleton.relaxed), (160, 1))
    swing = np.sin(2 * np.pi * times / 1.6)
    for joint, degrees in (
        ("spine2_rotation", 35), ("arm_flex_l", 40), ("arm_flex_r", -40), ("knee_flexion_l", 10),
        ("elbow_flex_l", 20), ("elbow_flex_r", 20), ("neck_rotation", 30),
    ):  # fmt: skip
        angles[:, skeleton.tree.joint(joint)] += np.radians(degrees) * swing
    still = np.tile([0.0, 0.0, 0.95], (160, 1)), np.tile([1.0, 0.0, 0.0, 0.0], (160, 1))
    poses = Pose(*(jnp.asarray(part, float) for part in (*still, angles)))
    seen = jax.jit(jax.vmap(lambda pose: site_positions(skeleton, forward(skeleton, pose), sites)))
    markers = np.array(seen(poses)) + 0.001 * random.normal(size=(160, len(stated.places), 3))
    truth = np.asarray(jax.jit(jax.vmap(lambda pose: landmarks(skeleton, pose)))(poses))
    markers[20:30, 5] = np.nan
    names = [place.name for place in stated.places]
    left, right = names.index("LWRA"), names.index("RWRA")
    markers[40:43, [left, right]] = markers[40:43, [right, left]]
    points = {name: markers[:, i] for i, name in enumerate(names)}
    write_trc(folder / "markers.trc", times, points)
    return folder, truth


def labels_of_set() -> list[str]:
    from jaxmocap.formats.marker_sets.sets import set_file

    return list(set_file("plug-in-gait")[0])


@pytest.fixture(scope="module")
def tracked(twisted):
    return track(load_recording(twisted[0] / "recording.toml"))


def test_a_full_set_is_met_and_the_sentence_says_what_was_fitted(tracked):
    assert tracked.report is not None
    errors = tracked.report.marker_errors
    assert np.nanmean(errors) < 0.01 and np.nanmedian(errors, 0).max() < 0.02
    assert "fitted" in summary(tracked) and "30 markers" in tracked.report.run.fitted
    assert misfit(tracked) is None


def test_few_samples_are_counted_once_and_a_gap_is_passed_through(twisted):
    recording = load_recording(twisted[0] / "recording.toml")
    rows, missing = [60, 61, 62, 63, 64], 2
    positions = recording.positions_world[rows]
    positions[missing] = np.nan
    found = track(replace(recording, times=recording.times[rows], positions_world=positions))
    assert "4 samples" in found.report.run.fitted
    angles = found.poses.angles
    np.testing.assert_allclose(angles[missing], angles[[1, 3]].mean(0), atol=1e-4)


def test_the_joints_follow_a_twisted_trunk_and_their_deviations_follow_from_the_markers(
    tracked, twisted
):
    points = np.stack([tracked.joints()[name] for name in LANDMARKS], 1)
    limbs = [
        LANDMARKS.index(f"{joint}_{side}")
        for joint in ("shoulder", "elbow", "wrist", "knee", "ankle")
        for side in "lr"
    ]
    apart = np.linalg.norm(points - twisted[1], axis=-1)[:, limbs]
    assert apart.mean() < 0.03
    twist = np.degrees(tracked.poses.angles[:, tracked.skeleton.tree.joint("spine2_rotation")])
    assert 25 < twist.max() < 45 and -45 < twist.min() < -25
    assert np.nanmedian(tracked.report.elbow_deviations) < 0.04


def test_without_fit_places_and_lengths_stay_as_stated(twisted):
    folder, _ = twisted
    text = SET.replace("[markers]", "[markers]\nfit = false") + SUBJECT
    (folder / "unfitted.toml").write_text(text)
    recording = load_recording(folder / "unfitted.toml")
    motion = track(recording)
    assert np.array_equal(motion.skeleton.lengths, recording.skeleton.lengths)
    assert motion.report is not None and not motion.report.run.fitted


def test_few_markers_leave_the_body_as_it_is(tmp_path):
    points = {name: np.ones((3, 3)) for name in ("Head", "L", "R")}
    write_trc(tmp_path / "markers.trc", np.arange(3) / 50, points)
    on = 'Head = { bone = "head" }\nL = { bone = "radius_l" }\nR = { bone = "radius_r" }\n'
    text = f'[markers]\nfile = "markers.trc"\n[markers.on]\n{on}{SUBJECT}'
    (tmp_path / "recording.toml").write_text(text)
    joints = load_recording(tmp_path / "recording.toml").skeleton.tree.joints
    assert joints == Skeleton.human(1.7).tree.joints


def test_joints_of_real_people_lie_within_what_is_stated(recordings, tmp_path):
    """Elbows, shoulders, hips and knees beside Plug-in Gait's, from the stature alone."""
    inside = []
    for name in ("person_01", "person_06"):
        person = recordings / "people" / name
        height = tomllib.loads((person / "person.toml").read_text())["height"]
        text = f'[markers]\nfile = "{person}/turn.trc"\nset = "plug-in-gait"\n'
        (tmp_path / "recording.toml").write_text(f"{text}[subject]\nheight = {height}\n")
        motion = track(load_recording(tmp_path / "recording.toml"))
        assert motion.report is not None
        reference, joints = read_markers(person / "turn.trc"), motion.joints()
        for part in ("Elbow", "Shoulder", "Hip", "Knee"):
            for side in ("l", "r"):
                own = f"{part.lower()}_{side}"
                truth = reference.positions[:, reference.names.index(side.upper() + part)]
                off = np.linalg.norm(joints[own] - truth, axis=1)
                std = np.asarray(motion.report.landmarks_std)[:, LANDMARKS.index(own)]
                # 90 % of a normal error in three dimensions are within 2.5 deviations of one.
                inside.append(np.mean(off < 2.5 * np.sqrt((std**2).mean(-1))))
    assert np.mean(inside) > 0.8


def test_an_elbow_that_turned_through_its_back_is_found_the_right_way_round(twisted, tracked):
    """By the samples beside it, and by its own pose with all joints in their ranges."""
    recording = load_recording(twisted[0] / "recording.toml")
    model = HybridTracker.from_recording(recording).model
    markers = recording.positions_world[:4].astype(np.float32)
    start = jax.tree.map(lambda part: np.asarray(part[:4], np.float32), tracked.poses)
    right = FIT_POSES(model, start, markers, np.float32(TAILS))
    angles, elbow = np.array(right.poses.angles), model.skeleton.tree.joint("elbow_flex_l")
    angles[1:3, elbow] += 1.5 * np.pi
    wrong = FIT_POSES(model, right.poses._replace(angles=angles), markers, np.float32(TAILS))
    assert (np.asarray(wrong.cost) > np.asarray(right.cost) + 5)[1:3].all()
    found = cheapest(model, wrong, markers)
    np.testing.assert_allclose(found.cost, right.cost, rtol=0.01)
    beyond = beyond_limits(model.skeleton.limits, found.poses.angles)
    assert beyond.max() < np.radians(20)


# A head that turns --------------------------------------------------------------------------------


# What a measured head or hand may be off in 95 % of the samples, metres and degrees.
HELD_M, HELD_DEG = 0.01, 3.0


@pytest.mark.slow
@pytest.mark.parametrize("oriented", [True, False])
@pytest.mark.parametrize("way", ["smoothed", "frame by frame", "no video"])
def test_measured_head_and_hands_hold_while_the_head_turns(tmp_path, way, oriented):
    path, R_world_head = write_turning_head(tmp_path, oriented=oriented, filmed=way != "no video")
    recording, settings = Recording.load(path), Settings()
    settings = replace(settings, smooth=way == "smoothed")
    poses = jax.tree.map(np.asarray, track(recording, settings, mode="causal").poses)
    model = HybridTracker.from_recording(recording, settings).model

    def placed(pose):
        frames = forward(model.skeleton, pose)
        head = frames.R_world_bone[model.skeleton.tree.bone("head")]
        return site_positions(model.skeleton, frames, model.markers), head

    points, R = jax.jit(jax.vmap(placed))(poses)
    off = np.linalg.norm(np.asarray(points) - recording.positions_world, axis=-1)
    assert np.percentile(off, 95) < HELD_M
    if oriented:
        between = np.einsum("tij,tij->t", np.asarray(R), R_world_head)
        turned = np.degrees(np.arccos(np.clip((between - 1) / 2, -1, 1)))
        assert np.percentile(turned, 95) < HELD_DEG
