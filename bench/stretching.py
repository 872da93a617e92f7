"""A range of motion for finding a person's lengths, by people of unusual proportions.

Stretched arms swung to the side and ahead, elbows bent with the upper arms hanging, forearms folded
before the chest, a bow of the knees.

INPUTS: a duration, a seed, a stature. OUTPUTS: a Performance.
"""

from dataclasses import replace
from itertools import pairwise

import jax.numpy as jnp
import numpy as np

from jaxmocap.body.skeleton import WINTER, Skeleton
from jaxmocap.synthetic.movements.motions import STANDING, Performance, spline_through
from jaxmocap.synthetic.people.figure import Figure, Posture

# Standard deviations of lengths among people of one stature, both sides alike.
SPREADS = {
    ("spine",): 0.05,
    ("clavicle",): 0.06,
    ("neck", "head"): 0.05,
    ("humerus",): 0.05,
    ("radius",): 0.05,
    ("hand",): 0.05,
    ("hip",): 0.05,
    ("femur",): 0.05,
    ("tibia",): 0.05,
    ("foot",): 0.05,
}
# From sole to crown; what these lengths together are stays as tall as the person.
UPRIGHT = ("spine", "neck", "head", "femur_l", "tibia_l")
UPPER_ARM, STRETCHED = 0.56, 0.955  # of the arm's length
LOW = np.array([-0.14, 0.0, -0.22])


def stretching(seconds: float = 6.0, seed: int = 0, height: float = 1.75) -> Performance:
    """The whole range of motion, once."""
    rng = np.random.default_rng([seed, 9])
    keys = [_varied(key, rng) for key in _keys()]
    # Time goes by as the hands' and the pelvis' ways do.
    ways = [_way(a, b) for a, b in pairwise(keys)]
    times = seconds * np.cumsum([0.0, *ways]) / np.sum(ways)
    figure = unusual(height, np.random.default_rng([seed, 77]))
    path = spline_through(list(zip(times.tolist(), keys, strict=True)))
    return Performance(figure, path, np.array([0.0]))


def unusual(height: float, rng: np.random.Generator) -> Figure:
    """A person of this stature whose lengths are not the mean's."""
    usual = Skeleton.human(height, proportions=WINTER)
    bones, lengths = usual.tree.bones, np.array(usual.lengths, float)
    for starts, spread in SPREADS.items():
        lengths[[name.startswith(starts) for name in bones]] *= 1 + spread * rng.normal()
    upright = [bone for bone, name in enumerate(bones) if name.startswith(UPRIGHT)]
    right = [bones.index(name) for name in ("femur_r", "tibia_r")]
    scale = float(np.asarray(usual.lengths)[upright].sum()) / lengths[upright].sum()
    lengths[[*upright, *right]] *= scale
    return Figure.standing(
        replace(usual, lengths=jnp.asarray(lengths, usual.lengths.dtype)), height
    )


def _keys() -> list[Posture]:
    side = [_stretched(angle, 85) for angle in (12, 30, 50, 70, 88, 70, 50, 30, 12)]
    curls = [_curled(bend) for bend in (20, 50, 80, 110, 130, 110, 80, 50, 20)]
    ahead = [_stretched(angle, 12) for angle in (12, 30, 50, 70, 85)]
    folded = [
        _reaching((0.62, 0.15, -0.12), 50),
        _reaching((0.40, 0.12, -0.22), 75),
        _reaching((0.32, 0.10, -0.30), 85),
        _reaching((0.45, 0.12, -0.20), 60),
    ]
    back = [_stretched(angle, 12) for angle in (70, 50, 30, 12)]
    bowed = [
        _low(_curled(bend), share) for bend, share in ((45, 0.4), (70, 0.9), (70, 0.9), (45, 0.4))
    ]
    return [*side, *curls, *ahead, *folded, *back, *bowed, _stretched(12, 60)]


def _reaching(reach: tuple[float, float, float], swivel: float) -> Posture:
    """Both wrists at a place from their shoulders, in arm lengths; knees a little bent."""
    return replace(
        STANDING,
        pelvis=(0.0, 0.0, -0.045),
        reach_l=reach,
        reach_r=reach,
        swivel_l=swivel,
        swivel_r=swivel,
    )


def _stretched(elevation: float, outward: float) -> Posture:
    """Straight arms, degrees from hanging and from ahead."""
    up, out = np.radians([elevation, outward])
    ahead, side = np.sin(up) * np.cos(out), np.sin(up) * np.sin(out)
    x, y, z = (STRETCHED * np.array([ahead, side, -np.cos(up)])).tolist()
    return _reaching((x, y, z), 30)


def _curled(bend: float, out: float = 8.0) -> Posture:
    """Upper arms hanging, elbows bent by so many degrees."""
    out, bend = np.radians([out, bend])
    upper = np.array([np.sin(out) * np.cos(1.4), np.sin(out) * np.sin(1.4), -np.cos(out)])
    fore = np.array([np.sin(bend), np.sin(out), -np.cos(bend)])
    fore /= np.linalg.norm(fore)
    x, y, z = (UPPER_ARM * upper + (1 - UPPER_ARM) * fore).tolist()
    return _reaching((x, y, z), 8)


def _low(posture: Posture, share: float) -> Posture:
    """The same with bent knees and a bowed trunk."""
    x, y, z = (np.array(posture.pelvis) + share * LOW).tolist()
    return replace(
        posture, pelvis=(x, y, z), pitch=26 * share, flexion=14 * share, gaze=(0.0, -6 * share)
    )


def _varied(posture: Posture, rng: np.random.Generator) -> Posture:
    """As it comes out one time."""
    left, right = (
        tuple(np.asarray(reach) + rng.uniform(-0.015, 0.015, 3))
        for reach in (posture.reach_l, posture.reach_r)
    )
    swivels = np.array([posture.swivel_l, posture.swivel_r]) + rng.uniform(-5, 5, 2)
    return replace(
        posture, reach_l=left, reach_r=right, swivel_l=float(swivels[0]), swivel_r=float(swivels[1])
    )


def _way(a: Posture, b: Posture) -> float:
    hands = np.linalg.norm(np.subtract(a.reach_l, b.reach_l))
    return float(max(hands, 0.1 + np.linalg.norm(np.subtract(a.pelvis, b.pelvis))))
