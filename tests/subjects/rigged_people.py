"""The smallest file of people with rigs: one person, eight vertices, joints that hang in chains."""

import numpy as np

from jaxmocap.synthetic.people.rigged_mesh import JOINTS

# Of each of JOINTS: which of them it hangs on.
PARENTS = (-1, 19, 18, 18, 2, 3, 4, 5, 6, 7, 0, 0, 10, 11, 12, 13, 14, 15, 0, 18)


def rigged(who: str = "woman", **change: np.ndarray) -> dict[str, np.ndarray]:
    """The arrays of such a file, some of them others."""
    rng = np.random.default_rng(0)
    vertices = rng.uniform(0, 0.3, (1, 8, 3))
    vertices[0, 0, 2], vertices[0, 1, 2] = 0.0, 1.7
    return {
        "people": np.array([who]),
        "vertices": vertices,
        "quads": np.array([[0, 1, 2, 3]]),
        "skin_joint": np.zeros((8, 1), int),
        "skin_weight": np.ones((8, 1)),
        "joint_names": np.array(JOINTS),
        "joint_parents": np.array(PARENTS),
        "joints": rng.uniform(0, 2, (1, len(JOINTS), 3)),
    } | change
