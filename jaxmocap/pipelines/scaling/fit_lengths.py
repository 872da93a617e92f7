"""A person's bone lengths from a clip of movement: markers on head and hands, and video.

    recording ── first pass ── second pass ── lengths and girths free as well ── subject.toml

INPUTS: a recording of somebody who stretches, swings and bends the arms.
OUTPUTS: a body in a file, and for each length whether the recording determines it.
"""

from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from jaxmocap.body.proportions import LENGTHS, scale_skeleton
from jaxmocap.body.skeleton import scale_to_height
from jaxmocap.body.subject import skeleton_stature
from jaxmocap.calibration.fitting.lengths import LengthsFit, fit_lengths
from jaxmocap.capture.footage import cached_frames, forward_readers
from jaxmocap.compilation.clock import Clock
from jaxmocap.evidence.appearance.learned import ROWS
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.recordings.recording import Recording, load_recording
from jaxmocap.formats.recordings.subject import write_subject
from jaxmocap.hybrid.tracker import HybridTracker
from jaxmocap.pipelines.progress import Progress, progress_bar
from jaxmocap.pipelines.scaling.lengths_report import LengthsReport, plot_lengths
from jaxmocap.pipelines.tracking.events import RecordingEvents, open_recording
from jaxmocap.pipelines.tracking.first_pass import scan_events
from jaxmocap.pipelines.tracking.track import with_sight_lines
from jaxmocap.smoothing.batch import FINELY, solve_recording
from jaxmocap.smoothing.settings import allow_for_noise

# Hands that move less than this about the head (RMS, metres) show too few postures.
LEAST_MOVEMENT_M = 0.10
# So do clips of fewer seconds.
LEAST_SECONDS = 1.0
ADVICE = "film 5 to 10 s of stretching, swinging and bending both arms"


def scale_by_recording(
    out: str | Path,
    path: str | Path,
    height: float | None = None,
    mass: float | None = None,
    sex: str | None = None,
    progress: Progress | bool | None = None,
) -> LengthsReport:
    """Write the body of the person in a recording, and beside it a picture of the estimates.

    The lengths start from its [subject], or from a height (metres), a mass (kilograms) and a sex
    ("female" or "male"). The picture is named as ``out`` is, and ends in .png.

    Raises:
        InputError: a recording that cannot determine lengths; what ``track`` would refuse.
    """
    recording = _load(path, height, mass, sex)
    fit = fit_recording(recording, progress)
    stated = recording.skeleton
    # The girths are those of clothes and headset, which the file is not to hold.
    lengths = fit.logarithms[: len(LENGTHS)]
    person = scale_skeleton(stated, jnp.asarray(lengths, stated.lengths.dtype))
    tall = skeleton_stature(stated) if height is None else height
    report = LengthsReport.of(stated, person, tall, fit, Path(out))
    write_subject(out, person, tall, report.lines(), sex)
    plot_lengths(report.picture, report.lengths, f"Lengths from {Path(path).name}")
    return report


def fit_recording(recording: Recording, progress: Progress | bool | None = None) -> LengthsFit:
    """Lengths and girths with which a recording's motion costs least; see ``fitting.lengths``."""
    _check_recording(recording)
    tracker, clock = HybridTracker.from_recording(recording), Clock(False)
    with progress_bar("fitting lengths", progress) as show:
        opened = open_recording(recording)
        events = RecordingEvents.of(opened.recording, opened.videos, "own", opened.cleaning)
        part = lambda done, total: show(round(36 * done / total), 100)  # noqa: E731
        with forward_readers(opened.videos) as readers:
            first = scan_events(events, tracker, readers, part, clock)
        solved = solve_recording(
            tracker.model,
            allow_for_noise(tracker.settings.smoothing, opened.noise),
            with_sight_lines(opened, events, first),
            cached_frames(opened.videos, ROWS),
            lambda share: show(round(36 + 54 * share), 100),
        )
        if solved is None:
            raise recording.error("no video frame lies within the markers' time")
        fit = fit_lengths(*solved, FINELY)
        show(100, 100)
    return fit


def _load(path: str | Path, height: float | None, mass: float | None, sex: str | None) -> Recording:
    """The recording of a person of that height, mass and sex, where they are stated."""
    if height is not None:
        subject = {"height": height, "mass": mass, "sex": sex}
        return load_recording(path, {key: v for key, v in subject.items() if v is not None})
    if sex is not None:
        raise InputError(path, "found --sex without --height, expected it in [subject]")
    recording = load_recording(path)
    if mass is None:
        return recording
    try:
        return replace(recording, skeleton=scale_to_height(recording.skeleton, None, mass))
    except ValueError as error:
        raise recording.error(str(error)) from None


def _check_recording(recording: Recording) -> None:
    """Check that a recording can determine lengths.

    Raises:
        InputError: it cannot; the message says what it lacks.
    """
    if not recording.videos:
        problem = "no [[video]]: three markers alone do not determine bone lengths, film the"
        raise recording.error(f"{problem} movement as well")
    head, *hands = (
        [i for i, place in enumerate(recording.places) if place.bone in bones]
        for bones in (("head", "neck"), ("radius_l", "hand_l"), ("radius_r", "hand_r"))
    )
    if not head or not all(hands):
        markers = ", ".join(f"{p.name} on {p.bone}" for p in recording.places) or "no marker"
        problem = f"[markers.on]: found {markers}, expected markers at the head and at both hands"
        raise recording.error(problem)
    seconds = float(np.ptp(recording.times))
    if seconds < LEAST_SECONDS:
        raise recording.error(f"{seconds:.2f} s of markers are too few, {ADVICE}")
    moved = max(_movement(recording.positions_world, head[0], hand[0]) for hand in hands)
    if moved < LEAST_MOVEMENT_M:
        problem = f"the hands keep within {100 * moved:.0f} cm (RMS) of one place before the head"
        raise recording.error(f"{problem}, too little to determine lengths: {ADVICE}")


def _movement(positions_world: np.ndarray, head: int, hand: int) -> float:
    """How far (RMS, metres) a hand goes from where it is on average, relative to the head."""
    relative = positions_world[:, hand] - positions_world[:, head]
    relative = relative[np.isfinite(relative).all(-1)]
    if not len(relative):
        return 0.0
    return float(np.sqrt(np.mean(np.sum((relative - relative.mean(0)) ** 2, -1))))
