"""What a frame's pose answers for: its derivative, against going forwards through everything."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import on_device
from jaxmocap.evidence.residuals import linearised_residuals, residuals
from painted_motion import CAMERAS, MARKERS, PERSON, SETTINGS, known, points_of, truth

from jaxmocap.body.kinematics import landmarks
from jaxmocap.body.pose import retract
from jaxmocap.body.proportions import PROPORTIONS, scaled
from jaxmocap.body.skeleton import LANDMARKS, ROOT_DOF
from jaxmocap.evidence.keypoints import lines_of_sight
from jaxmocap.geometry.cameras import project

LOGARITHMS = jnp.asarray([0.04, -0.03])
COUNT = 2


def frame(kind: str):
    """A pose, and what is known of another, so that nothing is at rest."""
    there = known(COUNT)
    if kind == "a marker lost, feet free":
        targets = np.array(there.targets)
        targets[:, 1] = np.nan
        there = there._replace(targets=targets, feet=np.ones_like(there.feet))
    if kind == "elbows with goals":
        there = there._replace(goals=np.full((COUNT, 2, 3), 0.3, np.float32))
    if kind == "lines of sight":
        seen = np.asarray(project(CAMERAS[0], jnp.asarray(points_of(truth(COUNT)))))
        names = tuple(LANDMARKS)
        lines = lines_of_sight(CAMERAS[0], names, seen, np.full(seen.shape[:2], 0.9))
        there = there._replace(lines=lines)
    pose, one = jax.tree.map(lambda part: on_device(part[1]), (truth(COUNT), there))
    step = 0.1 * np.random.default_rng(3).standard_normal(ROOT_DOF + pose.angles.size)
    return retract(pose, on_device(step)), one


@pytest.mark.parametrize(
    "kind",
    ["markers", "a marker lost, feet free", "elbows with goals", "lines of sight"],
)
def test_the_derivative_is_that_of_going_through_everything(kind):
    pose, one = frame(kind)
    dofs = ROOT_DOF + pose.angles.size

    def moved(step):
        person, there = scaled(PERSON, LOGARITHMS + step[dofs:]), retract(pose, step[:dofs])
        r = residuals(person, MARKERS, SETTINGS, there, one)
        return r, landmarks(person, there).ravel()

    still = jnp.zeros(dofs + len(PROPORTIONS))
    (r, at), (J, by) = jax.jit(lambda step: (moved(step), jax.jacfwd(moved)(step)))(still)
    found = jax.jit(linearised_residuals)(PERSON, LOGARITHMS, MARKERS, SETTINGS, pose, one)
    assert found[1].shape == (r.size, still.size)
    for ours, theirs in zip(found, (r, J, at, by), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=2e-5, atol=2e-5 * np.abs(theirs).max())
    assert np.abs(J[:, dofs:]).max() > 0.1, "lengths matter to the markers"
