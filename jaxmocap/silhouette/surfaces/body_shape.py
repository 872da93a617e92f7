"""A person's shape as rims are found on it: bones, and a dense surface around them.

INPUTS: a skeleton, a surface around it. OUTPUTS: a BodyShape; its nodes as points on bones.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jaxmocap.body.skeleton import Skeleton
from jaxmocap.body.surfaces.loft import rest_joints
from jaxmocap.body.surfaces.surface import BodyPoints, Skin, Surface, low_pass, skin_of

# The level of the surface with all its frequencies.
FULL = -1


class BodyShape(NamedTuple):
    """Bones and skin of one person; passes over a recording correct both.

    Attributes:
        skeleton: the bones.
        surfaces: its low-passes, coarse to fine, and itself, node for node.
        skins: of ``surfaces``, as kinematics move them.
    """

    skeleton: Skeleton
    surfaces: tuple[Surface, ...]
    skins: tuple[Skin, ...]

    @classmethod
    def of(
        cls, skeleton: Skeleton, surface: Surface, levels: Sequence[tuple[int, int]]
    ) -> "BodyShape":
        """Of a surface as dense as rims need it, and its low-passes.

        Args:
            skeleton: of the person.
            surface: around it.
            levels: coarse to fine: the lowest harmonics around and waves along each limb, (3.17).
        """
        joints = rest_joints(skeleton)
        every = (*(low_pass(surface, joints, *level) for level in levels), surface)
        return cls(skeleton, every, tuple(skin_of(each, joints) for each in every))

    @property
    def surface(self) -> Surface:
        """The dense one, whose nodes rims consist of."""
        return self.surfaces[FULL]

    def points(self, nodes: np.ndarray, level: int = FULL) -> BodyPoints:
        """Nodes of the surface, or of one of its low-passes, on bones, for ``solve_pose``."""
        chosen = nodes.ravel()
        return BodyPoints(*(np.asarray(part)[chosen] for part in self.surfaces[level].points))
