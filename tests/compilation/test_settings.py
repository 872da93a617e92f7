"""How settings are declared: defaults, what is traced, what is static, docstrings."""

from dataclasses import FrozenInstanceError, fields, replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import double
from jax import Array

from jaxmocap.compilation.settings import counted, group, settings, static, traced
from jaxmocap.hybrid.settings import Settings


@settings
class Spring:
    """How a spring pulls."""

    stiffness: Array = traced(2.0, "of the spring, newtons per metre")
    coils: Array = counted(3, "of wire")
    shape: str = static("round", "of its wire")


@settings
class Clockwork:
    """A spring within a clock."""

    spring: Spring = group(Spring, "that drives it")
    hands: int = static(2, "on its face")


def test_defaults_are_arrays_of_jaxs_present_precision():
    own = Spring()
    assert own.stiffness.dtype == jnp.float32 and float(own.stiffness) == 2.0
    assert own.coils.dtype == jnp.int32 and int(own.coils) == 3
    assert own.shape == "round"
    with double():
        assert Spring().stiffness.dtype == jnp.float64 and Spring().coils.dtype == jnp.int32


def test_python_numbers_become_arrays_and_all_else_stays():
    assert Spring(stiffness=3, coils=5).stiffness.dtype == jnp.float32
    array = np.asarray(4.0, np.float64)
    assert Spring(stiffness=array).stiffness is array
    kept = object()
    # As where pytrees are rebuilt with other leaves.
    assert jax.tree.map(lambda _: kept, Spring()).stiffness is kept


def test_other_numbers_need_no_new_trace_and_other_choices_do():
    calls = []

    @jax.jit
    def force(spring, length):
        calls.append(spring.shape)
        return spring.stiffness * length * spring.coils.astype(float)

    length = jnp.asarray(2.0)
    assert float(force(Spring(), length)) == 12.0
    assert float(force(Spring(stiffness=5, coils=1), length)) == 10.0
    assert float(force(replace(Spring(), stiffness=0.5), length)) == 3.0
    assert calls == ["round"]
    force(Spring(shape="flat"), length)
    assert calls == ["round", "flat"]


def test_numbers_are_differentiable_and_mapped():
    slope = jax.grad(lambda own: own.stiffness**2, allow_int=True)(Spring())
    assert float(slope.stiffness) == 4.0
    many = jax.vmap(lambda k: Spring(stiffness=k).stiffness * 2)(jnp.arange(3.0))
    np.testing.assert_array_equal(many, [0, 2, 4])


def test_settings_within_settings_are_made_for_each():
    one, other = Clockwork(), Clockwork()
    assert one.spring is not other.spring
    changed = replace(one, spring=Spring(stiffness=9.0))
    assert float(changed.spring.stiffness) == 9.0 and float(one.spring.stiffness) == 2.0
    doubled = jax.tree.map(lambda leaf: leaf * 2, one)
    assert float(doubled.spring.stiffness) == 4.0 and doubled.hands == 2


def test_settings_do_not_change():
    with pytest.raises(FrozenInstanceError):
        Spring().stiffness = 1.0  # type: ignore[misc]
    with pytest.raises(TypeError):
        Spring(strength=1.0)  # type: ignore[call-arg]


def test_the_docstring_has_every_field():
    text = Spring.__doc__ or ""
    assert text.startswith("How a spring pulls.\n\nAttributes:\n")
    assert "    stiffness: of the spring, newtons per metre.\n" in text
    assert "    coils: of wire.\n" in text and text.endswith("    shape: of its wire.")


def declared(own: object):
    """All settings within settings, themselves included."""
    yield own
    for field in fields(own):  # type: ignore[arg-type]
        value = getattr(own, field.name)
        if type(value).__module__.startswith("jaxmocap.") and not field.metadata.get("static"):
            yield from declared(value)


def test_every_field_of_the_trackers_settings_has_a_meaning():
    actual = list(declared(Settings()))
    assert len(actual) > 15
    for own in actual:
        for field in fields(own):  # type: ignore[arg-type]
            assert field.metadata.get("meaning"), (type(own), field.name)
            assert f"    {field.name}: " in (type(own).__doc__ or "")


def test_all_leaves_of_the_trackers_settings_are_arrays():
    leaves = jax.tree.leaves(Settings())
    assert len(leaves) > 50 and all(isinstance(leaf, Array) and not leaf.shape for leaf in leaves)
    assert not any(leaf.weak_type for leaf in leaves)
