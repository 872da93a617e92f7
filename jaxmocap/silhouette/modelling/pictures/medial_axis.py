"""The skeleton of a silhouette: its medial axis by the chamfer distance transform, made connected.

A pixel is on the axis where the distance to the rim has no clear direction in which it grows. Such
pixels come in pieces, which are then joined, each by the shortest gap to another (second paper,
2.1, Fig. 2).

INPUTS: masks (H, W) bool.
OUTPUTS: distances; a Skeleton: pixels, and the edges between them.
"""

from itertools import combinations
from typing import NamedTuple

import cv2
import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components, dijkstra, minimum_spanning_tree
from scipy.spatial import KDTree

# Across the axis distances grow by less than so much for each pixel.
RIDGE = 0.82
# Narrower than twice this nothing has an axis, pixels.
LEAST_PX = 1.5
# Pieces of fewer pixels are the rim's roughness.
SMALLEST = 4


class MedialAxis(NamedTuple):
    """N pixels of an axis, all of them connected."""

    pixels_xy: np.ndarray  # (N, 2) whole numbers
    radii: np.ndarray  # (N,) distance to the rim, pixels
    edges: csr_array  # (N, N) sparse, both ways: steps between neighbours, and closed gaps, pixels


def rim_distance(mask: np.ndarray, goes_on_below: bool = True) -> np.ndarray:
    """(H, W) float32, pixels to the rim, by the 5 x 5 chamfer mask; beyond the image is nobody.

    But below, where a person goes on.
    """
    padded = np.pad(mask.astype(np.uint8), 1)
    if goes_on_below:
        padded[-1] = padded[-2]
    return cv2.distanceTransform(padded, cv2.DIST_L2, 5)[1:-1, 1:-1]


def medial_axis(mask: np.ndarray) -> MedialAxis:
    """The closed skeleton of a silhouette."""
    distance = rim_distance(mask)
    smooth = cv2.GaussianBlur(distance, (0, 0), 0.8)
    slope = np.hypot(cv2.Sobel(smooth, cv2.CV_32F, 1, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 1)) / 8
    ridge = ((slope < RIDGE) & (distance > LEAST_PX)).astype(np.uint8)
    _, pieces, stats, _ = cv2.connectedComponentsWithStats(ridge)
    areas = np.asarray(stats)[:, cv2.CC_STAT_AREA]
    ridge[areas[np.asarray(pieces, int)] < SMALLEST] = 0
    rows, columns = np.nonzero(ridge)
    pixels = np.stack([columns, rows], 1)
    return MedialAxis(pixels, distance[rows, columns], close_gaps(pixels))


def close_gaps(pixels_xy: np.ndarray) -> csr_array:
    """(N, N) steps between neighbours of (N, 2) pixels, and the gaps that connect all, pixels.

    Of all gaps between two pieces' nearest pixels, those of the shortest tree.
    """
    steps = KDTree(pixels_xy).query_pairs(1.5, output_type="ndarray")
    count, piece = connected_components(_both_ways(pixels_xy, steps), directed=False)
    members = [np.flatnonzero(piece == k) for k in range(count)]
    trees = [KDTree(pixels_xy[mine]) for mine in members]
    gaps, links = np.zeros((count, count)), {}
    for a, b in combinations(range(len(trees)), 2):
        far, near = map(np.asarray, trees[b].query(pixels_xy[members[a]]))
        best = int(np.argmin(far))
        gaps[a, b], links[a, b] = far[best], (members[a][best], members[b][near[best]])
    chosen = np.sort(np.stack(minimum_spanning_tree(csr_array(gaps)).nonzero(), 1), 1)
    bridges = [links[a, b] for a, b in chosen.tolist()]
    return _both_ways(pixels_xy, np.concatenate([steps, np.array(bridges, int).reshape(-1, 2)]))


def _both_ways(pixels_xy: np.ndarray, pairs: np.ndarray) -> csr_array:
    a, b = pairs.T
    lengths = np.linalg.norm(pixels_xy[a] - pixels_xy[b], axis=1)
    size = len(pixels_xy)
    rows, columns = np.concatenate([a, b]), np.concatenate([b, a])
    return csr_array((np.tile(lengths, 2), (rows, columns)), shape=(size, size))


def path(axis: MedialAxis, start_xy: np.ndarray, end_xy: np.ndarray) -> np.ndarray:
    """(K,) indices of the skeleton's pixels from the one nearest a place to that nearest another.

    The way keeps to the middle: a step costs the more the narrower the silhouette is there.
    """
    tree = KDTree(axis.pixels_xy)
    start, end = (int(tree.query(place)[1]) for place in (start_xy, end_xy))
    rows, columns = axis.edges.nonzero()
    narrow = 1 / np.maximum(np.minimum(axis.radii[rows], axis.radii[columns]), 1.0)
    weighted = csr_array((axis.edges.data * narrow, (rows, columns)), shape=axis.edges.shape)
    _, before = dijkstra(weighted, indices=start, return_predecessors=True)
    way = [end]
    while way[-1] != start:
        way.append(int(before[way[-1]]))
    return np.array(way[::-1])
