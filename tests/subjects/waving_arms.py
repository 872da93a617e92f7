"""A person who waves both arms before a camera, and the markers of that: shared by its tests."""

import jax
import numpy as np
from drawn_arms import draw, limbs_of
from watched_arms import FRONT, MARKERS, PERSON, TRUTH

from jaxmocap.reference import kinematics as reference

RATE = 30
# For the reference, which takes one number at a time: NumPy is much faster at that.
BODY = jax.tree.map(np.asarray, PERSON)


def waving(time):
    """The person's pose at a time: both arms move, each in its own way."""
    angles, joint = TRUTH.angles.copy(), PERSON.tree.joint
    for side, sign in (("l", 1), ("r", -1)):
        angles[joint(f"arm_flex_{side}")] += 0.35 * np.sin(2 * time) * sign
        angles[joint(f"arm_rot_{side}")] += 0.3 * np.sin(3 * time)
        angles[joint(f"elbow_flex_{side}")] += 0.25 * np.sin(2.5 * time + sign)
    return TRUTH._replace(angles=angles)


def markers_of(pose):
    return reference.site_positions(BODY, reference.forward(BODY, pose), MARKERS)


def image_of(pose):
    return draw(FRONT, list(limbs_of(BODY, pose)))


def frames(count, first=0):
    for i in range(first, first + count):
        truth = waving(i / RATE)
        yield i / RATE, truth, markers_of(truth)
