"""``python -m bench.paper_times``: the times that both papers state, beside ours.

The balance of a squat (first paper, 5.3), the pose of 100 points on rays, from 20 degrees and 5 cm
off (second paper, 3.1.3), and the pose of a free-form contour and of a surface (3.1.4, 3.1.5), of
which the paper says 10 iterations: here as many as it takes from 30 degrees and 5 cm off, and ten
alone. All programs are compiled before. For one core: ``taskset -c 0 python -m bench.paper_times``.

INPUTS: none. OUTPUTS: a table of medians, and Metrics.
"""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from bench import command
from bench.clock import interleaved
from bench.contour_pose import camera_at, surface_trial, trial
from bench.figures import aligned, stage_metrics, write_json
from jaxmocap.body.kinematics import forward
from jaxmocap.body.pose import relaxed_pose, retract
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.body.surfaces.surface import BodyPoints, posed
from jaxmocap.geometry.cameras import project
from jaxmocap.hybrid.balance import bow_factors, bow_on_feet
from jaxmocap.hybrid.settings import IKSettings
from jaxmocap.silhouette import ContourPoseSettings, solve_contour_pose
from jaxmocap.silhouette.points import PointRays, contour_rays
from jaxmocap.silhouette.pose import PoseSettings, solve_pose

POINTS = 100
# Degrees and metres by which a contour's start is off.
OFF = 30.0, 0.05
# All that a contour needs; and one cycle and three times three, ten: the paper's number.
WAYS = {
    "": ContourPoseSettings(),
    ", 10 cycles": ContourPoseSettings(harmonics=(8,), low_cycles=1, cycles=3, rest=0.0),
}


def balance() -> Callable[[], Any]:
    """The bow of a squat."""
    skeleton, settings = Skeleton.human(), IKSettings()
    pose = relaxed_pose(skeleton)
    squat = pose._replace(position=pose.position.at[2].set(0.6))
    return partial(jax.jit(bow_on_feet), skeleton, settings, squat, bow_factors(skeleton, settings))


def points_on_rays() -> Callable[[], Any]:
    """A rigid body of points before one camera, until it rests."""
    skeleton, rng = Skeleton.human(), np.random.default_rng(0)
    places = rng.normal(0, 0.15, (POINTS, 1, 3)).astype(np.float32)
    one = np.ones((POINTS, 1), np.float32)
    points, truth = BodyPoints(np.zeros((POINTS, 1), np.int32), places, one), relaxed_pose(skeleton)
    camera = camera_at(0.0)
    pixels = project(camera, posed(forward(skeleton, truth), points))
    lines, across = contour_rays(camera, pixels, jnp.tile(jnp.asarray([1.0, 0.0]), (POINTS, 1)))
    pairs = PointRays(points, lines, across, jnp.ones(POINTS), jnp.ones(POINTS))
    free = jnp.arange(len(skeleton.costs)) < 6
    step = jnp.zeros(len(free)).at[:6].set(jnp.asarray([0.03, 0.03, -0.03, 0.2, -0.2, 0.2]))
    solve = jax.jit(lambda start: solve_pose(skeleton, start, pairs, PoseSettings(), free=free))
    return partial(solve, retract(truth, step))


def contours(number: int) -> Iterator[tuple[str, Callable[[], Any]]]:
    """Of a wire and of a surface before so many cameras."""
    cameras = [camera_at(0.8 * k) for k in range(number)]
    for form, make in (("contour", trial), ("surface", surface_trial)):
        each = make(cameras, (1, number), False, OFF)
        solve = partial(solve_contour_pose, each.shape, cameras, each.outlines, each.start)
        for way, settings in WAYS.items():
            yield f"{form}, {number} cameras{way}", partial(solve, settings)


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure, print."""
    parser = command("bench.paper_times", __doc__)
    parser.add_argument("--rounds", type=int, default=50, help="of each; default: %(default)s")
    options = parser.parse_args(arguments)
    functions = {"balance": balance(), f"{POINTS} points": points_on_rays()}
    functions |= {name: each for number in (1, 2) for name, each in contours(number)}
    paper = {"balance": "< 1", f"{POINTS} points": "2", "contour, 1 cameras, 10 cycles": "40"}
    cells, metrics = [["ms", "paper", "ours, median", "processor", "99 %"]], []
    for name, spans in interleaved(functions, options.rounds).items():
        (wall, busy), late = np.median(spans, 0), np.percentile(spans[:, 0], 99)
        figures = (f"{value:.2f}" for value in (wall, busy, late))
        cells.append([name, paper.get(name, ""), *figures])
        metrics += stage_metrics(f"paper's times, {name}", spans[:, 0])
    print(aligned(cells))
    write_json(metrics, options.json)


if __name__ == "__main__":
    main()
