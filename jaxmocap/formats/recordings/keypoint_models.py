"""Models of 2-D pose detectors: which of their points are landmarks of ours.

INPUTS: a model's name, the names that a file gives its points, or points whose count identifies
the model.
OUTPUTS: the names of a model's points in order; for each landmark of ours the index of its point.
"""

from collections.abc import Sequence

import numpy as np

_COCO = (
    *("nose", "left_eye", "right_eye", "left_ear", "right_ear"),
    *("left_shoulder", "right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist"),
    *("left_hip", "right_hip", "left_knee", "right_knee", "left_ankle", "right_ankle"),
)
_ARMS = (
    *("right_shoulder", "right_elbow", "right_wrist"),
    *("left_shoulder", "left_elbow", "left_wrist"),
)
_LEGS = ("right_hip", "right_knee", "right_ankle", "left_hip", "left_knee", "left_ankle")
_FACE = ("right_eye", "left_eye", "right_ear", "left_ear")
_FEET = (
    *("left_big_toe", "left_small_toe", "left_heel"),
    *("right_big_toe", "right_small_toe", "right_heel"),
)
_HALPE_FEET = (
    *("left_big_toe", "right_big_toe", "left_small_toe", "right_small_toe"),
    *("left_heel", "right_heel"),
)
# Model -> its points in the file's order. OpenPose: BODY_25, BODY_25B, COCO_18. RTMPose, MMPose
# and Pose2Sim: COCO_17, HALPE_26, COCO_133 (whose 110 points of face and hands are of no use here:
# COCO_23 is without them).
# MEDIAPIPE_19: of MediaPipe's 33 points those that COCO has, and the toes.
MODELS: dict[str, tuple[str, ...]] = {
    "BODY_25": ("nose", "mid_shoulder", *_ARMS, "hip", *_LEGS, *_FACE, *_FEET),
    "BODY_25B": (*_COCO, "neck", "head", *_FEET),
    "COCO_18": ("nose", "mid_shoulder", *_ARMS, *_LEGS, *_FACE),
    "COCO_17": _COCO,
    "MEDIAPIPE_19": (*_COCO, "left_big_toe", "right_big_toe"),
    "COCO_23": (*_COCO, *_FEET),
    "HALPE_26": (*_COCO, "head", "neck", "hip", *_HALPE_FEET),
    "COCO_133": (*_COCO, *_FEET, *[""] * 110),
}
# Point -> landmark. The "neck" of BODY_25 and COCO_18 is the middle of the shoulders, which is
# none of ours; that of the others lies at the head's lower end, and their "head" is its top.
LANDMARK_OF: dict[str, str] = {
    "neck": "neck",
    "upper_neck": "neck",
    "head": "vertex",
    "head_top": "vertex",
    "hip": "pelvis",
    "root": "pelvis",
    "pelvis": "pelvis",
    "left_big_toe": "toe_l",
    "right_big_toe": "toe_r",
} | {
    f"{side}_{joint}": f"{joint}_{side[0]}"
    for joint in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
    for side in ("left", "right")
}
# Of two models with as many points, the right one has the face's points close together. It is
# taken where it makes the face smaller by this factor in the median,
_MIN_SIZE_RATIO = 2.0
# and smaller at all in this share of the people.
_MIN_AGREEING_SHARE = 0.9
# Fewer points of a face than this have no extent worth comparing.
_MIN_FACE_POINTS = 3


def landmark_indices(points: Sequence[str]) -> dict[str, int]:
    """Landmark of ours -> index of its point, for a model whose points have these names."""
    return {LANDMARK_OF[name]: i for i, name in enumerate(points) if name in LANDMARK_OF}


def model_by_faces(pixels_xy: np.ndarray, models: Sequence[str]) -> str | None:
    """Which of two models the points are of, by how compact the face is.

    Nose, eyes and ears lie close together in the right reading, and are limbs in the wrong one.

    Args:
        pixels_xy: (N, K, 2) the K points of N people; NaN where missing.
        models: two names of models with K points.

    Returns:
        One of the names, or None where the points do not decide it safely.
    """
    extents = np.array([_face_extents(pixels_xy, MODELS[model]) for model in models])
    first, second = extents[:, np.isfinite(extents).all(0)]
    if not len(first):
        return None
    # How many times the first reading's face is larger than the second's, as a logarithm.
    larger = np.log(np.maximum(first, 1.0) / np.maximum(second, 1.0))
    median = float(np.median(larger))
    agreeing = float(np.mean(np.sign(larger) == np.sign(median)))
    if abs(median) < np.log(_MIN_SIZE_RATIO) or agreeing < _MIN_AGREEING_SHARE:
        return None
    return models[0] if median < 0 else models[1]


def _face_extents(pixels_xy: np.ndarray, points: Sequence[str]) -> np.ndarray:
    """(N,) diagonal of the box about each face, pixels; NaN where too little of it is detected."""
    face = pixels_xy[:, [points.index(name) for name in ("nose", *_FACE)]]
    is_detected = np.all(np.isfinite(face), axis=-1)
    lowest = np.where(is_detected[..., None], face, np.inf).min(1)
    highest = np.where(is_detected[..., None], face, -np.inf).max(1)
    enough = is_detected.sum(-1) >= _MIN_FACE_POINTS
    return np.where(enough, np.linalg.norm(highest - lowest, axis=-1), np.nan)
