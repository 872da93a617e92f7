"""``python -m bench.stature person.npz [--people WHO,...] [--sex]``: people by stature alone.

People whose bodies are nobody's construction of ours do exercises before one camera, with markers
at the vertex and both wrists. Of their bodies the recording states the stature, as most users do,
and with --sex whether it is a man or a woman. What is off is mostly where published proportions put
their joints.

INPUTS: person.npz. OUTPUTS: mean position errors of joints, centimetres, a line for each clip;
Metrics.
"""

from pathlib import Path

import numpy as np

from bench import command, kept
from bench.figures import Metric, write_json
from jaxmocap.evaluation.errors import evaluate
from jaxmocap.evaluation.tables import align_columns
from jaxmocap.formats.cameras.calibration import write_calibration
from jaxmocap.formats.recordings.recording import load_recording, write_recording
from jaxmocap.formats.time_series.csv import write_csv
from jaxmocap.formats.time_series.trc import write_trc
from jaxmocap.pipelines.kept_programs import keep_compiled
from jaxmocap.pipelines.progress import progress_bar
from jaxmocap.pipelines.tracking.track import track
from jaxmocap.synthetic.four_cameras import cameras_around, frame_times
from jaxmocap.synthetic.movements.exercises import exercise
from jaxmocap.synthetic.people.rigged_mesh import load_rig
from jaxmocap.synthetic.recording import MARKER_RATE, VIDEO_RATE, write_video
from jaxmocap.synthetic.renderer import render_frames

EXERCISES = ("arm_raises", "walking", "turn")
JOINTS = ("elbow", "shoulder", "hip", "knee", "ankle")
# Marker -> landmark and bone that it is at the end of.
MARKERS = {
    "Head": ("vertex", "head"),
    "LWrist": ("wrist_l", "radius_l"),
    "RWrist": ("wrist_r", "radius_r"),
}
# White noise of a marker, metres.
NOISE_M = 0.001


def render(folder: Path, file: Path, who: str, name: str, seed: int, seconds: float) -> Path:
    """Somebody's exercise before the camera in front; the recording's path."""
    if (folder / "recording.toml").exists():
        return folder / "recording.toml"
    performer, frames = (
        exercise(load_rig(file, who, seed), name, seconds, seed),
        frame_times(seconds),
    )
    view = cameras_around(performer, seconds)[0]
    folder.mkdir(parents=True, exist_ok=True)
    with progress_bar(f"rendering {who}, {name}", True) as show:
        write_video(
            folder / "cam_1.mp4",
            shown(render_frames(view.scene(performer, seed), frames), show, len(frames)),
        )
    write_trc(folder / "truth.trc", frames, performer.landmarks(frames), rate=VIDEO_RATE)
    times = np.arange(0.0, frames[-1], 1 / MARKER_RATE)
    truth, rng = performer.landmarks(times), np.random.default_rng(seed)
    noisy = {
        marker: truth[landmark] + rng.normal(0, NOISE_M, (len(times), 3))
        for marker, (landmark, _) in MARKERS.items()
    }
    write_csv(folder / "markers.csv", times, noisy)
    write_calibration(folder / "calibration.toml", {view.name: view.camera})
    places = {marker: {"bone": bone, "at": 1.0} for marker, (_, bone) in MARKERS.items()}
    videos = [{"file": "cam_1.mp4", "camera": view.name}]
    subject = described(file, who)
    return write_recording(folder, "markers.csv", places, videos, "calibration.toml", subject)


def described(file: Path, who: str, sex: bool = False) -> dict[str, float | str]:
    """A [subject]: the stature and, where asked for, the sex of who is called man or woman."""
    stated = "female" if who.endswith("woman") else "male"
    return {"height": stature(file, who)} | ({"sex": stated} if sex else {})


def shown(frames, show, count: int):
    """The frames, counted."""
    for i, frame in enumerate(frames, 1):
        yield frame
        show(i, count)


def stature(file: Path, who: str) -> float:
    """Metres, of the mesh as it stands."""
    with np.load(file) as arrays:
        people = [str(each) for each in arrays["people"]]
        return round(float(np.ptp(arrays["vertices"][people.index(who)][:, 2])), 3)


def measure(recording: Path, subject: dict) -> dict[str, float]:
    """Mean position error of each kind of joint, metres, of a person so described."""
    motion = track(load_recording(recording, subject), progress=True)
    truth = recording.with_name("truth.trc")
    return {
        joint: evaluate(motion, truth, {f"{joint}_{s}": f"{joint}_{s}" for s in "lr"}).mean
        for joint in JOINTS
    }


def main() -> None:
    """Render, track, print."""
    parser = command("bench.stature", __doc__)
    parser.add_argument("file", type=Path, help="person.npz")
    parser.add_argument("--people", metavar="WHO,...", help="default: all")
    parser.add_argument("--sex", action="store_true", help="state it: man and woman of their names")
    parser.add_argument("--seconds", type=float, default=3.0, help="default: 3")
    parser.add_argument("--keep", metavar="DIR", help="where rendered recordings stay")
    options = parser.parse_args()
    keep_compiled()
    with np.load(options.file) as arrays:
        everybody = [str(each) for each in arrays["people"]]
    people = options.people.split(",") if options.people else everybody
    rows = [["person", "exercise", *(f"{joint} cm" for joint in JOINTS)]]
    every = []
    with kept(options.keep) as keep:
        for who in people:
            for i, name in enumerate(EXERCISES):
                folder = keep / f"{who}_{name}"
                seed = 10 * everybody.index(who) + i
                clip = render(folder, options.file, who, name, seed, options.seconds)
                errors = measure(clip, described(options.file, who, options.sex))
                every.append([100 * errors[joint] for joint in JOINTS])
                rows.append([who, name, *(f"{error:.1f}" for error in every[-1])])
    mean = np.mean(every, 0)
    rows.append([f"mean of {len(every)}", "", *(f"{error:.1f}" for error in mean)])
    print(align_columns(rows))
    metrics = [Metric(joint, error, "cm") for joint, error in zip(JOINTS, mean, strict=True)]
    write_json(metrics, options.json)


if __name__ == "__main__":
    main()
