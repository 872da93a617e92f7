"""Small valid inputs of every format that is read, from which the hostile ones are made.

INPUTS: a folder. OUTPUTS: files in it, and in folders named as ``hostile_kinds`` wants them.
"""

import json
import pickle
from pathlib import Path

import cv2
import numpy as np
from calibrations_of_others import (
    anipose,
    caliscope,
    easymocap,
    freemocap,
    motive,
    opencap_table,
    place,
    qualisys,
    vicon,
)
from drawn_boards import BOARD, LENS, draw, views
from rigged_people import rigged
from scipy.spatial.transform import Rotation
from small_recording import HEIGHT, PLACES, small_recording, write_small_recording

from jaxmocap.body.kinematics import forward, landmark_sites, site_positions
from jaxmocap.body.motion import Motion, Report, Run
from jaxmocap.body.pose import Pose, relaxed_pose
from jaxmocap.body.skeleton import LANDMARKS, Skeleton
from jaxmocap.body.subject import rest_joints
from jaxmocap.body.surfaces.loft import generic_surface
from jaxmocap.body.surfaces.mesh import atlas_of
from jaxmocap.body.surfaces.surface import rest_nodes
from jaxmocap.formats.animation.export import write_animation
from jaxmocap.formats.armatures.skin import TEXEL_M
from jaxmocap.formats.cameras.calibration import write_calibration, write_camera
from jaxmocap.formats.motion_npz import save_motion
from jaxmocap.formats.recordings.subject import write_subject
from jaxmocap.formats.recordings.surface import save_surface
from jaxmocap.formats.time_series.c3d import write_c3d
from jaxmocap.formats.time_series.csv import write_csv
from jaxmocap.formats.time_series.mot import write_mot
from jaxmocap.formats.time_series.tables import Markers
from jaxmocap.formats.time_series.trc import write_trc
from jaxmocap.pipelines.silhouettes.person import read_person
from jaxmocap.synthetic.drawing_camera import look_at

STATIC = ("neck", "hip_l", "hip_r", "shoulder_l", "shoulder_r", "elbow_l", "knee_r")
POSES, RATE, SLOW = 8, 30, 10
# Half as wide and high as in the drawn boards.
BOARD_LENS = LENS.__class__(LENS.size / 2, LENS.matrix * [[0.5], [0.5], [1]], LENS.distortions)
YAML = """\
%YAML:1.0
---
camera_name: cam
image_width: 96
image_height: 72
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 95., 0., 47.5,
       0., 95., 35.5, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 1
   cols: 4
   dt: d
   data: [ 0., 0., 0., 0. ]
rvec: !!opencv-matrix
   rows: 3
   cols: 1
   dt: d
   data: [ 1.184678, 1.445075, -1.289182 ]
tvec: !!opencv-matrix
   rows: 3
   cols: 1
   dt: d
   data: [ 0., 0.943844, 3.187344 ]
"""
RICH = """\
[markers]
file = "rich.csv"
up = "z"
[markers.on]
Head = { bone = "head" }
Set = { bone = "radius_l", at = 0.9, offset = [0.0, 0.0, 0.05], offset_in = "marker" }
Turned = { bone = "hand_r", at = 0.5, turn = [1.0, 0.0, 0.0, 0.0], lever = 0.2 }
[markers.rigid]
Set = ["A", "B", "C"]
[markers.filters]
hampel = true
gaps = 0.2
butterworth = 3.0
[subject]
height = 1.75
mass = 70.0
"""
LIVE = """\
[markers]
up = "z"
[markers.on]
Hmd = { bone = "head" }
Hand = { bone = "hand_l", at = 0.5, offset = [0.0, 0.02, 0.0] }
[markers.filters]
one_euro = { cutoff = 2.0, beta = 1.5 }
[osc]
listen = "127.0.0.1:39593"
raw = true
[osc.names]
controller = "Hand"
[vmc]
send = "127.0.0.1:39591"
[vrchat]
send = "127.0.0.1:39592"
trackers = ["hip", "head"]
[subject]
height = 1.75
"""


def write_bases(folder: Path) -> None:
    """Write all of them into one folder."""
    write_small_recording(folder)
    _write_markers(folder)
    _write_subjects(folder)
    _write_motions(folder)
    _write_pictures(folder)
    _write_key_points(folder)
    _write_calibrations(folder)
    np.savez(folder / "people.npz", **rigged("man"))
    (folder / "cam.yml").write_text(YAML, encoding="utf-8")
    (folder / "rich.toml").write_text(RICH, encoding="utf-8")
    (folder / "live.toml").write_text(LIVE, encoding="utf-8")
    (folder / "recording.rrd").write_bytes(b"RRF2")
    (folder / "notes.txt").write_text("no video, no markers, no picture\n", encoding="utf-8")
    _write_variants(folder)


def _write_variants(folder: Path) -> None:
    """Recordings that name other files; some end in a refusal once those files were read."""
    plain = (folder / "recording.toml").read_text(encoding="utf-8")

    def variant(name: str, *changes: tuple[str, str], more: str = "") -> None:
        text = plain
        for old, new in changes:
            assert old in text, old
            text = text.replace(old, new)
        (folder / name).write_text(text + more, encoding="utf-8")

    camera = 'camera = "cam"'
    second = '[[video]]\nfile = "cam.mp4"\ncamera = "cam"\n'
    for suffix in ("csv", "c3d"):
        variant(f"{suffix}.toml", ("markers.trc", f"markers.{suffix}"))
    variant("yaml.toml", ("calibration.toml", "cam.yml"))
    variant("subject_recording.toml", ("height = 1.75", 'file = "subject.toml"'))
    landmarks = "".join(f'{name} = "{name}"\n' for name in STATIC)
    static = f'static = "static.trc"\nup = "z"\n[subject.landmarks]\n{landmarks}'
    variant("static_recording.toml", ("height = 1.75", static))
    named = f'{camera}\nkeypoints = "{{}}"\nkeypoints_model = "BODY_25"\n'
    refused = second + 'keypoints = "nobody.json"\n'
    variant("keypoints.toml", (camera, named.format("keypoints")), more=refused)
    variant("keypoint_list.toml", (camera, named.format("list.json")), more=refused)
    empty = f'{camera}\nbackground = "room.png"\n'
    variant("background.toml", (camera, empty), more=second + 'background = "nobody.json"\n')
    live = (folder / "live.toml").read_text(encoding="utf-8")
    video = second.replace("cam.mp4", "notes.txt") + '[calibration]\nfile = "calibration.toml"\n'
    (folder / "live_refused.toml").write_text(live + video, encoding="utf-8")


def _write_markers(folder: Path) -> None:
    """The recording's markers in other formats, markers with orientations, a static trial."""
    recording = small_recording()
    markers = Markers(recording.times, tuple(PLACES), np.array(recording.positions_world))
    write_csv(folder / "markers.csv", markers.times, markers.points())
    write_c3d(folder / "markers.c3d", markers)
    _write_rich(folder / "rich.csv")
    skeleton = Skeleton.human(HEIGHT)
    sites = landmark_sites(skeleton, STATIC)
    at = np.asarray(site_positions(skeleton, forward(skeleton, relaxed_pose(skeleton)), sites))
    still = np.repeat(at[None] + [0, 0, 1.0], 5, 0)
    points = dict(zip(STATIC, np.moveaxis(still, 1, 0), strict=True))
    write_trc(folder / "static.trc", np.arange(5) / 50, points)


def _write_rich(path: Path) -> None:
    """Ten seconds of markers in a rigid set that turns, and of one with an orientation."""
    times = np.arange(10 * SLOW) / SLOW
    swing = 0.6 * np.sin(np.outer(times, [2.0, 1.3, 0.7]))
    R = Rotation.from_euler("xyz", swing).as_matrix()
    wrist, hand = np.array([0.2, 0.3, 1.1]), np.array([0.2, -0.3, 1.0])
    points = {name: wrist + R @ at for name, at in zip("ABC", 0.1 * np.eye(3), strict=True)}
    points |= {"Head": np.tile([0.0, 0.0, 1.7], (len(times), 1)), "Turned": hand + R @ [0, 0, 0.1]}
    write_csv(path, times, points, {"Turned": R})


def _write_subjects(folder: Path) -> None:
    """A body, and a model folder around it."""
    skeleton = Skeleton.human(HEIGHT)
    write_subject(folder / "subject.toml", skeleton, HEIGHT, [])
    write_subject(folder / "model" / "subject.toml", skeleton, HEIGHT, [])
    save_surface(folder / "model" / "surface.npz", generic_surface(skeleton), skeleton.tree)
    person = read_person(folder / "model")
    nodes = rest_nodes(person.surface, rest_joints(person.skeleton))
    atlas = atlas_of(person.surface, nodes, TEXEL_M)
    picture = np.full((atlas.height, atlas.width, 3), 128, np.uint8)
    cv2.imwrite(str(folder / "model" / "texture.png"), picture)


def _write_motions(folder: Path) -> None:
    """A tracked folder, and its motion in every format."""
    skeleton = Skeleton.human(HEIGHT)
    pose = Pose(*(np.repeat(np.asarray(part)[None], POSES, 0) for part in relaxed_pose(skeleton)))
    angles = pose.angles + 0.05 * np.sin(np.arange(POSES))[:, None]
    motion = Motion(skeleton, np.arange(POSES) / RATE, pose._replace(angles=angles), _report())
    save_motion(folder / "motion.npz", motion)
    write_animation(folder / "motion.bvh", motion)
    write_animation(folder / "motion.glb", motion)
    write_mot(folder / "motion.mot", motion)
    write_trc(folder / "joints.trc", motion.times, motion.joints())


def _report() -> Report:
    """What tracking says of every sample."""
    each, pair = np.full((POSES, len(PLACES)), 0.01), np.full((POSES, 2), 0.5)
    landmarks = np.full((POSES, len(LANDMARKS), 3), 0.02)
    return Report(
        tuple(PLACES), each, pair, pair, landmarks, landmarks[..., 0] * 0,
        (("held",),) * POSES, {"solve": np.full(POSES, 0.5)}, Run("a", "own"),
    )  # fmt: skip


def _write_pictures(folder: Path) -> None:
    """Boards, an empty room, photographs that show too little, a calibration to place cameras."""
    stood = views(BOARD)[:6]
    for i, T_cam_board in enumerate(stood):
        picture = cv2.resize(draw(BOARD, T_cam_board, i), (320, 240), interpolation=cv2.INTER_AREA)
        cv2.imwrite(str(folder / f"board{i}.png"), picture)
    cv2.imwrite(str(folder / "board.jpg"), picture)
    cv2.imwrite(str(folder / "room.png"), np.full((72, 96, 3), 90, np.uint8))
    figure = np.full((240, 320, 3), 200, np.uint8)
    cv2.ellipse(figure, (160, 130), (30, 90), 0, 0, 360, (60, 40, 30), -1)
    for name in ("front", "side", "joint", "arm_side"):
        cv2.imwrite(str(folder / f"{name}.png"), figure)
    camera = look_at((3.0, 0.0, 1.0), (0.0, 0.0, 1.0), size=(320, 240), focal=300, distortion=())
    write_calibration(folder / "photographed.toml", {"front": camera, "side": camera})
    write_camera(folder / "lens.toml", "cam", BOARD_LENS.entries())
    depth = 3.0 + np.arange(5) * 0.2
    rows = [
        f"p{i},{(u - 160) / 310 * z},{z},{(120 - v) / 310 * z},{u},{v}"
        for i, (u, v, z) in enumerate(
            zip([40, 280, 60, 250, 150], [30, 50, 200, 210, 110], depth, strict=True)
        )
    ]
    rows.append("p5,0.2,3.5,-0.1,178,129")
    (folder / "points.csv").write_text("name,x,y,z,u,v\n" + "\n".join(rows) + "\n")


def _write_calibrations(folder: Path) -> None:
    """Calibrations as other systems write them."""
    cameras = {f"cam_{i}": place(i) for i in (1, 2)}
    for write in (qualisys, vicon, motive, easymocap, caliscope, freemocap, anipose):
        write(folder, cameras)
    # Its text mutates as any other's.
    text = (folder / "lab.mcal").read_bytes().decode("utf-16").replace("UTF-16LE", "UTF-8")
    (folder / "lab.mcal").write_text(text, encoding="utf-8")
    (folder / "cam.pickle").write_bytes(pickle.dumps(opencap_table(place(1))))


def _write_key_points(folder: Path) -> None:
    """A folder as OpenPose writes it, a list as MMPose does, and one of nobody."""
    (folder / "keypoints").mkdir(exist_ok=True)
    rng, frames = np.random.default_rng(0), []
    for i in range(12):
        points = rng.uniform(5, 70, (25, 2)).round(2)
        flat = np.concatenate([points, np.full((25, 1), 0.9)], 1).ravel().tolist()
        path = folder / "keypoints" / f"cam_{i:06d}_keypoints.json"
        path.write_text(json.dumps({"version": 1.3, "people": [{"pose_keypoints_2d": flat}]}))
        joints = rng.normal(0, 0.5, (25, 3)).round(3).tolist()
        person = {"keypoints": points.tolist(), "keypoint_scores": [0.9] * 25}
        person["keypoints_3d"] = joints
        frames.append({"frame_id": i, "instances": [person]})
    (folder / "list.json").write_text(json.dumps(frames))
    (folder / "nobody.json").write_text('{"people": []}')
