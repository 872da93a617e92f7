"""A generic body's surface, lofted around a skeleton: any subject can be tracked without a scan.

INPUTS: a Skeleton, scaled to the person; the table of cross-sections ``data/surface.toml``.
OUTPUTS: a Surface: trunk with neck and head, arms with hands, legs, feet.

A ring of the table is a closed contour about the bone's axis, its radius a short Fourier series of
the angle, in units of the stature. Stature follows from the skeleton's lengths.
"""

import tomllib
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources

import numpy as np
from scipy.interpolate import PchipInterpolator

from jaxmocap.body.skeleton import Skeleton
from jaxmocap.body.subject import bone_vectors, rest_joints
from jaxmocap.body.surfaces.surface import Surface, surface_from_rest
from jaxmocap.body.tree import Tree

# Of the stature, by Winter's proportions: trunk, neck and head, thigh and shank together.
UPRIGHT = 0.340 + 0.130 + 0.245 + 0.246
# How far along a bone the skin goes over from one bone to the next, as a share of the bone.
BLEND = 0.3


@dataclass(frozen=True)
class LoftedPart:
    """One limb of the table."""

    name: str  # of the patch, with its side
    side: int  # 1 left or middle, -1 right
    bones: tuple[str, ...]  # along which it lies, end to end; names
    above: str  # the bone that carries its beginning, or ""
    # Length of its last bone as a fraction of the stature, or 0 for the skeleton's own.
    reach: float
    around: int  # nodes of a ring
    along: int  # rings
    at: np.ndarray  # (R,) place of each ring of the table: whole numbers are bones' joints
    # (R, 2) of the rings' centres by the stature, towards phi = 0 and 90 degrees.
    shifts: np.ndarray
    stout: np.ndarray  # (R,) power of the girth by which they grow
    waves: np.ndarray  # (R, 2, H) cosine and sine coefficients of the radius by the stature


def generic_surface(skeleton: Skeleton, girth: float = 1.0) -> Surface:
    """A surface of people's mean proportions around a skeleton.

    Args:
        skeleton: scaled to the person, with any joints.
        girth: of trunk and lofted_parts by the mean person's: a stout one's is above 1.
    """
    joints, stature = rest_joints(skeleton), stature_of(skeleton)
    grids, shares = {}, {}
    for limb in lofted_parts():
        places = ring_places(skeleton, limb, stature)
        grids[limb.name] = lofted_rings(skeleton, limb, places, limb.around, girth)
        shares[limb.name] = bone_shares(skeleton.tree, limb, places, grids[limb.name], joints)
    return surface_from_rest(grids, shares, joints)


def lofted_rings(
    skeleton: Skeleton, limb: LoftedPart, places: np.ndarray, around: int, girth: float = 1.0
) -> np.ndarray:
    """Rings (R, around, 3) of a limb with all angles 0, from the pelvis, metres.

    Args:
        skeleton: scaled to the person.
        limb: of the table.
        places: (R,) of the rings; the first and the last are points, which close the ends.
        around: nodes of a ring.
        girth: as for ``generic_surface``.
    """
    stature, phi = stature_of(skeleton), 2 * np.pi * np.arange(around) / around
    size = stature * girth ** PchipInterpolator(limb.at, limb.stout)(places)[:, None]
    waves = PchipInterpolator(limb.at, limb.waves)(places)
    orders = np.arange(waves.shape[-1])[:, None] * phi
    radii = waves[:, 0] @ np.cos(orders) + waves[:, 1] @ np.sin(orders)
    radii[[0, -1]] = 0.0
    radii = size * np.maximum(radii, 0.0)
    centres, cosine, sine = ring_frames(skeleton, limb, places, stature)
    shifts = size * PchipInterpolator(limb.at, limb.shifts)(places)
    ahead = radii * np.cos(phi) + shifts[:, :1]
    outwards = radii * np.sin(phi) + shifts[:, 1:]
    return centres[:, None] + ahead[..., None] * cosine + outwards[..., None] * sine


def stature_of(skeleton: Skeleton) -> float:
    """Body height by the lengths of trunk, head and legs, metres."""
    lengths, tree = np.asarray(skeleton.lengths, float), skeleton.tree
    middle = lengths[tree.bones_in("spine", "head")]
    legs = lengths[tree.bones_in("thigh", "shank")]
    return (sum(middle) + sum(legs) / 2) / UPRIGHT


def ring_frames(
    skeleton: Skeleton, limb: LoftedPart, places: np.ndarray, stature: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centres (R, 3) of rings with all angles 0, and the directions (3,) of phi = 0 and 90 degrees.

    Rings lie level, phi = 0 ahead and 90 degrees outwards; a foot's stand upright, phi = 0 up.
    """
    joints, tree = rest_joints(skeleton), skeleton.tree
    bones = [tree.bone(bone) for bone in limb.bones]
    reach = bone_vectors(skeleton)[bones]
    if limb.reach:
        reach[-1] *= limb.reach * stature / np.linalg.norm(reach[-1])
    which = np.clip(np.floor(places).astype(int), 0, len(bones) - 1)
    centres = joints[bones][which] + (places - which)[:, None] * reach[which]
    upright = abs(reach[0, 2]) > abs(reach[0, 0])
    return centres, np.eye(3)[0 if upright else 2], limb.side * np.eye(3)[1]


def ring_places(skeleton: Skeleton, limb: LoftedPart, stature: float) -> np.ndarray:
    """(along,) places of rings, evenly spaced from the table's first ring to its last.

    The first and the last are there twice: once more without a radius, so that ends are closed.
    """
    fine = np.linspace(limb.at[0], limb.at[-1], 400)
    centres, _, _ = ring_frames(skeleton, limb, fine, stature)
    way = np.append(0, np.cumsum(np.linalg.norm(np.diff(centres, axis=0), axis=1)))
    even = np.linspace(0, way[-1], limb.along - 2)
    return np.interp(np.concatenate([[0], even, [way[-1]]]), way, fine)


def bone_shares(
    tree: Tree, limb: LoftedPart, places: np.ndarray, grid: np.ndarray, joints: np.ndarray
) -> np.ndarray:
    """(R, U, B) of each bone at the nodes: one going over into the next about their joint."""
    bones = [tree.bone(bone) for bone in limb.bones]
    chain = ([tree.bone(limb.above)] if limb.above else []) + bones
    first = 0 if limb.above else 1
    shares = np.zeros((*grid.shape[:2], len(tree.bones)))
    shares[..., chain[0]] = 1.0
    for k, bone in enumerate(chain[1:]):
        part = _smooth((places - (first + k)) / (2 * BLEND) + 0.5)[:, None]
        shares *= 1 - part[..., None]
        shares[..., bone] += part
    if limb.name == "torso":
        for side, sign in (("l", 1), ("r", -1)):
            _give_shoulder(tree, side, sign, shares, grid, joints)
    return shares


def _give_shoulder(
    tree: Tree, side: str, sign: int, shares: np.ndarray, grid: np.ndarray, joints: np.ndarray
) -> None:
    """What lies by a shoulder follows its clavicle, more so farther out; changes ``shares``."""
    arm, clavicle = tree.bones_in("arm", side=side)[0], tree.bones_in("shoulder", side=side)
    chest, neck = tree.bones_in("spine")[-1:], tree.bones_in("neck")[0]
    breadth = abs(joints[arm, 1])
    outwards = _smooth((sign * grid[..., 1] / breadth - 0.3) / 0.6)
    bottom, top = joints[chest[0], 2], joints[neck, 2]
    upwards = _smooth((grid[..., 2] - bottom) / (top - bottom) * 1.5 - 0.3)
    part = (outwards * upwards)[..., None] * shares[..., chest]
    shares[..., clavicle] += part
    shares[..., chest] -= part


def _smooth(x: np.ndarray) -> np.ndarray:
    """From 0 to 1 as x does, without corners."""
    x = np.clip(x, 0, 1)
    return x * x * (3 - 2 * x)


def lofted_parts() -> tuple[LoftedPart, ...]:
    """All lofted_parts of the table, the paired ones left and right."""
    parts = []
    for row in _table()["patch"]:
        at = np.array([ring["at"] for ring in row["ring"]])
        shifts = np.array([ring["shift"] for ring in row["ring"]]) / 1000
        stout = np.array([ring["stout"] for ring in row["ring"]])
        waves = np.array([_waves(ring) for ring in row["ring"]]) / 1000
        sides = (("", 1),) if row.get("single", False) else (("_l", 1), ("_r", -1))
        for end, side in sides:
            bones = tuple(bone + end for bone in row["bones"])
            above = row["above"] + end if row["above"] else ""
            size, rings = (row["around"], row["along"]), (at, shifts, stout, waves)
            named = row["name"] + end, side, bones, above, row["reach"]
            parts.append(LoftedPart(*named, *size, *rings))
    return tuple(parts)


def _waves(ring: dict) -> list[list[float]]:
    """(2, H) cosine and sine coefficients; without the latter a ring is the same on both sides."""
    cosine = ring["cos"]
    return [cosine, [0.0, *ring.get("sin", [0.0] * (len(cosine) - 1))]]


# Plain numbers, read once.
@lru_cache
def _table() -> dict:
    """What the table of cross-sections holds."""
    text = resources.files("jaxmocap.body").joinpath("data", "surface.toml").read_text("utf-8")
    return tomllib.loads(text)
