"""Programs kept on disk: what a start traced, a later one only reads."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from threading import Barrier
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import Array, export

from jaxmocap.body.pose import Pose
from jaxmocap.compilation import programs
from jaxmocap.compilation.programs import Program, keep_in
from jaxmocap.pipelines.kept_programs import PrivateCache, keep_compiled


@partial(export.register_namedtuple_serialization, serialized_name="turned")
class Turned(NamedTuple):
    """A result with a structure of its own."""

    point: Array
    rest: None
    parts: dict[str, Array]


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[Path]:
    """Where programs are kept during a test."""
    keep_in(PrivateCache(tmp_path, "programs"))
    yield tmp_path / "programs"
    keep_compiled()


def counted(traced: list[int], name: str = "turn", static: object = ()) -> Program:
    """A program, new as after a start; each trace of its function appends to ``traced``."""

    def turn(angle: Array, point: Array) -> Turned:
        traced.append(1)
        s, c = jnp.sin(angle), jnp.cos(angle)
        moved = jnp.stack([c * point[0] - s * point[1], s * point[0] + c * point[1]])
        return Turned(moved, None, {"length": jnp.sqrt(jnp.sum(moved**2))})

    return Program(turn, name, static)


ANGLE, POINT = np.float32(0.5), np.array([3.0, 4.0], np.float32)


def test_a_later_start_reads_what_an_earlier_one_traced(folder: Path) -> None:
    traced: list[int] = []
    first = counted(traced)(ANGLE, POINT)
    assert len(traced) == 1 and len(list(folder.iterdir())) == 1
    later = counted(traced)(ANGLE, POINT)
    assert len(traced) == 1
    assert isinstance(later, Turned) and later.rest is None
    np.testing.assert_array_equal(later.point, first.point)
    assert float(later.parts["length"]) == pytest.approx(5.0, rel=1e-5)


class CountingStore:
    """Keeps nothing but the names of what it is to keep."""

    def __init__(self) -> None:
        self.names: list[str] = []

    def read(self, name: str, key: str) -> None:
        """Nothing is there."""

    def write(self, name: str, key: str, content: bytes) -> None:
        self.names.append(name)


def test_threads_that_call_at_once_make_it_once(folder: Path) -> None:
    """Many times: two threads that only came close would each make their own."""
    # What the compiler's options are is found out by then.
    counted([])(ANGLE, POINT)
    keep_in(store := CountingStore())
    names = [f"halved {i}" for i in range(20)]
    with ThreadPoolExecutor(2) as threads:
        for name in names:
            own, begun = Program(lambda x: x / 2, name), Barrier(2)

            def call(x: np.ndarray, own=own, begun=begun) -> np.ndarray:
                begun.wait()
                return np.asarray(own(x))

            found = list(threads.map(call, (POINT, 2 * POINT)))
            np.testing.assert_array_equal(found, (POINT / 2, POINT))
    assert len(store.names) == len(names)


def test_it_returns_what_the_function_returns(folder: Path) -> None:
    kept = counted([])
    np.testing.assert_allclose(kept(ANGLE, POINT).point, kept.jitted(ANGLE, POINT).point, 1e-6)


def test_nothing_is_kept_where_no_folder_was_chosen(folder: Path) -> None:
    keep_in(None)
    traced: list[int] = []
    counted(traced)(ANGLE, POINT)
    counted(traced)(ANGLE, POINT)
    assert len(traced) == 2 and not folder.exists()


@pytest.mark.parametrize(
    "other",
    [
        lambda traced: counted(traced)(ANGLE, np.append(POINT, POINT)),
        lambda traced: counted(traced)(ANGLE, POINT.astype(np.float16)),
        lambda traced: counted(traced, static="another body")(ANGLE, POINT),
        lambda traced: counted(traced, name="another turn")(ANGLE, POINT),
    ],
    ids=["shape", "type", "static", "name"],
)
def test_what_is_asked_for_otherwise_is_traced_by_itself(folder: Path, other) -> None:
    traced: list[int] = []
    counted(traced)(ANGLE, POINT)
    with jax.numpy_dtype_promotion("standard"):
        other(traced)
    assert len(traced) == 2


def test_other_code_of_the_package_is_traced_by_itself(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    traced: list[int] = []
    counted(traced)(ANGLE, POINT)
    monkeypatch.setattr(programs, "_code", lambda: "changed")
    counted(traced)(ANGLE, POINT)
    assert len(traced) == 2


def test_tables_of_the_package_are_part_of_its_code(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Tracing bakes them in: an edited place of a landmark had no effect with a kept program."""
    (tmp_path / "compilation").mkdir()
    monkeypatch.setattr(programs, "__file__", str(tmp_path / "compilation" / "programs.py"))
    digests = []
    for name, text in (("code.py", "x = 1"), ("body.toml", "at = 1"), ("body.toml", "at = 2")):
        (tmp_path / name).write_text(text)
        digests.append(programs._code.__wrapped__())
    assert len(set(digests)) == 3


def test_a_result_in_a_container_without_a_name_is_traced_by_each_start(folder: Path) -> None:
    class Local(NamedTuple):
        doubled: Array

    def double(x: Array) -> Local:
        return Local(2 * x)

    assert float(Program(double, "double")(ANGLE).doubled) == 1.0
    assert not folder.exists()


def test_containers_come_back_as_they_were(folder: Path) -> None:
    traced: list[int] = []

    def nested(x: Array) -> dict:
        traced.append(1)
        return {"a": (x, [x, None], Turned(x, None, {}), Pose(x, x, x)), "b": [], "c": ()}

    for _ in range(2):
        result = Program(nested, "nested")(ANGLE)
        assert jax.tree.structure(result) == jax.tree.structure(nested(ANGLE))
    assert len(traced) == 3


@pytest.mark.parametrize("is_kept", [True, False])
def test_within_what_is_traced_it_is_the_function(folder: Path, is_kept: bool) -> None:
    if not is_kept:
        keep_in(None)
    kept = counted([])
    many = jax.vmap(lambda angle: kept(angle, POINT).point)(jnp.array([0.0, np.pi], jnp.float32))
    np.testing.assert_allclose(many, [POINT, -POINT], atol=1e-5)
    slope = jax.grad(lambda angle: kept(angle, POINT).point[0])
    assert float(slope(jnp.zeros(()))) == pytest.approx(-4.0, rel=1e-5)
    # Compiler's options, which its own program has, are refused within another's.
    assert float(jax.jit(slope)(jnp.zeros(()))) == pytest.approx(-4.0, rel=1e-5)
    constant = jax.jit(lambda x: x + kept(ANGLE, POINT).parts["length"])
    assert float(constant(0.0)) == pytest.approx(5.0, rel=1e-5)


def test_shapes_are_given_before_anything_is_compiled(folder: Path) -> None:
    traced: list[int] = []
    like = jax.ShapeDtypeStruct((), np.float32), jax.ShapeDtypeStruct((2,), np.float32)
    program = counted(traced)
    assert program.shapes(*like).point.shape == (2,)
    assert not folder.exists()
    compiled = program.beside(*like)()
    np.testing.assert_allclose(compiled(ANGLE, POINT).parts["length"], 5.0, rtol=1e-5)
    later = counted(traced).shapes(*like)
    assert later == program.shapes(*like) and later.rest is None
    assert len(traced) == 1


def test_arguments_that_come_first_are_numbers_and_no_part_of_the_program(folder: Path) -> None:
    traced: list[int] = []
    program = counted(traced)
    still, turned = program.after(np.float32(0.0)), program.after(np.float32(np.pi))
    assert still.beside(POINT)()(POINT).parts["length"] == pytest.approx(5.0, rel=1e-5)
    np.testing.assert_allclose(still(POINT).point, POINT, atol=1e-5)
    np.testing.assert_allclose(turned(POINT).point, -POINT, atol=1e-5)
    np.testing.assert_allclose(turned.beside(POINT)()(POINT).point, -POINT, atol=1e-5)
    assert len(traced) == 1 and len(list(folder.iterdir())) == 1


def test_what_cannot_be_kept_runs_all_the_same(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As what calls LAPACK by a name that JAX may change."""

    def refused(*_: object, **__: object) -> None:
        raise ValueError("custom calls without compatibility guarantees")

    monkeypatch.setattr(programs.export, "export", refused)
    actual = counted([])(ANGLE, POINT)
    assert float(actual.parts["length"]) == pytest.approx(5.0, rel=1e-5)
    assert not any(folder.glob("*"))


def test_options_that_this_compiler_lacks_are_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """A release that lacks one of an effort's has the others all the same."""
    level = {"xla_backend_optimization_level": 1}
    monkeypatch.setattr(jax, "default_backend", lambda: "cpu")
    monkeypatch.setitem(programs.EFFORTS, "quick", {"xla_of_no_release": True, **level})
    assert programs._compiler_options.__wrapped__("quick") == level
