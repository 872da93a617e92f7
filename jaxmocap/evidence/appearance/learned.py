"""What a person looks like to one camera, and where that appears in its frames.

    learn    some frames + where the poses put the body -> background, colours
    measure  every frame -> grids: the person, the forearms; the legs

INPUTS: poses of the person, frames. OUTPUTS: an AppearanceModel; a SilhouetteGrids of every frame.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.kinematics import forward
from jaxmocap.body.model import LOWER_LEG
from jaxmocap.body.motion import landmarks_over_time
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import LANDMARK_PLACES, Skeleton
from jaxmocap.body.surfaces.cones import cones, project_cones
from jaxmocap.body.tree import Tree
from jaxmocap.compilation.batches import in_batches
from jaxmocap.compilation.programs import Program
from jaxmocap.evidence.appearance.hulls import draw_hulls, part_odds
from jaxmocap.evidence.appearance.presence import share_of_person, without_nobody
from jaxmocap.evidence.silhouettes import FOREARMS, LegGrid, SilhouetteGrids
from jaxmocap.geometry.cameras import NEAREST_M, Camera, depth, on_host, pixels_per_metre, project
from jaxmocap.geometry.outlines import Discs
from jaxmocap.images.background_model import Background
from jaxmocap.images.colours import Colours, learn_colours
from jaxmocap.images.foreground import (
    AROUND_PX,
    Layers,
    Window,
    learn_foreground,
    log_odds,
    log_odds_of,
    person_grids,
    shrunk_size,
    weigh_odds,
)
from jaxmocap.images.regions import Region, region_of_side
from jaxmocap.images.silhouette_grid import Grid

# Rows of the images that silhouettes are learned from.
ROWS = 360
# Cells along a side of the grid around the upper half.
CELLS = 64
# Cells along a side of the grid around the legs.
LEG_CELLS = 32
# Poses per call, so that they compile once.
POSES_A_CALL = 64
# Around the person's upper half, as a share of its extent.
MARGIN = 0.12
# Around the legs.
LEG_MARGIN = 0.15
# Share of a limb's thickness that surely is the limb.
CORE = 0.7
# Multiple of its thickness within which it surely is,
WHEREVER = 1.4
# and so many metres more, by which poses err.
POSE_ERROR_M = 0.03
# By how much parts of legs err that no marker holds, metres. Somebody who stands still would be
# learned as furniture if legs were drawn aside of where they are.
ASTRAY_M = {"thigh": 0.12, "shank": 0.2, "foot": 0.2}
# Along the forearm: skin, whatever the sleeve; the markers hold its far half best.
BARE = (0.5, 0.95)
# No cone is like a head with its head-set, or a pelvis: so many times as thick as they are drawn
# silhouettes determine nothing.
GROWN = 1.6
# Nor like a shoe: so many metres about it.
SHOE_M = 0.06


@dataclass(frozen=True)
class AppearanceModel:
    """What one camera's frames taught."""

    background: Background  # without the person
    person: Colours  # colours against the rest
    forearms: Colours  # colours against the rest of the body


def in_image(skeleton: Skeleton, camera: Camera, pose: Pose) -> tuple[Discs, Array]:
    """All limbs (K), pixels of the full image, and how many of them make a metre at the person."""
    every = np.arange(len(skeleton.tree.bones))
    flesh = cones(skeleton, forward(skeleton, pose), every)
    away = jnp.maximum(jnp.mean(depth(camera, flesh.near)), NEAREST_M)
    return project_cones(camera, flesh), pixels_per_metre(camera, away)


_all_in_image = Program(jax.vmap(in_image, (None, None, 0)), "all_in_image")


@dataclass(frozen=True)
class Drawing:
    """The body as poses put it into the shrunk images."""

    discs: Discs  # (F, K) limbs, pixels of the shrunk images; the radii of all the limbs' ends
    per_metre: np.ndarray  # (F,) pixels of a metre at the person, of the shrunk images
    size: tuple[int, int]  # width and height of the shrunk images
    ratio: np.ndarray  # (2,) their size over that of the full ones
    tree: Tree  # of the K bones

    @classmethod
    def of(
        cls, skeleton: Skeleton, camera: Camera, size: tuple[int, int], poses: Pose
    ) -> "Drawing":
        """The poses (F, ...) in a camera's frames, whose width and height is ``size``."""
        there = jax.tree.map(lambda part: np.asarray(part, skeleton.lengths.dtype), poses)
        call = partial(_all_in_image, skeleton, camera)
        *limbs, per_metre = in_batches(call, (there,), POSES_A_CALL)
        return cls.shrunk(skeleton, Discs._make(limbs), per_metre, size)

    @classmethod
    def shrunk(
        cls, skeleton: Skeleton, limbs: Discs, per_metre: np.ndarray, size: tuple[int, int],
        rows: int = ROWS,
    ) -> "Drawing":  # fmt: skip
        """Of what ``in_image`` found in full images (F, ...) of that width and height."""
        small = shrunk_size(size, rows)
        ratio = np.divide(small, size)
        near, far = ((end + 0.5) * ratio - 0.5 for end in (limbs.near, limbs.far))
        discs = Discs(near, far, limbs.radii * ratio[0])
        return cls(discs, per_metre * ratio[0], small, ratio, skeleton.tree)

    def mask(
        self,
        frame: int,
        share: float | np.ndarray,
        more_px: float | np.ndarray = 0.0,
        only: Sequence[str] | None = None,
        without: Sequence[str] = (),
        part: tuple[float, float] = (0.0, 1.0),
    ) -> np.ndarray:
        """Limbs (h, w) bool with their radii scaled and enlarged, or a part of their length.

        ``share`` and ``more_px`` are alike for all limbs or (K, 1). ``only`` and ``without`` name
        groups of bones or their parts.
        """
        kept = _bones_but(self.tree, None if only is None else tuple(only), tuple(without))
        near, far, radii = (each[frame] for each in self.discs)
        ends = [near + at * (far - near) for at in part]
        widths = radii[:, :1] + np.array(part) * (radii[:, 1:] - radii[:, :1])
        limbs = Discs(ends[0], ends[1], widths * share + more_px)
        return draw_hulls(Discs._make(each[kept] for each in limbs), self.size)

    def image_per_metre(self, frame: int, dtype: np.dtype) -> np.ndarray:
        """() pixels of a metre at the person, of the full image."""
        return np.asarray(self.per_metre[frame] / self.ratio[0], dtype)

    def core(self, frame: int, without: Sequence[str] = ()) -> np.ndarray:
        """Where (h, w) the person surely is."""
        return self.mask(frame, CORE, without=("foot", *without))

    def trunk_and_arms(self, frame: int) -> np.ndarray:
        """Where (h, w) these surely are; a desk hides legs."""
        return self.core(frame, without=("leg", "hip", "head"))

    def wherever(self, frame: int, feet_astray: bool) -> np.ndarray:
        """Where (h, w) the person may be; ``feet_astray`` where no marker holds the feet."""
        metres = np.full((len(self.tree.bones), 1), POSE_ERROR_M)
        for part, astray in ASTRAY_M.items() if feet_astray else ():
            metres[_bones_but(self.tree, (part,), ())] = astray
        return self.mask(frame, WHEREVER, metres * float(self.per_metre[frame]))

    def unlike(self, frame: int) -> np.ndarray:
        """Where (h, w) the person is not like what is drawn."""
        share, metres = np.full((2, len(self.tree.bones), 1), [[[GROWN]], [[0.0]]])
        feet = _bones_but(self.tree, ("foot",), ())
        share[feet], metres[feet] = 1.0, SHOE_M
        more_px = metres * float(self.per_metre[frame])
        return self.mask(frame, share, more_px, only=("head", "hip", "foot"))


@lru_cache(maxsize=64)
def _bones_but(tree: Tree, only: tuple[str, ...] | None, without: tuple[str, ...]) -> np.ndarray:
    """Rows of the bones of some groups or parts, None for all, but not those of others."""
    bones = np.arange(len(tree.bones)) if only is None else tree.bones_in(*only)
    return np.setdiff1d(bones, tree.bones_in(*without))


class Regions(NamedTuple):
    """Where F frames, or one, are looked at."""

    upper: Region  # around the upper half
    lower: Region  # around the legs

    @classmethod
    def around(cls, skeleton: Skeleton, camera: Camera, poses: Pose) -> "Regions":
        """Those of poses (F, ...), all at one scale."""
        points = landmarks_over_time(skeleton, poses)
        pixels = np.asarray(project(on_host(camera), points), points.dtype)
        upper, legs = landmark_halves(skeleton.tree)
        around = _region(pixels[:, upper], CELLS, MARGIN)
        return cls(around, _region(pixels[:, legs], LEG_CELLS, LEG_MARGIN))

    def of(self, frame: int) -> "Regions":
        """Of one frame."""
        return jax.tree.map(lambda part: part[frame], self)


def landmark_halves(tree: Tree) -> tuple[np.ndarray, np.ndarray]:
    """Rows of the landmarks of the upper half, and of those of the legs; hips are of both."""
    bones = [tree.bone(bone) for bone, _ in LANDMARK_PLACES.values()]
    is_low, is_leg = (np.isin(bones, tree.bones_in(*kind)) for kind in (LOWER_LEG, ("leg",)))
    return np.flatnonzero(~is_low), np.flatnonzero(is_leg)


def _region(pixels: np.ndarray, cells: int, margin: float) -> Region:
    low, high = pixels.min(1), pixels.max(1)
    side = float(np.percentile((high - low).max(1), 95)) * (1 + 2 * margin)
    return region_of_side(low, high, side, cells)


def learn_appearance(
    drawing: Drawing, chosen: np.ndarray, images: Iterable[np.ndarray | None], feet_astray: bool
) -> AppearanceModel | None:
    """Background and colours from some frames; None if none of them can be read.

    Args:
        drawing: the body in F frames.
        chosen: which of them.
        images: these, shrunk, BGR; None where one cannot be read.
        feet_astray: whether no marker holds the feet.
    """
    read = [(i, image) for i, image in zip(chosen, images, strict=True) if image is not None]
    if not read:
        return None
    which, frames = [i for i, _ in read], np.stack([image for _, image in read])
    cores = np.stack([drawing.core(i) for i in which])
    bodies = np.stack([drawing.wherever(i, feet_astray) for i in which])
    background, person = learn_foreground(frames, cores, bodies)
    odds = np.stack(
        [
            log_odds_of(frame, background, person, body)
            for frame, body in zip(frames, bodies, strict=True)
        ]
    )
    arms = np.stack([drawing.mask(i, CORE, only=FOREARMS[:1], part=BARE) for i in which])
    others = np.stack([drawing.core(i, without=(*FOREARMS, "head")) for i in which])
    near = np.stack([drawing.mask(i, 2.0, only=FOREARMS) for i in which])
    rest = others & ~near & (odds > -0.5)
    rest = rest if rest.any() else others
    forearms = learn_colours(frames, arms & (odds > -0.5), ~rest)
    return AppearanceModel(background, person, forearms)


def silhouette_grids(
    images: Iterable[np.ndarray | None],
    learned: AppearanceModel | None,
    drawing: Drawing,
    regions: Regions,
) -> SilhouetteGrids:
    """The person (F, ...) on the grids of F frames.

    Args:
        images: F, shrunk, BGR; None where one cannot be read.
        learned: of the person; None where nothing was learned.
        drawing: the body in the frames.
        regions: where the grids lie, in pixels of the full images.

    Returns:
        Of weight 0 where there is no image, and everywhere where most frames show nobody.
    """
    grids, shares = [], []
    for i, image in enumerate(images):
        if image is None or learned is None:
            grids.append(_no_grids(regions.of(i), drawing, i))
            continue
        odds, own = body_grids(image, learned, drawing, i, regions.of(i))
        grids.append(own)
        shares.append(share_of_person(odds, drawing.trunk_and_arms(i)))
    return without_nobody(jax.tree.map(lambda *parts: np.stack(parts), *grids), shares)


def _no_grids(regions: Regions, drawing: Drawing, frame: int) -> SilhouetteGrids:
    """All weights are zero where there is no image."""
    upper, lower = (Grid(*np.zeros((2, cells, cells), np.float32)) for cells in (CELLS, LEG_CELLS))
    per_metre = drawing.image_per_metre(frame, regions.upper.scale.dtype)
    return SilhouetteGrids(regions.upper, upper, upper, per_metre, LegGrid(regions.lower, lower))


def body_grids(
    image: np.ndarray,
    learned: AppearanceModel,
    drawing: Drawing,
    frame: int,
    regions: Regions,
    cells: tuple[int, int] = (CELLS, LEG_CELLS),
) -> tuple[np.ndarray, SilhouetteGrids]:
    """Log-odds (h, w) that pixels of a shrunk image show the person; what that is on the grids.

    Args:
        image: (h, w, 3) BGR uint8.
        learned: of room and person.
        drawing: the body in the frames.
        frame: which of them.
        regions: where the grids lie, in pixels of the full image.
        cells: to a side of both grids.
    """
    on_upper, on_legs = cells
    upper = _in_shrunk(drawing, regions.upper)
    lower = _in_shrunk(drawing, regions.lower)
    window, corner = _window(image, {on_upper: upper, on_legs: lower})
    odds = np.zeros(image.shape[:2], np.float32)
    odds[window] = log_odds(image, learned.background, learned.person, window=window)
    head = drawing.mask(frame, GROWN, only=("head",))[window]
    forearms = part_odds(image[window], odds[window], learned.forearms, head)
    person = np.where(drawing.unlike(frame)[window], np.float32(0), odds[window])

    def grids(others: Layers, region: Region, cells: int) -> list[Grid]:
        origin, both = np.asarray(region.origin) - corner, (layers, others)
        return [Grid(*each) for each in person_grids(both, origin, float(region.scale), cells)]

    layers = weigh_odds(person)
    person_image, part = grids(weigh_odds(forearms), upper, on_upper)
    legs = LegGrid(regions.lower, grids(layers, lower, on_legs)[0])
    per_metre = drawing.image_per_metre(frame, regions.upper.scale.dtype)
    return odds, SilhouetteGrids(regions.upper, person_image, part, per_metre, legs)


def _in_shrunk(drawing: Drawing, region: Region) -> Region:
    """A region of the full image in the shrunk one; edges map onto edges."""
    origin = (np.asarray(region.origin) + 0.5) * drawing.ratio - 0.5
    return Region(origin, np.asarray(region.scale * drawing.ratio[0]))


def _window(image: np.ndarray, grids: Mapping[int, Region]) -> tuple[Window, np.ndarray]:
    """The part of a shrunk image that grids of so many cells lie in, and its corner (x, y)."""
    size = np.array([image.shape[1], image.shape[0]])
    low = np.min([each.origin for each in grids.values()], 0) - AROUND_PX
    ends = [each.origin + cells * each.scale for cells, each in grids.items()]
    high = np.max(ends, 0) + AROUND_PX
    # Of a body that is nowhere in the image a pixel is left.
    start = np.clip(np.floor(low), 0, size - 1).astype(int)
    end = np.maximum(np.clip(np.ceil(high), 0, size).astype(int), start + 1)
    return (slice(start[1], end[1]), slice(start[0], end[0])), start
