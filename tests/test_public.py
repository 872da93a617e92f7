"""The public names, frozen: who removes or renames one breaks somebody's notebook."""

import doctest
import inspect
import subprocess
import sys
from pathlib import Path

import pytest

import jaxmocap
from jaxmocap.synthetic.recording import write_table_tennis

PUBLIC = {
    "LANDMARKS",
    "Camera",
    "Events",
    "HybridTracker",
    "InputError",
    "Model",
    "Motion",
    "Observation",
    "Pose",
    "Recording",
    "Report",
    "Settings",
    "Skeleton",
    "SmoothMotion",
    "State",
    "__version__",
    "evaluate",
    "first_pass",
    "keep_compiled",
    "landmarks",
    "observe",
    "refine",
    "smooth",
    "solve",
    "track",
}
PARAMETERS = {
    "track": ["recording", "settings", "mode", "progress", "tracker"],
    "evaluate": ["motion", "truth", "pairs", "up"],
    "HybridTracker": ["skeleton", "cameras", "settings", "markers"],
    "HybridTracker.from_recording": ["recording", "settings"],
    "HybridTracker.init": ["self", "markers_world"],
    "HybridTracker.step": ["self", "state", "time", "markers_world", "images", "clock"],
    "Recording.load": ["path"],
    "Skeleton.human": ["height", "mass", "proportions"],
    "Motion.joints": ["self"],
    "Model.of": ["recording"],
    "Model.with_lengths": ["self", "lengths"],
    "keep_compiled": [],
    "solve": ["model", "settings", "markers_world", "start"],
    "observe": ["model", "settings", "pose", "images"],
    "refine": ["model", "settings", "pose", "observation"],
    "landmarks": ["model", "pose"],
    "smooth": ["model", "settings", "events"],
    "first_pass": ["recording", "settings", "progress", "tracker"],
}
# Everything heavy, OpenCV and the viewer above all, loads when it is used.
LIGHT = "import sys, jaxmocap; print(sorted(m for m in sys.modules if m.startswith('jaxmocap')))"


def test_the_public_names_are_these_and_no_others():
    assert set(jaxmocap.__all__) == PUBLIC
    assert set(dir(jaxmocap)) >= PUBLIC
    for name in PUBLIC:
        assert getattr(jaxmocap, name) is not None


def test_every_public_name_is_what_its_home_defines():
    from jaxmocap.hybrid.tracker import HybridTracker
    from jaxmocap.pipelines.tracking.track import track

    assert jaxmocap.HybridTracker is HybridTracker and jaxmocap.track is track


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'tracker'"):
        _ = jaxmocap.tracker


@pytest.mark.parametrize("name", PARAMETERS)
def test_public_calls_keep_their_parameters(name):
    thing = jaxmocap
    for part in name.split("."):
        thing = getattr(thing, part)
    assert list(inspect.signature(thing).parameters) == PARAMETERS[name]


def test_importing_the_package_loads_no_room_of_it():
    done = subprocess.run(
        [sys.executable, "-c", LIGHT],
        capture_output=True,
        text=True,
        check=True,
        cwd=Path(__file__).parents[1],
    )
    assert done.stdout.strip() == "['jaxmocap']"


def test_state_and_pose_are_named_tuples_that_jax_takes_apart():
    assert jaxmocap.Pose._fields == ("position", "quaternion", "angles")
    assert jaxmocap.State._fields[0] == "pose"


FUNCTIONS = sorted(n for n in PUBLIC if inspect.isfunction(getattr(jaxmocap, n)))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """With a recording.toml, as the examples have it."""
    return write_table_tennis(tmp_path_factory.mktemp("examples"), seconds=0.5).parent


# Its program takes a minute to compile.
SMOOTH = pytest.param("smooth", marks=pytest.mark.slow)


@pytest.mark.parametrize(
    "name", [SMOOTH if name == "smooth" else name for name in (*FUNCTIONS, "Model.with_lengths")]
)
def test_the_example_of_a_function_runs(name, folder, monkeypatch):
    monkeypatch.chdir(folder)
    thing = jaxmocap
    for part in name.split("."):
        thing = getattr(thing, part)
    (example,) = doctest.DocTestFinder(recurse=False).find(thing, name, globs={})
    assert example.examples, f"help(jaxmocap.{name}) has no example"
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS)
    printed = []
    assert runner.run(example, out=printed.append).failed == 0, "".join(printed)
