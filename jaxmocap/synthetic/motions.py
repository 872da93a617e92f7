"""Movements of a synthetic person: table-tennis strokes, a squat, reaching.

Key postures joined by smooth splines; a continuous function of time, so that markers, video and
the instants within one exposure sample the same movement. Every stroke lifts the elbow its own
way: markers at head and hands say nothing about it.

INPUTS: a kind of movement, a duration, a seed. OUTPUTS: a Performance.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np

from jaxmocap.body.skeleton import Skeleton
from jaxmocap.synthetic.figure import Bones, Channels, Figure, Posture
from jaxmocap.synthetic.splines import Spline

LIMB_SPREAD = 0.03
# Swivels at which an elbow is low or high; degrees. Strokes alternate between them.
LOW_SWIVEL, MIDDLE_SWIVEL, HIGH_SWIVEL = (18.0, 26.0), (50.0, 70.0), (100.0, 110.0)

READY = Posture(
    pelvis=(-0.05, 0.0, -0.12),
    pitch=18,
    flexion=16,
    gaze=(0, -4),
    reach_l=(0.50, 0.02, -0.40),
    reach_r=(0.52, 0.08, -0.40),
)
STANDING = Posture(
    pelvis=(0.0, 0.0, -0.02), reach_l=(0.35, 0.20, -0.75), reach_r=(0.35, 0.20, -0.75)
)
# A stroke: key postures at seconds from its start. Wrists in arm lengths: forward, out, up.
STROKES: dict[str, tuple[tuple[float, Posture], ...]] = {
    "forehand": (
        (
            0.42,
            replace(
                READY,
                pelvis=(-0.05, -0.05, -0.17),
                yaw=-18,
                twist=-26,
                bend=6,
                reach_l=(0.62, 0.10, -0.22),
                reach_r=(-0.02, 0.62, -0.52),
                wrist_r=(-8, 15),
            ),
        ),
        (
            0.60,
            replace(
                READY,
                pelvis=(-0.02, 0.02, -0.13),
                yaw=2,
                twist=4,
                reach_l=(0.45, 0.30, -0.35),
                reach_r=(0.66, 0.34, -0.22),
                wrist_r=(4, 20),
            ),
        ),
        (
            0.74,
            replace(
                READY,
                pelvis=(0.0, 0.05, -0.12),
                yaw=12,
                twist=20,
                bend=-4,
                reach_l=(0.30, 0.40, -0.42),
                reach_r=(0.66, -0.16, 0.20),
                wrist_r=(10, 25),
            ),
        ),
    ),
    "backhand": (
        (
            0.40,
            replace(
                READY,
                pelvis=(-0.06, 0.02, -0.16),
                yaw=6,
                twist=14,
                flexion=22,
                reach_l=(0.42, 0.18, -0.46),
                reach_r=(0.44, -0.28, -0.36),
                wrist_r=(10, -15),
            ),
        ),
        (
            0.56,
            replace(
                READY,
                twist=2,
                reach_l=(0.34, 0.28, -0.48),
                reach_r=(0.72, 0.06, -0.16),
                wrist_r=(0, -5),
            ),
        ),
        (
            0.70,
            replace(
                READY,
                yaw=-6,
                twist=-12,
                flexion=10,
                reach_l=(0.28, 0.34, -0.50),
                reach_r=(0.66, 0.48, 0.10),
                wrist_r=(-10, 5),
            ),
        ),
    ),
    "serve": (
        (
            0.40,
            replace(
                READY,
                yaw=-22,
                twist=-16,
                flexion=20,
                gaze=(10, -8),
                reach_l=(0.50, -0.12, -0.42),
                reach_r=(0.34, 0.44, -0.34),
            ),
        ),
        (
            0.72,
            replace(
                READY,
                pelvis=(-0.04, -0.03, -0.06),
                yaw=-26,
                twist=-24,
                flexion=8,
                gaze=(12, -18),
                reach_l=(0.62, -0.02, 0.34),
                reach_r=(0.08, 0.70, -0.06),
                wrist_r=(-12, 20),
            ),
        ),
        (
            0.98,
            replace(
                READY,
                pelvis=(0.0, 0.02, -0.15),
                yaw=4,
                twist=8,
                flexion=26,
                gaze=(0, 4),
                reach_l=(0.34, 0.22, -0.50),
                reach_r=(0.60, -0.04, -0.36),
                wrist_r=(14, 10),
            ),
        ),
    ),
}
RECOVERY_S = 0.5
REST_S = 0.25


@dataclass(frozen=True)
class Performance:
    """A movement of one person, at any time.

    Attributes:
        figure: who moves.
        curves: posture channels over time.
        starts: (S,) seconds at which a stroke, or a reach, begins; what follows the last is rest.
    """

    figure: Figure
    curves: Spline
    starts: np.ndarray

    def bones(self, times: np.ndarray) -> Bones:
        """Frames of all bones at (T,) times, seconds."""
        return self.figure.place(Channels.split(self.curves(times)))

    def landmarks(self, times: np.ndarray) -> dict[str, np.ndarray]:
        """Landmark name -> (T, 3) positions in the world, metres, at (T,) times, seconds."""
        return self.figure.landmarks(self.bones(times))

    def swivels(self, times: np.ndarray) -> np.ndarray:
        """(T, 2) of the left and the right elbow, radians; see ``Posture``."""
        channels = Channels.split(self.curves(times))
        return np.stack([channels.swivel_l, channels.swivel_r], -1)


def person(height: float, rng: np.random.Generator) -> Figure:
    """Someone of that height (metres) whose bones differ from the tables' by up to 3 %."""
    average = Skeleton.human(height)
    names = [name.removesuffix("_l").removesuffix("_r") for name in average.tree.bones]
    spread = {name: rng.uniform(-LIMB_SPREAD, LIMB_SPREAD) for name in dict.fromkeys(names)}
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
    figure = person(height, rng)
    keys, starts, now, first = [(0.0, _lifted(READY, rng, 0))], [], REST_S, int(rng.integers(2))
    while now < seconds:
        number = len(starts)
        starts.append(now)
        pace = rng.uniform(1.25, 1.4)
        for after, posture in STROKES[strokes[number % len(strokes)]]:
            keys.append((now + pace * after, _lifted(_varied(posture, rng), rng, first + number)))
        now = keys[-1][0] + RECOVERY_S
        between = {f"swivel_{side}": rng.uniform(*MIDDLE_SWIVEL) for side in "lr"}
        keys.append((now, replace(READY, **between)))
    return Performance(figure, _through(keys), np.array(starts))


def squat(seconds: float = 5.0, seed: int = 0, height: float = 1.75) -> Performance:
    """Down by 0.3 m with the trunk bowed and the arms stretched forward, and up again."""
    rng = np.random.default_rng(seed)
    down = Posture(
        pelvis=(-0.16, 0.0, -0.305),
        pitch=34,
        flexion=22,
        gaze=(0, -6),
        reach_l=(0.80, 0.05, -0.12),
        reach_r=(0.80, 0.05, -0.12),
        swivel_l=74,
        swivel_r=62,
    )
    upright = replace(STANDING, swivel_l=46, swivel_r=36)
    shares = (0.0, 0.12, 0.42, 0.56, 0.88, 1.0)
    postures = (upright, upright, down, replace(down, swivel_l=88), upright, upright)
    keys = [(share * seconds, posture) for share, posture in zip(shares, postures, strict=True)]
    return Performance(person(height, rng), _through(keys), np.array([shares[1] * seconds]))


def reaching(seconds: float = 6.0, seed: int = 0, height: float = 1.75) -> Performance:
    """Left and right hand in turn to places around the body, at elbow heights of their own."""
    rng = np.random.default_rng(seed)
    figure = person(height, rng)
    keys, starts, now = [(0.0, replace(STANDING, swivel_l=60, swivel_r=60))], [], 0.3
    while now < seconds:
        goal = (rng.uniform(0.45, 0.8), rng.uniform(-0.2, 0.45), rng.uniform(-0.35, 0.4))
        side = "lr"[len(starts) % 2]
        trunk = replace(STANDING, flexion=rng.uniform(4, 18), twist=(-12 if side == "l" else 12))
        posture = replace(trunk, **{f"reach_{side}": goal})
        keys.append((now + 0.8, _lifted(posture, rng, len(starts) // 2)))
        starts.append(now)
        now += 1.1
        keys.append((now, keys[-1][1]))
    return Performance(figure, _through(keys), np.array(starts))


def _lifted(posture: Posture, rng: np.random.Generator, number: int) -> Posture:
    """The posture with its elbows low or high, the two sides in opposite turns."""
    high, low = rng.uniform(*HIGH_SWIVEL), rng.uniform(*LOW_SWIVEL)
    left, right = (low, high) if number % 2 else (high, low)
    return replace(posture, swivel_l=left, swivel_r=right)


def _varied(posture: Posture, rng: np.random.Generator) -> Posture:
    """The posture as it comes out one time: no two strokes are the same."""
    around = {
        name: tuple(np.asarray(getattr(posture, name)) + rng.uniform(-0.05, 0.05, 3))
        for name in ("reach_l", "reach_r")
    }
    return replace(posture, twist=posture.twist + rng.uniform(-4, 4), **around)


def _through(keys: list[tuple[float, Posture]]) -> Spline:
    """The spline through key postures."""
    return Spline.through(
        np.array([time for time, _ in keys]), np.stack([key.channels() for _, key in keys])
    )
