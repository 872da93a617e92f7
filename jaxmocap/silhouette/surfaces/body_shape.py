"""A person's shape as rims are found on it: bones, and a dense surface around them.

INPUTS: a skeleton, a surface around it. OUTPUTS: a BodyShape; its nodes as points on bones; the
surface of what a body's file has.

A torso is tracked without legs and legs without arms, since what no joint moves would lie elsewhere
than in the images. The file lists its patches (``surface``), and how far up it has one of them.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jaxmocap.body.model_files import data_of
from jaxmocap.body.skeleton import LANDMARK_PLACES, Skeleton
from jaxmocap.body.subject import rest_joints
from jaxmocap.body.surfaces.surface import (
    BodyPoints,
    Skin,
    Surface,
    every_share,
    low_pass,
    rest_nodes,
    skin_of,
    surface_from_rest,
)
from jaxmocap.body.tree import ROOT_DOF, Tree


def moved_bones(tree: Tree) -> np.ndarray:
    """(B,) bool: bones that a joint moves against the root, and those that begin at it."""
    return tree.carries[ROOT_DOF:].any(0) | (np.array(tree.parents) < 0)


def determined_landmarks(tree: Tree) -> np.ndarray:
    """(L,) bool: those on ``moved_bones``, or at such a bone's far end."""
    moved, places = moved_bones(tree), []
    for name, at in LANDMARK_PLACES.values():
        bone = tree.bone(name)
        begins = at == 0 and tree.parents[bone] >= 0
        places.append(bool(moved[bone] or (begins and moved[tree.parents[bone]])))
    return np.array(places)


def surface_of_body(surface: Surface, skeleton: Skeleton, name: str) -> Surface:
    """A whole person's surface, cut down to the parts of a body; closed where it was cut.

    ``name`` is of the body's file; where that lists no ``surface`` it has all of it.
    """
    rows = data_of(name).get("surface")
    if rows is None:
        return surface
    joints, tree = rest_joints(skeleton), skeleton.tree
    nodes, shares = rest_nodes(surface, joints), every_share(surface.points, len(joints))
    last = {row["patch"]: row.get("to") for row in rows}
    grids, carried = {}, {}
    for patch in surface.patches:
        if patch.limb not in last:
            continue
        grid, share = patch.grid(nodes), shares[patch.nodes].reshape(patch.along, patch.around, -1)
        if (to := last[patch.limb]) is not None:
            # Of the rings, from the first, that those bones carry most of.
            own = share[..., list(tree.chain(to))].sum(-1).mean(1) > 0.5
            count = len(own) if own.all() else int(np.argmin(own))
            middle = np.broadcast_to(grid[count - 1].mean(0), grid[:1].shape)
            grid = np.concatenate([grid[:count], middle])
            share = np.concatenate([share[:count], share[count - 1 : count]])
        grids[patch.name], carried[patch.name] = grid, share
    return surface_from_rest(grids, carried, joints)


# The level of the surface with all its frequencies.
FULL = -1


class BodyShape(NamedTuple):
    """Bones and skin of one person; passes over a recording correct both."""

    skeleton: Skeleton
    surfaces: tuple[Surface, ...]  # its low-passes, coarse to fine, and itself, node for node
    skins: tuple[Skin, ...]  # of ``surfaces``, as kinematics move them

    @classmethod
    def of(
        cls, skeleton: Skeleton, surface: Surface, levels: Sequence[tuple[int, int]]
    ) -> "BodyShape":
        """Of a surface as dense as rims need it, and its low-passes, (3.17).

        ``levels`` are, coarse to fine, the lowest harmonics around and waves along each limb.
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
