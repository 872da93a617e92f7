"""A person's body, from height and mass or from a static trial, into a file to read and edit.

INPUTS: height and mass; or markers of the person standing, and which landmarks they are.
OUTPUTS: subject.toml, which a recording's [subject] names; what each bone's length rests on.
"""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from jaxmocap.body.skeleton import (
    LANDMARKS,
    LEAST_HEIGHT_M,
    MOST_HEIGHT_M,
    Skeleton,
)
from jaxmocap.body.subject import NECK_HEAD, TRUNK, skeleton_stature
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.files.toml import TomlTable
from jaxmocap.formats.recordings.subject import (
    person_table,
    read_subject,
    stated_proportions,
    static_landmarks,
    write_subject,
)
from jaxmocap.formats.time_series.markers import read_markers

BY_HEIGHT = "by height"
# Lengths that differ by less are one, metres: files round them.
SAME_LENGTH_M = 1e-5
# Bones -> landmarks between which they are measured, "hips" being the middle of the hips.
_BONE_ENDS = dict.fromkeys(TRUNK, ("hips", "neck")) | dict.fromkeys(NECK_HEAD, ("neck", "vertex"))
_LIMB_ENDS = {
    "clavicle": ("neck", "shoulder_{}"),
    "humerus": ("shoulder_{}", "elbow_{}"),
    "radius": ("elbow_{}", "wrist_{}"),
    "hand": ("wrist_{}", "hand_{}"),
    "hip": ("hips", "hip_{}"),
    "femur": ("hip_{}", "knee_{}"),
    "tibia": ("knee_{}", "ankle_{}"),
    "foot": ("ankle_{}", "toe_{}"),
}
_BONE_ENDS |= {
    f"{bone}_{side}": (near.format(side), far.format(side))
    for bone, (near, far) in _LIMB_ENDS.items()
    for side in "lr"
}


@dataclass(frozen=True)
class ScaledBody:
    """A person's body."""

    skeleton: Skeleton
    height: float  # metres
    # Bone -> standard deviation, metres, over the frames of the distance that its length was taken
    # from, and their number; only of bones that were measured.
    measured_bones: Mapping[str, tuple[float, int]]
    path: Path  # of the file written

    def text(self) -> str:
        """What each bone's length rests on."""
        lines = [f"{self.height:.3f} m, {float(self.skeleton.masses.sum()):.1f} kg"]
        for bone, length in zip(self.skeleton.tree.bones, self.skeleton.lengths, strict=True):
            basis = BY_HEIGHT
            if bone in self.measured_bones:
                spread, frames = self.measured_bones[bone]
                basis = f"measured, ± {1e3 * spread:.1f} mm over {frames} frames"
                basis += (
                    ", in the proportions of the first paper"
                    if bone in (*TRUNK, *NECK_HEAD)
                    else ""
                )
            lines.append(f"{bone.ljust(11)} {float(length):.4f} m  {basis}")
        return "\n".join([*lines, f"written  {self.path}"])

    def figures(self) -> dict:
        """The same for programs."""
        bones, lengths = self.skeleton.tree.bones, self.skeleton.lengths
        return {
            "height_m": self.height,
            "mass_kg": float(self.skeleton.masses.sum()),
            "bones": {
                bone: {
                    "length_m": float(length),
                    "measured": bone in self.measured_bones,
                    "std_m": self.measured_bones.get(bone, (None, 0))[0],
                }
                for bone, length in zip(bones, lengths, strict=True)
            },
        }


def scale_subject(
    out: str | Path,
    height: float | None = None,
    static: str | Path | None = None,
    landmarks: Mapping[str, str] | None = None,
    up: str | None = None,
    mass: float | None = None,
    wrists: bool = False,
    sex: str | None = None,
) -> ScaledBody:
    """Write a person's body by height (metres), or as they stand in a static trial, and by mass.

    Args:
        out: subject.toml.
        height: metres; one of height and static trial is given.
        static: file of markers.
        landmarks: landmark -> marker; empty takes markers that are called as landmarks are.
        up: the file's vertical axis, z by default.
        mass: kilograms.
        wrists: whether the body has them.
        sex: "female" or "male", beside a height.
    """
    every: dict[str, Any] = {"wrists": wrists, "mass": mass, "sex": sex}
    stated = {key: value for key, value in every.items() if value is not None}
    if static is None:
        if landmarks or up:
            problem = "found without --static, whose trial they describe"
            raise InputError("--landmarks, --up", problem)
        if height is None:
            problem = "found no source, expected --height, --static or --recording"
            raise InputError("the person", problem)
        skeleton = read_subject(Path("the person"), "", stated | {"height": height})
        measured = {}
    else:
        if height is not None:
            raise InputError(static, "found --height beside --static, expected one of them")
        if sex is not None:
            raise InputError(static, "found --sex beside --static, which measures the lengths")
        static = Path(static)
        marker_of = dict(landmarks or {})
        marker_of = marker_of or {n: n for n in read_markers(static).names if n in LANDMARKS}
        if not marker_of:
            problem = "has no marker called as a landmark is, name them (--landmarks)"
            raise InputError(static, problem)
        table = {"static": static.name, "up": up or "z", "landmarks": marker_of}
        skeleton = read_subject(static, "", table | stated)
        measured = length_deviations(static_landmarks(TomlTable(static, "", table)))
        height = skeleton_stature(skeleton)
        if not LEAST_HEIGHT_M <= height <= MOST_HEIGHT_M:
            expected = f"expected {LEAST_HEIGHT_M:g} to {MOST_HEIGHT_M:g} m: is its unit right?"
            raise InputError(static, f"shows a person {height:.3g} m tall, {expected}")
    write_subject(out, skeleton, height, sex=sex)
    return ScaledBody(skeleton, height, measured, Path(out))


def measured_bones(path: Path) -> tuple[str, ...]:
    """Bones whose length a recording file's [subject] measures, or states as no height has it.

    Raises:
        InputError: the file, or one that it names, cannot be read.
    """
    fields = person_table(path)
    if "static" in fields:
        return tuple(length_deviations(static_landmarks(fields)))
    stated = fields.entries.get("bones", {})
    lengths = {bone: float(entry["length"]) for bone, entry in stated.items() if "length" in entry}
    if "height" not in fields:
        return tuple(lengths)
    # ``scale --height`` writes all lengths: those that follow are not measured.
    usual = Skeleton.human(fields.number("height"), proportions=stated_proportions(fields))
    by_height = dict(zip(usual.tree.bones, np.asarray(usual.lengths, float), strict=True))
    return tuple(
        bone
        for bone, length in lengths.items()
        if abs(length - by_height.get(bone, np.inf)) > SAME_LENGTH_M
    )


def length_deviations(landmarks: Mapping[str, np.ndarray]) -> dict[str, tuple[float, int]]:
    """Bone -> standard deviation (metres) over the frames of its ends' distance, and their number.

    Args:
        landmarks: name -> (T, 3) world, metres; NaN where missing.
    """
    points = dict(landmarks)
    if "hip_l" in points and "hip_r" in points:
        points["hips"] = (points["hip_l"] + points["hip_r"]) / 2
    deviations = {}
    for bone, (near, far) in _BONE_ENDS.items():
        if near in points and far in points:
            distance = np.linalg.norm(points[near] - points[far], axis=-1)
            if frames := int(np.isfinite(distance).sum()):
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore", RuntimeWarning)
                    deviations[bone] = float(np.nanstd(distance)), frames
    return deviations
