"""Arguments of public functions, checked at the door: when they are called or traced, not later.

Under ``vmap`` an argument has the shape of one example, so the check is the same there.

INPUTS: an argument, its expected shape. OUTPUTS: its array, or an error of one sentence.
"""

from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.core import Tracer

BATCH = "jax.vmap takes several at once"


def is_traced(tree: Any) -> bool:
    """Whether jit, vmap or a derivative has a hand in any of its leaves."""
    return any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(tree))


def check_kind(name: str, value: Any, kind: type) -> None:
    """Check that an argument is of a class.

    Raises:
        TypeError: it is not.
    """
    if not isinstance(value, kind):
        raise TypeError(f"{name}: found {type(value).__name__}, expected {kind.__name__}")


def floating(name: str, value: Any, shape: Sequence[int], dtype: Any, about: Any = "") -> Array:
    """An argument as an array of floating-point numbers.

    Args:
        name: of the argument.
        value: an array, a number, or lists of them; whole numbers are converted.
        shape: that it must have.
        dtype: that it gets.
        about: what asks for this shape; its text ends the sentence.

    Raises:
        TypeError: no real numbers.
        ValueError: another shape.
    """
    array = _as_array(name, value)
    check_shape(name, array.shape, shape, about)
    return jnp.asarray(array, jax.dtypes.canonicalize_dtype(dtype))


def check_shape(name: str, found: Sequence[int], expected: Sequence[int], about: Any = "") -> None:
    """Check a shape.

    Raises:
        ValueError: it is another one.
    """
    found, expected = tuple(found), tuple(expected)
    if found == expected:
        return
    is_batch = len(found) > len(expected) and found[len(found) - len(expected) :] == expected
    ends = [text for text in (BATCH * is_batch, str(about)) if text]
    raise ValueError("; ".join([f"{name}: found shape {found}, expected {expected}", *ends]))


def checked_parts(
    name: str,
    value: Any,
    kind: type,
    shapes: Mapping[str, Sequence[int]],
    dtype: Any,
    about: Any = "",
) -> Any:
    """A record, its named fields by ``floating``.

    Args:
        name: of the argument.
        value: a dataclass or a NamedTuple.
        kind: its class.
        shapes: field -> expected shape.
        dtype: of all of them.
        about: what asks for these shapes; its text ends the sentence.

    Raises:
        TypeError: no such record, or no real numbers in it.
        ValueError: another shape.
    """
    check_kind(name, value, kind)
    parts = {
        key: floating(f"{name}.{key}", getattr(value, key), shape, dtype, about)
        for key, shape in shapes.items()
    }
    is_tuple = hasattr(value, "_replace")
    return value._replace(**parts) if is_tuple else replace(value, **parts)


def check_settings(name: str, value: Any, kind: type) -> None:
    """Check that declared settings are of a class and that each traced number is one number.

    Raises:
        TypeError: other settings.
        ValueError: several numbers in place of one.
    """
    check_kind(name, value, kind)
    for each in fields(value):
        part = getattr(value, each.name)
        if "dtype" in each.metadata:
            check_shape(f"{name}.{each.name}", np.shape(part), ())
        elif is_dataclass(part) and not each.metadata.get("static"):
            check_settings(f"{name}.{each.name}", part, type(part))


def _as_array(name: str, value: Any) -> Array | np.ndarray:
    try:
        # In NumPy where nothing is traced, which compiles nothing.
        on_device = isinstance(value, Array) or is_traced(value)
        array = jnp.asarray(value) if on_device else np.asarray(value)
    except (TypeError, ValueError):
        array = np.asarray(None)
    if not (jnp.issubdtype(array.dtype, jnp.floating) or jnp.issubdtype(array.dtype, jnp.integer)):
        found = type(value).__name__ if array.dtype == object else f"an array of {array.dtype}"
        raise TypeError(f"{name}: found {found}, expected an array of real numbers")
    return array
