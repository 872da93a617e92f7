"""What the commands do: call what does it, print what it found.

INPUTS: parsed options. OUTPUTS: text; figures where --json says; an exit code, None for 0.

Before any work it is looked whether what is to be written can be. Each imports what it needs when
it runs, so that ``--help`` is quick.
"""

import argparse
from pathlib import Path

from jaxmocap.cli.reporting import done, inputs_named, print_lines, report
from jaxmocap.pipelines.signals import Terminated


def demo(options: argparse.Namespace) -> None:
    """Make a synthetic recording, track it and show what video brings."""
    from jaxmocap.pipelines.demo import demonstrate
    from jaxmocap.pipelines.kept_programs import keep_compiled

    keep_compiled()
    shown = demonstrate(options.out, options.seconds, options.seed, progress=True)
    files = "\n".join(f"written  {path}" for path in shown.files)
    report(options, f"{shown.table()}\n\n{files}", shown.as_dict())


def check(options: argparse.Namespace) -> None:
    """Look for mistakes in a recording's file, as ``track`` does before it begins."""
    from jaxmocap.formats.recordings.recording import load_recording
    from jaxmocap.pipelines.check import check

    checked = check(load_recording(options.recording))
    report(options, checked.text(), checked.figures())
    checked.refuse()


def track(options: argparse.Namespace) -> int:
    """Track a recording and write everything; 1 where the body is far off its markers."""
    from jaxmocap.cli import choose_recording
    from jaxmocap.formats.recordings.recording import load_recording
    from jaxmocap.pipelines.kept_programs import keep_compiled
    from jaxmocap.pipelines.summary import figures, misfit, summary
    from jaxmocap.pipelines.tracking import track as offline
    from jaxmocap.pipelines.writing import tracked_folder, write_outputs

    keep_compiled()
    recording = load_recording(options.recording)
    if options.cameras:
        recording = choose_recording.select_cameras(recording, options.cameras)
    if options.height:
        recording = choose_recording.with_height(recording, options.height)
    settings = offline.choose_settings(options.refine, options.paper)
    tracked_folder(options.out, recording)
    motion = offline.track(recording, settings, mode=options.mode, progress=True)
    left_out: list[str] = []
    files = write_outputs(motion, recording, options.out, settings, True, left_out.append)
    report(options, summary(motion, files, left_out), figures(motion))
    sentence = misfit(motion)
    return done(options, [sentence] if sentence else [])


def batch(options: argparse.Namespace) -> int:
    """Track a corpus; what an earlier run has done is kept. 1 where a recording failed."""
    from jaxmocap.pipelines.batch.batch import Wanted, track_corpus

    wanted = Wanted(options.refine, options.mode)
    how = {"scheduler": options.scheduler, "workers": options.workers}
    how["timeout_s"] = options.job_timeout
    found = track_corpus(options.corpus, options.out, wanted, **how, progress=True)
    report(options, found.text(), found.figures())
    count = len(found.failures)
    return done(options, [f"{count} recordings failed"] if count else [])


def sync(options: argparse.Namespace) -> int:
    """Find the videos' offsets; nothing is changed. 1 where one cannot be told."""
    from dataclasses import asdict

    from jaxmocap.calibration.sync import estimate_video_offsets, sync_text
    from jaxmocap.cli import choose_recording
    from jaxmocap.formats.recordings.recording import load_recording

    recording = load_recording(options.recording)
    if options.cameras:
        recording = choose_recording.select_cameras(recording, options.cameras)
    found = estimate_video_offsets(recording, options.search)
    report(options, sync_text(found), {"videos": [asdict(each) for each in found]})
    count = sum(not each.is_found for each in found)
    return done(options, [f"no offset of {count} of {len(found)} videos"] if count else [])


def warmup(options: argparse.Namespace) -> None:
    """Compile ahead, and say what it took."""
    from jaxmocap.pipelines import warmup
    from jaxmocap.pipelines.tracking import track as offline

    ways = warmup.warm_up(
        warmup.asked_for(options.recording), offline.choose_settings(options.refine)
    )
    report(options, warmup.text(ways), warmup.figures(ways))


def evaluate(options: argparse.Namespace) -> None:
    """Compare joints.trc with a reference."""
    from jaxmocap.evaluation.errors import evaluate_directory
    from jaxmocap.evaluation.tables import format_table

    errors = evaluate_directory(
        options.directory, options.truth, dict(options.match), options.up, options.offset
    )
    report(options, format_table(errors), errors.as_dict())


def convert(options: argparse.Namespace) -> None:
    """Make one file into another."""
    from jaxmocap.formats.convert import ConversionOptions, convert_file
    from jaxmocap.formats.files.writing import check_target

    body = [] if options.body is None else [options.body]
    check_target(options.target, [options.source, *body])
    wanted = ConversionOptions(
        options.names, options.unit, options.rate, options.body, options.angles
    )
    notes = convert_file(options.source, options.target, wanted)
    print_lines([*notes, f"written: {options.target}"])


def retarget(options: argparse.Namespace) -> None:
    """Play a motion with another person's body."""
    from jaxmocap.pipelines.retarget import retarget, retargeted_folder, write_retargeted

    folder = retargeted_folder(options.out, options.source, options.onto)
    played = retarget(options.source, options.onto)
    left_out: list[str] = []
    files = write_retargeted(played, folder, left_out.append)
    lines = [played.text(files), *(f"warning        {sentence}" for sentence in left_out)]
    report(options, "\n".join(lines), played.figures())


def live(options: argparse.Namespace) -> int:
    """Track what comes in until Ctrl-C; 1 where nothing came in or it was not all recorded.

    Raises:
        Terminated: after everything, where SIGTERM ended it.
    """
    from jaxmocap.pipelines.kept_programs import keep_compiled
    from jaxmocap.pipelines.live.session import live_summary, run_live

    keep_compiled()
    figures = run_live(
        options.setup,
        out=options.out,
        smooth=options.smooth,
        refine=options.refine,
        seconds=options.seconds,
        view=options.view,
    )
    report(options, live_summary(figures), figures)
    if figures["terminated"]:
        raise Terminated
    return done(options, figures["problems"])


def scale(options: argparse.Namespace) -> None:
    """Write a person's body."""
    from jaxmocap.formats.files.writing import check_target
    from jaxmocap.formats.recordings.subject import check_replaceable
    from jaxmocap.pipelines.scaling.scale import scale

    check_target(options.out, inputs_named(options))
    check_replaceable(Path(options.out))
    stated = options.height, options.static, options.recording, dict(options.landmarks), options.up
    scaled = scale(options.out, *stated, options.mass, options.wrists, progress=True)
    report(options, scaled.text(), scaled.figures())


def offsets(options: argparse.Namespace) -> None:
    """Find where devices sit seen from the joints they turn about."""
    from jaxmocap.calibration.offsets import find_offsets
    from jaxmocap.calibration.offsets_report import offsets_figures, offsets_text

    span = options.turning or (float("-inf"), float("inf"))
    found = find_offsets(options.recording, options.still, span)
    report(options, offsets_text(found), offsets_figures(found))


def calibrate_intrinsics(options: argparse.Namespace) -> None:
    """Find a camera's intrinsics."""
    from jaxmocap.calibration import calibration_report
    from jaxmocap.calibration.board.boards import parse_board
    from jaxmocap.calibration.calibrate import calibrate_camera

    board = parse_board(options.board, options.square, options.charuco)
    found = calibrate_camera(
        options.paths, board, options.camera, options.out, options.distortions, options.pictures
    )
    text, figures = calibration_report.intrinsics_text, calibration_report.intrinsics_figures
    report(options, text(found), figures(found))


def calibrate_extrinsics(options: argparse.Namespace) -> None:
    """Find where a camera stands."""
    from jaxmocap.calibration import calibration_report
    from jaxmocap.calibration.place_camera import parse_target, place_camera

    seen = parse_target(
        options.board,
        options.square,
        options.charuco,
        options.pose,
        options.origin,
        options.points,
        options.up,
    )
    files = options.out, options.intrinsics, options.pictures
    found = place_camera(options.image, seen, options.camera, *files, options.upside_down)
    text, figures = calibration_report.extrinsics_text, calibration_report.extrinsics_figures
    report(options, text(found), figures(found))


def silhouette_track(options: argparse.Namespace) -> None:
    """Track a recording without markers and write everything."""
    from jaxmocap.cli import choose_recording
    from jaxmocap.formats.recordings.recording import load_recording
    from jaxmocap.pipelines.kept_programs import keep_compiled
    from jaxmocap.pipelines.silhouettes.first_pose import settings_for, start_pose
    from jaxmocap.pipelines.silhouettes.person import modelled, person_files
    from jaxmocap.pipelines.silhouettes.track import follow
    from jaxmocap.pipelines.silhouettes.writing import followed_folder, write_followed
    from jaxmocap.pipelines.summary import figures, summary

    keep_compiled()
    recording = load_recording(options.recording)
    if options.cameras:
        recording = choose_recording.select_cameras(recording, options.cameras)
    recording, person = modelled(recording, options.model)
    read = person_files(Path(options.model)) if options.model else []
    followed_folder(options.out, recording, read)
    start = start_pose(recording, options.at)
    asked = {name: getattr(options, name) for name in ("passes", "markers", "lengths")}
    asked["surface"] = person and person.surface
    asked["settings"] = settings_for(options.at is not None, options.shoulders)
    followed = follow(recording, start, **asked, progress=True)
    left_out: list[str] = []
    where = recording, options.out, True, person, read, left_out.append
    files = write_followed(followed, *where)
    report(options, summary(followed.motion, files, left_out), figures(followed.motion))


def silhouette_demo(options: argparse.Namespace) -> None:
    """Make a synthetic recording by four cameras, track it and compare it with the truth."""
    from jaxmocap.pipelines.kept_programs import keep_compiled
    from jaxmocap.pipelines.silhouettes.demo import demonstrate

    keep_compiled()
    chosen = options.seconds, options.seed, options.person, options.exercise
    shown = demonstrate(options.out, *chosen, progress=True)
    files = "\n".join(f"written  {path}" for path in shown.files)
    report(options, f"{shown.text()}\n\n{files}", shown.as_dict())


def silhouette_model(options: argparse.Namespace) -> None:
    """Make a person's own model of four photographs, with pictures of every step."""
    from jaxmocap.pipelines.silhouettes import model as modelling

    files = {name: getattr(options, name) for name in modelling.PHOTOGRAPHS}
    folder = modelling.model_folder(options.out, [*files.values(), options.calibration])
    asked = options.calibration, options.out, options.bottom, options.height
    made = modelling.model_from(files, *asked)
    written = modelling.write_model(made, folder)
    report(options, modelling.model_text(made, written), made.figures())


def view(options: argparse.Namespace) -> None:
    """Open the viewer, or serve it until Ctrl-C."""
    from jaxmocap.pipelines.view import open_viewer, recording_in, serve_page

    path = recording_in(options.directory)
    if not options.web:
        print(open_viewer(path))
        return
    served = serve_page(path, options.port)
    print(f"{path}\nat {served.page}\nuntil Ctrl-C", flush=True)
    served.until_interrupted()
