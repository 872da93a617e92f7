"""Options of the silhouette tracker's settings: which body, what goes along.

INPUTS: a command's parser; parsed options. OUTPUTS: the options; the Settings that they ask for.
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from jaxmocap.silhouette.settings import Settings

# The bodies of ``body/data``; --help does not load those.
BODIES = ("torso", "legs", "whole", "supple", "human")


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
        "--shoulders",
        action="store_true",
        help="let shoulders go along with raised arms, up and back, as most people's do",
    )


def settings_of(options: argparse.Namespace, by_hand: bool = False) -> Settings:
    """The settings that the options ask for; ``by_hand`` where the first pose is rough.

    Raises:
        InputError: the body does not have the joints for them.
    """
    from jaxmocap.pipelines.silhouettes.first_pose import settings_for

    return settings_for(f"{options.model_file}.toml", by_hand, options.shoulders)
