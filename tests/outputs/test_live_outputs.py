"""Poses as Unity, VMC and VRChat have them, next to what is worked out by hand and by SciPy."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pythonosc.osc_bundle import OscBundle
from pythonosc.osc_packet import OscPacket
from scipy.spatial.transform import Rotation

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
