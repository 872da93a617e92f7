"""``jaxmocap convert``: a file of markers, of a motion or a calibration in another format.

INPUTS: a file, or a folder with a calibration. OUTPUTS: another file; warnings of what its format
cannot hold.
"""

import argparse
from dataclasses import fields
from pathlib import Path

from jaxmocap.cli.command import picture_size, positive_number, report

PURPOSE = "convert a file to another format"
EXAMPLE = "jaxmocap convert tracked/motion.npz motion.bvh --unit cm"

FORMATS_TEXT = """\
Markers: .c3d .trc .csv. Motions: .npz .bvh .glb .mot; their joints can become markers. What a
format cannot hold is left out, with a warning. .bvh and .glb are Y up, facing Z, their rest pose a
T with the arms out to the sides; joints made of them are Z up. Markers keep their file's axes. With
--up y markers and joints that are Z up are written Y up.

Calibrations of Qualisys, Vicon, Motive, OpenCap, EasyMocap, Caliscope, FreeMoCap, anipose and
OpenCV become .toml: metres, Z up (jaxmocap help calibrate)."""


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.description = f"{parser.description}\n\n{FORMATS_TEXT}"
    parser.add_argument("source", metavar="FROM")
    parser.add_argument("target", metavar="TO")
    parser.add_argument(
        "--names",
        choices=("jaxmocap", "vrm", "humanik", "smpl", "isb", "opensim"),
        help="what joints are called; default: humanik in .bvh, vrm in .glb, else as they are. "
        "opensim is for a .mot: the coordinates of OpenSim's full-body model (Rajagopal 2016), "
        "always Y up",
    )
    parser.add_argument(
        "--up",
        choices=("z", "y"),
        help="vertical axis of the .trc, .c3d or .csv written; default: as it is, Z for joints",
    )
    parser.add_argument(
        "--unit",
        choices=("m", "cm", "mm", "in"),
        help="of the .bvh (the one written, if both are), which states none; default: metres when "
        "written, inferred from the body's size when read; of a calibration that states none",
    )
    parser.add_argument(
        "--rate",
        metavar="HZ",
        type=positive_number,
        help="samples per second; default: as they are",
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
    parser.add_argument(
        "--source-up",
        choices=("x", "y", "z", "minus-x", "minus-y", "minus-z"),
        help="axis of a calibration that points up; default: its system's",
    )
    parser.add_argument(
        "--size",
        metavar="WxH",
        type=picture_size,
        help="pixels of the pictures, of a calibration that does not say",
    )


def run(options: argparse.Namespace) -> None:
    from jaxmocap.formats.convert import ConversionOptions, convert_file
    from jaxmocap.formats.files.writing import check_target

    body = [] if options.body is None else [options.body]
    check_target(options.target, [options.source, *body])
    stated = {each.name: getattr(options, each.name) for each in fields(ConversionOptions)}
    warnings = convert_file(options.source, options.target, ConversionOptions(**stated))
    text = "\n".join([*warnings, f"written  {options.target}"])
    report(options, text, {"files": [options.target], "warnings": warnings})
