"""What is left for a limb to explain once the rest of the body is laid over the images.

INPUTS: a ProjectedBody, the body's appearance. OUTPUTS: LimbEvidence; unexplained person.
"""

import jax
import numpy as np

from jaxmocap.body.kinematics import forward
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.body.surfaces.surface import BodyPoints, Surface, pose_points
from jaxmocap.compilation.programs import program
from jaxmocap.geometry.cameras import Camera, depth, on_host, pixels_per_metre
from jaxmocap.silhouette.recovery.chromaticity import BodyAppearance
from jaxmocap.silhouette.recovery.limb_likelihood import (
    ALONG_BONE,
    NEAREST_M,
    LimbAppearance,
    LimbEvidence,
    Obstacles,
    obstacle_rings,
)
from jaxmocap.silhouette.recovery.limbs import LimbChain, bins_along, carrying_bones, halves_of
from jaxmocap.silhouette.recovery.projected_body import ProjectedBody

# Person without a body counts within a limb's length times this,
REACH = 1.6
# by cells that are so much likelier person than not.
PERSON_LOG_RATIO = 1.5
# Log-ratios are no less than minus this: half of a limb in the right place is a beginning.
WEAKEST_REST = 0.7


class EvidenceFinder:
    """Finds what is left for each of L limbs of one person.

    Attributes:
        nodes: (2 * L, N) bool: the body's points on the near and the far half of each limb.
    """

    def __init__(
        self,
        skeleton: Skeleton,
        surface: Surface,
        cameras: Camera,
        limbs: dict[str, LimbChain],
        points: BodyPoints,
    ):
        """Prepare for N points of the body and C cameras (stacked)."""
        self._skeleton, self._limbs = skeleton, tuple(limbs.values())
        carrier = carrying_bones(points)[0]
        halves = [half for limb in self._limbs for half in halves_of(limb)]
        self.nodes = np.array([np.isin(carrier, half.bones[half.radii > 0]) for half in halves])
        self._bins = [bins_along(skeleton, limb, points, ALONG_BONE) for limb in self._limbs]
        self._rings = [obstacle_rings(surface, name) for name in limbs]
        self._cameras = [
            on_host(jax.tree.map(lambda part, c=c: part[c], cameras))
            for c in range(len(cameras.size))
        ]
        lengths = np.asarray(skeleton.lengths)
        self._reaches = np.array([
            REACH * lengths[limb.bones].sum() for limb in self._limbs
        ])  # fmt: skip
        self._areas = np.array([
            2 * (limb.radii * lengths[limb.bones]).sum() for limb in self._limbs
        ])  # fmt: skip

    def nearest_depths(self, projected: ProjectedBody) -> np.ndarray:
        """(L + 1, C, S, S) metres of each limb, and of the rest of the body; infinite beside it."""
        limbs = [self._on(number) for number in range(len(self._limbs))]
        parts = [*limbs, ~np.any(limbs, 0)]
        return np.stack([projected.cells.nearest_depths(part) for part in parts])

    def of_limb(
        self,
        number: int,
        projected: ProjectedBody,
        appearance: BodyAppearance,
        depths: np.ndarray,
    ) -> LimbEvidence:
        """What is left for a limb: beside the rest of the body, or before it by its colour.

        ``depths`` are of ``nearest_depths``.
        """
        rest, cells = ~self._on(number), projected.cells
        depth = np.delete(depths, number, 0).min(0)
        visible = cells.visible(depth) & rest
        cost = cells.appearance_cost(projected.chromaticities, appearance, visible)
        count = len(self._limbs[number].bones)
        means = appearance.means(self._bins[number], count * len(ALONG_BONE))
        means = means.reshape(count, len(ALONG_BONE), 3)
        colours = LimbAppearance(projected.chromaticities, cost, depth, means)
        alone = np.maximum(projected.log_ratios, np.float32(-WEAKEST_REST))
        log_ratios = np.where(np.isfinite(depth), np.float32(0), alone)
        obstacles = _obstacles(self._skeleton, projected.pose, self._rings[number])
        return LimbEvidence(log_ratios, projected.region, projected.used, colours, obstacles)

    def unexplained_areas(self, projected: ProjectedBody) -> np.ndarray:
        """(L,) area of person that nothing explains within each limb's reach, by the limb's."""
        every = np.ones(projected.pixels.shape[1], bool)
        likely = projected.log_ratios > PERSON_LOG_RATIO
        left = likely & ~projected.covered_cells(every)
        area, size = np.zeros((2, len(self._limbs)))
        for camera in np.flatnonzero(projected.used):
            region, of = projected.regions[camera], self._cameras[camera]
            # Cells to a metre at the pelvis' depth.
            away = max(depth(of, np.asarray(projected.pose.position)), NEAREST_M)
            metre = float(pixels_per_metre(of, away) / region.scale)
            rows, columns = np.nonzero(left[camera])
            size += self._areas * metre**2
            if not len(rows):
                continue
            for number in range(len(self._limbs)):
                middle = projected.pixels[camera, self._on(number)].mean(0)
                x, y = (middle - region.origin) / region.scale
                near = np.hypot(columns - x, rows - y) < metre * self._reaches[number]
                area[number] += np.sum(near)
        return area / np.maximum(size, 1.0)

    def _on(self, number: int) -> np.ndarray:
        """(N,) bool: the points of a limb."""
        return np.any(self.nodes[2 * number : 2 * number + 2], 0)


@program("full")
def _obstacles(skeleton: Skeleton, pose: Pose, rings: BodyPoints) -> Obstacles:
    """Parts of a body in a pose."""
    return Obstacles.of(pose_points(forward(skeleton, pose), rings))
