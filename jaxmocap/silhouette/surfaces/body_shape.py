"""A person's shape as rims are found on it: bones, and a dense surface around them.

INPUTS: a skeleton, a surface around it. OUTPUTS: a BodyShape; its nodes as points on bones.
"""

from typing import NamedTuple

import numpy as np

from jaxmocap.body.skeleton import Skeleton
from jaxmocap.body.surfaces.loft import rest_joints
from jaxmocap.body.surfaces.surface import BodyPoints, Skin, Surface, low_pass, skin_of


class BodyShape(NamedTuple):
    """Bones and skin of one person; passes over a recording correct both.

    Attributes:
        skeleton: the bones.
        surface: the dense one, whose nodes rims consist of.
        coarse: its low-pass, node for node.
        skin: of ``surface``, as kinematics move it.
        coarse_skin: of ``coarse``.
    """

    skeleton: Skeleton
    surface: Surface
    coarse: Surface
    skin: Skin
    coarse_skin: Skin

    @classmethod
    def of(cls, skeleton: Skeleton, surface: Surface, harmonics: tuple[int, int]) -> "BodyShape":
        """Of a surface as dense as rims need it, and its harmonics around and waves along."""
        joints = rest_joints(skeleton)
        coarse = low_pass(surface, joints, *harmonics)
        return cls(skeleton, surface, coarse, skin_of(surface, joints), skin_of(coarse, joints))

    def points(self, nodes: np.ndarray, coarse: bool = False) -> BodyPoints:
        """Nodes of the surface, or of its low-pass, on bones, for ``solve_pose``."""
        every = (self.coarse if coarse else self.surface).points
        chosen = nodes.ravel()
        return BodyPoints(*(np.asarray(part)[chosen] for part in every))
