"""``python -m bench.raised_skin RECORDINGS``: the skin of raised arms, with and without swelling.

People of the independent mesh raise their arms to 150 degrees. A generic body of their bones takes
the pose of their landmarks; how far its trunk's skin is off theirs between waist and neck, along
its normals, less how far it is off with hanging arms, is what a swelling should take away. That of
``data/shoulder.toml`` was fitted so to the man, who is not among those that count.

INPUTS: the folder of recordings, with ``person/person.npz`` in it. OUTPUTS: a table, and Metrics.
"""

from collections.abc import Sequence
from pathlib import Path

import jax
import numpy as np
from scipy.spatial import KDTree

from bench import command
from bench.figures import Metric, aligned, write_json
from jaxmocap.body.kinematics import forward
from jaxmocap.body.skeleton import LANDMARKS, Skeleton, with_joints
from jaxmocap.body.subject import scale_to_landmarks
from jaxmocap.body.surfaces.loft import generic_surface, rest_joints
from jaxmocap.body.surfaces.morphing import shoulders
from jaxmocap.body.surfaces.surface import posed, rest_nodes
from jaxmocap.silhouette.first_pose import pose_at_landmarks
from jaxmocap.silhouette.settings import Settings
from jaxmocap.silhouette.surfaces.morph import driver_values, moved_points
from jaxmocap.silhouette.surfaces.swelling import grid_normals, morph_around, patch_coordinates
from jaxmocap.synthetic.movements.exercises import exercise
from jaxmocap.synthetic.people.rigged_mesh import load_rig
from jaxmocap.synthetic.people.shoulder_girdle import Girdle

PEOPLE = ("woman", "broad_man", "tall_man", "slim_woman", "short_woman")
SECONDS, FRAMES = 3.0, 30
# Of the trunk's patch, shares of the way along it.
BETWEEN = (0.4, 0.8)
# Drivers of hanging and of raised arms.
HANGING, RAISED = 0.05, 0.3
# Nearest points of the mesh face as the skin does, to this cosine, and lie within so many metres.
LEAST_COSINE, FARTHEST_M = 0.6, 0.06
# Metres that a unit between normals is worth.
NORMAL_M = 0.05
FORWARD, POSED, MOVED = jax.jit(forward), jax.jit(posed), jax.jit(moved_points)


def offsets(nodes: np.ndarray, normals: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """(N,) metres from nodes to a mesh's faces (F, 4, 3) along normals; NaN where none is near."""
    u, v = (a.ravel()[:, None, None] for a in np.meshgrid(*[np.linspace(0.17, 0.83, 3)] * 2))
    a, b, c, d = np.moveaxis(corners, 1, 0)
    points = ((1 - u) * ((1 - v) * a + v * d) + u * ((1 - v) * b + v * c)).reshape(-1, 3)
    ways = np.cross(c - a, d - b)
    ways /= np.linalg.norm(ways, axis=1, keepdims=True) + 1e-12
    ways = np.tile(ways, (len(u), 1))
    tree = KDTree(np.concatenate([points, NORMAL_M * ways], 1))
    near = tree.query(np.concatenate([nodes, NORMAL_M * normals], 1))[1]
    way = points[near] - nodes
    alike = np.sum(ways[near] * normals, 1) > LEAST_COSINE
    close = np.linalg.norm(way, axis=1) < FARTHEST_M
    return np.where(alike & close, np.sum(way * normals, 1), np.nan)


def errors(people: Path, who: str, seed: int) -> tuple[float, float]:
    """Root mean square with raised arms, without and with what swells, metres."""
    performer = exercise(load_rig(people, who, seed), "overhead", SECONDS, seed, Girdle())
    times = np.linspace(0, SECONDS, FRAMES)
    vertices, landmarks = performer.vertices(times), performer.landmarks(times)
    standing = {name: path[:1] for name, path in landmarks.items()}
    skeleton = with_joints(scale_to_landmarks(Skeleton.human(), standing), Settings.body)
    surface, joints = generic_surface(skeleton), rest_joints(skeleton)
    patch = next(each for each in surface.patches if each.name == "torso")
    along = patch_coordinates(patch, patch.grid(rest_nodes(surface, joints)))[:, 1]
    kept = (along > BETWEEN[0]) & (along < BETWEEN[1])
    morph = morph_around(shoulders(), skeleton.tree, surface, joints)
    missing, rows, drivers = np.full((FRAMES, 3), np.nan), [], []
    marks = np.stack([landmarks.get(name, missing) for name in LANDMARKS], 1)
    for points, mesh in zip(marks, vertices, strict=True):
        pose = pose_at_landmarks(skeleton, points)
        values, frames = driver_values(morph, pose.angles), FORWARD(skeleton, pose)
        drivers.append(float(np.min(values)))
        for worn in (surface.points, MOVED(surface.points, morph.moves, values)):
            nodes = np.asarray(POSED(frames, worn), float)
            normals = grid_normals(patch.grid(nodes)).reshape(-1, 3)[kept]
            corners = mesh[performer.mesh.faces]
            rows.append(offsets(nodes[patch.nodes][kept], normals, corners))
    off = np.reshape(rows, (FRAMES, 2, -1))
    lifted = np.array(drivers)
    rest = np.nanmean(off[lifted < HANGING], 0)
    both = np.sqrt(np.nanmean((off[lifted > RAISED] - rest) ** 2, (0, 2)))
    return float(both[0]), float(both[1])


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure, print."""
    parser = command("bench.raised_skin", __doc__)
    parser.add_argument("recordings", metavar="RECORDINGS")
    parser.add_argument("--people", default=",".join(PEOPLE), help="default: %(default)s")
    parser.add_argument("--seed", type=int, default=3, help="of the movement")
    options = parser.parse_args(arguments)
    people = Path(options.recordings) / "person" / "person.npz"
    results = {who: errors(people, who, options.seed) for who in options.people.split(",")}
    results["mean"] = tuple(np.mean(list(results.values()), 0))
    cells = [[who, *(f"{1000 * value:.1f}" for value in pair)] for who, pair in results.items()]
    print(aligned([["trunk's skin, mm off", "off", "on"], *cells]))
    pairs = zip(("off", "on"), results["mean"], strict=True)
    write_json(
        [Metric(f"raised skin {state}", 1000 * value, "mm") for state, value in pairs],
        options.json,
    )


if __name__ == "__main__":
    main()
