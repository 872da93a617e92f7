"""How settings are declared: each field once, with its default, its meaning and what tracing sees.

    @settings
    class Posture:
        \"\"\"How far joints go from the relaxed pose.\"\"\"

        ease: Array = traced(1.0, "multiple of what is usual")
        iterations: int = static(12, "most of one solve")

A traced number is an array: it may be tuned, or differentiated by, without a new trace (a Python
float in a pytree would trace again). A static one belongs to the program.

INPUTS: a class with such fields. OUTPUTS: a frozen dataclass that is a pytree, its fields listed in
its docstring.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, fields
from typing import Any, TypeVar, dataclass_transform

import jax
import jax.numpy as jnp

from jaxmocap.compilation.arrays import on_device

T = TypeVar("T")


# A setting may be so many times its default, and a positive one so small a part of it.
WIDEST = 1e4
# The same of what sizes a program or says how often something is done.
MOST_TIMES = 10


def traced(default: float, meaning: str, least: float | None = None) -> Any:
    """A number that becomes a floating-point array of JAX's present precision.

    Args:
        default: its range follows from it.
        meaning: in words, with the unit.
        least: of its range; without it a positive number stays positive.
    """
    if least is None:
        least = default / WIDEST if default > 0 else -WIDEST
    bounds = least, WIDEST * (default or 1.0)
    return field(default=default, metadata={"meaning": meaning, "dtype": float, "range": bounds})


def counted(default: int, meaning: str) -> Any:
    """A whole number that becomes an int32 array."""
    bounds = 1, MOST_TIMES * default
    return field(
        default=default, metadata={"meaning": meaning, "dtype": jnp.int32, "range": bounds}
    )


def static(default: Any, meaning: str, within: tuple[float, float] | None = None) -> Any:
    """What changes the shape of a computation: hashable, and part of the program's name.

    Args:
        default: a number's range follows from it where none is named.
        meaning: in words, with the unit.
        within: the least and the largest number.
    """
    metadata = {"meaning": meaning, "static": True}
    if isinstance(default, tuple):
        metadata |= {"range": within, "length": len(default)}
    elif isinstance(default, int | float) and not isinstance(default, bool):
        metadata["range"] = within or (default / MOST_TIMES, MOST_TIMES * default)
    return field(default=default, metadata=metadata)


def group(make: Callable[[], Any], meaning: str) -> Any:
    """Settings within settings, new for each."""
    return field(default_factory=make, metadata={"meaning": meaning})


@dataclass_transform(frozen_default=True)
def settings(cls: type[T]) -> type[T]:
    """The class as a frozen dataclass and a pytree; its numbers are converted when it is made."""
    cls.__post_init__ = _convert  # type: ignore[attr-defined]
    made = dataclass(frozen=True)(cls)
    named = fields(made)  # type: ignore[arg-type]
    shape = [each.name for each in named if each.metadata.get("static")]
    jax.tree_util.register_dataclass(
        made, data_fields=[each.name for each in named if each.name not in shape], meta_fields=shape
    )
    listed = [f"    {f.name}: {f.metadata['meaning']}." for f in named if "meaning" in f.metadata]
    made.__doc__ = "\n".join([f"{cls.__doc__ or cls.__name__}\n", "Attributes:", *listed])
    return made


def _convert(self: Any) -> None:
    """Python numbers of traced fields become arrays; what is an array or traced stays."""
    for each in fields(self):
        value = getattr(self, each.name)
        if "dtype" in each.metadata and isinstance(value, int | float):
            object.__setattr__(self, each.name, on_device(value, each.metadata["dtype"]))
