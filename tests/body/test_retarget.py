"""A motion played by another person."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxmocap.body.motion import Motion
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.cli.program import main
from jaxmocap.formats.motion_npz import load_motion, save_motion
from jaxmocap.pipelines.retarget import (
    RetargetedMotion,
    feet,
    ground_contacts,
    retarget_motion,
)

PERSON = Skeleton.human(1.75)
TIMES = np.arange(50) / 30


def on_one_foot(skeleton: Skeleton = PERSON) -> Motion:
    """Knees bend and stretch, the left ankle stays where it is, the right foot is in the air."""
    tree, bend = skeleton.tree, 0.6 * np.sin(2 * np.pi * TIMES / 1.6) ** 2
    angles = np.tile(np.asarray(skeleton.relaxed), (len(TIMES), 1))
    for name, factor in (("hip_flexion_l", 1.0), ("knee_flexion_l", 2.0)):
        angles[:, tree.joint(name)] = factor * bend
    angles[:, tree.joint("knee_flexion_r")] = 1.2 + 0.3 * bend
    level = np.tile(np.eye(4)[0], (len(TIMES), 1))
    poses = Pose(*(jnp.asarray(part, jnp.float32) for part in (np.zeros((50, 3)), level, angles)))
    place = np.array([0.3, -0.2, 0.08]) - feet(skeleton, poses)[:, 0]
    return Motion(skeleton, TIMES, poses._replace(position=jnp.asarray(place, jnp.float32)))


def other_proportions() -> Skeleton:
    """Long thighs, short shanks: the way of the first person's pelvis does not fit them."""
    usual = Skeleton.human(1.6)
    factor = {"femur": 1.2, "tibia": 0.8}
    factors = [factor.get(name.split("_")[0], 1.0) for name in usual.tree.bones]
    return replace(usual, lengths=usual.lengths * jnp.asarray(factors, jnp.float32))


def test_the_foot_that_stood_stands_for_the_other_person_too():
    motion, other = on_one_foot(), other_proportions()
    before = feet(PERSON, motion.poses)
    assert ground_contacts(before)[:, 0].all()
    played = retarget_motion(motion, other)
    after = feet(other, played.poses)
    assert np.ptp(after[:, 0], axis=0).max() < 0.01
    # As the pelvis went, scaled alone, it would slide by centimetres.
    scaled = np.asarray(motion.poses.position) * 0.9
    alone = feet(other, played.poses._replace(position=jnp.asarray(scaled, jnp.float32)))
    assert np.ptp(alone[:, 0], axis=0).max() > 0.05


def test_joints_bend_as_they_did():
    motion = on_one_foot()
    played = retarget_motion(motion, other_proportions())
    np.testing.assert_array_equal(played.poses.angles, motion.poses.angles)
    np.testing.assert_array_equal(played.poses.quaternion, motion.poses.quaternion)


@settings(max_examples=15, deadline=None)
@given(st.floats(0.6, 1.6))
def test_who_is_larger_in_everything_does_everything_larger(factor):
    motion = on_one_foot()
    larger = replace(PERSON, lengths=PERSON.lengths * jnp.float32(factor))
    ours, theirs = motion.joints(), retarget_motion(motion, larger).joints()
    for name in ("pelvis", "wrist_l", "knee_r", "ankle_l"):
        moved = np.diff(theirs[name], axis=0) - factor * np.diff(ours[name], axis=0)
        assert np.abs(moved).max() < 2e-3, name
    np.testing.assert_allclose(theirs["pelvis"][0, :2], ours["pelvis"][0, :2], atol=5e-3)


def test_a_leap_leaves_the_ground():
    motion = on_one_foot()
    height = np.where((TIMES > 0.5) & (TIMES < 1.0), 0.4, 0.0)
    leaping = np.asarray(motion.poses.position) + height[:, None] * [0, 0, 1]
    motion = replace(motion, poses=motion.poses._replace(position=jnp.asarray(leaping)))
    played = retarget_motion(motion, Skeleton.human(1.6))
    air = height > 0
    assert not ground_contacts(feet(PERSON, motion.poses))[air].any()
    ankles = feet(played.skeleton, played.poses)[:, 0, 2]
    assert ankles[air][3:-3].min() > ankles[~air].max() + 0.25


def test_other_bones_are_refused():
    trunk = replace(PERSON.tree, bones=tuple(f"b{i}" for i in range(len(PERSON.tree.bones))))
    with pytest.raises(ValueError, match="expected the bones spine1"):
        retarget_motion(on_one_foot(), replace(PERSON, tree=trunk))


def test_poses_that_are_missing_stay_so_and_change_no_other():
    motion, other = on_one_foot(), other_proportions()
    part = replace(motion, times=TIMES[3:], poses=Pose(*(part[3:] for part in motion.poses)))
    gaps = Pose(*(part.at[:3].set(jnp.nan) for part in motion.poses))
    played = retarget_motion(replace(motion, poses=gaps), other)
    np.testing.assert_array_equal(played.times, TIMES)
    for whole, expected in zip(played.poses, retarget_motion(part, other).poses, strict=True):
        assert np.isnan(whole[:3]).all()
        np.testing.assert_array_equal(whole[3:], expected)
    nobody = Pose(*(np.nan * part for part in motion.poses))
    with pytest.raises(ValueError, match="expected a pose; found none"):
        retarget_motion(replace(motion, poses=nobody), other)
    one = replace(motion, times=TIMES[:1], poses=Pose(*(part[:1] for part in motion.poses)))
    assert np.isfinite(retarget_motion(one, other).poses.position).all()
    # Nothing slides within one sample.
    text = RetargetedMotion(one, retarget_motion(one, other), None, None).text([])
    assert text.endswith("error of the feet's height 0.0 cm")


def test_the_command_writes_the_other_persons_motion(tmp_path, capsys):
    (tmp_path / "tracked").mkdir()
    motion = on_one_foot()
    late = Pose(*(part.at[:2].set(jnp.nan) for part in motion.poses))
    save_motion(tmp_path / "tracked" / "motion.npz", replace(motion, poses=late))
    (tmp_path / "subject.toml").write_text("height = 1.6\n")
    given_ = [str(tmp_path / name) for name in ("tracked", "subject.toml", "out")]
    assert main(["retarget", given_[0], "--onto", given_[1], "--out", given_[2]]) == 0
    assert "on the ground" in capsys.readouterr().out
    played = load_motion(tmp_path / "out" / "motion.npz")
    np.testing.assert_allclose(played.skeleton.lengths, Skeleton.human(1.6).lengths, rtol=1e-5)
    for name in ("joints.trc", "motion.bvh", "motion.glb", "recording.rrd", "retargeted.png"):
        assert (tmp_path / "out" / name).stat().st_size > 0


@pytest.mark.parametrize(
    ("onto", "problem"),
    [
        ("nobody.toml", "nobody.toml: no such file or folder, expected a person's"),
        ("", "found no subject.toml, expected what 'silhouette model' writes"),
    ],
)
def test_who_is_not_there_is_said_in_one_sentence(tmp_path, refusal, onto, problem):
    save_motion(tmp_path / "motion.npz", on_one_foot())
    out = "--out", tmp_path / "out"
    assert problem in refusal("retarget", tmp_path, "--onto", tmp_path / onto, *out)
