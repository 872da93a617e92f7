"""Exercises: push-ups, sit-ups, arm raises, a turn, walking, jumping, scissors.

Key stances joined by smooth splines, as in ``motions``. Times vary with the seed, and so does every
joint by some degrees, so that no repetition is the same.

INPUTS: a rig, the name of an exercise, a duration, a seed. OUTPUTS: an Exerciser.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from jaxmocap.synthetic.movements.exerciser import Exerciser
from jaxmocap.synthetic.movements.splines import KeyStance, Spline
from jaxmocap.synthetic.people.rigged_mesh import Rig

Keys = list[tuple[float, KeyStance]]
# Each angle of a stance varies by up to so many degrees.
VARIATION_DEG = 2.0
STANDING = KeyStance()
# Wrists of push-ups, metres: ahead of the middle, to the left, up.
PLANTED = np.array([[0.43, 0.30, 0.075], [0.43, -0.30, 0.075]])
_TUCKED = (0.0, 3.0, 0.0, 2.0, -4.0)
_HIGH = KeyStance(place=(-0.02, 0.0), turn=(0.0, 73.0, 0.0), neck=-22, leg_l=_TUCKED, leg_r=_TUCKED)
_LOW = replace(_HIGH, place=(0.03, 0.0), turn=(0.0, 83.0, 0.0), neck=-30)
_FEET = (52.0, 6.0, 0.0, 98.0, 42.0)
_AHEAD = (30.0, 12.0, 12.0, 40.0)
_LYING = KeyStance(
    turn=(0.0, -88.0, 0.0), back=(4.0, 0.0, 0.0), neck=12, leg_l=_FEET, leg_r=_FEET,
    arm_l=_AHEAD, arm_r=_AHEAD,
)  # fmt: skip
_KNEES_UP = (104.0, 6.0, 0.0, 98.0, 42.0)
_REACHING = (72.0, 10.0, 10.0, 22.0)
_SITTING = KeyStance(
    turn=(0.0, -36.0, 0.0), back=(46.0, 0.0, 0.0), neck=4, leg_l=_KNEES_UP, leg_r=_KNEES_UP,
    arm_l=_REACHING, arm_r=_REACHING,
)  # fmt: skip
# One step: the left heel strikes; then the right leg swings past it.
_STRIKE = KeyStance(
    turn=(-4.0, 3.0, 0.0), back=(2.0, 0.0, 8.0),
    leg_l=(20.0, 2.0, -6.0, 4.0, -4.0), leg_r=(-13.0, 2.0, -6.0, 14.0, 8.0),
    arm_l=(-16.0, 9.0, 0.0, 16.0), arm_r=(20.0, 9.0, 0.0, 28.0),
)  # fmt: skip
_PASSING = KeyStance(
    turn=(0.0, 3.0, 2.0), leg_l=(3.0, 1.0, -6.0, 8.0, 2.0), leg_r=(22.0, 3.0, -6.0, 56.0, 10.0)
)
_CROUCHED = KeyStance(
    turn=(0.0, 32.0, 0.0), back=(10.0, 0.0, 0.0), neck=-24, leg_l=(84.0, 5.0, -8.0, 92.0, -24.0),
    leg_r=(84.0, 5.0, -8.0, 92.0, -24.0), arm_l=(-38.0, 12.0, 0.0, 12.0),
    arm_r=(-38.0, 12.0, 0.0, 12.0),
)  # fmt: skip
_STRETCHED = KeyStance(
    turn=(0.0, 4.0, 0.0), leg_l=(4.0, 5.0, -6.0, 6.0, 38.0), leg_r=(4.0, 5.0, -6.0, 6.0, 38.0),
    arm_l=(118.0, 14.0, 0.0, 24.0), arm_r=(118.0, 14.0, 0.0, 24.0),
)  # fmt: skip
_BALANCED = (8.0, 62.0, 0.0, 24.0)
_APART = KeyStance(
    leg_l=(8.0, 24.0, -6.0, 10.0, 8.0), leg_r=(8.0, 24.0, -6.0, 10.0, 8.0), arm_l=_BALANCED,
    arm_r=_BALANCED,
)  # fmt: skip
_CROSSED = replace(_APART, leg_l=(20.0, -13.0, 0.0, 12.0, 6.0), leg_r=(-10.0, -12.0, 0.0, 10.0, 12))


def push_ups(seconds: float, rng: np.random.Generator) -> Keys:
    """Down and up on planted hands."""
    return _repeat_stances((_HIGH, _LOW), seconds, 0.62, rng)


def sit_ups(seconds: float, rng: np.random.Generator) -> Keys:
    """Up from the back and down again, the hands towards the knees."""
    return _repeat_stances((_LYING, _SITTING), seconds, 0.8, rng)


def arm_raises(seconds: float, rng: np.random.Generator) -> Keys:
    """Arms to the front, to the sides, overhead, and bent."""
    raised = [
        *((88.0, 4.0, 0.0, 8.0), (4.0, 9.0, 0.0, 14.0), (6.0, 88.0, 0.0, 8.0)),
        *((8.0, 158.0, 0.0, 14.0), (6.0, 88.0, 0.0, 8.0), (20.0, 14.0, 0.0, 118.0)),
    ]
    stances = (STANDING, *(replace(STANDING, arm_l=arm, arm_r=arm) for arm in raised))
    return _repeat_stances(stances, seconds, 0.46, rng)


def overhead(seconds: float, rng: np.random.Generator) -> Keys:
    """Arms up to 150 degrees before the shoulder blades and to the front, and down again."""
    up = (50.0, 100.0, 150.0, 100.0, 50.0)
    raised = [_raise_arm(elevation, ahead) for ahead in (45.0, 80.0) for elevation in (10.0, *up)]
    stances = tuple(replace(STANDING, arm_l=arm, arm_r=arm) for arm in raised)
    return _repeat_stances(stances, seconds, 0.27, rng)


def _raise_arm(elevation: float, ahead: float) -> tuple[float, float, float, float]:
    """An arm so far from hanging, in a plane so far from the side to the front; degrees.

    It turns outwards on its way up, as arms do: flexed first and then abducted it is not rotated.
    """
    up, turned = np.radians([elevation, ahead])
    out, front = np.sin(up) * np.cos(turned), np.sin(up) * np.sin(turned)
    swung = Rotation.from_euler("YX", [-np.arctan2(front, np.cos(up)), np.arcsin(out)])
    abduction, flexion, rotation = swung.as_euler("XYZ", degrees=True) * [1, -1, -1]
    return float(flexion), float(abduction), float(rotation), 14.0


def turning(seconds: float, rng: np.random.Generator) -> Keys:
    """Half a turn on the spot in small steps, then towards the first camera, the arms swinging."""
    keys, steps = [], 10
    for i, stance in enumerate(_gait(steps)):
        share = i / steps
        yaw = 180 * (1 - np.clip(share / 0.6, 0, 1))
        x = -0.45 + 0.95 * np.clip((share - 0.5) / 0.5, 0, 1) ** 1.3
        bent = 30 + 60 * np.sin(np.pi * share) ** 2
        arms = [(*getattr(stance, f"arm_{s}")[:3], bent) for s in "lr"]
        here = replace(stance, place=(x, 0.0), arm_l=arms[0], arm_r=arms[1])
        keys.append((share * seconds, replace(here, turn=(stance.turn[0] + yaw, *stance.turn[1:]))))
    return _vary_stances(keys, rng)


def walking(seconds: float, rng: np.random.Generator) -> Keys:
    """Straight on towards the first camera, through the middle."""
    steps = max(2, round(2 * seconds / 0.55))
    middle = 0.2 * seconds
    return _vary_stances(
        [
            (i / steps * seconds, replace(stance, place=(0.4 * seconds * i / steps - middle, 0.0)))
            for i, stance in enumerate(_gait(steps))
        ],
        rng,
    )


def jumping(seconds: float, rng: np.random.Generator) -> Keys:
    """Jumps on the spot out of a crouch, the arms thrown up."""
    flight = replace(_STRETCHED, lift=0.2, leg_l=(14.0, 6.0, -6.0, 22.0, 30.0),
                     leg_r=(14.0, 6.0, -6.0, 22.0, 30.0))  # fmt: skip
    landing = replace(_CROUCHED, arm_l=(20.0, 24.0, 0.0, 30.0), arm_r=(20.0, 24.0, 0.0, 30.0))
    after = ((0.0, STANDING), (0.45, _CROUCHED), (0.76, _STRETCHED), (1.0, flight))
    after += ((1.24, replace(_STRETCHED, arm_l=_BALANCED, arm_r=_BALANCED)), (1.45, landing))
    keys, start = [], 0.0
    while start < seconds:
        keys += [(start + t, stance) for t, stance in after]
        start += rng.uniform(1.8, 2.0)
    return _vary_stances([*keys, (start, STANDING)], rng)


def scissors(seconds: float, rng: np.random.Generator) -> Keys:
    """Legs apart and crossed in hops, left and right in front in turn."""
    apart = replace(_APART, lift=0.03)
    return _repeat_stances((apart, _CROSSED, apart, _CROSSED.mirror()), seconds, 0.42, rng)


EXERCISES: dict[str, Callable[[float, np.random.Generator], Keys]] = {
    "push_ups": push_ups,
    "sit_ups": sit_ups,
    "arm_raises": arm_raises,
    "turn": turning,
    "walking": walking,
    "jumping": jumping,
    "scissors": scissors,
}
# Exercises that the tracker's benchmark does not include.
RAISES = {"overhead": overhead}


def exercise(
    rig: Rig, name: str, seconds: float = 3.0, seed: int = 0, girdle: bool = False
) -> Exerciser:
    """Someone at one of ``EXERCISES`` or ``RAISES``, facing +x about the world's origin.

    The seed is of the variations; without a girdle the shoulders stay on the chest.

    Raises:
        ValueError: an unknown exercise; the message lists the valid ones.
    """
    exercises = EXERCISES | RAISES
    if name not in exercises:
        raise ValueError(f"unknown exercise {name!r}; expected one of {', '.join(exercises)}")
    keys = exercises[name](seconds, np.random.default_rng([seed, 6]))
    times, stances = zip(*keys, strict=True)
    curves = Spline(np.array(times), np.stack([stance.channels() for stance in stances]))
    return Exerciser(rig, curves, PLANTED if name == "push_ups" else None, girdle=girdle)


def _gait(steps: int) -> list[KeyStance]:
    """Heel strikes and swings in turn: ``steps`` halves of steps, and the last one's end."""
    cycle = (_STRIKE, _PASSING, _STRIKE.mirror(), _PASSING.mirror())
    return [cycle[i % 4] for i in range(steps + 1)]


def _repeat_stances(
    stances: tuple[KeyStance, ...], seconds: float, pace: float, rng: np.random.Generator
) -> Keys:
    """Stances in turn, about ``pace`` seconds apart, for so many seconds."""
    keys, now = [], 0.0
    while now < seconds + pace:
        keys.append((now, stances[len(keys) % len(stances)]))
        now += pace * rng.uniform(0.9, 1.1)
    return _vary_stances(keys, rng)


def _vary_stances(keys: Keys, rng: np.random.Generator) -> Keys:
    """The same with random variations of each stance."""

    def by(angles: tuple) -> tuple:
        return tuple(np.asarray(angles) + rng.uniform(-VARIATION_DEG, VARIATION_DEG, len(angles)))

    limbs = ("arm_l", "arm_r", "leg_l", "leg_r")
    return [
        (time, replace(stance, **{limb: by(getattr(stance, limb)) for limb in limbs}))
        for time, stance in keys
    ]
