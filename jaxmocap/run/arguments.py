"""What ``convert`` takes on the command line, and the text that explains it.

INPUTS: the command's parser. OUTPUTS: the parser with its options.
"""

import argparse
from pathlib import Path

from jaxmocap.setup.arguments import positive

CARRIED = """\
Markers: .c3d .trc .csv. Motions: .npz .bvh .glb .mot; their joints can become markers. What a
format cannot hold is left out and said. .bvh and .glb are Y up, facing Z, their rest pose a T with
the arms out to the sides; joints made of them are Z up. Markers keep their file's axes."""


def add_convert(parser: argparse.ArgumentParser) -> None:
    """Options of ``convert``."""
    parser.description = f"{parser.description}\n\n{CARRIED}"
    parser.add_argument("source", metavar="FROM")
    parser.add_argument("target", metavar="TO")
    parser.add_argument(
        "--names",
        choices=("jaxmocap", "vrm", "humanik", "smpl", "isb"),
        help="what joints are called; default: humanik in .bvh, vrm in .glb, else as they are",
    )
    parser.add_argument(
        "--unit",
        choices=("m", "cm", "mm", "in"),
        help="of the .bvh (the one written, if both are), which does not say; default: metres when "
        "written, told by the body's size when read",
    )
    parser.add_argument(
        "--rate", metavar="HZ", type=positive, help="samples per second; default: as they are"
    )
    parser.add_argument(
        "--body", metavar="FILE", type=Path, help=".npz, .bvh or .glb of the body that a .mot is of"
    )
    parser.add_argument(
        "--angles",
        choices=("hinges", "isb"),
        help="of the .mot written: the skeleton's hinges, from which the motion can be read again, "
        "or joint angles by ISB's conventions; default: hinges",
    )
