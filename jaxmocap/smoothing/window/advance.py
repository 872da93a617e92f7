"""A fixed lag as a pure function: a state and new events in, the next state and poses out.

Events come in, all events of the window are moved to where they cost least together with the
marginal prior, and the oldest ones are condensed into that prior and leave. ``jit``, ``vmap`` over
people and ``lax.scan`` over a recording's events go through it.

INPUTS: a Model, settings, a WindowState, new events. OUTPUTS: the next state, poses, deviations,
which events are final.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxmocap.body.arms import ELBOW, GRIP, SHOULDER, unmarked_arms
from jaxmocap.body.model import Model
from jaxmocap.body.pose import difference, unpack
from jaxmocap.body.skeleton import LANDMARKS
from jaxmocap.compilation.arrays import Numbers
from jaxmocap.compilation.programs import program
from jaxmocap.evidence.smoothness import REACH
from jaxmocap.smoothing.settings import LASTING_HZ, LONGEST_STEP_S, SmoothingSettings, with_lasting
from jaxmocap.smoothing.uncertainty import frames_a_moment, landmark_deviations
from jaxmocap.smoothing.window.arm_search import search_arms, with_arm_there
from jaxmocap.smoothing.window.elimination import (
    MarginalPrior,
    eliminate,
    point_variances,
)
from jaxmocap.smoothing.window.solving import Window, evidence_of, solve
from jaxmocap.smoothing.window.state import (
    MOST_KEPT,
    NEW,
    SURE_EVERY,
    Drawn,
    EventArrays,
    WindowState,
    later_rows,
)
from jaxmocap.solvers.descent import tree_where

# A pose is given out once so many later video frames came,
DELAY_FRAMES = 2
# and so many seconds later at most; without video, where events wait for one another as well.
DELAY_S, DELAY_WITHOUT_VIDEO_S = 0.1, 0.05
# Video frames that stay in the window,
KEPT_FRAMES = 3
# for so many seconds at most; and events that stay at least.
KEPT_S, FEWEST_KEPT = 0.2, 3
# Fewest and most steps of a solve.
STEPS = 1, 3
# The arms are searched for at one video frame in so many. A window that starts where the search has
# an elbow is tried where that is so far away, metres, and costs so much less; it makes so many
# steps, and must cost as much less in the end.
SEARCH_EVERY = 4
RIVAL_M = 0.1
RIVAL_GAIN = 5.0
RIVAL_STEPS = 3, 3
# Terms are weighed again where the time between events has changed by this share.
RATE_CHANGED = 0.2


class Advanced(NamedTuple):
    """What ``advance`` found of E events."""

    poses: Numbers  # (E, 7 + D) packed, those that came among them
    given: Numbers  # (2,) the first that is given out now, and the first that is not
    left: Numbers  # () how many left the window
    # (2, N) tangent vector from where the event that was given out last is now to where it was
    # then, and its change per second.
    correction: Numbers
    deviations: Numbers  # (L, 3) of what is given out, world, metres
    # (L,) 1 where markers and video leave a landmark almost as uncertain as it is without them,
    # else 0.
    from_prior: Numbers
    arms_spread: Numbers  # (2, 3, 3) as of ``WindowState``


@program("quick")
def advance(
    model: Model,
    settings: SmoothingSettings,
    state: WindowState,
    news: EventArrays,
    markers_world: Array,
    is_last: Array,
) -> tuple[WindowState, Advanced]:
    """A window some events on.

    Args:
        model: of the person, the markers and the cameras.
        settings: of the smoothing.
        state: of the window.
        news: events that come, ``NEW`` at most.
        markers_world: (E, M, 3) metres, of all events that are there then: a frame between two
            samples has them once the second one came. NaN where missing.
        is_last: () whether all that waits is given out.
    """
    events = state.events.join_news(news)
    events = events._replace(measured=events.measured._replace(markers=markers_world))
    drawn = state.drawn and state.drawn.without_rows(state.events.filled, NEW)
    state = state._replace(events=events, drawn=drawn, pace=_pace(state.pace, events))
    weighed = with_lasting(settings, (state.pace * LASTING_HZ) ** -0.5)
    state, window = _solve_window(model, weighed, state)
    first, given, left = _schedule(model, state, is_last)
    state = _sure(weighed, state, window, first, given)
    last = jnp.maximum(jnp.stack([first, given]) - 1, 0)
    slopes = jax.vmap(_slope, (None, None, 0))(events, window.poses, last)
    off = difference(unpack(state.last_given), unpack(window.poses[last[0]]))
    correction = jnp.where(first > 0, jnp.stack([off, state.last_slope - slopes[0]]), 0.0)
    all_of_it, without = state.variances
    deviations, from_prior = landmark_deviations(all_of_it, without, settings.mismatch)
    advanced = Advanced(
        window.poses, jnp.stack([first, given]), left, correction, deviations, from_prior,
        state.arms_spread,
    )  # fmt: skip
    now = window.poses[last[1]], slopes[1]
    last_given, last_slope = tree_where(given > first, now, (state.last_given, state.last_slope))
    state = state._replace(given=given, last_given=last_given, last_slope=last_slope)
    return _shorten_state(weighed, state, window, left), advanced


def _slope(events: EventArrays, poses: Array, i: Array) -> Array:
    """(N,) tangent vector a second at the ith event, as ``cubic_step`` has it."""
    rows = jnp.clip(i + jnp.arange(-1, 2, dtype=jnp.int32), 0, events.filled - 1)
    before, here, after = (unpack(poses[row]) for row in rows)
    spans = events.since[jnp.stack([i, rows[2]])]
    ways = jnp.stack([difference(here, before), difference(after, here)]) / spans[:, None]
    # The nearer neighbour counts more; one that is not there does not.
    weights = jnp.where(rows[1:] > rows[:-1], spans[::-1], 0.0)
    return jnp.sum(weights[:, None] * ways, 0) / jnp.maximum(jnp.sum(weights), 1e-9)


def _pace(pace: Array, events: EventArrays) -> Array:
    """() seconds between events, as long as it is about the same."""
    later = events.are_there & (jnp.arange(len(events.since)) > 0)
    steps = jnp.where(later, jnp.minimum(events.since, LONGEST_STEP_S), 0.0)
    mean = jnp.sum(steps) / jnp.maximum(events.filled - 1, 1).astype(pace.dtype)
    has_changed = (events.filled > REACH) & (jnp.abs(mean / pace - 1) > RATE_CHANGED)
    return jnp.where(has_changed, mean, pace)


def _solve_window(
    model: Model, settings: SmoothingSettings, state: WindowState
) -> tuple[WindowState, Window]:
    """The window, or one with an arm where the search has it, where that costs less."""
    events = state.events
    steps, rival_steps = (jax.tree.map(jnp.int32, each) for each in (STEPS, RIVAL_STEPS))
    own = events, state.drawn, state.marginal
    if state.drawn is None or events.grids is None:
        return state, solve(model, settings, *own, steps)[0]
    newest, dtype = events.filled - 1, events.poses.dtype
    shown = jnp.asarray(events.shown)[newest]
    can_search = jnp.any(shown) & (events.filled > REACH)
    searched = state.searched + can_search.astype(jnp.int32)
    is_due = can_search & (searched % SEARCH_EVERY == 0)
    unmarked = unmarked_arms(model.skeleton.tree, model.markers, events.measured.markers)
    # An arm without a marker is turned about its shoulder and, at the next search, about its elbow.
    free = jnp.where(searched > SEARCH_EVERY, ELBOW, SHOULDER)
    pivots = jnp.where(unmarked[newest], free, GRIP)

    def search() -> tuple[Array, Array, Array]:
        grids, lines = jax.tree.map(lambda part: part[newest], (events.grids, events.lines))
        there = unpack(events.poses[newest])
        found = search_arms(model, settings, there, shown, grids, lines, pivots)
        is_tried = (found.gain >= RIVAL_GAIN) & (found.away >= RIVAL_M)
        return is_tried, found.spread, with_arm_there(model, events.poses, found, unmarked)

    def none() -> tuple[Array, Array, Array]:
        return jnp.zeros((), bool), state.arms_spread, events.poses

    is_tried, spread, there = jax.lax.cond(is_due, search, none)
    # Its marginal prior says the same of a body whose arm was there all along: without one nothing
    # would hold a body whose markers are missing.
    size = len(state.marginal.gradient) // REACH
    undrawn = Drawn.never(len(events.since), size, dtype)
    rival = events._replace(poses=there), undrawn, state.marginal

    def untried(carry: tuple) -> Array:
        attempt, *_ = carry
        return (attempt == 0) | ((attempt == 1) & is_tried)

    def attempt(carry: tuple) -> tuple:
        # Both through here, so that the solve compiles once.
        attempt, best, cost, _ = carry
        is_rival = attempt == 1
        events, drawn, marginal = tree_where(is_rival, rival, own)
        most = tree_where(is_rival, rival_steps, steps)
        tried, price = solve(model, settings, events, drawn, marginal, most)
        wins = ~is_rival | (price < cost - RIVAL_GAIN)
        best, cost = tree_where(wins, (tried, price), (best, cost))
        return attempt + 1, best, cost, is_rival & wins

    like = jax.eval_shape(lambda: solve(model, settings, *own, steps))
    nothing = jax.tree.map(lambda part: jnp.zeros(part.shape, part.dtype), like)
    first = jnp.zeros((), jnp.int32), *nothing, jnp.zeros((), bool)
    _, window, _, has_won = jax.lax.while_loop(untried, attempt, first)
    state = state._replace(
        searched=searched % (2 * SEARCH_EVERY), arms_spread=spread,
        sure=jnp.where(has_won, 0.0, state.sure),
    )  # fmt: skip
    return state, window


def _schedule(model: Model, state: WindowState, is_last: Array) -> tuple[Array, Array, Array]:
    """Which events are given out, the first and the first that is not; how many leave."""
    events = state.events
    frames, waited = events.have_frames.astype(jnp.int32), events.waited
    later = jnp.sum(frames, dtype=jnp.int32) - jnp.cumsum(frames, dtype=jnp.int32)
    longest = DELAY_S if model.camera_count else DELAY_WITHOUT_VIDEO_S
    is_final = is_last | (~jnp.any(events.have_frames) if model.camera_count else False)
    is_due = events.are_there & (is_final | (later >= DELAY_FRAMES) | (waited >= longest))
    # One more than must leave: the track goes on from there.
    crowded = events.filled - MOST_KEPT + 1
    due = jnp.maximum(jnp.sum(is_due, dtype=jnp.int32), crowded)
    given = jnp.maximum(state.given, due)
    left = jnp.arange(len(frames), dtype=jnp.int32)
    kept = events.filled - left
    is_short = (later + frames <= KEPT_FRAMES) & (waited < KEPT_S) & (kept <= MOST_KEPT)
    stops = (kept <= FEWEST_KEPT) | (left >= given - 1) | is_short
    return state.given, given, jnp.argmax(stops).astype(jnp.int32)


def _shares(settings: SmoothingSettings, events: EventArrays) -> Array:
    """What of the silhouettes counts in deviations: cells that err alike count once; and none."""
    filmed, times = events.have_frames, jnp.cumsum(events.since)
    first = jnp.min(jnp.where(filmed, times, jnp.inf))
    span = jnp.max(jnp.where(filmed, times, -jnp.inf)) - first
    between = jnp.sum(filmed, dtype=times.dtype) - 1
    step = jnp.where(between > 0, span / jnp.maximum(between, 1), 1 / LASTING_HZ)
    once = 1 / (frames_a_moment(step) * settings.silhouettes.redundancy)
    return jnp.stack([once, jnp.zeros_like(once)])


def _sure(
    settings: SmoothingSettings, state: WindowState, window: Window, first: Array, given: Array
) -> WindowState:
    """The state with variances of what is given out, found every few times."""
    events, stated = state.events, state.stated + (given > first).astype(jnp.int32)
    is_due = (given > first) & (stated > SURE_EVERY)
    dtype, J = events.poses.dtype, window.fit.jacobian[jnp.maximum(given - 1, 0)]

    def found() -> Array:
        def of_share(share: Array, hessian: Array) -> Array:
            evidence = evidence_of(settings, events, window.fit, window.drawn, share)
            marginal = MarginalPrior(hessian, jnp.zeros(len(hessian), dtype))
            loose = jnp.zeros(J.shape[1], dtype)
            eliminated = eliminate(evidence, marginal, loose, events.filled)
            return point_variances(eliminated, J, events.filled, given - 1)

        each = jax.vmap(of_share)(_shares(settings, events), state.sure)
        return each.reshape(2, len(LANDMARKS), 3)

    variances = jax.lax.cond(is_due, found, lambda: state.variances)
    return state._replace(variances=variances, stated=jnp.where(is_due, 1, stated))


def _shorten_state(
    settings: SmoothingSettings, state: WindowState, window: Window, left: Array
) -> WindowState:
    """The state without the first so many events, condensed, about where the window is now."""
    events, sure = state.events, state.sure
    size, dtype = window.steps.shape[1], events.poses.dtype
    one = jnp.ones(1, dtype)
    shares = jnp.concatenate([one, _shares(settings, events)])
    hessians = jnp.concatenate([window.marginal.hessian[None], sure])
    pull = jnp.zeros_like(window.marginal.gradient)
    gradients = jnp.stack([window.marginal.gradient, pull, pull])

    def condensed(share: Array, hessian: Array, gradient: Array) -> MarginalPrior:
        evidence = evidence_of(settings, events, window.fit, window.drawn, share)
        marginal = MarginalPrior(hessian, gradient)
        return eliminate(evidence, marginal, jnp.zeros(size, dtype), left).rest

    rest = jax.vmap(condensed)(shares, hessians, gradients)
    are_right = jnp.all(jnp.isfinite(rest.hessian), (1, 2)) & jnp.all(jnp.isfinite(rest.gradient))
    hessian = jnp.where(are_right[:, None, None], rest.hessian, 0.0)
    gradient = jnp.where(are_right[0], rest.gradient[0], 0.0)
    steps = jax.lax.dynamic_slice_in_dim(window.steps, left, REACH)
    drawn = window.drawn and later_rows(window.drawn.about(window.steps), left)
    return state._replace(
        events=events._replace(poses=window.poses).after(left), drawn=drawn,
        given=state.given - left, marginal=MarginalPrior(hessian[0], gradient).about(steps),
        sure=hessian[1:],
    )  # fmt: skip
