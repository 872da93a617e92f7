"""What a person looks like to one camera, learned frame by frame, for a live run.

    measure  a frame + where the body is expected -> grids: the person, the forearms; the legs
    learn    the same frame, once the body's pose is better determined -> background, colours

Where the person stood from the start the background is unknown; there only colours count, until the
person has moved.

INPUTS: frames, poses. OUTPUTS: a SilhouetteGrids of each frame.
"""

from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jax import Array

from jaxmocap.body.kinematics import landmarks
from jaxmocap.body.pose import Pose, unpack
from jaxmocap.body.skeleton import LANDMARKS, Skeleton
from jaxmocap.compilation.arrays import pack_leaves, unpack_leaves
from jaxmocap.compilation.programs import program
from jaxmocap.evidence.appearance.learned import (
    BARE,
    CELLS,
    CORE,
    LEG_MARGIN,
    MARGIN,
    AppearanceModel,
    Drawing,
    Regions,
    body_grids,
    in_image,
    landmark_halves,
)  # fmt: skip
from jaxmocap.evidence.appearance.presence import share_of_person, without_nobody
from jaxmocap.evidence.silhouettes import FOREARMS, LegGrid, SilhouetteGrids
from jaxmocap.geometry.cameras import Camera, project
from jaxmocap.geometry.outlines import Discs
from jaxmocap.images.background_model import RunningBackground
from jaxmocap.images.colours import RunningColours, colour_bins
from jaxmocap.images.foreground import SURE_ODDS, shrink
from jaxmocap.images.regions import Region, region_of_side
from jaxmocap.images.silhouette_grid import Grid, blur_grid

# Rows of the images that silhouettes are learned from, fewer than for a whole recording;
ROWS = 160
# and cells to a side of the grids round the upper half and the legs, fewer as well.
UPPER_CELLS, LOWER_CELLS = 48, 24
# So many frames are all learned from,
FIRST_FRAMES = 60
# and of later ones one in so many.
LATER_EVERY = 3
# Learned frames whose share of the person counts (``share_of_person``).
SHARE_MEMORY = 30
# A part's pixels must at least not look like the background.
UNLIKELY_ODDS = -0.5
# A region's scale stays as it is while the person fills this much of it, so that cells do not swim.
LEAST_FILLED = 0.6


def _empty(cells: int) -> Grid:
    return Grid(*np.zeros((2, cells, cells), np.float32))


# Of a camera that has no frame.
_NOWHERE = Region(np.zeros(2, np.float32), np.zeros((), np.float32))
NO_GRIDS = SilhouetteGrids(
    _NOWHERE, _empty(UPPER_CELLS), _empty(UPPER_CELLS), np.ones((), np.float32),
    LegGrid(_NOWHERE, _empty(LOWER_CELLS)), np.zeros((), np.float32),
)  # fmt: skip


class MeasuredFrame(NamedTuple):
    """A frame that has been looked at, to be learned from later."""

    image: np.ndarray  # (h, w, 3) BGR, shrunk
    odds: np.ndarray  # (h, w) that a pixel shows the person
    is_learned: np.ndarray  # (h, w) whether the background there was learned
    grids: SilhouetteGrids  # of the person


class _Projected(NamedTuple):
    """A body in an image: its limbs (K) and landmarks (L, 2), pixels; pixels in a metre there."""

    limbs: Discs
    landmarks_xy: Array | np.ndarray
    per_metre: Array | np.ndarray


@program("quick")
def _project_bones(skeleton: Skeleton, camera: Camera, pose: Array) -> Array:
    """A packed ``_Projected`` of a packed pose."""
    posed = unpack(pose)
    limbs, per_metre = in_image(skeleton, camera, posed)
    return pack_leaves(_Projected(limbs, project(camera, landmarks(skeleton, posed)), per_metre))


@dataclass
class _Window:
    """A region that follows some landmarks at a scale that hardly changes."""

    landmarks: np.ndarray  # (K,) which
    cells: int  # to a side
    margin: float  # around them, as a share of their extent
    side: float = 0.0  # of the region so far, pixels

    def region(self, pixels: np.ndarray) -> Region:
        """The region about these of all landmarks (L, 2)."""
        own = pixels[self.landmarks]
        low, high = own.min(0), own.max(0)
        extent = float((high - low).max()) * (1 + 2 * self.margin)
        if not LEAST_FILLED * self.side <= extent <= self.side:
            self.side = extent
        return region_of_side(low, high, self.side, self.cells)


class RunningAppearance:
    """One camera's view of one person.

    Attributes:
        background: without the person, so far.
        person: colours against the rest, so far.
        forearms: colours against the rest of the body, so far.
    """

    def __init__(self, skeleton: Skeleton, camera: Camera, feet_astray: bool):
        """Prepare for the person; the size of the frames is that of the first.

        Args:
            skeleton: of the person.
            camera: that looks.
            feet_astray: whether no marker holds the feet.
        """
        self.background, self.person = RunningBackground(), RunningColours()
        self.forearms = RunningColours()
        self._skeleton, self._camera, self._astray = skeleton, camera, feet_astray
        upper, legs = landmark_halves(skeleton.tree)
        self._upper = _Window(upper, UPPER_CELLS, MARGIN)
        self._lower = _Window(legs, LOWER_CELLS, LEG_MARGIN)
        self._offered, self._nothing_learned = 0, True
        self._learned: AppearanceModel | None = None
        self._shares = deque[float](maxlen=SHARE_MEMORY)

    def measure(self, image: np.ndarray, pose: Pose, softness: float) -> MeasuredFrame:
        """Look at a frame (H, W[, 3]) uint8 in which the body is expected in a pose.

        The first frame is learned from beforehand: colours are available at once.
        """
        size = image.shape[1], image.shape[0]
        small = shrink(_to_colour(image), ROWS)
        drawing, pixels = self._drawing(size, pose)
        regions = Regions(self._upper.region(pixels), self._lower.region(pixels))
        if self._nothing_learned:
            self._learn(small, drawing, None, None)
        learned = self._model()
        cells = UPPER_CELLS, LOWER_CELLS
        odds, grids = body_grids(small, learned, drawing, 0, regions, cells)
        soft = grids.each_grid(lambda grid: _soft(grid, softness))
        if len(self._shares) == SHARE_MEMORY:
            soft = without_nobody(soft, self._shares)
        return MeasuredFrame(small, odds, learned.background.certainty > 0.5, soft)

    def learn(self, frame: MeasuredFrame, size: tuple[int, int], pose: Pose) -> None:
        """Learn from a frame, whose full width and height is ``size``, where the body was.

        Of a room that was looked at for long every few frames will do.
        """
        self._offered += 1
        if self._offered <= FIRST_FRAMES or self._offered % LATER_EVERY == 0:
            self._learn(frame.image, self._drawing(size, pose)[0], frame.odds, frame.is_learned)

    def _model(self) -> AppearanceModel:
        """All that was learned; asked for more often than it changes."""
        if self._learned is None:
            background = self.background.background()
            colours = self.person.colours(), self.forearms.colours()
            self._learned = AppearanceModel(background, *colours)
        return self._learned

    def _drawing(self, size: tuple[int, int], pose: Pose) -> tuple[Drawing, np.ndarray]:
        """The body in the shrunk image, and its landmarks in the full one."""
        vector = np.asarray(_project_bones(self._skeleton, self._camera, np.concatenate(pose)))
        of_bones = np.empty((len(self._skeleton.tree.bones), 2))
        shapes = _Projected(Discs._make([of_bones] * 3), np.empty((len(LANDMARKS), 2)), np.empty(1))
        limbs, pixels, per_metre = unpack_leaves(vector, shapes)
        alone = Discs._make(part[None] for part in limbs)
        drawing = Drawing.shrunk(self._skeleton, alone, per_metre, size, ROWS)
        return drawing, pixels

    def _learn(
        self,
        image: np.ndarray,
        drawing: Drawing,
        odds: np.ndarray | None,
        is_learned: np.ndarray | None,
    ) -> None:
        self._nothing_learned, self._learned = False, None
        core, body = drawing.core(0), drawing.wherever(0, self._astray)
        arms = drawing.mask(0, CORE, only=FOREARMS[:1], part=BARE)
        others = drawing.core(0, without=(*FOREARMS, "head"))
        others &= ~drawing.mask(0, 2.0, only=FOREARMS)
        hidden = body
        if odds is not None and is_learned is not None:
            # What looks like the background learned there is background, body or not.
            hidden = core | (body & ~(is_learned & (odds <= -SURE_ODDS)))
            share = share_of_person(odds, drawing.trunk_and_arms(0))
            if np.isfinite(share):
                self._shares.append(share)
            core, likely = core & (odds >= 0), odds > UNLIKELY_ODDS
            arms, others = arms & likely, others & likely
        self.background.update(image, hidden)
        bins = colour_bins(image)
        self.person.update(bins, core, body)
        self.forearms.update(bins, arms, ~others)


def _to_colour(image: np.ndarray) -> np.ndarray:
    """(H, W, 3), of a grey image (H, W) too."""
    return image if image.ndim == 3 else np.repeat(image[..., None], 3, 2)


def _soft(grid: Grid, softness: float) -> Grid:
    """One grid blurred as softly as it is drawn, float32; few cells count as much as many."""
    stacked = blur_grid(Grid(*(np.asarray(part)[None] for part in grid)), softness)
    probability, weight = (np.asarray(part[0], np.float32) for part in stacked)
    return Grid(probability, weight * np.float32(CELLS / UPPER_CELLS))
