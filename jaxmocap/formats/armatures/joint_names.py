"""What other programs call our joints.

INPUTS: the name of a convention. OUTPUTS: its name for the pelvis, for every bone's joint and for
the ends of head, hands and feet, and for every landmark.

A joint is called by the bone that begins there: ``humerus_l`` is the left shoulder, which VRM
calls leftUpperArm and SMPL left_shoulder. The bones from pelvis to hip do not move against the
pelvis, so the joint ``femur_l`` hangs on ``pelvis``. An end without a name of its own gets its
joint's with ``_end``.
"""

from collections.abc import Mapping

from jaxmocap.body.skeleton import LANDMARK_PLACES, LANDMARKS

PELVIS = "pelvis"
_TRUNK: tuple[str, ...] = (PELVIS, "spine1", "spine2", "spine3", "neck", "head")
_LIMBS = ("clavicle", "humerus", "radius", "hand", "femur", "tibia", "foot")
# The joint at the far end of which a landmark lies that no other joint shares.
JOINTS_WITH_END = ("head", "hand_l", "foot_l", "hand_r", "foot_r")


def _convention(trunk: str, limbs: str, left: str, right: str, **ends: str) -> dict[str, str]:
    """One convention: names of trunk and limbs in the order above, and how the sides are put."""
    names: dict[str, str] = dict(zip(_TRUNK, trunk.split(), strict=True))
    for side, pattern in (("l", left), ("r", right)):
        for ours, theirs in zip(_LIMBS, limbs.split(), strict=True):
            names[f"{ours}_{side}"] = pattern.format(theirs)
        for ours, theirs in ends.items():
            names[end_of(f"{ours}_{side}")] = pattern.format(theirs)
    return {end_of(joint): end_of(names[joint]) for joint in JOINTS_WITH_END} | names


def end_of(joint: str) -> str:
    """The name of a joint's far end."""
    return f"{joint}_end"


# VRM 1.0's humanoid bones; HumanIK's characters (MotionBuilder, Maya; Mixamo's rig is named alike);
# SMPL's joints; the segments of ISB (Wu et al. 2002, 2005), which divides the trunk into vertebrae:
# its lumbar and thoracolumbar part are our names.
CONVENTIONS: dict[str, dict[str, str]] = {
    "jaxmocap": _convention(" ".join(_TRUNK), " ".join(_LIMBS), "{}_l", "{}_r"),
    "vrm": _convention(
        "hips spine chest upperChest neck head",
        "Shoulder UpperArm LowerArm Hand UpperLeg LowerLeg Foot",
        "left{}",
        "right{}",
        foot="Toes",
    ),
    "humanik": _convention(
        "Hips Spine Spine1 Spine2 Neck Head",
        "Shoulder Arm ForeArm Hand UpLeg Leg Foot",
        "Left{}",
        "Right{}",
        foot="ToeBase",
    ),
    "smpl": _convention(
        "pelvis spine1 spine2 spine3 neck head",
        "collar shoulder elbow wrist hip knee ankle",
        "left_{}",
        "right_{}",
        hand="hand",
        foot="foot",
    ),
    "isb": _convention(
        "pelvis lumbar thoracolumbar thorax cervical head",
        "clavicle humerus forearm hand femur tibia calcaneus",
        "{}_l",
        "{}_r",
    ),
}


def joint_of(landmark: str) -> str:
    """Our name of the joint or end at which a landmark lies."""
    bone, at = LANDMARK_PLACES[landmark]
    if landmark == PELVIS:
        return PELVIS
    return end_of(bone) if at else bone


def landmark_names(convention: str | None) -> dict[str, str]:
    """Landmark -> its name in a convention; None leaves the landmarks' own."""
    if convention is None:
        return {landmark: landmark for landmark in LANDMARKS}
    return {landmark: CONVENTIONS[convention][joint_of(landmark)] for landmark in LANDMARKS}


def names_to_ours(names: tuple[str, ...]) -> Mapping[str, str] | None:
    """Their name -> ours by one of the conventions, in which ends may be missing; else None."""
    for convention in CONVENTIONS.values():
        inner = {theirs for ours, theirs in convention.items() if not ours.endswith("_end")}
        if inner <= set(names):
            to_ours = {theirs: ours for ours, theirs in convention.items()}
            return to_ours | {end_of(convention[joint]): end_of(joint) for joint in JOINTS_WITH_END}
    return None
