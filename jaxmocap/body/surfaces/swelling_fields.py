"""How a body differs from the generic one: fields that move its surface, in and out and aside.

A field moves one stretch of a patch, fading towards the next: all around outwards (a thicker limb),
to one side (flesh ahead of the bone), or outwards on two sides opposite each other (a flat limb).
A limb and its fellow on the other side share their fields, mirrored: people are nearly symmetric,
and what one camera shows of the left arm determines the right one too.

INPUTS: a Surface; amounts of its fields, metres. OUTPUTS: the fields; the surface with them.
"""

from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np

from jaxmocap.body.surfaces.surface import Patch, Surface, rest_nodes

# Stretches of a patch, by its name without a side.
STRETCHES = {"torso": 7, "arm": 7, "leg": 7, "foot": 3}
# Kind -> deviation from the generic body, metres.
KINDS = {"girth": 0.010, "ahead": 0.008, "aside": 0.008, "flat": 0.005, "skew": 0.005}
# What is not the same on both sides: a trunk has none of it.
SIDED = ("aside", "skew")


@dataclass(frozen=True)
class SwellingFields:
    """P fields over the N nodes of a surface.

    Attributes:
        names: of the fields: patch without its side, kind and stretch.
        moves: (N, 3, P) where a node goes with an amount of 1, in its bones' frames.
        deviations: (P,) of the amounts among people, metres.
    """

    names: tuple[tuple[str, str, int], ...]
    moves: np.ndarray
    deviations: np.ndarray


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


def reshaped(surface: Surface, fields: SwellingFields, amounts: np.ndarray) -> Surface:
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
    steps = np.linalg.norm(np.diff(grid.mean(1), axis=0), axis=1)
    way = np.append(0.0, np.cumsum(steps))
    at = way / way[-1] * (stretches - 1)
    return np.maximum(1 - np.abs(at[:, None] - np.arange(stretches)), 0.0)
