"""The import table of the design, held: who may know whom, and who opens which third party."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import jaxmocap

PACKAGE = Path(jaxmocap.__file__).parent
PROJECT = PACKAGE.parent
FILES = sorted(PACKAGE.rglob("*.py"))

# Room -> rooms that it may import besides itself.
MAY_IMPORT = {
    "geometry": set(),
    "solvers": set(),
    "reference": set(),
    "body": {"geometry"},
    "images": {"geometry"},
    "hybrid": {"geometry", "solvers", "body", "images"},
    "silhouette": {"geometry", "solvers", "body", "images"},
    "formats": {"geometry", "body"},
    "capture": {"geometry", "body", "formats"},
    "outputs": {"geometry", "body", "formats"},
    "evaluation": {"geometry", "body", "formats"},
    "synthetic": {"geometry", "body", "formats"},
    "setup": {"geometry", "solvers", "body", "images", "hybrid", "capture", "formats"},
    "cli": {"run", "setup", "evaluation", "formats"},
}
MAY_IMPORT["run"] = {*MAY_IMPORT, "run"} - {"reference", "cli"}
# The renderer must not draw with the tracker's own flesh.
FORBIDDEN_MODULES = {
    "synthetic": {"jaxmocap.body.flesh", "jaxmocap.body.surface", "jaxmocap.body.loft"}
}
DOORS = {
    "optimistix": ("solvers/least_squares.py",),
    "rerun": ("outputs/",),
    "ezc3d": ("formats/c3d.py", "formats/c3d_process.py"),
    "pylsl": ("capture/lsl.py",),
    "pythonosc": ("capture/osc.py", "outputs/osc.py"),
    "cv2": ("images/", "capture/", "setup/", "synthetic/", "outputs/overlay.py"),
}
HEAVY = ("cv2", "rerun", "matplotlib", "av", "optimistix", "ezc3d")
TOP_LEVEL = {*MAY_IMPORT, "__init__.py", "py.typed"}
LONGEST_FILE = 350
DRAWERS = ("utils", "util", "common", "helpers", "helper", "misc", "tools", "shared")


def within(path: Path) -> str:
    return path.relative_to(PACKAGE).as_posix()


def room_of(path: Path) -> str:
    """The top-level room or module that a file belongs to."""
    return within(path).split("/")[0].removesuffix(".py")


def imports(path: Path) -> set[str]:
    """Full names of everything imported anywhere in a file, inside functions too."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            here = ("jaxmocap", *Path(within(path)).parts[:-1])
            base = ".".join(here[: len(here) + 1 - node.level]) + "." if node.level else ""
            module = (base + (node.module or "")).rstrip(".")
            found |= {module} | {f"{module}.{alias.name}" for alias in node.names}
    return found


def rooms_imported(path: Path) -> set[str]:
    ours = {name.split(".")[1] for name in imports(path) if name.startswith("jaxmocap.")}
    return ours & set(MAY_IMPORT)


@pytest.mark.parametrize("path", FILES, ids=within)
def test_a_room_imports_only_what_the_table_allows(path):
    room = room_of(path)
    if room == "__init__":
        assert "reference" not in rooms_imported(path)
        return
    assert room in MAY_IMPORT, f"{room} has no line in the import table"
    assert rooms_imported(path) <= MAY_IMPORT[room] | {room}
    assert not imports(path) & FORBIDDEN_MODULES.get(room, set())


@pytest.mark.parametrize("third_party", DOORS)
def test_third_parties_come_in_by_their_own_door(third_party):
    for path in FILES:
        if any(name.split(".")[0] == third_party for name in imports(path)):
            assert within(path).startswith(DOORS[third_party]), within(path)


def test_the_reference_needs_numpy_and_scipy_only():
    for path in (PACKAGE / "reference").glob("*.py"):
        outside = {name.split(".")[0] for name in imports(path)} - set(sys.stdlib_module_names)
        assert outside <= {"numpy", "scipy", "jaxmocap"}, within(path)


@pytest.mark.parametrize("path", FILES, ids=within)
def test_no_file_is_longer_than_350_lines(path):
    assert len(path.read_text(encoding="utf-8").splitlines()) <= LONGEST_FILE


def test_there_is_no_drawer_for_odds_and_ends():
    names = {part.removesuffix(".py") for path in FILES for part in Path(within(path)).parts}
    assert not names & set(DRAWERS)


def test_the_package_has_the_rooms_of_the_design_and_no_others():
    entries = {entry.name for entry in PACKAGE.iterdir()} - {"__pycache__"}
    assert entries <= TOP_LEVEL


def test_every_module_says_what_it_is():
    for path in FILES:
        assert ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))), within(path)


def test_importing_the_package_loads_neither_viewer_nor_opencv():
    check = f"import sys, jaxmocap; print([m for m in {HEAVY!r} if m in sys.modules])"
    done = subprocess.run(
        [sys.executable, "-c", check], capture_output=True, text=True, cwd=PROJECT, check=True
    )
    assert done.stdout.strip() == "[]"
