"""Options that several commands share: which cameras, what height, how video refines.

INPUTS: a command's parser; parsed options. OUTPUTS: the options; the Recording that they name.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from jaxmocap.cli.option_types import names
from jaxmocap.formats.files.errors import InputError

if TYPE_CHECKING:
    from jaxmocap.formats.recordings.recording import Recording

REFINEMENTS = ("simplex", "gradient", "search", "none")
EVIDENCE = ("outline", "coverage")


def add_cameras(parser: argparse.ArgumentParser, help_text: str) -> None:
    """The option --cameras."""
    parser.add_argument("--cameras", metavar="A,B", type=names, help=help_text)


def add_refine(parser: argparse.ArgumentParser, help_text: str) -> None:
    """The options --refine and --evidence."""
    parser.add_argument("--refine", choices=REFINEMENTS, default="simplex", help=help_text)
    parser.add_argument(
        "--evidence",
        choices=EVIDENCE,
        help="what of an arm is compared with the edges: its outline (default), or the area that "
        "it covers, the first paper's sum (13)",
    )


def recording_of(options: argparse.Namespace) -> Recording:
    """The recording that the options name, with --cameras and --height where they are given.

    Raises:
        InputError: it cannot be read, has no such camera, or nobody is that tall.
    """
    from jaxmocap.formats.recordings.recording import load_recording

    recording = load_recording(options.recording)
    if options.cameras:
        recording = select_cameras(recording, options.cameras)
    if height := getattr(options, "height", None):
        recording = with_height(recording, height)
    return recording


def with_height(recording: Recording, height: float) -> Recording:
    """The recording of a person of another height (metres), by published proportions.

    Raises:
        InputError: nobody's height.
    """
    from jaxmocap.body.skeleton import Skeleton

    try:
        return replace(recording, skeleton=Skeleton.human(height))
    except ValueError as error:
        raise InputError(recording.path or recording.name, str(error)) from None


def select_cameras(recording: Recording, camera_names: Sequence[str]) -> Recording:
    """The recording with some of its cameras, in their order there.

    Raises:
        InputError: a name that it does not have.
    """
    existing = [source.camera_name for source in recording.videos]
    for name in camera_names:
        if name not in existing:
            problem = f"no [[video]] of camera {name!r}, found {', '.join(existing) or 'no video'}"
            raise InputError(recording.path or recording.name, problem)
    chosen = tuple(source for source in recording.videos if source.camera_name in camera_names)
    return replace(recording, videos=chosen)
