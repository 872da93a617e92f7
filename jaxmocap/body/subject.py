"""Scaling a skeleton to a person by the landmarks of a static trial; how tall a skeleton stands.

INPUTS: a Skeleton and landmark positions (metres, world Z up).
OUTPUTS: a Skeleton of the same tree with other lengths, directions, masses, diameters; a stature.
"""

from dataclasses import replace

import numpy as np

from jaxmocap.body.model_files import proportions_of
from jaxmocap.body.skeleton import (
    JOINT_CENTRES,
    LANDMARKS,
    LEAST_HEIGHT_M,
    MOST_HEIGHT_M,
    NECK_HEAD,
    TRUNK,
    WINTER,
    Skeleton,
    scale_to_height,
    with_girths,
)
from jaxmocap.compilation.arrays import on_device

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
# Landmarks of who stands, the second to the left of the first or ahead of it, by its axis in the
# trunk's frame. Wrists may cross.
_BESIDE = (
    *((f"{part}_r", f"{part}_l", 1, "on the right of") for part in ("elbow", "knee", "ankle")),
    *((f"ankle_{side}", f"toe_{side}", 0, "behind") for side in "lr"),
)
LEFT_IS_LEFT = "expected left landmarks on the left of right ones"
# Cosine between the vertical and the way from ankles to vertex, of a person who stands.
LEAST_UPRIGHT = 0.7


def scale_to_landmarks(skeleton: Skeleton, landmarks: dict[str, np.ndarray]) -> Skeleton:
    """Scale by a static trial: robust means of lengths, and the directions of what has no DoF.

    The person stands upright, arms anywhere. What no landmark measures follows from the height that
    the measured lengths suggest. The pelvis is the midpoint of the hips; spine and neck with head
    are split as in the skeleton given.

    Args:
        skeleton: the tree and the defaults.
        landmarks: name (of ``LANDMARKS``) to (T, 3) positions, metres, Z up; NaN where missing.

    Raises:
        ValueError: an unknown landmark, or one that is needed (neck, hips, shoulders) has no data;
            landmarks on the other side; vertex and ankles not one above the other.
    """
    unknown = sorted(set(landmarks) - set(LANDMARKS))
    if unknown:
        raise ValueError(f"unknown landmark {unknown[0]!r}; expected one of {', '.join(LANDMARKS)}")
    for name in ("neck", "hip_l", "hip_r", "shoulder_l", "shoulder_r"):
        if name not in landmarks or not np.isfinite(landmarks[name]).all(-1).any():
            raise ValueError(f"a static trial needs the landmark {name!r} in at least one frame")
    measured = {which: _distance(landmarks, *ends) for which, ends in _MEASURED.items()}
    height = _height(landmarks, measured)
    guess = scale_to_height(skeleton, height, None)
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
    scaled = replace(guess, lengths=on_device(lengths), directions=on_device(directions))
    return with_girths(scale_to_height(skeleton, height, None, WINTER), scaled)


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

    The limbs' height is the median of those at which the table's limbs are as long as the measured.
    Without any it is that of trunk, neck and head, as far up as they were measured.
    """
    table = proportions_of(JOINT_CENTRES)
    if {"vertex", "ankle_l", "ankle_r"} <= set(landmarks):
        ankles = (landmarks["ankle_l"] + landmarks["ankle_r"]) / 2
        upwards = landmarks["vertex"] - ankles
        if np.isfinite(upwards).all(-1).any():
            upwards = np.nanmedian(upwards, axis=0)
            if upwards[2] < LEAST_UPRIGHT * np.linalg.norm(upwards):
                axis = np.abs(upwards).argmax()
                stands = f"{'-' if upwards[axis] < 0 else ''}{'xyz'[axis]}"
                raise ValueError(
                    f"the person stands along {stands} in the static trial, expected z: state its "
                    "vertical axis (up), or let the person stand upright"
                )
            tall = upwards[2] / (1 - table["ankle"])
            return float(np.clip(tall, LEAST_HEIGHT_M, MOST_HEIGHT_M))
    ratios = [
        length / table["lengths"][part]
        for (part, _), length in measured.items()
        if length is not None and part != "foot"
    ]
    pelvis, parts = (landmarks["hip_l"] + landmarks["hip_r"]) / 2, table["lengths"]
    usual_lengths = {"vertex": parts["trunk"] + parts["neck_head"], "neck": parts["trunk"]}
    for top, usual in usual_lengths.items():
        length = _distance({**landmarks, "pelvis": pelvis}, "pelvis", top)
        if not ratios and length is not None:
            ratios = [length / usual]
    if not ratios:
        return 1.75
    return float(np.clip(np.median(ratios), LEAST_HEIGHT_M, MOST_HEIGHT_M))


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
        each = np.einsum("tij,tj->ti", R_trunk_world, b - a)
        if not np.isfinite(each).all(-1).any():
            raise ValueError("found neck, hips and shoulders in no common frame")
        return np.nanmedian(each, axis=0)

    vectors: dict[tuple[str, ...], np.ndarray] = {TRUNK: vector(pelvis, landmarks["neck"])}
    vertex = landmarks.get("vertex", np.full_like(pelvis, np.nan))
    if np.isfinite(vertex - landmarks["neck"] + pelvis).all(-1).any():
        vectors[NECK_HEAD] = vector(landmarks["neck"], landmarks["vertex"])
    for side in "lr":
        vectors[(f"clavicle_{side}",)] = vector(landmarks["neck"], landmarks[f"shoulder_{side}"])
        vectors[(f"hip_{side}",)] = vector(pelvis, landmarks[f"hip_{side}"])
    for part in ("clavicle", "hip"):
        across = vectors[(f"{part}_l",)][1] - vectors[(f"{part}_r",)][1]
        if across <= 0:
            found = "found hips and shoulders on opposite sides, or in one place"
            raise ValueError(f"{found}: {LEFT_IS_LEFT}")
    for near, far, axis, where in _BESIDE:
        if {near, far} <= set(landmarks):
            each = np.einsum("tij,tj->ti", R_trunk_world, landmarks[far] - landmarks[near])
            if np.isfinite(each).any() and np.nanmedian(each[:, axis]) < 0:
                raise ValueError(f"found {far} {where} {near}: {LEFT_IS_LEFT}, and toes ahead")
    return vectors


def skeleton_stature(skeleton: Skeleton) -> float:
    """How tall the skeleton stands, metres, from sole to vertex."""
    vectors = bone_vectors(skeleton)
    sole, vertex = sole_and_vertex(rest_joints(skeleton), vectors)
    return vertex - sole


def bone_vectors(skeleton: Skeleton) -> np.ndarray:
    """(B, 3) from each joint to its bone's far end with all angles 0, metres."""
    return np.asarray(skeleton.lengths, float)[:, None] * np.asarray(skeleton.directions, float)


def rest_joints(skeleton: Skeleton) -> np.ndarray:
    """Joints (B, 3) of all bones from the pelvis, with all angles 0, metres."""
    vectors = bone_vectors(skeleton)
    joints = np.zeros_like(vectors)
    for bone, parent in enumerate(skeleton.tree.parents):
        if parent >= 0:
            joints[bone] = joints[parent] + vectors[parent]
    return joints


def sole_and_vertex(joints: np.ndarray, vectors: np.ndarray) -> tuple[float, float]:
    """Heights of the body's ends; the lowest joints, the ankles, are a share of them above one."""
    vertex, ankle = float((joints + vectors)[:, 2].max()), float(joints[:, 2].min())
    return vertex - (vertex - ankle) / (1 - proportions_of(JOINT_CENTRES)["ankle"]), vertex
