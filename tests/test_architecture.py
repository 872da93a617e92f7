"""The import table of the design, held: who may import whom, and who opens which third party."""

import ast
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

import jaxmocap

PACKAGE = Path(jaxmocap.__file__).parent
PROJECT = PACKAGE.parent
FILES = sorted(PACKAGE.rglob("*.py"))

# In reading order: a room imports only from rooms above it.
ROOMS = (
    # Programs that are kept are of all rooms: what a start need not trace it saves.
    "compilation",
    "geometry",
    "body",
    "solvers",
    "images",
    "evidence",
    "smoothing",
    "hybrid",
    "silhouette",
    "formats",
    "capture",
    "calibration",
    "outputs",
    # Above the commands, two of which render recordings and plot errors.
    "synthetic",
    "evaluation",
    "pipelines",
    "cli",
    "reference",
)
# Rooms that import fewer than those above them.
ALLOWED = {
    "solvers": set(),
    "compilation": set(),
    "reference": set(),
    "images": {"geometry", "compilation"},
    # Neither tracker imports the other.
    "silhouette": set(ROOMS[: ROOMS.index("hybrid")]),
    "formats": {"geometry", "body", "compilation"},
    "capture": {"compilation", "geometry", "body", "formats", "images"},
    "outputs": {"compilation", "geometry", "body", "formats"},
    # The renderer must not draw with the tracker's own flesh, nor be tested by its raster.
    "synthetic": {"geometry", "body", "formats"},
    "evaluation": {"geometry", "body", "formats"},
}
FORBIDDEN_MODULES = {
    "synthetic": {
        "jaxmocap.body.surfaces.cones",
        "jaxmocap.body.surfaces.surface",
        "jaxmocap.body.surfaces.loft",
    }
}
DOORS = {
    "optimistix": ("solvers/least_squares.py",),
    "rerun": ("outputs/",),
    "ezc3d": ("formats/time_series/c3d.py", "formats/time_series/c3d_process.py"),
    "pylsl": ("capture/streams/lsl.py",),
    "pythonosc": ("capture/streams/osc.py", "outputs/senders/osc.py"),
    "onnxruntime": ("pipelines/keypoints/by_onnx.py",),
    "mediapipe": ("pipelines/keypoints/mediapipe_process.py",),
    "distributed": ("pipelines/batch/cluster.py",),
    "shtab": ("cli/completion.py",),
    "PIL": ("capture/photographs.py",),
    "av": (
        "capture/",
        "formats/cameras/video_out.py",
        "synthetic/recording.py",
        "outputs/overlay.py",
        "pipelines/live/",
    ),
    "cv2": (
        "images/",
        "evidence/appearance/",
        "silhouette/segmentation/",
        "silhouette/recovery/",
        "silhouette/surfaces/",
        "silhouette/modelling/",
        "capture/",
        "calibration/",
        "synthetic/",
        "outputs/overlay.py",
    ),
}
HEAVY = ("cv2", "rerun", "matplotlib", "av", "optimistix", "ezc3d")
HELP = """
from contextlib import redirect_stdout, suppress
from io import StringIO
from jaxmocap.cli.program import main
with suppress(SystemExit), redirect_stdout(StringIO()):
    main(["--help"])
"""
TOP_LEVEL = {*ROOMS, "docs", "__init__.py", "README.md", "py.typed"}
MOST_MODULES = 12
LONGEST_FILE = 350
DRAWERS = ("utils", "util", "common", "helpers", "helper", "misc", "tools", "shared")


def within(path: Path) -> str:
    return path.relative_to(PACKAGE).as_posix()


def dotted(path: Path) -> str:
    return ".".join(["jaxmocap", *Path(within(path)).with_suffix("").parts])


def room_of(path: Path) -> str:
    """The top-level room or module that a file belongs to."""
    return within(path).split("/")[0].removesuffix(".py")


@cache
def imports(path: Path) -> frozenset[str]:
    """Full names of everything imported anywhere in a file, inside functions too."""
    actual = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            actual |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            here = ("jaxmocap", *Path(within(path)).parts[:-1])
            base = ".".join(here[: len(here) + 1 - node.level]) + "." if node.level else ""
            module = (base + (node.module or "")).rstrip(".")
            actual |= {module} | {f"{module}.{alias.name}" for alias in node.names}
    return frozenset(actual)


def rooms_imported(path: Path) -> set[str]:
    ours = {name.split(".")[1] for name in imports(path) if name.startswith("jaxmocap.")}
    return ours & set(ROOMS)


def may_import(room: str) -> set[str]:
    return ALLOWED.get(room, set(ROOMS[: ROOMS.index(room)])) - {"reference"}


@pytest.mark.parametrize("path", FILES, ids=within)
def test_a_room_imports_only_what_the_table_allows(path):
    room = room_of(path)
    if room == "__init__":
        assert "reference" not in rooms_imported(path)
        return
    assert room in ROOMS, f"{room} has no line in the import table"
    assert rooms_imported(path) <= may_import(room) | {room}
    assert not imports(path) & FORBIDDEN_MODULES.get(room, set())


def test_what_a_room_imports_stands_above_it():
    for room, allowed in ALLOWED.items():
        assert allowed <= set(ROOMS[: ROOMS.index(room)])


def test_a_room_has_twelve_modules_at_most():
    for folder in {path.parent for path in FILES} - {PACKAGE}:
        modules = [path.stem for path in folder.glob("*.py") if not path.stem.startswith("__")]
        assert len(modules) <= MOST_MODULES, (within(folder), sorted(modules))


@pytest.mark.parametrize("third_party", DOORS)
def test_third_parties_come_in_by_their_own_door(third_party):
    for path in FILES:
        if any(name.split(".")[0] == third_party for name in imports(path)):
            assert within(path).startswith(DOORS[third_party]), within(path)


def test_the_reference_needs_numpy_and_scipy_only():
    for path in (PACKAGE / "reference").rglob("*.py"):
        outside = {name.split(".")[0] for name in imports(path)} - set(sys.stdlib_module_names)
        assert outside <= {"numpy", "scipy", "jaxmocap"}, within(path)


@pytest.mark.parametrize("path", FILES, ids=within)
def test_no_file_is_longer_than_350_lines(path):
    assert len(path.read_text(encoding="utf-8").splitlines()) <= LONGEST_FILE


def test_every_benchmark_is_short_and_named_in_their_readme():
    readme = (PROJECT / "bench" / "README.md").read_text(encoding="utf-8")
    for path in (PROJECT / "bench").glob("[!_]*.py"):
        assert f"`bench.{path.stem}`" in readme or f"`{path.stem}`" in readme, path.name
        assert len(path.read_text(encoding="utf-8").splitlines()) <= LONGEST_FILE, path.name


def test_there_is_no_drawer_for_odds_and_ends():
    names = {part.removesuffix(".py") for path in FILES for part in Path(within(path)).parts}
    assert not names & set(DRAWERS)


def test_the_package_has_the_rooms_of_the_design_and_no_others():
    entries = {entry.name for entry in PACKAGE.iterdir()} - {"__pycache__"}
    assert entries <= TOP_LEVEL


def test_every_module_says_what_it_is():
    for path in FILES:
        assert ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))), within(path)


@pytest.mark.parametrize(
    ("code", "absent"),
    [
        ("import jaxmocap", HEAVY),
        ("import jaxmocap.outputs.viewer", ("rerun",)),
        ("import jaxmocap.evaluation.plots, jaxmocap.evaluation.errors", ("matplotlib",)),
        (HELP, ("jax", "cv2", "av", "rerun")),
    ],
    ids=("the package", "the viewer", "evaluation", "help"),
)
def test_libraries_load_only_when_they_are_used(code, absent):
    check = f"{code}\nimport sys\nprint([m for m in {absent!r} if m in sys.modules])"
    done = subprocess.run(
        [sys.executable, "-c", check], capture_output=True, text=True, cwd=PROJECT, check=True
    )
    assert done.stdout.strip() == "[]"


def test_the_map_shows_the_rooms_in_their_order():
    lines = (PACKAGE / "README.md").read_text(encoding="utf-8").splitlines()
    start = lines.index("| room | what it is for | begin with |") + 2
    rows = [line.split("|")[1].strip(" `") for line in lines[start : start + len(ROOMS)]]
    assert tuple(rows) == ROOMS
    folders = {path.name for path in PACKAGE.iterdir() if (path / "__init__.py").exists()}
    assert folders == set(ROOMS)


def test_every_room_says_what_it_is_for_and_where_to_begin():
    for path in PACKAGE.rglob("__init__.py"):
        if path.parent != PACKAGE:
            text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
            assert "begin" in text.lower(), within(path)


def test_modules_import_one_another_in_no_circle():
    names = {path: dotted(path) for path in FILES}
    paths = {name: path for path, name in names.items()}
    leads = {names[path]: imports(path) & set(paths) - {names[path]} for path in FILES}
    finished: set[str] = set()

    def walk(name: str, above: tuple[str, ...]) -> None:
        assert name not in above, " -> ".join([*above[above.index(name) :], name])
        if name not in finished:
            for other in sorted(leads[name]):
                walk(other, (*above, name))
            finished.add(name)

    for name in sorted(leads):
        walk(name, ())


def test_a_class_name_stands_for_one_thing():
    homes: dict[str, list[str]] = {}
    for path in FILES:
        if room_of(path) != "reference":
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.ClassDef):
                    homes.setdefault(node.name, []).append(within(path))
    twice = {name: paths for name, paths in homes.items() if len(paths) > 1}
    # Once for each of the two trackers.
    assert set(twice) <= {"Settings", "State", "StepReport"}, twice
