"""Joint limits: no joint goes far beyond its range.

INPUTS: a posed body. OUTPUTS: whitened residuals.
"""

from jax import Array

from jaxmocap.body.model import Model
from jaxmocap.body.pose import beyond_limits
from jaxmocap.compilation.settings import settings, traced
from jaxmocap.evidence.terms import Measurements, PosedBody, Term


@settings
class JointLimits(Term):
    """Ranges of the joints."""

    deviation: Array = traced(0.02, "by which a joint may exceed its range, radians")

    def residual(self, model: Model, body: PosedBody, measured: Measurements) -> Array:
        """(D,)."""
        return beyond_limits(model.skeleton.limits, body.pose.angles) / self.deviation
