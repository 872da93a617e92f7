"""What a fixed lag keeps: the newest events, and what the ones before them tell.

Everything is an array of a fixed shape: there is room for ``PLACES`` events, of which the first so
many are there.

INPUTS: a Model, what was measured of new events. OUTPUTS: WindowStates.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.model import Model
from jaxmocap.body.pose import pack, relaxed_pose
from jaxmocap.body.skeleton import LANDMARKS
from jaxmocap.body.tree import ROOT_DOF
from jaxmocap.compilation.arrays import Numbers
from jaxmocap.evidence.keypoints import SightLines
from jaxmocap.evidence.silhouettes import SilhouetteGrids
from jaxmocap.evidence.smoothness import REACH
from jaxmocap.evidence.terms import Measurements
from jaxmocap.smoothing.settings import LASTING_HZ
from jaxmocap.smoothing.window.elimination import MarginalPrior

# Events that a window has room for, that may come at once, and that stay at most.
PLACES, NEW = 16, 4
MOST_KEPT = PLACES - NEW
# Deviations are found at one of so many times that poses are given out, and hold until the next.
SURE_EVERY = 5


class EventArrays(NamedTuple):
    """E events, the first K of which are there."""

    filled: Numbers  # () K
    since: Numbers  # (E,) seconds from the event before each
    poses: Numbers  # (E, 7 + D) packed
    measured: Measurements  # (E, ...) besides the silhouettes
    shown: Numbers  # (E, C) which cameras had a frame
    grids: SilhouetteGrids | None  # (E, C, ...) what these show; None without cameras
    lines: SightLines | None = None  # (E, K, ...) of cameras with key points; None where none has

    def join_news(self, news: "EventArrays") -> "EventArrays":
        """With ``NEW`` others behind; there must be room."""

        def behind(own: Array, other: Array) -> Array:
            return jax.lax.dynamic_update_slice_in_dim(own, other, self.filled, 0)

        alone = self._replace(filled=jnp.zeros(0)), news._replace(filled=jnp.zeros(0))
        joined = jax.tree.map(lambda own, other: behind(own, other) if own.size else own, *alone)
        return joined._replace(filled=self.filled + news.filled)

    def after(self, left: Array) -> "EventArrays":
        """Without the first so many."""
        later = later_rows(self._replace(filled=jnp.zeros(0)), left)
        return later._replace(filled=self.filled - left)

    @property
    def are_there(self) -> Array:
        """(E,)."""
        return jnp.arange(len(self.since), dtype=jnp.int32) < self.filled

    @property
    def have_frames(self) -> Array:
        """(E,)."""
        return jnp.any(self.shown, 1) & self.are_there

    @property
    def waited(self) -> Array:
        """(E,) seconds until the last event."""
        since = jnp.where(self.are_there, self.since, 0.0)
        return jnp.sum(since) - jnp.cumsum(since)


def later_rows(tree: Any, left: Array) -> Any:
    """Arrays (E, ...) without their first so many rows; the last one fills up."""

    def later(part: Array) -> Array:
        rows = jnp.minimum(jnp.arange(len(part), dtype=jnp.int32) + left, len(part) - 1)
        return jnp.take(part, rows, axis=0) if part.size else part

    return jax.tree.map(later, tree)


class Drawn(NamedTuple):
    """What silhouettes and key points of E events cost near the poses where they were drawn."""

    cost: Array  # (E,) of them there
    hessian: Array  # (E, N, N) of half the cost, by the pose's tangent vector
    gradient: Array  # (E, N) likewise
    points: Array  # (E, 3 L) the landmarks there, world, metres; NaN before the first time
    step: Array  # (E, N) from an event's pose to that where it was drawn

    @classmethod
    def never(cls, events: int, size: int, dtype: Any) -> "Drawn":
        """Of N unknowns: the size."""
        row, square = jnp.zeros((events, size), dtype), jnp.zeros((events, size, size), dtype)
        unknown = jnp.full((events, 3 * len(LANDMARKS)), jnp.nan, dtype)
        return cls(jnp.zeros(events, dtype), square, row, unknown, row)

    def without_rows(self, first: Array, count: int) -> "Drawn":
        """The same, so many rows as if nothing had been drawn there."""
        never = Drawn.never(count, self.step.shape[1], self.step.dtype)

        def placed(own: Array, other: Array) -> Array:
            return jax.lax.dynamic_update_slice_in_dim(own, other, first, 0)

        return jax.tree.map(placed, self, never)

    def about(self, steps: Array) -> "Drawn":
        """The same of poses that moved by steps (E, N)."""
        return self._replace(step=self.step - steps)


class WindowState(NamedTuple):
    """The newest events, and what the ones before them tell."""

    events: EventArrays  # ``PLACES`` of them
    drawn: Drawn | None  # their silhouettes' costs; None without cameras
    given: Array  # () how many of them were given out
    last_given: Array  # (7 + D,) the pose that was given out last, as it was then
    last_slope: Array  # (N,) tangent vector a second there
    marginal: MarginalPrior  # about the first two
    # (2, 2 N, 2 N) the same for deviations: with silhouettes, which err alike and count less, and
    # without.
    sure: Array
    pace: Array  # () seconds between events, by which terms are weighed
    searched: Array  # () video frames since the arms were searched for, in two searches' time
    # (2, 3, 3) how far arms may be elsewhere, see ``ArmSearch``; of the last search.
    arms_spread: Array
    variances: Array  # (2, L, 3) of the landmarks, as last found, likewise
    stated: Array  # () how often poses were given out since


@jax.jit
def init(model: Model, like: EventArrays) -> WindowState:
    """A window without events.

    Args:
        model: of the person, the markers and the cameras.
        like: events of the same shapes as those to come.
    """
    dtype, size = model.dtype, ROOT_DOF + model.skeleton.relaxed.size
    still, no = pack(relaxed_pose(model.skeleton)), jnp.zeros((), jnp.int32)

    def room(part: Any) -> Array:
        return jnp.zeros((PLACES, *np.shape(part)[1:]), np.result_type(part))

    events = jax.tree.map(room, like._replace(filled=np.zeros(1, np.int32)))._replace(
        filled=no, since=jnp.ones(PLACES, dtype), poses=jnp.tile(still, (PLACES, 1))
    )
    return WindowState(
        events, None if model.cameras is None else Drawn.never(PLACES, size, dtype), no, still,
        jnp.zeros(size, dtype),
        MarginalPrior.none(size, dtype), jnp.zeros((2, REACH * size, REACH * size), dtype),
        jnp.asarray(1 / LASTING_HZ, dtype), no, jnp.zeros((2, 3, 3), dtype),
        jnp.zeros((2, len(LANDMARKS), 3), dtype), jnp.asarray(SURE_EVERY, jnp.int32),
    )  # fmt: skip
