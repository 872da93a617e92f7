"""The body's silhouette: how far the drawn body covers what the cameras saw of it.

Two pictures of the same grid round the upper half: the whole person against the background, and the
forearms against all else, so that an arm before the torso counts as well. A coarser grid round the
legs shows where the person stands.

INPUTS: a skeleton, a pose, a camera, measured silhouettes on a grid.
OUTPUTS: a cost, and its Gauss-Newton terms by the pose's tangent vector.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.kinematics import Frames, forward, jacobian
from jaxmocap.body.pose import Pose, retract
from jaxmocap.body.proportions import scale_skeleton
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.body.surfaces.cones import Cones, cones, project_cones
from jaxmocap.body.tree import ROOT_DOF, Tree
from jaxmocap.compilation.arrays import Numbers
from jaxmocap.compilation.settings import settings, traced
from jaxmocap.geometry.cameras import (
    NEAREST_M,
    Camera,
    depth,
    depth_gradient,
    projection_jacobian,
    turn_camera,
)
from jaxmocap.geometry.outlines import Discs, depth_along
from jaxmocap.geometry.rotations import HIGHEST
from jaxmocap.images.regions import Region, discs_in_region, in_other_region
from jaxmocap.images.silhouette_grid import (
    CoverageFit,
    Grid,
    coverage_fit,
    distances,
    frontmost,
    halve_grid,
)

# Parts of the arms that have silhouettes of their own.
FOREARMS = ("forearm", "hand")
# Limbs whose thickness tells their distance; flesh and clothes of all others vary by more.
THICK_BY_DISTANCE = ("arm", "head")
# A limb is hidden by what lies in front of its axis by more than this, metres:
HIDDEN_BEYOND_M = 0.06
# and over so many metres more and more of it.
HIDDEN_SOFTLY_M = 0.03


class LegGrid(NamedTuple):
    """The person's lower half in one camera."""

    region: Region  # where the grid lies in the image
    person: Grid  # the whole person, as far as it is there


class SilhouetteGrids(NamedTuple):
    """The person in one camera at one time."""

    region: Region  # where the grid round the upper half lies in the image (no batch)
    person: Grid  # the whole person
    forearms: Grid  # forearms and hands alone
    # () image pixels of a metre at the person, where the grids were measured.
    per_metre: Array | np.ndarray
    legs: LegGrid | None = None  # the lower half; None where nobody looked
    # () 1 while no marker is measured, else 0; None for never. All limbs are as thick as
    # ``per_metre`` has them then: by its own thickness the person would come nearer and nearer.
    unmarked: Array | np.ndarray | None = None

    @property
    def recognised(self) -> np.ndarray:
        """(...) whether any pixel speaks for the person, or against."""
        return np.asarray(np.asarray(self.person.weight).any((-2, -1)))

    def each_grid(self, call: Callable[[Grid], Grid]) -> "SilhouetteGrids":
        """The same with every grid changed."""
        legs = self.legs and self.legs._replace(person=call(self.legs.person))
        return self._replace(person=call(self.person), forearms=call(self.forearms), legs=legs)

    def halve(self) -> "SilhouetteGrids":
        """The same on grids of half as many cells to a side."""
        coarse, legs = self.each_grid(halve_grid), self.legs and _coarser(self.legs.region)
        coarse = coarse._replace(region=_coarser(self.region))
        return coarse._replace(legs=coarse.legs and coarse.legs._replace(region=legs))


def _coarser(region: Region) -> Region:
    return Region(region.origin, 2 * region.scale)


@settings
class Silhouettes:
    """How differences between the drawn body and what cameras show of it count.

    It is evidence of a view, a camera at a frame, and not of a frame alone; it has so many cells
    that it hands on J^T J and J^T r in place of rows (``silhouette_fit``).
    """

    deviation: Array = traced(
        0.7, "of a cell's coverage; above what one cell errs by, since neighbours err alike"
    )
    person: Array = traced(
        1.0,
        "weight of the differences from the whole person's silhouette; 0 leaves it out",
        least=0,
    )
    forearms: Array = traced(1.0, "weight of those from the forearms'", least=0)
    redundancy: Array = traced(
        100.0,
        "how many cells and frames err alike: a silhouette is wrong where the person is no cone, "
        "and goes on being so; for the deviations only",
    )

    @property
    def weight(self) -> float:
        """Of a squared difference between what is drawn and what a camera shows."""
        return 1 / float(self.deviation) ** 2

    def weigh(self, grids: SilhouetteGrids) -> SilhouetteGrids:
        """Grids (...) weighted as in the settings; those on the host stay there."""

        def by(weight: Array) -> Callable[[Grid], Grid]:
            def scaled(grid: Grid) -> Grid:
                is_traced = isinstance(grid.weight, Array)
                return grid._replace(weight=(weight if is_traced else float(weight)) * grid.weight)

            return scaled

        person = grids.each_grid(by(self.person))
        return person._replace(forearms=by(self.forearms)(grids.forearms))


def project_limbs(
    skeleton: Skeleton, frames: Frames, camera: Camera, grids: SilhouetteGrids
) -> tuple[Cones, Discs, Array]:
    """The body's limbs (K), world, and in cells; the visible share (S * S,) of a forearm."""
    flesh = cones(skeleton, frames, skeleton.tree.drawn)
    outlines = project_flesh(skeleton.tree, camera, flesh, grids.per_metre, unmarked=grids.unmarked)
    discs = discs_in_region(grids.region, outlines)
    return flesh, discs, _visible(skeleton.tree, camera, flesh, discs, grids.person)


def project_flesh(
    tree: Tree,
    camera: Camera,
    flesh: Cones,
    per_metre: Array | np.ndarray,
    bones: np.ndarray | None = None,
    unmarked: Array | np.ndarray | None = None,
) -> Discs:
    """Limbs in the image, pixels; trunk and legs as thick as they are drawn anywhere.

    Clothes are thicker than what is drawn, and would bring a limb, or with the trunk the head,
    nearer to the camera.

    Args:
        tree: of the person.
        camera: that sees it.
        flesh: of the drawn bones, or of others.
        per_metre: () pixels of a metre of trunk and legs.
        bones: of the flesh; those that are drawn without it.
        unmarked: as of ``SilhouetteGrids``; arms and head are as thick anywhere, too, where 1.
    """
    discs = project_cones(camera, flesh)
    bones = tree.drawn if bones is None else bones
    alike = _as_thick_anywhere(tree, bones, unmarked)[:, None]
    return discs._replace(radii=jnp.where(alike, flesh.radii * per_metre, discs.radii))


def _as_thick_anywhere(tree: Tree, bones: np.ndarray, unmarked: Numbers | None) -> Numbers:
    """Which limbs (K,) look as thick far away as nearby."""
    alike = ~np.isin(bones, tree.bones_in(*THICK_BY_DISTANCE))
    return alike if unmarked is None else alike | (unmarked > 0)


def limbs_fit(
    tree: Tree, discs: Discs, visible: Array, grids: SilhouetteGrids, softness: Array
) -> CoverageFit:
    """Gauss-Newton terms of all pictures, by limbs (K) of ``project_limbs``."""
    fore = forearms(tree)
    arms = Discs(*(part[fore] for part in discs))
    person = coverage_fit(discs, grids.person, softness)
    arms_only = coverage_fit(arms, grids.forearms, softness, visible)
    both = CoverageFit(
        person.cost + arms_only.cost,
        person.hessian.at[fore].add(arms_only.hessian),
        person.gradient.at[fore].add(arms_only.gradient),
    )
    if grids.legs is None:
        return both
    # By samples of the upper grid, as all else.
    ratio = jnp.asarray(grids.region.scale / grids.legs.region.scale)
    below = in_other_region(discs, grids.region, grids.legs.region)
    below = coverage_fit(below, grids.legs.person, softness)
    own = CoverageFit(below.cost, ratio**2 * below.hessian, ratio * below.gradient)
    return jax.tree.map(jnp.add, both, own)


def silhouette_fit(
    skeleton: Skeleton,
    proportions: Array | None,
    pose: Pose,
    camera: Camera,
    grids: SilhouetteGrids,
    softness: Array,
) -> tuple[Array, Array, Array]:
    """The cost () of all pictures, with J^T J (N, N) and J^T r (N,), N = 6 + D + P + 3.

    By the pose, then the proportions, then a turn of the camera in its own frame.

    Args:
        skeleton: unscaled.
        proportions: (P,) of ``scale_skeleton``; None for body and camera as stated: N = 6 + D.
        pose: of the person.
        camera: that sees it.
        grids: what it saw.
        softness: cells.
    """
    bones = skeleton.tree.drawn
    person = skeleton if proportions is None else scale_skeleton(skeleton, proportions)
    frames = forward(person, pose)
    flesh, discs, visible = project_limbs(person, frames, camera, grids)
    leverage = _leverage(person, frames, camera, flesh, discs, grids, bones)
    if proportions is not None:

        def limbs(shared: Array) -> Discs:
            own = scale_skeleton(skeleton, shared[:-3])
            body = cones(own, forward(own, pose), bones)
            there = turn_camera(camera, shared[-3:])
            outlines = project_flesh(
                own.tree, there, body, grids.per_metre, unmarked=grids.unmarked
            )
            return discs_in_region(grids.region, outlines)

        by_shared = jax.jacfwd(limbs)(jnp.pad(proportions, (0, 3)))
        ends = by_shared.near, by_shared.far, by_shared.radii
        leverage = jnp.concatenate([leverage, jnp.concatenate(ends, 1)], 2)
    fit = limbs_fit(person.tree, discs, visible, grids, softness)
    return (
        fit.cost,
        jnp.einsum("kia,kij,kjb->ab", leverage, fit.hessian, leverage, precision=HIGHEST),
        jnp.einsum("kia,ki->a", leverage, fit.gradient, precision=HIGHEST),
    )


def silhouette_hessian(
    skeleton: Skeleton, pose: Pose, camera: Camera, grids: SilhouetteGrids, softness: Array
) -> Array:
    """(N, N) of half the cost of ``silhouette_fit`` by the pose, N = 6 + D; nothing is left out.

    Which limb is frontmost over a cell, and what hides a forearm, is held fixed.
    """

    def limbs(step: Array) -> tuple[Array, Discs, Array]:
        frames = forward(skeleton, retract(pose, step))
        flesh, discs, visible = project_limbs(skeleton, frames, camera, grids)
        bones = skeleton.tree.drawn
        return _leverage(skeleton, frames, camera, flesh, discs, grids, bones), discs, visible

    still = jnp.zeros(ROOT_DOF + pose.angles.size, pose.angles.dtype)
    leverage, discs, visible = limbs(still)

    def uphill(moved: Array) -> Array:
        near, far, radii = jnp.split(moved, 3, -1)
        there = Discs(discs.near + near, discs.far + far, discs.radii + radii)
        return limbs_fit(skeleton.tree, there, visible, grids, softness).gradient

    slope, push = jax.linearize(uphill, jnp.zeros_like(leverage[..., 0]))
    # No cell belongs to two limbs: one direction of all limbs at once gives a row of each.
    ways = jnp.broadcast_to(np.eye(6, dtype=slope.dtype)[:, None], (6, *slope.shape))
    blocks = jax.vmap(push, out_axes=2)(ways)
    H = jnp.einsum("kia,kij,kjb->ab", leverage, blocks, leverage, precision=HIGHEST)
    H += jax.jacfwd(lambda step: jnp.einsum("kia,ki->a", limbs(step)[0], slope, precision=HIGHEST))(
        still
    )
    # What differs with the order of two turns is no curvature of the cost.
    return (H + H.T) / 2


def forearms(tree: Tree) -> np.ndarray:
    """Which of the drawn limbs are forearms and hands."""
    return np.flatnonzero(np.isin(tree.drawn, tree.bones_in(*FOREARMS)))


def _visible(tree: Tree, camera: Camera, flesh: Cones, discs: Discs, grid: Grid) -> Array:
    """Visible share (S * S,) of the frontmost forearm.

    Without a derivative: what hides a limb has none.
    """
    fore = np.isin(np.arange(len(discs.near)), forearms(tree))
    size = grid.probability.shape[-1]
    which, at = frontmost(Discs(*(part[fore] for part in discs)), size)
    ends = (depth(camera, end)[fore][which] for end in (flesh.near, flesh.far))
    others = Cones(*(part[~fore] for part in flesh))
    surface = nearest_surface(camera, others, distances(discs, size)[~fore])
    return jax.lax.stop_gradient(unhidden(surface, depth_along(at, *ends)))


def nearest_surface(camera: Camera, flesh: Cones, away: Array) -> Array:
    """Depth (C,) of the nearest limb over each cell, metres; infinite where none is.

    Args:
        camera: that sees them.
        flesh: K limbs.
        away: (K, C) distances of the cells from the limbs' outlines, negative inside.
    """
    depths = jnp.stack([depth(camera, end) for end in (flesh.near, flesh.far)], 1)
    surfaces = jnp.mean(depths - flesh.radii, 1)[:, None]
    return jnp.min(jnp.where(away < 0, surfaces, jnp.inf), 0)


def unhidden(surface: Array, away: Array) -> Array:
    """Share (C,) of a limb at a depth (C,) that a surface before or behind it leaves visible."""
    return jax.nn.sigmoid((surface + HIDDEN_BEYOND_M - away) / HIDDEN_SOFTLY_M)


def _leverage(
    skeleton: Skeleton,
    frames: Frames,
    camera: Camera,
    flesh: Cones,
    discs: Discs,
    grids: SilhouetteGrids,
    bones: np.ndarray,
) -> Array:
    """Derivatives (K, 6, 6 + D) of the limbs' discs in cells."""
    ahead = depth_gradient(camera)
    alike = _as_thick_anywhere(skeleton.tree, bones, grids.unmarked)[:, None, None]

    def of_end(points_world: Array, radii: Array) -> tuple[Array, Array]:
        J = jacobian(skeleton, frames, bones, points_world)
        cells = projection_jacobian(camera, points_world) / grids.region.scale
        # Sums of three products: as one loop they are faster than small matrix products.
        centre = sum(cells[:, :, i, None] * J[:, i, None] for i in range(3))
        deeper = sum(ahead[i] * J[:, i, None] for i in range(3))
        away = jnp.maximum(depth(camera, points_world), NEAREST_M)
        nearer = jnp.where(alike, 0.0, -deeper / away[:, None, None])
        return jnp.asarray(centre), radii[:, None, None] * nearer

    near, near_radius = of_end(flesh.near, discs.radii[:, 0])
    far, far_radius = of_end(flesh.far, discs.radii[:, 1])
    return jnp.concatenate([near, far, near_radius, far_radius], 1)
