"""Where else an arm may be in a frame: the search of the whole recording's, one frame of it.

A window goes downhill, and an elbow stays in the valley it is in. So now and then a frame prices
every candidate of ``elbow_viterbi`` for one arm, the rest of the body where it is. Candidates that
cost about as much as where the arm is say how sure that is.

INPUTS: an event with frames. OUTPUTS: the arm that would cost least elsewhere; how far arms may be.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.arms import TURNS, arm_dofs, hang
from jaxmocap.body.model import Model
from jaxmocap.body.pose import pack, unpack
from jaxmocap.compilation.batches import in_batches
from jaxmocap.compilation.programs import program
from jaxmocap.evidence.silhouettes import SilhouetteGrids
from jaxmocap.geometry.cameras import Camera
from jaxmocap.smoothing.elbow_viterbi import STAY, candidates, turned_angles, view_costs
from jaxmocap.smoothing.settings import SmoothingSettings
from jaxmocap.smoothing.window.events import WindowEvent

# Cells over which silhouettes fade, where there are half as many to a side.
SOFTNESS = 0.75
# A frame's silhouette counts by this share when candidates say how sure an arm is: it errs as much
# again where people are no cones. By five rendered clips and one real camera.
COUNTS = 0.5
# Poses in one call.
POSES_A_CALL = 8


class ArmSearch(NamedTuple):
    """What a frame says of arms elsewhere.

    Attributes:
        side: of the arm that would cost least elsewhere, 0 for the left one.
        turn: (3,) of its forearm, as of ``TURNS``, radians.
        gain: by how much less that costs than where the arm is, nats.
        away: of its elbow from there, metres.
        spread: (2, 3, 3) root mean squares of how far elbow, wrist and hand's tip of either arm may
            be from where they are, world, metres.
    """

    side: int
    turn: np.ndarray
    gain: float
    away: float
    spread: np.ndarray


def search_arms(
    model: Model, settings: SmoothingSettings, cameras: Sequence[Camera], event: WindowEvent
) -> ArmSearch:
    """All candidates of either arm, by the frames of an event.

    Args:
        model: of the person and the markers.
        settings: of the smoothing.
        cameras: of the model.
        event: with frames.
    """
    pose = np.concatenate(event.pose).astype(model.dtype)
    points, costs = (np.asarray(part, float) for part in _arms_elsewhere(model, settings, pose))
    pictures = np.zeros_like(costs)
    for camera, frame, _ in event.frames:
        squares = _picture_costs(model, cameras[camera], pose, frame.grids.halved())
        pictures += settings.silhouettes.weight / 2 * np.asarray(squares)
    total, tempered = costs + pictures, costs + COUNTS * pictures
    side, turn = np.unravel_index(total.argmin(), total.shape)
    shares = np.exp(tempered.min(1, keepdims=True) - tempered)
    shares /= shares.sum(1, keepdims=True)
    away = points - points[:, STAY, None]
    spread = np.sqrt(np.einsum("sk,skpi->spi", shares, away**2))
    gain, elbow = total[side, STAY] - total[side, turn], away[side, turn, 0]
    chosen = TURNS[turn].astype(model.dtype)
    return ArmSearch(int(side), chosen, float(gain), float(np.linalg.norm(elbow)), spread)


def with_arm_there(model: Model, poses: np.ndarray, found: ArmSearch) -> np.ndarray:
    """Packed poses (T, 7 + D), the arm of each turned as was found."""
    chosen = np.int32(found.side), found.turn
    (there,) = in_batches(
        lambda some: (_with_arm_there(model, some, *chosen),), (poses,), POSES_A_CALL
    )
    return there.astype(poses.dtype)


@program("full")
def _arms_elsewhere(model: Model, settings: SmoothingSettings, pose: Array) -> tuple[Array, Array]:
    """Elbow, wrist and tip (2, K, 3, 3) of candidates, and what they cost by themselves (2, K)."""
    one = jax.tree.map(lambda part: part[None], unpack(pose))
    arms, costs = candidates(model, settings.elbow_path, one)
    return jnp.stack([arms.elbow, arms.wrist, arms.tip], 3)[0], costs[0]


@program("full")
def _picture_costs(model: Model, camera: Camera, pose: Array, grids: SilhouetteGrids) -> Array:
    """Sums of squares (2, K) of one view with one arm at each candidate, the other where it is."""
    every, stay = jnp.arange(len(TURNS)), jnp.full(1, STAY)
    soft = jnp.asarray(SOFTNESS, pose.dtype)
    left, right = (
        view_costs(model, soft, unpack(pose), camera, grids, chosen).ravel()
        for chosen in ((every, stay), (stay, every))
    )
    return jnp.stack([left, right])


@program("quick")
def _with_arm_there(model: Model, poses: Array, side: Array, turn: Array) -> Array:
    """Packed poses (T, 7 + D), one arm's forearm turned by a rotation vector about its grip."""
    dofs = jnp.asarray(arm_dofs(model.skeleton.tree))[side]

    def one(packed: Array) -> Array:
        pose = unpack(packed)
        angles = turned_angles(hang(model.skeleton, pose, model.grips), turn[None])[side, 0]
        return pack(pose._replace(angles=pose.angles.at[dofs].set(angles)))

    return jax.vmap(one)(poses)
