"""A person's own model from four silhouettes: the story of section 2 of the second paper.

INPUTS: masks and calibrated cameras of the front, side, joint and arms' side view. The person faces
+x of the calibration's world, whose z is up, and stands upright.
OUTPUTS: a PersonModel: joints, bone lengths and surface, metres.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from jaxmocap.silhouette.modelling.arm_joints import ArmPixels, arm_axis, arm_joints, lift_arms
from jaxmocap.silhouette.modelling.arm_surface import (
    ArmBones,
    arm_rings,
    arm_thickness,
    hand_extent,
    without_elbow_fold,
)
from jaxmocap.silhouette.modelling.pictures.medial_axis import medial_axis, rim_distance
from jaxmocap.silhouette.modelling.pictures.views import PhotographView
from jaxmocap.silhouette.modelling.readings import OWN, Reading
from jaxmocap.silhouette.modelling.separation import FrontLandmarks, find_landmarks, narrowest_neck
from jaxmocap.silhouette.modelling.trunk import Thighs, Trunk, find_thighs, find_trunk

# Unit vector of the world in which the person faces +x.
UP = np.array([0.0, 0.0, 1.0])
# Side -> the sign of its y.
SIDES = (("l", 1.0), ("r", -1.0))
# All of two people of measured joints, on whom nothing is tested; shares of the stature.
# From bottom line to vertex.
UPPER_BODY = 0.532
# The shoulder's joint from the middle to its side,
SHOULDER_ASIDE = 0.102
# from the arm pit outwards
SHOULDER_OUTWARDS = 0.0053
# and upwards,
SHOULDER_ABOVE_PIT = 0.041
# from the shoulder's upper rim downwards with the arm held level,
SHOULDER_BELOW_RIM = 0.0247
# and from the middle ahead.
SHOULDER_AHEAD = 0.005
# From the shoulder to where the upper arm is clear of the trunk.
CLEAR_OF_TRUNK = 0.07
# The shoulder's joint below the rim, by the arm's thickness there.
SHOULDER_BELOW_RIM_BY_ARM = 0.44
# Of a stretched arm's length, from the shoulder to the tip in a straight line.
LEAST_STRAIGHT = 0.93


class StanceError(ValueError):
    """A view shows another stance than it should.

    Attributes:
        view: its name.
        problem: one sentence.
    """

    def __init__(self, view: str, problem: str):
        super().__init__(view, problem)
        self.view, self.problem = view, problem

    def __str__(self) -> str:
        return f"{self.view}: {self.problem}"


class PersonModel(NamedTuple):
    """A person as measured, world, metres."""

    front: FrontLandmarks
    trunk: Trunk  # rings from the bottom line to the top of the head
    arm_pixels: tuple[ArmPixels, ...]  # the arms in the joint view, left and right: pixels
    bent: tuple[ArmBones, ...]  # their joints there
    stretched: tuple[ArmBones, ...]  # their joints in the arms' side view
    lifted: tuple[ArmBones, ...]  # their joints in the front view
    # (K, N, 3) each: rings, stretched out level to the side from the shoulder, thumb ahead.
    arms: tuple[np.ndarray, ...]
    legs: Thighs  # of the front and the side view
    # Photograph -> (3,) how far the person has moved since the front view.
    shifts: dict[str, np.ndarray]

    @property
    def stature(self) -> float:
        """Body height by that of trunk, neck and head, metres."""
        return float(np.ptp(self.trunk.rings[:, 0, 2])) / UPPER_BODY

    def neck_height(self) -> float:
        """Height of the neck's narrowest slice, metres."""
        top, bottom = self.trunk.middles[[-1, 0], 2]
        share = (self.front.bottom - self.front.neck) / (self.front.bottom - self.front.top)
        return float(bottom + share * (top - bottom))

    def lengths(self) -> dict[str, float]:
        """Bone -> length, metres; ``shoulders`` is from the one joint to the other."""
        result = {}
        for (name, _), bones in zip(SIDES, self.bent, strict=True):
            for bone, length in zip(("humerus", "radius", "hand"), bones.lengths, strict=True):
                result[f"{bone}_{name}"] = float(length)
        across = self.bent[0].shoulder - self.bent[1].shoulder
        return result | {"shoulders": float(np.linalg.norm(across))}


def person_model(
    views: dict[str, PhotographView], bottom: int | None = None, reading: Reading = OWN
) -> PersonModel:
    """A model from the views ``front``, ``side``, ``joint`` and ``arm_side``.

    ``bottom`` is the row of the trunk's bottom line in the front view; without it, where the legs
    part.

    Raises:
        ValueError: what a view shows is not the stance that is asked for.
    """
    with _of("front"):
        landmarks = find_landmarks(views["front"].mask, bottom)
    with _of("side"):
        body = find_trunk(views["front"], views["side"], landmarks, reading)
    with _of("joint"):
        joint = aligned_view(views["joint"], views["front"], landmarks, body)
        pixels, bent = bent_arms(joint, body, reading)
    with _of("arm_side"):
        arm_side = aligned_view(views["arm_side"], views["front"], landmarks, body)
        stretched = stretched_arms(arm_side, body, bent, reading)
    middle = float(np.mean([bones.shoulder[1] for bones in bent]))
    arms = tuple(
        arm_rings(
            without_elbow_fold(
                arm_thickness(joint, bones, bones.shoulder + bones.wrist - 2 * bones.elbow)
            ),
            arm_thickness(arm_side, straight, UP),
            bones.shoulder,
            float(bones.shoulder[1]) - middle,
            np.append(bones.lengths[:2], hand_extent(bones)),
            reading,
        )
        for bones, straight in zip(bent, stretched, strict=True)
    )
    with _of("front"):
        lifted = lift_arms(views["front"], landmarks, bent)
        legs = find_thighs(views["front"], views["side"], landmarks, body.middles[0])
    moved = {"front": np.zeros(3), "side": np.zeros(3)}
    moved |= {"joint": joint.shift, "arm_side": arm_side.shift}
    return PersonModel(landmarks, body, pixels, bent, stretched, lifted, arms, legs, moved)


@contextmanager
def _of(view: str) -> Iterator[None]:
    """What is wrong within is wrong with this view."""
    try:
        yield
    except ValueError as error:
        raise StanceError(view, str(error)) from None


def bent_arms(
    joint: PhotographView, body: Trunk, reading: Reading
) -> tuple[tuple[ArmPixels, ...], tuple[ArmBones, ...]]:
    """Left and right arm in the joint view, in pixels and in metres."""
    shoulders, distance = shoulder_joints(body, joint), rim_distance(joint.mask)
    result = tuple(
        arm_joints(way, distance, joint.pixels(shoulder), reading)
        for way, shoulder in zip(arm_axes(joint, body), shoulders, strict=True)
    )
    ends = [np.array([arm.elbow, arm.wrist, arm.tip]) for arm in result]
    bent = tuple(
        ArmBones(shoulder, *joint.plane_points(pixels, shoulder))
        for pixels, shoulder in zip(ends, shoulders, strict=True)
    )
    return result, bent


def stretched_arms(
    arm_side: PhotographView, body: Trunk, bent: tuple[ArmBones, ...], reading: Reading
) -> tuple[ArmBones, ...]:
    """Left and right arm in their side view: the bones as long as in the joint view."""
    tall, result = np.ptp(body.rings[:, 0, 2]) / UPPER_BODY, []
    for way, bones in zip(arm_axes(arm_side, body), bent, strict=True):
        arm = arm_on_axis(arm_side.plane_points(way, bones.shoulder), bones)
        result.append(arm._replace(elbow=arm.elbow + tall * reading.elbow_above * UP))
    return tuple(result)


# Who moved aside has the head elsewhere: its top is looked for so many times above the neck found.
ASIDE_ROUNDS = 3


def aligned_view(
    view: PhotographView, front: PhotographView, landmarks: FrontLandmarks, body: Trunk
) -> PhotographView:
    """A view in which the person may have moved aside or up since the front view.

    By the neck's middle and the top of the head.
    """
    middle = body.middles[-1]
    there = view.pixels(np.append(middle[:2], body.pits[:, 2].min()))
    neck_x, top = float(there[0]), 0
    for _ in range(ASIDE_ROUNDS):
        # Hands may be higher than the head.
        column = np.flatnonzero(
            view.mask[:, round(float(np.clip(neck_x, 0, len(view.mask.T) - 1)))]
        )
        if len(column) == 0 or column[0] >= there[1]:
            raise ValueError("found no head where the front view has it, expected the same place")
        top = int(column[0])
        _, neck_x = narrowest_neck(view.mask, top, int(there[1]), neck_x)
    before, now = (
        each.plane_points(np.array([x, row]), middle)
        for each, x, row in ((front, landmarks.neck_x, landmarks.top), (view, neck_x, top))
    )
    return replace(view, shift=now - before)


def shoulder_joints(body: Trunk, joint: PhotographView) -> np.ndarray:
    """(2, 3) left and right shoulder.

    Aside, half-way between where the arm pit and where the stature would have it: muscles carry
    the arm pits outwards. In height, below the shoulder's rim in the joint view, half-way between
    where the stature and where the arm's thickness would have it. Ahead, before the trunk's middle
    at that height: a heavy chest carries the arm pits down, to where it is itself.
    """
    stature = np.ptp(body.rings[:, 0, 2]) / UPPER_BODY
    out = np.array([[0.0, s, 0.0] for _, s in SIDES])
    joints = body.pits + stature * (SHOULDER_OUTWARDS * out + SHOULDER_ABOVE_PIT * UP)
    usual = trunk_middle_at(body, joints[:, 2].mean()) + stature * SHOULDER_ASIDE * out
    joints[:, 1] = (joints[:, 1] + usual[:, 1]) / 2
    joints[:, 0] = usual[:, 0]
    rim = joints + joint.extent(joints, UP, stature / 4)[:, None] * UP
    arm = rim + stature * (CLEAR_OF_TRUNK * out - SHOULDER_BELOW_RIM * UP)
    thick = sum(joint.extent(arm, way, stature / 4) for way in (UP, -UP))
    joints[:, 2] = (
        rim[:, 2] - (stature * SHOULDER_BELOW_RIM + thick * SHOULDER_BELOW_RIM_BY_ARM) / 2
    )
    joints[:, 0] = trunk_middle_at(body, joints[:, 2].mean())[0] + stature * SHOULDER_AHEAD
    return joints


def trunk_middle_at(body: Trunk, height: float) -> np.ndarray:
    """(3,) the trunk's middle at a height."""
    levels = body.middles[:, 2]
    return np.array([np.interp(height, levels, line) for line in body.middles.T])


def arm_axes(view: PhotographView, body: Trunk) -> list[np.ndarray]:
    """(K, 2) pixels each: the axes of left and right arm, from the trunk to the fingertip."""
    axis = medial_axis(view.mask)
    start = view.pixels(trunk_middle_at(body, body.pits[:, 2].mean()))
    lowest = view.pixels(body.middles[0])[1]
    return [arm_axis(axis, start, pit, lowest) for pit in view.pixels(body.pits)]


def arm_on_axis(way: np.ndarray, bones: ArmBones) -> ArmBones:
    """A stretched arm's joints on its axis (K, 3), the bones as long as they are."""
    first = int(np.argmin(np.sum((way - bones.shoulder) ** 2, 1)))
    length_m = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(way[first:], axis=0), axis=1)))
    straight = float(np.linalg.norm(way[-1] - way[first]) / length_m[-1])
    if straight < LEAST_STRAIGHT:
        raise ValueError(
            f"found an arm whose ends are {100 * straight:.0f} % of its length apart, expected "
            f"stretched arms, at least {100 * LEAST_STRAIGHT:.0f} %"
        )
    # The shoulder's joint is above the axis of its flesh, where the joint view has it: bones are
    # as long as the straight lines between joints, not as the way along that axis.
    joints, at = [bones.shoulder], first
    for length in bones.lengths[:2]:
        beyond = np.linalg.norm(way[at:] - joints[-1], axis=1) >= length
        if not beyond.any():
            raise ValueError(
                f"the arm in the arms' side view is {100 * length_m[-1]:.0f} cm long, shorter than "
                f"its {100 * bones.lengths[:2].sum():.0f} cm from shoulder to wrist in the joint "
                "view"
            )
        at += int(np.argmax(beyond))
        joints.append(way[at])
    return ArmBones(bones.shoulder, joints[1], joints[2], way[-1])
