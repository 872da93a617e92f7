"""``jaxmocap view``: the rerun viewer, in a window or for a browser.

INPUTS: a folder that ``track`` wrote. OUTPUTS: a viewer.
"""

import argparse
import sys

from jaxmocap.cli.command import port_number, report

PURPOSE = "show what track wrote in the rerun viewer"
EXAMPLE = "jaxmocap view tracked"


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("directory", metavar="DIR", help="what track --out was given")
    parser.add_argument("--web", action="store_true", help="serve it to a browser, until Ctrl-C")
    parser.add_argument(
        "--port",
        metavar="N",
        type=port_number,
        default=9090,
        help="of the page; default: %(default)s",
    )


def run(options: argparse.Namespace) -> None:
    from jaxmocap.pipelines.view import open_viewer, recording_in, serve_page

    path = recording_in(options.directory)
    if not options.web:
        report(options, open_viewer(path), {"recording": str(path), "page": None})
        return
    viewer = serve_page(path, options.port)
    figures = {"recording": str(path), "page": viewer.page}

    def announce() -> None:
        report(options, f"{path}\nat {viewer.page}\nuntil Ctrl-C", figures)
        sys.stdout.flush()

    viewer.until_interrupted(announce)
