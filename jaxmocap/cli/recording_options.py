"""Options that several commands share: which cameras, what height, which settings.

INPUTS: a command's parser; parsed options. OUTPUTS: the options; the Recording that they name.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from jaxmocap.cli.command import names, positive_number, whole_number
from jaxmocap.formats.files.errors import InputError

if TYPE_CHECKING:
    from jaxmocap.capture.timeline import Mode
    from jaxmocap.formats.recordings.recording import Recording
    from jaxmocap.hybrid.settings import Settings

REFINEMENTS = ("search", "simplex", "gradient", "none")


def add_cameras(parser: argparse.ArgumentParser, help_text: str) -> None:
    """The option --cameras."""
    parser.add_argument("--cameras", metavar="A,B", type=names, help=help_text)


def add_demo(parser: argparse.ArgumentParser, out: str, seconds: float, seeded: str) -> None:
    """The options --out, --seconds and --seed of a recording that is made."""
    add = parser.add_argument
    add("--out", metavar="DIR", default=out, help="default: %(default)s")
    length = "of the recording, up to 3600; default: %(default)s"
    add("--seconds", type=positive_number, default=seconds, help=length)
    add("--seed", type=whole_number, default=0, help=f"of {seeded} and noise; default: 0")


def add_settings(parser: argparse.ArgumentParser) -> None:
    """The options --refine and --settings."""
    parser.add_argument(
        "--refine",
        choices=REFINEMENTS,
        help="what video does to the pose of the markers: the body follows a search for the elbows "
        "(default); then each arm is fitted by a downhill simplex or the whole body by least "
        "squares, frame by frame, where nothing is smoothed; or none: markers only",
    )
    parser.add_argument(
        "--settings",
        metavar="FILE.toml",
        help="any of the tracker's settings by name; 'jaxmocap help settings' lists them",
    )


def mode_of(options: argparse.Namespace, settings: Settings) -> Mode:
    """How video frames and samples come together: as the options say, or else the settings."""
    return options.mode or ("own" if settings.search or settings.smooth else "nearest")


def settings_of(options: argparse.Namespace, smooth: bool | None = None) -> Settings:
    """The tracker's settings, or with --paper the first paper's, with --settings and --refine.

    ``smooth`` is whether poses are smoothed; None where the settings say so.

    Raises:
        InputError: a settings file that is none; something chosen that would have no part.
    """
    from jaxmocap.formats.settings_file import read_settings
    from jaxmocap.hybrid.settings import Settings, unused_setting

    chosen = Settings.paper() if getattr(options, "paper", False) else Settings()
    if options.settings:
        chosen = read_settings(options.settings, chosen)
    if options.refine:
        chosen = replace(chosen, refine=options.refine)
    live, smooth = smooth is not None, chosen.smooth if smooth is None else smooth
    causal = live or getattr(options, "mode", None) == "causal"
    if problem := unused_setting(chosen, smooth, causal):
        raise InputError("--refine" if options.refine else options.settings, problem)
    return chosen


def recording_of(options: argparse.Namespace) -> Recording:
    """The recording that the options name, with --cameras and --height where they are given.

    Raises:
        InputError: it cannot be read, has no such camera, or nobody is that tall.
    """
    from jaxmocap.formats.recordings.recording import load_recording

    height = getattr(options, "height", None)
    recording = load_recording(options.recording, {"height": height} if height else None)
    return select_cameras(recording, options.cameras) if options.cameras else recording


def select_cameras(recording: Recording, camera_names: Sequence[str]) -> Recording:
    """The recording with some of its cameras, in their order there.

    Raises:
        InputError: a name that it does not have.
    """
    existing = [source.camera_name for source in recording.videos]
    for name in camera_names:
        if name not in existing:
            problem = f"no [[video]] of camera {name!r}, found {', '.join(existing) or 'no video'}"
            raise recording.error(problem)
    chosen = tuple(source for source in recording.videos if source.camera_name in camera_names)
    return replace(recording, videos=chosen)
