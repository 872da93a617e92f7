"""A settings file: any field of a settings record by its name, TOML tables for records within.

    refine = "search"

    [ik]
    memory = 0.5

    [smoothing.pelvis]
    facing = 0.2

INPUTS: a TOML file, the record that it changes. OUTPUTS: the changed record; a list of all fields.
"""

import textwrap
from collections.abc import Iterator
from dataclasses import Field, fields, is_dataclass, replace
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

import numpy as np

from jaxmocap.formats.files.errors import short_repr
from jaxmocap.formats.files.toml import TomlTable, read_toml, toml_value

T = TypeVar("T")
WIDTH = 96


def read_settings(path: str | Path, settings: T) -> T:
    """A settings record with the fields that a TOML file names; InputError where one is wrong."""
    return _change_settings(settings, Path(path), "", read_toml(path))


def _change_settings(settings: T, path: Path, where: str, entries: Any) -> T:
    named = {each.name: each for each in fields(settings)}  # type: ignore[arg-type]
    table = TomlTable(path, where and f"[{where}]", entries, named)
    hints = get_type_hints(type(settings))
    values = {}
    for name, entry in table.entries.items():
        now = getattr(settings, name)
        if is_dataclass(now):
            values[name] = _change_settings(now, path, f"{where}.{name}" if where else name, entry)
        else:
            values[name] = _value(table, named[name], hints[name])
    return replace(settings, **values)  # type: ignore[type-var]


def _value(table: TomlTable, field: Field, kind: Any) -> Any:
    """An entry, of its field's kind and within its range."""
    entry, name = table.require(field.name), field.name
    if choices := _choices(kind):
        if entry not in choices or isinstance(entry, bool) != isinstance(choices[0], bool):
            expected = ", ".join(map(toml_value, choices))
            raise table.error(name, f"found {short_repr(entry)}, expected one of {expected}")
        return entry
    bounds = field.metadata["range"]
    if (length := field.metadata.get("length")) is not None:
        row = table.array(name, [(length,)], f"{length} numbers").tolist()
        if any(not bounds[0] <= number <= bounds[1] for number in row):
            expected = f"expected numbers from {bounds[0]:g} to {bounds[1]:g}"
            raise table.error(name, f"found {short_repr(entry)}, {expected}")
        return tuple(row)
    is_whole = isinstance(field.default, int)
    return table.integer(name, *bounds) if is_whole else table.number(name, None, *bounds)


def _choices(kind: Any) -> tuple:
    """What a field may be, where that is one of a few things."""
    if kind is bool:
        return (True, False)
    return get_args(kind) if get_origin(kind) is Literal else ()


def list_fields(settings: Any) -> str:
    """Every field of a settings record: its name, its value, what else it may be, its meaning."""
    return "\n".join(_lines(settings, ""))


def _lines(settings: Any, where: str) -> Iterator[str]:
    hints, within = get_type_hints(type(settings)), []
    for field in fields(settings):
        value, meaning = getattr(settings, field.name), field.metadata["meaning"]
        if is_dataclass(value):
            within.append((f"{where}.{field.name}" if where else field.name, value, meaning))
            continue
        yield f"{field.name} = {_text(value)}"
        if choices := _choices(hints[field.name]):
            meaning = f"{' | '.join(map(toml_value, choices))}: {meaning}"
        yield from textwrap.wrap(
            meaning, WIDTH, initial_indent="    # ", subsequent_indent="    # "
        )
    for name, value, meaning in within:
        yield from ("", f"[{name}]  # {meaning}", *_lines(value, name))


def _text(value: Any) -> str:
    """As it stands in TOML, a float32 by its own digits."""
    if value is None:
        return "(none)"
    if isinstance(value, tuple):
        return toml_value(list(value))
    if isinstance(value, bool | int | str):
        return toml_value(value)
    number = np.asarray(value)
    if number.dtype.kind == "i":
        return str(int(number))
    text = f"{float(number):.7g}"
    return text if "." in text or "e" in text else f"{text}.0"
