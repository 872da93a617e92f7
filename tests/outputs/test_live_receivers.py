"""What goes out, taken in by receivers of our own that follow the published ones."""

from functools import cache

import jax
import numpy as np
import pytest
from moving_body import moving_body
from pythonosc.osc_packet import OscPacket
from scipy.spatial.transform import Rotation
from vmc_receivers import (
    DIRECTIONS,
    PARENTS,
    Avatar,
    Frame,
    as_slimevr,
    mirrored,
    on_avatar,
    received,
    vrchat_aligned,
)

from jaxmocap.body.kinematics import forward
from jaxmocap.body.motion import Motion
from jaxmocap.body.pose import Pose
from jaxmocap.formats.armatures.body_armature import T_POSE
from jaxmocap.outputs.senders.unity import UnityBody
from jaxmocap.outputs.senders.vmc import VMC, VmcTable
from jaxmocap.outputs.senders.vrchat import Trackers, VrchatTable

# The world (x ahead, y left, z up) in Unity's frame (x right, y up, z ahead).
MIRROR = np.array([[0.0, -1, 0], [0, 0, 1], [1, 0, 0]])
OURS = {
    **dict(Spine="spine1", Chest="spine2", UpperChest="spine3", Neck="neck", Head="head"),
    **{
        f"{side}{theirs}": f"{ours}_{side[0].lower()}"
        for side in ("Left", "Right")
        for theirs, ours in (
            *(("Shoulder", "clavicle"), ("UpperArm", "humerus"), ("LowerArm", "radius")),
            *(("Hand", "hand"), ("UpperLeg", "femur"), ("LowerLeg", "tibia"), ("Foot", "foot")),
        )
    },
}
FRAMES = range(0, 60, 4)
# Neither ours nor near them: an avatar of 1.2 m with long arms.
OFFSETS = {bone: np.array([0.03, 0.09, -0.01]) for bone in PARENTS} | {
    bone: length * DIRECTIONS[parent]
    for bone, parent in PARENTS.items()
    if parent in DIRECTIONS
    for length in [0.31 if "Arm" in parent else 0.17]
}


Segments = dict[str, tuple[np.ndarray, np.ndarray]]


def pose_at(motion: Motion, i: int) -> Pose:
    return Pose(*(np.asarray(part)[i] for part in motion.poses))


@cache
def segments() -> list[Segments]:
    """Unity's name -> where our bone begins and ends, in Unity's frame, for each of FRAMES.

    The last is the T pose at the origin.
    """
    motion = moving_body()
    skeleton = motion.skeleton
    angles = [np.radians(T_POSE.get(joint, 0.0)) for joint in skeleton.tree.joints]
    rows = [pose_at(motion, i) for i in FRAMES]
    rows.append(Pose(np.zeros(3), np.array([1.0, 0, 0, 0]), np.array(angles)))  # type: ignore[arg-type]
    poses = Pose(*(np.stack(parts).astype(np.float32) for parts in zip(*rows, strict=True)))
    frames = jax.vmap(lambda pose: forward(skeleton, pose))(poses)
    reach = np.asarray(skeleton.lengths)[:, None] * np.asarray(skeleton.directions)
    begins = np.asarray(frames.joints_world, float)
    ends = begins + np.einsum("tbij,bj->tbi", np.asarray(frames.R_world_bone, float), reach)
    index = {name: skeleton.tree.bones.index(ours) for name, ours in OURS.items()}
    return [
        {name: (begins[t, b] @ MIRROR.T, ends[t, b] @ MIRROR.T) for name, b in index.items()}
        for t in range(len(rows))
    ]


def unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector)


def degrees_between(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)))


@cache
def sent() -> list[Frame]:
    """The frames as receivers read them."""
    motion = moving_body()
    body = UnityBody(motion.skeleton)
    vmc, times = VMC(VmcTable(), body), motion.times
    return [received(vmc.frame(float(times[i]), body.local(pose_at(motion, i)))) for i in FRAMES]


def rest_direction(bone: str) -> np.ndarray:
    """A VRM's own where its T pose states it; shoulders and feet as ours are then."""
    begin, end = segments()[-1][bone]
    return DIRECTIONS.get(bone, unit(end - begin))


def check_directions(avatar: Avatar, ours: Segments, mirror) -> None:
    """Every bone points where ours does, within half a degree."""
    for bone, (begin, end) in ours.items():
        direction = avatar.rotations[bone].apply(mirror(rest_direction(bone)))
        assert degrees_between(direction, mirror(unit(end - begin))) < 0.5, bone


def test_every_bone_of_another_avatar_points_as_ours_and_its_hips_are_where_ours_are():
    for row, (frame, ours) in enumerate(zip(sent(), segments(), strict=False)):
        avatar = on_avatar(frame, OFFSETS)
        check_directions(avatar, ours, lambda vector: vector)
        hips = np.asarray(moving_body().poses.position)[FRAMES[row]] @ MIRROR.T
        np.testing.assert_allclose(avatar.positions["Hips"], hips, atol=1e-3)
        # Its own bones reach from joint to joint.
        for side in ("Left", "Right"):
            for bone, child in (("UpperArm", "LowerArm"), ("UpperLeg", "LowerLeg")):
                ours_begin, ours_end = ours[f"{side}{bone}"]
                reach = avatar.positions[f"{side}{child}"] - avatar.positions[f"{side}{bone}"]
                assert degrees_between(reach, ours_end - ours_begin) < 0.5
                assert np.linalg.norm(reach) == pytest.approx(
                    np.linalg.norm(OFFSETS[f"{side}{child}"]), rel=1e-4
                )


@pytest.mark.parametrize("mirror", [lambda points: points, mirrored], ids=["Unity", "SlimeVR"])
def test_joints_are_where_ours_are_with_the_positions_that_were_sent(mirror):
    for frame, ours in zip(sent(), segments(), strict=False):
        avatar = as_slimevr(frame) if mirror is mirrored else on_avatar(frame, None)
        check_directions(avatar, ours, mirror)
        for bone, (begin, _) in ours.items():
            np.testing.assert_allclose(avatar.positions[bone], mirror(begin), atol=1e-3)


def test_a_frame_says_that_the_person_is_tracked_and_when():
    for i, frame in zip(FRAMES, sent(), strict=True):
        assert frame.status == [1, 3, 0, 1] and set(frame.bones) == set(PARENTS)
        assert frame.seconds == pytest.approx(float(moving_body().times[i]), abs=1e-6)


def test_vrchat_finds_the_trackers_by_the_head():
    """Its own world is turned and moved against ours; head and heading are all that it has."""
    body = UnityBody(moving_body().skeleton)
    trackers = Trackers(VrchatTable(), body)
    joints = {1: "Hips", 2: "UpperChest", 3: "LeftFoot", 4: "RightFoot"}
    joints |= {5: "LeftLowerArm", 6: "RightLowerArm"}
    turn, shift = Rotation.from_rotvec([0.0, 1.3, 0.0]), np.array([4.0, 0.2, -3.0])
    for i, frame, ours in zip(FRAMES, sent(), segments(), strict=False):
        (datagram,) = trackers.frame(0.0, body.local(pose_at(moving_body(), i)))
        assert len(datagram) <= 1200
        assert all(len(t.message.params) == 3 for t in OscPacket(datagram).messages)
        avatar = on_avatar(frame, None)
        ahead = (turn * avatar.rotations["Head"]).apply([0.0, 0.0, 1.0])
        heading = Rotation.from_rotvec([0.0, np.arctan2(ahead[0], ahead[2]), 0.0])
        # The root of the head, where the neck ends.
        head = turn.apply(ours["Neck"][1]) + shift
        aligned = vrchat_aligned(datagram, head, heading)
        assert set(aligned) == set(joints)
        for number, joint in joints.items():
            place = avatar.positions["Hips"] if joint == "Hips" else ours[joint][0]
            np.testing.assert_allclose(aligned[number][0], turn.apply(place) + shift, atol=1e-3)
        for number, bone in ((1, "Hips"), (3, "LeftFoot"), (5, "LeftUpperArm")):
            apart = aligned[number][1] * (turn * avatar.rotations[bone]).inv()
            assert np.degrees(apart.magnitude()) < 0.5
