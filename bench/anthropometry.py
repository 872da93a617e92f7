"""Measures of a mesh as by tape and callipers: the truth for a person's own model.

INPUTS: a rigged person as they stand. OUTPUTS: sections of trunk and arms: width, depth, girth.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.spatial import ConvexHull

from jaxmocap.synthetic.people.rigged_mesh import RiggedMesh, unit

TRUNK = ("Hip", "Spine", "LowerBack", "Neck", "Head", "UpLeg", "Shoulder")
_BONES = {"humerus": ("Arm", "ForeArm"), "radius": ("ForeArm", "Hand")}
_SIDES = {"l": "Left", "r": "Right"}


class TapeMeasure(NamedTuple):
    """Where a plane cuts a part of the body: metres.

    Attributes:
        width: across (to the person's left; of an arm, along the hinge of its elbow).
        depth: to the front (of an arm, in the plane in which it bends).
        girth: of a tape around it, which no hollow lets in.
    """

    width: float
    depth: float
    girth: float


@dataclass(frozen=True)
class MeasuredPerson:
    """A person as they stand: everything in the world, metres.

    Attributes:
        person: whose mesh it is.
        vertices: (V, 3).
        R: (J, 3, 3) turns of the rig's joints from rest.
        joints: (J, 3) of the rig.
    """

    person: RiggedMesh
    vertices: np.ndarray
    R: np.ndarray
    joints: np.ndarray

    @classmethod
    def of(cls, person: RiggedMesh) -> "MeasuredPerson":
        """A person at time 0."""
        now = np.zeros(1)
        R, joints = person.rig(now)
        return cls(person, person.vertices(now)[0], R[0], joints[0])

    def landmarks(self) -> dict[str, np.ndarray]:
        """Landmark name -> (3,)."""
        return {name: at[0] for name, at in self.person.landmarks(np.zeros(1)).items()}

    def trunk(self, height: float) -> TapeMeasure:
        """The level section of trunk, neck or head at a height."""
        cut = self._cut(TRUNK, np.array([0.0, 0.0, height]), np.array([0.0, 0.0, 1.0]))
        return tape_measure(cut[:, [1, 0]])

    def arm(self, bone: str, side: str, at: float) -> TapeMeasure:
        """The section square to ``humerus`` or ``radius`` of side l or r, at a share of it."""
        near, far = (self._joint(_SIDES[side] + name) for name in _BONES[bone])
        names = self.person.body.names
        shoulder, elbow, wrist = (
            self.person.at(_SIDES[side] + name) for name in ("Arm", "ForeArm", "Hand")
        )
        rest_hinge = np.cross(elbow - shoulder, wrist - elbow)
        hinge = self.R[names.index(_SIDES[side] + _BONES[bone][0])] @ rest_hinge
        along = unit(far - near)
        hinge = unit(hinge - along * (along @ hinge))
        carriers = tuple(_SIDES[side] + name for name in ("Arm", "ForeArm", "Hand"))
        cut = self._cut(carriers, near + at * (far - near), along)
        return tape_measure(np.stack([cut @ hinge, cut @ np.cross(along, hinge)], 1))

    def _joint(self, name: str) -> np.ndarray:
        return self.joints[self.person.body.names.index(name)]

    def _cut(self, parts: tuple[str, ...], origin: np.ndarray, normal: np.ndarray) -> np.ndarray:
        """(N, 3) where a plane crosses the edges of faces that only these bones carry most."""
        mesh, names = self.person.mesh, self.person.body.names
        carrier = mesh.bones[np.arange(len(mesh.bones)), mesh.weights.argmax(-1)]
        of_part = np.array([any(part in name for part in parts) for name in names])
        faces = mesh.faces[of_part[carrier][mesh.faces].all(1)]
        a, b = self.vertices[faces], self.vertices[np.roll(faces, -1, 1)]
        above, below = (a - origin) @ normal, (b - origin) @ normal
        crossed = above * below < 0
        share = (above / np.where(crossed, above - below, 1.0))[..., None]
        return (a + share * (b - a))[crossed]


def tape_measure(outline: np.ndarray) -> TapeMeasure:
    """Of points (N, 2) across and ahead."""
    hull = outline[ConvexHull(outline).vertices]
    girth = np.linalg.norm(np.roll(hull, -1, 0) - hull, axis=1).sum()
    width, depth = np.ptp(outline, axis=0)
    return TapeMeasure(float(width), float(depth), float(girth))
