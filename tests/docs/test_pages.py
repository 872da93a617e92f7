"""Pages for users, held: links lead somewhere, commands and files are read, snippets run."""

import ast
import re
import shlex
import subprocess
import sys
import tomllib
from importlib import import_module
from pathlib import Path

import pytest
from documented_files import write_files_named_by

import jaxmocap
from jaxmocap.cli.help import TOPICS
from jaxmocap.cli.program import main, make_parser
from jaxmocap.formats.recordings.recording import Recording
from jaxmocap.pipelines.live.setup import load_live
from jaxmocap.synthetic.recording import write_table_tennis

PACKAGE = Path(jaxmocap.__file__).parent
PROJECT = PACKAGE.parent
DOCS = PACKAGE / "docs"
README = PROJECT / "README.md"
PAGES = [README, *(DOCS / f"{topic}.md" for topic in TOPICS)]
# An sdist has no benchmarks.
FIGURES = [path for path in [PROJECT / "bench" / "README.md"] if path.exists()]
MOST_WORDS = 80
README_WORDS = 900
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\(([^)\s]+)\)")
# First lines of blocks that are whole files.
RECORDING_FILE, LIVE_FILE = "# recording.toml", "# live.toml"


def blocks(page: Path, kind: str) -> list[str]:
    return [text for found, text in BLOCK.findall(page.read_text("utf-8")) if found == kind]


def all_blocks(kind: str) -> list[tuple[Path, str]]:
    return [(page, text) for page in PAGES for text in blocks(page, kind)]


def named(pairs: list[tuple[Path, str]]) -> list:
    return [pytest.param(*pair, id=f"{pair[0].stem}-{number}") for number, pair in enumerate(pairs)]


def command_lines() -> list[tuple[Path, str]]:
    return [(page, line) for page, text in all_blocks("sh") for line in text.splitlines()]


def test_every_page_is_a_topic_and_the_other_way_round():
    assert {path.stem for path in DOCS.glob("*.md")} == set(TOPICS)


@pytest.mark.parametrize("page", [*PAGES, *FIGURES], ids=lambda page: page.as_posix()[-25:])
def test_a_page_has_a_title_and_links_that_lead_somewhere(page):
    text = page.read_text("utf-8")
    assert text.startswith("# ")
    links = [link for link in LINK.findall(text) if not link.startswith("http")]
    if not FIGURES:
        links = [link for link in links if "bench/" not in link and "notebooks/" not in link]
    lost = [link for link in links if not (page.parent / link.partition("#")[0]).exists()]
    assert not lost


@pytest.mark.parametrize("page", [*PAGES, *FIGURES], ids=lambda page: page.as_posix()[-25:])
def test_no_paragraph_is_long(page):
    text = BLOCK.sub("", page.read_text("utf-8"))
    items = re.split(r"\n\s*\n|\n(?=[-|]|\d+\. )", text)
    prose = [item for item in items if not item.startswith(("|", "["))]
    long = [item for item in prose if len(item.split()) > MOST_WORDS]
    assert not long, long[0]


def test_the_readme_is_short_and_leads_to_every_page():
    text = README.read_text("utf-8")
    assert len(text.split()) <= README_WORDS
    lacking = [topic for topic in TOPICS if f"jaxmocap/docs/{topic}.md" not in text]
    assert not lacking


@pytest.mark.parametrize("topic", TOPICS)
def test_help_prints_a_page(topic, capsys):
    assert main(["help", topic]) == 0
    printed, written = capsys.readouterr().out, (DOCS / f"{topic}.md").read_text("utf-8")
    assert printed == written if topic != "settings" else printed.startswith(written)


def test_help_lists_the_pages_and_names_them_where_one_is_not_there(capsys):
    assert main(["help"]) == 0
    printed = capsys.readouterr().out
    assert all(f"  {topic} " in printed for topic in TOPICS)
    with pytest.raises(SystemExit) as done:
        main(["help", "nothing"])
    assert done.value.code == 2 and "start_vr" in capsys.readouterr().err


@pytest.mark.parametrize(("page", "line"), named(command_lines()))
def test_a_command_on_a_page_is_accepted(page, line):
    program, *arguments = shlex.split(line)
    assert program == "jaxmocap", line
    make_parser().parse_args(arguments)


@pytest.mark.parametrize(("page", "text"), named(all_blocks("toml")))
def test_a_file_on_a_page_is_read(page, text, tmp_path):
    table = tomllib.loads(text)
    kind = text.partition("\n")[0]
    if kind not in (RECORDING_FILE, LIVE_FILE):
        return
    path = tmp_path / kind.removeprefix("# ")
    path.write_text(text, encoding="utf-8")
    write_files_named_by(table, tmp_path)
    if kind == LIVE_FILE:
        setup = load_live(path)
        assert set(setup.marker_names) == set(table["markers"]["on"])
    else:
        recording = Recording.load(path)
        assert len(recording.videos) == len(table.get("video", ()))


@pytest.mark.parametrize(("page", "text"), named(all_blocks("python")))
def test_what_a_snippet_imports_is_there(page, text):
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.ImportFrom):
            module = import_module(str(node.module))
            assert all(hasattr(module, alias.name) for alias in node.names)
        elif isinstance(node, ast.Import):
            assert all(import_module(alias.name) for alias in node.names)


@pytest.mark.slow
@pytest.mark.parametrize("page", [p for p in PAGES if blocks(p, "python")], ids=lambda p: p.stem)
def test_the_snippets_of_a_page_run_one_after_the_other(page, tmp_path):
    code = "\n".join(blocks(page, "python"))
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout and "nan" not in done.stdout


# Commands that run in a folder with a recording: their page, and what each leaves behind.
RUN = (
    ("start_lab", "jaxmocap check recording.toml", ()),
    ("start_lab", "jaxmocap track recording.toml --out tracked", ("tracked/joints.trc",)),
    ("start_lab", "jaxmocap convert tracked/motion.npz joints.c3d", ("joints.c3d",)),
    ("convert", "jaxmocap convert tracked/motion.npz motion.bvh --unit cm", ("motion.bvh",)),
    ("body", "jaxmocap scale --height 1.80 --mass 75 --out subject.toml", ("subject.toml",)),
    (
        "convert",
        "jaxmocap retarget tracked --onto subject.toml --out played",
        ("played/retargeted.png",),
    ),
    ("batch", "jaxmocap warmup recordings/first/recording.toml", ()),
)


@pytest.mark.slow
def test_the_commands_of_the_pages_run_in_turn(tmp_path):
    write_table_tennis(tmp_path, seconds=1.0)
    write_table_tennis(tmp_path / "recordings" / "first", seconds=1.0)
    shown = command_lines()
    for page, line, left in RUN:
        assert (DOCS / f"{page}.md", line) in shown
        done = subprocess.run(
            [sys.executable, "-m", "jaxmocap.cli", *shlex.split(line)[1:]],
            cwd=tmp_path, capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.returncode == 0, (line, done.stderr)
        assert all((tmp_path / name).exists() for name in left), line
