"""A person who exercises with every joint and the position off: where a search begins.

INPUTS: an Exerciser, a generator. OUTPUTS: a DisplacedExerciser.
"""

from dataclasses import dataclass, fields

import numpy as np

from jaxmocap.synthetic.movements.exerciser import Exerciser
from jaxmocap.synthetic.movements.splines import KeyStance
from jaxmocap.synthetic.people.rigged_mesh import unit

# First channel and number of channels of each joint, which one error rotates.
JOINTS = ((3, 3), (6, 3), (9, 1), *((i, n) for s in (10, 14) for i, n in ((s, 3), (s + 3, 1))))
JOINTS += tuple((i, n) for s in (18, 23) for i, n in ((s, 3), (s + 3, 1), (s + 4, 1)))


@dataclass(frozen=True)
class DisplacedExerciser(Exerciser):
    """One whose joints are rotated, and whose body is moved, by the same at all times.

    Attributes:
        angle_errors: (28,) added to the channels, degrees.
        position_error: (3,) added to the position, metres.
    """

    angle_errors: np.ndarray | float = 0.0
    position_error: np.ndarray | float = 0.0

    def rig(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """As high above the floor as without the errors."""
        channels = self.curves(np.atleast_1d(times))
        places = self.places(channels) + self.position_error
        return self.rig_at(channels + self.angle_errors, places)


def displaced(
    person: Exerciser, rng: np.random.Generator, degrees: float = 5.0, metres: float = 0.03
) -> DisplacedExerciser:
    """The same, with every joint rotated by so much in some direction, and the body moved."""
    errors = np.zeros_like(KeyStance().channels())
    for first, count in JOINTS:
        direction = rng.standard_normal(count)
        errors[first : first + count] = degrees * direction / np.linalg.norm(direction)
    aside = metres * unit(rng.standard_normal(3))
    own = {field.name: getattr(person, field.name) for field in fields(Exerciser)}
    if person.hands is not None:
        own["hands"] = person.hands + aside
    return DisplacedExerciser(**own, angle_errors=errors, position_error=aside)
