"""``jaxmocap help``: the pages of ``jaxmocap/docs``, printed.

INPUTS: a topic, or none. OUTPUTS: its page, or the list of all.
"""

import argparse
import pydoc
import sys
from importlib.resources import files

PURPOSE = "print a page of the documentation"
EXAMPLE = "jaxmocap help recording_file"

# Every page, in the order of the list; what a reader begins with comes first.
TOPICS = (
    "start_vr",
    "start_lab",
    "start_jax",
    "recording_file",
    "live_file",
    "programs",
    "outputs",
    "calibrate",
    "sync",
    "keypoints",
    "body",
    "devices",
    "filters",
    "settings",
    "silhouettes",
    "batch",
    "convert",
    "gradients",
    "terms",
    "how_it_works",
    "limits",
    "security",
    "papers",
    "glossary",
)


def page(topic: str) -> str:
    """The text of a topic's page, Markdown."""
    return files("jaxmocap").joinpath("docs", f"{topic}.md").read_text(encoding="utf-8")


def _page_text(topic: str) -> str:
    """A page, and below that of the settings what the tracker's records say themselves."""
    if topic != "settings":
        return page(topic)
    from jaxmocap.formats.settings_file import list_fields
    from jaxmocap.hybrid.settings import Settings

    return f"{page(topic)}\n```toml\n{list_fields(Settings())}\n```\n"


def contents() -> str:
    """Every topic with the title of its page."""
    width = max(map(len, TOPICS))
    titles = (page(topic).partition("\n")[0].removeprefix("# ") for topic in TOPICS)
    lines = [f"  {topic:{width}}  {title}" for topic, title in zip(TOPICS, titles, strict=True)]
    return "\n".join(["jaxmocap help TOPIC prints one of these pages:", "", *lines])


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "topic", nargs="?", choices=TOPICS, metavar="TOPIC", help="a page; all are listed without"
    )


def run(options: argparse.Namespace) -> None:
    if options.topic is None:
        print(contents())
    elif sys.stdout.isatty():
        pydoc.pager(_page_text(options.topic))
    else:
        print(_page_text(options.topic), end="")
