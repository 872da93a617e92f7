"""Doubt: which parts of the limbs the images deny, and where the limbs might be instead.

INPUTS: a pose that was found, and what was segmented. OUTPUTS: parts that are not seen where they
are thought to be; a better pose to fit from, if there is one; what to remember.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import ROOT_DOF, Skeleton
from jaxmocap.body.surface import BodyPoints, Surface
from jaxmocap.geometry.cameras import Camera
from jaxmocap.images.background import Background
from jaxmocap.images.coverage import covered, widened
from jaxmocap.images.regions import Region
from jaxmocap.silhouette import hypotheses
from jaxmocap.silhouette.appearance import Appearance
from jaxmocap.silhouette.hypotheses import Evidence, Limb, SearchSettings
from jaxmocap.silhouette.looking import Outlines

# Of the surface's nodes one in so many says what the body covers, with so many cells about it.
NODES, AROUND = 8, 1
# The canvas that limbs are looked for on: cells, and how many times as wide as the segmentation's.
CELLS, WIDER = 96, 1.5
# A limb is in doubt where within its reach (by its length) person is unexplained by this share of
# its own size, whose cells are so much likelier person than not; and a better place must explain so
# much more.
REACH, UNEXPLAINED, SURELY, BETTER = 1.6, 0.08, 1.5, 0.15
# Log-ratio of what surely is no room, beyond the segmentation.
MOST = 2.0
# Half of a limb in the right place is a beginning: the other half's log-ratios count so little.
LENIENT = 0.7
# A part is denied where its cells are likelier not person.
DENIED = 0.0
# Frames to wait after a search that found nothing, at most; twice as long each time.
LONGEST = 2
_explained = jax.jit(hypotheses.explained)
_likenesses = jax.jit(
    jax.vmap(hypotheses.likeness, (None, None, None, Limb(0, None, 0), None))  # type: ignore[arg-type]
)


class Doubts(NamedTuple):
    """What is remembered of the L limbs.

    Attributes:
        particles: of each limb (P, K) angles, or None where there was no doubt.
        waits: (L,) frames until each may be searched for again.
        failures: (L,) searches of each, one after the other, that found nothing.
        appearance: of the near and the far half of each limb.
        frame: of how many frames; the seed of the pseudo-random numbers.
    """

    particles: tuple[np.ndarray | None, ...]
    waits: np.ndarray
    failures: np.ndarray
    appearance: Appearance
    frame: int


class Better(NamedTuple):
    """Poses that explain more.

    Attributes:
        poses: to fit from, the likeliest first.
        limbs: numbers of those that were moved.
    """

    poses: tuple[Pose, ...]
    limbs: tuple[int, ...]


class Sight(NamedTuple):
    """A pose and what the cameras show, laid over each other.

    Attributes:
        pose: that was found.
        pixels: (C, N, 2) of the body's points.
        ratios: (C, S, S) log-ratios of person and rest.
        regions: of each camera's canvas.
        region: the same as one.
        used: (C,) bool.
    """

    pose: Pose
    pixels: np.ndarray
    ratios: np.ndarray
    regions: tuple[Region, ...]
    region: Region
    used: np.ndarray


class Doubter:
    """Looks after the limbs of one person.

    Attributes:
        names: of the limbs.
        limbs: in that order.
        joints: (2 * L, D) bool: those that move the near and the far half of each limb.
        nodes: (2 * L, M) bool: the surface's nodes on each.
        count: of particles.
    """

    def __init__(self, skeleton: Skeleton, surface: Surface, cameras: Camera, count: int):
        """Prepare for C cameras (stacked); traces once."""
        self.skeleton, self.cameras, self.count = skeleton, cameras, count
        found = hypotheses.limbs_of(skeleton, surface)
        self.names, self.limbs = tuple(found), tuple(found.values())
        halves = [half for limb in self.limbs for half in hypotheses.halves_of(limb)]
        self._halves = Limb(*(np.stack(part) for part in zip(*halves, strict=True)))
        bones = [half.bones[half.radii > 0] for half in halves]
        moved = np.array(skeleton.tree.dof_bones)
        carrier = carriers(surface.points)
        self.joints = np.array([np.isin(moved, each) for each in bones])
        self.nodes = np.array([np.isin(carrier, each) for each in bones])
        self._points = BodyPoints(*(np.asarray(part)[::NODES] for part in surface.points))
        self._depths = np.asarray(cameras.T_cam_world)[:, 2]
        self._focals = np.asarray(cameras.matrix)[:, 0, 0]
        lengths = np.asarray(skeleton.lengths)
        self._reaches = np.array([REACH * lengths[limb.bones].sum() for limb in self.limbs])
        self._sizes = np.array(
            [2 * (limb.radii * lengths[limb.bones]).sum() for limb in self.limbs]
        )

    def none(self) -> Doubts:
        """Before the first frame."""
        zeros = np.zeros(len(self.limbs), int)
        looks = Appearance.none(2 * len(self.limbs), len(self.cameras.size))
        return Doubts((None,) * len(self.limbs), zeros, zeros, looks, 0)

    def sight(
        self,
        pose: Pose,
        seen: Outlines,
        used: np.ndarray,
        images: Sequence[np.ndarray | None],
        rooms: Sequence[Background | None],
    ) -> Sight:
        """A pose over what was segmented, and what lies about that, of cameras (C,) that count."""
        narrow = zip(*map(np.asarray, seen.region), strict=True)
        ratios = np.asarray(seen.segmented.log_ratio)
        parts = [
            widened(ratio, Region(*region), image, room, CELLS, WIDER, MOST)
            for ratio, region, image, room in zip(ratios, narrow, images, rooms, strict=True)
        ]
        regions = tuple(region for _, region in parts)
        region = Region(*(np.stack(part) for part in zip(*regions, strict=True)))
        ratios = np.stack([ratio for ratio, _ in parts])
        return Sight(pose, self.covering(pose), ratios, regions, region, used)

    def covering(self, pose: Pose) -> np.ndarray:
        """(C, N, 2) pixels of points all over the body, hidden or not."""
        return np.asarray(hypotheses.seen_at(self.skeleton, pose, self.cameras, self._points))

    def hidden(
        self, doubts: Doubts, sight: Sight, images: Sequence[np.ndarray | None]
    ) -> tuple[np.ndarray, Doubts]:
        """(D,) bool: joints of halves of limbs where the images show something else; what is kept.

        That is no person by the densities, or not the hue that the part had.
        """
        evidence = Evidence(sight.ratios, sight.region, sight.used)
        found = _likenesses(self.skeleton, self.cameras, sight.pose, self._halves, evidence)
        shown = [image if used else None for image, used in zip(images, sight.used, strict=True)]
        parts = self.nodes[:, ::NODES]
        other, looks = doubts.appearance.judged(shown, sight.pixels, parts)
        elsewhere = (np.asarray(found) < DENIED) | other
        return np.any(self.joints[elsewhere], 0), doubts._replace(appearance=looks)

    def better(
        self, doubts: Doubts, sight: Sight, how: SearchSettings
    ) -> tuple[Better | None, Doubts]:
        """Poses that explain more of what is seen than the one found, if there are any."""
        missing = self._unexplained(sight)
        particles, waits, failures = list(doubts.particles), doubts.waits - 1, +doubts.failures
        poses, moved = [sight.pose], []
        for number, limb in enumerate(self.limbs):
            if missing[number] < UNEXPLAINED:
                particles[number], failures[number] = None, 0
                continue
            if waits[number] > 0:
                continue
            found = self._search(number, particles[number], poses[0], sight, doubts.frame, how)
            particles[number] = np.asarray(found.particles)
            better = np.asarray(found.gains) > float(found.before) + BETTER
            if better[0]:
                count = max(len(poses), int(better.sum()))
                poses = [
                    _with(poses[min(k, len(poses) - 1)], limb, found.best[k if better[k] else 0])
                    for k in range(count)
                ]
                moved.append(number)
            else:
                waits[number] = min(2 ** failures[number], LONGEST) + 1
                failures[number] += 1
        waits = np.maximum(waits, 0)
        after = Doubts(tuple(particles), waits, failures, doubts.appearance, doubts.frame + 1)
        return (Better(tuple(poses), tuple(moved)) if moved else None), after

    def _search(
        self,
        number: int,
        old: np.ndarray | None,
        pose: Pose,
        sight: Sight,
        frame: int,
        how: SearchSettings,
    ) -> hypotheses.Found:
        """Of one limb, from the particles of the frame before or from where it is."""
        limb = self.limbs[number]
        if old is None:
            old = np.tile(np.asarray(pose.angles)[limb.joints], (self.count, 1))
        key = jax.random.fold_in(jax.random.PRNGKey(frame), number)
        evidence = self._left_for(number, sight)
        return hypotheses.search(
            self.skeleton, self.cameras, pose, limb, evidence, jnp.asarray(old), key, how
        )

    def gain(self, limbs: tuple[int, ...], sight: Sight) -> float:
        """What some limbs of a pose explain of what is seen, together."""
        return sum(
            float(
                _explained(
                    self.skeleton, self.cameras, sight.pose, self.limbs[number],
                    self._left_for(number, sight),
                )
            )
            for number in limbs
        )  # fmt: skip

    def joints_of(self, limbs: tuple[int, ...]) -> np.ndarray:
        """(D,) bool: the joints of some limbs."""
        found = np.zeros(self.joints.shape[1], bool)
        for number in limbs:
            found[self.limbs[number].joints] = True
        return found

    def _on(self, number: int) -> np.ndarray:
        """(N,) bool: the points of a limb."""
        return np.any(self.nodes[2 * number : 2 * number + 2, ::NODES], 0)

    def _left_for(self, number: int, sight: Sight) -> Evidence:
        """What is left for a limb to explain: beside the rest of the body."""
        rest = _covered(sight, ~self._on(number))
        gains = np.where(rest, np.float32(0), np.maximum(sight.ratios, np.float32(-LENIENT)))
        return Evidence(gains, sight.region, sight.used)

    def _unexplained(self, sight: Sight) -> np.ndarray:
        """(L,) how much person nothing explains within each limb's reach, by the limb's size."""
        every = np.ones(sight.pixels.shape[1], bool)
        left = (sight.ratios > SURELY) & ~_covered(sight, every)
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
        ahead = self._depths[camera]
        depth = ahead[:3] @ np.asarray(sight.pose.position) + ahead[3]
        return float(self._focals[camera] / max(depth, 0.3) / sight.regions[camera].scale)


def _with(pose: Pose, limb: Limb, angles: jax.Array) -> Pose:
    """A pose whose limb has other angles (K,)."""
    return pose._replace(angles=pose.angles.at[limb.joints].set(angles))


def _covered(sight: Sight, points: np.ndarray) -> np.ndarray:
    """(C, S, S) bool, what of the canvases some points (N,) bool of the body cover."""
    size = sight.ratios.shape[-1]
    return np.stack(
        [
            covered(at[points], region, size, AROUND)
            for at, region in zip(sight.pixels, sight.regions, strict=True)
        ]
    )


def carriers(points: BodyPoints) -> np.ndarray:
    """(N,) the bone that carries most of each point."""
    bones, shares = np.asarray(points.bones), np.asarray(points.shares)
    return bones[np.arange(len(bones)), shares.argmax(1)]


def freed(beforehand: np.ndarray, joints: np.ndarray, deviation: float) -> np.ndarray:
    """Deviations (6 + D,) beforehand, those of some joints (D,) no less than another."""
    wide = beforehand.copy()
    wide[ROOT_DOF:][joints] = np.maximum(wide[ROOT_DOF:][joints], deviation)
    return wide
