"""What commands of this room take on the command line, and texts that explain it.

INPUTS: a command's parser. OUTPUTS: the parser with its options.
"""

import argparse
from pathlib import Path

from jaxmocap.cli.setup_arguments import finite, natural, positive

CARRIED = """\
Markers: .c3d .trc .csv. Motions: .npz .bvh .glb .mot; their joints can become markers. What a
format cannot hold is left out and said. .bvh and .glb are Y up, facing Z, their rest pose a T with
the arms out to the sides; joints made of them are Z up. Markers keep their file's axes."""


def add_check(parser: argparse.ArgumentParser) -> None:
    """Options of ``check``."""
    parser.add_argument("recording", metavar="RECORDING.toml")


def add_warmup(parser: argparse.ArgumentParser) -> None:
    """Options of ``warmup``."""
    parser.add_argument(
        "recording", metavar="RECORDING.toml", nargs="?",
        help="whose markers and cameras; default: the demo's, headset and controllers, one camera",
    )  # fmt: skip
    _add_refine(parser, "see 'track'")


def add_retarget(parser: argparse.ArgumentParser) -> None:
    """Options of ``retarget``."""
    parser.add_argument("source", metavar="DIR", help="that 'track' wrote, or a motion.npz")
    parser.add_argument(
        "--onto",
        metavar="PERSON",
        required=True,
        help="a subject file, as 'scale' writes, or a folder that 'silhouette model' wrote",
    )
    parser.add_argument("--out", metavar="DIR", required=True, help="where to write")


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


def add_batch(parser: argparse.ArgumentParser) -> None:
    """Options of ``batch``."""
    parser.add_argument("corpus", metavar="CORPUS_DIR", help="recordings, at any depth")
    parser.add_argument(
        "--out", metavar="DIR", required=True, help="gets a folder for each, and corpus.csv"
    )
    where = parser.add_mutually_exclusive_group()
    where.add_argument(
        "--scheduler", metavar="ADDRESS", help="a Dask cluster's, such as tcp://10.0.0.1:8786"
    )
    where.add_argument(
        "--workers", metavar="N", type=_count, help="processes here; default: one per core"
    )
    parser.add_argument(
        "--job-timeout", metavar="SECONDS", type=positive,
        help="a recording that takes longer fails; default: as long as it takes",
    )  # fmt: skip
    _add_refine(parser, "see 'track'")
    parser.add_argument(
        "--causal", dest="mode", action="store_const", const="causal", default="own",
        help="see 'track'",
    )  # fmt: skip


def _count(text: str) -> int:
    if not (text.isascii() and text.isdecimal() and len(text) < 10 and int(text)):
        raise argparse.ArgumentTypeError(f"found {text}, expected a whole number above 0")
    return int(text)


def _port(text: str) -> int:
    if not (text.isascii() and text.isdecimal() and len(text) < 6 and int(text) < 65536):
        raise argparse.ArgumentTypeError(f"found {text}, expected a port, 0 to 65535")
    return int(text)


def add_live(parser: argparse.ArgumentParser) -> None:
    """Options of ``live``."""
    parser.add_argument("setup", metavar="LIVE.toml", help="what to listen to and where to send")
    parser.add_argument("--out", metavar="DIR", help="record there what 'track' reads again")
    parser.add_argument(
        "--smooth",
        action="store_true",
        help="give each pose out once two more video frames were seen, smoothed",
    )
    _add_refine(parser, "how video refines the markers' pose, see 'track'")
    parser.add_argument(
        "--view", choices=("window", "web"), help="show it in rerun's viewer, or in a browser"
    )
    parser.add_argument(
        "--seconds", metavar="S", type=positive, help="how long; default: until Ctrl-C"
    )


def add_view(parser: argparse.ArgumentParser) -> None:
    """Options of ``view``."""
    parser.add_argument("directory", metavar="DIR", help="what track --out was given")
    parser.add_argument("--web", action="store_true", help="serve it to a browser, until Ctrl-C")
    parser.add_argument(
        "--port", metavar="N", type=_port, default=9090, help="of the page; default: %(default)s"
    )


def add_demo(parser: argparse.ArgumentParser) -> None:
    """Options of ``demo``."""
    parser.add_argument(
        "--out", metavar="DIR", default="jaxmocap-demo", help="default: %(default)s"
    )
    parser.add_argument("--seconds", type=positive, default=6.0, help="default: %(default)s")
    parser.add_argument(
        "--seed", type=natural, default=0, help="of person, room, strokes and noise"
    )


def add_track(parser: argparse.ArgumentParser) -> None:
    """Options of ``track``."""
    parser.add_argument("recording", metavar="RECORDING.toml")
    parser.add_argument("--out", metavar="DIR", required=True, help="where to write")
    _add_refine(
        parser,
        "how video refines the markers' pose: each arm by a simplex, the whole body by "
        "least squares, or not at all (markers only)",
    )
    mode = parser.add_mutually_exclusive_group()
    mode.add_argument(
        "--causal",
        dest="mode",
        action="store_const",
        const="causal",
        help="use no later marker or frame than a live run would, which smooths each pose once it "
        "has seen two more video frames",
    )
    mode.add_argument(
        "--nearest",
        dest="mode",
        action="store_const",
        const="nearest",
        help="use the frame nearest to each marker sample, as in the paper",
    )
    parser.add_argument(
        "--paper", action="store_true", help="the paper's edges, cost and simplex, no memory"
    )
    parser.add_argument(
        "--cameras", metavar="A,B", type=_names, help="use these of the recording's cameras"
    )
    parser.add_argument(
        "--height", metavar="M", type=positive, help="metres, in place of the [subject]"
    )
    parser.set_defaults(mode="own")


def add_sync(parser: argparse.ArgumentParser) -> None:
    """Options of ``sync``."""
    parser.add_argument("recording", metavar="RECORDING.toml")
    parser.add_argument(
        "--search",
        metavar="S",
        type=positive,
        default=1.0,
        help="how far the stated offsets may be off, seconds; default: %(default)s",
    )
    parser.add_argument(
        "--cameras", metavar="A,B", type=_names, help="find those of these cameras only"
    )


def add_evaluate(parser: argparse.ArgumentParser) -> None:
    """Options of ``evaluate``."""
    parser.add_argument("directory", metavar="DIR", help="what track --out was given")
    parser.add_argument("truth", metavar="TRUTH.trc", help="reference: .trc .csv .c3d .bvh .glb")
    parser.add_argument(
        "--match",
        metavar="JOINT=MARKER",
        type=_pair,
        nargs="+",
        required=True,
        help="a joint and its marker in the reference",
    )
    parser.add_argument(
        "--up", choices=("y", "z"), help="the reference's vertical; default: y of .bvh .glb, else z"
    )
    parser.add_argument(
        "--offset", metavar="S", type=finite, default=0.0, help="add to the reference's times"
    )


def _names(text: str) -> list[str]:
    return [name.strip() for name in text.split(",")]


def _pair(text: str) -> tuple[str, str]:
    joint, equals, marker = text.partition("=")
    if not (joint and equals and marker):
        raise argparse.ArgumentTypeError(f"found {text!r}, expected JOINT=MARKER")
    return joint, marker


def _add_refine(parser: argparse.ArgumentParser, said: str) -> None:
    parser.add_argument(
        "--refine", choices=("simplex", "gradient", "none"), default="simplex", help=said
    )
