"""Datagrams as the programs send them that people wear trackers with, byte by byte.

Written from the layouts that their sources and manuals publish, none of whose text is here:

- the VMC protocol's message tables, https://protocol.vmc.info/english (MIT licence);
- VirtualMotionCapture, ``ExternalSender.cs`` at 0ce9234 (github.com/sh-akira/VirtualMotionCapture,
  MIT): which bundles a frame has, their order, nesting and arguments;
- uOSC, ``Message.cs``, ``Bundle.cs``, ``Writer.cs`` (github.com/hecomi/uOSC, MIT): bytes;
- SlimeVR's server, ``VMCHandler.kt`` at 002e9a4 and ``VRCOSCHandler.kt`` at 00835ea, and what
  replaced them, ``vmc/output-encoder.kt`` at 035b79b and ``vrcosc/output-encoder.kt`` at 1397683
  (github.com/SlimeVR/SlimeVR-Server, MIT or Apache 2.0);
- the sample ``SampleTrackerSend.cs`` of the protocol's repository (CC0);
- VRChat's page on OSC trackers, https://docs.vrchat.com/docs/osc-trackers.

No program was run. Names of devices are examples.
"""

import struct
from collections.abc import Iterable, Sequence
from typing import NamedTuple

IMMEDIATELY = 1
# Unity's HumanBodyBones in their order, without the last.
FINGERS = [
    f"{side}{finger}{part}"
    for side in ("Left", "Right")
    for finger in ("Thumb", "Index", "Middle", "Ring", "Little")
    for part in ("Proximal", "Intermediate", "Distal")
]
BONES = [
    *("Hips", "LeftUpperLeg", "RightUpperLeg", "LeftLowerLeg", "RightLowerLeg", "LeftFoot"),
    *("RightFoot", "Spine", "Chest", "Neck", "Head", "LeftShoulder", "RightShoulder"),
    *("LeftUpperArm", "RightUpperArm", "LeftLowerArm", "RightLowerArm", "LeftHand", "RightHand"),
    *("LeftToes", "RightToes", "LeftEye", "RightEye", "Jaw"),
    *FINGERS,
    "UpperChest",
]
_AT_REST = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)


class Device(NamedTuple):
    """Hmd, Con or Tra; serial; position, metres; quaternion xyzw; in Unity's frame."""

    kind: str
    serial: str
    position: Sequence[float]
    quaternion: Sequence[float]


def text(value: str) -> bytes:
    content = value.encode("utf-8")
    return content + bytes(4 - len(content) % 4)


def message(address: str, *arguments) -> bytes:
    """A message; numbers by their Python types, True and False, None, bytes as a blob."""
    tags, content = ",", b""
    for argument in arguments:
        if argument is None or isinstance(argument, bool):
            tags += {None: "N", True: "T", False: "F"}[argument]
        elif isinstance(argument, int):
            tags, content = tags + "i", content + struct.pack(">i", argument)
        elif isinstance(argument, float):
            tags, content = tags + "f", content + struct.pack(">f", argument)
        elif isinstance(argument, str):
            tags, content = tags + "s", content + text(argument)
        else:
            padded = argument + bytes(-len(argument) % 4)
            tags, content = tags + "b", content + struct.pack(">i", len(argument)) + padded
    return text(address) + text(tags) + content


def bundle(elements: Iterable[bytes], tag: int = IMMEDIATELY) -> bytes:
    sized = (struct.pack(">i", len(each)) + each for each in elements)
    return text("#bundle") + struct.pack(">Q", tag) + b"".join(sized)


def bone(name: str) -> bytes:
    return message("/VMC/Ext/Bone/Pos", name, *_AT_REST)


def device(each: Device, suffix: str = "", scale: float = 1.0) -> bytes:
    place = [float(scale * x) for x in each.position]
    turn = map(float, each.quaternion)
    return message(f"/VMC/Ext/{each.kind}/Pos{suffix}", each.serial, *place, *turn)


def virtual_motion_capture(
    devices: Sequence[Device], seconds: float, expressions: int = 64, scale: float = 0.9
) -> list[bytes]:
    """A frame of VirtualMotionCapture: bones by 13, expressions, all else in one last bundle.

    That last one begins with the root (with scale and offset, version 2.1), then the left-over
    bones as a bundle in the bundle; each device twice, scaled to the avatar and as tracked.
    """
    *whole, rest = [BONES[i : i + 13] for i in range(0, len(BONES), 13)]
    blends = [message("/VMC/Ext/Blend/Val", f"表情{i}", 0.25) for i in range(expressions)]
    pairs = [
        part
        for each in sorted(devices, key=lambda one: ("Hmd", "Con", "Tra").index(one.kind))
        for part in (device(each, scale=scale), device(each, "/Local"))
    ]
    root = ("root", *_AT_REST, scale, scale, scale, 0.0, 0.0, 0.0)
    return [
        *(bundle(map(bone, names)) for names in whole),
        bundle([*blends, message("/VMC/Ext/Blend/Apply")]),
        bundle(
            [
                message("/VMC/Ext/Root/Pos", *root),
                bundle(map(bone, rest)),
                message("/VMC/Ext/Cam", "Camera", *_AT_REST, 60.0),
                *pairs,
                message("/VMC/Ext/OK", 1, 3, 0),
                message("/VMC/Ext/T", seconds),
            ]
        ),
    ]


def virtual_motion_capture_now_and_then() -> list[bytes]:
    """What it sends about once a second, and at buttons, keys and MIDI."""
    return [
        bundle(
            [
                message("/VMC/Ext/Rcv", 1, 39540),
                message("/VMC/Ext/Light", "Light", *_AT_REST, 1.0, 1.0, 1.0, 1.0),
                message("/VMC/Ext/Setting/Color", 0.0, 1.0, 0.0, 1.0),
                message("/VMC/Ext/Setting/Win", 0, 1, 0, 0),
            ]
        ),
        message("/VMC/Ext/VRM", "C:\\アバター\\私.vrm", "私"),
        message("/VMC/Ext/Remote", "vroidhub", '{"characterModelId":"123456789456"}'),
        message("/VMC/Ext/Config", "C:\\設定.json"),
        message("/VMC/Ext/Opt", ""),
        message("/VMC/Ext/Con", 1, "ClickTrigger", 1, 0, 1, 0.5, 0.0, 0.0),
        message("/VMC/Ext/Key", 1, "A", 65),
        message("/VMC/Ext/Midi/Note", 1, 0, 60, 0.5),
        message("/VMC/Ext/Midi/CC/Val", 3, 0.5),
        message("/VMC/Ext/Midi/CC/Bit", 3, 1),
        # From another program, passed on; arguments as any library packs them.
        message("/VMC/Thru/Camera/Image", "frame", b"\x89PNG\r\n", True, None),
    ]


def slimevr_vmc(devices: Sequence[Device], seconds: float) -> bytes:
    """A frame of SlimeVR's server (2023 to 2025) by VMC: one bundle, the devices last."""
    return bundle(
        [
            message("/VMC/Ext/T", seconds),
            message("/VMC/Ext/OK", 1),
            message("/VMC/Ext/Root/Pos", "root", *_AT_REST),
            *(bone(name) for name in BONES if name not in ("LeftEye", "RightEye", "Jaw")),
            *map(device, devices),
        ]
    )


def slimevr_vmc_without_devices(seconds: float) -> list[bytes]:
    """A frame of the server that replaces it (2026): bones only; before the first, a request."""
    return [message("/VMC/Ext/Req"), slimevr_vmc((), seconds)]


def slimevr_trackers(places: Sequence, degrees: Sequence, head: Sequence[float]) -> bytes:
    """A frame of SlimeVR's server as VRChat's trackers: 1 to 8 and the head's position."""
    parts = []
    for number, (place, turn) in enumerate(zip(places, degrees, strict=True), 1):
        parts.append(message(f"/tracking/trackers/{number}/position", *map(float, place)))
        parts.append(message(f"/tracking/trackers/{number}/rotation", *map(float, turn)))
    return bundle([*parts, message("/tracking/trackers/head/position", *map(float, head))])


def slimevr_reset(yaw_degrees: float) -> bytes:
    """What SlimeVR sends at a reset: the head's heading, alone and once."""
    return message("/tracking/trackers/head/rotation", 0.0, yaw_degrees, 0.0)


def sample_tracker_sender(each: Device) -> list[bytes]:
    """A frame of the protocol's sample for one tracker: messages one by one, no time."""
    return [device(each), message("/VMC/Ext/Blend/Val", "", 0.0), message("/VMC/Ext/Blend/Apply")]
