"""Surfaces between surfaces, and places that swell (second paper, 4.2.2 and 4.2.3).

INPUTS: Surfaces in correspondence, node for node; places of their patches.
OUTPUTS: moves of the nodes.
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.surfaces.morphing import Driver, Morphing, Swelling, Transition
from jaxmocap.body.surfaces.surface import (
    Patch,
    Surface,
    resampled,
    resampled_moves,
    rest_nodes,
)
from jaxmocap.body.tree import Tree
from jaxmocap.silhouette.surfaces.morph import Morph, morph_of


@jax.jit
def radial(places: Array, centre: Array, radii: Array) -> Array:
    """r(phi1, phi2) of (4.27), (N,), 1 at the centre.

    Args:
        places: (N, 2) phi1, radians and periodic, and phi2.
        centre: (2,) the same.
        radii: (2,) where r falls to 1/e: the roots of the paper's r_x and r_y.
    """
    around = places[:, 0] - centre[0]
    around = around - 2 * jnp.pi * jnp.round(around / (2 * jnp.pi))
    along = places[:, 1] - centre[1]
    return jnp.exp(-((around / radii[0]) ** 2)) * jnp.exp(-((along / radii[1]) ** 2))


def patch_coordinates(patch: Patch, grid: np.ndarray) -> np.ndarray:
    """(along * around, 2) phi1, radians, and phi2, share of the way along, of a patch's nodes."""
    steps = np.linalg.norm(np.diff(grid.mean(1), axis=0), axis=1)
    way = np.append(0.0, np.cumsum(steps)) / steps.sum()
    phi = 2 * np.pi * np.arange(patch.around) / patch.around
    return np.stack(np.broadcast_arrays(phi, way[:, None]), -1).reshape(-1, 2)


def grid_normals(grid: np.ndarray) -> np.ndarray:
    """Unit normals (along, around, 3), out of the body; 0 at a limb's closed ends."""
    around = np.roll(grid, -1, 1) - np.roll(grid, 1, 1)
    across = np.cross(around, np.gradient(grid, axis=0))
    outwards = np.sum(across * (grid - grid.mean(1, keepdims=True)))
    length = np.linalg.norm(across, axis=-1, keepdims=True)
    return np.sign(outwards) * across / np.where(length > 1e-12, length, np.inf)


def swelling_moves(
    surface: Surface, joints: np.ndarray, drivers: Sequence[Driver], swellings: Sequence[Swelling]
) -> np.ndarray:
    """(N, 3, S) what each driver moves of a surface, lambda e r of (4.28), all places together.

    Args:
        surface: N nodes, however dense.
        joints: (B, 3) of the bones with all angles 0, metres.
        drivers: S of them.
        swellings: each by one of these.

    Raises:
        ValueError: no such patch.
    """
    moves = np.zeros((len(surface.points.bones), 3, len(drivers)), np.float32)
    nodes, patches = rest_nodes(surface, joints), {each.name: each for each in surface.patches}
    for swelling in swellings:
        if swelling.patch not in patches:
            raise ValueError(f"no patch {swelling.patch!r}: expected of {', '.join(patches)}")
        patch = patches[swelling.patch]
        grid = patch.grid(nodes)
        r = radial(
            patch_coordinates(patch, grid), np.array(swelling.centre), np.array(swelling.radii)
        )  # type: ignore[arg-type]
        ways = grid_normals(grid).reshape(-1, 3)
        if swelling.direction is not None:
            ways = np.broadcast_to(np.array(swelling.direction), ways.shape)
        moves[patch.nodes, :, drivers.index(swelling.driver)] += (
            swelling.gain * np.asarray(r)[:, None] * ways
        )
    return moves


def transition_offsets(
    surface: Surface, joints: np.ndarray, transition: Transition, spacing: float | None = None
) -> np.ndarray:
    """(M, 3) from a surface's nodes, resampled at ``spacing`` where given, to the other's.

    Raises:
        ValueError: the two have other patches, or there is no such patch.
    """
    if transition.to.patches != surface.patches:
        raise ValueError("two surfaces of other patches: expected the same, node for node")
    names = [patch.name for patch in surface.patches]
    if strange := [name for name in transition.patches if name not in names]:
        raise ValueError(f"no patch {strange[0]!r}: expected of {', '.join(names)}")
    moves = rest_nodes(transition.to, joints) - rest_nodes(surface, joints)
    for patch in surface.patches:
        if transition.patches and patch.name not in transition.patches:
            moves[patch.nodes] = 0.0
    return moves if spacing is None else resampled_moves(surface, joints, spacing, moves)


def morph_around(
    morphing: Morphing,
    tree: Tree,
    surface: Surface,
    joints: np.ndarray,
    spacing: float | None = None,
) -> Morph:
    """A morphing of one skeleton and the surface around it.

    Args:
        morphing: what goes along.
        tree: of the skeleton.
        surface: N nodes.
        joints: (B, 3) of the bones with all angles 0, metres.
        spacing: of the nodes that go along, metres, if those are ``resampled``.

    Raises:
        KeyError: no such joint, or no such weighting.
        ValueError: no such patch, surfaces of other patches, or a joint drives and follows.
    """
    if not (morphing.swellings or morphing.transitions):
        return morph_of(morphing, tree)
    drivers = morphing.drivers
    worn = surface if spacing is None else resampled(surface, joints, spacing)
    moves = swelling_moves(worn, joints, drivers, morphing.swellings)
    for transition in morphing.transitions:
        gone = transition_offsets(surface, joints, transition, spacing)
        moves[..., drivers.index(transition.driver)] += gone
    return morph_of(morphing, tree, moves)
