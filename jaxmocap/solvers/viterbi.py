"""The cheapest path through candidates over time, by dynamic programming (Viterbi 1967).

INPUTS: costs and places of candidates. OUTPUTS: which candidate is on the path at each time.
"""

import numpy as np
from scipy.spatial.distance import cdist


def cheapest_path(
    costs: np.ndarray,
    places: np.ndarray,
    times: np.ndarray,
    speed: float,
    largest_price: float = np.inf,
) -> np.ndarray:
    """Viterbi: which candidate (T,) at each time makes up the cheapest path.

    Args:
        costs: (T, K) of the candidates, nats.
        places: (T, K, N) of one elbow or of more points, metres.
        times: (T,) seconds.
        speed: of a movement that costs half a nat, metres a second.
        largest_price: of any movement, nats.
    """
    total, came_from = costs[0], np.zeros(costs.shape, np.int32)
    for t in range(1, len(costs)):
        reach = speed * max(times[t] - times[t - 1], 1e-3)
        between = cdist(places[t], places[t - 1], "sqeuclidean")
        via = total + np.minimum(between / (2 * reach**2), largest_price)
        came_from[t] = via.argmin(1)
        total = via.min(1) + costs[t]
    path = np.full(len(costs), total.argmin())
    for t in range(len(costs) - 1, 0, -1):
        path[t - 1] = came_from[t, path[t]]
    return path
