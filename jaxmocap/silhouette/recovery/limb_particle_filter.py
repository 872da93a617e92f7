"""Several hypotheses of where a limb is, by a particle filter (second paper, section 5).

A limb that was hidden, or too fast, may be far from where one hypothesis looks for it: its rim
finds the contour of something else, and stays there. Where the images show person that no part of
the body explains, within a limb's reach, its particles are spread, weighed by what they would
explain, drawn anew in proportion (systematic resampling), and so once more with less spread; fits
then start from the best, and from the best elsewhere. Particles live on from frame to frame while
the doubt lasts.

Where a limb is before the rest of the body its hues tell, and nowhere can it be within the rest.

INPUTS: a pose, the log-ratios of person and rest on canvases, what the rest of the body covers and
which hues it has.
OUTPUTS: the limb's likeliest angles in some places, what they explain, the particles for the next
frame.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.geometry.cameras import Camera, depth, pixels_per_metre, project
from jaxmocap.images.regions import Region
from jaxmocap.images.sampling import look_up
from jaxmocap.silhouette.recovery.hues import FARTHEST, SPREAD
from jaxmocap.silhouette.recovery.limbs import Limb, ends
from jaxmocap.silhouette.recovery.penetration import Parts, within

# So many particles are fitted, that differ by so much in their angles' root mean square, radians.
KEPT, APART = 3, 0.5
# Log-ratio of what surely has the limb's hue and not that of the rest of the body.
HUE = 2.5
# Half the squared deviations from the limb's hue beyond which any hue is likelier: about the log
# of a hue's density at its mean, SPREAD about it, by one that is the same everywhere.
THIRD = 4.0
# Log-ratio of what is neither room nor body, nor has the limb's hue: the limb may be behind it.
HIDES = 0.1
# What it costs to lie wholly within other parts of the body, as a log-ratio.
IMPOSSIBLE = 1.0
# However little is shown of a limb, another place must show more than by this.
FAINT = -0.05
# Where a bone is looked at: along it, and across it in its radii.
ALONG, ACROSS = np.linspace(0.06, 0.94, 8), np.array([-0.6, 0.0, 0.6])


class SearchSettings(NamedTuple):
    """Numbers of the filter; traced.

    Attributes:
        anywhere: share of the particles that are drawn from all of the joints' ranges.
        spreads: deviations of the others about those before, layer by layer, radians.
        coldness: by what a log-ratio counts in the weights, layer by layer.
        usual: deviation of an angle about the pose given: of two that explain alike, the nearer.
    """

    anywhere: Array | float = 0.35
    spreads: Array | tuple[float, ...] = (0.5, 0.25, 0.1)
    coldness: Array | tuple[float, ...] = (4.0, 10.0, 25.0)
    usual: Array | float = 2.0


class Looks(NamedTuple):
    """What hues C cameras show, to a limb of B bones with A places on each.

    Attributes:
        hues: (C, S, S, 3) that are seen; NaN where there are none.
        rest: (C, S, S) half their squared deviations from those of the rest of the body; 0 where
            nothing is known.
        depth: (C, S, S) metres, of the rest of the body; infinite beside it.
        limb: (B, A, 3) hues of the limb; -1 where not known.
    """

    hues: Array | np.ndarray
    rest: Array | np.ndarray
    depth: Array | np.ndarray
    limb: Array | np.ndarray


class Evidence(NamedTuple):
    """What C cameras show of the person beyond the rest of the body.

    Attributes:
        gains: (C, S, S) log-ratio of person and rest; 0 where the rest of the body is seen.
        region: of the canvases.
        used: (C,) cameras that count.
        looks: hues; None where nothing is known of them.
        others: parts of the body that the limb cannot be in; None for none.
    """

    gains: Array | np.ndarray
    region: Region
    used: Array | np.ndarray
    looks: Looks | None = None
    others: Parts | None = None


class Found(NamedTuple):
    """What a search found.

    Attributes:
        particles: (P, K) angles, for the next frame.
        best: (H, K) angles of the best, and of the best that are elsewhere than those before them.
        gains: (H,) what they explain: the mean log-ratio where the limb would be seen.
        before: () what they must explain more than, see ``upheld``.
    """

    particles: Array
    best: Array
    gains: Array
    before: Array


def explained(
    skeleton: Skeleton, cameras: Camera, pose: Pose, limb: Limb, evidence: Evidence
) -> Array:
    """() mean log-ratio of where the limb would be seen, by its size if it were seen in full.

    Less what of it lies within other parts of the body.
    """
    shown, cost = _judged(skeleton, cameras, pose, limb, evidence)
    return shown - cost


def upheld(
    skeleton: Skeleton, cameras: Camera, pose: Pose, limb: Limb, evidence: Evidence
) -> Array:
    """() what another place must explain more than: ``explained``, but ``FAINT`` at least is shown.

    What denies a limb may be a thing before it, or be the limb itself, learned as room. Else it
    were better off wherever nothing is seen of it.
    """
    shown, cost = _judged(skeleton, cameras, pose, limb, evidence)
    return jnp.maximum(shown, FAINT) - cost


def _judged(
    skeleton: Skeleton, cameras: Camera, pose: Pose, limb: Limb, evidence: Evidence
) -> tuple[Array, Array]:
    """What images show of a limb, and what it costs that it lies within other parts."""
    near, far = ends(skeleton, pose, limb)
    gained, _, full = _summed(skeleton, cameras, near, far, limb, evidence)
    cost = jnp.zeros_like(gained)
    if evidence.others is not None:
        cost = IMPOSSIBLE * within(near, far, jnp.asarray(limb.radii), evidence.others)
    return gained / jnp.maximum(full, 1.0), cost


def likeness(
    skeleton: Skeleton, cameras: Camera, pose: Pose, limb: Limb, evidence: Evidence
) -> Array:
    """() mean log-ratio of where the limb is seen; 0 where no camera looks."""
    gained, seen, _ = _summed(skeleton, cameras, *ends(skeleton, pose, limb), limb, evidence)
    return gained / jnp.maximum(seen, 1.0)


def _summed(
    skeleton: Skeleton, cameras: Camera, near: Array, far: Array, limb: Limb, evidence: Evidence
) -> tuple[Array, Array, Array]:
    """Over the cameras that count: log-ratios of the limb's cells, how many, how many in full."""
    gains, radii = jnp.asarray(evidence.gains), jnp.asarray(limb.radii)
    region, looks = jax.tree.map(jnp.asarray, (evidence.region, evidence.looks))
    each = None if looks is None else Looks(0, 0, 0, None)  # type: ignore[arg-type]
    sums = jax.vmap(_explained, (0, None, None, None, None, 0, 0, each))(
        cameras, near, far, radii, skeleton.lengths[limb.bones], gains, region, looks
    )
    used = jnp.asarray(evidence.used)
    gained, seen, full = (jnp.sum(jnp.where(used, part, 0.0)) for part in sums)
    return gained, seen, full


def _explained(
    camera: Camera, near: Array, far: Array, radii: Array, lengths: Array, gains: Array,
    region: Region, looks: Looks | None,
) -> tuple[Array, Array, Array]:  # fmt: skip
    """Of one camera: the sum of log-ratios over the limb's cells, how many, how many in full."""
    depths = depth(camera, near), depth(camera, far)
    cells = pixels_per_metre(camera, jnp.maximum(depths[0][0], 0.3)) / region.scale
    starts, stops = ((project(camera, end) - region.origin) / region.scale - 0.5
                     for end in (near, far))  # fmt: skip
    way = stops - starts
    length = jnp.sqrt(jnp.sum(way**2, -1) + 1e-6)
    aside = jnp.stack([-way[:, 1], way[:, 0]], -1) / length[:, None]
    along, across = (jnp.asarray(part, way.dtype) for part in (ALONG, ACROSS))
    x, y = (
        starts[:, None, None, k] + along[:, None] * way[:, None, None, k]
        + across * (cells * radii)[:, None, None] * aside[:, None, None, k]
        for k in (0, 1)
    )  # fmt: skip
    edge = gains.shape[0] - 1.0
    on_canvas = (x >= 0) & (x <= edge) & (y >= 0) & (y <= edge)
    # A forearm laid over its upper arm explains nothing more than that does.
    fresh = on_canvas & ~_on_earlier(jnp.stack([x, y], -1), starts, way, cells * radii)
    there = look_up(gains[None], jnp.zeros((), jnp.int32), x, y)
    if looks is not None:
        deep = depths[0][:, None] + along * (depths[1] - depths[0])[:, None] - radii[:, None] / 2
        there = _by_hue(there, x, y, deep, looks)
    there = jnp.where(fresh, there, 0.0)
    width = 2 * cells * radii
    gained = jnp.sum(jnp.mean(there, (1, 2)) * length * width)
    seen = jnp.sum(jnp.mean(fresh.astype(x.dtype), (1, 2)) * length * width)
    return gained, seen, jnp.sum(cells * lengths * width)


def _by_hue(gains: Array, x: Array, y: Array, depths: Array, looks: Looks) -> Array:
    """Log-ratios (B, A, W) of cells, by their hues too, for a limb whose places (B, A) lie so deep.

    Before the rest of the body the hue tells that from the limb. What has another hue than the limb
    is a third thing: no sign of the limb there, and a faint one beside the body, as it may hide it.
    """
    edge = looks.depth.shape[0] - 1
    row, column = (jnp.clip(jnp.rint(part), 0, edge).astype(jnp.int32) for part in (y, x))
    # One look-up of all is faster than one of each.
    whole = jnp.concatenate([looks.hues, looks.rest[..., None], looks.depth[..., None]], -1)
    there = whole[row, column]
    hue, rest, behind = there[..., :3], there[..., 3], there[..., 4]
    limb = looks.limb[:, :, None]
    told = (limb[..., 0] >= 0) & jnp.isfinite(hue[..., 0])
    off = jnp.sum((jnp.nan_to_num(hue) - limb) ** 2, -1) / (2 * SPREAD**2)
    off = jnp.where(told, jnp.minimum(off, FARTHEST), 0.0)
    before = told & (rest > 0) & (depths[..., None] < behind)
    own = jnp.clip(THIRD - off, 0.0, HUE)
    either = jnp.where(before, jnp.clip(rest - off, -HUE, own), 0.0)
    alone = jnp.where(gains > 0, jnp.maximum(gains - off, jnp.minimum(gains, HIDES)), gains)
    return jnp.where(jnp.isfinite(behind), either, alone)


def _on_earlier(points: Array, starts: Array, ways: Array, radii: Array) -> Array:
    """(B, ...) bool: points (B, ..., 2) of each bone that lie on a bone before it, (B, 2) cells."""
    away = points[..., None, :] - starts
    squared = jnp.sum(ways**2, -1) + 1e-6
    along = jnp.sum(away * ways, -1) / squared
    aside = jnp.abs(away[..., 0] * ways[:, 1] - away[..., 1] * ways[:, 0])
    on = (along >= 0) & (along <= 1) & (aside < radii * jnp.sqrt(squared))
    before = jnp.tril(jnp.ones((len(starts),) * 2, bool), -1)
    return jnp.any(on & before[:, None, None], -1)


@jax.jit
def search(
    skeleton: Skeleton,
    cameras: Camera,
    pose: Pose,
    limb: Limb,
    evidence: Evidence,
    particles: Array,
    key: Array,
    settings: SearchSettings,
) -> Found:
    """Search a limb's angles.

    Args:
        skeleton: of the person.
        cameras: C, stacked.
        pose: as it was found, one hypothesis.
        limb: that may be elsewhere.
        evidence: what is to be explained.
        particles: (P, K) angles of the frame before; the pose's own where there was no doubt.
        key: of the pseudo-random numbers: the same gives the same.
        settings: traced.
    """
    low, high = skeleton.limits[limb.joints].T
    here = pose.angles[limb.joints]

    def value(angles: Array) -> Array:
        there = pose._replace(angles=pose.angles.at[limb.joints].set(angles))
        return explained(skeleton, cameras, there, limb, evidence)

    def weighed(angles: Array) -> tuple[Array, Array]:
        gains = jax.vmap(value)(angles)
        away = jnp.mean((angles - here) ** 2, -1) / settings.usual**2
        return gains, gains - away / 2

    def layer(carry: tuple[Array, Array], numbers: tuple) -> tuple[tuple[Array, Array], tuple]:
        old, mixing = carry
        key, spread, cold = numbers
        fresh, moving, choosing, drawing = jax.random.split(key, 4)
        moved = old + spread * jax.random.normal(moving, old.shape, old.dtype)
        anywhere = low + (high - low) * jax.random.uniform(fresh, old.shape, old.dtype)
        chosen = jax.random.uniform(choosing, (len(old), 1), old.dtype) < mixing
        angles = jnp.clip(jnp.where(chosen, anywhere, moved), low, high)
        gains, worth = weighed(angles)
        weights = jax.nn.softmax(cold * worth)
        kept = angles[systematic(drawing, weights)]
        return (kept, jnp.zeros_like(mixing)), (angles, gains, worth)

    spreads, coldness = (jnp.asarray(part, particles.dtype) for part in settings[1:3])
    keys = jax.random.split(key, len(spreads))
    mixing = jnp.asarray(settings.anywhere, particles.dtype)
    (left, _), (angles, gains, worth) = jax.lax.scan(
        layer, (particles, mixing), (keys, spreads, coldness)
    )
    angles, gains, worth = (jnp.concatenate(part) for part in (angles, gains, worth))
    best = distinct(angles, worth)
    before = upheld(skeleton, cameras, pose, limb, evidence)
    return Found(left, angles[best], gains[best], before)


def distinct(angles: Array, worth: Array) -> Array:
    """(H,) indices of the worthiest of particles (N, K), each ``APART`` from those before it."""
    chosen = []
    for _ in range(KEPT):
        chosen.append(jnp.argmax(worth))
        away = jnp.sqrt(jnp.mean((angles - angles[chosen[-1]]) ** 2, -1))
        worth = jnp.where(away < APART, -jnp.inf, worth)
    return jnp.stack(chosen)


def systematic(key: Array, weights: Array) -> Array:
    """(P,) indices drawn in proportion to weights (P,) that add up to 1: one number for all.

    Each is drawn as often as its weight times P says, rounded up or down.
    """
    count = len(weights)
    start = jax.random.uniform(key, (), weights.dtype)
    places = (jnp.arange(count, dtype=weights.dtype) + start) / count
    return jnp.minimum(jnp.searchsorted(jnp.cumsum(weights), places), count - 1)
