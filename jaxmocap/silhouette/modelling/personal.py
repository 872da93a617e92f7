"""A person's skeleton and surface for the tracker, by four photographs.

The surface has the nodes of ``loft.generic_surface``, patch by patch, ring by ring: what was
measured moves them, the rest stays as people of such bones and girths are. Two persons' surfaces
are so in correspondence.

INPUTS: a PersonModel.
OUTPUTS: a Personal: skeleton, surface, and the person's pose in each photograph.
"""

from dataclasses import replace
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.body.subject import NECK_HEAD, TRUNK, rest_joints, scale_to_landmarks
from jaxmocap.body.surfaces.loft import generic_surface
from jaxmocap.body.surfaces.surface import Surface, rest_nodes
from jaxmocap.silhouette.modelling.arm_surface import ArmBones, hand_extent
from jaxmocap.silhouette.modelling.person import SIDES, PersonModel, trunk_middle_at
from jaxmocap.silhouette.modelling.slices import BodySlices, fitted_grid, measured_slices, stoutness

# All of two people of measured joints, on whom nothing is tested; shares of the stature.
# The hips' joints above the bottom line,
HIP_ABOVE = 0.0506
# from the middle to either side,
HIP_ASIDE = 0.0621
# and ahead of it.
HIP_AHEAD = -0.0047
# From the shoulders' middle to the neck's joint, ahead and up.
NECK_OFFSET = (-0.0044, 0.0283)
# From there to the head's joint, ahead and up.
HEAD_OFFSET = (0.0175, 0.0879)
# A foot.
FOOT_LENGTH = 0.0852
# The hips' joints above the floor.
LEG_LENGTH = 0.534
# Thigh and shank, shares of that.
FEMUR_SHARE = 0.4565
TIBIA_SHARE = 0.4646
# A leg is no smaller and no larger share of the body height.
LEG_SHARES = (0.4, 0.62)
# From this share of a thigh on downwards its middle shows how far the leg is spread.
SPREAD_FROM = 0.5


class PersonalModel(NamedTuple):
    """A person as the tracker wants one."""

    skeleton: Skeleton  # the human one's joints, with the person's own bones
    surface: Surface  # around it; node for node as that of ``generic_surface``
    # Photograph (``front``, ``side``, ``joint``, ``arm_side``) -> the skeleton's pose in it, in the
    # calibration's world, metres.
    poses: dict[str, Pose]


def personal_model(model: PersonModel, height: float | None = None) -> PersonalModel:
    """Skeleton, surface and poses of a person.

    The height, metres, gives the legs' length; by default as those of people with such a trunk and
    head.

    Raises:
        ValueError: a height that does not suit the trunk and head in the photographs.
    """
    marks = landmarks_of_person(model, height)
    skeleton = standing_skeleton(marks)
    joints, usual = rest_joints(skeleton), generic_surface(skeleton)
    spread = thigh_spreads(model, skeleton, usual, marks)
    measured = measured_slices(model, skeleton, marks, spread)
    # What photographs do not show is as stout as what they show.
    stout = generic_surface(skeleton, stoutness(skeleton, measured))
    nodes = _nodes(stout, skeleton, measured, tuple(map(hand_extent, model.bent)))
    places = nodes[:, None] - joints[np.asarray(usual.points.bones)]
    dtype = jnp.asarray(usual.points.points_bone).dtype
    points = usual.points._replace(points_bone=jnp.asarray(places, dtype))
    return PersonalModel(
        skeleton, replace(usual, points=points), photograph_poses(model, skeleton, marks, spread)
    )


def standing_skeleton(marks: dict[str, np.ndarray]) -> Skeleton:
    """The skeleton whose landmarks lie there with all angles 0."""
    skeleton = scale_to_landmarks(Skeleton.human(), {k: v[None] for k, v in marks.items()})
    # There the line from hips to neck is upright; here the person is, as in the photographs.
    pelvis, tree = (marks["hip_l"] + marks["hip_r"]) / 2, skeleton.tree
    ends = {bone: (pelvis, marks["neck"]) for bone in TRUNK}
    ends |= {bone: (marks["neck"], marks["vertex"]) for bone in NECK_HEAD}
    for side, _ in SIDES:
        ends[f"clavicle_{side}"] = marks["neck"], marks[f"shoulder_{side}"]
        ends[f"hip_{side}"] = pelvis, marks[f"hip_{side}"]
    directions = np.array(skeleton.directions)
    for bone, (near, far) in ends.items():
        directions[tree.bone(bone)] = (far - near) / np.linalg.norm(far - near)
    return replace(skeleton, directions=jnp.asarray(directions, skeleton.directions.dtype))


def leg_length_of_person(model: PersonModel, height: float | None) -> float:
    """From the hips' joints to the floor, metres.

    Raises:
        ValueError: a height that does not suit the trunk and head in the photographs.
    """
    if height is None:
        return LEG_LENGTH * model.stature
    above = float(np.ptp(model.trunk.rings[:, 0, 2])) - HIP_ABOVE * model.stature
    if not LEG_SHARES[0] < 1 - above / height < LEG_SHARES[1]:
        low, high = (above / (1 - share) for share in LEG_SHARES)
        raise ValueError(
            f"found a height of {height:g} m, expected {low:.2f} to {high:.2f} m of somebody whose "
            f"hips are {above:.2f} m below the top of the head"
        )
    return height - above


def landmarks_of_person(model: PersonModel, height: float | None = None) -> dict[str, np.ndarray]:
    """Landmark -> (3,) in the front view's stance, arms hanging, metres."""
    tall, bent, leg = model.stature, model.bent, leg_length_of_person(model, height)
    low, top = model.trunk.rings[0, 0, 2], model.trunk.rings[-1, 0, 2]
    hips = trunk_middle_at(model.trunk, low + tall * HIP_ABOVE) + tall * np.array([HIP_AHEAD, 0, 0])
    neck = (bent[0].shoulder + bent[1].shoulder) / 2 + tall * np.array(
        [NECK_OFFSET[0], 0, NECK_OFFSET[1]]
    )
    vertex = np.array([neck[0] + tall * HEAD_OFFSET[0], neck[1], top])
    landmarks = {"neck": neck, "vertex": vertex}
    down, ahead = np.array([0.0, 0.0, -1.0]), np.array([1.0, 0.0, 0.0])
    for (side, sign), bones in zip(SIDES, bent, strict=True):
        at = bones.shoulder
        landmarks[f"shoulder_{side}"] = at
        for name, length in zip(("elbow", "wrist", "hand"), bones.lengths, strict=True):
            landmarks[f"{name}_{side}"] = at = at + length * down
        landmarks[f"hip_{side}"] = at = hips + sign * tall * HIP_ASIDE * np.eye(3)[1]
        for name, share in (("knee", FEMUR_SHARE), ("ankle", TIBIA_SHARE)):
            landmarks[f"{name}_{side}"] = at = at + leg * share * down
        landmarks[f"toe_{side}"] = at + tall * FOOT_LENGTH * ahead
    return landmarks


def thigh_spreads(
    model: PersonModel, skeleton: Skeleton, surface: Surface, marks: dict[str, np.ndarray]
) -> np.ndarray:
    """(2,) by how much left and right thigh are spread in the front view, radians."""
    legs, spreads = model.legs, []
    if len(legs.heights) < 2:
        return np.zeros(2)
    joints = rest_joints(skeleton)
    length = float(skeleton.lengths[skeleton.tree.bone("femur_l")])
    for k, (side, _) in enumerate(SIDES):
        hip = marks[f"hip_{side}"]
        far = (hip[2] - legs.heights) / length
        low = far >= min(SPREAD_FROM, far[-1])
        # Flesh is not in the middle of the bone: as far off as in the generic surface.
        patch = next(patch for patch in surface.patches if patch.name == f"leg_{side}")
        grid = patch.grid(rest_nodes(surface, joints))
        rest = joints[skeleton.tree.bone(f"femur_{side}")]
        levels = rest[2] - grid[1:-1, 0, 2]
        off = (grid[1:-1, :, 1].max(1) + grid[1:-1, :, 1].min(1)) / 2 - rest[1]
        aside = legs.across[:, k].mean(1) - np.interp(far * length, levels, off)
        spreads.append(np.median(np.arctan2(aside - hip[1], hip[2] - legs.heights)[low]))
    return np.array(spreads)


def photograph_poses(
    model: PersonModel, skeleton: Skeleton, marks: dict[str, np.ndarray], spread: np.ndarray
) -> dict[str, Pose]:
    """Photograph -> pose: trunk upright, arms and thighs as they were found."""
    hips = (marks["hip_l"] + marks["hip_r"]) / 2
    arms = {"joint": model.bent, "front": model.lifted}
    poses = {}
    for name, moved in model.shifts.items():
        angles = np.zeros(len(skeleton.tree.joints))
        for k, (side, sign) in enumerate(SIDES):
            bones = arms.get(name, model.stretched)[k]
            arm = arm_angles(bones, sign, straight=name != "joint")
            for joint, angle in (arm | {"hip_abduction": sign * spread[k]}).items():
                angles[skeleton.tree.joint(f"{joint}_{side}")] = angle
        dtype = skeleton.lengths.dtype
        parts = hips + moved, np.eye(4)[0], angles
        poses[name] = Pose(*(jnp.asarray(part, dtype) for part in parts))
    return poses


def arm_angles(bones: ArmBones, sign: float, straight: bool) -> dict[str, float]:
    """Joint -> angle, radians, of an arm, the trunk upright and facing +x.

    ``sign`` is 1 left, -1 right. A ``straight`` elbow's inner side looks ahead; else the bones say.
    """
    shoulder, elbow, wrist, _ = bones
    upper = wrist - shoulder if straight else elbow - shoulder
    upper = upper / np.linalg.norm(upper)
    lower = (wrist - elbow) / np.linalg.norm(wrist - elbow)
    inner = np.array([1.0, 0.0, 0.0]) if straight else lower
    inner = inner - upper * (upper @ inner)
    inner /= np.linalg.norm(inner)
    R = np.stack([inner, np.cross(-upper, inner), -upper], 1)
    # By R = Ry(-flex) Rx(sign abduct) Rz(-sign rotate), also where the arm is level and the first
    # and the last turn are one.
    flex = np.arctan2(-R[0, 2], R[2, 2])
    abduct = np.arctan2(-R[1, 2], np.hypot(R[0, 2], R[2, 2]))
    rest = Rotation.from_euler("YX", [-flex, abduct]).as_matrix().T @ R
    turn = np.arctan2(rest[1, 0], rest[0, 0])
    bend = 0.0 if straight else float(np.arccos(np.clip(upper @ lower, -1, 1)))
    return {
        "arm_flex": flex,
        "arm_abduct": sign * abduct,
        "arm_rot": -sign * turn,
        "elbow_flex": bend,
    }


def _nodes(
    surface: Surface, skeleton: Skeleton, measured: dict[str, BodySlices], hands: tuple[float, ...]
) -> np.ndarray:
    """(N, 3) at rest: a generic surface's, moved to what was measured; hands reach so far."""
    joints = rest_joints(skeleton)
    nodes = rest_nodes(surface, joints)
    for patch in surface.patches:
        grid = patch.grid(nodes)
        if patch.limb == "arm":
            below = joints[skeleton.tree.bones_in("hand", side=patch.side)[0], 2] - grid[..., 2]
            longer = hands["lr".index(patch.side)] / below[-1, 0] - 1
            grid[..., 2] -= longer * np.maximum(below, 0)
        if patch.name in measured:
            grid[:] = fitted_grid(grid, patch.outwards, measured[patch.name])
    return nodes
