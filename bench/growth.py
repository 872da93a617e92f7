"""How time grows with what there is more of, and that memory does not grow with the frames.

INPUTS: a clip. OUTPUTS: Metrics.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from bench.clips import Footage
from bench.clock import Stopwatch, interleaved, peak_mib
from bench.figures import Metric
from jaxmocap.body.kinematics import forward, jacobian
from jaxmocap.body.model import marker_sites
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.body.tree import Tree
from jaxmocap.geometry.cameras import Camera
from jaxmocap.hybrid.settings import Settings
from jaxmocap.hybrid.step import solve_event
from jaxmocap.hybrid.tracker import HybridTracker
from jaxmocap.solvers.sdls import sdls_step

REGIONS, CAMERAS = (96, 160, 224), (1, 2, 4)
HINGES, RECORDINGS = (10, 20, 40, 80), (1, 4, 16, 64)
ROUNDS = 40
# Samples of the long run, one in three with a frame, and how many of them may still warm up.
SAMPLES, WARMING = 6000, 1500


def measure(footage: Footage, samples: int = SAMPLES) -> Iterator[Metric]:
    """Everything; the long run goes on for so many samples."""
    yield from by_region(footage)
    yield from by_cameras(footage)
    yield from by_hinges()
    yield from by_recordings(footage)
    yield from by_frames(footage, samples)


def a_step(tracker: HybridTracker, footage: Footage) -> Callable[[], object]:
    """One step with a frame of every camera, from the state after the first sample."""
    markers = footage.recording.positions_world
    state = tracker.init(markers[0])
    images = [footage.images[0]] * tracker.model.camera_count
    return lambda: tracker.step(state, 0.01, markers[1], images)


def a_tracker(footage: Footage, settings: Settings, cameras: int = 1) -> HybridTracker:
    """Of the footage's person, watched by so many cameras."""
    recording = footage.recording
    sites = marker_sites(recording.skeleton, recording.places)
    watching: list[Camera] = [footage.camera] * cameras
    return HybridTracker(recording.skeleton, watching, settings, sites)


def by_region(footage: Footage) -> Iterator[Metric]:
    """The step with regions of so many samples a side."""
    steps = {
        f"growth: step, regions of {side}": a_step(
            a_tracker(footage, replace(Settings(), region=side)), footage
        )
        for side in REGIONS
    }
    yield from medians(steps)


def by_cameras(footage: Footage) -> Iterator[Metric]:
    """The step with so many cameras."""
    steps = {
        f"growth: step, cameras {count}": a_step(a_tracker(footage, Settings(), count), footage)
        for count in CAMERAS
    }
    yield from medians(steps)


def by_hinges() -> Iterator[Metric]:
    """Kinematics, Jacobian and a selectively damped step of a chain of so many hinges."""

    @jax.jit
    def step(skeleton: Skeleton, pose: Pose, targets: jax.Array) -> jax.Array:
        frames = forward(skeleton, pose)
        bones = np.linspace(0, len(skeleton.tree.bones) - 1, 5).astype(np.int32)
        points = frames.joints_world[bones]
        J = jacobian(skeleton, frames, bones, points).reshape(3 * len(bones), -1)
        gamma = jnp.asarray(np.pi / 4, jnp.float32)
        return sdls_step(J, (targets - points).ravel(), gamma).primary

    steps: dict[str, Callable[[], object]] = {}
    targets = np.full((5, 3), 0.1, np.float32)
    for count in HINGES:
        skeleton = chain(count)
        angles = np.linspace(-0.5, 0.5, count, dtype=np.float32)
        pose = Pose(jnp.zeros(3), jnp.eye(4)[0], jnp.asarray(angles))
        problem = (skeleton, pose, targets)
        steps[f"growth: IK step, hinges {count}"] = lambda given=problem: step(*given)
    yield from medians(steps)


def chain(count: int) -> Skeleton:
    """So many bones of 0.1 m in a row, each on one hinge, axes in turn."""
    names = tuple(f"bone{i}" for i in range(count))
    parents = tuple(i - 1 for i in range(count))
    tree = Tree(names, parents, tuple(f"hinge{i}" for i in range(count)), tuple(range(count)))
    ones, zeros = jnp.ones(count), jnp.zeros(count)
    axes = jnp.asarray(np.eye(3)[np.arange(count) % 3], float)
    return Skeleton(
        tree=tree,
        lengths=0.1 * ones,
        directions=jnp.asarray(np.tile([0.0, 0.0, 1.0], (count, 1)), float),
        masses=ones,
        centres=0.5 * ones,
        diameters=jnp.full((count, 2), 0.05),
        axes=axes,
        limits=jnp.asarray(np.tile([-3.0, 3.0], (count, 1)), float),
        costs=jnp.ones(count + 6),
        relaxed=zeros,
        usual_deviations=ones,
        rest_deviations=jnp.full(count, jnp.inf),
        unmarked_costs=jnp.ones(count + 6),
        unmarked_relaxed=zeros - jnp.inf,
        unmarked_least=zeros - jnp.inf,
    )


def by_recordings(footage: Footage) -> Iterator[Metric]:
    """Markers to poses of so many recordings side by side, in one call: of each recording."""
    tracker = a_tracker(footage, Settings())
    model, settings = tracker.model, tracker.settings
    markers = np.asarray(footage.recording.positions_world, model.dtype)
    state = tracker.init(markers[0])

    @jax.jit
    def solve_all(poses, feet, targets):
        return jax.vmap(lambda *each: solve_event(model, settings, *each).ik.pose)(
            poses, feet, targets
        )

    steps: dict[str, Callable[[], object]] = {}
    for count in RECORDINGS:
        batch = jax.tree.map(lambda part, n=count: jnp.stack([part] * n), (state.pose, state.feet))
        targets = markers[1 : count + 1]
        steps[f"growth: solve, recordings {count}"] = lambda g=(*batch, targets): solve_all(*g)
    for metric, count in zip(medians(steps), RECORDINGS, strict=True):
        yield replace(metric, name=f"{metric.name}, of each", value=metric.value / count)


def by_frames(footage: Footage, samples: int) -> Iterator[Metric]:
    """A long run of the tracker: the clip there and back, again and again."""
    tracker = a_tracker(footage, Settings())
    recording, images = footage.recording, footage.images
    there = list(range(len(recording.times)))
    path = there + there[::-1]
    state, pace = tracker.init(recording.positions_world[0]), []
    before = peak_mib()
    for i in range(samples):
        row = path[i % len(path)]
        # One image to three samples, the nearest.
        image = images[min(row // 3, len(images) - 1)] if i % 3 == 0 else None
        watch = Stopwatch()
        state, *_ = jax.block_until_ready(
            tracker.step(state, i / 90, recording.positions_world[row], [image])
        )
        pace.append(watch.read().busy)
        if i == min(WARMING, samples // 4):
            before = peak_mib()
    gained, fifth = peak_mib() - before, samples // 5
    slower = float(np.mean(pace[-fifth:]) / np.mean(pace[fifth : 2 * fifth]))
    yield Metric(f"growth: memory gained over {samples} samples", gained, "MiB")
    yield Metric("late_over_early_step", slower, "x")


def medians(steps: dict[str, Callable[[], object]]) -> Iterator[Metric]:
    """Processor time of each, taken in turn."""
    for name, spans in interleaved(steps, ROUNDS).items():
        yield Metric(name, float(np.median(spans[:, 1])), "ms")
