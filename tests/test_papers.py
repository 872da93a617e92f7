"""The page on the papers, held: its names import, its tests, options and sources exist."""

import re
from functools import reduce
from importlib import import_module
from pathlib import Path

import pytest

import jaxmocap

PACKAGE = Path(jaxmocap.__file__).parent
PROJECT = PACKAGE.parent
PAGE = PACKAGE / "docs" / "papers.md"
HEADER = ("the paper's", "ours: function", "default or option", "test", "measured")
NAME = re.compile(r"`(jaxmocap(?:\.\w+)+)`")
TEST = re.compile(r"`([\w/]+\.py)::(\w+)`")
# A paper's equations and figures, as the page's first column has them.
EQUATIONS = {
    "Paper A": {f"({number})" for number in range(1, 15)},
    "Paper B": {f"(3.{number})" for number in range(1, 19)}
    | {f"(4.{number})" for number in range(19, 29)},
}
FIGURES = {"Paper A": 9, "Paper B": 33}


def rows_of(paper: str) -> list[tuple[str, ...]]:
    """The rows of a paper's tables, by the page's headings."""
    text = PAGE.read_text(encoding="utf-8")
    section = next(part for part in text.split("\n## ") if part.startswith(f"{paper}:"))
    lines = [line for line in section.splitlines() if line.startswith("|")]
    cells = [tuple(cell.strip() for cell in line.strip("|").split("|")) for line in lines]
    assert HEADER in cells
    return [row for row in cells if row != HEADER and set("".join(row)) != {"-"}]


ROWS = [row for paper in EQUATIONS for row in rows_of(paper)]


def resolved(name: str) -> object:
    """What a dotted name stands for: a module, or what is in one."""
    parts = name.split(".")
    for count in range(len(parts), 0, -1):
        try:
            module = import_module(".".join(parts[:count]))
        except ModuleNotFoundError as error:
            if not name.startswith(str(error.name)):
                raise
            continue
        return reduce(getattr, parts[count:], module)
    raise ModuleNotFoundError(name)


def test_every_row_has_five_cells_and_a_name_of_ours():
    for row in ROWS:
        assert len(row) == len(HEADER), row
        assert row[0] and row[2] and NAME.search(row[1]), row


@pytest.mark.parametrize("paper", EQUATIONS)
def test_every_equation_and_figure_has_a_row(paper):
    first = " ".join(row[0] for row in rows_of(paper))
    assert EQUATIONS[paper] <= set(re.findall(r"\([\d.]+\)", first))
    figures = {int(number) for number in re.findall(r"Fig\. (\d+)", first)}
    assert figures == set(range(1, FIGURES[paper] + 1))


def test_every_name_imports():
    lacking = []
    for name in sorted({name for row in ROWS for name in NAME.findall(row[1])}):
        try:
            resolved(name)
        except (ModuleNotFoundError, AttributeError):
            lacking.append(name)
    assert not lacking, "\n".join(lacking)


def test_every_test_exists():
    named = {found for row in ROWS for found in TEST.findall(row[3])}
    assert all(not row[3] or TEST.search(row[3]) for row in ROWS)
    files = {path: PROJECT / path for path, _ in named}
    texts = {path: file.read_text("utf-8") if file.exists() else "" for path, file in files.items()}
    lacking = [f"{path}::{name}" for path, name in named if f"def {name}(" not in texts[path]]
    assert not lacking, "\n".join(sorted(lacking))


def test_options_benches_and_notebooks_exist():
    text = PAGE.read_text(encoding="utf-8")
    commands = "".join(path.read_text("utf-8") for path in (PACKAGE / "cli").rglob("*.py"))
    options = {option for row in ROWS for option in re.findall(r"`(--[\w-]+)", row[2])}
    lacking = [option for option in options if f'"{option}"' not in commands]
    sources = re.findall(r"\bnotebooks/\w+\.ipynb", text)
    sources += [f"bench/{name}.py" for name in re.findall(r"python -m bench\.(\w+)", text)]
    lacking += [source for source in sources if not (PROJECT / source).exists()]
    assert not lacking, "\n".join(sorted(lacking))
