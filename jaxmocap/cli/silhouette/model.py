"""``jaxmocap silhouette model``: a person's own body and surface, of four photographs.

INPUTS: four photographs and their calibration. OUTPUTS: a folder with the model, and a picture of
every step.
"""

import argparse
from functools import partial

from jaxmocap.cli.command import positive_number, report, whole_number

PURPOSE = "make a person's own model of four photographs"
EXAMPLE = (
    "jaxmocap silhouette model --front front.png --side side.png --joint joint.png "
    "--arm-side arm_side.png --calibration calibration.toml --out model"
)


def add_options(parser: argparse.ArgumentParser) -> None:
    for name, stance in (
        ("front", "arms lifted off the trunk"),
        ("side", "from the left, arms spread towards and away from the camera"),
        ("joint", "from the front, upper arms level, forearms up, hands flat"),
        ("arm-side", "from the front, arms spread level, palms down"),
    ):
        parser.add_argument(f"--{name}", metavar="IMAGE", required=True, help=stance)
    parser.add_argument(
        "--calibration",
        metavar="FILE.toml",
        required=True,
        help="sections front and side, and joint and arm_side where it was another camera; in its "
        "world z is up and the person faces +x",
    )
    parser.add_argument("--out", metavar="DIR", required=True, help="where to write")
    parser.add_argument(
        "--bottom",
        metavar="ROW",
        type=whole_number,
        help="row of the front photograph where the trunk ends; default: where the legs part",
    )
    parser.add_argument(
        "--height",
        metavar="METRES",
        type=positive_number,
        help="of the body, which gives the legs' length; default: as people's of such a trunk",
    )
    parser.add_argument(
        "--reading",
        choices=("own", "paper"),
        default="own",
        help="where elbows and wrists lie and how full slices are: fitted to measured people, or "
        "as the paper has it; default: %(default)s",
    )


def run(options: argparse.Namespace) -> None:
    from jaxmocap.pipelines.silhouettes import model as modelling

    photographs = {name: getattr(options, name) for name in modelling.PHOTOGRAPHS}
    folder = modelling.model_folder(options.out, [*photographs.values(), options.calibration])
    model = modelling.model_from(
        photographs,
        options.calibration,
        options.out,
        options.bottom,
        options.height,
        options.reading,
    )
    files = folder.write(partial(modelling.write_model, model))
    figures = model.figures() | {"files": [str(path) for path in files]}
    report(options, modelling.model_text(model, files), figures)
