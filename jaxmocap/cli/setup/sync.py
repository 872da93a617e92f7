"""``jaxmocap sync``: the videos' offsets from the markers' clock, by the motion itself.

INPUTS: a recording. OUTPUTS: an offset for each video; exit code 1 where one cannot be determined.
The recording's file is not changed.
"""

import argparse
from dataclasses import asdict

from jaxmocap.cli.command import exit_code, positive_number, report
from jaxmocap.cli.recording_options import add_cameras, recording_of

PURPOSE = "find the videos' offsets from the motion itself"
EXAMPLE = "jaxmocap sync recording.toml"

# Seconds; the time that it takes grows with them.
MOST_S = 60.0


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("recording", metavar="RECORDING.toml")
    parser.add_argument(
        "--search",
        metavar="S",
        type=positive_number,
        default=1.0,
        help="how far the stated offsets may be off, seconds; default: %(default)s",
    )
    add_cameras(parser, "find those of these cameras only")


def run(options: argparse.Namespace) -> int:
    from jaxmocap.calibration.sync import estimate_video_offsets, sync_text
    from jaxmocap.formats.files.errors import InputError

    if options.search > MOST_S:
        found = f"found {options.search:g}, expected at most {MOST_S:g} seconds"
        raise InputError("--search", found)
    videos = estimate_video_offsets(recording_of(options), options.search)
    report(options, sync_text(videos), {"videos": [asdict(video) for video in videos]})
    count = sum(not video.is_found for video in videos)
    return exit_code(options, [f"no offset of {count} of {len(videos)} videos"] if count else [])
