"""What all tests share: strict promotion, double precision, bodies, poses, real recordings."""

import ctypes
import gc
import os
import subprocess
import sys
import time
from contextlib import contextmanager, suppress
from importlib.metadata import version
from pathlib import Path

# Before JAX is imported: what one process, or one run, compiles helps the others.
os.environ.setdefault(
    "JAX_COMPILATION_CACHE_DIR", str(Path(__file__).parents[1] / ".pytest_cache" / "compiled")
)
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
# Much is compiled and little of it computed: without optimisation, compiling takes a third of the
# time. What users run, optimised, the benchmark runs.
os.environ.setdefault("JAX_DISABLE_MOST_OPTIMIZATIONS", "1")
# Nor do programs have to say which lines of Python they came from.
os.environ.setdefault("JAX_TRACEBACK_IN_LOCATIONS_LIMIT", "0")
# There is one worker to a core: BLAS's threads would wait for one another.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# As compilation/programs.py asks for, and without threads: there is one worker to a core. A release
# that does not know the flags would not start.
if version("jaxlib").startswith("0.10."):
    flags = "--xla_cpu_use_fusion_emitters=false --xla_cpu_parallel_codegen_split_count=1"
    os.environ.setdefault("XLA_FLAGS", flags)

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.cli.program import main
from jaxmocap.compilation.programs import EFFORTS
from jaxmocap.formats.cameras.calibration import camera_of, read_sections
from jaxmocap.formats.files.errors import InputError
from jaxmocap.geometry.cameras import Camera
from jaxmocap.pipelines.kept_programs import keep_compiled
from jaxmocap.smoothing import elbow_viterbi, linearise

jax.config.update("jax_numpy_dtype_promotion", "strict")
# But for those that go through pictures and many candidates: a little of it makes them run in a
# quarter of the time.
EFFORTS["full"] = {"xla_backend_optimization_level": 1}
# Tests' recordings are short: a batch is filled up with little that nobody asks for.
linearise.FRAMES_A_CALL = elbow_viterbi.POSES_A_CALL = 8
linearise.VIEWS_A_CALL = elbow_viterbi.VIEWS_A_CALL = 4
# Tracing makes many objects that stay: to go through all of them again and again takes a tenth of
# its time.
gc.set_threshold(200_000, 20, 100)
settings.register_profile("tests", deadline=None, max_examples=25, derandomize=True)
settings.load_profile("tests")
# A tmp_path that examples share is fine: each of them overwrites what it reads.
shared_folder = settings(suppress_health_check=[HealthCheck.function_scoped_fixture])

# How far float32 may lie from the same in double precision: the absolute error allowed.
FLOAT32_TOLERANCES = {
    "positions": 2e-6,  # metres, on a body about the origin
    "orientations": 2e-6,
    "jacobian": 4e-6,  # metres per radian
    "centre_of_gravity": 2e-6,  # metres
    "masses": 2e-5,  # kilograms
    "arms": 2e-5,  # metres
    "pixels": 1e-3,
    "rays": 1e-6,
}
LIMITS = np.asarray(Skeleton.human().limits)
# Nothing that is refused takes longer than a second or two on an idle machine.
HANG_S = 60
RECORDINGS = Path(__file__).parents[2] / "shared" / "recordings"


def double():
    """A context in which JAX computes in float64."""
    return jax.enable_x64(True)


# Beyond so much memory, GiB, compiled programs are let go between two files. What a later file
# needs of them is traced again and read from the folder of compiled programs, which takes some
# seconds for a tracker's.
MOST_RESIDENT_GIB = 3.0


@pytest.fixture(autouse=True, scope="module")
def programs_let_go():
    """Compiled programs do not pile up over files."""
    yield
    status = Path("/proc/self/status")
    if status.exists():
        kib = next(line.split()[1] for line in status.read_text().splitlines() if "VmRSS" in line)
        if int(kib) / 2**20 > MOST_RESIDENT_GIB:
            jax.clear_caches()
            gc.collect()
            # The compiler leaves much that is free but not handed back.
            with suppress(AttributeError, OSError):
                ctypes.CDLL(None).malloc_trim(0)


# What takes longest comes first, so that workers end together (with --no-loadscope-reorder: xdist
# would begin with files of many tests, however short they are).
LONGEST_FILES = ("test_functions.py", "test_terms.py", "test_smooth_by_silhouettes.py")


def pytest_collection_modifyitems(items):
    """Files in order of what they take."""
    items.sort(key=lambda item: item.path.name not in LONGEST_FILES)


def complaint(read, *arguments, **options) -> str:
    """What input is refused with, and soon: one sentence that any terminal shows."""
    begun = time.monotonic()
    with pytest.raises(InputError) as caught:
        read(*arguments, **options)
    assert time.monotonic() - begun < HANG_S
    text = str(caught.value)
    assert text.isprintable() and len(text) <= 500
    return text


def written(folder: Path, name: str, content: str | bytes) -> Path:
    """A file of that content."""
    path = folder / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def problem_of(read, path: Path, *arguments) -> str:
    """What a file is refused with, behind its name."""
    text = complaint(read, path, *arguments)
    assert text.startswith(f"{path}: ")
    return text.removeprefix(f"{path}: ")


def read_calibration(path: Path) -> dict[str, Camera]:
    """Every camera of a calibration file."""
    sections = read_sections(path)
    return {name: camera_of(path, sections, name) for name in sections}


MEASURED = """
import resource, sys
from pathlib import Path
from jaxmocap.formats.files.errors import InputError
from {module} import {name}
path, before = Path(sys.argv[1]), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
try:
    {name}({arguments})
except InputError as error:
    print(error)
print((resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) // 1024)
"""


def measured_complaint(read, path: Path, arguments: str = "path") -> tuple[str, int]:
    """What a process of its own refuses a file with, and by how many MB that made it grow."""
    pytest.importorskip("resource", reason="this system has no limits of file sizes")
    named = {"module": read.__module__, "name": read.__name__, "arguments": arguments}
    done = subprocess.run(
        [sys.executable, "-c", MEASURED.format(**named), str(path)],
        capture_output=True, text=True, timeout=HANG_S, check=True,
    )  # fmt: skip
    message, size = done.stdout.splitlines()
    assert done.stderr == ""
    return message, int(size)


@pytest.fixture
def refusal(capsys):
    """What a command line is refused with: exit code 2, one line on stderr and nothing else."""

    def refused(*arguments: object) -> str:
        capsys.readouterr()
        try:
            code = main([str(each) for each in arguments])
        except SystemExit as end:
            code = end.code
        printed = capsys.readouterr()
        assert code == 2 and printed.out == "" and printed.err.count("\n") == 1
        assert printed.err.startswith("jaxmocap") and "Traceback" not in printed.err
        return printed.err

    return refused


def wait_for(condition, seconds: float = 5.0) -> None:
    """Until something is so, and no longer than so many seconds."""
    end = time.monotonic() + seconds
    while not condition() and time.monotonic() < end:
        time.sleep(0.005)
    assert condition()


def rerun_chunks():
    """What reads rerun's recordings back."""
    why = "the installed rerun-sdk cannot read .rrd files (no rerun.chunk); a newer one can"
    return pytest.importorskip("rerun.chunk", reason=why)


@contextmanager
def disk_full_at(size: int):
    """No file may grow beyond so many bytes, which a program sees as it sees a full disk."""
    resource = pytest.importorskip("resource", reason="this system has no limits of file sizes")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def vectors(n: int, largest: float = 1.0):
    """Hypothesis: (n,) float64 arrays with entries between -largest and largest."""
    return arrays(float, n, elements=st.floats(-largest, largest, allow_subnormal=False))


@st.composite
def poses(draw, beyond: float = 0.0) -> Pose:
    """Hypothesis: float64 NumPy poses anywhere within the human's limits.

    Args:
        draw: given by Hypothesis.
        beyond: radians by which angles may exceed the limits.
    """
    lowest, highest = np.asarray(LIMITS, float).T + np.array([[-beyond], [beyond]])
    fractions = draw(arrays(float, len(lowest), elements=st.floats(0, 1, allow_subnormal=False)))
    quaternion = draw(vectors(4))
    if np.linalg.norm(quaternion) < 1e-3:
        quaternion = np.array([1.0, 0, 0, 0])
    angles = lowest + fractions * (highest - lowest)
    return Pose(draw(vectors(3)), quaternion / np.linalg.norm(quaternion), angles)


def on_device(tree, dtype=None):
    """NumPy leaves as JAX arrays of the present precision, or of ``dtype``."""
    # Converted on the host: on the device each shape would be a program.
    dtype = jax.dtypes.canonicalize_dtype(dtype or float)
    return jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf, dtype)), tree)


def in_double(tree):
    """Floating-point leaves in float64, all else as it is; call it where that is enabled."""

    def convert(leaf):
        array = np.asarray(leaf)
        is_real = np.issubdtype(array.dtype, np.floating)
        return jnp.asarray(array.astype(float)) if is_real else leaf

    return jax.tree.map(convert, tree)


@pytest.fixture(scope="session", autouse=True)
def kept_programs():
    """Programs are kept as by the commands, so that these, too, share what tests have compiled."""
    keep_compiled()


@pytest.fixture(scope="session")
def skeleton() -> Skeleton:
    """The paper's subject, float32."""
    return Skeleton.human()


@pytest.fixture(scope="session")
def skeleton64() -> Skeleton:
    """The paper's subject, float64."""
    with double():
        return Skeleton.human()


@pytest.fixture(scope="session")
def plain_skeleton(skeleton64) -> Skeleton:
    """The same in NumPy: the reference takes one number at a time, at which that is faster."""
    return jax.tree.map(np.asarray, skeleton64)


@pytest.fixture(scope="module")
def mujoco_body(skeleton64):
    """The same in MuJoCo."""
    from mujoco_body import MujocoBody

    return MujocoBody(skeleton64)


@pytest.fixture(scope="session")
def recordings() -> Path:
    """The folder of real recordings, which lies beside the checkout."""
    if not RECORDINGS.is_dir():
        pytest.skip("the real recordings are not here (shared/recordings beside the checkout)")
    return RECORDINGS


@pytest.fixture(scope="session")
def slim_woman(recordings):
    """A body mesh with a rig of its own."""
    from jaxmocap.synthetic.people.rigged_mesh import load_rig

    return load_rig(recordings / "person" / "person.npz", "slim_woman")


@pytest.fixture(scope="session")
def shots(slim_woman, tmp_path_factory) -> Path:
    """The folder of four photographs and their cameras' calibration."""
    from jaxmocap.synthetic.photographs import write_photographs

    return write_photographs(tmp_path_factory.mktemp("photographs"), slim_woman).parent
