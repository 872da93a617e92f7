"""A motion as the coordinates of OpenSim's full-body model (Rajagopal et al. 2016).

INPUTS: a Motion. OUTPUTS: coordinates over time by the model's names, signs and axes; a .mot file,
Y up, that OpenSim's tools read.

x, y, z of the file are y, z, x of our world, as ``up = "y"`` of a recording has it. Each coordinate
puts the model's bodies where ours are:

- pelvis and thorax: their orientations; the origin of the pelvis such that the midpoints of the
  hips agree, for a pelvis as high and deep for its thigh as the model's;
- thigh and shank, upper arm and forearm: their directions, and the plane in which they bend. The
  model's oblique elbow and its moving knee are in ``rajagopal``;
- ankle, rotation of the forearm, wrist: between the bones, of bodies that have such joints.

The model has one joint in the back, no neck and no clavicle. Where our body has no joint, the
coordinate is constant: 0, but 90 degrees of ``pro_sup``, which are thumbs forward. Samples without
a pose are left out, since OpenSim has no missing values.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from jaxmocap.body.motion import Motion
from jaxmocap.body.orientations import about, body_turns, matrices
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.opensim import rajagopal
from jaxmocap.formats.opensim.rajagopal import Limb
from jaxmocap.formats.time_series.axes import R_WORLD_OF_UP, Y_UP
from jaxmocap.formats.time_series.isb import (
    LIMB_JOINTS,
    MIRROR,
    R_BONE_ISB,
    hinge_angles,
    isb_angles,
)
from jaxmocap.formats.time_series.mot import write_table
from jaxmocap.geometry.euler import FREE, continuous_euler, ease_near_lock, wrap_angles

# The name of this convention among those of joints.
OPENSIM = "opensim"
_ROOT = ("pelvis_tilt", "pelvis_list", "pelvis_rotation", "pelvis_tx", "pelvis_ty", "pelvis_tz")
_LUMBAR = ("lumbar_extension", "lumbar_bending", "lumbar_rotation")
_HIP = ("hip_flexion_{}", "hip_adduction_{}", "hip_rotation_{}")
# The patella follows the knee.
_KNEE = ("knee_angle_{}", "knee_angle_{}_beta")
_FOOT = ("ankle_angle_{}", "subtalar_angle_{}", "mtp_angle_{}")
_SHOULDER = ("arm_flex_{}", "arm_add_{}", "arm_rot_{}")
_FOREARM = ("elbow_flex_{}", "pro_sup_{}", "wrist_flex_{}", "wrist_dev_{}")
# As the model's file has them, degrees, but for the pelvis, which faces anywhere and may roll over.
_RANGES = {
    _ROOT[:3]: (FREE, (-90, 90), FREE),
    _LUMBAR: ((-90, 90), (-90, 90), (-90, 90)),
    _HIP: ((-30, 120), (-50, 30), (-40, 40)),
    _SHOULDER: ((-90, 90), (-120, 90), (-90, 90)),
}
# In the order of the model's file.
COORDINATES = (
    *_ROOT,
    *(name.format(side) for side in "rl" for name in (*_HIP, *_KNEE, *_FOOT)),
    *_LUMBAR,
    *(name.format(side) for side in "rl" for name in (*_SHOULDER, *_FOREARM)),
)
# A fit of two angles to an orientation converges from 0 in fewer.
_FOOT_ROUNDS = 12


def write_opensim(path: str | Path, motion: Motion) -> list[str]:
    """Write a motion's coordinates, degrees and metres; sentences on what was left out.

    InputError where no sample has a pose.
    """
    is_measured = np.isfinite(np.asarray(motion.poses.quaternion, float).sum(-1))
    if not is_measured.any():
        raise InputError(path, "no sample has a pose, and OpenSim has no missing values")
    parts = (np.asarray(part, float)[is_measured] for part in motion.poses)
    poses, times = Pose(*parts), motion.times[is_measured]  # type: ignore[arg-type]
    columns = opensim_coordinates(replace(motion, times=times, poses=poses, report=None))
    degrees = {
        name: values if name in _ROOT[3:] else np.degrees(values)
        for name, values in columns.items()
    }
    table = np.stack(list(degrees.values()), 1)
    steps = write_table(Path(path), times, tuple(degrees), table)
    sentences = ["left out: neck and clavicles, which OpenSim's model does not have"]
    if missing := int((~is_measured).sum()):
        sentences.append(f"left out: {missing} samples without a pose, which OpenSim cannot read")
    return sentences + steps


def opensim_coordinates(motion: Motion) -> dict[str, np.ndarray]:
    """Each of ``COORDINATES`` -> (T,) radians, no jumps, or metres; every sample has a pose."""
    skeleton = motion.skeleton
    turns = body_turns(skeleton, np.asarray(motion.poses.angles, float))
    R_pelvis_bone = R_BONE_ISB.T @ turns @ R_BONE_ISB
    R_file_pelvis = (
        R_WORLD_OF_UP[Y_UP].T @ matrices(np.asarray(motion.poses.quaternion, float)) @ R_BONE_ISB
    )
    R_thorax = R_pelvis_bone[:, skeleton.tree.bone("spine3")]
    limbs = {
        (part, side): _limb_turns(skeleton, R_thorax, R_pelvis_bone, part, side)
        for side in "rl"
        for part in ("leg", "arm")
    }
    turns = np.stack([R_file_pelvis, R_thorax, *(R_near for R_near, _ in limbs.values())], 1)
    names = [_ROOT[:3], _LUMBAR, *({"leg": _HIP, "arm": _SHOULDER}[part] for part, _ in limbs)]
    sides = ["", "", *(side for _, side in limbs)]
    ranges = np.radians([_RANGES[triple] for triple in names])
    angles = ease_near_lock(continuous_euler(turns, "ZXY", ranges, motion.times), "ZXY")
    columns = {
        name.format(side): column
        for triple, side, three in zip(names, sides, np.moveaxis(angles, 1, 0), strict=True)
        for name, column in zip(triple, three.T, strict=True)
    }
    columns |= dict(zip(_ROOT[3:], _pelvis_places(motion, R_file_pelvis).T, strict=True))
    hands = isb_angles(motion)
    for (part, side), (R_near, angle) in limbs.items():
        if part == "leg":
            columns |= dict.fromkeys((name.format(side) for name in _KNEE), angle)
            columns |= _foot(skeleton, R_pelvis_bone, side)
        else:
            R_radius = R_thorax.swapaxes(-1, -2) @ R_pelvis_bone[:, _bone(skeleton, "radius", side)]
            columns[f"elbow_flex_{side}"] = angle
            columns[f"pro_sup_{side}"] = _pronation(
                skeleton, R_near, angle, _mirror_left(R_radius, side), side
            )
            for ours, name in (("flexion", "wrist_flex"), ("deviation", "wrist_dev")):
                columns[f"{name}_{side}"] = hands.get(f"wrist_{ours}_{side}", 0.0 * angle)
    return {name: columns[name] for name in COORDINATES}


def _bone(skeleton: Skeleton, bone: str, side: str) -> int:
    return skeleton.tree.bone(f"{bone}_{side}")


def _mirror_left(R: np.ndarray, side: str) -> np.ndarray:
    """Rotations (T, 3, 3) of a left limb as those of a right one."""
    return MIRROR @ R @ MIRROR if side == "l" else R


def _limb_turns(
    skeleton: Skeleton, R_thorax: np.ndarray, R_pelvis_bone: np.ndarray, part: str, side: str
) -> tuple[np.ndarray, np.ndarray]:
    """The model's near body (T, 3, 3) in pelvis or thorax, and the knee's or elbow's angle (T,)."""
    is_leg = part == "leg"
    limb: Limb = rajagopal.leg() if is_leg else rajagopal.arm()
    bones = [_bone(skeleton, b, side) for b in (("femur", "tibia") if is_leg else
                                                ("humerus", "radius"))]  # fmt: skip
    R_base = np.eye(3) if is_leg else R_thorax.swapaxes(-1, -2)
    R_near, R_far = (_mirror_left(R_base @ R_pelvis_bone[:, bone], side) for bone in bones)
    directions = np.asarray(skeleton.directions, float)[bones] @ R_BONE_ISB
    directions = directions @ MIRROR if side == "l" else directions
    along, beyond = R_near @ directions[0], R_far @ directions[1]
    hinge = R_near[..., 2] * (-1.0 if is_leg else 1.0)
    across = np.cross(along, beyond)
    angle, normal = limb.bend_at(np.arctan2((across * hinge).sum(-1), (along * beyond).sum(-1)))
    ours, models = _frames(along, hinge), _frames(np.broadcast_to(limb.near, along.shape), normal)
    return ours @ models.swapaxes(-1, -2), angle


def _frames(along: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Rotations (T, 3, 3) whose first axis is (T, 3) along, their second nearest to normal."""
    second = normal - (normal * along).sum(-1, keepdims=True) * along
    second = second / np.linalg.norm(second, axis=-1, keepdims=True)
    return np.stack([along, second, np.cross(along, second)], -1)


def _pelvis_places(motion: Motion, R_file_pelvis: np.ndarray) -> np.ndarray:
    """Origins (T, 3) of the model's pelvis, the file's axes, metres."""
    skeleton = motion.skeleton
    lengths = np.asarray(skeleton.lengths, float)
    hips = [_bone(skeleton, "hip", side) for side in "lr"]
    reach = lengths[hips, None] * np.asarray(skeleton.directions)[hips]
    thigh = lengths[[_bone(skeleton, "femur", side) for side in "lr"]].mean()
    from_origin = rajagopal.HIP * [1.0, 1.0, 0.0] * thigh / rajagopal.leg().length
    to_middle = R_file_pelvis @ (R_BONE_ISB.T @ reach.mean(0) - from_origin)
    return motion.positions_world @ R_WORLD_OF_UP[Y_UP] + to_middle


def _pronation(
    skeleton: Skeleton, R_humerus: np.ndarray, elbow: np.ndarray, R_radius: np.ndarray, side: str
) -> np.ndarray:
    """``pro_sup`` (T,) that points the thumb as ours does, mirrored; constant without a joint."""
    joint = next(joint for joint in LIMB_JOINTS if joint.name == "elbow")
    if 2 not in hinge_angles(skeleton, joint, side):
        return np.full(len(elbow), rajagopal.THUMB_FORWARD)
    R_ulna = R_humerus @ about(rajagopal.ELBOW_AXIS, elbow)
    axis, supine = R_ulna @ rajagopal.PRO_SUP_AXIS, R_ulna[..., 2]
    thumb = R_radius[..., 0]
    sine = (axis * np.cross(supine, thumb)).sum(-1)
    cosine = (supine * thumb).sum(-1) - (axis * supine).sum(-1) * (axis * thumb).sum(-1)
    away = np.arctan2(sine, cosine) - rajagopal.THUMB_FORWARD
    return rajagopal.THUMB_FORWARD + wrap_angles(away)


def _foot(skeleton: Skeleton, R_pelvis_bone: np.ndarray, side: str) -> dict[str, np.ndarray]:
    """Angles (T,) about the model's oblique axes that are nearest to our foot's orientation."""
    angles = np.zeros((len(R_pelvis_bone), 2))
    joint = next(joint for joint in LIMB_JOINTS if joint.name == "ankle")
    if hinge_angles(skeleton, joint, side):
        tibia, foot = (R_pelvis_bone[:, _bone(skeleton, b, side)] for b in ("tibia", "foot"))
        angles = _two_hinges(
            _mirror_left(tibia.swapaxes(-1, -2) @ foot, side),
            rajagopal.ANKLE_AXIS,
            rajagopal.SUBTALAR_AXIS,
        )
    columns = (*angles.T, np.zeros(len(angles)))
    return {name.format(side): column for name, column in zip(_FOOT, columns, strict=True)}


def _two_hinges(R: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Angles (T, 2) about two axes, in turn, that are nearest to (T, 3, 3) rotations."""
    angles = np.zeros((len(R), 2))
    for _ in range(_FOOT_ROUNDS):
        R_first, R_second = about(first, angles[:, 0]), about(second, angles[:, 1])
        rest = (R_first @ R_second).swapaxes(-1, -2) @ R
        error = np.stack([rest[:, 2, 1] - rest[:, 1, 2], rest[:, 0, 2] - rest[:, 2, 0],
                          rest[:, 1, 0] - rest[:, 0, 1]], -1) / 2  # fmt: skip
        # Both axes in the frame that the two turns leave.
        axes = np.stack(
            [R_second.swapaxes(-1, -2) @ first, np.broadcast_to(second, error.shape)], -1
        )
        normal = axes.swapaxes(-1, -2) @ axes
        angles += np.linalg.solve(normal, (axes.swapaxes(-1, -2) @ error[..., None]))[..., 0]
    return angles
