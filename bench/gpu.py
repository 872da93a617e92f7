"""``python -m bench.gpu [--part NAME] [--json FILE]``: the same code on an accelerator and the CPU.

Nothing in the package asks what it runs on. Both devices are measured in one run, and what they
find is held against each other, as a share of the largest number in each array, and joints
against float64.

    kinematics   poses in a batch -> joints
    solve        markers of recordings side by side, all events in one scan
    refine       the same with images
    rasters      silhouettes' Gauss-Newton terms, the body drawn on 64 x 64 cells

INPUTS: what JAX finds. OUTPUTS: one table, and Metrics.
"""

import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from bench import command
from bench.clips import Footage, film
from bench.clock import interleaved, timed
from bench.figures import Metric, table, write_json
from bench.rivals import random_poses
from jaxmocap.body.kinematics import forward
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.evidence.silhouettes import LegGrid, SilhouetteGrids
from jaxmocap.hybrid.observe import edge_fields
from jaxmocap.hybrid.settings import Settings
from jaxmocap.hybrid.step import EventFields, RefineInputs, refine_events, solve_events
from jaxmocap.hybrid.tracker import HybridTracker, Images, State
from jaxmocap.images.regions import Region
from jaxmocap.images.silhouette_grid import Grid
from jaxmocap.pipelines.kept_programs import keep_compiled
from jaxmocap.reference import kinematics as reference
from jaxmocap.smoothing.linearise import views_fit

# Poses, recordings and pictures at a time; events of a recording, every third with a frame.
BATCHES, EVENTS = (1, 64, 4096), 24
# Calls of each; a single one where all devices together take longer than so many milliseconds.
ROUNDS, LONG_MS = 5, 2000
# Of the markers.
RATE_HZ = 90
# Poses whose joints are checked one by one against float64.
CHECKED = 64

# What to run on a device, by the size of a batch; the arguments there.
Work = tuple[Callable[..., Any], tuple[Any, ...]]


def measure(footage: Footage, most: int, part: str = "") -> Iterator[Metric]:
    """All parts whose names begin so, on the CPU and, if there is one, on the accelerator."""
    sizes = [size for size in BATCHES if size <= most]
    for name, work in parts(footage, sizes):
        if not name.startswith(part):
            continue
        devices = {"cpu": jax.devices("cpu")[0]}
        if jax.default_backend() != "cpu":
            devices[jax.default_backend()] = jax.devices()[0]
        yield from compared(name, work, devices)
    yield from against_float64()


def parts(footage: Footage, sizes: Sequence[int]) -> Iterator[tuple[str, Work]]:
    """Everything that is measured."""
    skeleton = Skeleton.human(1.75)
    for size in sizes:
        yield f"kinematics of {size} poses", kinematics(skeleton, size)
    tracker = HybridTracker.from_recording(footage.recording, Settings(smooth=False))
    for size in sizes:
        yield f"solve, {size} recordings of {EVENTS} events", solving(tracker, footage, size)
    for size in sizes:
        yield f"refine, {size} recordings of {EVENTS} events", refining(tracker, footage, size)
    for size in sizes:
        yield f"rasters of {size} bodies", rasters(tracker, footage, size)


def kinematics(skeleton: Skeleton, size: int) -> Work:
    """Joints of a batch of poses."""
    batched = jax.vmap(lambda body, pose: forward(body, pose).joints_world, (None, 0))
    return batched, (skeleton, random_poses(skeleton, size))


def solving(tracker: HybridTracker, footage: Footage, size: int) -> Work:
    """Markers of all events to poses, of recordings side by side."""
    state, markers, _ = _clip(tracker, footage)
    many = np.broadcast_to(markers, (size, *markers.shape))
    # No two alike: some millimetres apart.
    moved = many + np.random.default_rng(0).normal(0, 0.003, (size, 1, 1, 3)).astype(many.dtype)
    over = jax.vmap(solve_events, (None, None, None, 0))
    call = lambda *given: over(*given)[1].ik.pose  # noqa: E731
    return call, (tracker.model, tracker.settings, (state.pose, state.feet), moved)


def refining(tracker: HybridTracker, footage: Footage, size: int) -> Work:
    """Markers' poses and images of all events to refined poses; the images are the same for all."""
    state, markers, images = _clip(tracker, footage)
    model, settings = tracker.model, tracker.settings
    _, solved = jax.jit(solve_events)(model, settings, (state.pose, state.feet), markers)
    fields = _fields(tracker, state, images, jax.tree.map(np.asarray, solved.region))
    elapsed = np.full(EVENTS, 1 / RATE_HZ, markers.dtype)
    elapsed[0] = 0.0
    many = np.broadcast_to(markers, (size, *markers.shape))

    def refined(model, settings, bow_factors, events, markers, belief):
        return refine_events(model, settings, bow_factors, events._replace(markers=markers), belief)

    over = jax.vmap(refined, (None, None, None, None, 0, None))
    call = lambda *given: over(*given)[1]  # noqa: E731
    events = RefineInputs(solved, markers, fields, elapsed)
    return call, (model, settings, tracker.bow_factors, events, many, state.belief)


def rasters(tracker: HybridTracker, footage: Footage, size: int) -> Work:
    """One body drawn over pictures of noise, in so many poses."""
    model, state = tracker.model, tracker.init(footage.recording.positions_world[0])
    rng = np.random.default_rng(0)

    def grid(cells: int) -> Grid:
        noise = rng.uniform(size=(1, cells, cells)).astype(np.float32)
        return Grid(np.repeat(noise, size, 0), np.ones((size, cells, cells), np.float32))

    def region(x: float, y: float, scale: float) -> Region:
        corner = np.tile(np.array([x, y], np.float32), (size, 1))
        return Region(corner, np.full(size, scale, np.float32))

    upper, lower = region(180, 60, 4.0), region(180, 240, 6.0)
    per_metre = np.full(size, 250, np.float32)
    grids = SilhouetteGrids(upper, grid(64), grid(64), per_metre, LegGrid(lower, grid(32)))
    repeated = lambda part: np.repeat(np.asarray(part)[None], size, 0)  # noqa: E731
    poses = jax.tree.map(repeated, state.pose)
    cameras = jax.tree.map(repeated, model.camera(0))
    softness, usual = jnp.asarray(1.5, jnp.float32), jnp.zeros(2, jnp.float32)
    return views_fit, (model.skeleton, usual, softness, poses, cameras, grids)


def _clip(
    tracker: HybridTracker, footage: Footage
) -> tuple[State, np.ndarray, Sequence[Images | None]]:
    """The state before the first samples, their markers, and an image for every third."""
    markers = np.asarray(footage.recording.positions_world[:EVENTS], tracker.model.dtype)
    images = [[footage.images[i // 3]] if i % 3 == 0 else None for i in range(EVENTS)]
    return tracker.init(markers[0]), markers, images


def _fields(
    tracker: HybridTracker, state: State, images: Sequence[Images | None], regions: Region
) -> EventFields:
    """Distances to the edges of the images in their regions."""
    settings, thresholds, each = tracker.settings, state.thresholds, []
    for event, frames in enumerate(images):
        region = jax.tree.map(lambda part, e=event: part[e], regions)
        fields, thresholds = edge_fields(settings, thresholds, frames, region)
        each.append(None if frames is None else fields)
    first = jax.tree.map(lambda part: part[0], regions)
    nothing, _ = edge_fields(settings, thresholds, None, first)
    return EventFields.of(nothing, each)


def compared(name: str, work: Work, devices: dict[str, Any]) -> Iterator[Metric]:
    """The same call on each device, in turn: milliseconds, their ratio, and how far they differ.

    The first call of each is apart: it traces and compiles, or reads what an earlier run has kept.
    """
    call, arguments = work
    jitted, ways, results, long = jax.jit(call), {}, {}, 0.0
    for device, where in devices.items():
        there = jax.device_put(arguments, where)
        ways[device] = lambda given=there: jitted(*given)
        first, _ = timed(ways[device])
        yield Metric(f"{name}, {device}, first call", first.wall / 1e3, "s")
        second, result = timed(ways[device])
        long, results[device] = long + second.wall, jax.device_get(result)
    spans = interleaved(ways, 1 if long > LONG_MS else ROUNDS, warm=0)
    for device, times in spans.items():
        yield Metric(f"{name}, {device}", float(np.median(times[:, 0])), "ms")
    for device in list(devices)[1:]:
        own, cpu = (float(np.median(spans[d][:, 0])) for d in (device, "cpu"))
        yield Metric(f"{name}, cpu over {device}", cpu / own, "x", "higher")
        most = max(jax.tree.leaves(jax.tree.map(farthest, *results.values())))
        yield Metric(f"{name}, {device} from cpu at most", most, "of the largest")


def farthest(one: np.ndarray, other: np.ndarray) -> float:
    """The largest difference between two arrays, as a share of the largest number in them."""
    largest = max(np.nanmax(np.abs(other.astype(float)), initial=0.0), np.finfo(np.float32).tiny)
    apart = np.abs(np.subtract(one, other, dtype=float))
    return float(np.nanmax(apart, initial=0.0) / largest)


def against_float64() -> Iterator[Metric]:
    """Joints of random poses by the default device against NumPy's float64."""
    skeleton = Skeleton.human(1.75)
    poses = random_poses(skeleton, CHECKED)
    call, arguments = kinematics(skeleton, CHECKED)
    actual = np.asarray(jax.jit(call)(*arguments))
    body = jax.tree.map(np.asarray, skeleton)
    each = (Pose._make(np.asarray(p, float) for p in pose) for pose in zip(*poses, strict=True))
    expected = np.stack([reference.forward(body, pose).joints_world for pose in each])
    apart = 1e6 * float(np.abs(actual - expected).max())
    yield Metric(f"joints from float64 at most, {jax.default_backend()}", apart, "µm")


def main() -> None:
    parser = command("bench.gpu", __doc__)
    parser.add_argument("--most", type=int, default=BATCHES[-1], help="the largest batch")
    parser.add_argument("--part", default="", help="kinematics, solve, refine or rasters alone")
    options = parser.parse_args()
    keep_compiled()
    device = jax.devices()[0]
    print(f"{device.platform}: {device.device_kind}", flush=True)
    if device.platform == "cpu":
        print("JAX finds no accelerator here: the CPU alone", flush=True)
    with tempfile.TemporaryDirectory() as folder:
        metrics = []
        for metric in measure(film(Path(folder), 1.0), options.most, options.part):
            print(f"{metric.name}: {metric.value:.4g} {metric.unit}", flush=True)
            metrics.append(metric)
    print(table(metrics))
    write_json(metrics, options.json)


if __name__ == "__main__":
    main()
