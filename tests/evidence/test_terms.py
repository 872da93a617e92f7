"""Terms of evidence: a new one is one class and one line; derivatives of all that there are."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import on_device
from painted_motion import (
    CAMERAS,
    MODEL,
    PERSON,
    SETTINGS,
    measurements,
    points_of,
    truth,
)  # fmt: skip

from jaxmocap.body.kinematics import landmarks
from jaxmocap.body.pose import retract
from jaxmocap.body.proportions import PROPORTIONS, scaled
from jaxmocap.body.skeleton import LANDMARKS, ROOT_DOF
from jaxmocap.evidence.keypoints import lines_of_sight
from jaxmocap.evidence.terms import linearised, residuals
from jaxmocap.geometry.cameras import project

LOGARITHMS = jnp.asarray([0.04, -0.03])
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
    found = jax.jit(linearised)(SETTINGS.terms, MODEL, LOGARITHMS, pose, one)
    assert found[1].shape == (r.size, still.size)
    for ours, theirs in zip(found, (r, J, at, by), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=2e-5, atol=2e-5 * np.abs(theirs).max())
    assert np.abs(J[:, dofs:]).max() > 0.1, "lengths matter to the markers"
