"""The downhill simplex of Nelder and Mead (1965), as the textbooks print it.

INPUTS: a function of n variables and a simplex of n + 1 points. OUTPUTS: the best point found.
"""

from collections.abc import Callable

import numpy as np


def minimise(
    function: Callable[[np.ndarray], float], simplex: np.ndarray, iterations: int
) -> tuple[np.ndarray, float]:
    """Reflect (1), expand (2), contract (1/2) or shrink (1/2), a given number of times.

    Args:
        function: of (n,).
        simplex: (n + 1, n) initial vertices.
        iterations: how many times.

    Returns:
        The best vertex (n,), and the function there.
    """
    vertices = [(function(point), point) for point in np.array(simplex, float)]
    for _ in range(iterations):
        vertices.sort(key=lambda vertex: vertex[0])
        vertices = _move_vertices(function, vertices)
    value, point = min(vertices, key=lambda vertex: vertex[0])
    return point, value


def _move_vertices(evaluate: Callable[[np.ndarray], float], vertices: list) -> list:
    """One move of the sorted vertices (value, point)."""
    best, second_worst, (worst_value, worst) = vertices[0][0], vertices[-2][0], vertices[-1]
    middle = np.mean([point for _, point in vertices[:-1]], 0)

    reflected = middle + 1.0 * (middle - worst)
    reflected_value = evaluate(reflected)
    if best <= reflected_value < second_worst:
        return [*vertices[:-1], (reflected_value, reflected)]
    if reflected_value < best:
        expanded = middle + 2.0 * (middle - worst)
        expanded_value = evaluate(expanded)
        if expanded_value < reflected_value:
            return [*vertices[:-1], (expanded_value, expanded)]
        return [*vertices[:-1], (reflected_value, reflected)]
    if reflected_value < worst_value:
        contracted = middle + 0.5 * (reflected - middle)
        contracted_value = evaluate(contracted)
        if contracted_value <= reflected_value:
            return [*vertices[:-1], (contracted_value, contracted)]
    else:
        contracted = middle + 0.5 * (worst - middle)
        contracted_value = evaluate(contracted)
        if contracted_value < worst_value:
            return [*vertices[:-1], (contracted_value, contracted)]
    kept = vertices[0]
    halved = [kept[1] + 0.5 * (point - kept[1]) for _, point in vertices[1:]]
    return [kept, *((evaluate(point), point) for point in halved)]
