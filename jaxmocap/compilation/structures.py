"""Structures of results as JSON: which tuples, lists, dicts and NamedTuples hold the arrays.

INPUTS: the structure (PyTreeDef) of a result, or such JSON.
OUTPUTS: the other, and whether a structure is of this package's classes alone. Reading it imports
no module and runs no code of a class: a NamedTuple is looked up among the modules that are there.
"""

import json
import sys
from typing import Any

import jax

# An array's place. None stands for itself, a list for a list.
ARRAY = 0
TUPLE, DICT = "tuple", "dict"


class _UnknownError(Exception):
    """A container that is none of these, or that is not there."""


def to_json(structure: Any) -> str | None:
    """The structure in JSON; None if it holds containers that cannot be described."""
    try:
        return json.dumps(_describe(structure))
    except _UnknownError:
        return None


def from_json(text: str) -> Any:
    """The structure that ``to_json`` described.

    Raises:
        ValueError: no such JSON, or a class that is not there any more.
    """
    try:
        return jax.tree.structure(_fill(json.loads(text)))
    except (_UnknownError, RecursionError):
        raise ValueError("not a structure that can be restored here") from None


def is_of_this_code(structure: Any) -> bool:
    """Whether all classes in a structure of arguments are this package's, or containers.

    Of a user's own, such as a term, the code is not known: it may change from start to start.
    """
    kind = (structure.node_data() or (None, None))[0]
    name = getattr(kind, "__module__", "builtins")
    return name.partition(".")[0] in ("builtins", "jaxmocap") and all(
        map(is_of_this_code, structure.children())
    )


def _describe(structure: Any) -> Any:
    children = [_describe(child) for child in structure.children()]
    if (node := structure.node_data()) is None:
        return ARRAY
    kind, keys = node
    if kind is type(None):
        return None
    if kind is list:
        return children
    if kind is tuple:
        return {TUPLE: children}
    if kind is dict and all(isinstance(key, str) for key in keys):
        return {DICT: dict(zip(keys, children, strict=True))}
    name = f"{kind.__module__}:{kind.__qualname__}"
    if _named_tuple(name) is not kind:
        raise _UnknownError
    return {name: children}


def _fill(described: Any) -> Any:
    """The containers, with some object for each array."""
    if described is None:
        return None
    if described == ARRAY:
        return ARRAY
    if isinstance(described, list):
        return [_fill(child) for child in described]
    if not isinstance(described, dict) or len(described) != 1:
        raise _UnknownError
    ((name, children),) = described.items()
    if name == DICT and isinstance(children, dict):
        return {key: _fill(child) for key, child in children.items()}
    if not isinstance(children, list):
        raise _UnknownError
    kind = tuple if name == TUPLE else _named_tuple(name)
    if kind is None or len(getattr(kind, "_fields", children)) != len(children):
        raise _UnknownError
    # Not by the class's own constructor, which is code.
    return tuple.__new__(kind, [_fill(child) for child in children])


def _named_tuple(name: str) -> type | None:
    """The NamedTuple ``module:qualified.name`` if its module is imported, else None."""
    module, _, path = name.partition(":")
    item: Any = sys.modules.get(module)
    for part in path.split("."):
        item = vars(item).get(part) if hasattr(item, "__dict__") else None
    is_one = isinstance(item, type) and issubclass(item, tuple) and hasattr(item, "_fields")
    return item if is_one else None
