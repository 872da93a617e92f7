"""The shape of a synthetic person: muscle, clothes, hair, headset, racket.

Nothing here is the tracker's flesh: limbs are elliptical and bulge, sleeves are wider than arms
and wrinkled, the trunk is a superellipse, and a racket covers part of the hand.

INPUTS: a Figure, a random generator. OUTPUTS: a Mesh skinned to the figure's bones; where its
vertices are at any time of a performance.
"""

from dataclasses import dataclass, replace

import numpy as np

from jaxmocap.synthetic.movements.motions import Performance
from jaxmocap.synthetic.movements.splines import Spline
from jaxmocap.synthetic.people.figure import Figure
from jaxmocap.synthetic.people.meshes import QuadMesh, grid_faces, loft, merged_meshes, waves

# Where headset and controllers sit: bone, fraction of its length, offset in its frame (metres).
MARKERS: dict[str, tuple[str, float, tuple[float, float, float]]] = {
    "Headset": ("head", 0.7, (0.10, 0.0, 0.0)),
    "LeftController": ("hand_l", 0.6, (0.02, 0.0, 0.0)),
    "RightController": ("hand_r", 0.6, (0.02, 0.0, 0.0)),
}
# Profiles for a person of 1.75 m: fraction along the bone, half-widths forward and sideways, and
# how far the middle lies forward, metres. Muscles bulge; no section is a circle.
PROFILE_HEIGHT = 1.75
UPPER_ARM = ((-0.05, 0.052, 0.046, 0), (0.35, 0.052, 0.041, 0.008), (1, 0.042, 0.039, 0))
SLEEVE = ((-0.06, 0.070, 0.062, 0), (0.3, 0.071, 0.060, 0.003), (0.58, 0.077, 0.068, 0))
LONG_SLEEVE = ((-0.06, 0.070, 0.062, 0), (0.5, 0.064, 0.056, 0.006), (1.04, 0.056, 0.053, 0))
FOREARM = (
    (0, 0.041, 0.039, 0),
    (0.24, 0.040, 0.048, 0.004),
    (0.7, 0.029, 0.035, 0),
    (1, 0.021, 0.030, 0),
)
CUFF = ((-0.04, 0.054, 0.053, 0), (0.3, 0.053, 0.056, 0), (0.93, 0.036, 0.042, 0))
HAND = ((0, 0.022, 0.030, 0), (0.3, 0.026, 0.042, 0.008), (0.62, 0.021, 0.034, 0.014))
THIGH = ((-0.02, 0.098, 0.094, 0), (0.3, 0.094, 0.092, 0.012), (1, 0.064, 0.060, 0))
SHANK = ((0, 0.064, 0.060, 0), (0.3, 0.066, 0.062, -0.012), (1.02, 0.058, 0.055, 0))
NECK = ((-0.5, 0.062, 0.068, 0.0), (0.5, 0.056, 0.055, 0), (1.1, 0.055, 0.054, 0))
# The trunk: height above the pelvis over the distance from there to the neck, half-widths
# forward and sideways.
TRUNK = (
    *((-0.10, 0.108, 0.172), (0.10, 0.112, 0.165), (0.35, 0.106, 0.150), (0.62, 0.122, 0.170)),
    *((0.78, 0.118, 0.186), (0.90, 0.085, 0.165), (1.0, 0.060, 0.085), (1.04, 0.052, 0.066)),
)
# Of fine meshes: the shirt hangs over the hips, which the skeleton has wider apart than people.
LOOSE_TRUNK = (
    *((-0.15, 0.146, 0.236), (-0.08, 0.142, 0.234), (0.02, 0.132, 0.220), (0.16, 0.120, 0.190)),
    *((0.36, 0.112, 0.163), *TRUNK[3:]),
)
SLIM_THIGH = (
    *((-0.02, 0.090, 0.062, 0), (0.12, 0.094, 0.080, 0.004), (0.3, 0.092, 0.088, 0.012)),
    (1, 0.064, 0.060, 0),
)
PELVIS = (
    *((-0.30, 0.070, 0.090), (-0.22, 0.106, 0.168), (-0.12, 0.124, 0.192), (0.0, 0.120, 0.190)),
    (0.10, 0.108, 0.165),
)
# Latitudes of the rings of a limb's round end, radians.
CAP_ANGLES = np.deg2rad([20.0, 50.0, 75.0, 89.0])
# Colours to choose from, BGR, 0 to 1.
SHIRTS = ((0.62, 0.30, 0.16), (0.20, 0.24, 0.66), (0.30, 0.52, 0.24), (0.72, 0.72, 0.70))
TROUSERS = ((0.44, 0.31, 0.23), (0.30, 0.31, 0.33), (0.38, 0.50, 0.58))
SKINS = ((0.50, 0.60, 0.82), (0.36, 0.46, 0.66), (0.22, 0.30, 0.44))
HAIRS = ((0.06, 0.08, 0.12), (0.16, 0.24, 0.36), (0.20, 0.22, 0.24))


@dataclass(frozen=True)
class Actor:
    """A mesh that moves."""

    mesh: QuadMesh  # at rest
    performance: Performance  # the movement of its bones
    rest: np.ndarray  # (B, 3) joints of the bones at rest, metres

    def vertices(self, times: np.ndarray) -> np.ndarray:
        """(T, V, 3) in the world, metres, at (T,) times, seconds."""
        joints, R = self.performance.bones(times)
        return self.mesh.pose_vertices(R, joints - np.einsum("tbij,bj->tbi", R, self.rest))

    def landmarks(self, times: np.ndarray) -> dict[str, np.ndarray]:
        """Landmark name -> (T, 3), world, metres."""
        return self.performance.landmarks(times)


def clothed_actor(performance: Performance, seed: int = 0, detail: int = 1) -> Actor:
    """The performer with a body, clothes, a headset, and a racket in the right hand.

    Args:
        performance: the movement.
        seed: of clothes and folds.
        detail: finer meshes by this factor, in smooth colours: for the eye. Trackers get no other
            outlines by it, and drawing takes its square as long.
    """
    parts = _PersonMesh(performance.figure, np.random.default_rng([seed, 1]), detail)
    return Actor(parts.person(), performance, parts.rest)


class _PersonMesh:
    """Builds the parts of one person at rest: every bone's frame upright, arms hanging."""

    def __init__(self, figure: Figure, rng: np.random.Generator, detail: int):
        self.figure, self.rng, self.tree = figure, rng, figure.skeleton.tree
        self.detail = detail
        self.scale = figure.height / PROFILE_HEIGHT
        self.rest = np.zeros((len(self.tree.bones), 3))
        for i, parent in enumerate(self.tree.parents):
            if parent >= 0:
                self.rest[i] = self.rest[parent] + figure.reach(self.tree.bones[parent])
        shirts = rng.permutation(len(SHIRTS))
        self.shirt, self.print = (np.array(SHIRTS[i]) for i in shirts[:2])
        self.trousers = np.array(TROUSERS[rng.integers(len(TROUSERS))])
        self.skin = np.array(SKINS[rng.integers(len(SKINS))])
        self.hair = np.array(HAIRS[rng.integers(len(HAIRS))])
        self.long_sleeves = bool(rng.random() < 0.4)

    def person(self) -> QuadMesh:
        """All parts."""
        parts = [*self._trunk(), *self._head(), self._racket()]
        for side in "lr":
            parts += [*self._arm(side), *self._leg(side)]
        return merged_meshes(parts)

    def _arm(self, side: str) -> list[QuadMesh]:
        humerus, radius, hand = (f"{bone}_{side}" for bone in ("humerus", "radius", "hand"))
        bare = [
            self._limb(humerus, UPPER_ARM, self.skin),
            self._limb(radius, FOREARM, self.skin),
            self._limb(hand, HAND, self.skin, sides=12),
        ]
        bone, at, offset = MARKERS["LeftController" if side == "l" else "RightController"]
        centre = self.rest[self.tree.bone(bone)] + at * self.figure.reach(bone) + offset
        size, black = (0.045, 0.022, 0.024), np.full(3, 0.12)
        bare.append(self._ball(hand, centre, size, black, exponent=4))
        if self.long_sleeves:
            upper = self._limb(humerus, LONG_SLEEVE, self.shirt, folds=0.035, sides=18)
            return [*bare, upper, self._limb(radius, CUFF, self.shirt, folds=0.04, sides=18)]
        return [*bare, self._limb(humerus, SLEEVE, self.shirt, folds=0.05, sides=18, caps=(1, 0))]

    def _leg(self, side: str) -> list[QuadMesh]:
        foot = self.tree.bone(f"foot_{side}")
        reach = self.figure.reach(f"foot_{side}")
        shoe = self._ball(
            f"foot_{side}", self.rest[foot] + 0.42 * reach, (0.145, 0.05, 0.045), np.full(3, 0.75)
        )
        thigh = THIGH if self.detail == 1 else SLIM_THIGH
        return [
            self._limb(f"femur_{side}", thigh, self.trousers, folds=0.02, sides=16),
            self._limb(f"tibia_{side}", SHANK, self.trousers, folds=0.04, sides=16),
            shoe,
        ]

    def _limb(
        self,
        bone: str,
        profile: tuple,
        colour: np.ndarray,
        folds: float = 0.0,
        sides: int = 14,
        caps: tuple[int, int] = (1, 1),
    ) -> QuadMesh:
        """A tube along a bone through a profile, with round ends."""
        i, reach = self.tree.bone(bone), self.figure.reach(bone)
        table = np.array(profile, float)
        t = np.linspace(table[0, 0], table[-1, 0], 12 * self.detail + 1)
        rows = Spline(table[:, 0], table[:, 1:])(t) * self.scale
        centres = self.rest[i] + t[:, None] * reach + rows[:, 2:] * [1.0, 0.0, 0.0]
        radii = rows[:, :2]
        for end, wanted in ((0, caps[0]), (-1, caps[1])):
            if wanted:
                centres, radii = _cap_tube(centres, radii, end)
        sides = sides * self.detail
        swell = 1 + folds * waves(self.rng, len(centres), sides)
        # A limb is upright at rest.
        forward = np.array([1.0, 0.0, 0.0])
        across = forward, np.cross(reach / np.linalg.norm(reach), forward)
        vertices = loft(centres, radii, across, sides, swell=swell)
        return self._paint_rings(vertices, len(centres), sides, colour, i, 0.05 + 2 * folds)

    def _trunk(self) -> list[QuadMesh]:
        names = ("hip_l", "spine1", "spine2", "spine3")
        bones = np.array([self.tree.bone(name) for name in names])
        top = self.rest[self.tree.bone("neck"), 2]
        middles = [0.0]
        middles += [self.rest[self.tree.bone(b), 2] + self.figure.length(b) / 2 for b in names[1:]]
        parts = []
        shirt = TRUNK if self.detail == 1 else LOOSE_TRUNK
        for table, colour, folds in ((shirt, self.shirt, 0.025), (PELVIS, self.trousers, 0.01)):
            profile, rings, sides = np.array(table), 26 * self.detail, 30 * self.detail
            t = np.linspace(profile[0, 0], profile[-1, 0], rings)
            radii = Spline(profile[:, 0], profile[:, 1:])(t) * self.scale
            centres = t[:, None] * [0.0, 0.0, top]
            across = (np.array([1.0, 0, 0]), np.array([0, 1.0, 0]))
            swell = 1 + folds * waves(self.rng, rings, sides, around=7)
            vertices = loft(centres, radii, across, sides, exponent=2.5, swell=swell)
            part = self._paint_rings(vertices, rings, sides, colour, 0, 0.10)
            parts.append(_blend_part(part, bones, np.array(middles)))
        parts[0] = self._print_shirt(parts[0])
        return parts

    def _print_shirt(self, shirt: QuadMesh) -> QuadMesh:
        """Stripes across the chest and a patch at the front."""
        middle = shirt.vertices[shirt.faces].mean(1)
        top = middle[:, 2].max()
        share = middle[:, 2] / top
        stripe = (np.abs(share - 0.62) < 0.03) | (np.abs(share - 0.50) < 0.025)
        patch = (np.abs(middle[:, 1] - 0.08) < 0.035) & (np.abs(share - 0.76) < 0.04)
        patch &= middle[:, 0] > 0
        colours = shirt.colours.copy()
        colours[stripe | patch] *= (self.print / self.shirt)[None]
        return replace(shirt, colours=np.clip(colours, 0, 1))

    def _head(self) -> list[QuadMesh]:
        head = self.rest[self.tree.bone("head")]
        crown = self.figure.length("head")
        centre = head + np.array([0.012, 0.0, crown - 0.125 * self.scale])
        skull = self._ball("head", centre, (0.098, 0.077, 0.125), self.skin, rings=14, sides=20)
        away = skull.vertices[skull.faces].mean(1) - centre
        hairy = (away[:, 2] > 0.055 * self.scale) | ((away[:, 0] < -0.015) & (away[:, 2] > -0.05))
        strands = self.rng.uniform(0.6, 1.4, (hairy.sum(), 1))
        skull.colours[hairy] = self.hair * (strands if self.detail == 1 else 1.0)
        visor = head + np.array([0.085, 0.0, 0.7 * crown - 0.045])
        headset = self._ball("head", visor, (0.055, 0.088, 0.048), np.full(3, 0.09), exponent=5)
        return [self._limb("neck", NECK, self.skin), skull, headset]

    def _racket(self) -> QuadMesh:
        """A blade beyond the right fist, in the plane of the forearm's flexion."""
        hand = self.tree.bone("hand_r")
        end = self.rest[hand] + 0.6 * self.figure.reach("hand_r")
        red, wood = np.array([0.15, 0.12, 0.70]), np.array([0.35, 0.5, 0.65])
        blade, grip = end + np.array([0.05, 0, -0.115]), end + np.array([0.02, 0, -0.01])
        rubber = self._ball("hand_r", blade, (0.075, 0.007, 0.08), red)
        handle = self._ball("hand_r", grip, (0.016, 0.014, 0.06), wood, exponent=4)
        return merged_meshes([rubber, handle])

    def _ball(
        self,
        bone: str,
        centre: np.ndarray,
        radii: tuple[float, float, float],
        colour: np.ndarray,
        rings: int = 9,
        sides: int = 14,
        exponent: float = 2.0,
    ) -> QuadMesh:
        """An ellipsoid, or a rounded box with a larger exponent, of half-axes in metres."""
        rings, sides = rings * self.detail, sides * self.detail
        polar = np.linspace(0.02, np.pi - 0.02, rings)[:, None]
        power = 2 / exponent
        heights = -np.sign(np.cos(polar)) * np.abs(np.cos(polar)) ** power
        size = np.array(radii) * self.scale
        centres = centre + heights * size[2] * [0.0, 0.0, 1.0]
        across = (np.array([1.0, 0, 0]), np.array([0, 1.0, 0]))
        vertices = loft(centres, np.sin(polar) ** power * size[:2], across, sides, exponent)
        return self._paint_rings(vertices, rings, sides, colour, self.tree.bone(bone), 0.05)

    def _paint_rings(
        self,
        vertices: np.ndarray,
        rings: int,
        sides: int,
        colour: np.ndarray,
        bone: int,
        contrast: float,
    ) -> QuadMesh:
        """Rings closed to a mesh on one bone, its colour unevenly worn."""
        cloud = waves(self.rng, rings - 1, sides, 4, 2.0)
        if self.detail == 1:
            cloud = cloud + self.rng.normal(0, 0.5, (rings - 1, sides))
        shade = 1 + contrast * np.clip(cloud, -2, 2)
        colours = np.clip(shade.reshape(-1, 1) * colour, 0.02, 1.0)
        bones = np.full((len(vertices), 2), bone)
        weights = np.tile([1.0, 0.0], (len(vertices), 1))
        return QuadMesh(vertices, grid_faces(rings, sides), colours, bones, weights)


def _cap_tube(centres: np.ndarray, radii: np.ndarray, end: int) -> tuple[np.ndarray, np.ndarray]:
    """Rings that round off one end (0 or -1) of a tube."""
    inner = 1 if end == 0 else -2
    axis = centres[end] - centres[inner]
    axis /= np.linalg.norm(axis)
    rings = np.cos(CAP_ANGLES)[:, None] * radii[end]
    middles = centres[end] + np.sin(CAP_ANGLES)[:, None] * radii[end].mean() * axis
    if end == 0:
        return np.concatenate([middles[::-1], centres]), np.concatenate([rings[::-1], radii])
    return np.concatenate([centres, middles]), np.concatenate([radii, rings])


def _blend_part(part: QuadMesh, bones: np.ndarray, middles: np.ndarray) -> QuadMesh:
    """A part carried by the two of several stacked bones whose middles (heights) are nearest."""
    z = np.clip(part.vertices[:, 2], middles[0], middles[-1])
    below = np.clip(np.searchsorted(middles, z, side="right") - 1, 0, len(middles) - 2)
    share = (z - middles[below]) / (middles[below + 1] - middles[below])
    carriers = np.stack([bones[below], bones[below + 1]], -1)
    weights = np.stack([1 - share, share], -1)
    return replace(part, bones=carriers, weights=weights)
