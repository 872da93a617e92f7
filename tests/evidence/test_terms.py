"""Terms of evidence: a new one is one class and one line; derivatives of all that there are."""

import re
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import double, in_double, on_device, poses
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
    pose_at,
    problem,
    truth,
    views,
)

import jaxmocap
from jaxmocap.body.kinematics import joined_sites, landmark_sites, landmarks
from jaxmocap.body.model import Model
from jaxmocap.body.pose import Pose, retract
from jaxmocap.body.proportions import PROPORTIONS, scale_skeleton
from jaxmocap.body.skeleton import LANDMARKS, landmark_rows
from jaxmocap.body.tree import ROOT_DOF
from jaxmocap.compilation.settings import group, settings, traced
from jaxmocap.evidence.edges import EdgeEvidence, EdgeFields
from jaxmocap.evidence.expansion import expand_terms, linearise_term, linearise_terms
from jaxmocap.evidence.ground import ANKLES, KNEES, AnkleRange, FeetOnFloor, KneesOverFeet
from jaxmocap.evidence.keypoints import EstimatedDepths, lines_of_sight
from jaxmocap.evidence.markers import Goals, MarkerPositions, PointGoals, SearchedElbows
from jaxmocap.evidence.posture import (
    USUAL_ROWS,
    EasyPosture,
    EstimatedPose,
    LastPose,
    MostlyRelaxedPosture,
    NearEstimate,
    Pelvis,
    Usual,
)
from jaxmocap.evidence.terms import (
    Measurements,
    PosedBody,
    Term,
    posed_body,
    residuals,
)
from jaxmocap.geometry.cameras import project
from jaxmocap.hybrid.fit import Aims, refine_body
from jaxmocap.hybrid.ik import reach
from jaxmocap.hybrid.paper.chamfer import Chamfer
from jaxmocap.hybrid.settings import GradientSettings, IKSettings, Settings
from jaxmocap.images.regions import Region
from jaxmocap.smoothing.linearise import smooth_poses
from jaxmocap.smoothing.settings import SmoothingSettings

LOGARITHMS = np.array([0.04, -0.03], np.float32)
COUNT = 2
PROJECT = jax.jit(project)


def frame(kind: str):
    """A pose, and measurements of another, so that nothing is at rest."""
    there = measurements(COUNT)
    if kind == "a marker lost":
        there.markers[:, 1] = np.nan
    if kind == "elbows with goals":
        there = there._replace(elbows=np.full((COUNT, 2, 3), 0.3, np.float32))
    # One program for all kinds: lines of no confidence where none is meant.
    pixels = np.asarray(PROJECT(CAMERAS[0], jnp.asarray(points_of(truth(COUNT)))))
    sure = np.full(pixels.shape[:2], 0.9 if kind == "lines of sight" else 0.0)
    there = there._replace(sight_lines=lines_of_sight(CAMERAS[0], LANDMARKS, pixels, sure))
    pose, one = jax.tree.map(lambda part: on_device(part[1]), (truth(COUNT), there))
    step = 0.1 * np.random.default_rng(3).standard_normal(ROOT_DOF + pose.angles.size)
    return jax.jit(retract)(pose, on_device(step)), one


@jax.jit
def through_everything(pose, one):
    """Residuals and landmarks, their derivatives by pushing tangents through; and ours."""
    dofs = ROOT_DOF + pose.angles.size

    def moved(step):
        person, there = scale_skeleton(PERSON, LOGARITHMS + step[dofs:]), retract(pose, step[:dofs])
        r = residuals(SETTINGS.terms, replace(MODEL, skeleton=person), there, one)
        return r, landmarks(person, there).ravel()

    still = jnp.zeros(dofs + len(PROPORTIONS))
    ours = linearise_terms(SETTINGS.terms, MODEL, LOGARITHMS, pose, one)
    return moved(still), jax.jacfwd(moved)(still), ours


@pytest.mark.parametrize(
    "kind",
    ["markers", "a marker lost", "elbows with goals", "lines of sight"],
)
def test_the_derivative_is_that_of_going_through_everything(kind):
    pose, one = frame(kind)
    (r, at), (J, by), actual = through_everything(pose, one)
    lengths = J[:, ROOT_DOF + pose.angles.size :]
    assert actual[1].shape == (r.size, ROOT_DOF + pose.angles.size + len(PROPORTIONS))
    for ours, theirs in zip(actual, (r, J, at, by), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=2e-5, atol=2e-5 * np.abs(theirs).max())
    assert np.abs(lengths).max() > 0.1, "lengths matter to the markers"


def test_a_term_s_own_formula_is_its_derivative():
    class Stated(MarkerPositions):
        def jacobian(self, model, body, measured):
            return jnp.full((*body.markers.shape, model.skeleton.costs.size), 7.0)

    pose, one = frame("markers")
    linearised = jax.jit(partial(linearise_terms, (Stated(),), MODEL))
    J = linearised(LOGARITHMS, pose, one).jacobian
    by_pose = J[:, : -len(LOGARITHMS)]
    np.testing.assert_array_equal(by_pose, np.full(by_pose.shape, 7.0))


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


@cache
def another_moment() -> Measurements:
    """All that any term may have measured, of a pose of its own."""
    pose = Pose(*(part[1] for part in truth(COUNT)))
    points, dofs = points_of(truth(COUNT)), ROOT_DOF + pose.angles.size
    pixels = np.asarray(PROJECT(CAMERAS[0], jnp.asarray(points)))
    sure = np.full(points.shape[:2], 0.9)
    depths = np.linspace(-0.4, 0.4, sure.size).reshape(sure.shape)
    lines = lines_of_sight(CAMERAS[0], LANDMARKS, pixels, sure, depths)
    measured, lines = jax.tree.map(lambda part: part[1], (measurements(COUNT), lines))
    targets = np.concatenate([measured.markers, measured.ankles])
    return measured._replace(
        elbows=points[1][ELBOWS] + 0.05,
        sight_lines=lines,
        goals=Goals(MODEL.effectors, targets, np.array([1.0, 1.0, 0.0, 0.8, 0.8])),
        usual=Usual(
            points[1][USUAL_ROWS] + 0.05, np.eye(3) + np.linspace(0, 9, 45).reshape(5, 3, 3)
        ),
        centre=pose,
        last=LastPose(pose, np.linspace(0.01, 0.2, dofs - ROOT_DOF), np.bool_(True)),
        estimate=EstimatedPose(pose, np.eye(dofs) + 0.1, np.linspace(-1, 1, dofs)),
        edges=jax.jit(EdgeEvidence.weigh)(AREA, MODEL, slanted_fields(), on_device(pose)),
    )


MORE = SearchedElbows(), NearEstimate(), EasyPosture(), EdgeEvidence(), EstimatedDepths()
MORE += FeetOnFloor(), MostlyRelaxedPosture(), KneesOverFeet()
ALL = (*SETTINGS.terms, *GradientSettings().terms, *MORE)
AREA = Chamfer(drawn=False)
TERMS = {type(term).__name__: term for term in ALL} | {"EdgeEvidence over areas": AREA}
# Which feet are marked matters to these alone.
OF_FEET = ("MarkerPositions", "Pelvis", "Ground", "AnkleRange", "KneesOverFeet", "Balance")


@jax.jit
def all_jacobians(terms, model, pose, measured):
    """Of all residuals of terms, and the terms' sizes.

    By ``linearise_terms``, by central differences, and by the terms' own formulas.
    """
    dofs, logarithms = ROOT_DOF + pose.angles.size, jnp.asarray(LOGARITHMS, float)

    def moved(step):
        person = replace(model, skeleton=scale_skeleton(model.skeleton, logarithms + step[dofs:]))
        return residuals(terms, person, retract(pose, step[:dofs]), measured)

    steps = 1e-6 * jnp.eye(dofs + len(PROPORTIONS))
    ahead, behind = jnp.split(jax.vmap(moved)(jnp.concatenate([steps, -steps])), 2)
    ours = linearise_terms(terms, model, logarithms, pose, measured).jacobian
    person = replace(model, skeleton=scale_skeleton(model.skeleton, logarithms))
    own = [linearise_term(term, person, pose, measured)[1].reshape(-1, dofs) for term in terms]
    sizes = jnp.array([len(part) for part in own])
    return ours, (ahead - behind).T / 2e-6, jnp.concatenate(own), sizes


def test_there_are_all_terms_of_the_package():
    package = Path(jaxmocap.__file__).parent
    files = [*package.glob("evidence/*.py"), *package.glob("hybrid/**/*.py")]
    declared = re.findall(
        r"^class (\w+)\((?:Term|EdgeEvidence|RelaxedPosture)\)", "".join(map(_text, files)), re.M
    )
    assert sorted(declared) == sorted({type(term).__name__ for term in TERMS.values()})


def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8")


@pytest.mark.parametrize("feet", ["unmarked feet", "marked feet"])
@hypothesis_settings(max_examples=10)
@given(pose=poses(beyond=0.3))
def test_every_terms_derivative_is_that_of_finite_differences(feet, pose):
    """Anywhere, joints beyond their ranges included; all terms in one compilation."""
    measured = another_moment()
    # The difference from a pose half a turn away is not continuous.
    assume(abs(np.dot(pose.quaternion, measured.centre.quaternion)) > 0.05)
    names, model = tuple(TERMS), MODEL
    if feet == "marked feet":
        markers = np.concatenate([measured.markers, measured.ankles])
        measured = measured._replace(markers=markers)
        names, model = OF_FEET, MARKED_FEET
    with double():
        terms = tuple(TERMS[name] for name in names)
        terms, model, measured = in_double((terms, model, measured))
        jacobians = all_jacobians(terms, model, on_device(pose), measured)
    *each, sizes = map(np.asarray, jacobians)
    parts = (np.split(jacobian, np.cumsum(sizes)[:-1]) for jacobian in each)
    for name, ours, expected, own in zip(names, *parts, strict=True):
        largest = max(1.0, np.abs(expected).max(initial=0))
        np.testing.assert_allclose(ours, expected, atol=1e-6 * largest, err_msg=name)
        by_pose = ours[:, : own.shape[1]]
        np.testing.assert_allclose(own, by_pose, atol=1e-9 * largest, err_msg=name)
        # Where markers hold the feet, the ground, ankles and balance are silent.
        silent = feet == "marked feet" and name not in ("MarkerPositions", "Pelvis")
        assert (not ours.size) == silent, name


@pytest.mark.parametrize("name", TERMS)
def test_what_a_term_needs_and_was_not_measured_is_stated(name):
    """Others have no residual, or one of the pose alone."""
    term, pose = TERMS[name], on_device(another_moment().centre)
    if not term.needs:
        assert np.isfinite(jax.jit(partial(residuals, (term,), MODEL))(pose, Measurements())).all()
        return
    for missing in term.needs:
        less = another_moment()._replace(**{missing: None})
        for call in (residuals, expand_terms):
            with pytest.raises(ValueError, match=f"needs measured '{missing}', which is missing"):
                jax.eval_shape(partial(call, (term,), MODEL), pose, less)


@jax.jit
def all_curvatures(terms, model, pose, measured):
    """Second derivatives times residuals of terms, summed: (T, N, N) ours and by differences."""
    still = jnp.zeros(ROOT_DOF + pose.angles.size)
    steps = 1e-5 * jnp.eye(still.size)

    def expected(term):
        weights = jax.lax.stop_gradient(residuals((term,), model, pose, measured))

        def pull(step):
            def weighed(further):
                there = retract(retract(pose, further), step)
                return jnp.vdot(weights, residuals((term,), model, there, measured))

            return jax.grad(weighed)(still)

        ahead, behind = jax.vmap(pull)(steps), jax.vmap(pull)(-steps)
        return symmetric((ahead - behind) / 2e-5)

    def symmetric(matrix):
        return (matrix + matrix.T) / 2

    ours = [symmetric(expand_terms((term,), model, pose, measured)[2]) for term in terms]
    return jnp.stack(ours), jnp.stack([expected(term) for term in terms])


@hypothesis_settings(max_examples=5)
@given(pose=poses(beyond=0.3))
def test_the_second_order_of_goals_and_of_the_secondary_task_is_that_of_differences(pose):
    measured = another_moment()
    assume(abs(np.dot(pose.quaternion, measured.centre.quaternion)) > 0.2)
    with double():
        terms = (PointGoals(), EasyPosture(), Pelvis())
        given_ = in_double((terms, MODEL, measured))
        ours, expected = all_curvatures(given_[0], given_[1], on_device(pose), given_[2])
        for term, mine, other in zip(terms, np.asarray(ours), np.asarray(expected), strict=True):
            largest = max(1.0, np.abs(other).max())
            np.testing.assert_allclose(
                mine, other, atol=1e-5 * largest, err_msg=type(term).__name__
            )


def test_the_second_order_keeps_the_order_of_terms():
    """Formulas or none: rows are where the residuals have them."""
    terms = (Pelvis(), PointGoals(), SearchedElbows(), EasyPosture(), FeetOnFloor())
    with double():
        terms, model, measured = in_double((terms, MODEL, another_moment()))
        pose = jax.jit(retract)(measured.centre, jnp.full(PERSON.costs.size, 0.01))
        r, J, _ = jax.jit(expand_terms)(terms, model, pose, measured)
        expected = jax.jit(linearise_terms)(terms, model, jnp.zeros(0), pose, measured)
    np.testing.assert_allclose(r, expected.residuals, atol=1e-9)
    np.testing.assert_allclose(J, expected.jacobian, atol=1e-6)


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
    measured.markers[:, 1:] = np.nan
    given = problem(count, views(count).none, measured)

    for metres in (0.6, 0.45):
        chosen = SmoothingWithAStick(stick=HandsApart(metres=metres))
        actual = smooth_poses(replace(given, settings=chosen), disturbed(count), (1.0,))
        apart = hands_apart(points_of(actual.trajectory.poses))
        np.testing.assert_allclose(apart, metres, atol=0.005)


@settings
class IKWithAStick(IKSettings):
    """The settings and one term more."""

    stick: HandsApart = group(HandsApart, "of the hands on a stick")


def test_a_new_term_takes_part_in_inverse_kinematics():
    start = on_device(Pose(*(part[1] for part in truth(COUNT))))
    model = jax.tree.map(jnp.asarray, MODEL)
    goals = another_moment().goals._replace(weights=np.array([1.0, 0, 0, 1, 1], np.float32))
    solve = jax.jit(
        lambda chosen: reach(model, chosen, Measurements(goals=on_device(goals)), start)
    )
    for metres in (0.6, 0.45):
        found = solve(IKWithAStick(stick=HandsApart(metres=metres)))
        apart = hands_apart(points_of(jax.tree.map(lambda part: part[None], found)))
        np.testing.assert_allclose(apart, metres, atol=0.001)


def test_a_new_term_takes_part_in_the_gradient_refinement():
    start = on_device(Pose(*(part[1] for part in truth(COUNT))))
    model = jax.tree.map(jnp.asarray, MODEL)
    measured = another_moment()
    goals = measured.goals._replace(weights=np.array([1.0, 0, 0, 1, 1], np.float32))
    free = jnp.ones(PERSON.costs.shape, bool)
    aims = Aims(on_device(goals), on_device(measured.elbows), start, free)
    fields = jax.tree.map(lambda part: np.asarray(part, np.float32), slanted_fields())
    fields = fields._replace(available=np.ones((2, 2), bool))

    settings = Settings(refine="gradient", search=False, gradient=GradientWithAStick())
    edges = jax.jit(EdgeEvidence.weigh)(settings.edges, model, fields, start)
    actual, _ = jax.jit(refine_body)(model, settings, edges, start, aims)
    before, after = (hands_apart(points_of(jax.tree.map(lambda part: part[None], each)))
                     for each in (start, actual))  # fmt: skip
    assert abs(before - 0.6) > 0.02 and abs(after - 0.6) < 0.005


# Floor and ease -----------------------------------------------------------------------------------


def test_feet_stand_on_the_floor_and_nothing_lies_below_it():
    """One ankle at its height costs nothing, however high the other is; a jump costs little."""
    term, heights = FeetOnFloor(), np.full(len(LANDMARKS), 1.0, np.float32)
    heights[LANDMARKS.index("ankle_l")] = float(term.ankle)

    def cost(above: float) -> float:
        points = np.zeros((len(LANDMARKS), 3), np.float32)
        points[:, 2] = heights + np.float32(above)
        body = SimpleNamespace(landmarks=jnp.asarray(points))
        return float(jnp.sum(term.residual(None, body, Measurements()) ** 2))  # type: ignore[arg-type]

    assert cost(0.0) == pytest.approx(0.0, abs=1e-4)
    assert cost(0.01) == pytest.approx((0.01 / float(term.height)) ** 2, rel=0.1)
    assert cost(0.6) < 30 and cost(-0.17) > (0.1 / float(term.height)) ** 2


def shanks(lean: float, lifted: float = 0.0, heading: float = 0.0) -> float:
    """What shanks cost that lean so many degrees along x, of a body that faces that way from x."""
    points, standing = np.zeros((len(LANDMARKS), 3)), np.array([[0, 0.1, 0.07], [0, -0.1, 0.07]])
    points[ANKLES] = standing + np.array([0, 0, lifted])
    points[KNEES] = points[ANKLES] + 0.4 * np.array(
        [np.sin(np.radians(lean)), 0, np.cos(np.radians(lean))]
    )
    c, s = np.cos(np.radians(heading)), np.sin(np.radians(heading))
    R = jnp.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    body = SimpleNamespace(landmarks=jnp.asarray(points), R_world_pelvis=R)
    residual = AnkleRange().residual(MODEL, body, Measurements(ankles=standing))  # type: ignore[arg-type]
    return float(jnp.sum(residual**2))


def test_shanks_lean_as_far_as_ankles_let_them():
    """Over a flat foot: one that is lifted lets its shank lie."""
    assert max(shanks(lean) for lean in (-15, 0, 15, 30)) < 0.2
    assert shanks(55) > 5 and shanks(80) > 2 * shanks(55) and shanks(-50) > 5
    assert shanks(80, lifted=0.12) < 0.02 * shanks(80)
    # Ahead is where the body faces.
    assert shanks(80, heading=90) < 0.2 and shanks(-35, heading=180) < 0.2 < shanks(-35)


def test_most_joints_are_near_ease_and_a_few_may_be_far():
    usual = np.array([0.5, 1.0], np.float32)
    skeleton = SimpleNamespace(
        relaxed=jnp.zeros(2), usual_deviations=jnp.asarray(usual), tree=SimpleNamespace(
            groups_of_joints=("arm", "leg")
        )
    )  # fmt: skip
    model, term = SimpleNamespace(skeleton=skeleton), MostlyRelaxedPosture(ease=1.0)

    def cost(*angles: float) -> float:
        body = SimpleNamespace(pose=SimpleNamespace(angles=jnp.asarray(angles)))
        return float(jnp.sum(term.residual(model, body, Measurements()) ** 2))  # type: ignore[arg-type]

    assert cost(0.01, 0.0) == pytest.approx((0.01 / 0.5) ** 2, rel=1e-2)
    assert cost(0.0, 20.0) < 0.1 * 20.0**2
    assert cost(0.5, 1.0) == pytest.approx(cost(0.5, 0.0) + cost(0.0, 1.0), rel=1e-5)


def posture_costs(hips: float, *knees: float) -> float:
    """What joints cost that are at ease but for hips and knees, degrees."""
    pose = pose_at(0.0)
    angles = np.array(PERSON.relaxed)
    for side, knee in zip("lr", knees, strict=True):
        angles[PERSON.tree.joint(f"hip_flexion_{side}")] = np.radians(hips)
        angles[PERSON.tree.joint(f"knee_flexion_{side}")] = np.radians(knee)
    body = SimpleNamespace(pose=pose._replace(angles=jnp.asarray(angles)))
    residual = SETTINGS.posture.residual(MODEL, body, Measurements())  # type: ignore[arg-type]
    return float(jnp.sum(residual**2))


def test_who_bends_both_knees_bends_the_hips_along():
    """Squats that bow by 41 degrees were taken for kneeling upright, feet 48 cm behind."""
    assert posture_costs(75, 100, 100) < posture_costs(15, 100, 100) - 5
    # Not of one knee, as of who kicks or walks, nor of legs that stand.
    assert posture_costs(15, 100, 20) < posture_costs(75, 100, 20) - 5
    assert posture_costs(15, 30, 30) < posture_costs(75, 30, 30) - 5


POSED, PELVIS = jax.jit(posed_body), jax.jit(Pelvis.residual)


def off_upright(trunk: float, legs: float = 0.0) -> float:
    """What the pelvis costs of a body that leans ahead and bends its legs by so many degrees."""
    pose = pose_at(0.0)
    angles = np.array(pose.angles)
    for side in "lr":
        angles[PERSON.tree.joint(f"knee_flexion_{side}")] = 2 * np.radians(legs)
        angles[PERSON.tree.joint(f"hip_flexion_{side}")] = np.radians(legs + trunk)
    lean = np.radians(trunk) / 2
    pose = pose._replace(angles=angles, quaternion=np.array([np.cos(lean), 0, np.sin(lean), 0]))
    pose = jax.tree.map(lambda part: jnp.asarray(part, jnp.float32), pose)
    term, measured = Pelvis(lean=0.05), Measurements(upright=np.zeros(2), facing=np.eye(3)[0])
    residual = PELVIS(term, MODEL, POSED(MODEL, pose), measured)
    return float(np.sum(np.asarray(residual) ** 2))


def test_who_stands_is_upright_and_who_bends_the_legs_may_bow():
    """Nobody leans back; who sits is upright, who squats bows; touching the toes is possible."""
    assert off_upright(0) < 0.2 and off_upright(2) < 1
    assert off_upright(-10) > 10 and off_upright(-10, 45) > 10
    assert off_upright(0, 45) < 0.2 and off_upright(25, 45) < 0.2
    assert off_upright(25) > 2 * off_upright(8) > 6
    assert off_upright(80) < 40
