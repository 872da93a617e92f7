"""Doubt: which parts of the limbs the images deny, and where the limbs might be instead.

A limb is in doubt where somebody is seen whom no limb explains; and where it explains less than
nothing: before the room, before the rest of the body where that is what is seen, within the rest of
the body. So is found what no outline tells: an arm that one camera hides, and another sees before
the trunk, leaves all silhouettes as they are.

INPUTS: a pose that was found, and what was segmented; what an earlier pass found, if there was one.
OUTPUTS: parts that are not seen where they are thought to be; a better pose to fit from, if there
is one; what to remember.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.kinematics import forward
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import ROOT_DOF, Skeleton
from jaxmocap.body.surfaces.surface import BodyPoints, Surface, posed
from jaxmocap.geometry.cameras import Camera, depth, on_host, pixels_per_metre
from jaxmocap.silhouette.recovery import limb_particle_filter
from jaxmocap.silhouette.recovery.hues import BodyHues, hues_at
from jaxmocap.silhouette.recovery.limb_particle_filter import ALONG, Evidence, Looks, SearchSettings
from jaxmocap.silhouette.recovery.limbs import (
    Limb,
    carriers,
    ends,
    halves_of,
    limbs_of,
    places_along,
)
from jaxmocap.silhouette.recovery.part_appearance import Appearance
from jaxmocap.silhouette.recovery.penetration import Parts, rings
from jaxmocap.silhouette.recovery.projected_body import Onlooker, Sight

# A limb is in doubt where within its reach (by its length) person is unexplained by this share of
# its own size, whose cells are so much likelier person than not; or where it explains less than
# nothing, by so much. It is not seen there if it is, or if it is the first and it explains little.
# And a better place must explain so much more.
REACH, UNEXPLAINED, SURELY, UNLIKE, LITTLE, BETTER = 1.6, 0.08, 1.5, 0.1, 0.2, 0.15
# Half of a limb in the right place is a beginning: the other half's log-ratios count so little.
LENIENT = 0.7
# A part is denied where its cells are likelier not person.
DENIED = 0.0
# Frames to wait after a search that found nothing, at most; twice as long each time. A place that
# is better by this share of what it must be is not nothing.
LONGEST, HOPE = 2, 0.5
# Where an earlier pass found a limb, so many metres away, it must explain so much more.
AWAY, KNOWN = 0.05, 0.08
_explained, _upheld = jax.jit(limb_particle_filter.explained), jax.jit(limb_particle_filter.upheld)
_likenesses = jax.jit(
    jax.vmap(limb_particle_filter.likeness, (None, None, None, Limb(0, None, 0), None))  # type: ignore[arg-type]
)


class Doubts(NamedTuple):
    """What is remembered of the L limbs.

    Attributes:
        particles: of each limb (P, K) angles, or None where there was no doubt.
        waits: (L,) frames until each may be searched for again.
        failures: (L,) searches of each, one after the other, that found nothing.
        appearance: of the near and the far half of each limb.
        known: hues of the body's points.
        denied: (L,) bool: where they were found the last frame showed nothing, or something else.
        frame: of how many frames; the seed of the pseudo-random numbers.
    """

    particles: tuple[np.ndarray | None, ...]
    waits: np.ndarray
    failures: np.ndarray
    appearance: Appearance
    known: BodyHues
    denied: np.ndarray
    frame: int


class Better(NamedTuple):
    """Poses that explain more.

    Attributes:
        poses: to fit from, the likeliest first.
        limbs: numbers of those that were moved.
        least: that they must explain more once they are fitted.
    """

    poses: tuple[Pose, ...]
    limbs: tuple[int, ...]
    least: float = BETTER


class Doubter:
    """Looks after the limbs of one person.

    Attributes:
        names: of the limbs.
        limbs: in that order.
        joints: (2 * L, D) bool: those that move the near and the far half of each limb.
        nodes: (2 * L, N) bool: the onlooker's points on each.
        count: of particles.
        sight: lays a pose over what the cameras show, see ``Onlooker``.
    """

    def __init__(self, skeleton: Skeleton, surface: Surface, cameras: Camera, count: int):
        """Prepare for C cameras (stacked); traces once."""
        self.skeleton, self.cameras, self.count = skeleton, cameras, count
        self._onlooker = Onlooker(skeleton, surface, cameras)
        self.sight = self._onlooker.sight
        found = limbs_of(skeleton, surface)
        self.names, self.limbs = tuple(found), tuple(found.values())
        halves = [half for limb in self.limbs for half in halves_of(limb)]
        self._halves = Limb(*(np.stack(part) for part in zip(*halves, strict=True)))
        bones = [half.bones[half.radii > 0] for half in halves]
        moved = np.array(skeleton.tree.dof_bones)
        carrier = carriers(self._onlooker.points)
        self.joints = np.array([np.isin(moved, each) for each in bones])
        self.nodes = np.array([np.isin(carrier, each) for each in bones])
        self._along = [
            places_along(skeleton, limb, self._onlooker.points, ALONG) for limb in self.limbs
        ]
        self._rings = [rings(surface, name) for name in self.names]
        self._each_camera = [
            on_host(jax.tree.map(lambda part, c=c: part[c], cameras))
            for c in range(len(cameras.size))
        ]
        lengths = np.asarray(skeleton.lengths)
        self._reaches = np.array([REACH * lengths[limb.bones].sum() for limb in self.limbs])
        self._sizes = np.array(
            [2 * (limb.radii * lengths[limb.bones]).sum() for limb in self.limbs]
        )

    def none(self) -> Doubts:
        """Before the first frame."""
        zeros = np.zeros(len(self.limbs), int)
        looks = Appearance.none(2 * len(self.limbs), len(self.cameras.size))
        known = BodyHues.none(self.nodes.shape[1])
        return Doubts((None,) * len(self.limbs), zeros, zeros, looks, known, zeros > 0, 0)

    def covering(self, pose: Pose) -> np.ndarray:
        """(C, N, 2) pixels of points all over the body, hidden or not."""
        return self._onlooker.placed(pose)[0]

    def hidden(
        self,
        doubts: Doubts,
        sight: Sight,
        images: Sequence[np.ndarray | None],
        moved: tuple[int, ...] = (),
    ) -> tuple[np.ndarray, Doubts]:
        """(D,) bool: joints of halves of limbs where the images show something else; what is kept.

        That is no person by the densities, or not the hue that the part had. Nor are limbs seen
        that explain nothing; of those that were ``moved`` since it is asked again.
        """
        evidence = Evidence(sight.ratios, sight.region, sight.used)
        found = _likenesses(self.skeleton, self.cameras, sight.pose, self._halves, evidence)
        shown = [image if used else None for image, used in zip(images, sight.used, strict=True)]
        other, looks = doubts.appearance.judged(shown, sight.pixels, self.nodes)
        denied = doubts.denied.copy()
        depths = self._nearest(sight)
        for number in moved:
            evidence = self._left_for(number, sight, doubts.known, depths)
            denied[number] = self._explains(number, evidence, sight.pose) < LITTLE
        elsewhere = (np.asarray(found) < DENIED) | other | np.repeat(denied, 2)
        # A near half that is not seen does not tell where the far one hangs.
        elsewhere[1::2] |= elsewhere[::2]
        seen = sight.places.seen(depths.min(0))
        # Limbs that may be elsewhere have the hues of something else.
        unsure = np.any(self.nodes[elsewhere], 0)
        known = doubts.known.learned(hues_at(shown, sight.pixels), seen & ~unsure)
        after = doubts._replace(appearance=looks, known=known, denied=denied)
        return np.any(self.joints[elsewhere], 0), after

    def found_earlier(self, doubts: Doubts, sight: Sight, earlier: Pose) -> Better | None:
        """The pose with those limbs that explain more where an earlier pass found them."""
        found, moved, depths = sight.pose, [], None
        for number, limb in enumerate(self.limbs):
            angles = earlier.angles[limb.joints]
            there = _with(sight.pose, limb, angles)
            if float(_apart(self.skeleton, sight.pose, there, limb)) < AWAY:
                continue
            depths = self._nearest(sight) if depths is None else depths
            evidence = self._left_for(number, sight, doubts.known, depths)
            before = self._explains(number, evidence, sight.pose, _upheld)
            if self._explains(number, evidence, there) > before + KNOWN:
                found = _with(found, limb, angles)
                moved.append(number)
        return Better((found,), tuple(moved), KNOWN) if moved else None

    def better(
        self, doubts: Doubts, sight: Sight, how: SearchSettings
    ) -> tuple[Better | None, Doubts]:
        """Poses that explain more of what is seen than the one found, if there are any."""
        missing = self._unexplained(sight)
        depths, known = self._nearest(sight), doubts.known
        evidence = [self._left_for(k, sight, known, depths) for k in range(len(self.limbs))]
        worth = [self._explains(k, each, sight.pose) for k, each in enumerate(evidence)]
        # Where somebody is seen whom nothing explains, a limb that explains little is not there.
        denied = np.array(worth) < np.where(missing < UNEXPLAINED, -UNLIKE, LITTLE)
        doubtful = (missing >= UNEXPLAINED) | denied
        # Where what denied a limb is gone it is looked for once more, and at once.
        back = doubts.denied & ~doubtful
        particles, waits, failures = list(doubts.particles), doubts.waits - 1, +doubts.failures
        poses, moved = [sight.pose], []
        for number, limb in enumerate(self.limbs):
            if not doubtful[number] and not back[number]:
                particles[number], failures[number] = None, 0
                continue
            if waits[number] > 0 and not back[number]:
                continue
            found = self._search(number, evidence[number], doubts, poses[0], how)
            particles[number] = np.asarray(found.particles)
            better = np.asarray(found.gains) > float(found.before) + BETTER
            if better[0]:
                count = max(len(poses), int(better.sum()))
                poses = [
                    _with(poses[min(k, len(poses) - 1)], limb, found.best[k if better[k] else 0])
                    for k in range(count)
                ]
                moved.append(number)
            elif np.max(found.gains) < float(found.before) + HOPE * BETTER:
                waits[number] = min(2 ** failures[number], LONGEST) + 1
                failures[number] += 1
        waits = np.maximum(waits, 0)
        after = doubts._replace(
            particles=tuple(particles),
            waits=waits,
            failures=failures,
            denied=denied,
            frame=doubts.frame + 1,
        )
        return (Better(tuple(poses), tuple(moved)) if moved else None), after

    def _search(
        self, number: int, evidence: Evidence, doubts: Doubts, pose: Pose, how: SearchSettings
    ) -> limb_particle_filter.Found:
        """Of one limb, from the particles of the frame before or from where it is."""
        limb, old = self.limbs[number], doubts.particles[number]
        if old is None:
            old = np.tile(np.asarray(pose.angles)[limb.joints], (self.count, 1))
        key = jax.random.fold_in(jax.random.PRNGKey(doubts.frame), number)
        return limb_particle_filter.search(
            self.skeleton, self.cameras, pose, limb, evidence, jnp.asarray(old), key, how
        )

    def gain(self, limbs: tuple[int, ...], before: Sight, after: Sight, known: BodyHues) -> float:
        """What some limbs explain more, together, in one pose than they did in another."""
        new, old = self._nearest(after), self._nearest(before)
        return sum(
            self._explains(k, self._left_for(k, after, known, new), after.pose)
            - self._explains(k, self._left_for(k, before, known, old), before.pose, _upheld)
            for k in limbs
        )

    def _explains(
        self, number: int, evidence: Evidence, pose: Pose, how: Callable[..., Array] = _explained
    ) -> float:
        """What one limb of a pose explains of what is left for it."""
        return float(how(self.skeleton, self.cameras, pose, self.limbs[number], evidence))

    def joints_of(self, limbs: tuple[int, ...]) -> np.ndarray:
        """(D,) bool: the joints of some limbs."""
        found = np.zeros(self.joints.shape[1], bool)
        for number in limbs:
            found[self.limbs[number].joints] = True
        return found

    def _on(self, number: int) -> np.ndarray:
        """(N,) bool: the points of a limb."""
        return np.any(self.nodes[2 * number : 2 * number + 2], 0)

    def _nearest(self, sight: Sight) -> np.ndarray:
        """(L + 1, C, S, S) metres of each limb, and of the rest of the body; infinite beside it."""
        limbs = [self._on(number) for number in range(len(self.limbs))]
        parts = [*limbs, ~np.any(limbs, 0)]
        return np.stack([sight.places.nearest(part) for part in parts])

    def _left_for(self, number: int, sight: Sight, known: BodyHues, depths: np.ndarray) -> Evidence:
        """What is left for a limb to explain: beside the rest of the body, or before it by hue."""
        rest, places = ~self._on(number), sight.places
        depth = np.delete(depths, number, 0).min(0)
        unlike = places.unlike(sight.hues, known, places.seen(depth) & rest)
        count = len(self.limbs[number].bones)
        hues = known.means(self._along[number], count * len(ALONG))
        looks = Looks(sight.hues, unlike, depth, hues.reshape(count, len(ALONG), 3))
        alone = np.maximum(sight.ratios, np.float32(-LENIENT))
        gains = np.where(np.isfinite(depth), np.float32(0), alone)
        others = _parts(self.skeleton, sight.pose, self._rings[number])
        return Evidence(gains, sight.region, sight.used, looks, others)

    def _unexplained(self, sight: Sight) -> np.ndarray:
        """(L,) how much person nothing explains within each limb's reach, by the limb's size."""
        every = np.ones(sight.pixels.shape[1], bool)
        left = (sight.ratios > SURELY) & ~sight.covered(every)
        area, size = np.zeros((2, len(self.limbs)))
        for camera in np.flatnonzero(sight.used):
            region, metre = sight.regions[camera], self._cells_to_a_metre(camera, sight)
            rows, columns = np.nonzero(left[camera])
            size += self._sizes * metre**2
            if not len(rows):
                continue
            for number in range(len(self.limbs)):
                middle = sight.pixels[camera, self._on(number)].mean(0)
                x, y = (middle - region.origin) / region.scale
                area[number] += np.sum(
                    np.hypot(columns - x, rows - y) < metre * self._reaches[number]
                )
        return area / np.maximum(size, 1.0)

    def _cells_to_a_metre(self, camera: np.intp, sight: Sight) -> float:
        """At the pelvis' depth."""
        of = self._each_camera[camera]
        away = max(depth(of, np.asarray(sight.pose.position)), 0.3)
        return float(pixels_per_metre(of, away) / sight.regions[camera].scale)


@jax.jit
def _apart(skeleton: Skeleton, pose: Pose, other: Pose, limb: Limb) -> Array:
    """() metres between the ends of a limb's bones in two poses, the most."""
    here, there = (ends(skeleton, each, limb)[1] for each in (pose, other))
    return jnp.max(jnp.linalg.norm(here - there, axis=-1))


@jax.jit
def _parts(skeleton: Skeleton, pose: Pose, around: BodyPoints) -> Parts:
    """Parts of a body in a pose."""
    return Parts.of(posed(forward(skeleton, pose), around))


def _with(pose: Pose, limb: Limb, angles: Array | np.ndarray) -> Pose:
    """A pose whose limb has other angles (K,)."""
    return pose._replace(angles=pose.angles.at[limb.joints].set(angles))


def freed(beforehand: np.ndarray, joints: np.ndarray, deviation: float) -> np.ndarray:
    """Deviations (6 + D,) beforehand, those of some joints (D,) no less than another."""
    wide = beforehand.copy()
    wide[ROOT_DOF:][joints] = np.maximum(wide[ROOT_DOF:][joints], deviation)
    return wide
