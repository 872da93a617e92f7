"""The floor under somebody's feet, and joints most of which are at ease."""

from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

from jaxmocap.body.skeleton import LANDMARKS
from jaxmocap.evidence.ground import FeetOnFloor
from jaxmocap.evidence.posture import MostlyRelaxedPosture


def test_feet_stand_on_the_floor_and_nothing_lies_below_it():
    """One ankle at its height costs nothing, however high the other is; a jump costs little."""
    term, heights = FeetOnFloor(), np.full(len(LANDMARKS), 1.0, np.float32)
    heights[LANDMARKS.index("ankle_l")] = float(term.ankle)

    def cost(above: float) -> float:
        points = np.zeros((len(LANDMARKS), 3), np.float32)
        points[:, 2] = heights + np.float32(above)
        body = SimpleNamespace(landmarks=jnp.asarray(points))
        return float(jnp.sum(term.residual(None, body, {}) ** 2))  # type: ignore[arg-type]

    assert cost(0.0) == pytest.approx(0.0, abs=1e-4)
    assert cost(0.01) == pytest.approx((0.01 / float(term.height)) ** 2, rel=0.1)
    assert cost(0.6) < 30 and cost(-0.17) > (0.1 / float(term.height)) ** 2


def test_most_joints_are_near_ease_and_a_few_may_be_far():
    usual = np.array([0.5, 1.0], np.float32)
    skeleton = SimpleNamespace(relaxed=jnp.zeros(2), usual_deviations=jnp.asarray(usual))
    model, term = SimpleNamespace(skeleton=skeleton), MostlyRelaxedPosture(ease=1.0)

    def cost(*angles: float) -> float:
        body = SimpleNamespace(pose=SimpleNamespace(angles=jnp.asarray(angles)))
        return float(jnp.sum(term.residual(model, body, {}) ** 2))  # type: ignore[arg-type]

    assert cost(0.01, 0.0) == pytest.approx((0.01 / 0.5) ** 2, rel=1e-2)
    assert cost(0.0, 20.0) < 0.1 * 20.0**2
    assert cost(0.5, 1.0) == pytest.approx(cost(0.5, 0.0) + cost(0.0, 1.0), rel=1e-5)
