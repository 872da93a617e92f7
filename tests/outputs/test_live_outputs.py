"""Live outputs: packets as receivers want them, and the pose as receivers have it then."""

from functools import cache

import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from moving_body import moving_body
from pythonosc.osc_bundle import OscBundle
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
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.formats.armatures.body_armature import T_POSE
from jaxmocap.outputs.senders.osc import Bundle
from jaxmocap.outputs.senders.unity import UnityBody, euler_degrees
from jaxmocap.outputs.senders.vmc import VMC, VmcTable
from jaxmocap.outputs.senders.vrchat import DEFAULT_TRACKED, TRACKED, Trackers, VrchatTable

SKELETON = Skeleton.human(1.75)
BODY = UnityBody(SKELETON)
HALF = np.sqrt(0.5)
# The mirror between the world (x ahead, y left, z up) and Unity (x right, y up, z ahead).
MIRROR = np.array([[0.0, -1, 0], [0, 0, 1], [1, 0, 0]])


def t_pose(position=(0.0, 0.0, 0.0), quaternion=(1.0, 0.0, 0.0, 0.0), **degrees: float) -> Pose:
    """Upright, arms out to the sides, but for some joints."""
    angles = [np.radians({**T_POSE, **degrees}.get(j, 0.0)) for j in SKELETON.tree.joints]
    return Pose(np.array(position), np.array(quaternion), np.array(angles))


def messages_of(datagrams: list[bytes]) -> list:
    """All messages, as python-osc reads the bundles."""
    return [timed.message for one in datagrams for timed in OscPacket(one).messages]


def bones_of(datagrams: list[bytes]) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Bone -> place and turn (xyzw)."""
    bones = {}
    for message in messages_of(datagrams):
        if message.address == "/VMC/Ext/Bone/Pos":
            name, *numbers = message.params
            bones[name] = np.array(numbers[:3]), np.array(numbers[3:])
    return bones


def test_in_the_t_pose_no_bone_is_turned():
    datagram = VMC(VmcTable(), BODY).frame(0.0, BODY.local(t_pose()))
    for _, turn in bones_of(datagram).values():
        np.testing.assert_allclose(turn * np.sign(turn[3]), [0, 0, 0, 1], atol=1e-6)


def test_a_frame_of_vmc_is_what_its_receivers_ask_for():
    vmc = VMC(VmcTable(), BODY)
    datagrams = vmc.frame(2.5, BODY.local(t_pose()))
    assert all(map(OscBundle.dgram_is_bundle, datagrams))
    # As VirtualMotionCapture's: shorter than what a network cuts up, the time last.
    assert len(datagrams) == 2 and max(map(len, datagrams)) <= 1200
    messages = messages_of(datagrams)
    assert [m.address for m in messages[-3:]] == ["/VMC/Ext/Root/Pos", "/VMC/Ext/OK", "/VMC/Ext/T"]
    assert messages[-2].params == [1, 3, 0, 1] and messages[-1].params == [2.5]
    assert messages[-3].params == ["root", 0, 0, 0, 0, 0, 0, 1]
    tags = [m.dgram[len(m.address) :].strip(b"\0").split(b"\0")[0] for m in messages[-3:]]
    assert tags == [b",sfffffff", b",iiii", b",f"]
    assert messages[-4].address == "/jaxmocap/Elbows" and messages[-4].params == [-1, -1]
    names = {m.params[0] for m in messages[:-4]}
    sides = ("Shoulder", "UpperArm", "LowerArm", "Hand", "UpperLeg", "LowerLeg", "Foot")
    assert names == {
        *("Hips", "Spine", "Chest", "UpperChest", "Neck", "Head"),
        *(f"{side}{bone}" for side in ("Left", "Right") for bone in sides),
    }
    assert [m.params for m in messages_of(vmc.lost_messages(3.0))] == [[1, 3, 0, 0], [3.0]]


def test_vmc_states_how_sure_the_elbows_are():
    deviations = np.array([0.25, np.nan])
    messages = messages_of(VMC(VmcTable(), BODY).frame(0.0, BODY.local(t_pose()), deviations))
    assert [m.params for m in messages if m.address == "/jaxmocap/Elbows"] == [[0.25, -1]]


def test_a_bundle_is_filled_without_changing_its_texts():
    bundle = Bundle([("/a", ["name", 7, 1.0]), ("/b", [3.0, 4.0])])
    messages = [t.message for t in OscPacket(bundle.fill(0.5, np.array([1.5, 2.5]))).messages]
    assert [(m.address, m.params) for m in messages] == [
        ("/a", ["name", 7, 0.5]),
        ("/b", [1.5, 2.5]),
    ]


def test_trackers_are_numbered_and_turned_as_unity_says_it():
    pose = t_pose((1.0, 2.0, 3.0), (HALF, 0.0, 0.0, HALF))
    local = BODY.local(pose)
    (datagram,) = Trackers(VrchatTable(), BODY).frame(0.0, local)
    params = {m.message.address: m.message.params for m in OscPacket(datagram).messages}
    assert len(params) == 2 * len(DEFAULT_TRACKED)
    np.testing.assert_allclose(params["/tracking/trackers/1/position"], [-2, 3, 1], atol=1e-5)
    np.testing.assert_allclose(params["/tracking/trackers/1/rotation"], [0, -90, 0], atol=1e-3)
    elbow = np.array(params[f"/tracking/trackers/{DEFAULT_TRACKED.index('elbow_l') + 1}/position"])
    # Facing left, which is -x, the left arm points back, to -z.
    assert elbow[2] < 1 - 0.4 and elbow[1] > 3
    assert params["/tracking/trackers/head/position"][1] > 3.4
    table = VrchatTable(trackers=tuple(TRACKED))
    (everything,) = Trackers(table, BODY).frame(0.0, local)
    assert "/tracking/trackers/8/rotation" in {
        m.message.address for m in OscPacket(everything).messages
    }


@given(st.lists(st.floats(-1, 1), min_size=4, max_size=4))
def test_unitys_angles_turn_about_z_then_x_then_y(parts):
    xyzw = np.array(parts)
    if np.linalg.norm(xyzw) < 0.1:
        xyzw = np.array([0, 0, 0, 1.0])
    xyzw /= np.linalg.norm(xyzw)
    x, y, z = euler_degrees(xyzw)
    again = Rotation.from_euler("zxy", [z, x, y], degrees=True)
    apart = np.degrees((again * Rotation.from_quat(xyzw).inv()).magnitude())
    assert apart < 1e-3


@pytest.mark.parametrize("up", [90.0, -90.0])
def test_unitys_angles_are_right_looking_straight_up_and_down(up):
    turn = Rotation.from_euler("zxy", [20.0, up, 50.0], degrees=True)
    x, y, z = euler_degrees(turn.as_quat())
    again = Rotation.from_euler("zxy", [z, x, y], degrees=True)
    assert np.degrees((again * turn.inv()).magnitude()) < 1e-3


# As receivers have it -----------------------------------------------------------------------------


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
