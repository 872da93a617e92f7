"""Several hypotheses of where a limb is, by a particle filter (second paper, section 5).

A limb that was hidden, or too fast, may be far from where one hypothesis looks for it: its rim
finds the contour of something else, and stays there. Where the images show person that no part of
the body explains, within a limb's reach, its particles are spread, weighed by what they would
explain, drawn anew in proportion (systematic resampling), and so once more with less spread; fits
then start from the best, and from the best elsewhere. Particles live on from frame to frame while
the doubt lasts.

INPUTS: a pose, the log-ratios of person and rest on canvases, what the rest of the body covers.
OUTPUTS: the limb's likeliest angles in some places, what they explain, the particles for the next
frame.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.kinematics import forward
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.body.surface import BodyPoints, Surface, posed
from jaxmocap.geometry.cameras import Camera, project
from jaxmocap.images.regions import Region
from jaxmocap.images.sampling import look_up

# Limb -> its bones from the body outwards, and its joints; as many of each.
LIMBS = {
    "arm": (("humerus", "radius", "hand"),
            ("clavicle_raise", "clavicle_protract", "arm_flex", "arm_abduct", "arm_rot",
             "elbow_flex")),
    "leg": (("femur", "tibia", "foot"),
            ("hip_flexion", "hip_abduction", "hip_rotation", "knee_flexion", "ankle_dorsiflex",
             "ankle_invert")),
}  # fmt: skip
# So many particles are fitted, that differ by so much in their angles' root mean square, radians.
KEPT, APART = 3, 0.5
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


class Limb(NamedTuple):
    """A limb of B bones and K joints.

    Attributes:
        bones: (B,) indices.
        joints: (K,) indices.
        radii: (B,) metres.
    """

    bones: np.ndarray
    joints: np.ndarray
    radii: np.ndarray


class Evidence(NamedTuple):
    """What C cameras show of the person beyond the rest of the body.

    Attributes:
        gains: (C, S, S) log-ratio of person and rest; 0 where the rest of the body is seen.
        region: of the canvases.
        used: (C,) cameras that count.
    """

    gains: Array | np.ndarray
    region: Region
    used: Array | np.ndarray


class Found(NamedTuple):
    """What a search found.

    Attributes:
        particles: (P, K) angles, for the next frame.
        best: (H, K) angles of the best, and of the best that are elsewhere than those before them.
        gains: (H,) what they explain: the mean log-ratio where the limb would be seen.
        before: () the same of the pose given.
    """

    particles: Array
    best: Array
    gains: Array
    before: Array


def limbs_of(skeleton: Skeleton, surface: Surface) -> dict[str, Limb]:
    """``arm_l`` and so on, those that the skeleton's joints move in full."""
    tree, found = skeleton.tree, {}
    for kind, (bones, joints) in LIMBS.items():
        for side in "lr":
            names = [f"{joint}_{side}" for joint in joints]
            if set(names) <= set(tree.joints):
                rows = np.array([tree.bone(f"{bone}_{side}") for bone in bones], np.int32)
                moved = np.array([tree.joint(name) for name in names], np.int32)
                found[f"{kind}_{side}"] = Limb(rows, moved, radii(skeleton, surface, rows))
    return found


def halves_of(limb: Limb) -> tuple[Limb, Limb]:
    """The limb's first bone, and what follows it: what is left out is given no thickness."""
    first = np.arange(len(limb.bones)) < 1
    return tuple(limb._replace(radii=np.where(of, limb.radii, 0)) for of in (first, ~first))  # type: ignore[return-value]


def radii(skeleton: Skeleton, surface: Surface, bones: np.ndarray) -> np.ndarray:
    """(B,) metres from bones to the surface's nodes that they carry alone or most."""
    points = surface.points
    carriers = np.asarray(points.shares).argmax(1)
    rows = np.arange(len(carriers))
    carrier = np.asarray(points.bones)[rows, carriers]
    places = np.asarray(points.points_bone)[rows, carriers]
    ways = np.asarray(skeleton.directions)
    found = []
    for bone in bones:
        at = places[carrier == bone]
        away = np.linalg.norm(np.cross(at, ways[bone]), axis=1)
        found.append(np.median(away) if len(at) else 0.03)
    return np.array(found, np.float32)


@jax.jit
def seen_at(skeleton: Skeleton, pose: Pose, cameras: Camera, points: BodyPoints) -> Array:
    """(C, N, 2) pixels of points of the body, hidden or not."""
    places = posed(forward(skeleton, pose), points)
    return jax.vmap(project, (0, None))(cameras, places)


def explained(
    skeleton: Skeleton, cameras: Camera, pose: Pose, limb: Limb, evidence: Evidence
) -> Array:
    """() mean log-ratio of where the limb would be seen, by its size if it were seen in full."""
    gained, _, full = _summed(skeleton, cameras, pose, limb, evidence)
    return gained / jnp.maximum(full, 1.0)


def likeness(
    skeleton: Skeleton, cameras: Camera, pose: Pose, limb: Limb, evidence: Evidence
) -> Array:
    """() mean log-ratio of where the limb is seen; 0 where no camera looks."""
    gained, seen, _ = _summed(skeleton, cameras, pose, limb, evidence)
    return gained / jnp.maximum(seen, 1.0)


def _summed(
    skeleton: Skeleton, cameras: Camera, pose: Pose, limb: Limb, evidence: Evidence
) -> tuple[Array, Array, Array]:
    """Over the cameras that count: log-ratios of the limb's cells, how many, how many in full."""
    frames = forward(skeleton, pose)
    near = frames.joints_world[limb.bones]
    reach = (skeleton.lengths[:, None] * skeleton.directions)[limb.bones]
    far = near + jnp.sum(frames.R_world_bone[limb.bones] * reach[:, None], -1)
    sums = jax.vmap(_explained, (0, None, None, None, None, 0, 0))(
        cameras, near, far, jnp.asarray(limb.radii), skeleton.lengths[limb.bones],
        jnp.asarray(evidence.gains), Region(*map(jnp.asarray, evidence.region)),
    )  # fmt: skip
    used = jnp.asarray(evidence.used)
    gained, seen, full = (jnp.sum(jnp.where(used, part, 0.0)) for part in sums)
    return gained, seen, full


def _explained(
    camera: Camera, near: Array, far: Array, radii: Array, lengths: Array, gains: Array,
    region: Region,
) -> tuple[Array, Array, Array]:  # fmt: skip
    """Of one camera: the sum of log-ratios over the limb's cells, how many, how many in full."""
    depth = camera.T_cam_world[2, :3] @ near[0] + camera.T_cam_world[2, 3]
    cells = camera.matrix[0, 0] / jnp.maximum(depth, 0.3) / region.scale
    ends = [(project(camera, end) - region.origin) / region.scale - 0.5 for end in (near, far)]
    way = ends[1] - ends[0]
    length = jnp.sqrt(jnp.sum(way**2, -1) + 1e-6)
    aside = jnp.stack([-way[:, 1], way[:, 0]], -1) / length[:, None]
    along, across = (jnp.asarray(part, way.dtype) for part in (ALONG, ACROSS))
    x, y = (
        ends[0][:, None, None, k] + along[:, None] * way[:, None, None, k]
        + across * (cells * radii)[:, None, None] * aside[:, None, None, k]
        for k in (0, 1)
    )  # fmt: skip
    edge = gains.shape[0] - 1.0
    within = (x >= 0) & (x <= edge) & (y >= 0) & (y <= edge)
    # A forearm laid over its upper arm explains nothing more than that does.
    fresh = within & ~_on_earlier(jnp.stack([x, y], -1), ends[0], way, cells * radii)
    there = jnp.where(fresh, look_up(gains[None], jnp.zeros((), jnp.int32), x, y), 0.0)
    width = 2 * cells * radii
    gained = jnp.sum(jnp.mean(there, (1, 2)) * length * width)
    seen = jnp.sum(jnp.mean(fresh.astype(x.dtype), (1, 2)) * length * width)
    return gained, seen, jnp.sum(cells * lengths * width)


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
    return Found(left, angles[best], gains[best], value(here))


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
