"""Surfaces between surfaces, and places that swell (second paper, 4.2.2 and 4.2.3).

A field moves one stretch of a patch, fading towards the next: all around outwards (a thicker limb),
to one side (flesh ahead of the bone), or outwards on two sides opposite each other (a flat limb).
A limb and its fellow on the other side share their fields, mirrored: people are nearly symmetric,
and what one camera shows of the left arm determines the right one too.

INPUTS: Surfaces in correspondence, node for node; places of their patches.
OUTPUTS: moves of the nodes.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.surfaces.morphing import Driver, Morphing, Swelling, Transition
from jaxmocap.body.surfaces.surface import (
    Patch,
    Surface,
    resample_moves,
    resample_surface,
    rest_nodes,
)
from jaxmocap.body.tree import Tree
from jaxmocap.silhouette.surfaces.morph import Morph, morph_of

# Stretches of a patch, by its name without a side.
STRETCHES = {"torso": 7, "arm": 7, "leg": 7, "foot": 3}
# Kind -> deviation from the generic body, metres.
KINDS = {"girth": 0.010, "ahead": 0.008, "aside": 0.008, "flat": 0.005, "skew": 0.005}
# What is not the same on both sides: a trunk has none of it.
SIDED = ("aside", "skew")


@dataclass(frozen=True)
class SwellingFields:
    """P fields over the N nodes of a surface."""

    # Of the fields: patch without its side, kind and stretch.
    names: tuple[tuple[str, str, int], ...]
    moves: np.ndarray  # (N, 3, P) where a node goes with an amount of 1, in its bones' frames
    deviations: np.ndarray  # (P,) of the amounts among people, metres


def fields_of(surface: Surface, joints: np.ndarray) -> SwellingFields:
    """The fields of a surface, however dense, around bones with these joints (B, 3) at rest."""
    names = _names(surface)
    moves = np.zeros((len(surface.points.bones), 3, len(names)), np.float32)
    nodes = rest_nodes(surface, joints)
    for patch in surface.patches:
        grid = patch.grid(nodes)
        limb = patch.limb
        ways, parts = _ways(patch, grid), _parts(grid, STRETCHES[limb])
        for column, (of, kind, stretch) in enumerate(names):
            if of == limb:
                moved = parts[:, stretch, None, None] * ways[kind]
                moves[patch.nodes, :, column] = moved.reshape(-1, 3)
    return SwellingFields(names, moves, np.array([KINDS[kind] for _, kind, _ in names]))


def swell_surface(surface: Surface, fields: SwellingFields, amounts: np.ndarray) -> Surface:
    """The surface with amounts (P,) of its fields."""
    points = surface.points
    moved = np.asarray(points.points_bone) + (fields.moves @ amounts)[:, None]
    dtype = jnp.asarray(points.points_bone).dtype
    return replace(surface, points=points._replace(points_bone=jnp.asarray(moved, dtype)))


def _names(surface: Surface) -> tuple[tuple[str, str, int], ...]:
    limbs = dict.fromkeys(patch.limb for patch in surface.patches)
    return tuple(
        (limb, kind, stretch)
        for limb in limbs
        for kind in KINDS
        if not (limb == "torso" and kind in SIDED)
        for stretch in range(STRETCHES[limb])
    )


def _ways(patch: Patch, grid: np.ndarray) -> dict[str, np.ndarray]:
    """Kind -> (along, around, 3) unit moves of a patch's nodes; mirrored on the right."""
    phi = 2 * np.pi * np.arange(patch.around) / patch.around
    upright = np.ptp(grid.mean(1)[:, 2]) > np.ptp(grid.mean(1)[:, 0])
    first = np.eye(3)[0 if upright else 2]
    second = np.eye(3)[1] * patch.outwards
    outwards = np.cos(phi)[:, None] * first + np.sin(phi)[:, None] * second
    ways = {
        "girth": outwards,
        "ahead": first,
        "aside": second,
        "flat": np.cos(2 * phi)[:, None] * outwards,
        "skew": np.sin(2 * phi)[:, None] * outwards,
    }
    return {kind: np.broadcast_to(way, grid.shape) for kind, way in ways.items()}


def _parts(grid: np.ndarray, stretches: int) -> np.ndarray:
    """(along, stretches) how far each ring belongs to each stretch; together 1."""
    at = _shares_along(grid) * (stretches - 1)
    return np.maximum(1 - np.abs(at[:, None] - np.arange(stretches)), 0.0)


def _shares_along(grid: np.ndarray) -> np.ndarray:
    """(along,) of the way through the rings' middles."""
    steps = np.linalg.norm(np.diff(grid.mean(1), axis=0), axis=1)
    way = np.append(0.0, np.cumsum(steps))
    return way / way[-1]


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
    phi = 2 * np.pi * np.arange(patch.around) / patch.around
    return np.stack(np.broadcast_arrays(phi, _shares_along(grid)[:, None]), -1).reshape(-1, 2)


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

    ``joints`` (B, 3) are of the bones with all angles 0, metres.

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
    return moves if spacing is None else resample_moves(surface, joints, spacing, moves)


def morph_around(
    morphing: Morphing,
    tree: Tree,
    surface: Surface,
    joints: np.ndarray,
    spacing: float | None = None,
) -> Morph:
    """A morphing of one skeleton and the surface around it.

    ``joints`` (B, 3) are of the bones with all angles 0, metres; ``spacing``, metres, is of the
    nodes that go along, if those come from ``resample_surface``.

    Raises:
        KeyError: no such joint, or no such weighting.
        ValueError: no such patch, surfaces of other patches, or a joint drives and follows.
    """
    if not (morphing.swellings or morphing.transitions):
        return morph_of(morphing, tree)
    drivers = morphing.drivers
    worn = surface if spacing is None else resample_surface(surface, joints, spacing)
    moves = swelling_moves(worn, joints, drivers, morphing.swellings)
    for transition in morphing.transitions:
        gone = transition_offsets(surface, joints, transition, spacing)
        moves[..., drivers.index(transition.driver)] += gone
    return morph_of(morphing, tree, moves)
