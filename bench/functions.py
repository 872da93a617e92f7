"""``python -m bench.functions [--only NAME] [--json FILE]``: the public functions, one by one.

Of ``landmarks``, ``solve`` (without a start, and from the last pose), ``refine`` by gradient and by
simplex, and ``smooth``: a value, its gradient by what was measured, 64 and 256 at a time, how long
they compile, and how many equations they are. ``rivals`` is ``solve`` beside mink and pink with
limits and beside MuJoCo with a damped step in NumPy, in turn, on the same targets.

One core, float32, table tennis. Nothing that an earlier run compiled is used: it compiles by the
options of ``gradients.md``, and as JAX has it.

INPUTS: nothing. OUTPUTS: one table, and Metrics: milliseconds, seconds, equations.
"""

import logging
import sys
import tempfile
from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bench import command, keep_to_one_core
from bench.clock import ratio, settle_garbage, timed
from bench.figures import Metric, stage_metrics, table, write_json

RATE_HZ, SECONDS = 30, 2.0
# How many at a time, and how often each is timed.
BATCHES = {1: 60, 64: 8, 256: 3}
# Events that ``smooth`` takes at once, and motions at a time.
EVENTS, MOTIONS = 30, {1: 10, 8: 3}
# What ``gradients.md`` has a derivative compiled with, up to the last JAX that has both.
QUICK = {"xla_cpu_use_fusion_emitters": False, "xla_backend_optimization_level": 1}
HAS_QUICK = jax.__version_info__ < (0, 11, 1)


class Work(NamedTuple):
    """A public function at work.

    Attributes:
        function: of ``fixed`` and of one sample, whose first part it is differentiated by.
        fixed: the model, the settings.
        samples: leaves (N, ...).
        batches: how many at a time, and how often.
    """

    function: Callable[..., Array]
    fixed: tuple
    samples: tuple
    batches: dict[int, int]


def works(folder: Path) -> dict[str, Work]:
    """Name -> the work, on a rendered clip."""
    import jaxmocap
    from jaxmocap import Events, Model, Recording, Settings
    from jaxmocap.capture.video import open_video
    from jaxmocap.synthetic.recording import write_table_tennis

    recording = Recording.load(write_table_tennis(folder, seconds=SECONDS))
    model, alone = Model.of(recording), Settings(refine="none")
    events = jaxmocap.first_pass(recording, alone)
    frames = list(islice(open_video(recording.videos[0]).frames(), int(RATE_HZ * SECONDS)))
    rows = np.searchsorted(recording.times, [time for time, _ in frames[:-1]])
    markers = np.asarray(recording.positions_world[rows], np.float32)
    posed, poses = jax.jit(jaxmocap.solve), []
    for own in markers:
        poses.append(posed(model, alone, own, poses[-1] if poses else None))
    each = {way: Settings(refine=way) for way in ("gradient", "simplex")}
    found = [
        jaxmocap.observe(model, each["gradient"], pose, image)
        for pose, (_, image) in zip(poses, frames, strict=False)
    ]
    stacked = lambda parts: jax.tree.map(lambda *p: np.stack(p), *parts)  # noqa: E731
    observations, last = stacked(found), stacked([poses[0], *poses[:-1]])

    def cold(model: Any, settings: Any, own: Array) -> Array:
        return jaxmocap.landmarks(model, jaxmocap.solve(model, settings, own))

    def following(model: Any, settings: Any, own: Array, before: Any) -> Array:
        return jaxmocap.landmarks(model, jaxmocap.solve(model, settings, own, before))

    def refined(model: Any, settings: Any, pose: Any, observation: Any) -> Array:
        return jaxmocap.landmarks(model, jaxmocap.refine(model, settings, pose, observation))

    def smoothed(model: Any, settings: Any, measured: Any, times: Array, start: Any) -> Array:
        return jaxmocap.smooth(model, settings, Events(times, measured, start)).points

    firsts = range(0, len(events.times) - EVENTS, 5)
    motions = stacked(
        [jax.tree.map(lambda part, f=f: part[f : f + EVENTS], events) for f in firsts]
    )
    result = {
        "landmarks": Work(jaxmocap.landmarks, (model,), (stacked(poses),), BATCHES),
        "solve": Work(cold, (model, alone), (markers,), BATCHES),
        "solve from the last pose": Work(following, (model, alone), (markers, last), BATCHES),
    }
    for way, settings in each.items():
        given = (stacked(poses), observations)
        result[f"refine, {way}"] = Work(refined, (model, settings), given, BATCHES)
    given = (motions.measured, motions.times, motions.poses)
    result[f"smooth, {EVENTS} events"] = Work(smoothed, (model, alone), given, MOTIONS)
    return result


def measured(name: str, work: Work) -> Iterator[Metric]:
    """All figures of one function."""
    function, fixed, samples, batches = work
    count = len(jax.tree.leaves(samples)[0])
    own = [jax.tree.map(lambda part, i=i: part[i], samples) for i in range(count)]

    def slope(*given: Any) -> Any:
        def total(first: Any) -> Array:
            return jnp.sum(function(*fixed_of(given), first, *given[len(fixed) + 1 :]) ** 2)

        return jax.grad(total)(given[len(fixed)])

    def fixed_of(given: tuple) -> tuple:
        return given[: len(fixed)]

    def compiled_by(one: Callable, options: dict | None) -> tuple:
        jax.clear_caches()
        jitted = jax.jit(one, compiler_options=options)
        return timed(lambda: jitted.lower(*fixed, *own[0]).compile())

    traced = jax.make_jaxpr(function)(*fixed, *own[0])
    yield Metric(f"{name}, equations", equations(traced.jaxpr), "", tolerance=0.1)
    for kind, one in (("", function), (", gradient", slope)):
        if HAS_QUICK:
            quickly, _ = compiled_by(one, QUICK)
            yield Metric(f"{name}{kind}, compile, quick options", quickly.busy / 1e3, "s")
        compiling, compiled = compiled_by(one, None)
        yield Metric(f"{name}{kind}, compile", compiling.busy / 1e3, "s")
        spent = [timed(compiled, *fixed, *own[i % count])[0].busy for i in range(batches[1])]
        yield from stage_metrics(f"{name}{kind}", spent[1:])
    for size, times in batches.items():
        if size == 1:
            continue
        together = jax.jit(jax.vmap(function, (*[None] * len(fixed), *[0] * len(samples))))
        rows = np.arange(size) % count
        batch = jax.tree.map(lambda part, r=rows: part[r], samples)
        jax.block_until_ready(together(*fixed, *batch))
        spent = [timed(together, *fixed, *batch)[0].busy / size for _ in range(times)]
        yield Metric(f"{name}, {size} at a time, each", float(np.median(spent)), "ms")


def equations(jaxpr: Any) -> int:
    """Of a program, those of its loops and branches included."""
    inner = [
        getattr(part, "jaxpr", part)
        for equation in jaxpr.eqns
        for value in equation.params.values()
        for part in (value if isinstance(value, tuple | list) else (value,))
        if hasattr(part, "eqns") or hasattr(part, "jaxpr")
    ]
    return len(jaxpr.eqns) + sum(map(equations, inner))


def rivals() -> Iterator[Metric]:
    """``solve`` from the last pose, and others', in turn on the same targets."""
    from bench import rival_ik
    from jaxmocap import Model, Settings, Skeleton, solve
    from jaxmocap.body.kinematics import Sites, forward

    logging.disable(logging.WARNING)
    skeleton = Skeleton.human(1.75)
    start, targets = rival_ik.motion(skeleton, rival_ik.FRAMES[False])
    bones = np.array([skeleton.tree.bone(name) for name in rival_ik.REACHING], np.int32)
    model = Model.create(skeleton, Sites(bones, jnp.zeros(len(bones)), jnp.zeros((len(bones), 3))))

    # The model is the program's own, as it is theirs.
    @jax.jit
    def followed(markers: Array, last: Any) -> tuple:
        pose = solve(model, Settings(), markers, last)
        return pose, forward(model.skeleton, pose).joints_world[bones]

    last = [start]

    def ours(goals: np.ndarray) -> np.ndarray:
        last[0], points = followed(goals.astype(np.float32), last[0])
        return np.asarray(points)

    everybody = rival_ik.everybody(skeleton, start, set())
    chosen = ("mink_limits", "pink_limits", "mujoco_and_numpy")
    followers = {"solve": ours} | {name: everybody[name] for name in chosen}
    for block, suffix in ((1, ""), (rival_ik.BLOCK, f", {rival_ik.BLOCK} at a time")):
        spans, misses = rival_ik.followed(followers, targets, block)
        for name, times in spans.items():
            yield from stage_metrics(f"rivals, {name}{suffix}", times[:, 1])
            if block == 1:
                met = 100 * float(np.mean(misses[name] < 1.05 * rival_ik.TOLERANCE_M))
                yield Metric(f"rivals, {name}, met within 1 mm", met, "%", "higher")
        for name in chosen:
            over = ratio(spans["solve"], spans[name])
            yield Metric(f"rivals, solve over {name}{suffix}", over, "x")
    logging.disable(logging.NOTSET)


def main() -> None:
    """Print the table."""
    parser = command("bench.functions", __doc__)
    parser.add_argument("--only", metavar="NAME", help="those whose name begins so; or rivals")
    options = parser.parse_args()
    keep_to_one_core()
    chosen, metrics = options.only or "", []
    with tempfile.TemporaryDirectory() as folder:
        for name, work in (works(Path(folder)) if chosen != "rivals" else {}).items():
            if name.startswith(chosen):
                print(f"measuring {name}", file=sys.stderr, flush=True)
                settle_garbage()
                metrics += measured(name, work)
    if "rivals".startswith(chosen):
        metrics += rivals()
    if not metrics:
        parser.error(f"--only {chosen!r}: no function's name begins so")
    print(table(metrics))
    write_json(metrics, options.json)


if __name__ == "__main__":
    main()
