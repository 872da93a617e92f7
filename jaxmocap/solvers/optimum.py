"""Derivatives of a minimum, by the implicit function theorem.

A loop of steps has no useful derivative; the minimum x that it ends at has one. There the slope
g(x, p) vanishes, and goes on doing so as p changes: H dx = -(dg/dp) dp. One step from the minimum,
its Hessian H kept fixed, says just that, forwards, backwards and in batches.

INPUTS: a minimum, slopes or residuals about it. OUTPUTS: it, with its derivatives.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array
from jax.custom_derivatives import SymbolicZero

from jaxmocap.solvers.sdls import HIGHEST


def following(moved: Callable[[Any, Any], Any], parameters: Any, x: Any) -> Any:
    """The minimum x as it is, with the derivatives of ``moved(parameters, x)``.

    That function holds no arrays of its own, and is called for derivatives only.
    """
    leaves, tree = jax.tree.flatten((parameters, x))
    return _following(moved, tree, leaves)


@partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def _following(moved: Callable[[Any, Any], Any], tree: Any, leaves: list[Array]) -> Any:
    return jax.tree.unflatten(tree, leaves)[1]


def _following_jvp(
    moved: Callable[[Any, Any], Any], tree: Any, primals: tuple, tangents: tuple
) -> tuple[Any, Any]:
    (leaves,), (changes,) = primals, tangents
    # By what nobody asks for nothing is traced.
    asked = [i for i, change in enumerate(changes) if not isinstance(change, SymbolicZero)]

    def there(parts: list[Array]) -> Any:
        now = dict(enumerate(leaves)) | dict(zip(asked, parts, strict=True))
        return moved(*jax.tree.unflatten(tree, now.values()))

    parts, change = ([of[i] for i in asked] for of in (leaves, changes))
    return jax.tree.unflatten(tree, leaves)[1], jax.jvp(there, (parts,), (change,))[1]


_following.defjvp(_following_jvp, symbolic_zeros=True)


# Of the curvature that the residuals' derivatives alone have, less is none.
LEAST_CURVATURE = 1e-2


def least_squares_step(
    jacobian: Array, second_order: Array, moves: Array, change: Array, pull: Array
) -> Array:
    """The step (N,) of a least-squares minimum as its residuals change.

    The cost's Hessian J^T J + S has the square of J's condition, and single precision cannot hold
    it where a marker counts for millimetres beside a weak prior. By J = U V^T and V = B^-1, columns
    of J scaled to the same length, the equations are

        (1 + B^T S B) (V dx) = -(U^T dr + B^T dJ^T r)

    and no square is formed. The factors are those of a singular value decomposition: on processors
    JAX's QR and triangular solves of a batch wait for each other for ever where two are under way
    (jaxlib 0.10.2).

    Args:
        jacobian: (K, N) of the residuals; held fixed.
        second_order: (N, N) S, the residuals' second derivatives, each times its residual; held.
        moves: (N,) which unknowns may move; the others' step is 0.
        change: (K,) of the residuals, dr.
        pull: (N,) of their pull, dJ^T r.
    """
    J, S = jax.lax.stop_gradient((jacobian, (second_order + second_order.T) / 2))
    free = moves.astype(J.dtype)
    sizes = jnp.linalg.norm(J, axis=0)
    # What no residual determines stays.
    determined = moves & (sizes > 0)
    scale = free / jnp.where(determined, sizes, 1.0)
    ridge = jnp.where(determined, 10 * jnp.finfo(J.dtype).eps, 1.0)
    U, sigma, Vt = jnp.linalg.svd(
        jnp.concatenate([J * scale, jnp.diag(ridge)]), full_matrices=False
    )
    B = scale[:, None] * Vt.T / sigma
    exactly = partial(jnp.matmul, precision=HIGHEST)
    values, vectors = jnp.linalg.eigh(
        jnp.eye(len(free), dtype=J.dtype) + exactly(exactly(B.T, S), B)
    )
    curved = values > LEAST_CURVATURE
    inverse = jnp.where(curved, 1 / jnp.where(curved, values, 1.0), 0.0)
    right = exactly(U[: len(J)].T, change) + exactly(B.T, pull)
    return -exactly(B, exactly(vectors, inverse * exactly(vectors.T, right)))


def curved_step(slope: Array, hessian: Array) -> Array:
    """The step (N,) that carries the derivatives of the minimum beside a point.

    Directions in which the Hessian (N, N) is not curved upwards have none.
    """
    H = jax.lax.stop_gradient((hessian + hessian.T) / 2)
    curvature = jnp.abs(jnp.diagonal(H))
    scale = jnp.where(curvature > 0, 1 / jnp.sqrt(jnp.where(curvature > 0, curvature, 1.0)), 0.0)
    values, vectors = jnp.linalg.eigh(scale[:, None] * H * scale)
    curved = values > 100 * jnp.finfo(H.dtype).eps * jnp.max(jnp.abs(values))
    inverse = jnp.where(curved, 1 / jnp.where(curved, values, 1.0), 0.0)
    exactly = partial(jnp.matmul, precision=HIGHEST)
    return -scale * exactly(vectors, inverse * exactly(scale * slope, vectors))
