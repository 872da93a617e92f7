"""Scaling a skeleton to a person: by height and mass, or by the landmarks of a static trial.

INPUTS: a Skeleton, and height and mass or landmark positions (metres, world Z up).
OUTPUTS: a Skeleton of the same tree with other lengths, directions, masses and diameters.

Proportions: D. A. Winter, "Biomechanics and Motor Control of Human Movement", 4th ed. (2009),
Fig. 4.1 (lengths, after Drillis and Contini) and Table 4.1 (masses).
"""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.skeleton import LANDMARKS, Skeleton

# Lengths as fractions of the body height. Trunk: hip (0.530) to the base of the neck (0.870);
# neck and head: from there to the vertex. The shoulder lies at 0.818, 0.129 to the side.
WINTER_LENGTHS = {
    "trunk": 0.340,
    "neck_head": 0.130,
    "shoulder": float(np.hypot(0.129, 0.052)),
    "upper_arm": 0.186,
    "forearm": 0.146,
    "hand": 0.108,
    "hip": 0.0955,
    "thigh": 0.245,
    "shank": 0.246,
    "foot": 0.110,
}
ANKLE_HEIGHT = 0.039
CLAVICLE_DROP = 0.052 / 0.129
# Masses as fractions of the body mass; trunk and head are split as Table 1 splits them.
WINTER_MASSES = {
    "trunk": 0.497,
    "neck_head": 0.081,
    "upper_arm": 0.028,
    "forearm": 0.016,
    "hand": 0.006,
    "thigh": 0.100,
    "shank": 0.0465,
    "foot": 0.0145,
}
TRUNK = ("spine1", "spine2", "spine3")
NECK_HEAD = ("neck", "head")
# Groups of bones that share one number of the tables, in proportion to what they have.
_LONG_TOGETHER = {"spine": "trunk", "head": "neck_head"}
# Clavicles and hips weigh as parts of the trunk.
_HEAVY_TOGETHER = {**_LONG_TOGETHER, "shoulder": "trunk", "hip": "trunk"}
MEAN_BODY_MASS_INDEX = 23.0

# Part and side of a bone -> the landmarks at its two ends.
_MEASURED = {
    (part, side): (f"{near}_{side}", f"{far}_{side}")
    for part, near, far in (
        ("upper_arm", "shoulder", "elbow"),
        ("forearm", "elbow", "wrist"),
        ("hand", "wrist", "hand"),
        ("thigh", "hip", "knee"),
        ("shank", "knee", "ankle"),
        ("foot", "ankle", "toe"),
    )
    for side in "lr"
}


def scale_to_height(skeleton: Skeleton, height: float | None, mass: float | None) -> Skeleton:
    """Scale by height (metres) and mass (kilograms) with Winter's proportions.

    Without a height only the masses change, all by the same factor.

    Raises:
        ValueError: height outside 0.5 to 2.5 m, or mass outside 10 to 400 kg.
    """
    if mass is not None and not 10.0 <= mass <= 400.0:
        raise ValueError(f"mass = {mass}: expected kilograms between 10 and 400")
    if height is None:
        factor = 1.0 if mass is None else mass / float(skeleton.masses.sum())
        return replace(skeleton, masses=skeleton.masses * factor)
    if not 0.5 <= height <= 2.5:
        raise ValueError(f"height = {height}: expected metres between 0.5 and 2.5")
    lengths = _fractions(skeleton, WINTER_LENGTHS, _LONG_TOGETHER, skeleton.lengths) * height
    directions = np.array(skeleton.directions)
    for side, left in (("l", 1.0), ("r", -1.0)):
        slope = np.array([0.0, left, -CLAVICLE_DROP])
        directions[skeleton.tree.bones_in("shoulder", side=side)] = slope / np.linalg.norm(slope)
    kilograms = MEAN_BODY_MASS_INDEX * height**2 if mass is None else mass
    masses = _fractions(skeleton, WINTER_MASSES, _HEAVY_TOGETHER, skeleton.masses)
    # Winter's masses are all of it: what he does not have takes its share from the others.
    masses = masses * kilograms / (masses.sum() if masses.sum() > 1.001 else 1.0)
    scaled = replace(
        skeleton,
        lengths=jnp.asarray(lengths, float),
        directions=jnp.asarray(directions, float),
        masses=jnp.asarray(masses, float),
    )
    return _with_girths(skeleton, scaled)


def _fractions(
    skeleton: Skeleton, table: dict[str, float], together: dict[str, str], shares: Array
) -> np.ndarray:
    """One fraction per bone (B,).

    Trunk and neck with head are split in proportion to ``shares``. A bone that the table does not
    have, a tail's, keeps its proportion to all the others.

    Args:
        skeleton: of B bones.
        table: of Winter.
        together: group of bones -> the entry that they share.
        shares: (B,) of the skeleton.
    """
    segments, own = skeleton.tree.segments, np.asarray(shares)
    keys = [together.get(segment.group, segment.part) for segment in segments]
    single = [segment.group not in together for segment in segments]
    fractions = np.full(len(own), np.nan, own.dtype)
    for i, key in enumerate(keys):
        if key in table:
            members = [i] if single[i] else [j for j, other in enumerate(keys) if other == key]
            fractions[i] = table[key] * own[i] / sum(own[j] for j in members)
    known = np.isfinite(fractions)
    return np.where(known, fractions, own * fractions[known].sum() / own[known].sum())


def _with_girths(old: Skeleton, new: Skeleton) -> Skeleton:
    """Diameters that keep each bone's density: they grow with the root of mass per length."""
    density = jnp.sqrt((new.masses / new.lengths) / (old.masses / old.lengths))
    return replace(new, diameters=old.diameters * density[:, None])


def scale_to_landmarks(skeleton: Skeleton, landmarks: dict[str, np.ndarray]) -> Skeleton:
    """Scale by a static trial: robust means of lengths, and the directions of what has no DoF.

    The person stands upright, arms anywhere. What no landmark tells follows from the height that
    the known lengths suggest. The pelvis is the midpoint of the hips; spine and neck with head
    are split as in the skeleton given.

    Args:
        skeleton: the tree and the defaults.
        landmarks: name (of ``LANDMARKS``) to (T, 3) positions, metres, Z up; NaN where missing.

    Raises:
        ValueError: an unknown landmark, or one that is needed (neck, hips, shoulders) has no data.
    """
    unknown = sorted(set(landmarks) - set(LANDMARKS))
    if unknown:
        raise ValueError(f"unknown landmark {unknown[0]!r}; expected one of {', '.join(LANDMARKS)}")
    for name in ("neck", "hip_l", "hip_r", "shoulder_l", "shoulder_r"):
        if name not in landmarks or not np.isfinite(landmarks[name]).all(-1).any():
            raise ValueError(f"a static trial needs the landmark {name!r} in at least one frame")
    measured = {which: _distance(landmarks, *ends) for which, ends in _MEASURED.items()}
    guess = scale_to_height(skeleton, _height(landmarks, measured), None)
    lengths, directions = np.array(guess.lengths), np.array(guess.directions)
    names = skeleton.tree.bones
    for (part, side), length in measured.items():
        if length is not None:
            lengths[skeleton.tree.bones_in(part, side=side)] = length
    for bones, vector in _trunk_vectors(landmarks).items():
        members = [names.index(bone) for bone in bones]
        share = lengths[members] / lengths[members].sum()
        lengths[members] = share * np.linalg.norm(vector)
        directions[members] = vector / np.linalg.norm(vector)
    scaled = replace(
        guess, lengths=jnp.asarray(lengths, float), directions=jnp.asarray(directions, float)
    )
    return _with_girths(guess, scaled)


def _distance(landmarks: dict[str, np.ndarray], a: str, b: str) -> float | None:
    """Median distance over the frames in which both are seen, or None."""
    if a not in landmarks or b not in landmarks:
        return None
    lengths = np.linalg.norm(landmarks[a] - landmarks[b], axis=-1)
    return float(np.nanmedian(lengths)) if np.isfinite(lengths).any() else None


def _height(
    landmarks: dict[str, np.ndarray], measured: dict[tuple[str, str], float | None]
) -> float:
    """Body height, metres: from vertex to ankles where both are known, else from the limbs.

    The limbs' height is the median of those at which Winter's limbs are as long as the measured.
    """
    if {"vertex", "ankle_l", "ankle_r"} <= set(landmarks):
        ankles = (landmarks["ankle_l"] + landmarks["ankle_r"]) / 2
        extent = (landmarks["vertex"] - ankles)[:, 2]
        if np.isfinite(extent).any():
            return float(np.clip(np.nanmedian(extent) / (1 - ANKLE_HEIGHT), 0.5, 2.5))
    ratios = [
        length / WINTER_LENGTHS[part]
        for (part, _), length in measured.items()
        if length is not None and part != "foot"
    ]
    return float(np.clip(np.median(ratios), 0.5, 2.5)) if ratios else 1.75


def _trunk_vectors(landmarks: dict[str, np.ndarray]) -> dict[tuple[str, ...], np.ndarray]:
    """Vectors along bones without degrees of freedom, and neck with head, in the trunk's frame."""
    pelvis = (landmarks["hip_l"] + landmarks["hip_r"]) / 2
    up = landmarks["neck"] - pelvis
    left = landmarks["hip_l"] - landmarks["hip_r"]
    left = left + landmarks["shoulder_l"] - landmarks["shoulder_r"]
    z = up / np.linalg.norm(up, axis=-1, keepdims=True)
    x = np.cross(left, z)
    x /= np.linalg.norm(x, axis=-1, keepdims=True)
    R_trunk_world = np.stack([x, np.cross(z, x), z], -2)

    def seen(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return np.nanmedian(np.einsum("tij,tj->ti", R_trunk_world, b - a), axis=0)

    vectors: dict[tuple[str, ...], np.ndarray] = {TRUNK: seen(pelvis, landmarks["neck"])}
    if "vertex" in landmarks and np.isfinite(landmarks["vertex"]).all(-1).any():
        vectors[NECK_HEAD] = seen(landmarks["neck"], landmarks["vertex"])
    for side in "lr":
        vectors[(f"clavicle_{side}",)] = seen(landmarks["neck"], landmarks[f"shoulder_{side}"])
        vectors[(f"hip_{side}",)] = seen(pelvis, landmarks[f"hip_{side}"])
    return vectors
