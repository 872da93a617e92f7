"""What a person looks like to one camera, and where that is to be seen in its frames.

    learn    some frames + where the poses put the body -> background, colours
    see      every frame -> two grids: the person, the forearms

INPUTS: poses of the person, frames. OUTPUTS: an Appearance; a Sight of every frame.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.flesh import cones, project_cones
from jaxmocap.body.kinematics import forward
from jaxmocap.body.motion import landmarks_over_time
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import LANDMARKS, Skeleton
from jaxmocap.geometry.cameras import NEAREST_M, Camera, project, to_camera
from jaxmocap.geometry.outlines import Discs
from jaxmocap.hybrid.batches import in_batches
from jaxmocap.hybrid.silhouette import FOREARMS, Sight, drawn_bones
from jaxmocap.images.background import Background
from jaxmocap.images.colours import Colours, learn_colours
from jaxmocap.images.foreground import learn_foreground, log_odds, person_grid, shrunk_size
from jaxmocap.images.hulls import draw_hulls
from jaxmocap.images.parts import part_odds
from jaxmocap.images.regions import Region
from jaxmocap.images.silhouette import Grid

# Rows of the images that silhouettes are learned from; cells of the grid around the person.
ROWS, CELLS = 360, 64
# Poses per call, so that they compile once.
POSES_A_CALL = 64
# Around the person's upper half, as a share of its extent.
MARGIN = 0.12
# Of a limb's thickness: its core, and wherever it may be; the pose errs by some centimetres.
CORE, WHEREVER, ERRING_M = 0.7, 1.4, 0.03
# Along the forearm: skin, whatever the sleeve; the markers hold its far half best.
BARE = (0.5, 0.95)
HEAD = ("head", "neck")
HEAD_GROWN = 1.6
BELOW = ("knee", "ankle", "toe")
UPPER = [i for i, name in enumerate(LANDMARKS) if not name.startswith(BELOW)]


@dataclass(frozen=True)
class Appearance:
    """What one camera's frames taught.

    Attributes:
        background: without the person.
        person: colours against the rest.
        forearms: colours against the rest of the body.
    """

    background: Background
    person: Colours
    forearms: Colours


def in_image(skeleton: Skeleton, camera: Camera, pose: Pose) -> tuple[Discs, Array]:
    """Limbs (K), pixels of the full image, and how many of them make a metre at the person."""
    flesh = cones(skeleton, forward(skeleton, pose), drawn_bones(skeleton.tree))
    depth = jnp.maximum(jnp.mean(to_camera(camera, flesh.near)[:, 2]), NEAREST_M)
    return project_cones(camera, flesh), camera.matrix[0, 0] / depth


_all_in_image = jax.jit(jax.vmap(in_image, (None, None, 0)))


@dataclass(frozen=True)
class Drawing:
    """The body as poses put it into the shrunk images.

    Attributes:
        discs: (F, K) limbs, pixels of the shrunk images; the radii of all the limbs' ends.
        per_metre: (F,) pixels of a metre at the person.
        size: width and height of the shrunk images.
        ratio: (2,) their size over that of the full ones.
        names: of the K bones.
    """

    discs: Discs
    per_metre: np.ndarray
    size: tuple[int, int]
    ratio: np.ndarray
    names: list[str]

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
        names = [skeleton.tree.bones[bone] for bone in drawn_bones(skeleton.tree)]
        discs = Discs(near, far, limbs.radii * ratio[0])
        return cls(discs, per_metre * ratio[0], small, ratio, names)

    def mask(
        self,
        frame: int,
        share: float,
        more_px: float = 0.0,
        only: Sequence[str] | None = None,
        without: Sequence[str] = (),
        part: tuple[float, float] = (0.0, 1.0),
    ) -> np.ndarray:
        """Limbs (h, w) bool with their radii scaled and enlarged, or a part of their length."""
        kept = [n not in without and (only is None or n in only) for n in self.names]
        near, far, radii = (each[frame][kept] for each in self.discs)
        ends = [near + at * (far - near) for at in part]
        widths = radii[:, :1] + np.array(part) * (radii[:, 1:] - radii[:, :1])
        return draw_hulls(Discs(ends[0], ends[1], widths * share + more_px), self.size)


def upper_body_regions(skeleton: Skeleton, camera: Camera, poses: Pose) -> Region:
    """Where (F) the person's upper half is, all at one scale."""
    points = landmarks_over_time(skeleton, poses)
    pixels = np.asarray(project(camera, jnp.asarray(points[:, UPPER])))
    low, high = pixels.min(1), pixels.max(1)
    side = np.percentile((high - low).max(1), 95) * (1 + 2 * MARGIN)
    origin = np.round((low + high) / 2 - side / 2) - 0.5
    dtype = points.dtype
    return Region(origin.astype(dtype), np.full(len(origin), side / CELLS, dtype))


def learn_appearance(
    drawing: Drawing, chosen: np.ndarray, images: Iterable[np.ndarray | None]
) -> Appearance | None:
    """Background and colours from some frames; None if none of them can be read.

    Args:
        drawing: the body in F frames.
        chosen: which of them.
        images: these, shrunk, BGR; None where one cannot be read.
    """
    read = [(i, image) for i, image in zip(chosen, images, strict=True) if image is not None]
    if not read:
        return None
    which, frames = [i for i, _ in read], np.stack([image for _, image in read])
    cores = np.stack([drawing.mask(i, CORE) for i in which])
    more_px = ERRING_M * drawing.per_metre
    bodies = np.stack([drawing.mask(i, WHEREVER, float(more_px[i])) for i in which])
    background, person = learn_foreground(frames, cores, bodies)
    odds = np.stack([log_odds(frame, background, person) for frame in frames])
    arms = np.stack([drawing.mask(i, CORE, only=FOREARMS[:2], part=BARE) for i in which])
    others = np.stack([drawing.mask(i, CORE, without=(*FOREARMS, *HEAD)) for i in which])
    near = np.stack([drawing.mask(i, 2.0, only=FOREARMS) for i in which])
    rest = others & ~near & (odds > -0.5)
    rest = rest if rest.any() else others
    forearms = learn_colours(frames, arms & (odds > -0.5), ~rest)
    return Appearance(background, person, forearms)


def see(
    images: Iterable[np.ndarray | None], known: Appearance | None, drawing: Drawing, region: Region
) -> Sight:
    """The person (F, ...) on the grids of F regions.

    Args:
        images: F, shrunk, BGR; None where one cannot be read.
        known: of the person; None where nothing is.
        drawing: the body in the frames.
        region: where the grids lie, in pixels of the full images.
    """
    grids = [
        _grids(image, known, drawing, i, Region(region.origin[i], region.scale[i]))
        for i, image in enumerate(images)
    ]
    person, forearms = (
        Grid(*(np.stack(parts) for parts in zip(*each, strict=True)))
        for each in zip(*grids, strict=True)
    )
    return Sight(region, person, forearms)


def _grids(
    image: np.ndarray | None, known: Appearance | None, drawing: Drawing, frame: int, region: Region
) -> tuple[Grid, Grid]:
    """The person and the forearms on the grid; nothing known where there is no image."""
    if image is None or known is None:
        nothing = Grid(*np.zeros((2, CELLS, CELLS), np.float32))
        return nothing, nothing
    return body_grids(image, known, drawing, frame, region)[1:]


def body_grids(
    image: np.ndarray, known: Appearance, drawing: Drawing, frame: int, region: Region
) -> tuple[np.ndarray, Grid, Grid]:
    """Log-odds (h, w) that pixels of a shrunk image show the person; person, forearms on a grid."""
    person = log_odds(image, known.background, known.person)
    head = drawing.mask(frame, HEAD_GROWN, only=HEAD)
    forearms = part_odds(image, person, known.forearms, head)
    # Edges map onto edges.
    origin = (np.asarray(region.origin) + 0.5) * drawing.ratio - 0.5
    cell = float(region.scale) * drawing.ratio[0]
    whole, part = (Grid(*person_grid(odds, origin, cell, CELLS)) for odds in (person, forearms))
    return person, whole, part
