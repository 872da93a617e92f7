"""Scaling a skeleton to a person by the landmarks of a static trial.

INPUTS: a Skeleton and landmark positions (metres, world Z up).
OUTPUTS: a Skeleton of the same tree with other lengths, directions, masses and diameters.
"""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np

from jaxmocap.body.skeleton import (
    ANKLE_HEIGHT,
    LANDMARKS,
    NECK_HEAD,
    TRUNK,
    WINTER_LENGTHS,
    Skeleton,
    scale_to_height,
    with_girths,
)

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


def scale_to_landmarks(skeleton: Skeleton, landmarks: dict[str, np.ndarray]) -> Skeleton:
    """Scale by a static trial: robust means of lengths, and the directions of what has no DoF.

    The person stands upright, arms anywhere. What no landmark measures follows from the height that
    the measured lengths suggest. The pelvis is the midpoint of the hips; spine and neck with head
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
    return with_girths(guess, scaled)


def _distance(landmarks: dict[str, np.ndarray], a: str, b: str) -> float | None:
    """Median distance over the frames that show both, or None."""
    if a not in landmarks or b not in landmarks:
        return None
    lengths = np.linalg.norm(landmarks[a] - landmarks[b], axis=-1)
    return float(np.nanmedian(lengths)) if np.isfinite(lengths).any() else None


def _height(
    landmarks: dict[str, np.ndarray], measured: dict[tuple[str, str], float | None]
) -> float:
    """Body height, metres: from vertex to ankles where both are measured, else from the limbs.

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

    def vector(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return np.nanmedian(np.einsum("tij,tj->ti", R_trunk_world, b - a), axis=0)

    vectors: dict[tuple[str, ...], np.ndarray] = {TRUNK: vector(pelvis, landmarks["neck"])}
    if "vertex" in landmarks and np.isfinite(landmarks["vertex"]).all(-1).any():
        vectors[NECK_HEAD] = vector(landmarks["neck"], landmarks["vertex"])
    for side in "lr":
        vectors[(f"clavicle_{side}",)] = vector(landmarks["neck"], landmarks[f"shoulder_{side}"])
        vectors[(f"hip_{side}",)] = vector(pelvis, landmarks[f"hip_{side}"])
    return vectors
