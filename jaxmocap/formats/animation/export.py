"""A tracked motion, or a person who stands still, as files for programs of animation.

INPUTS: a Motion, or a Skeleton; by choice the body's surface, and a picture of its colours.
OUTPUTS: a .bvh or .glb file, Y up, facing Z, metres, the rest pose a T.

BVH has one rate only: samples that are not evenly spaced are resampled at their median rate, and
where a pose is missing the nearest one is repeated. Where that would take many times as many frames
as there are samples (a recording with a gap of hours) no .bvh file is written, and the result says
so.
"""

from pathlib import Path

import numpy as np

from jaxmocap.body.motion import Motion
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.body.subject import rest_joints
from jaxmocap.body.surfaces.surface import Surface, rest_nodes
from jaxmocap.formats.animation.bvh import write_bvh
from jaxmocap.formats.animation.gltf import write_gltf
from jaxmocap.formats.armatures.armature import (
    Armature,
    BeyondFormatError,
    fill_from_nearest,
    rotated_armature,
)
from jaxmocap.formats.armatures.body_armature import T_POSE, armature_of
from jaxmocap.formats.armatures.skin import surface_skin
from jaxmocap.formats.time_series.axes import R_WORLD_OF_UP
from jaxmocap.formats.time_series.resampling import even_times, resample_armature
from jaxmocap.formats.time_series.tables import is_even, usual_step

# What names joints have in a file if nothing else is asked for.
DEFAULT_CONVENTION = {".bvh": "humanik", ".glb": "vrm"}
R_FILE_WORLD = R_WORLD_OF_UP["y"].T
# Frames that a BVH file may have for each sample where their times are uneven, and in any case.
MAX_GROWTH = 4
ALWAYS_ALLOWED_FRAMES = 10_000


def write_animation(
    path: str | Path, motion: Motion, surface: Surface | None = None, texture: bytes | None = None
) -> str | None:
    """Write a motion to a .bvh or .glb file, by its suffix; joints have the format's usual names.

    A .glb file's skin is the body's ``surface``, with ``surface_skin``'s texture; the limbs' solids
    without one. Returns a sentence where the format cannot hold the motion and nothing is written,
    else None. InputError where every sample's pose is missing.
    """
    kind = Path(path).suffix
    armature = rotated_armature(armature_of(motion, DEFAULT_CONVENTION[kind]), R_FILE_WORLD)
    try:
        if kind == ".glb":
            skin = None
            if surface is not None:
                skin = surface_skin(path, motion.skeleton, surface, R_FILE_WORLD, texture)
            write_gltf(path, armature, skin)
        else:
            write_bvh(path, fill_from_nearest(_evenly_sampled(path, armature), path))
    except BeyondFormatError as error:
        return f"{Path(path).name} is left out: {error.problem}"
    return None


def _evenly_sampled(path: str | Path, armature: Armature) -> Armature:
    """An armature at one rate, its gaps missing; BeyondFormatError where it would be far longer."""
    times = armature.times
    if is_even(times):
        return armature
    steps = np.diff(times)
    rate = 1 / usual_step(times)
    count, most = (times[-1] - times[0]) * rate, max(ALWAYS_ALLOWED_FRAMES, MAX_GROWTH * len(times))
    if count > most:
        problem = f"BVH has one rate only, and its {len(times)} samples at {rate:g} Hz would take"
        gap = f"{count:.6g} frames (up to {steps.max():g} s apart)"
        raise BeyondFormatError(path, f"{problem} {gap}, expected at most {most}")
    # Only positions are in memory at once.
    return resample_armature(armature, even_times(times, rate, 3, path))


def write_avatar(
    path: str | Path, skeleton: Skeleton, surface: Surface, texture: bytes | None = None
) -> None:
    """Write a person as a .glb file to be moved: in a T pose, feet on the ground."""
    angles = [[np.radians(T_POSE.get(joint, 0.0)) for joint in skeleton.tree.joints]]
    lowest = float(rest_nodes(surface, rest_joints(skeleton))[:, 2].min())
    parts = [[0.0, 0.0, -lowest]], [[1.0, 0.0, 0.0, 0.0]], angles
    pose = Pose(*map(np.array, parts))  # type: ignore[arg-type]
    standing = armature_of(Motion(skeleton, np.zeros(1), pose), DEFAULT_CONVENTION[".glb"])
    skin = surface_skin(path, skeleton, surface, R_FILE_WORLD, texture)
    write_gltf(path, rotated_armature(standing, R_FILE_WORLD), skin, still=True)
