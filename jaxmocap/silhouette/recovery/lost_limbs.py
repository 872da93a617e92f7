"""Which parts of the limbs the images contradict, and where the limbs might be instead.

A limb is searched for where no limb explains a visible person, and where it explains less than
nothing: before the background, before the rest of the body where that is what is visible, within
the rest of the body. So is found what no outline shows: an arm that one camera hides, and another
sees before the trunk, leaves all silhouettes as they are.

INPUTS: an estimated pose, and what was segmented; what an earlier pass found, if there was one.
OUTPUTS: parts that are hidden where the pose has them; better poses to fit from, if there are any;
what to remember.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.body.surfaces.surface import Surface
from jaxmocap.compilation.programs import program
from jaxmocap.geometry.cameras import Camera
from jaxmocap.silhouette.recovery import limb_likelihood
from jaxmocap.silhouette.recovery.chromaticity import BodyAppearance, chromaticity_at
from jaxmocap.silhouette.recovery.limb_evidence import EvidenceFinder
from jaxmocap.silhouette.recovery.limb_likelihood import LEAST_VISIBLE, LimbEvidence
from jaxmocap.silhouette.recovery.limb_particle_filter import (
    LimbSearchResult,
    search_limb,
)
from jaxmocap.silhouette.recovery.limbs import (
    LimbChain,
    bone_ends,
    halves_of,
    limb_chains,
    with_angles,
)
from jaxmocap.silhouette.recovery.part_appearance import PartAppearance
from jaxmocap.silhouette.recovery.projected_body import BodyProjector, ProjectedBody

# Unexplained person, by the limb's own size, that calls for a search,
UNEXPLAINED_SHARE = 0.08
# also of a limb that explains less than this there; where nothing is unexplained, of one that
# explains less than minus the other.
WEAK, CONTRADICTED = 0.2, 0.1
# Mean log-ratio by which a better place must explain more;
LEAST_GAIN = 0.15
# the same of a place where an earlier pass found the limb, if that is so far away.
EARLIER_GAIN, EARLIER_DISTANCE_M = 0.08, 0.05
# A part whose cells are less likely person than this is hidden.
HIDDEN_LOG_RATIO = 0.0
# Frames after a search that found nothing, at most; twice as long each time.
LONGEST_WAIT = 2
# A place that explains more by this share of ``LEAST_GAIN`` is not nothing.
PROMISING_SHARE = 0.5
_explained = jax.jit(limb_likelihood.explained_log_ratio, static_argnames="least")


@program("full")
def _log_ratios_of_parts(
    skeleton: Skeleton, cameras: Camera, pose: Pose, parts: LimbChain, evidence: LimbEvidence
) -> Array:
    """(2 * L,) mean log-ratios of where parts, halves of limbs, are visible."""

    def one(radii: Array | np.ndarray, bones: Array | np.ndarray) -> Array:
        part = LimbChain(bones, parts.joints, radii)  # type: ignore[arg-type]
        return limb_likelihood.visible_log_ratio(skeleton, cameras, pose, part, evidence)

    return jax.vmap(one)(parts.radii, parts.bones)


class LimbMemory(NamedTuple):
    """What is remembered of the L limbs."""

    # Of each limb (P, K) angles, or None where it was in its place.
    particles: tuple[np.ndarray | None, ...]
    waits: np.ndarray  # (L,) frames until each may be searched for again
    failures: np.ndarray  # (L,) searches of each, one after the other, that found nothing
    part_appearance: PartAppearance  # of the near and the far half of each limb
    appearance: BodyAppearance  # of the body's points
    # (L,) bool: where the last frame showed nothing of them, or something else.
    contradicted: np.ndarray
    frame: int  # number of frames so far; the seed of the pseudo-random numbers


class LimbProposal(NamedTuple):
    """Poses that explain more."""

    poses: tuple[Pose, ...]  # to fit from, the likeliest first
    limbs: tuple[int, ...]  # numbers of those that were moved
    least_gain: float  # mean log-ratio that they must explain more once they are fitted


class LimbRecovery:
    """Recovers the limbs of one person.

    Attributes:
        names: of the limbs.
        limbs: in that order.
        joints: (2 * L, D) bool: those that move the near and the far half of each limb.
        evidence: of each limb, and which points of the body lie on it.
        projector: lays poses over what the cameras show.
    """

    def __init__(self, skeleton: Skeleton, surface: Surface, cameras: Camera, particles: int):
        """Prepare for C cameras (stacked); traces once."""
        self._skeleton, self._cameras, self._particles = skeleton, cameras, particles
        self.projector = BodyProjector(skeleton, surface, cameras)
        chains = limb_chains(skeleton, surface)
        self.names, self.limbs = tuple(chains), tuple(chains.values())
        halves = [half for limb in self.limbs for half in halves_of(limb)]
        self._halves = LimbChain(*(np.stack(part) for part in zip(*halves, strict=True)))
        bones = [half.bones[half.radii > 0] for half in halves]
        moved = np.array(skeleton.tree.dof_bones)
        self.joints = np.array([np.isin(moved, each) for each in bones])
        points = self.projector.points
        self.evidence = EvidenceFinder(skeleton, surface, cameras, chains, points)

    def empty_memory(self) -> LimbMemory:
        """Before the first frame."""
        zeros = np.zeros(len(self.limbs), int)
        parts = PartAppearance.empty(2 * len(self.limbs), len(self._cameras.size))
        body = BodyAppearance.empty(self.evidence.nodes.shape[1])
        return LimbMemory((None,) * len(self.limbs), zeros, zeros, parts, body, zeros > 0, 0)

    def joints_of(self, limbs: tuple[int, ...]) -> np.ndarray:
        """(D,) bool: the joints of some limbs."""
        joints = np.zeros(self.joints.shape[1], bool)
        for number in limbs:
            joints[self.limbs[number].joints] = True
        return joints

    def hidden_joints(
        self,
        memory: LimbMemory,
        projected: ProjectedBody,
        images: Sequence[np.ndarray | None],
        relocated: tuple[int, ...] = (),
    ) -> tuple[np.ndarray, LimbMemory]:
        """(D,) bool: joints of halves of limbs where the images show something else; what is kept.

        That is no person by the densities, or not the colour that the part had. Nor are limbs
        visible that explain nothing; those that were ``relocated`` since are tested again.
        """
        finder = self.evidence
        plain = LimbEvidence(projected.log_ratios, projected.region, projected.used)
        log_ratios = _log_ratios_of_parts(
            self._skeleton, self._cameras, projected.pose, self._halves, plain
        )
        used = zip(images, projected.used, strict=True)
        shown = [image if counts else None for image, counts in used]
        strange, parts = memory.part_appearance.compare(shown, projected.pixels, finder.nodes)
        contradicted = memory.contradicted.copy()
        depths = finder.nearest_depths(projected)
        for number in relocated:
            evidence = finder.of_limb(number, projected, memory.appearance, depths)
            contradicted[number] = self._explains(number, evidence, projected.pose) < WEAK
        hidden = (np.asarray(log_ratios) < HIDDEN_LOG_RATIO) | strange
        hidden = hidden | np.repeat(contradicted, 2)
        # A near half that is hidden does not determine where the far one hangs.
        hidden[1::2] |= hidden[::2]
        visible = projected.cells.visible(depths.min(0))
        # Limbs that may be elsewhere have the colours of something else.
        unsure = np.any(finder.nodes[hidden], 0)
        colours = chromaticity_at(shown, projected.pixels)
        appearance = memory.appearance.update(colours, visible & ~unsure)
        after = memory._replace(
            part_appearance=parts, appearance=appearance, contradicted=contradicted
        )
        return np.any(self.joints[hidden], 0), after

    def earlier_proposal(
        self, memory: LimbMemory, projected: ProjectedBody, earlier: Pose
    ) -> LimbProposal | None:
        """The pose with those limbs that explain more where an earlier pass found them."""
        pose, moved, depths = projected.pose, [], None
        for number, limb in enumerate(self.limbs):
            angles = earlier.angles[limb.joints]
            away = _distance(self._skeleton, projected.pose, limb, angles)
            if float(away) < EARLIER_DISTANCE_M:
                continue
            there = with_angles(projected.pose, limb, angles)
            depths = self.evidence.nearest_depths(projected) if depths is None else depths
            evidence = self.evidence.of_limb(number, projected, memory.appearance, depths)
            before = self._explains(number, evidence, projected.pose, LEAST_VISIBLE)
            if self._explains(number, evidence, there) > before + EARLIER_GAIN:
                pose = with_angles(pose, limb, angles)
                moved.append(number)
        return LimbProposal((pose,), tuple(moved), EARLIER_GAIN) if moved else None

    def propose(
        self, memory: LimbMemory, projected: ProjectedBody
    ) -> tuple[LimbProposal | None, LimbMemory]:
        """Poses that explain more of the image than the present one, if there are any."""
        finder, pose = self.evidence, projected.pose
        missing, depths = finder.unexplained_areas(projected), finder.nearest_depths(projected)
        evidence = [
            finder.of_limb(number, projected, memory.appearance, depths)
            for number in range(len(self.limbs))
        ]
        explained = np.array([self._explains(k, each, pose) for k, each in enumerate(evidence)])
        # Where nothing explains a visible person, a limb that explains little is not there.
        is_missing = missing >= UNEXPLAINED_SHARE
        contradicted = explained < np.where(is_missing, WEAK, -CONTRADICTED)
        doubtful = is_missing | contradicted
        # Where what contradicted a limb is gone it is searched for once more, and at once.
        back = memory.contradicted & ~doubtful
        particles, poses, moved = list(memory.particles), [pose], []
        waits, failures = memory.waits - 1, +memory.failures
        for number, limb in enumerate(self.limbs):
            if not doubtful[number] and not back[number]:
                particles[number], failures[number] = None, 0
            elif waits[number] <= 0 or back[number]:
                result = self._search(number, evidence[number], memory, poses[0])
                particles[number], baseline = np.asarray(result.particles), float(result.baseline)
                better = np.asarray(result.gains) > baseline + LEAST_GAIN
                if better[0]:
                    count = max(len(poses), int(better.sum()))
                    poses += poses[-1:] * (count - len(poses))
                    poses = [
                        with_angles(each, limb, result.best[k if better[k] else 0])
                        for k, each in enumerate(poses)
                    ]
                    moved.append(number)
                elif np.max(result.gains) < baseline + PROMISING_SHARE * LEAST_GAIN:
                    waits[number] = min(2 ** failures[number], LONGEST_WAIT) + 1
                    failures[number] += 1
        proposal = LimbProposal(tuple(poses), tuple(moved), LEAST_GAIN) if moved else None
        return proposal, memory._replace(
            particles=tuple(particles),
            waits=np.maximum(waits, 0),
            failures=failures,
            contradicted=contradicted,
            frame=memory.frame + 1,
        )

    def _search(
        self, number: int, evidence: LimbEvidence, memory: LimbMemory, pose: Pose
    ) -> LimbSearchResult:
        """Of one limb, from the particles of the frame before or from where it is."""
        limb, old = self.limbs[number], memory.particles[number]
        if old is None:
            old = np.tile(np.asarray(pose.angles)[limb.joints], (self._particles, 1))
        key = jax.random.fold_in(jax.random.PRNGKey(memory.frame), number)
        body = self._skeleton, self._cameras
        return search_limb(*body, pose, limb, evidence, jnp.asarray(old), key)

    def gain(
        self,
        limbs: tuple[int, ...],
        before: ProjectedBody,
        after: ProjectedBody,
        appearance: BodyAppearance,
    ) -> float:
        """What some limbs explain more, together, in one pose than they did in another."""
        finder = self.evidence
        new, old = finder.nearest_depths(after), finder.nearest_depths(before)

        def one(number: int) -> float:
            there = finder.of_limb(number, after, appearance, new)
            here = finder.of_limb(number, before, appearance, old)
            baseline = self._explains(number, here, before.pose, LEAST_VISIBLE)
            return self._explains(number, there, after.pose) - baseline

        return sum(one(number) for number in limbs)

    def _explains(
        self, number: int, evidence: LimbEvidence, pose: Pose, least: float = -np.inf
    ) -> float:
        """What one limb of a pose explains of what is left for it; see ``explained_log_ratio``."""
        body, limb = (self._skeleton, self._cameras), self.limbs[number]
        return float(_explained(*body, pose, limb, evidence, least=least))


@program("full")
def _distance(skeleton: Skeleton, pose: Pose, limb: LimbChain, angles: Array) -> Array:
    """() metres by which other angles (K,) move the ends of a limb's bones, the most."""
    poses = pose, with_angles(pose, limb, angles)
    here, there = (bone_ends(skeleton, each, limb)[1] for each in poses)
    return jnp.max(jnp.linalg.norm(here - there, axis=-1))
