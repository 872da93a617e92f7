"""What of a skeleton is static: the names of bones and joints, and who hangs on whom.

INPUTS: rows of a model file. OUTPUTS: a Tree, hashable, so that programs are compiled for it.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

# The virtual root's degrees of freedom: three translations, three rotations.
ROOT_DOF = 6


class Segment(NamedTuple):
    """What kind of bone one is."""

    group: str = ""  # spine, head, shoulder, arm, hip, leg, or what else a body has; "" for none
    part: str = ""  # the bone's name within its group, the same on both sides
    side: str = ""  # "l", "r", or "" in the middle
    drawn: bool = True  # whether silhouettes show it as its cone


# Of the links' transforms, the world's own is first, then the root's.
ROOT_LINK = 1


class Links(NamedTuple):
    """Turning by one degree of freedom each, or by none: what transforms are composed along."""

    # (N,) that those beside the world and the root belong to: of each degree of freedom, then of
    # each bone without any.
    bones: np.ndarray
    begins: np.ndarray  # (N,) whether one is the first of its bone
    last: np.ndarray  # (B,) each bone's last link, which carries it
    # (K, 2 + N) ancestors at distance 1, 2, 4, ... of each; the world past the root.
    doublings: np.ndarray


# Indices that are kept are int32: JAX remembers an int64 array as it was first seen, and a change
# of precision between two traces would break the second.
@dataclass(frozen=True)
class Tree:
    """What of a skeleton is static: names and who hangs on whom. Hashable."""

    bones: tuple[str, ...]  # names of the B bones, parents before children
    # Index of each bone's parent, -1 for bones that start at the virtual root.
    parents: tuple[int, ...]
    joints: tuple[str, ...]  # names of the D degrees of freedom
    # Index of the bone that each degree of freedom turns, proximal to distal.
    dof_bones: tuple[int, ...]
    # What kind of bone each is; () where that is specified of none.
    segments: tuple[Segment, ...] = ()
    # Limb that is searched by each degree of freedom, "" for none; () for none at all.
    searched: tuple[str, ...] = ()

    def bone(self, name: str) -> int:
        """Index of a bone by name.

        Raises:
            KeyError: no such bone; the message lists the valid ones.
        """
        if name not in self.bones:
            raise KeyError(f"unknown bone {name!r}; the bones are {', '.join(self.bones)}")
        return self.bones.index(name)

    def bones_in(self, *names: str, side: str | None = None) -> np.ndarray:
        """Indices (K,) of the bones of groups or parts, parents before children.

        Args:
            names: of groups ("arm") or parts ("forearm"); a body that has none yields no bones.
            side: only these, "l", "r" or ""; None for all.
        """
        chosen = [
            i
            for i, segment in enumerate(self.segments)
            if (segment.group in names or segment.part in names) and side in (None, segment.side)
        ]
        return np.array(chosen, np.int32)

    def names_in(self, *names: str, side: str | None = None) -> tuple[str, ...]:
        """The names of ``bones_in``."""
        return tuple(self.bones[i] for i in self.bones_in(*names, side=side))

    @property
    def groups_of_joints(self) -> tuple[str, ...]:
        """The group (D) of the bone that each degree of freedom turns; "" for none."""
        if not self.segments:
            return ("",) * len(self.joints)
        return tuple(self.segments[bone].group for bone in self.dof_bones)

    @property
    def drawn(self) -> np.ndarray:
        """Indices (K,) of the bones that silhouettes show as their cones."""
        if not self.segments:
            return np.arange(len(self.bones), dtype=np.int32)
        return np.flatnonzero([segment.drawn for segment in self.segments]).astype(np.int32)

    def joint(self, name: str) -> int:
        """Index of a degree of freedom by name; KeyError lists the valid ones."""
        if name not in self.joints:
            raise KeyError(f"unknown joint {name!r}; the joints are {', '.join(self.joints)}")
        return self.joints.index(name)

    def chain(self, bone: str) -> tuple[int, ...]:
        """Indices of the bones on the path from the root to ``bone``: a kinematic chain."""
        path = [self.bone(bone)]
        while self.parents[path[-1]] >= 0:
            path.append(self.parents[path[-1]])
        return tuple(reversed(path))

    @cached_property
    def leaves(self) -> tuple[int, ...]:
        """Bones that carry no other."""
        return tuple(i for i in range(len(self.bones)) if i not in self.parents)

    @cached_property
    def carries(self) -> np.ndarray:
        """(6 + D, B) booleans: does a degree of freedom, the root's first, move a bone?"""
        chains = [set(self.chain(name)) for name in self.bones]
        moved = [[bone in chain for chain in chains] for bone in self.dof_bones]
        return np.vstack([np.ones((ROOT_DOF, len(self.bones)), bool), np.array(moved, bool)])

    @cached_property
    def hinge_slots(self) -> np.ndarray:
        """(B, S) indices of each bone's degrees of freedom in turning order, -1 where empty."""
        bones = range(len(self.bones))
        per_bone = [[d for d, b in enumerate(self.dof_bones) if b == i] for i in bones]
        slots = np.full((len(bones), max(map(len, per_bone))), -1, np.int32)
        for i, dofs in enumerate(per_bone):
            slots[i, : len(dofs)] = dofs
        return slots

    @cached_property
    def links(self) -> Links:
        """One for the world, the root, each degree of freedom, and each bone without any."""
        stiff = [i for i in range(len(self.bones)) if i not in self.dof_bones]
        bones = (*self.dof_bones, *stiff)
        # Later ones of a bone take the place of earlier ones.
        last = {bone: link for link, bone in enumerate(bones, ROOT_LINK + 1)}
        parents, begins, before = [], [], {}
        for link, bone in enumerate(bones, ROOT_LINK + 1):
            begins.append(bone not in before)
            parents.append(before.get(bone, last.get(self.parents[bone], ROOT_LINK)))
            before[bone] = link
        rounds, ancestors = [], np.array([0, 0, *parents], np.int32)
        while ancestors.any():
            rounds.append(ancestors)
            ancestors = ancestors[ancestors]
        carriers = np.array([last[bone] for bone in range(len(self.bones))], np.int32)
        return Links(np.array(bones, np.int32), np.array(begins), carriers, np.stack(rounds))


def with_dofs(tree: Tree, joints: list[dict], added: bool = False) -> Tree:
    """The same bones turned by other degrees of freedom, or by more."""
    names = tuple(joint["name"] for joint in joints)
    turned = tuple(tree.bone(joint["bone"]) for joint in joints)
    searched = tuple(joint.get("limb", "") for joint in joints)
    if added:
        before = tree.searched or ("",) * len(tree.joints)
        names, turned = (*tree.joints, *names), (*tree.dof_bones, *turned)
        searched = (*before, *searched)
    return replace(tree, joints=names, dof_bones=turned, searched=searched)
