"""Doubt: where the images show person that the pose does not explain, and what might.

INPUTS: a pose that was found, and what was segmented. OUTPUTS: a better pose to fit from, if there
is one; what to remember for the next frame.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import ROOT_DOF, Skeleton
from jaxmocap.body.surface import BodyPoints, Surface
from jaxmocap.geometry.cameras import Camera
from jaxmocap.images.coverage import covered
from jaxmocap.images.regions import Region
from jaxmocap.silhouette.hypotheses import (
    Evidence,
    Limb,
    SearchSettings,
    explained,
    limbs_of,
    search,
    seen_at,
)
from jaxmocap.silhouette.looking import Outlines

# Of the surface's nodes one in so many says what the body covers, with so many cells about it.
NODES, AROUND = 4, 4
# A limb is in doubt where person is unexplained within its reach by this share of its own size,
# whose cells are so much likelier person than not; and a better place must explain so much more.
UNEXPLAINED, SURELY, BETTER = 0.15, 1.5, 0.2
# Frames to wait after a search that found nothing, at most; twice as long each time.
LONGEST = 8
_explained = jax.jit(explained)


class Doubts(NamedTuple):
    """What is remembered of the L limbs.

    Attributes:
        particles: of each limb (P, K) angles, or None where there was no doubt.
        waits: frames until each may be searched for again.
        failures: searches of each, one after the other, that found nothing.
        frame: of how many frames; the seed of the pseudo-random numbers.
    """

    particles: tuple[np.ndarray | None, ...]
    waits: tuple[int, ...]
    failures: tuple[int, ...]
    frame: int = 0


class Better(NamedTuple):
    """A pose that explains more.

    Attributes:
        pose: to fit from.
        joints: (D,) bool: those that differ.
        limbs: numbers of those that were moved.
    """

    pose: Pose
    joints: np.ndarray
    limbs: tuple[int, ...]


class Doubter:
    """Looks for limbs of one person.

    Attributes:
        limbs: name -> Limb.
        count: of particles.
    """

    def __init__(self, skeleton: Skeleton, surface: Surface, cameras: Camera, count: int):
        """Prepare for C cameras (stacked); traces once."""
        self.skeleton, self.cameras, self.count = skeleton, cameras, count
        self.limbs = limbs_of(skeleton, surface)
        self._points = BodyPoints(*(np.asarray(part)[::NODES] for part in surface.points))
        shares, bones = np.asarray(self._points.shares), np.asarray(self._points.bones)
        carrier = bones[np.arange(len(bones)), shares.argmax(1)]
        self._on = [np.isin(carrier, limb.bones) for limb in self.limbs.values()]

    def none(self) -> Doubts:
        """Before the first frame."""
        empty, zeros = (None,) * len(self.limbs), (0,) * len(self.limbs)
        return Doubts(empty, zeros, zeros)

    def better(
        self, doubts: Doubts, pose: Pose, seen: Outlines, used: np.ndarray, how: SearchSettings
    ) -> tuple[Better | None, Doubts]:
        """A pose that explains more of what is seen than the one found, if there is one.

        Args:
            doubts: of the frame before.
            pose: that was found.
            seen: what was segmented.
            used: (C,) cameras that count.
            how: of the search.
        """
        pixels = np.asarray(seen_at(self.skeleton, pose, self.cameras, self._points))
        ratios = np.asarray(seen.segmented.log_ratio)
        short = self._short(pose, ratios, pixels, seen.region, used)
        angles, moved = np.array(pose.angles), []
        particles, waits, failures = (list(part) for part in doubts[:3])
        for number, (limb, lack) in enumerate(zip(self.limbs.values(), short, strict=True)):
            waits[number] = max(waits[number] - 1, 0)
            if lack < UNEXPLAINED:
                particles[number], failures[number] = None, 0
                continue
            if waits[number]:
                continue
            old = particles[number]
            if old is None:
                old = np.tile(angles[limb.joints], (self.count, 1))
            key = jax.random.fold_in(jax.random.PRNGKey(doubts.frame), number)
            evidence = self._evidence(number, ratios, pixels, seen.region, used)
            there = pose._replace(angles=jnp.asarray(angles))
            found = search(
                self.skeleton, self.cameras, there, limb, evidence, jnp.asarray(old), key, how
            )
            particles[number] = np.asarray(found.particles)
            if float(found.gain) > float(found.before) + BETTER:
                angles[limb.joints] = np.asarray(found.best)
                moved.append(number)
            else:
                waits[number] = min(2 ** failures[number], LONGEST)
                failures[number] += 1
        after = Doubts(tuple(particles), tuple(waits), tuple(failures), doubts.frame + 1)
        if not moved:
            return None, after
        joints = np.zeros(len(angles), bool)
        joints[np.concatenate([self._limb(number).joints for number in moved])] = True
        return Better(pose._replace(angles=jnp.asarray(angles)), joints, tuple(moved)), after

    def gain(self, limbs: tuple[int, ...], pose: Pose, seen: Outlines, used: np.ndarray) -> float:
        """What some limbs of a pose explain of what is seen, together."""
        pixels = np.asarray(seen_at(self.skeleton, pose, self.cameras, self._points))
        ratios = np.asarray(seen.segmented.log_ratio)
        total = 0.0
        for number in limbs:
            evidence = self._evidence(number, ratios, pixels, seen.region, used)
            limb = self._limb(number)
            total += float(_explained(self.skeleton, self.cameras, pose, limb, evidence))
        return total

    def _limb(self, number: int) -> Limb:
        return list(self.limbs.values())[number]

    def _evidence(
        self, number: int, ratios: np.ndarray, pixels: np.ndarray, region: Region, used: np.ndarray
    ) -> Evidence:
        """What is left for a limb to explain: beside the rest of the body."""
        rest = self._covered(pixels[:, ~self._on[number]], region, ratios.shape[-1])
        return Evidence(np.where(rest, np.float32(0), ratios), region, used)

    def _covered(self, pixels: np.ndarray, region: Region, size: int) -> np.ndarray:
        """(C, S, S) bool, what of the canvases points (C, N, 2) of the body cover."""
        places = (Region(*part) for part in zip(*map(np.asarray, region), strict=True))
        return np.stack(
            [covered(at, place, size, AROUND) for at, place in zip(pixels, places, strict=True)]
        )

    def _short(
        self, pose: Pose, ratios: np.ndarray, pixels: np.ndarray, region: Region, used: np.ndarray
    ) -> np.ndarray:
        """(L,) how much person nothing explains within each limb's reach, by the limb's size."""
        whole = self._covered(pixels, region, ratios.shape[-1])
        left = (ratios > SURELY) & ~whole & np.asarray(used)[:, None, None]
        lengths = np.asarray(self.skeleton.lengths)
        found = []
        for number, limb in enumerate(self.limbs.values()):
            nodes = pixels[:, self._on[number]]
            root, length = nodes.mean(1), 0.0
            area = total = 0.0
            for camera in np.flatnonzero(used):
                scale = float(np.asarray(region.scale)[camera])
                metre = _pixels_to_a_metre(self.cameras, camera, pose) / scale
                at = (root[camera] - np.asarray(region.origin)[camera]) / scale
                rows, columns = np.nonzero(left[camera])
                length = 1.6 * metre * lengths[limb.bones].sum()
                area += np.sum(np.hypot(columns - at[0], rows - at[1]) < length)
                total += np.sum(2 * limb.radii * lengths[limb.bones]) * metre**2
            found.append(area / max(total, 1.0))
        return np.array(found)


def _pixels_to_a_metre(cameras: Camera, camera: int, pose: Pose) -> float:
    """At the pelvis' depth."""
    T = np.asarray(cameras.T_cam_world)[camera]
    depth = T[2, :3] @ np.asarray(pose.position) + T[2, 3]
    return float(np.asarray(cameras.matrix)[camera, 0, 0] / max(depth, 0.3))


def freed(beforehand: np.ndarray, joints: np.ndarray, deviation: float) -> np.ndarray:
    """Deviations (6 + D,) beforehand, those of some joints (D,) no less than another."""
    wide = beforehand.copy()
    wide[ROOT_DOF:][joints] = np.maximum(wide[ROOT_DOF:][joints], deviation)
    return wide
