"""The true silhouettes of the synthetic photographs."""

import numpy as np

from jaxmocap.synthetic.people.rigged_mesh import Rig
from jaxmocap.synthetic.photographs import camera_of, person_in_stance
from jaxmocap.synthetic.renderer import silhouette


def true_person_mask(rig: Rig, name: str) -> np.ndarray:
    """(H, W) bool, the pixels that show the person in a photograph."""
    person = person_in_stance(rig, name)
    vertices = person.vertices(np.zeros(1))[0]
    return silhouette(person.mesh, camera_of(rig, name), vertices)
