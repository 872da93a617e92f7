"""Balance: who stands has the centre of gravity over the middle of the feet.

INPUTS: a posed body. OUTPUTS: whitened residuals.
"""

from typing import ClassVar

import jax.numpy as jnp
from jax import Array

from jaxmocap.body.model import Model
from jaxmocap.body.skeleton import landmark_rows
from jaxmocap.compilation.settings import settings, traced
from jaxmocap.evidence.terms import Measurements, PosedBody, Term

# Their middle is the middle of the base of support.
BASE = landmark_rows(("ankle_l", "ankle_r", "toe_l", "toe_r"))


@settings
class Balance(Term):
    """Standing in balance."""

    errors_last: ClassVar[bool] = True
    deviation: Array = traced(
        0.06,
        "of the middle of feet that no marker holds about the point below the centre of gravity, "
        "metres",
    )

    def residual(self, model: Model, body: PosedBody, measured: Measurements) -> Array:
        """(2,); none where a marker holds a foot."""
        if not model.no_foot_is_marked:
            return jnp.zeros(0, body.landmarks.dtype)
        middle = jnp.mean(body.landmarks[BASE], 0)
        return (body.centre_of_gravity - middle)[:2] / self.deviation
