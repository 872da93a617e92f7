"""Options of the silhouette tracker's settings: which body, how a frame is segmented and fitted.

INPUTS: a command's parser; parsed options. OUTPUTS: the options; the Settings that they ask for.
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from jaxmocap.cli.option_types import whole_number

if TYPE_CHECKING:
    from jaxmocap.silhouette.settings import Settings

# The bodies of ``body/data``; --help does not load those.
BODIES = ("torso", "legs", "whole", "supple", "human")
# How many low-passes ``RimSettings`` has.
LEVELS = 3


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
        help="then segment and fit again until both settle, so many times at most; "
        "default: %(default)s",
    )


def settings_of(options: argparse.Namespace, by_hand: bool = False) -> Settings:
    """The settings that the options ask for; ``by_hand`` where the first pose is rough."""
    from jaxmocap.pipelines.silhouettes.first_pose import settings_for

    loop = {name: getattr(options, name) for name in ("grey", "frequencies", "settle")}
    return settings_for(f"{options.model_file}.toml", by_hand, **loop)
