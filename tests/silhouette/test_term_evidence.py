"""Terms beside silhouettes: markers, and one that nobody has written yet."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import complaint
from point_rays import on_rays
from test_rim import BODY

from jaxmocap.body.kinematics import Sites, forward, site_positions
from jaxmocap.body.model import Model
from jaxmocap.body.pose import relaxed_pose, retract
from jaxmocap.body.surfaces.surface import BodyPoints
from jaxmocap.body.tree import ROOT_DOF
from jaxmocap.compilation.settings import settings, traced
from jaxmocap.evidence.keypoints import KeyPoints, lines_of_sight
from jaxmocap.evidence.markers import MarkerPositions
from jaxmocap.evidence.terms import Measurements, Term
from jaxmocap.formats.recordings.recording import Recording
from jaxmocap.geometry.lines import Lines
from jaxmocap.pipelines.silhouettes.track import make_silhouette_tracker
from jaxmocap.silhouette.fit.cycles import term_evidence
from jaxmocap.silhouette.pose import PoseSettings, TermEvidence, solve_pose
from jaxmocap.silhouette.settings import Settings
from jaxmocap.synthetic.drawing_camera import look_at

SITES = Sites(
    np.array([BODY.tree.bone(name) for name in ("head", "radius_l", "radius_r")], np.int32),
    jnp.asarray([1.0, 1.0, 0.8]),
    jnp.asarray([[0.0, 0.0, 0.0], [0.0, 0.02, 0.0], [0.01, 0.0, 0.03]]),
)
SOLVE = jax.jit(solve_pose)
EQUATIONS = jax.jit(lambda pose, beside: beside.equations(pose))
MOVED = jax.jit(retract)
PLACES = jax.jit(lambda pose: site_positions(BODY, forward(BODY, pose), SITES))
START = relaxed_pose(BODY)


@settings
class PelvisHeight(Term):
    """A term that the package does not have: the pelvis is so high."""

    height: jax.Array = traced(1.2, "of the pelvis, metres")

    def residual(self, model, body, measured):
        """()."""
        return (body.pose.position[2] - self.height) / 0.01


def beside(positions, deviation=0.01, *more) -> TermEvidence:
    terms = (MarkerPositions(deviation=deviation), *more)
    return TermEvidence(Model(BODY, SITES), terms, Measurements(np.asarray(positions, np.float32)))


def raised():
    step = np.zeros(BODY.costs.shape, np.float32)
    step[:3] = 0.03, -0.02, 0.01
    step[ROOT_DOF + BODY.tree.joint("arm_abduct_l")] = 0.4
    step[ROOT_DOF + BODY.tree.joint("elbow_flex_r")] = 0.5
    return retract(START, jnp.asarray(step))


def test_terms_without_measurements_have_no_part():
    model, usual = Model(BODY, Sites.none(BODY.lengths.dtype)), Settings()
    assert term_evidence(model, Measurements(), usual) is None
    camera = look_at((4.0, 0.0, 1.0), (0.0, 0.0, 1.0))
    pixels = np.full((1, 1, 2), 200.0)
    lines = lines_of_sight(camera, ("wrist_l",), pixels, np.ones((1, 1)))
    by_points = term_evidence(
        model, Measurements(sight_lines=jax.tree.map(lambda part: part[0], lines)), usual
    )
    assert by_points is not None and [type(term) for term in by_points.terms] == [KeyPoints]
    marked = term_evidence(Model(BODY, SITES), Measurements(), usual)
    assert marked is not None and [type(term) for term in marked.terms] == [MarkerPositions]


def alone(positions, *more):
    """Solved by markers and other terms; the only ray weighs nothing."""
    nothing = jnp.zeros((1, 3))
    first = BodyPoints(jnp.zeros((1, 1), jnp.int32), jnp.zeros((1, 1, 3)), jnp.ones((1, 1)))
    rays = on_rays(first, Lines(nothing + jnp.eye(3)[0], nothing), jnp.zeros(1))
    how = PoseSettings(iterations=30, damping=10.0)
    return SOLVE(BODY, START, rays, how, None, None, beside(positions, 0.01, *more))


def test_markers_alone_are_reached_and_a_missing_one_asks_for_nothing():
    there = np.array(PLACES(raised()))
    actual = alone(there)
    np.testing.assert_allclose(PLACES(actual.pose), there, atol=1e-3)
    there[1] = np.nan
    actual = alone(there)
    np.testing.assert_allclose(np.asarray(PLACES(actual.pose))[[0, 2]], there[[0, 2]], atol=1e-3)
    assert np.isfinite(np.asarray(actual.information)).all()
    arm = ROOT_DOF + BODY.tree.joint("arm_abduct_l")
    assert actual.information[arm, arm] == 0


def test_a_term_that_is_added_takes_part():
    found = alone(np.full((3, 3), np.nan), PelvisHeight())
    assert float(found.pose.position[2]) == pytest.approx(1.2, abs=1e-3)
    np.testing.assert_allclose(found.pose.angles, START.angles, atol=1e-6)


def test_without_any_marker_and_any_ray_nothing_moves():
    actual = alone(np.full((3, 3), np.nan))
    np.testing.assert_array_equal(actual.pose.angles, START.angles)
    assert not np.asarray(actual.information).any()


def test_the_rows_are_the_slope_and_hessian_of_half_the_squares():
    there = np.asarray(PLACES(raised()))
    information, slope = EQUATIONS(START, beside(there, 0.02))

    def half_squares(step) -> float:
        off = (np.asarray(PLACES(MOVED(START, jnp.asarray(step))), float) - there) / 0.02
        return float(np.sum(off**2) / 2)

    for dof in (0, 5, ROOT_DOF + BODY.tree.joint("arm_abduct_l")):
        step = np.zeros(BODY.costs.shape, np.float32)
        step[dof] = 0.01
        numeric = (half_squares(step) - half_squares(-step)) / 0.02
        assert slope[dof] == pytest.approx(numeric, rel=0.02, abs=0.5)
    at_truth, _ = EQUATIONS(raised(), beside(there, 0.02))
    exact, _ = EQUATIONS(raised(), beside(there, 0.01))
    np.testing.assert_allclose(exact, 4 * np.asarray(at_truth), rtol=1e-4)
    assert np.linalg.eigvalsh(np.asarray(information, float)).min() > -1


def test_markers_are_asked_of_a_recording_that_has_them():
    bare = Recording(BODY, np.zeros(0), np.zeros((0, 0, 3)), ())
    assert "no [[video]]" in complaint(make_silhouette_tracker, bare, markers=True)
