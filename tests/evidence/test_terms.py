"""Terms of evidence: a new one is one class and one line; derivatives of all that there are."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import double, on_device, poses
from hypothesis import assume, given
from hypothesis import settings as hypothesis_settings
from jax import Array
from painted_motion import (
    CAMERAS,
    ELBOWS,
    MODEL,
    PERSON,
    SETTINGS,
    disturbed,
    measurements,
    points_of,
    problem,
    truth,
    views,
)

import jaxmocap
from jaxmocap.body.kinematics import joined_sites, landmark_sites, landmarks
from jaxmocap.body.model import Model
from jaxmocap.body.pose import Pose, retract
from jaxmocap.body.proportions import PROPORTIONS, scaled
from jaxmocap.body.skeleton import LANDMARKS, landmark_rows
from jaxmocap.body.tree import ROOT_DOF
from jaxmocap.compilation.settings import group, settings, traced
from jaxmocap.evidence.edges import EdgeFields, weighted_edges
from jaxmocap.evidence.keypoints import lines_of_sight
from jaxmocap.evidence.markers import Goals, SearchedElbows
from jaxmocap.evidence.posture import EstimatedPose, NearEstimate
from jaxmocap.evidence.terms import (
    Measurements,
    PosedBody,
    Term,
    linearised,
    linearised_term,
    residuals,
)
from jaxmocap.geometry.cameras import project
from jaxmocap.hybrid.gradient import Aims, refine_body
from jaxmocap.hybrid.ik import reach
from jaxmocap.hybrid.settings import GradientSettings, IKSettings, Settings
from jaxmocap.images.regions import Region
from jaxmocap.smoothing.linearise import smooth_poses
from jaxmocap.smoothing.settings import SmoothingSettings

LOGARITHMS = np.array([0.04, -0.03], np.float32)
COUNT = 2


def frame(kind: str):
    """A pose, and measurements of another, so that nothing is at rest."""
    there = measurements(COUNT)
    if kind == "a marker lost":
        there["markers"] = np.array(there["markers"])
        there["markers"][:, 1] = np.nan
    if kind == "elbows with goals":
        there["elbows"] = np.full((COUNT, 2, 3), 0.3, np.float32)
    if kind == "lines of sight":
        pixels = np.asarray(project(CAMERAS[0], jnp.asarray(points_of(truth(COUNT)))))
        names, sure = tuple(LANDMARKS), np.full(pixels.shape[:2], 0.9)
        there["sight_lines"] = lines_of_sight(CAMERAS[0], names, pixels, sure)
    pose, one = jax.tree.map(lambda part: on_device(part[1]), (truth(COUNT), there))
    step = 0.1 * np.random.default_rng(3).standard_normal(ROOT_DOF + pose.angles.size)
    return retract(pose, on_device(step)), one


@pytest.mark.parametrize(
    "kind",
    ["markers", "a marker lost", "elbows with goals", "lines of sight"],
)
def test_the_derivative_is_that_of_going_through_everything(kind):
    pose, one = frame(kind)
    dofs = ROOT_DOF + pose.angles.size

    def moved(step):
        person, there = scaled(PERSON, LOGARITHMS + step[dofs:]), retract(pose, step[:dofs])
        r = residuals(SETTINGS.terms, replace(MODEL, skeleton=person), there, one)
        return r, landmarks(person, there).ravel()

    still = jnp.zeros(dofs + len(PROPORTIONS))
    (r, at), (J, by) = jax.jit(lambda step: (moved(step), jax.jacfwd(moved)(step)))(still)
    actual = jax.jit(linearised)(SETTINGS.terms, MODEL, LOGARITHMS, pose, one)
    assert actual[1].shape == (r.size, still.size)
    for ours, theirs in zip(actual, (r, J, at, by), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=2e-5, atol=2e-5 * np.abs(theirs).max())
    assert np.abs(J[:, dofs:]).max() > 0.1, "lengths matter to the markers"


# Every term's derivative -------------------------------------------------------------------------

MARKED_FEET = replace(
    MODEL,
    markers=joined_sites(MODEL.markers, landmark_sites(PERSON, ("ankle_l", "ankle_r"))),
)
# Pixels along a side of the distance fields, and of one of their samples.
FIELD, SAMPLE_PX = 40, 12.0


def slanted_fields() -> EdgeFields:
    """Of both arms in both cameras: distances that grow evenly, which have no curvature."""
    rows, columns = np.indices((FIELD, FIELD))
    slope = 4 + 0.05 * columns + 0.08 * rows
    region = Region(np.tile([80.0, 0.0], (2, 2, 1)), np.full((2, 2), SAMPLE_PX))
    return EdgeFields(region, np.tile(slope, (2, 2, 1, 1, 1)), np.ones((2, 2), bool))


def in_double(tree):
    """Floats in double precision, all else as it is."""

    def wide(leaf):
        leaf = np.asarray(leaf)
        return jnp.asarray(leaf, float) if leaf.dtype.kind == "f" else jnp.asarray(leaf)

    return jax.tree.map(wide, tree)


def another_moment() -> dict[str, Any]:
    """All that any term may have measured, of a pose of its own."""
    pose = Pose(*(part[1] for part in truth(COUNT)))
    points, dofs = points_of(truth(COUNT)), ROOT_DOF + pose.angles.size
    pixels = np.asarray(project(CAMERAS[0], jnp.asarray(points)))
    lines = lines_of_sight(CAMERAS[0], tuple(LANDMARKS), pixels, np.full(points.shape[:2], 0.9))
    markers = measurements(COUNT)["markers"][1]
    targets = np.concatenate([markers, measurements(COUNT)["ankles"][1]])
    return {
        **{name: part[1] for name, part in measurements(COUNT).items()},
        "elbows": points[1][ELBOWS] + 0.05,
        "sight_lines": jax.tree.map(lambda part: part[1], lines),
        "goals": Goals(MODEL.effectors, targets, np.array([1.0, 1.0, 0.0, 0.8, 0.8])),
        "centre": pose,
        "estimate": EstimatedPose(pose, np.eye(dofs) + 0.1, np.linspace(-1, 1, dofs)),
        "edges": weighted_edges(MODEL, slanted_fields(), on_device(pose)),
    }


ALL = (*SETTINGS.terms, *GradientSettings().terms, SearchedElbows(), NearEstimate())
TERMS = {type(term).__name__: term for term in ALL}


# Those that ask whether markers hold the feet.
BY_FEET = ("Pelvis", "Ground", "Balance", "PointGoals")
CASES = [(name, "unmarked feet") for name in TERMS] + [(name, "marked feet") for name in BY_FEET]


@jax.jit
def all_jacobians(term, model, pose, measured):
    """Of a term's residuals: by ``linearised``, by central differences, by its own formula."""
    dofs, logarithms = ROOT_DOF + pose.angles.size, jnp.asarray(LOGARITHMS, float)

    def moved(step):
        person = replace(model, skeleton=scaled(model.skeleton, logarithms + step[dofs:]))
        return residuals((term,), person, retract(pose, step[:dofs]), measured)

    steps = 1e-6 * jnp.eye(dofs + len(PROPORTIONS))
    rise = jax.vmap(moved)(steps) - jax.vmap(moved)(-steps)
    person = replace(model, skeleton=scaled(model.skeleton, logarithms))
    alone = linearised_term(term, person, pose, measured)[1].reshape(-1, dofs)
    return linearised((term,), model, logarithms, pose, measured).jacobian, rise.T / 2e-6, alone


def test_there_are_all_terms_of_the_package():
    rooms = Path(jaxmocap.__file__).parent / "evidence"
    declared = re.findall(r"^class (\w+)\(Term\)", "".join(map(_text, rooms.glob("*.py"))), re.M)
    assert sorted(declared) == sorted(TERMS)


def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8")


@pytest.mark.usefixtures("plainly_compiled")
@pytest.mark.parametrize(("name", "feet"), CASES)
@hypothesis_settings(max_examples=10)
@given(pose=poses(beyond=0.3))
def test_a_terms_derivative_is_that_of_finite_differences(name, feet, pose):
    """Anywhere, joints beyond their ranges included."""
    measured = another_moment()
    # The difference from a pose half a turn away is not continuous.
    assume(abs(np.dot(pose.quaternion, measured["centre"].quaternion)) > 0.05)
    if feet == "marked feet":
        measured["markers"] = np.concatenate([measured["markers"], measured["ankles"]])
    with double():
        term, model, measured = in_double(
            (TERMS[name], MODEL if feet == "unmarked feet" else MARKED_FEET, measured)
        )
        ours, expected, alone = map(
            np.asarray, all_jacobians(term, model, on_device(pose), measured)
        )
    largest = max(1.0, np.abs(expected).max(initial=0))
    np.testing.assert_allclose(ours, expected, atol=1e-6 * largest)
    np.testing.assert_allclose(alone, ours[:, : alone.shape[1]], atol=1e-9 * largest)
    # On marked feet the ground and balance are silent.
    silent = feet == "marked feet" and name in ("Ground", "Balance")
    assert (not ours.size) == silent


# A term of one's own -----------------------------------------------------------------------------


@settings
class HandsApart(Term):
    """Wrists that keep a distance, as if they held a stick."""

    metres: Array = traced(0.6, "between the wrists")
    deviation: Array = traced(0.001, "of that, metres")

    def residual(self, model: Model, body: PosedBody, measured: Measurements) -> Array:
        """(1,)."""
        left, right = body.landmarks[landmark_rows(("wrist_l", "wrist_r"))]
        return (jnp.linalg.norm(left - right)[None] - self.metres) / self.deviation


@settings
class SmoothingWithAStick(SmoothingSettings):
    """The settings and one term more."""

    stick: HandsApart = group(HandsApart, "of the hands on a stick")


@settings
class GradientWithAStick(GradientSettings):
    """The settings and one term more."""

    stick: HandsApart = group(HandsApart, "of the hands on a stick")


def hands_apart(points: np.ndarray) -> np.ndarray:
    """Distances (...) of the wrists among landmarks (..., L, 3), metres."""
    left, right = np.moveaxis(points[..., landmark_rows(("wrist_l", "wrist_r")), :], -2, 0)
    return np.linalg.norm(left - right, axis=-1)


def test_a_new_term_takes_part_in_smoothing():
    count = 6
    measured = measurements(count)
    measured["markers"][:, 1:] = np.nan
    given = problem(count, views(count).none, measured)

    def smoothed(chosen: SmoothingSettings) -> np.ndarray:
        actual = smooth_poses(replace(given, settings=chosen), disturbed(count), (1.0,))
        return hands_apart(points_of(actual.trajectory.poses))

    plain, own = smoothed(SmoothingSettings()), smoothed(SmoothingWithAStick())
    assert np.abs(plain - 0.6).min() > 0.02
    np.testing.assert_allclose(own, 0.6, atol=0.005)
    np.testing.assert_allclose(
        smoothed(SmoothingWithAStick(stick=HandsApart(metres=0.45))), 0.45, atol=0.005
    )


@settings
class IKWithAStick(IKSettings):
    """The settings and one term more."""

    stick: HandsApart = group(HandsApart, "of the hands on a stick")


def test_a_new_term_takes_part_in_inverse_kinematics():
    start = on_device(Pose(*(part[1] for part in truth(COUNT))))
    model = jax.tree.map(jnp.asarray, MODEL)
    goals = another_moment()["goals"]._replace(weights=np.array([1.0, 0, 0, 1, 1], np.float32))
    solve = jax.jit(lambda chosen: reach(model, chosen, {"goals": on_device(goals)}, start)[0])
    apart = [hands_apart(points_of(jax.tree.map(lambda part: part[None], solve(chosen))))
             for chosen in (IKSettings(), IKWithAStick())]  # fmt: skip
    assert abs(apart[0] - 0.6) > 0.02
    np.testing.assert_allclose(apart[1], 0.6, atol=0.001)


def test_a_new_term_takes_part_in_the_gradient_refinement():
    start = on_device(Pose(*(part[1] for part in truth(COUNT))))
    model = jax.tree.map(jnp.asarray, MODEL)
    measured = another_moment()
    goals = measured["goals"]._replace(weights=np.array([1.0, 0, 0, 1, 1], np.float32))
    free = jnp.ones(PERSON.costs.shape, bool)
    aims = Aims(on_device(goals), on_device(measured["elbows"]), start, free)
    fields = jax.tree.map(lambda part: np.asarray(part, np.float32), slanted_fields())
    fields = fields._replace(available=np.ones((2, 2), bool))

    def refined(chosen: GradientSettings) -> np.ndarray:
        settings = Settings(refine="gradient", search=False, gradient=chosen)
        actual = jax.jit(refine_body)(model, settings, fields, start, aims).pose
        return hands_apart(np.asarray(landmarks(PERSON, actual)))

    plain, own = refined(GradientSettings(steps=40)), refined(GradientWithAStick(steps=40))
    assert abs(plain - 0.6) > 0.02 and abs(own - 0.6) < 0.005
