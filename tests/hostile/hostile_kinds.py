"""What is read, in which files, by which commands, and how each can be made hostile.

INPUTS: none. OUTPUTS: ``KINDS``; command lines, with ``in/`` for the inputs and ``out/`` for what
is written.

Commands are cheap: where what is valid would be tracked for a minute, the command line leads to a
refusal behind what is to be read, such as a second video that is none, or too few seconds for a
frame (``ends`` is 2 then).
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class Kind:
    """A kind of input."""

    name: str
    # That become hostile, one in each case: one that the command line names, if it names any.
    files: tuple[str, ...]
    commands: tuple[str, ...]  # that read it, cheap ones
    costly: tuple[str, ...] = ()  # that read it too, for whoever has the time
    ends: int = 0  # exit code of the commands with the unchanged files
    also: tuple[str, ...] = ()  # other files or folders that the commands need


RECORDING = ("recording.toml", "markers.trc", "cam.mp4", "calibration.toml")
VIEWS = " ".join(f"in/board{i}.png" for i in range(6))
BOARD = "--board 4x7 --square 0.06 --camera cam --out out/made.toml"
PLACED = f"calibrate extrinsics in/board0.png {BOARD} --pose 0.5,1.2,1,90,0,0"
POINTS = (
    "calibrate extrinsics in/board0.png --points in/points.csv --camera cam --out out/made.toml"
)
TAKEN = "--front in/front.png --side in/side.png --joint in/joint.png --arm-side in/arm_side.png"
MODEL = f"silhouette model {TAKEN} --calibration in/photographed.toml --out out/model"
BY_NAME = "--landmarks " + " ".join(
    f"{name}={name}" for name in ("neck", "hip_l", "hip_r", "shoulder_l", "shoulder_r")
)
TRACK = "track in/recording.toml --refine none --out out/tracked"
BATCH = "batch in --out out/batch --workers 1 --refine none"
AT = "--at 0,0,0 --out out/tracked"

KINDS = (
    Kind(
        "recording", ("recording.toml",), ("check in/recording.toml",) * 3
        + ("check in/recording.toml --json -", "sync in/recording.toml --search 0.2"),
        (TRACK, BATCH), also=RECORDING,
    ),
    Kind(
        "rich recording", ("rich.toml",),
        ("check in/rich.toml", "offsets in/rich.toml --turning 0,9.5"), also=("rich.csv",),
    ),
    Kind(
        "live", ("live_refused.toml", "live.toml"),
        ("live in/live_refused.toml --seconds 0.1",),
        ("live in/live.toml --seconds 0.1 --out out/session",), ends=2,
        also=("notes.txt", "calibration.toml"),
    ),
    Kind(
        "subject", ("subject.toml",), ("check in/subject_recording.toml",) * 3
        + ("retarget in/motion.npz --onto in/subject.toml --out out/played",),
        also=("subject_recording.toml", "motion.npz", *RECORDING),
    ),
    Kind(
        "static trial", ("static.trc", "static_recording.toml"),
        ("check in/static_recording.toml", f"scale --static in/static.trc {BY_NAME} --mass 70 "
         "--out out/made.toml"),
        also=("static_recording.toml", *RECORDING, "static.trc"),
    ),
    Kind(
        "calibration", ("calibration.toml",), ("check in/recording.toml",),
        also=RECORDING,
    ),
    Kind(
        "lens", ("lens.toml",),
        (f"{PLACED} --intrinsics in/lens.toml", f"{POINTS} --intrinsics in/lens.toml",
         f"{PLACED} --intrinsics in/lens.toml --origin 100,100 --up y"),
        also=("board0.png", "points.csv"),
    ),
    Kind(
        "OpenCV's YAML", ("cam.yml",),
        ("check in/yaml.toml",), also=("yaml.toml", "markers.trc", "cam.mp4"),
    ),
    Kind(
        "XML calibrations", ("lab.qca.txt", "lab.xcp", "lab.mcal"),
        ("convert in/lab.qca.txt out/made.toml", "convert in/lab.xcp out/made.toml",
         "convert in/lab.mcal out/made.toml"),
    ),
    Kind(
        "pickled calibration", ("cam.pickle",), ("convert in/cam.pickle out/made.toml",),
    ),
    Kind(
        "EasyMocap's calibration", ("intri.yml", "extri.yml"),
        ("convert in/intri.yml out/made.toml --size 1920x1080",
         "convert in/extri.yml out/made.toml --size 1920x1080 --unit mm --source-up y"),
        also=("intri.yml", "extri.yml"),
    ),
    Kind(
        "TOML calibrations", ("camera_array.toml", "sesh_camera_calibration.toml", "anipose.toml"),
        ("convert in/camera_array.toml out/made.toml", "convert in/anipose.toml out/made.toml",
         "convert in/sesh_camera_calibration.toml out/made.toml"),
    ),
    Kind(
        "points", ("points.csv",), (f"{POINTS} --intrinsics in/lens.toml",),
        also=("board0.png", "lens.toml"),
    ),
    Kind(
        "TRC", ("markers.trc",),
        ("check in/recording.toml", "convert in/markers.trc out/made.csv",
         "convert in/markers.trc out/made.c3d", "convert in/markers.trc out/made.trc --rate 100"),
        (TRACK,), also=RECORDING,
    ),
    Kind(
        "CSV", ("markers.csv",),
        ("check in/csv.toml", "convert in/markers.csv out/made.trc",
         "convert in/markers.csv out/made.c3d --rate 30"),
        also=("csv.toml", "cam.mp4", "calibration.toml"),
    ),
    Kind(
        "CSV of orientations", ("rich.csv",),
        ("check in/rich.toml", "convert in/rich.csv out/made.csv --rate 30",
         "convert in/rich.csv out/made.c3d", "offsets in/rich.toml --turning 0,9.5"),
        also=("rich.toml",),
    ),
    Kind(
        "C3D", ("markers.c3d",),
        ("check in/c3d.toml", "convert in/markers.c3d out/made.trc",
         "convert in/markers.c3d out/made.c3d --rate 50"),
        also=("c3d.toml", "cam.mp4", "calibration.toml"),
    ),
    Kind(
        "joints", ("joints.trc",),
        ("evaluate in in/markers.trc --match elbow_l=LWrist",
         "evaluate in in/joints.trc --match elbow_l=elbow_l elbow_r=elbow_r --json -"),
        also=("markers.trc",),
    ),
    Kind(
        "BVH", ("motion.bvh",),
        ("convert in/motion.bvh out/made.npz", "convert in/motion.bvh out/made.trc",
         "convert in/motion.bvh out/made.glb --rate 60", "convert in/motion.bvh out/made.bvh",
         "evaluate in in/motion.bvh --match elbow_l=LeftForeArm"),
        also=("joints.trc",),
    ),
    Kind(
        "glTF", ("motion.glb",),
        ("convert in/motion.glb out/made.npz", "convert in/motion.glb out/made.trc",
         "convert in/motion.glb out/made.bvh --rate 60", "convert in/motion.glb out/made.glb",
         "evaluate in in/motion.glb --match elbow_l=leftLowerArm"),
        also=("joints.trc",),
    ),
    Kind(
        "MOT", ("motion.mot",),
        ("convert in/motion.mot out/made.npz --body in/motion.npz",
         "convert in/motion.mot out/made.bvh --body in/motion.bvh",
         "convert in/motion.mot out/made.mot --angles isb --body in/motion.npz"),
        also=("motion.npz", "motion.bvh"),
    ),
    Kind(
        "motion", ("motion.npz",),
        ("convert in/motion.npz out/made.bvh", "convert in/motion.npz out/made.glb",
         "convert in/motion.npz out/made.trc", "convert in/motion.npz out/made.mot",
         "convert in/motion.npz out/made.npz --rate 60",
         "convert in/motion.mot out/made.npz --body in/motion.npz"),
        ("retarget in/motion.npz --onto in/subject.toml --out out/played",),
        also=("motion.mot", "subject.toml"),
    ),
    Kind(
        "surface", ("model/surface.npz",),
        ("retarget in/motion.npz --onto in/model --out out/played",),
        also=("model", "motion.npz"),
    ),
    Kind(
        "model", ("model/subject.toml", "model/texture.png"),
        ("retarget in/motion.npz --onto in/model --out out/played",),
        also=("model", "motion.npz"),
    ),
    Kind(
        "people", ("people.npz",),
        ("silhouette demo --person in/people.npz --seconds 0.01 --out out/demo",), ends=2,
    ),
    Kind(
        "key points", ("keypoints/cam_000003_keypoints.json",),
        ("track in/keypoints.toml --out out/tracked",), ends=2,
        also=("keypoints.toml", "keypoints", "nobody.json", *RECORDING),
    ),
    Kind(
        "key points of a video", ("list.json",),
        ("track in/keypoint_list.toml --out out/tracked",), ends=2,
        also=("keypoint_list.toml", "nobody.json", *RECORDING),
    ),
    Kind(
        "background", ("room.png",),
        (f"silhouette track in/background.toml {AT}",), ends=2,
        also=("background.toml", "nobody.json", *RECORDING),
    ),
    Kind(
        "photographs", ("front.png", "joint.png", "photographed.toml"),
        (MODEL,), ends=2, also=("front.png", "side.png", "joint.png", "arm_side.png",
                                "photographed.toml"),
    ),
    Kind(
        "pictures of boards", ("board0.png", "board1.png"),
        (f"{PLACED} --intrinsics in/lens.toml",
         f"calibrate intrinsics {VIEWS} {BOARD}"),
        also=("lens.toml", *(f"board{i}.png" for i in range(6))),
    ),
    Kind(
        "JPEG", ("board.jpg",),
        (f"{PLACED} --intrinsics in/lens.toml".replace("board0.png", "board.jpg"),),
        also=("lens.toml",),
    ),
    Kind(
        "video", ("cam.mp4",),
        ("check in/recording.toml", "check in/recording.toml", "sync in/recording.toml"),
        (TRACK,), also=RECORDING,
    ),
    Kind("folder", ("recording.rrd",), ("view in",), also=("notes.txt",)),
)  # fmt: skip
BY_KIND = {kind.name: kind for kind in KINDS}
# Of arguments themselves: any of the commands.
ARGUMENTS = "arguments"
# Numbers and names behind options that the commands above do not have.
MORE_COMMANDS = (
    "scale --height 1.8 --mass 75 --out out/made.toml",
    "evaluate in in/joints.trc --match elbow_l=elbow_l --up z --offset 0.1",
    "check in/recording.toml --json out/figures.json",
    "track in/keypoints.toml --out out/tracked --cameras cam --height 1.8 --causal",
    f"{PLACED} --intrinsics in/lens.toml --origin 100,100 --up y --pictures out/drawn",
    "convert in/motion.npz out/made.bvh --names humanik --unit cm --rate 30",
    "live in/live_refused.toml --seconds 0.1 --smooth --refine none",
    "silhouette demo --person in/people.npz --seed 1 --seconds 0.01 --out out/demo",
    f"{MODEL} --bottom 100 --height 1.8",
    "view in",
    "scale --recording in/recording.toml --height 1.8 --wrists --out out/made.toml",
    "silhouette track in/background.toml --model in/model --at 0,0,0 --once --out out/tracked",
    "calibrate intrinsics in/board0.png in/board.jpg --board 4x7 --square 0.06 "
    "--charuco 5X5_100,0.045 --camera cam --distortions 2 --out out/made.toml",
)
