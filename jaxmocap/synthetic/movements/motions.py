"""Movements of a synthetic person: table tennis, squats, reaching, raises, thrusts at a camera.

Key postures joined by smooth splines; a continuous function of time, so that markers, video and
the instants within one exposure sample the same movement. Every stroke lifts the elbow its own
way: markers at head and hands do not determine it.

INPUTS: a kind of movement, a duration, a seed. OUTPUTS: a Performance.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxmocap.body.skeleton import WINTER, Skeleton
from jaxmocap.synthetic.movements.splines import Spline
from jaxmocap.synthetic.people.figure import BoneFrames, Figure, Posture

# A person's bones differ from the tables' by up to this share.
LIMB_VARIATION = 0.03
# Swivels of a low elbow, degrees. Strokes alternate between low and high; no stroke has the relaxed
# pose's swivel, which is 0.
LOW_SWIVEL_DEG = (12.0, 15.0)
# Swivels between strokes, degrees.
MIDDLE_SWIVEL_DEG = (28.0, 42.0)
# Swivels of a high elbow, degrees.
HIGH_SWIVEL_DEG = (94.0, 97.0)

READY = Posture(
    pelvis=(-0.02, 0.0, -0.04), pitch=5, flexion=7, gaze=(0, -2), reach_l=(0.63, 0.13, -0.55),
    reach_r=(0.65, 0.17, -0.53),
)  # fmt: skip
STANDING = Posture(
    pelvis=(0.0, 0.0, -0.01), reach_l=(0.37, 0.21, -0.79), reach_r=(0.37, 0.21, -0.79)
)
# How far pelvis and chest turn with a hand that reaches across, degrees.
TURN_DEG = (14.0, 28.0)
# Where both hands are raised to, in arm lengths: to the front, to the sides, overhead.
RAISED = ((0.90, 0.15, 0.10), (0.12, 0.90, 0.10), (0.30, 0.30, 0.82))
# The posture between thrusts.
GUARD = Posture(pelvis=(-0.01, 0.0, -0.05), pitch=3, flexion=5)
# How far the fists are ahead of the shoulders between thrusts, arm lengths.
FOLDED_REACH = 0.08
# The same at the end of a thrust.
STRETCHED_REACH = (0.82, 0.90)
# How far the fists are below the shoulders, arm lengths.
FIST_DROP = 0.33
# A stroke: key postures at seconds from its start. Wrists in arm lengths: forward, out, up.
_BACKSWING = replace(
    READY, pelvis=(-0.03, -0.03, -0.07), yaw=-9, twist=-13, bend=5, reach_l=(0.76, 0.16, -0.26),
    reach_r=(-0.02, 0.65, -0.55), wrist_r=(-8, 15),
)  # fmt: skip
_DRIVE = replace(
    READY, pelvis=(-0.01, 0.02, -0.05), yaw=2, twist=3, reach_l=(0.58, 0.42, -0.47),
    reach_r=(0.76, 0.38, -0.29), wrist_r=(4, 20),
)  # fmt: skip
_OVER = replace(
    READY, pelvis=(0.01, 0.03, -0.04), yaw=6, twist=10, bend=-3, reach_l=(0.42, 0.47, -0.58),
    reach_r=(0.78, -0.19, 0.21), wrist_r=(10, 25),
)  # fmt: skip
_COIL = replace(
    READY, pelvis=(-0.03, 0.02, -0.07), yaw=3, twist=7, flexion=10, reach_l=(0.53, 0.26, -0.61),
    reach_r=(0.58, -0.32, -0.44), wrist_r=(10, -15),
)  # fmt: skip
_PUNCH = replace(
    READY, twist=2, reach_l=(0.44, 0.37, -0.61), reach_r=(0.84, 0.06, -0.21), wrist_r=(0, -5)
)
_OPEN = replace(
    READY, yaw=-5, twist=-9, flexion=6, reach_l=(0.37, 0.44, -0.63), reach_r=(0.69, 0.50, 0.11),
    wrist_r=(-10, 5),
)  # fmt: skip
_PALM = replace(
    READY, yaw=-9, twist=-7, flexion=9, gaze=(8, -4), reach_l=(0.63, -0.11, -0.53),
    reach_r=(0.47, 0.55, -0.42),
)  # fmt: skip
_TOSS = replace(
    READY, pelvis=(-0.02, -0.02, -0.02), yaw=-10, twist=-11, flexion=4, gaze=(10, -14),
    reach_l=(0.73, 0.00, 0.38), reach_r=(0.11, 0.80, -0.11), wrist_r=(-12, 20),
)  # fmt: skip
_BRUSH = replace(
    READY, pelvis=(0.0, 0.02, -0.07), yaw=3, twist=5, flexion=12, gaze=(0, 4),
    reach_l=(0.44, 0.32, -0.63), reach_r=(0.71, -0.05, -0.44), wrist_r=(14, 10),
)  # fmt: skip
STROKES: dict[str, tuple[tuple[float, Posture], ...]] = {
    "forehand": ((0.42, _BACKSWING), (0.60, _DRIVE), (0.74, _OVER)),
    "backhand": ((0.40, _COIL), (0.56, _PUNCH), (0.70, _OPEN)),
    "serve": ((0.40, _PALM), (0.72, _TOSS), (0.98, _BRUSH)),
}
# From the end of a stroke to the ready posture.
RECOVERY_S = 0.5
# Before the first stroke.
REST_S = 0.25


@dataclass(frozen=True)
class Performance:
    """A movement of one person, at any time."""

    figure: Figure  # the person who moves
    curves: Spline  # posture channels over time
    # (S,) seconds at which a stroke, or a reach, begins; what follows the last is rest.
    starts: np.ndarray

    def bones(self, times: np.ndarray) -> BoneFrames:
        """Frames of all bones at (T,) times, seconds."""
        return self.figure.place(Posture.split(self.curves(times)))

    def landmarks(self, times: np.ndarray) -> dict[str, np.ndarray]:
        """Landmark name -> (T, 3) positions in the world, metres, at (T,) times, seconds."""
        return self.figure.landmarks(self.bones(times))


def varied_figure(height: float, rng: np.random.Generator) -> Figure:
    """Someone of that height (metres) whose bones differ from the tables' by up to 3 %."""
    average = Skeleton.human(height, proportions=WINTER)
    names = [name.removesuffix("_l").removesuffix("_r") for name in average.tree.bones]
    spread = {name: rng.uniform(-LIMB_VARIATION, LIMB_VARIATION) for name in dict.fromkeys(names)}
    factors = jnp.asarray([1 + spread[name] for name in names], average.lengths.dtype)
    return Figure.standing(replace(average, lengths=average.lengths * factors), height)


def table_tennis(
    seconds: float,
    seed: int = 0,
    strokes: Sequence[str] = ("forehand", "backhand", "serve"),
    height: float = 1.75,
) -> Performance:
    """Strokes one after the other, as many as begin in time.

    Raises:
        ValueError: an unknown stroke; the message lists the valid ones.
    """
    for stroke in strokes:
        if stroke not in STROKES:
            raise ValueError(f"unknown stroke {stroke!r}; expected one of {', '.join(STROKES)}")
    rng = np.random.default_rng(seed)
    figure = varied_figure(height, rng)
    keys, starts, now, first = [(0.0, _ease_elbows(READY, rng))], [], REST_S, int(rng.integers(2))
    while not starts or now < seconds:
        number = len(starts)
        starts.append(now)
        pace = rng.uniform(1.25, 1.4)
        for after, posture in STROKES[strokes[number % len(strokes)]]:
            keys.append(
                (now + pace * after, _lift_elbows(_vary_posture(posture, rng), rng, first + number))
            )
        now = keys[-1][0] + RECOVERY_S
        keys.append((now, _ease_elbows(READY, rng)))
    return Performance(figure, spline_through(keys), np.array(starts))


def squat(seconds: float = 5.0, seed: int = 0, height: float = 1.75) -> Performance:
    """Down by 0.3 m with the trunk bowed and the arms stretched forward, and up again."""
    rng = np.random.default_rng(seed)
    down = Posture(
        pelvis=(-0.16, 0.0, -0.305), pitch=28, flexion=16, gaze=(0, -6),
        reach_l=(0.68, 0.12, 0.46), reach_r=(0.68, 0.12, 0.46), swivel_l=48, swivel_r=46,
    )  # fmt: skip
    upright = replace(STANDING, swivel_l=34, swivel_r=26)
    shares = (0.0, 0.12, 0.42, 0.56, 0.88, 1.0)
    postures = (upright, upright, down, replace(down, swivel_l=54), upright, upright)
    keys = [(share * seconds, posture) for share, posture in zip(shares, postures, strict=True)]
    return Performance(
        varied_figure(height, rng), spline_through(keys), np.array([shares[1] * seconds])
    )


def reaching(seconds: float = 6.0, seed: int = 0, height: float = 1.75) -> Performance:
    """Left and right hand in turn to places around the body, at elbow heights of their own."""
    rng = np.random.default_rng(seed)
    figure = varied_figure(height, rng)
    keys, starts, now = [(0.0, _ease_elbows(STANDING, rng))], [], 0.3
    while not starts or now < seconds:
        # Ahead, between chest and head, at four fifths of the arm's length.
        goal = np.array([0.8, rng.uniform(-0.25, 0.6), rng.uniform(-0.5, 0.4)])
        goal *= rng.uniform(0.78, 0.92) / np.linalg.norm(goal)
        side = "lr"[len(starts) % 2]
        trunk = replace(STANDING, flexion=rng.uniform(3, 10), twist=(-8 if side == "l" else 8))
        posture = _reaching_to(goal, side, trunk, rng, len(starts) // 2)
        keys += [(now + 0.8, posture), (now + 1.1, posture)]
        starts.append(now)
        now += 1.1
    return Performance(figure, spline_through(keys), np.array(starts))


def _reaching_to(
    goal: np.ndarray, side: str, trunk: Posture, rng: np.random.Generator, turn: int
) -> Posture:
    """A trunk with one hand at a goal (3,), by the arm's length; the other arm at ease."""
    other = "r" if side == "l" else "l"
    lifted = _lift_elbows(trunk, rng, turn)
    eased = getattr(_ease_elbows(trunk, rng), f"swivel_{other}")
    changed: dict[str, Any] = {f"reach_{side}": tuple(goal), f"swivel_{other}": eased}
    return replace(lifted, **changed)


def across(seconds: float = 6.0, seed: int = 0, height: float = 1.75) -> Performance:
    """Left and right hand in turn to the other side, where the trunk turns along and stays."""
    rng = np.random.default_rng([seed, 44])
    figure = varied_figure(height, rng)
    keys, starts, now = [(0.0, _ease_elbows(STANDING, rng))], [], 0.3
    while not starts or now < seconds:
        goal = np.array([0.7, rng.uniform(-0.75, -0.25), rng.uniform(-0.5, 0.35)])
        goal *= rng.uniform(0.78, 0.92) / np.linalg.norm(goal)
        side, turn = "lr"[len(starts) % 2], rng.uniform(*TURN_DEG)
        turn = -turn if side == "l" else turn
        flexion = rng.uniform(3, 10)
        trunk = replace(
            STANDING, pelvis=(0.0, 0.0, -0.02), yaw=0.3 * turn, twist=0.7 * turn, flexion=flexion
        )
        posture = _reaching_to(goal, side, trunk, rng, len(starts) // 2)
        keys += [(now + 0.8, posture), (now + 1.8, posture)]
        starts.append(now)
        now += 2.0
    return Performance(figure, spline_through(keys), np.array(starts))


def raises(seconds: float = 6.0, seed: int = 0, height: float = 1.75) -> Performance:
    """Both arms to the front, to the sides and overhead, and down again each time."""
    rng = np.random.default_rng(seed)
    figure = varied_figure(height, rng)
    keys, starts, now = [(0.0, _ease_elbows(STANDING, rng))], [], 0.3
    while not starts or now < seconds:
        place = RAISED[len(starts) % len(RAISED)]
        up = _ease_elbows(_vary_posture(replace(STANDING, reach_l=place, reach_r=place), rng), rng)
        keys += [(now + 0.7, up), (now + 1.0, up), (now + 1.7, _ease_elbows(STANDING, rng))]
        starts.append(now)
        now += 1.8
    return Performance(figure, spline_through(keys), np.array(starts))


def thrust(
    seconds: float = 6.0, seed: int = 0, height: float = 1.75, azimuth: float = 0.0
) -> Performance:
    """Left fist, right fist and both in turn, straight at a camera and back, elbows swinging.

    Along the line of sight the image hardly moves: what shows is the elbow, high or low.

    ``azimuth`` is the camera's, degrees from frontal, positive to the person's left. Hips and chest
    turn towards it, by half the way.
    """
    rng = np.random.default_rng(seed)
    figure = varied_figure(height, rng)
    guard = _aim_at(GUARD, azimuth, FOLDED_REACH, FOLDED_REACH)
    keys, starts, now = [(0.0, _ease_elbows(guard, rng))], [], 0.2
    while not starts or now < seconds:
        left, right = rng.uniform(*STRETCHED_REACH, 2)
        fists = ((left, FOLDED_REACH), (FOLDED_REACH, right), (left, right))[len(starts) % 3]
        aimed = _aim_at(replace(GUARD, twist=rng.uniform(-4, 4)), azimuth, *fists)
        struck = _lift_elbows(aimed, rng, len(starts))
        keys += [(now + 0.30, struck), (now + 0.40, struck), (now + 0.75, _ease_elbows(guard, rng))]
        starts.append(now)
        now += 0.85
    return Performance(figure, spline_through(keys), np.array(starts))


def _aim_at(posture: Posture, azimuth: float, left: float, right: float) -> Posture:
    """Hips and chest half the way to an azimuth, fists so many arm lengths ahead, all the way."""
    # In the chest's frame: what is left of the way, and the lean of trunk and chest undone.
    rest = np.deg2rad(azimuth / 2 - posture.twist)
    lean = np.deg2rad(posture.pitch + posture.flexion)
    up = np.array([-np.sin(lean), 0.0, np.cos(lean)])
    left_ahead = np.array([np.cos(rest) * np.cos(lean), np.sin(rest), np.sin(lean)])
    right_ahead = left_ahead * [1.0, -1.0, 1.0]
    return replace(
        posture,
        yaw=azimuth / 4,
        twist=posture.twist + azimuth / 4,
        reach_l=tuple(left * left_ahead - FIST_DROP * up),
        reach_r=tuple(right * right_ahead - FIST_DROP * up),
    )


def _ease_elbows(posture: Posture, rng: np.random.Generator) -> Posture:
    """The posture with its elbows between low and high."""
    left, right = rng.uniform(*MIDDLE_SWIVEL_DEG, 2)
    return replace(posture, swivel_l=left, swivel_r=right)


def _lift_elbows(posture: Posture, rng: np.random.Generator, number: int) -> Posture:
    """The posture with its elbows low or high, the two sides in opposite turns."""
    high, low = rng.uniform(*HIGH_SWIVEL_DEG), rng.uniform(*LOW_SWIVEL_DEG)
    left, right = (low, high) if number % 2 else (high, low)
    return replace(posture, swivel_l=left, swivel_r=right)


def _vary_posture(posture: Posture, rng: np.random.Generator) -> Posture:
    """The posture with random variations: no two strokes are the same."""
    around = {
        name: tuple(np.asarray(getattr(posture, name)) + rng.uniform(-0.05, 0.05, 3))
        for name in ("reach_l", "reach_r")
    }
    return replace(posture, twist=posture.twist + rng.uniform(-4, 4), **around)


def spline_through(keys: list[tuple[float, Posture]]) -> Spline:
    """The spline through key postures at times in seconds."""
    return Spline(
        np.array([time for time, _ in keys]), np.stack([key.channels() for _, key in keys])
    )


# Name -> of seconds, seed and height; a thrust goes at a camera of some azimuth as well.
MOTIONS: dict[str, Callable[..., Performance]] = {
    "tennis": table_tennis,
    "thrust": thrust,
    "reaching": reaching,
    "across": across,
    "raises": raises,
    "squat": squat,
}
