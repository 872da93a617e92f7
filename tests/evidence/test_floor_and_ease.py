"""The floor under somebody's feet, joints most of which are at ease, a trunk that is upright."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from painted_motion import MODEL, PERSON, pose_at

from jaxmocap.body.skeleton import LANDMARKS
from jaxmocap.evidence.ground import ANKLES, KNEES, AnkleRange, FeetOnFloor
from jaxmocap.evidence.posture import MostlyRelaxedPosture, Pelvis
from jaxmocap.evidence.terms import Measurements, posed_body


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
