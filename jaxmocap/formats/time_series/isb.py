"""Joint angles by ISB's joint coordinate systems, as far as the skeleton's hinges go.

INPUTS: a Motion. OUTPUTS: angles over time by name, radians, continuous.

G. Wu et al., "ISB recommendation on definitions of joint coordinate systems", J. Biomech. 35
(2002) 543-548 (ankle, hip, spine) and 38 (2005) 981-992 (shoulder, elbow, wrist); E. S. Grood and
W. J. Suntay, J. Biomech. Eng. 105 (1983) 136-144 (knee); R. Baker, Hum. Mov. Sci. 20 (2001)
(pelvis in the world).

Every segment's axes are x forward, y up along the segment, z to the right, upright with the arms
hanging: bones have them by the skeleton's zero pose, not by palpated landmarks, so that an angle
is 0 there. Left limbs are mirrored at the sagittal plane first, as ISB has it, so that a name has
one meaning on both sides.

| angles | order | positive |
|---|---|---|
| pelvis_, thorax_ rotation, lean, tilt (in the world) | Y X Z | to the left, to the right, back |
| trunk_, neck_ extension, bending, rotation | Z X Y | back, to the right, to the left |
| shoulder_ plane, elevation, rotation (to the thorax) | Y X Y | forward, *down*, internal |
| elbow_ flexion, carrying, pronation | Z X Y | flexed, medial, pronated |
| wrist_ flexion, deviation, rotation | Z X Y | towards the palm, to the ulna, pronated |
| hip_, knee_ flexion, adduction, rotation | Z X Y | flexed, adducted, internal |
| ankle_ dorsiflexion, inversion, rotation | Z X Y | toes up, sole inwards, internal |

The shoulder's plane of elevation is 0 for an arm raised sideways and 90 degrees for one raised
forwards; the elevation is negative when raised (ISB's sign): -90 degrees is level. Hanging or
straight up, the arm has no plane, and only the plane and the rotation together mean something:
there the plane goes evenly. An arm that swings through goes on continuously to the other side,
where the elevation is positive: (plane, elevation, rotation) and (plane + 180, -elevation, rotation
+ 180) are the same turn; one that stays there, or circles, steps back. A knee that flexes turns
negatively about z; Grood and Suntay's flexion is positive, and so is ours.

Pelvis and thorax in the world turn about the vertical first, so that lean and tilt are the
person's whichever way they face; ISB's thorax (Z X Y) would have them face the world's x.

Pronation and wrist count from the supinated forearm of the anatomical position, as ISB has it; the
bones' zero pose has the thumbs forward, which is 90 degrees of pronation.

Angles that no hinge of the skeleton makes are left out rather than written as 0. The paper's 21
degrees of freedom have: trunk extension; neck extension and bending; all of shoulder and hip;
flexion of elbow and knee. They have no bending or rotation of the trunk, rotation of the neck,
motion of clavicle and scapula (the shoulder's angles are the humerus' to the thorax), carrying
angle, pronation, wrist, adduction and rotation of the knee, or ankle. Bodies with wrists have
rotation of the neck, pronation, flexion and deviation of the wrist as well.
"""

from dataclasses import dataclass
from functools import partial

import numpy as np

from jaxmocap.body.motion import Motion
from jaxmocap.body.orientations import body_turns, matrices
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.geometry.euler import FREE, continuous_euler, ease_near_lock
from jaxmocap.geometry.rows import ComputedRows, Index

# Our axes (x forward, y left, z up) hold ISB's x, y, z in these columns; the world's alike.
R_BONE_ISB = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
# A mirror at the sagittal plane turns a left limb into a right one.
MIRROR = np.diag([1.0, 1.0, -1.0])
# ISB's axes of forearm and hand in those that their bones have by the above: palms turn forward.
SUPINATED = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])


Range = tuple[float, float]
# The elevation is negative by ISB's convention, positive where an arm swings through hanging.
_SHOULDER = ((-180, 180), (-180, 0), (-180, 180))


@dataclass(frozen=True)
class Joint:
    """One joint coordinate system."""

    name: str  # of the joint, without side
    proximal: str | None  # bone of the segment that stays fixed; None is the pelvis
    distal: str | None  # bone of the segment that turns; None is the pelvis
    order: str  # of the three turns, about the axes that the earlier ones leave
    angles: tuple[str, str, str]  # their names
    signs: tuple[int, int, int] = (1, 1, 1)  # what a positive angle is multiplied with
    # Of the three turns, degrees, to which their angles keep where they can.
    ranges: tuple[Range, Range, Range] = ((-180, 180), (-90, 90), (-180, 180))


_WORLD = ("YXZ", ("rotation", "lean", "tilt"), (1, 1, 1), (FREE, (-90, 90), FREE))
PELVIS_JOINT = (Joint("pelvis", None, None, *_WORLD), Joint("thorax", None, "spine3", *_WORLD))
TRUNK_JOINTS = (
    Joint("trunk", None, "spine3", "ZXY", ("extension", "bending", "rotation")),
    Joint("neck", "spine3", "head", "ZXY", ("extension", "bending", "rotation")),
)
_LEG = ("flexion", "adduction", "rotation")
LIMB_JOINTS = (
    Joint(
        "shoulder", "spine3", "humerus", "YXY", ("plane", "elevation", "rotation"), ranges=_SHOULDER
    ),
    Joint("elbow", "humerus", "radius", "ZXY", ("flexion", "carrying", "pronation")),
    Joint("wrist", "radius", "hand", "ZXY", ("flexion", "deviation", "rotation")),
    Joint("hip", None, "femur", "ZXY", _LEG),
    Joint("knee", "femur", "tibia", "ZXY", _LEG, (-1, 1, 1)),
    Joint("ankle", "tibia", "foot", "ZXY", ("dorsiflexion", "inversion", "rotation")),
)


def isb_angles(motion: Motion) -> dict[str, np.ndarray]:
    """Name -> (T,) radians, continuous; NaN where the pose is unknown."""
    wanted: list[tuple[Joint, str, tuple[int, ...]]]
    wanted = [(joint, "", (0, 1, 2)) for joint in PELVIS_JOINT]
    for joint, side in [(joint, "") for joint in TRUNK_JOINTS] + [
        (j, s) for s in "rl" for j in LIMB_JOINTS
    ]:
        if kept := hinge_angles(motion.skeleton, joint, side):
            wanted.append((joint, side, kept))
    angles = _euler_angles(motion, [(joint, side) for joint, side, _ in wanted])
    columns = {}
    for (joint, side, kept), joint_angles in zip(wanted, angles, strict=True):
        joint_angles *= joint.signs
        for k in kept:
            name = "_".join(filter(None, (joint.name, joint.angles[k], side)))
            columns[name] = joint_angles[:, k]
    return columns


def _turns(motion: Motion, joints: list[tuple[Joint, str]], rows: Index) -> np.ndarray:
    """Turns (N, J, 3, 3) of joints of a side, in ISB's axes, at some samples."""
    skeleton = motion.skeleton
    R_pelvis_bone = body_turns(skeleton, np.asarray(motion.poses.angles)[rows].astype(float))
    R_world_pelvis = matrices(np.asarray(motion.poses.quaternion)[rows].astype(float))
    turns = []
    for joint, side in joints:
        near, far = (_bone_of_side(skeleton, b, side) for b in (joint.proximal, joint.distal))
        R_far = _segment(skeleton, R_pelvis_bone, far)
        if joint in PELVIS_JOINT:
            turns.append(_in_isb(joint, side, R_world_pelvis @ R_far))
        else:
            R_near = _segment(skeleton, R_pelvis_bone, near)
            turns.append(_in_isb(joint, side, R_near.swapaxes(-1, -2) @ R_far))
    return np.stack(turns, 1)


def _in_isb(joint: Joint, side: str, R: np.ndarray) -> np.ndarray:
    """Turns (T, 3, 3) between a joint's bones as turns between ISB's axes, left ones mirrored."""
    to_isb = R_BONE_ISB @ MIRROR if side == "l" else R_BONE_ISB
    near, far = (_segment_axes(bone) for bone in (joint.proximal, joint.distal))
    return near.T @ to_isb.T @ R @ to_isb @ far


def _segment_axes(bone: str | None) -> np.ndarray:
    """ISB's axes (3, 3) of a segment in those that its bone has."""
    return SUPINATED if bone in ("radius", "hand") else np.eye(3)


def _euler_angles(motion: Motion, joints: list[tuple[Joint, str]]) -> list[np.ndarray]:
    """Angles (T, 3) of each joint of a side; joints of one order go together."""
    found = [np.empty(0)] * len(joints)
    for order in {joint.order for joint, _ in joints}:
        alike = [i for i, (joint, _) in enumerate(joints) if joint.order == order]
        ranges = np.radians([joints[i][0].ranges for i in alike])
        turns = partial(_turns, motion, [joints[i] for i in alike])
        R = ComputedRows((len(motion.times), len(alike), 3, 3), turns)
        angles = continuous_euler(R, order, ranges, motion.times)
        for i, column in zip(alike, np.moveaxis(ease_near_lock(angles, order), 1, 0), strict=True):
            found[i] = column
    return found


def hinge_angles(skeleton: Skeleton, joint: Joint, side: str = "") -> tuple[int, ...]:
    """Which of a joint's three angles the skeleton's hinges can make."""
    tree = skeleton.tree
    near, far = (_bone_of_side(skeleton, bone, side) for bone in (joint.proximal, joint.distal))
    above, below = (set(tree.chain(bone) if bone else ()) for bone in (near, far))
    between = below - above
    hinges = [d for d, bone in enumerate(tree.dof_bones) if bone in between]
    to_isb = R_BONE_ISB @ _segment_axes(joint.proximal)
    about = np.abs(np.asarray(skeleton.axes, float)[hinges] @ to_isb).max(0, initial=0.0)
    return tuple(k for k, axis in enumerate(joint.order) if about["XYZ".index(axis)] > 1e-6)


def _bone_of_side(skeleton: Skeleton, bone: str | None, side: str) -> str | None:
    """A segment's bone: that of a side where there are two."""
    if bone is None or bone in skeleton.tree.bones:
        return bone
    return f"{bone}_{side}"


def _segment(skeleton: Skeleton, R_pelvis_bone: np.ndarray, bone: str | None) -> np.ndarray:
    """Rotations (T, 3, 3) of a segment in the pelvis' frame."""
    if bone is None:
        return np.broadcast_to(np.eye(3), (len(R_pelvis_bone), 3, 3))
    return R_pelvis_bone[:, skeleton.tree.bone(bone)]
