"""How well a limb in a pose explains what cameras show: the particle filter's likelihood.

A limb is projected as bones of constant thickness, and log-ratios of person against rest are added
up where it would be visible. Before the rest of the body its chromaticity distinguishes it, and it
cannot be within the rest: an arm that is lost often ends within the trunk, where it hides from
every silhouette. What flesh yields and a model errs is allowed for: of a limb that touches another
part the axis lies outside, and only so far as that is inside it is where it cannot be.

INPUTS: a pose, a limb; log-ratios on canvases, what the rest of the body covers, chromaticities.
OUTPUTS: mean log-ratios of the limb's cells.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.body.surfaces.surface import BodyPoints, Surface
from jaxmocap.geometry.cameras import Camera, depth, pixels_per_metre, project
from jaxmocap.geometry.rotations import HIGHEST
from jaxmocap.images.regions import Region
from jaxmocap.images.sampling import look_up
from jaxmocap.silhouette.recovery.chromaticity import DEVIATION, LARGEST_COST
from jaxmocap.silhouette.recovery.limbs import LimbChain, bone_ends

# Nodes kept of a ring.
RING_NODES = 12
# Of the rings one in so many is kept.
RING_STRIDE = 6
# Where a limb is tested, shares of each bone's length: its root is joined to the trunk.
TESTED_SHARES = ((0.65, 0.9), (0.25, 0.75), (0.25, 0.75))
# Limb -> what else it cannot be in; thighs are joined to the trunk.
OBSTACLES = {"arm": ("torso", "leg"), "leg": ("leg",)}


class Obstacles(NamedTuple):
    """Parts of a body that a limb cannot be in, ring by ring."""

    nodes: Array  # (N, 3) in the world, metres
    outwards: Array  # (N, 3) unit vectors from the rings' middles

    @classmethod
    def of(cls, nodes: Array) -> "Obstacles":
        """Of the points of ``obstacle_rings`` (N, 3) in the world."""
        grid = nodes.reshape(-1, RING_NODES, 3)
        away = (grid - jnp.mean(grid, 1, keepdims=True)).reshape(-1, 3)
        return cls(nodes, away / jnp.sqrt(jnp.sum(away**2, -1, keepdims=True) + 1e-12))


def obstacle_rings(surface: Surface, limb: str) -> BodyPoints:
    """Points of the parts that a limb cannot be in, ring by ring ``RING_NODES`` of each."""
    own = next(patch for patch in surface.patches if patch.name == limb)
    chosen = [
        patch.start + np.arange(0, patch.along, RING_STRIDE)[:, None] * patch.around
        + np.arange(RING_NODES) * patch.around // RING_NODES
        for patch in surface.patches if patch != own and patch.limb in OBSTACLES[own.limb]
    ]  # fmt: skip
    nodes = np.concatenate(chosen).ravel()
    return BodyPoints(*(np.asarray(part)[nodes] for part in surface.points))


def penetration_depths(points: Array, obstacles: Obstacles) -> Array:
    """(P,) metres that points (P, 3) lie below the obstacles' surface; negative outside."""
    middle = jnp.mean(obstacles.nodes, 0)
    nodes, outwards, points = obstacles.nodes - middle, obstacles.outwards, points - middle
    # Products of matrices and plain extrema: an argmin takes many times as long.
    apart = jnp.sum(nodes**2, -1) / 2 - jnp.matmul(points, nodes.T, precision=HIGHEST)
    deep = jnp.sum(nodes * outwards, -1) - jnp.matmul(points, outwards.T, precision=HIGHEST)
    nearest = apart <= jnp.min(apart, -1, keepdims=True)
    return jnp.max(jnp.where(nearest, deep, -jnp.inf), -1)


def penetrating_share(near: Array, far: Array, radii: Array, obstacles: Obstacles) -> Array:
    """() 0 to 1: how much of a limb, its bones' ends (B, 3), lies within obstacles.

    A place of it counts in full where its axis lies as deep as the limb is thick.
    """
    at = jnp.asarray(TESTED_SHARES, near.dtype)[..., None]
    points = near[:, None] + at * (far - near)[:, None]
    deep = penetration_depths(points.reshape(-1, 3), obstacles).reshape(points.shape[:2])
    return jnp.mean(jnp.clip(deep / jnp.maximum(radii, 0.01)[:, None], 0.0, 1.0))


# Where cells of a bone are sampled along it, shares of its length.
ALONG_BONE = np.linspace(0.06, 0.94, 8)
# And across it, in its radii.
ACROSS_BONE = np.array([-0.6, 0.0, 0.6])
# No limb is taken for nearer to a camera than this, metres.
NEAREST_M = 0.3
# Log-ratio of what surely has the limb's chromaticity and not that of the rest.
LARGEST_COLOUR = 2.5
# Half the squared deviations from the limb's chromaticity beyond which any is likelier: about the
# log of a normal density at its mean by an even one.
OTHER_COST = 4.0
# Log-ratio of what is neither background nor body, nor of the limb's chromaticity: the limb may be
# behind it.
OCCLUDER = 0.1
# Of lying wholly within other parts of the body.
PENETRATION_COST = 1.0
# However little is visible of a limb, another place must show more than this.
LEAST_VISIBLE = -0.05


class LimbAppearance(NamedTuple):
    """Chromaticities that C cameras show, and those of a limb of B bones with A places on each."""

    chromaticities: Array | np.ndarray  # (C, S, S, 3) of the image; NaN where there are none
    # (C, S, S) half their squared deviations from those of the rest of the body; 0 where nothing
    # was learned.
    body_cost: Array | np.ndarray
    body_depth: Array | np.ndarray  # (C, S, S) metres, of the rest of the body; infinite beside it
    limb_chromaticities: Array | np.ndarray  # (B, A, 3) of the limb; -1 where none was learned


class LimbEvidence(NamedTuple):
    """What C cameras show of the person beyond the rest of the body."""

    # (C, S, S) of person and rest; 0 where the rest of the body is visible.
    log_ratios: Array | np.ndarray
    region: Region  # of the canvases
    used: Array | np.ndarray  # (C,) cameras that count
    appearance: LimbAppearance | None = None  # chromaticities; None where none were learned
    # Parts of the body that the limb cannot be in; None for none.
    obstacles: Obstacles | None = None


def explained_log_ratio(
    skeleton: Skeleton,
    cameras: Camera,
    pose: Pose,
    limb: LimbChain,
    evidence: LimbEvidence,
    least: float = -np.inf,
) -> Array:
    """() mean log-ratio of where the limb would be visible, by its size if all of it were.

    Less what of it lies within other parts of the body. The mean counts as no less than ``least``:
    ``LEAST_VISIBLE`` is for the pose that another must explain more than. What contradicts a limb
    may be a thing before it, or be the limb itself, learned as background; else it were better off
    wherever nothing of it is visible.
    """
    near, far = bone_ends(skeleton, pose, limb)
    gained, _, full = _sum_cameras(skeleton, cameras, (near, far), limb, evidence)
    visible = jnp.maximum(gained / jnp.maximum(full, 1.0), least)
    if evidence.obstacles is None:
        return visible
    share = penetrating_share(near, far, jnp.asarray(limb.radii), evidence.obstacles)
    return visible - PENETRATION_COST * share


def visible_log_ratio(
    skeleton: Skeleton, cameras: Camera, pose: Pose, limb: LimbChain, evidence: LimbEvidence
) -> Array:
    """() mean log-ratio of where the limb is visible; 0 where it is in no image."""
    ends = bone_ends(skeleton, pose, limb)
    gained, visible, _ = _sum_cameras(skeleton, cameras, ends, limb, evidence)
    return gained / jnp.maximum(visible, 1.0)


def _sum_cameras(
    skeleton: Skeleton,
    cameras: Camera,
    ends: tuple[Array, Array],
    limb: LimbChain,
    evidence: LimbEvidence,
) -> tuple[Array, Array, Array]:
    """Over the cameras that count: log-ratios of the limb's cells, how many, how many in full."""
    log_ratios, radii = jnp.asarray(evidence.log_ratios), jnp.asarray(limb.radii)
    region, appearance = jax.tree.map(jnp.asarray, (evidence.region, evidence.appearance))
    lengths = skeleton.lengths[limb.bones]

    def one(
        camera: Camera, log_ratios: Array, region: Region, appearance: LimbAppearance | None
    ) -> tuple[Array, Array, Array]:
        return _of_camera(camera, ends, (radii, lengths), region, log_ratios, appearance)

    each = None if appearance is None else LimbAppearance(0, 0, 0, None)  # type: ignore[arg-type]
    sums = jax.vmap(one, (0, 0, 0, each))(cameras, log_ratios, region, appearance)
    used = jnp.asarray(evidence.used)
    gained, visible, full = (jnp.sum(jnp.where(used, part, 0.0)) for part in sums)
    return gained, visible, full


def _of_camera(
    camera: Camera,
    ends: tuple[Array, Array],
    sizes: tuple[Array, Array],
    region: Region,
    log_ratios: Array,
    appearance: LimbAppearance | None,
) -> tuple[Array, Array, Array]:
    """Of one camera: the sum of log-ratios over the limb's cells, how many, how many in full.

    Of B bones the near and far ends (B, 3), world, and radii and lengths (B,), metres.
    """
    radii, lengths = sizes
    depths = depth(camera, ends[0]), depth(camera, ends[1])
    # Cells to a metre; all that follows is in cells, but for depths.
    cells = pixels_per_metre(camera, jnp.maximum(depths[0][0], NEAREST_M)) / region.scale
    starts, stops = ((project(camera, end) - region.origin) / region.scale - 0.5 for end in ends)
    ways = stops - starts
    length = jnp.sqrt(jnp.sum(ways**2, -1) + 1e-6)
    aside = jnp.stack([-ways[:, 1], ways[:, 0]], -1) / length[:, None]
    along, across = (jnp.asarray(part, ways.dtype) for part in (ALONG_BONE, ACROSS_BONE))
    x, y = (
        starts[:, None, None, k] + along[:, None] * ways[:, None, None, k]
        + across * (cells * radii)[:, None, None] * aside[:, None, None, k]
        for k in (0, 1)
    )  # fmt: skip
    edge = log_ratios.shape[0] - 1.0
    on_canvas = (x >= 0) & (x <= edge) & (y >= 0) & (y <= edge)
    # A forearm laid over its upper arm explains nothing more than that does.
    counts = on_canvas & ~_on_earlier(jnp.stack([x, y], -1), starts, ways, cells * radii)
    there = look_up(log_ratios[None], jnp.zeros((), jnp.int32), x, y)
    if appearance is not None:
        deep = depths[0][:, None] + along * (depths[1] - depths[0])[:, None] - radii[:, None] / 2
        there = _by_colour(there, x, y, deep, appearance)
    there = jnp.where(counts, there, 0.0)
    width = 2 * cells * radii
    gained = jnp.sum(jnp.mean(there, (1, 2)) * length * width)
    visible = jnp.sum(jnp.mean(counts.astype(x.dtype), (1, 2)) * length * width)
    return gained, visible, jnp.sum(cells * lengths * width)


def _by_colour(
    log_ratios: Array, x: Array, y: Array, depths: Array, appearance: LimbAppearance
) -> Array:
    """Log-ratios (B, A, W) of cells, by their chromaticities too, of a limb's places (B, A).

    Before the rest of the body the chromaticity separates that from the limb. What has another than
    the limb is a third thing: no sign of the limb there, and a faint one beside the body, as it may
    hide it.
    """
    edge = appearance.body_depth.shape[0] - 1
    row, column = (jnp.clip(jnp.rint(part), 0, edge).astype(jnp.int32) for part in (y, x))
    # One look-up of all is faster than one of each.
    body = appearance.body_cost[..., None], appearance.body_depth[..., None]
    there = jnp.concatenate([appearance.chromaticities, *body], -1)[row, column]
    shown, body_cost, body_depth = there[..., :3], there[..., 3], there[..., 4]
    limb = appearance.limb_chromaticities[:, :, None]
    is_learned = (limb[..., 0] >= 0) & jnp.isfinite(shown[..., 0])
    cost = jnp.sum((jnp.nan_to_num(shown) - limb) ** 2, -1) / (2 * DEVIATION**2)
    cost = jnp.where(is_learned, jnp.minimum(cost, LARGEST_COST), 0.0)
    before = is_learned & (body_cost > 0) & (depths[..., None] < body_depth)
    own = jnp.clip(OTHER_COST - cost, 0.0, LARGEST_COLOUR)
    either = jnp.where(before, jnp.clip(body_cost - cost, -LARGEST_COLOUR, own), 0.0)
    faint = jnp.minimum(log_ratios, OCCLUDER)
    alone = jnp.where(log_ratios > 0, jnp.maximum(log_ratios - cost, faint), log_ratios)
    return jnp.where(jnp.isfinite(body_depth), either, alone)


def _on_earlier(points: Array, starts: Array, ways: Array, radii: Array) -> Array:
    """(B, ...) bool: points (B, ..., 2) of each bone that lie on a bone before it, (B, 2) cells."""
    away = points[..., None, :] - starts
    squared = jnp.sum(ways**2, -1) + 1e-6
    along = jnp.sum(away * ways, -1) / squared
    aside = jnp.abs(away[..., 0] * ways[:, 1] - away[..., 1] * ways[:, 0])
    on = (along >= 0) & (along <= 1) & (aside < radii * jnp.sqrt(squared))
    before = jnp.tril(jnp.ones((len(starts),) * 2, bool), -1)
    return jnp.any(on & before[:, None, None], -1)
