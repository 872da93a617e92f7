"""``python -m bench.contour_pose``: from how far a rigid object is found by its contour.

Closed curves of random forms, smooth ones and ones with seven lobes, lie before one, two and four
cameras. The solve starts turned and shifted by so much in random directions, with the low-pass
curves of the second paper's Fig. 12 and with the whole curve from the first cycle on. The paper
pairs each ray with a point of the curve; both ways pairs each point with a ray as well.

INPUTS: none. OUTPUTS: a table of how many starts end at the truth, and Metrics.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from bench.command_line import command
from bench.metrics import Metric, aligned, write_json
from jaxmocap.geometry.cameras import Camera, project
from jaxmocap.geometry.fourier import fourier_series, phase_vectors
from jaxmocap.silhouette import ContourPoseSettings, solve_contour_pose

# Points of a curve and of its outlines, and the curve's root mean square radius, metres.
POINTS, RADIUS_M = 240, 0.15
# At the truth: degrees and metres.
FOUND = 1.0, 0.005
WAYS = {
    "one way, whole": ContourPoseSettings(harmonics=(), both_ways=False),
    "one way, low-pass": ContourPoseSettings(both_ways=False),
    "both ways, whole": ContourPoseSettings(harmonics=()),
    "both ways, low-pass": ContourPoseSettings(),
}


class Trial(NamedTuple):
    """An object before cameras: descriptors, outlines (Q, 2), the truth and a start (4, 4)."""

    descriptors: np.ndarray
    outlines: list[np.ndarray]
    truth: np.ndarray
    start: np.ndarray


def camera_at(azimuth: float) -> Camera:
    """640 x 480, 1.5 m from the origin, somewhat above it."""
    centre = 1.5 * np.array([np.cos(azimuth), np.sin(azimuth), 0.3])
    z = -centre / np.linalg.norm(centre)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    R = np.stack([x, np.cross(z, x), z])
    return Camera.create((640, 480), [[900, 0, 320], [0, 900, 240], [0, 0, 1]], (), R, -R @ centre)  # type: ignore[arg-type]


def random_curve(rng: np.random.Generator, lobed: bool) -> np.ndarray:
    """(N + 1, 3) phase vectors of a flat-ish closed curve: amplitudes fall as k^-1.5."""
    k = np.arange(1, 13)
    vectors = np.zeros((13, 3), complex)
    vectors[1:] = rng.normal(size=(12, 3)) + 1j * rng.normal(size=(12, 3))
    vectors[1:] *= (k**-1.5 * (0.4 if lobed else 1.0))[:, None]
    vectors[:, 2] *= 0.4
    vectors[1] = [1.0, -0.8j, vectors[1, 2]]
    if lobed:
        # A wave of seven periods on the radius.
        vectors[6] += [0.12, 0.12j, 0]
        vectors[8] += [0.12, -0.12j, 0]
    points = fourier_series(vectors, 2 * np.pi * np.arange(POINTS) / POINTS)
    points *= RADIUS_M / np.sqrt(np.mean(np.sum(points**2, 1)))
    return phase_vectors(points)


def trial(
    cameras: Sequence[Camera], seed: Sequence[int], lobed: bool, off: tuple[float, float]
) -> Trial:
    """An object somewhere, started at by so many degrees and metres off."""
    rng = np.random.default_rng(seed)
    descriptors, truth, start = random_curve(rng, lobed), np.eye(4), np.eye(4)
    truth[:3, :3], truth[:3, 3] = Rotation.random(rng=rng).as_matrix(), rng.normal(0, 0.05, 3)
    axis, way = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
    start[:3, :3] = Rotation.from_rotvec(np.radians(off[0]) * axis).as_matrix() @ truth[:3, :3]
    start[:3, 3] = truth[:3, 3] + off[1] * way
    phases = 2 * np.pi * np.arange(POINTS) / POINTS
    world = fourier_series(descriptors, phases) @ truth[:3, :3].T + truth[:3, 3]
    outlines = [np.asarray(project(each, jnp.asarray(world, float))) for each in cameras]
    return Trial(descriptors, [o + rng.normal(0, 0.5, o.shape) for o in outlines], truth, start)


def errors(cameras: Sequence[Camera], each: Trial, how: ContourPoseSettings) -> tuple[float, float]:
    """Degrees and metres off."""
    found = solve_contour_pose(each.descriptors, cameras, each.outlines, each.start, how)
    turn = found.T_world_object[:3, :3] @ each.truth[:3, :3].T
    shift = found.T_world_object[:3, 3] - each.truth[:3, 3]
    angle = np.degrees(Rotation.from_matrix(turn).magnitude())
    return float(angle), float(np.linalg.norm(shift))


def measured(
    count: int, numbers: Sequence[int], offs: Sequence[tuple[float, float]]
) -> Iterator[tuple[str, dict[str, list[tuple[float, float]]]]]:
    """Row by row, way by way the errors of ``count`` trials."""
    for lobed in (False, True):
        for number in numbers:
            cameras = [camera_at(0.8 * k) for k in range(number)]
            for off in offs:
                trials = [trial(cameras, (seed, number), lobed, off) for seed in range(count)]
                form = "lobed" if lobed else "smooth"
                name = f"{form}, {number} cameras, {off[0]:g} deg {100 * off[1]:g} cm"
                yield (
                    name,
                    {
                        way: [errors(cameras, each, how) for each in trials]
                        for way, how in WAYS.items()
                    },
                )


def found_share(off: Sequence[tuple[float, float]]) -> float:
    """Of errors, per cent at the truth."""
    return 100 * float(np.mean(np.all(np.array(off) < FOUND, 1)))


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure, print."""
    parser = command("bench.contour_pose", __doc__)
    parser.add_argument("--count", type=int, default=50, help="starts a row; default: %(default)s")
    parser.add_argument("--json", metavar="FILE", help="write the metrics")
    options = parser.parse_args(arguments)
    offs = ((30.0, 0.05), (60.0, 0.1))
    cells, metrics = [["found, %", *WAYS, "then off"]], []
    for name, ways in measured(options.count, (1, 2, 4), offs):
        best = np.array(ways["both ways, low-pass"])
        near = np.median(best[np.all(best < FOUND, 1)], 0)
        shares = [f"{found_share(off):.0f}" for off in ways.values()]
        cells.append([name, *shares, f"{near[0]:.2f} deg {1000 * near[1]:.1f} mm"])
        print(aligned(cells[-1:]), flush=True)
        metrics += [
            Metric(f"contour pose {name}, {way}", found_share(off), "%", direction="higher")
            for way, off in ways.items()
        ]
    print(aligned(cells))
    if options.json:
        write_json(metrics, options.json)


if __name__ == "__main__":
    main()
