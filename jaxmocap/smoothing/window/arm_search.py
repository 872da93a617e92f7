"""Where else an arm may be in a frame: the search of the whole recording's, one frame of it.

A window goes downhill, and an elbow stays in the valley it is in. So now and then a frame prices
every candidate of ``elbow_viterbi`` for one arm, the rest of the body where it is. Candidates that
cost about as much as where the arm is say how sure that is.

INPUTS: an event with frames. OUTPUTS: the arm that would cost least elsewhere; how far arms may be.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxmocap.body.arms import ELBOW, GRIP, TURNS, turn_pose
from jaxmocap.body.model import Model
from jaxmocap.body.pose import Pose, pack, unpack
from jaxmocap.evidence.keypoints import SightLines
from jaxmocap.evidence.silhouettes import SilhouetteGrids
from jaxmocap.geometry.rotations import HIGHEST
from jaxmocap.smoothing.elbow_viterbi import (
    STAY,
    candidates,
    lone_costs,
    price_off_lines,
)
from jaxmocap.smoothing.settings import SmoothingSettings

# Cells over which silhouettes fade, where there are half as many to a side.
SOFTNESS = 0.75
# A frame's silhouette counts by this share when candidates say how sure an arm is: it errs as much
# again where people are no cones. By five rendered clips and one real camera.
COUNTS = 0.5


class ArmSearch(NamedTuple):
    """What a frame says of arms elsewhere."""

    side: Array  # of the arm that would cost least elsewhere, 0 for the left one
    turn: Array  # (3,) about its pivot, as of ``TURNS``, radians
    gain: Array  # by how much less that costs than where the arm is, nats
    away: Array  # of its elbow from there, or about the elbow of its wrist, metres
    # (2, 3, 3) root mean squares of how far elbow, wrist and hand's tip of either arm may be from
    # where they are, world, metres.
    spread: Array
    pivots: Array  # (2,) about what the arms were turned


def search_arms(
    model: Model,
    settings: SmoothingSettings,
    pose: Pose,
    shown: Array,
    grids: SilhouetteGrids,
    lines: SightLines | None,
    pivots: Array,
) -> ArmSearch:
    """All candidates of either arm, by the frames of an event.

    Args:
        model: of the person, the markers and C cameras.
        settings: of the smoothing.
        pose: of the event.
        shown: (C,) which cameras had a frame.
        grids: (C, ...) what these show.
        lines: (K, ...) to their key points, where any camera has some.
        pivots: (2,) about what the arms are turned.
    """
    one = jax.tree.map(lambda part: part[None], pose)
    # A window goes on from its own angles: to others raised arms were led astray.
    arms, own = candidates(model, settings.elbow_path, one, pivots[None], limited=False)
    points, costs = jnp.stack([arms.elbow, arms.wrist, arms.tip], 3)[0], own[0]
    coarse, soft = grids.halve(), jnp.asarray(SOFTNESS, pose.angles.dtype)

    def of_camera(c: Array, total: Array) -> Array:
        def priced() -> Array:
            camera, there = jax.tree.map(lambda part: jnp.asarray(part)[c], (model.cameras, coarse))
            return total + lone_costs(model, soft, pose, camera, there, pivots)

        return jax.lax.cond(shown[c], priced, lambda: total)

    squares = jax.lax.fori_loop(0, model.camera_count, of_camera, jnp.zeros_like(costs))
    pictures = squares / (2 * settings.silhouettes.deviation**2)
    if lines is not None:
        pictures += price_off_lines(arms.elbow[0], lines, settings.keypoints.deviation)
    total = costs + pictures
    shares = jax.nn.softmax(-(costs + COUNTS * pictures), axis=1)
    away = points - points[:, STAY, None]
    spread = jnp.sqrt(jnp.einsum("sk,skpi->spi", shares, away**2, precision=HIGHEST))
    side, turn = jnp.divmod(jnp.argmin(total), len(TURNS))
    gain = total[side, STAY] - total[side, turn]
    # About an elbow that is the wrist's way.
    moved = away[side, turn, jnp.where(pivots[side] == ELBOW, 1, 0)]
    chosen = jnp.asarray(TURNS, pose.angles.dtype)[turn]
    return ArmSearch(side, chosen, gain, jnp.linalg.norm(moved), spread, pivots)


def with_arm_there(model: Model, poses: Array, found: ArmSearch, unmarked: Array) -> Array:
    """Packed poses (T, 7 + D), the arm of each turned as was found.

    About its grip at all events, about a joint at those where it is ``unmarked`` (T, 2).
    """
    turns = jnp.zeros((2, 3), poses.dtype).at[found.side].set(found.turn)
    is_turned = unmarked | (found.pivots == GRIP)

    def one(packed: Array, turned: Array) -> Array:
        own = jnp.where(turned[:, None], turns, 0.0)
        before = unpack(packed)
        after = turn_pose(model.skeleton, before, model.grips, own, found.pivots, limited=False)
        return pack(after)

    return jax.vmap(one)(poses, is_turned)
