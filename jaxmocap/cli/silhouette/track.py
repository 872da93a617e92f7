"""``jaxmocap silhouette track``: a person before one to four cameras, without markers.

INPUTS: a recording. OUTPUTS: a folder with the motion in every format, a report, overlay videos.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from jaxmocap.cli.command import exit_code, numbers, report, whole_number
from jaxmocap.cli.recording_options import add_cameras, recording_of

if TYPE_CHECKING:
    from jaxmocap.silhouette.settings import Settings

PURPOSE = "track a recording of one to four cameras"
EXAMPLE = "jaxmocap silhouette track recording.toml --out tracked --at 0,0,90"

# The bodies of ``body/data``; --help does not load those.
BODIES = ("torso", "legs", "whole", "supple", "human")
# How many low-passes ``RimSettings`` has.
LEVELS = 3


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("recording", metavar="RECORDING.toml")
    parser.add_argument("--out", metavar="DIR", required=True, help="where to write")
    add_cameras(parser, "use these of the recording's cameras")
    parser.add_argument(
        "--at",
        metavar="X,Y,FACING",
        type=numbers(3, "X,Y,FACING"),
        help="where the person stands upright at first, metres, and faces, degrees from x towards "
        "y, in the calibration's world; a foot or a mark on the floor tells ('jaxmocap help "
        "silhouettes'); default: by the recording's markers, or else its key points",
    )
    passes = parser.add_mutually_exclusive_group()
    passes.add_argument(
        "--once",
        dest="passes",
        action="store_const",
        const=1,
        help="one pass, which learns the rooms from its frames so far, and no girths; default: two "
        "passes learn both, but not by one camera with key points, where that helps little",
    )
    passes.add_argument(
        "--lengths",
        action="store_true",
        help="let these passes correct the bones' lengths too, where no static trial measures them",
    )
    parser.add_argument("--markers", action="store_true", help="follow the recording's markers too")
    parser.add_argument(
        "--guess",
        action="store_true",
        help="track by one camera without key points or markers all the same; the person is "
        "mostly lost, and the report says so",
    )
    add_settings(parser)
    morphing = parser.add_mutually_exclusive_group()
    morphing.add_argument(
        "--shoulders",
        action="store_true",
        help="let shoulders go along with raised arms, joints up and back and the skin inwards; "
        "default: they stay on the chest",
    )
    morphing.add_argument(
        "--morphing",
        metavar="FILE.toml",
        help="let joints and skin go along as this file has it: [[joint]] and [[swelling]] as in "
        "the package's body/data/shoulder.toml, [[transition]] into another surface",
    )
    parser.add_argument(
        "--model",
        metavar="DIR",
        help="the person's own, as 'silhouette model' wrote it; default: a body of people's mean "
        "proportions around the recording's [subject]",
    )


def run(options: argparse.Namespace) -> int:
    from jaxmocap.body.skeleton import with_joints
    from jaxmocap.pipelines.kept_programs import keep_compiled
    from jaxmocap.pipelines.silhouettes.first_pose import morphing_for, start_pose
    from jaxmocap.pipelines.silhouettes.keypoints import check_determined, lost_sentences
    from jaxmocap.pipelines.silhouettes.person import person_files, with_model
    from jaxmocap.pipelines.silhouettes.track import track_silhouettes
    from jaxmocap.pipelines.silhouettes.writing import results_folder, write_results
    from jaxmocap.pipelines.summary import figures, summary

    keep_compiled()
    recording, person = with_model(recording_of(options), options.model)
    model_files = person_files(Path(options.model)) if options.model else []
    settings = settings_of(options, by_hand=options.at is not None)
    surface, body = person and person.surface, with_joints(recording.skeleton, settings.body)
    morphing = morphing_for(body, surface, options.shoulders, options.morphing)
    inputs = [*model_files, Path(options.morphing)] if options.morphing else model_files
    results_folder(options.out, recording, inputs)
    warnings_before = check_determined(recording, options.markers, options.guess)
    start = start_pose(recording, options.at, settings.body)
    followed = track_silhouettes(
        recording,
        start,
        passes=options.passes,
        markers=options.markers,
        lengths=options.lengths,
        surface=surface,
        settings=replace(settings, morphing=morphing),
        progress=True,
        warnings_before=warnings_before,
    )
    warnings: list[str] = []
    where = recording, options.out, True, person, inputs, warnings.append
    files = write_results(followed, *where)
    given = followed.motion, files, warnings
    report(options, summary(*given), figures(*given))
    return exit_code(options, lost_sentences(followed.motion))


def add_settings(parser: argparse.ArgumentParser) -> None:
    """The options of ``settings_of``."""
    parser.add_argument(
        "--model-file",
        choices=BODIES,
        default="supple",
        help="the body's joints and parts: the paper's torso of 21 degrees of freedom, its legs "
        "of 18, the whole of 33, with wrists and neck that bend 40, or the first paper's; "
        "default: %(default)s",
    )
    parser.add_argument(
        "--grey",
        action="store_true",
        help="segment by histograms of grey levels, as the paper does; default: of colours, and by "
        "what each pixel of the room looks like",
    )
    parser.add_argument(
        "--frequencies",
        type=int,
        choices=range(LEVELS + 1),
        default=0,
        help="match so many low-passes of the surface, coarse to fine, before the surface itself, "
        "in every frame; default: %(default)s",
    )
    parser.add_argument(
        "--settle",
        metavar="ROUNDS",
        type=whole_number,
        default=0,
        help="segment and fit again in each frame until both settle, so many times at most; "
        "default: %(default)s",
    )


def settings_of(options: argparse.Namespace, by_hand: bool = False) -> Settings:
    """The settings that the options ask for; ``by_hand`` where the first pose is rough."""
    from jaxmocap.silhouette.settings import FAR_OFF, GREY, Settings, progressive

    usual = Settings()
    return replace(
        usual,
        body=f"{options.model_file}.toml",
        cycles=progressive(usual.cycles, options.frequencies, len(usual.rim.levels)),
        starting_cycles=FAR_OFF if by_hand else (),
        settling_rounds=options.settle,
        plan=GREY if options.grey else usual.plan,
    )
