"""``python -m bench.contour_pose``: from how far a rigid object is found by its contour.

Wires and surfaces of random forms, smooth ones and ones with lobes or lumps, lie before one, two
and four cameras. The solve starts turned and shifted by so much in random directions, with the
low-passes of the second paper's Fig. 12 and with all frequencies from the first cycle on. The paper
pairs each ray with a point of the contour; both ways pairs each point with a ray as well. Then a
fifth of all pixels are wrong, or another thing hides a part, with and without rejecting outliers.

INPUTS: none. OUTPUTS: tables of how many starts end at the truth, and Metrics.
"""

import sys
from collections.abc import Callable, Iterator, Sequence
from itertools import product
from typing import Any, NamedTuple

import cv2
import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from bench import command
from bench.figures import Metric, write_json
from jaxmocap.evaluation.tables import align_columns
from jaxmocap.geometry.cameras import Camera, project
from jaxmocap.geometry.fourier import fourier_series, phase_vectors
from jaxmocap.silhouette import (
    ContourPose,
    ContourPoseSettings,
    RigidSurface,
    solve_contour_pose,
)

# Points of a curve and of its outlines, and the curve's root mean square radius, metres.
POINTS, RADIUS_M = 240, 0.15
# At the truth: degrees and metres.
FOUND = 1.0, 0.005
# Curves by the paper's pairs, and curves and surfaces both ways.
ONE_WAY = {
    "one way, whole": ContourPoseSettings(harmonics=(), both_ways=False),
    "one way, low-pass": ContourPoseSettings(both_ways=False),
}
BOTH_WAYS = {
    "both ways, whole": ContourPoseSettings(harmonics=()),
    "both ways, low-pass": ContourPoseSettings(),
}
# With and without rejection by the distance in space.
OUTLIERS = {"all count": ContourPoseSettings(reach=np.inf), "outliers out": ContourPoseSettings()}
# Of an outline: pixels that are anywhere, and a stretch that another thing hides.
WRONG, HIDDEN = 0.2, 0.3
# Height of a surface's lumps, by its radius.
LUMPS = 0.15
PROJECT = jax.jit(project)
# A surface's grid, and pixels by which its true mask is finer than an image.
RINGS, AROUND, FINER = 40, 64, 4


class Trial(NamedTuple):
    """An object before cameras: its shape, outlines (Q, 2), the truth and a start (4, 4)."""

    shape: np.ndarray | RigidSurface
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


def random_surface(rng: np.random.Generator, lumps: float) -> np.ndarray:
    """(V, U, 3) a closed surface: an ellipsoid of three axes with smooth swells and sharper lumps.

    Lumps lie about the five nodes of a wave around and along it, by that share of the radius.
    """
    theta = np.linspace(0, np.pi, RINGS)[:, None]
    phi = 2 * np.pi * np.arange(AROUND) / AROUND
    radii = np.ones((RINGS, AROUND))
    for k in range(1, 4):
        for around in range(k + 1):
            a, b = 0.15 / k * rng.normal(size=2)
            wave = a * np.cos(around * phi) + b * np.sin(around * phi)
            radii += np.sin(theta) ** around * np.cos((k - around) * theta) * wave
    turn = 2 * np.pi * rng.random()
    radii += lumps * np.sin(theta) ** 5 * np.cos(5 * phi + turn) * np.cos(5 * theta)
    unit = np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta) + 0 * phi
    grid = np.stack(unit, -1) * np.maximum(radii, 0.3)[..., None] * [1.0, 0.7, 1.5]
    return grid * RADIUS_M / np.sqrt(np.mean(np.sum(grid**2, -1)))


def drawn_outline(camera: Camera, grid_world: np.ndarray) -> np.ndarray:
    """(Q, 2) pixels along the outline of a surface, drawn triangle by triangle: no rim of ours."""
    flat = np.asarray(PROJECT(camera, jnp.asarray(grid_world.reshape(-1, 3), float)))
    corner = flat.min(0) - 4
    places = np.round((flat - corner) * FINER * 16).reshape(*grid_world.shape[:2], 2).astype(int)
    size = (places.max((0, 1)) // 16 + 4 * FINER).astype(int)
    mask = np.zeros(size[::-1], np.uint8)
    ahead, beside = places[1:], np.roll(places, -1, 1)
    for three in ((places[:-1], beside[:-1], ahead), (beside[:-1], beside[1:], ahead)):
        for triangle in np.stack(three, 2).reshape(-1, 3, 2):
            cv2.fillConvexPoly(mask, triangle.astype(np.int32), 1, shift=4)
    outlines, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    return np.concatenate(outlines)[:, 0] / FINER + corner


def posed_start(
    rng: np.random.Generator, off: tuple[float, float]
) -> tuple[np.ndarray, np.ndarray]:
    """A truth, and a start (4, 4) that is so many degrees and metres off."""
    truth, start = np.eye(4), np.eye(4)
    truth[:3, :3], truth[:3, 3] = Rotation.random(rng=rng).as_matrix(), rng.normal(0, 0.05, 3)
    axis, way = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
    start[:3, :3] = Rotation.from_rotvec(np.radians(off[0]) * axis).as_matrix() @ truth[:3, :3]
    start[:3, 3] = truth[:3, 3] + off[1] * way
    return truth, start


def trial(
    cameras: Sequence[Camera], seed: Sequence[int], lobed: bool, off: tuple[float, float]
) -> Trial:
    """A wire somewhere, started at by so many degrees and metres off."""
    rng = np.random.default_rng(seed)
    descriptors = random_curve(rng, lobed)
    truth, start = posed_start(rng, off)
    phases = 2 * np.pi * np.arange(POINTS) / POINTS
    world = fourier_series(descriptors, phases) @ truth[:3, :3].T + truth[:3, 3]
    outlines = [np.asarray(PROJECT(each, jnp.asarray(world, float))) for each in cameras]
    return Trial(descriptors, [o + rng.normal(0, 0.5, o.shape) for o in outlines], truth, start)


def surface_trial(
    cameras: Sequence[Camera], seed: Sequence[int], lumps: float, off: tuple[float, float]
) -> Trial:
    """A surface somewhere, started at by so many degrees and metres off."""
    rng = np.random.default_rng(seed)
    grid = random_surface(rng, lumps)
    truth, start = posed_start(rng, off)
    world = grid @ truth[:3, :3].T + truth[:3, 3]
    outlines = [drawn_outline(each, world) for each in cameras]
    noisy = [o + rng.normal(0, 0.5, o.shape) for o in outlines]
    return Trial(RigidSurface(grid), noisy, truth, start)


def with_wrong_pixels(each: Trial, seed: int) -> Trial:
    """A fifth of each outline's pixels are anywhere about it."""
    rng, outlines = np.random.default_rng([seed, 1]), []
    for outline in each.outlines:
        low, span = outline.min(0), np.ptp(outline, 0)
        anywhere = low + span * rng.uniform(-0.3, 1.3, outline.shape)
        wrong = rng.random(len(outline)) < WRONG
        outlines.append(np.where(wrong[:, None], anywhere, outline))
    return each._replace(outlines=outlines)


def partly_hidden(each: Trial, seed: int) -> Trial:
    """A straight thing before 30 % of each outline: what shows there is its own edge."""
    rng, outlines = np.random.default_rng([seed, 2]), []
    for outline in each.outlines:
        turn = 2 * np.pi * rng.random()
        across = outline @ [np.cos(turn), np.sin(turn)]
        beyond = across - np.quantile(across, 1 - HIDDEN)
        way = np.maximum(beyond, 0)[:, None] * [np.cos(turn), np.sin(turn)]
        outlines.append(outline - way)
    return each._replace(outlines=outlines)


def errors(cameras: Sequence[Camera], each: Trial, how: ContourPoseSettings) -> tuple[float, float]:
    """Degrees and metres off."""
    return errors_of(solve_contour_pose(each.shape, cameras, each.outlines, each.start, how), each)


def errors_of(found: ContourPose, each: Trial) -> tuple[float, float]:
    """Degrees and metres of a solved trial."""
    turn = found.T_world_object[:3, :3] @ each.truth[:3, :3].T
    shift = found.T_world_object[:3, 3] - each.truth[:3, 3]
    angle = np.degrees(Rotation.from_matrix(turn).magnitude())
    return float(angle), float(np.linalg.norm(shift))


class Row(NamedTuple):
    """Trials of one kind, before the same cameras."""

    name: str
    cameras: Sequence[Camera]
    trials: Sequence[Trial]


def kinds(lobed: bool) -> tuple[tuple[str, Callable[..., Trial], Any], ...]:
    """Wires and surfaces: a name, what makes a trial, and its argument."""
    wire = ("wire, " + ("lobed" if lobed else "smooth"), trial, lobed)
    return wire, ("surface, " + ("lumpy" if lobed else "smooth"), surface_trial, LUMPS * lobed)


def start_rows(
    count: int, numbers: Sequence[int], offs: Sequence[tuple[float, float]], which: int
) -> Iterator[Row]:
    """Of wires (0) or surfaces (1): exact but for noise, by numbers of cameras and starts."""
    for lobed, number, off in product((False, True), numbers, offs):
        cameras = [camera_at(0.8 * k) for k in range(number)]
        form, make, how = kinds(lobed)[which]
        name = f"{form}, {number} cameras, {off[0]:g} deg {100 * off[1]:g} cm"
        yield Row(name, cameras, [make(cameras, (seed, number), how, off) for seed in range(count)])


def outlier_rows(count: int, off: tuple[float, float]) -> Iterator[Row]:
    """Of wires and surfaces before two cameras, with pixels that are not the object's."""
    cameras = [camera_at(0.8 * k) for k in range(2)]
    for form, make, how in (*kinds(False), *kinds(True)):
        exact = [make(cameras, (seed, 2), how, off) for seed in range(count)]
        for name, spoiled in (("wrong", with_wrong_pixels), ("hidden", partly_hidden)):
            trials = [spoiled(each, seed) for seed, each in enumerate(exact)]
            yield Row(f"{form}, {name}", cameras, trials)


def found_share(off: Sequence[tuple[float, float]]) -> float:
    """Of errors, per cent at the truth."""
    return 100 * float(np.mean(np.all(np.array(off) < FOUND, 1)))


def measured(title: str, rows: Iterator[Row], ways: dict[str, ContourPoseSettings]) -> list[Metric]:
    """Print a table of how many are found, and by how much those of the last way are off."""
    cells, metrics = [[title, *ways, "then off"]], []
    for name, cameras, trials in rows:
        each = [[errors(cameras, one, how) for one in trials] for how in ways.values()]
        last = np.array(each[-1])
        near = np.median(last[np.all(last < FOUND, 1)], 0)
        shares = [found_share(off) for off in each]
        cells.append(
            [name, *(f"{s:.0f}" for s in shares), f"{near[0]:.2f} deg {1e3 * near[1]:.1f} mm"]
        )
        print(align_columns(cells[-1:]), file=sys.stderr, flush=True)
        metrics += [
            Metric(f"contour pose {name}, {way}", share, "%", direction="higher")
            for way, share in zip(ways, shares, strict=True)
        ]
    print(align_columns(cells), end="\n\n", flush=True)
    return metrics


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure, print."""
    parser = command("bench.contour_pose", __doc__)
    parser.add_argument("--count", type=int, default=50, help="starts a row; default: %(default)s")
    parts = ("wires", "surfaces", "outliers")
    parser.add_argument("--only", choices=parts, help="one table of the three")
    options = parser.parse_args(arguments)
    offs, numbers, n = ((30.0, 0.05), (60.0, 0.1)), (1, 2, 4), options.count
    tables = {
        "wires": (start_rows(n, numbers, offs, 0), ONE_WAY | BOTH_WAYS),
        "surfaces": (start_rows(n, numbers, offs, 1), BOTH_WAYS),
        "outliers": (outlier_rows(n, offs[0]), OUTLIERS),
    }
    metrics = []
    for part in (options.only,) if options.only else parts:
        metrics += measured("found, %", *tables[part])
    write_json(metrics, options.json)


if __name__ == "__main__":
    main()
