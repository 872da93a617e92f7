"""Matrix products of a program, and those of them that a GPU would round to TF32's ten bits."""

from collections.abc import Callable, Iterator
from typing import Any

import jax
from jax._src import source_info_util
from jax.extend.core import ClosedJaxpr, Jaxpr
from jax.lax import Precision


def products(jaxpr: Jaxpr) -> Iterator[Any]:
    """Those of it, and of all that it calls."""
    for equation in jaxpr.eqns:
        if equation.primitive.name == "dot_general":
            yield equation
        for part in jax.tree.leaves(list(equation.params.values())):
            if isinstance(part, ClosedJaxpr):
                yield from products(part.jaxpr)
            elif isinstance(part, Jaxpr):
                yield from products(part)


def coarse_products(function: Callable, *arguments: Any) -> tuple[int, list[str]]:
    """How many products of float32 there are, and where in the code the coarse ones stand."""
    found = [
        each
        for each in products(jax.make_jaxpr(function)(*arguments).jaxpr)
        if each.invars[0].aval.dtype == "float32"
    ]
    coarse = [each for each in found if each.params["precision"] != (Precision.HIGHEST,) * 2]
    return len(found), sorted({source_info_util.summarize(each.source_info) for each in coarse})
