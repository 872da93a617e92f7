"""Our skeleton as an armature, and back.

INPUTS: a Motion; or an Armature whose joints are ours. OUTPUTS: the other.

The rest pose, in which no joint is rotated, is a T: upright, arms straight out to the sides, palms
down, legs straight, feet forwards, as VRM, HumanIK and SMPL have it. The pelvis is the root; the
bones from there to the hips, which do not move against it, are its joints' offsets.
"""

import warnings
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from jaxmocap.body.motion import Motion, near_origin
from jaxmocap.body.orientations import body_turns, local_turns, matrices, quaternions
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton, with_wrists
from jaxmocap.body.subject import bone_vectors
from jaxmocap.compilation.arrays import on_device
from jaxmocap.formats.armatures.armature import Armature
from jaxmocap.formats.armatures.joint_names import (
    CONVENTIONS,
    JOINTS_WITH_END,
    PELVIS,
    end_of,
    names_to_ours,
)
from jaxmocap.formats.files.errors import InputError, comma_list, short_name
from jaxmocap.geometry.rows import ComputedRows, Index

# Angles of our skeleton in the T pose, degrees; the others are 0.
T_POSE = {"arm_abduct_l": 90.0, "arm_abduct_r": 90.0}
# How far a joint may lie from where our skeleton has it, metres.
MAX_OFFSET_ERROR_M = 1e-3
# How far a limb may point from where our T has it, radians: of another rest pose, such as one whose
# arms hang, angles are others.
LIMBS, MAX_REST_ERROR_RAD = ("humerus", "radius", "femur", "tibia"), np.radians(20)
# How far a joint may be rotated from what our hinges can do, radians.
MAX_ROTATION_ERROR_RAD = 1e-3


def armature_of(motion: Motion, convention: str = "jaxmocap") -> Armature:
    """A motion of our skeleton in the world's axes, its joints named by one of ``CONVENTIONS``."""
    skeleton, names = motion.skeleton, CONVENTIONS[convention]
    tree = skeleton.tree
    joints, parents = joint_tree(skeleton)
    bones = {name: i for i, name in enumerate(tree.bones)}
    _, quaternion, angles = map(np.asarray, motion.poses)
    rest = rest_orientations(skeleton)
    reach = bone_vectors(skeleton)
    offsets, radii = np.zeros((len(joints), 3)), np.zeros((len(joints), 2))
    for j, joint in enumerate(joints[1:], 1):
        across = bone_ending_at(skeleton, joint)
        if across is not None:
            offsets[j] = rest[across] @ reach[across]
            radii[j] = np.asarray(skeleton.diameters)[across] / 2

    def rotations(rows: Index) -> np.ndarray:
        local = local_turns(skeleton, angles[rows].astype(float))
        R = np.tile(np.eye(3), (len(local), len(joints), 1, 1))
        R[:, 0] = matrices(quaternion[rows].astype(float))
        for j, joint in enumerate(joints):
            if joint in bones:
                bone, parent = bones[joint], tree.parents[bones[joint]]
                R_rest_parent = np.eye(3) if parent < 0 else rest[parent]
                R[:, j] = R_rest_parent @ local[:, bone] @ rest[bone].T
        return R

    return Armature(
        tuple(names[joint] for joint in joints),
        parents,
        offsets,
        np.asarray(motion.times, float),
        np.asarray(motion.positions_world, float),
        ComputedRows((len(angles), len(joints), 3, 3), rotations),
        radii,
    )


def joint_tree(skeleton: Skeleton) -> tuple[tuple[str, ...], tuple[int, ...]]:
    """Our joints and their parents: the pelvis, bones that turn or carry others, and ends."""
    tree = skeleton.tree
    joints, parents = [PELVIS], [-1]

    def grow(bone: int, parent: int) -> None:
        name = tree.bones[bone]
        if not name.startswith("hip_"):
            joints.append(name)
            parents.append(parent)
            parent = len(joints) - 1
        for child in (i for i, above in enumerate(tree.parents) if above == bone):
            grow(child, parent)
        if name in JOINTS_WITH_END:
            joints.append(end_of(name))
            parents.append(parent)

    for bone in (i for i, above in enumerate(tree.parents) if above < 0):
        grow(bone, 0)
    return tuple(joints), tuple(parents)


def bone_ending_at(skeleton: Skeleton, joint: str) -> int | None:
    """The bone at whose far end a joint lies; None for those at the pelvis."""
    tree = skeleton.tree
    if joint == PELVIS:
        return None
    if joint not in tree.bones:
        return tree.bones.index(joint.removesuffix("_end"))
    parent = tree.parents[tree.bones.index(joint)]
    return parent if parent >= 0 else None


def rest_orientations(skeleton: Skeleton) -> np.ndarray:
    """Orientations (B, 3, 3) in the body's frame of the bones in the T pose."""
    angles = [np.radians(T_POSE.get(joint, 0.0)) for joint in skeleton.tree.joints]
    return body_turns(skeleton, np.array([angles]))[0]


def motion_of(armature: Armature, path: str | Path) -> Motion:
    """The motion of our skeleton that an armature, in the world's axes and our T at rest, shows.

    Masses, diameters, limits and costs are those of a person with bones as long on the whole. Where
    the neck turns, a forearm twists or a wrist bends, it is a body with wrists. InputError, about
    ``path``, for joints that are not ours, lie elsewhere, or turn as ours cannot.
    """
    to_ours = names_to_ours(armature.names)
    if to_ours is None:
        names = comma_list(armature.names)
        raise InputError(path, f"not our skeleton, whatever its joints are called: {names}")
    index = {to_ours[name]: j for j, name in enumerate(armature.names) if name in to_ours}
    skeleton = _skeleton_of(Skeleton.human(), armature, index, path)
    try:
        angles = _angles(skeleton, armature, index, path)
    except InputError:
        # A body with wrists turns more; what it cannot turn either is refused in its words.
        skeleton = with_wrists(skeleton)
        angles = _angles(skeleton, armature, index, path)
    is_valid = armature.is_valid[:, None]
    root = quaternions(armature.rotations[:][:, index[PELVIS]])
    parts = [armature.positions, root, angles]
    parts_or_nan: list[Any] = [np.where(is_valid, part, np.nan) for part in parts]
    return near_origin(Motion(skeleton, armature.times, Pose(*parts_or_nan)))


def _angles(
    skeleton: Skeleton, armature: Armature, index: Mapping[str, int], path: str | Path
) -> np.ndarray:
    """Angles (T, D), radians, of bones as the joints have them; InputError where hinges cannot."""
    angles = np.zeros((len(armature.times), len(skeleton.tree.joints)))
    rest, rotations = rest_orientations(skeleton), armature.rotations[:]
    for bone, name in enumerate(skeleton.tree.bones):
        if name in index:
            parent = skeleton.tree.parents[bone]
            R_rest_parent = np.eye(3) if parent < 0 else rest[parent]
            local = R_rest_parent.T @ rotations[:, index[name]] @ rest[bone]
            dofs = [d for d, carried in enumerate(skeleton.tree.dof_bones) if carried == bone]
            angles[:, dofs] = hinge_angles(skeleton, dofs, local)
            # The angle between ours and the armature's; of unknown poses nothing is asked.
            traces = np.einsum("tij,tij->t", local_turns(skeleton, angles)[:, bone], local)
            off = np.nan_to_num(np.arccos(np.clip((traces - 1) / 2, -1, 1)))
            if off.max() > MAX_ROTATION_ERROR_RAD:
                i = int(off.argmax())
                problem = f"rotated {np.degrees(off[i]):.1f}° in a way that our joint cannot rotate"
                raise InputError(path, f"{name} at {armature.times[i]:g} s: {problem}")
    return angles


def _skeleton_of(
    skeleton: Skeleton, armature: Armature, index: Mapping[str, int], path: str | Path
) -> Skeleton:
    """Our skeleton with an armature's lengths and directions."""
    rest = rest_orientations(skeleton)
    joints, parents = joint_tree(skeleton)
    parent_of = {joint: joints[p] if p >= 0 else None
                 for joint, p in zip(joints, parents, strict=True)}  # fmt: skip
    by_index = {j: joint for joint, j in index.items()}
    lengths, directions = np.array(skeleton.lengths, float), np.array(skeleton.directions, float)
    bone_vectors: dict[int, np.ndarray] = {}
    for joint, j in index.items():
        if parent_of[joint] != by_index.get(armature.parents[j]):
            problem = f"not our skeleton: {short_name(armature.names[j])} hangs on another joint"
            raise InputError(path, problem)
        bone = bone_ending_at(skeleton, joint)
        vector = armature.offsets[j] if bone is None else rest[bone].T @ armature.offsets[j]
        expected = np.zeros(3) if bone is None else bone_vectors.setdefault(bone, vector)
        if np.linalg.norm(vector - expected) > MAX_OFFSET_ERROR_M:
            problem = f"not our skeleton: {short_name(armature.names[j])} starts elsewhere"
            raise InputError(path, problem)
    for bone, vector in bone_vectors.items():
        if (length := np.linalg.norm(vector)) > 0:
            aside = np.arccos(np.clip(vector / length @ directions[bone], -1, 1))
            if (name := skeleton.tree.bones[bone])[:-2] in LIMBS and aside > MAX_REST_ERROR_RAD:
                problem = f"{name} points {np.degrees(aside):.0f}° aside"
                raise InputError(path, f"the rest pose is not our T: {problem}")
            lengths[bone], directions[bone] = length, vector / length
    height = lengths.sum() / float(np.sum(np.asarray(Skeleton.human(1.0).lengths)))
    if not 0.5 <= height <= 2.5:
        raise InputError(path, f"bones of a person {height:.2f} m tall, expected 0.5 to 2.5 m")
    return replace(
        Skeleton.human(height), lengths=on_device(lengths), directions=on_device(directions)
    )


def hinge_angles(skeleton: Skeleton, dofs: list[int], R: np.ndarray) -> np.ndarray:
    """Angles (T, H) of up to three hinges, at right angles each to the next, that make (T, 3, 3).

    Of the two ways to make a turn by three hinges the one nearer to the limits is taken.
    """
    if not dofs:
        return np.zeros((len(R), 0))
    axes = np.asarray(skeleton.axes, float)[dofs]
    if len(dofs) == 1:
        return _near_limits(
            Rotation.from_matrix(_finite_rotations(R)).as_rotvec() @ axes.T, skeleton, dofs
        )
    third = axes[2] if len(dofs) == 3 else np.cross(axes[0], axes[1])
    with warnings.catch_warnings():
        # In the lock of the hinges any share between first and third is as good.
        warnings.filterwarnings("ignore", "Gimbal lock")
        angles = Rotation.from_matrix(_finite_rotations(R)).as_davenport(
            np.stack([axes[0], axes[1], third]), "intrinsic"
        )
    if len(dofs) == 2:
        return _near_limits(angles[:, :2], skeleton, dofs)
    other = angles * [1, -1, 1] + np.pi
    candidates = [_near_limits(candidate, skeleton, dofs) for candidate in (angles, other)]
    low, high = np.asarray(skeleton.limits, float)[dofs].T
    beyond = [
        np.maximum(low - candidate, 0) + np.maximum(candidate - high, 0) for candidate in candidates
    ]
    second = beyond[1].sum(-1) < beyond[0].sum(-1) - 1e-9
    return np.where(second[:, None], candidates[1], candidates[0])


def _near_limits(angles: np.ndarray, skeleton: Skeleton, dofs: list[int]) -> np.ndarray:
    """Angles by whole turns nearest to the middle of their limits."""
    middle = np.asarray(skeleton.limits, float)[dofs].mean(-1)
    return angles - 2 * np.pi * np.round((angles - middle) / (2 * np.pi))


def _finite_rotations(R: np.ndarray) -> np.ndarray:
    return np.where(np.isfinite(R).all((-2, -1), keepdims=True), R, np.eye(3))
