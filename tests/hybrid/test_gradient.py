"""Gradient refinement: finds displaced elbows, holds markers and limits, is differentiable."""

from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import LIMITS, double, on_device
from watched_arms import (
    FRONT,
    MARKERS,
    MODEL,
    PERSON,
    SIZE,
    TRUTH,
    arms_in,
    elbow_errors,
    observed,
    pictures,
    pose_off_by,
    stacked,
    true_arms,
)

from jaxmocap.body.kinematics import Sites, forward, points_on, site_positions
from jaxmocap.body.pose import Pose, retract
from jaxmocap.compilation.programs import Program
from jaxmocap.evidence.markers import Goals, SearchedElbows
from jaxmocap.hybrid import tracker as tracker_module
from jaxmocap.hybrid.feet import FootPlacement
from jaxmocap.hybrid.fit import Aims, refine_body
from jaxmocap.hybrid.ik import goals_of
from jaxmocap.hybrid.refine import refine_event
from jaxmocap.hybrid.settings import GradientSettings, IKSettings, Settings
from jaxmocap.hybrid.tracker import HybridTracker
from jaxmocap.solvers.status import Status

CAMERAS = stacked(FRONT)
EFFECTORS = MODEL.effectors
ANKLES = [PERSON.tree.bone(f"foot_{side}") for side in "lr"]
FREE = jnp.ones(PERSON.costs.shape, bool)
SEARCHED = Settings(region=SIZE)
# What a search finds counts for nothing, by the same program: the edges and the markers alone must
# do it.
FAR_OFF = GradientSettings(elbows=SearchedElbows(deviation=1e4))
ALONE = replace(SEARCHED, gradient=FAR_OFF)


@jax.jit
def places_of(pose):
    """Markers and ankles of a pose."""
    frames = forward(PERSON, pose)
    return site_positions(PERSON, frames, MARKERS), frames.joints_world[np.array(ANKLES)]


def markers_of(pose) -> np.ndarray:
    return np.asarray(places_of(on_device(pose))[0])


@jax.jit
def _goals(ankles, targets):
    feet = FootPlacement(ankles, jnp.zeros((), bool))
    return goals_of(MODEL, IKSettings(), feet, targets)


def goals_for(pose, mask=(True, True, True)) -> Goals:
    """The markers and feet of a pose."""
    markers, ankles = places_of(on_device(pose))
    return _goals(ankles, np.where(np.array(mask)[:, None], markers, np.float32(np.nan)))


class Refined(NamedTuple):
    """What ``refine_body`` gives."""

    pose: Pose
    status: jax.Array


@jax.jit
def _refined(chosen, cameras, fields, start, goals, elbows, centre):
    edges = chosen.edges.weigh(replace(MODEL, cameras=cameras), fields, start)
    aims = Aims(goals, elbows, centre, FREE)
    return Refined(*refine_body(replace(MODEL, cameras=cameras), chosen, edges, start, aims))


def refined(start, fields=None, goals=None, chosen=ALONE, elbows=None):
    """From a start, which is the priors' centre too."""
    fields = observed(pictures(FRONT), CAMERAS, arms_in(start)) if fields is None else fields
    goals = goals_for(TRUTH) if goals is None else goals
    elbows = arms_in(start).elbow if elbows is None else elbows
    return _refined(chosen, CAMERAS, fields, start, goals, elbows, start)


@pytest.mark.parametrize(
    ("off", "least"),
    [((0.45, 0.0), 0.035), ((-0.3, -0.3), 0.035), ((0.25, -0.25), 0.035), ((0.6, 0.0), 0.08)],
)
def test_elbows_that_were_moved_away_come_back_to_their_edges(off, least):
    start = pose_off_by(*off)
    moved = np.array(off) != 0
    before = elbow_errors(arms_in(start).elbow)
    assert (before[moved] > least).all()
    actual = refined(start)
    assert int(actual.status) == Status.CONVERGED
    assert (elbow_errors(arms_in(actual.pose).elbow) < 0.02).all()


def test_markers_are_held_while_the_edges_pull():
    actual = refined(pose_off_by(-0.3, 0.25)).pose
    assert np.linalg.norm(markers_of(actual) - markers_of(TRUTH), axis=1).max() < 0.01


def test_a_trunk_that_leans_wrongly_is_set_right_by_both_arms():
    """Three markers leave the shoulders uncertain: their place comes from the arms' outlines."""
    start = on_device(TRUTH)
    spine = PERSON.tree.joint("spine2_flexion")
    start = start._replace(angles=start.angles.at[spine].add(0.12))
    apart = lambda pose: np.linalg.norm(  # noqa: E731
        np.asarray(arms_in(pose).shoulder) - np.asarray(true_arms().shoulder), axis=1
    )
    assert apart(start).min() > 0.03
    assert (apart(refined(start).pose) < 0.6 * apart(start)).all()


@pytest.mark.parametrize("off", [(1.2, -1.2), (-1.2, 1.2)])
def test_joints_stay_within_their_range_however_the_start_lies(off):
    angles = np.asarray(refined(pose_off_by(*off)).pose.angles)
    assert (angles >= LIMITS[:, 0] - 1e-6).all() and (angles <= LIMITS[:, 1] + 1e-6).all()


@pytest.mark.parametrize("lost", range(3))
def test_a_missing_marker_leaves_the_others_held(lost):
    mask = [i != lost for i in range(3)]
    actual = refined(pose_off_by(0.25, -0.25), goals=goals_for(TRUTH, mask))
    missed = np.linalg.norm(markers_of(actual.pose) - markers_of(TRUTH), axis=1)
    assert np.isfinite(missed).all()
    assert missed[mask].max() < 0.01
    assert (elbow_errors(arms_in(actual.pose).elbow) < 0.06).all()


def test_a_black_image_leaves_the_pose_as_it_was():
    start = pose_off_by(0.25, -0.25)
    black = [np.zeros((480, 640), np.uint8)]
    actual = refined(start, fields=observed(black, CAMERAS, arms_in(start)))
    assert int(actual.status) == Status.CONVERGED
    for part, same in zip(actual.pose, start, strict=True):
        np.testing.assert_array_equal(part, same)


def test_an_arm_without_an_image_stays_within_its_prior():
    start = pose_off_by(-0.3, -0.3)
    fields = observed(pictures(FRONT), CAMERAS, arms_in(start))
    actual = refined(start, fields=fields._replace(available=np.array([[True, False]])))
    after = elbow_errors(arms_in(actual.pose).elbow)
    assert after[0] < 0.02
    moved = np.linalg.norm(np.asarray(arms_in(actual.pose).elbow - arms_in(start).elbow), axis=1)
    assert moved[1] < 0.02


def test_a_searched_elbow_draws_and_a_wild_one_hardly_more():
    """Long tails: an elbow half a metre off must not tear the hands from their markers."""
    start = pose_off_by(-0.3, 0.0)
    fields = observed(pictures(FRONT), CAMERAS, arms_in(start))
    fields = fields._replace(distances=np.full_like(np.asarray(fields.distances), 10.0))
    drawn = refined(start, fields=fields, chosen=SEARCHED, elbows=true_arms().elbow)
    assert elbow_errors(arms_in(drawn.pose).elbow)[0] < 0.03
    wild = true_arms().elbow + jnp.array([0.0, 0.0, 0.5])
    torn = refined(start, fields=fields, chosen=SEARCHED, elbows=wild)
    assert np.linalg.norm(markers_of(torn.pose) - markers_of(TRUTH), axis=1).max() < 0.02


@pytest.mark.parametrize("turn", [(0.0, 0.0, 0.0), (0.4, -0.3, 0.2)])
def test_the_points_derivative_is_that_of_the_tree(turn):
    """By the pose the geometric Jacobian, by lengths and marker offsets the plain one."""
    with double():
        body = jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf), float), PERSON)
        pose = on_device(TRUTH)
        sites = Sites(EFFECTORS.bones, on_device(EFFECTORS.at), on_device(EFFECTORS.offsets))
        step = jnp.zeros(27).at[3:6].set(jnp.array(turn))

        def ours(step, lengths, offsets):
            moved = retract(pose, step)
            person = replace(body, lengths=lengths)
            return points_on(person, moved, replace(sites, offsets=offsets))

        def plain(step, lengths, offsets):
            frames = forward(replace(body, lengths=lengths), retract(pose, step))
            person = replace(body, lengths=lengths)
            return site_positions(person, frames, replace(sites, offsets=offsets))

        arguments = (step, body.lengths, sites.offsets)
        expected = jax.jit(jax.jacfwd(plain, (0, 1, 2)))(*arguments)
        for way in (jax.jacfwd, jax.jacrev):
            for a, b in zip(jax.jit(way(ours, (0, 1, 2)))(*arguments), expected, strict=True):
                np.testing.assert_allclose(a, b, atol=1e-9)


def test_one_trace_over_twenty_frames_whatever_comes(monkeypatch):
    traced = []

    def counted(*arguments):
        traced.append("refine")
        return refine_event(*arguments)

    monkeypatch.setattr(tracker_module, "REFINE", Program(counted, "refine"))
    alone = Settings(refine="gradient", region=64, search=False, balance=False)
    tracker = HybridTracker(PERSON, [FRONT], alone, MARKERS)
    (picture,) = pictures(FRONT)
    state = tracker.init(markers_of(TRUTH))
    for i in range(20):
        markers = markers_of(TRUTH) + 0.01 * np.sin(i)
        if i in (5, 6):
            markers[i - 5] = np.nan
        image = {3: np.zeros_like(picture), 7: None}.get(i, picture)
        state, pose, report = tracker.step(state, i / 30, markers, [image])
        assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves((state, pose)))
        assert int(report.status) in set(Status)
    assert traced == ["refine"]
