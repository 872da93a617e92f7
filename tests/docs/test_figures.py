"""Figures in the pages: each measured one is a link to what printed it, and says the same.

The numbers in a link's text must be among those of the link's target, rounded to the stated digits:

- ``notebooks/NAME.ipynb#tag``: what the cell of that tag printed when it was stored,
- ``bench/figures.json#group/metric``: the group's metrics whose names begin so,
- ``bench/README.md#section``: the section's own text, the record of long runs.
"""

import json
import re
from decimal import Decimal
from pathlib import Path

import pytest

import jaxmocap
from bench.figures import Metric, record, write_json

PACKAGE = Path(jaxmocap.__file__).parent
PROJECT = PACKAGE.parent
# Pages with tables of measured figures, and the first column that has any.
MEASURED = {
    PROJECT / "README.md": 1,
    PACKAGE / "docs" / "limits.md": 1,
    PACKAGE / "docs" / "papers.md": -1,
}
PAGES = [
    PROJECT / "README.md",
    PROJECT / "CHANGELOG.md",
    PACKAGE / "README.md",
    *sorted((PACKAGE / "docs").glob("*.md")),
]
LINK = re.compile(r"\[([^\]]+)\](?:\(([^)\s]+)\)|\[([^\]]+)\])")
DEFINITION = re.compile(r"^\[([^\]]+)\]: (\S+)$", re.MULTILINE)
BLOCK = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)
NUMBER = re.compile(r"(?<![\w.])[-+]?(?:\d{1,3}(?:,\d{3})+|\d+(?:\.\d+)?(?:e[-+]?\d+)?)(?![\w])")
FIGURE = re.compile(r"\d\.\d|\d ?(?:%|°|(?:px|pixels|mm|cm|m|ms|s|Hz|times|degrees|seconds)\b)")
SOURCES = (".ipynb", "figures.json", "bench/README.md")


def numbers(text: str) -> list[str]:
    """The numbers of a text, with a plain minus and without separators."""
    return [found.replace(",", "") for found in NUMBER.findall(text.replace("−", "-"))]


def agrees(stated: str, printed: str) -> bool:
    """Whether a number is another one, rounded to its own digits; a bare one says no sign."""
    a, b = Decimal(stated), Decimal(printed)
    if stated[0] not in "+-":
        b = abs(b)
    last = [int(each.as_tuple().exponent) for each in (a, b)]
    return last[1] <= last[0] and abs(a - b) <= Decimal((0, (5,), last[0] - 1))


def links(text: str) -> list[tuple[str, str]]:
    """Texts and targets of a page's links; a label that nothing defines is its own target."""
    targets = dict(DEFINITION.findall(text))
    found = LINK.findall(BLOCK.sub("", text))
    return [(shown, target or targets.get(label, label)) for shown, target, label in found]


def names_source(target: str) -> bool:
    """Whether a link leads to a cell, a metric or a section."""
    file, _, fragment = target.partition("#")
    return bool(fragment) and file.endswith(SOURCES)


def printed(path: Path, fragment: str) -> str | None:
    """What a source says; None where there is no such cell, metric or section."""
    if path.suffix == ".ipynb":
        cells = json.loads(path.read_text("utf-8"))["cells"]
        tagged = [cell for cell in cells if fragment in cell["metadata"].get("tags", ())]
        return "\n".join(map(output, tagged)) if tagged else None
    if path.suffix == ".json":
        group, _, metric = fragment.partition("/")
        figures = json.loads(path.read_text("utf-8")).get(group, {}).get("figures", {})
        chosen = [value for name, value in figures.items() if name.startswith(metric)]
        return "\n".join(chosen) if chosen else None
    parts = re.split(r"^#+ +(.*)$", path.read_text("utf-8"), flags=re.MULTILINE)
    sections = {anchor(title): text for title, text in zip(parts[1::2], parts[2::2], strict=True)}
    return sections.get(fragment)


def output(cell: dict) -> str:
    """A cell's stored text and tables; not the names of its pictures."""
    texts = []
    for each in cell.get("outputs", ()):
        data = each.get("data", {})
        text = each.get("text") or data.get("text/markdown")
        texts.append("".join(text or ([] if "image/png" in data else data.get("text/plain", ""))))
    return "\n".join(texts)


def anchor(title: str) -> str:
    """A heading as GitHub links to it."""
    return re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-")


def complaints(page: Path) -> list[str]:
    """What is wrong with the figures of a page."""
    wrong = []
    for shown, target in links(page.read_text("utf-8")):
        stated = numbers(shown) if names_source(target) else []
        if not stated:
            continue
        file, _, fragment = target.partition("#")
        source = page.parent / file
        text = printed(source, fragment) if source.is_file() else None
        if text is None:
            wrong.append(f"[{shown}]: there is no {target}")
            continue
        there = numbers(text)
        lacking = [each for each in stated if not any(agrees(each, other) for other in there)]
        if lacking:
            wrong.append(f"[{shown}]: {target} does not say {', '.join(lacking)}")
    return wrong


def unsourced(page: Path, first: int) -> list[str]:
    """Cells from that column on with a decimal or a unit outside of a link to a source."""
    text = page.read_text("utf-8")
    targets = dict(DEFINITION.findall(text))

    def alone(link: re.Match) -> str:
        """Nothing for a figure with its source, a link's text else."""
        return "" if names_source(link[2] or targets.get(link[3], "")) else link[1]

    rows = [line.strip("| ") for line in text.splitlines() if line[:1] == "|"]
    cells = [cell for row in rows for cell in row.split("|")[first:]]
    return [cell for cell in cells if FIGURE.search(LINK.sub(alone, cell))]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(PROJECT).as_posix())
def test_a_figure_is_what_its_source_printed(page):
    wrong = complaints(page)
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(PROJECT).as_posix())
def test_labels_of_links_are_defined_and_used(page):
    text = BLOCK.sub("", page.read_text("utf-8"))
    labels = {label for _, _, label in LINK.findall(text) if label}
    assert labels == set(dict(DEFINITION.findall(text)))


@pytest.mark.parametrize("page", MEASURED, ids=lambda page: page.stem)
def test_a_measured_figure_in_a_table_names_its_source(page):
    wrong = unsourced(page, MEASURED[page])
    assert not wrong, "\n".join(wrong)


@pytest.fixture
def page(tmp_path):
    """A page beside a notebook, a bench's metrics and its tables."""
    stream = {
        "output_type": "stream",
        "name": "stdout",
        "text": ["19.04 to 14.2 cm, -25 %, 5e-14\n"],
    }
    drawn = {"output_type": "display_data", "data": {"image/png": "", "text/plain": ["<11x6>"]}}
    cell = {"cell_type": "code", "metadata": {"tags": ["headline"]}, "outputs": [stream, drawn]}
    (tmp_path / "a.ipynb").write_text(json.dumps({"cells": [cell]}))
    figures = {"elbows-markers": "7.486 cm", "elbows-video": "4.12 cm", "knees": "9 cm"}
    (tmp_path / "bench").mkdir()
    (tmp_path / "bench" / "figures.json").write_text(json.dumps({"real": {"figures": figures}}))
    tables = "# Benchmarks\n12 cm\n## Its `own` parts, here\n| a | 1,092 |\n### Next\n3 cm\n"
    (tmp_path / "bench" / "README.md").write_text(tables)
    return tmp_path / "page.md"


RIGHT = (
    "[19.0 → 14.2 cm, −25 %](a.ipynb#headline)",
    "[by 25 % and 5e-14°](a.ipynb#headline)",
    "[7.5 and 4.1 cm](bench/figures.json#real/elbows)",
    "[7.5 → 4.1 cm][real]\n\n[real]: bench/figures.json#real/elbows",
    "[1092 samples](bench/README.md#its-own-parts-here)",
    "[notebook 3](a.ipynb) and [section 2](page.md#other)",
)
WRONG = (
    ("[19.1 → 14.2 cm](a.ipynb#headline)", "does not say 19.1"),
    ("[+25 %](a.ipynb#headline)", r"does not say \+25"),
    ("[14.20 cm](a.ipynb#headline)", r"does not say 14.20"),
    ("[11](a.ipynb#headline)", "does not say 11"),
    ("[19.0 cm](a.ipynb#other)", "there is no"),
    ("[19.0 cm](b.ipynb#headline)", "there is no"),
    ("[9 cm](bench/figures.json#real/elbows)", "does not say 9"),
    ("[9 cm](bench/figures.json#drawn/knees)", "there is no"),
    ("[4.1 cm][real]\n\n[real]: bench/figures.json#real/knees", "does not say 4.1"),
    ("[3 cm](bench/README.md#its-own-parts-here)", "does not say 3"),
    ("[12 cm](bench/README.md#its-parts)", "there is no"),
)


@pytest.mark.parametrize("text", RIGHT)
def test_figures_that_their_sources_printed_pass(page, text):
    page.write_text(text)
    assert complaints(page) == []


@pytest.mark.parametrize(("text", "reason"), WRONG)
def test_a_changed_digit_and_a_lost_source_are_found(page, text, reason):
    page.write_text(text)
    assert len(wrong := complaints(page)) == 1 and re.search(reason, wrong[0])


def test_a_page_may_cite_what_a_bench_and_a_command_recorded(page):
    metrics = [Metric("drawn, elbows, mean", 0.034127, "m"), Metric("drawn, step", 3.5, "ms")]
    bench, file = page.parent / "found.json", page.parent / "figures.json"
    write_json(metrics, bench)
    record("paper", json.loads(bench.read_text()), "python -m bench.paper", path=file)
    lens = {"rms_px": 0.16515, "used": True, "parameters": {"fx": {"value": 1672.5637}}}
    record("lens", lens, "jaxmocap calibrate intrinsics", ["parameters"], path=file)
    page.write_text("[0.0341](figures.json#paper/drawn) [1672.6](figures.json#lens/parameters-fx)")
    assert complaints(page) == []
    kept = json.loads(file.read_text())
    assert kept["paper"]["figures"] == {"drawn-elbows-mean": "0.034127 m"}
    assert list(kept["lens"]["figures"]) == ["parameters-fx-value"]


@pytest.mark.parametrize(
    ("cell", "found"),
    [
        ("[19.0 → 14.2 cm](a.ipynb#headline), by markers and with video", 0),
        ("[8 cm][real] and 3 of 4 arms, (13), Fig. 8", 0),
        ("19.0 → 14.2 cm (notebook 7)", 1),
        ("8 % less", 1),
        ("16.7", 1),
        ("[8 cm](a.ipynb)", 1),
    ],
)
def test_a_unit_outside_of_a_link_is_found(page, cell, found):
    table = f"| the paper's 15.3 cm | ours | {cell} |"
    page.write_text(f"A sentence of 3 cm.\n\n{table}\n\n[real]: a.ipynb#headline\n")
    assert len(unsourced(page, -1)) == found
