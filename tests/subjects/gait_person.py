"""A person from a body mesh with a rig of its own, moved by recorded surface markers.

Neither the body nor the movement is of our making: a fair test. Each bone of the rig turns the way
the markers point and keeps its own length; the truth is the rig's own joints afterwards.

INPUTS: a rigged mesh (.npz: vertices, quads, skin weights, joints), marker positions of the
Plug-in-Gait set over time. OUTPUTS: a MeshPerson: vertices and landmarks at any time.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from jaxmocap.formats.time_series.trc import write_trc
from jaxmocap.synthetic.drawing_camera import look_at
from jaxmocap.synthetic.movements.splines import Spline
from jaxmocap.synthetic.people.figure import unit
from jaxmocap.synthetic.people.rigged_mesh import (
    RiggedMesh,
    load_rig,
    rotation_between,
    rotation_onto,
)
from jaxmocap.synthetic.recording import MARKER_RATE, RecordingParts, video_times, write_parts
from jaxmocap.synthetic.renderer import Scene, render_frames

# The five end effectors of the paper: marker, which is a landmark too -> bone that ends there.
BODY_MARKERS = {
    "vertex": "head",
    **{
        f"{mark}_{s}": f"{bone}_{s}"
        for mark, bone in (("wrist", "radius"), ("ankle", "tibia"))
        for s in "lr"
    },
}
# From the marker on the skin to the joint's centre, metres.
SHOULDER_DEPTH, ELBOW_DEPTH, KNEE_DEPTH, ANKLE_DEPTH = 0.05, 0.035, 0.05, 0.04
MARKERS = (
    *("LFHD", "RFHD", "LBHD", "RBHD", "C7", "CLAV", "LASI", "RASI", "LPSI", "RPSI"),
    *(
        f"{s}{name}"
        for s in "LR"
        for name in ("SHO", "ELB", "WRA", "WRB", "FIN", "KNE", "ANK", "TOE")
    ),
)


@dataclass(frozen=True)
class MeshPerson(RiggedMesh):
    """A rigged mesh that follows markers.

    Attributes:
        markers: positions (3 per marker, in the order of ``MARKERS``) over time.
    """

    markers: Spline

    def rig(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Turns (T, J, 3, 3) from rest, and positions (T, J, 3), of the joints."""
        centres = _centres(self.markers, times)
        legs = (centres["LeftUpLeg"] + centres["RightUpLeg"]) / 2
        return self.chain_turns(_turns(self, centres), legs)


def mesh_person(
    file: str | Path,
    positions: Mapping[str, np.ndarray],
    rate: float,
    start: float = 0.0,
    seconds: float = 3.0,
    who: str = "man",
    seed: int = 0,
) -> MeshPerson:
    """A person of a file of rigged meshes, doing what markers did.

    Args:
        file: .npz of people.
        positions: marker -> (N, 3), metres, Z up; all of ``MARKERS`` must be there.
        rate: of the markers, per second.
        start: where the movement begins, seconds; it becomes time 0.
        seconds: how long it lasts. On average the person then faces +x above the origin.
        who: which of the file's people.
        seed: of how the clothes are worn.

    Raises:
        ValueError: no such person, a marker is missing, or the markers end before the movement.
    """
    missing = [name for name in MARKERS if name not in positions]
    if missing:
        raise ValueError(f"marker {missing[0]!r} is missing, found {', '.join(positions)}")
    first, last = int(start * rate), int(np.ceil((start + seconds) * rate)) + 2
    paths = np.stack([positions[name][first:last] for name in MARKERS], 1)
    if len(paths) < last - first:
        raise ValueError(
            f"{start} s + {seconds} s: the markers end at {first + len(paths)} samples"
        )
    paths = _facing_forward(paths)
    times = np.arange(first, last) / rate - start
    return MeshPerson(load_rig(file, who, seed), Spline(times, paths.reshape(len(times), -1)))


def _facing_forward(paths: np.ndarray) -> np.ndarray:
    """Marker paths (N, M, 3) turned and shifted: the pelvis above the origin, facing +x."""
    left_front, right_front = (paths[:, MARKERS.index(name)] for name in ("LASI", "RASI"))
    left = unit((left_front - right_front).mean(0) * [1.0, 1.0, 0.0])
    R = np.array([[left[1], -left[0], 0.0], [left[0], left[1], 0.0], [0.0, 0.0, 1.0]])
    middle = (left_front + right_front).mean(0) / 2 * [1.0, 1.0, 0.0]
    return (paths - middle) @ R.T


def _centres(markers: Spline, times: np.ndarray) -> dict[str, np.ndarray]:
    """Joint centres and directions (T, 3) from the markers on the skin, world."""
    m = dict(zip(MARKERS, markers(times).reshape(-1, len(MARKERS), 3).swapaxes(0, 1), strict=True))
    front, back = (m["LASI"] + m["RASI"]) / 2, (m["LPSI"] + m["RPSI"]) / 2
    neck, pelvis = (m["C7"] + m["CLAV"]) / 2, (front + back) / 2
    across, up = m["LASI"] - m["RASI"], unit(neck - pelvis)
    width = np.linalg.norm(across, axis=-1, keepdims=True)
    actual = {"neck": neck, "up": up, "across": across, "chest": m["LSHO"] - m["RSHO"]}
    actual["ahead"] = m["LFHD"] + m["RFHD"] - m["LBHD"] - m["RBHD"]
    actual["head"] = m["LFHD"] + m["LBHD"] - m["RFHD"] - m["RBHD"]
    for side, s, other, out in (("Left", "L", "R", 1), ("Right", "R", "L", -1)):
        # After Bell: a hip lies behind, below and outside the middle of the pelvis' front.
        sideways = 0.36 * out * across - width * (0.30 * up + 0.19 * unit(front - back))
        actual[side + "UpLeg"] = front + sideways
        actual[side + "Arm"] = m[s + "SHO"] - SHOULDER_DEPTH * up
        actual[side + "ForeArm"] = _inward(m[s + "ELB"], (neck + pelvis) / 2, ELBOW_DEPTH)
        actual[side + "Hand"] = (m[s + "WRA"] + m[s + "WRB"]) / 2
        actual[side + "HandFinger1"] = m[s + "FIN"]
        actual[side + "Leg"] = _inward(m[s + "KNE"], m[other + "KNE"], KNEE_DEPTH)
        actual[side + "Foot"] = _inward(m[s + "ANK"], m[other + "ANK"], ANKLE_DEPTH)
        actual[side + "ToeBase"] = m[s + "TOE"]
    return actual


def _turns(person: MeshPerson, centres: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Joint -> (T, 3, 3) turn from rest, for the joints whose bones the markers show."""
    at = person.at
    left, up, ahead = np.eye(3)[0], np.eye(3)[2], -np.eye(3)[1]

    hips = rotation_onto(centres["across"], centres["up"], left, up)
    chest = rotation_onto(centres["up"], centres["chest"], up, left)
    head = rotation_onto(centres["ahead"], centres["head"], ahead, left)
    turned = {
        "Hips": hips,
        "Spine1": chest,
        "Head": head,
        "LowerBack": rotation_between(hips, chest, 1 / 3),
    }
    turned |= {
        "Spine": rotation_between(hips, chest, 2 / 3),
        "Neck1": rotation_between(chest, head, 0.5),
    }
    for side in ("Left", "Right"):
        bones = [side + part for part in ("Arm", "ForeArm", "Hand", "HandFinger1")]
        directions = [centres[b] - centres[a] for a, b in pairwise(bones)]
        rest = [at(b) - at(a) for a, b in pairwise(bones)]
        hinge, rest_hinge = np.cross(directions[0], directions[1]), np.cross(rest[0], rest[1])
        for bone, now, before in zip(bones, directions, rest, strict=False):
            turned[bone] = rotation_onto(now, hinge, before, rest_hinge)
        for bone, end in (("UpLeg", "Leg"), ("Leg", "Foot"), ("Foot", "ToeBase")):
            now = centres[side + end] - centres[side + bone]
            turned[side + bone] = rotation_onto(
                now, centres["across"], at(side + end) - at(side + bone), left
            )
    return turned


def _inward(marker: np.ndarray, towards: np.ndarray, depth: float) -> np.ndarray:
    return marker + depth * unit(towards - marker)


def write_person_recording(
    directory: Path, person: MeshPerson, seconds: float, seed: int = 0
) -> Path:
    """Write the recording of a rigged mesh, moved by recorded markers; its recording.toml.

    Head, wrists and ankles carry markers, as in the paper; a static trial, ``static.trc``, tells
    the subject's lengths.
    """
    directory.mkdir(parents=True, exist_ok=True)
    times = np.arange(int(seconds * MARKER_RATE)) / MARKER_RATE
    landmarks, standing = person.landmarks(times), person.standing()
    # The rig's rest faces -y; a static trial may face anywhere.
    write_trc(directory / "static.trc", np.zeros(1), standing, rate=MARKER_RATE)
    camera = look_at((3.6, 0.75, 1.35), (0.0, 0.0, 1.18), focal=680.0)
    names = {name: name for name in standing if name != "head"}
    parts = RecordingParts(
        times,
        markers={landmark: landmarks[landmark] for landmark in BODY_MARKERS},
        landmarks=landmarks,
        camera=camera,
        places={landmark: {"bone": bone, "at": 1.0} for landmark, bone in BODY_MARKERS.items()},
        subject={"static": "static.trc", "landmarks": names},
    )
    frames = render_frames(Scene.in_room(camera, person, seed), video_times(seconds))
    return write_parts(directory, parts, frames, seed)
