"""``python -m bench.segmentation RECORDINGS [--quick] [--json FILE]``: silhouettes by a look.

Rendered exercises by four cameras before clutter. Each look starts from the person's own silhouette
in a pose whose joints are all off by 5 degrees, and which stands off by 3 cm. Level sets know
nothing of the room, or what was learned of it over the whole recording from such looks, or a
picture of it without the person. GrabCut starts from the same silhouette, certain of nothing but
what is farther off than so many pixels; MOG2 follows the video, or has learned the empty room.

INPUTS: the folder of recordings, with ``person/person.npz`` in it. OUTPUTS: a table, and Metrics.
"""

import argparse
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from time import perf_counter
from typing import NamedTuple

import cv2
import numpy as np

from bench import add_rendered, command, kept
from bench.clips import Clip, displaced, exercises
from bench.figures import Metric, write_json
from jaxmocap.capture.footage import forward_readers
from jaxmocap.capture.video import open_video
from jaxmocap.evaluation.tables import align_columns
from jaxmocap.formats.recordings.recording import Recording
from jaxmocap.images.background_model import Background
from jaxmocap.images.canvases import full_mask, mask_canvas
from jaxmocap.images.regions import Region
from jaxmocap.pipelines.kept_programs import keep_compiled
from jaxmocap.silhouette.segmentation.background_models import (
    BackgroundLearner,
    background_of_picture,
)
from jaxmocap.silhouette.segmentation.outlines import find_outlines
from jaxmocap.silhouette.segmentation.segment import Histograms, SegmentationPlan
from jaxmocap.silhouette.settings import Settings
from jaxmocap.silhouette.surfaces.rim import Rim
from jaxmocap.synthetic.four_cameras import RoomCamera, cameras_around, read_masks
from jaxmocap.synthetic.movements.exercises import EXERCISES, exercise
from jaxmocap.synthetic.people.rigged_mesh import load_rig
from jaxmocap.synthetic.renderer import Sensor

# Evaluated frames of a recording; exposures of an empty room; a room is learned from every so many
# frames.
EVALUATED, EXPOSURES, LEARNED_EVERY = 3, 8, 3
# What GrabCut may call the person lies this near to where it starts, pixels; and its rounds.
GRABBED_PX, GRABS = 24, 4
MOG2 = {"history": 60, "varThreshold": 16, "detectShadows": True}
PERSON = 255
# Name of a row -> plan and which rooms are learned.
LEVEL_SETS = {
    "level set, grey": (SegmentationPlan(colour=False, background=False), "none"),
    "level set, colour": (SegmentationPlan(background=False), "none"),
    "+ learned room": (SegmentationPlan(), "learned"),
    "+ picture of the empty room": (SegmentationPlan(), "empty"),
}
START, GRABCUT = "starting silhouette", "GrabCut"
# Around the expected silhouette, pixels, and as a share of its extent.
MARGIN_PX, MARGIN = 12.0, 0.08
MOG2_VIDEO, MOG2_EMPTY = "MOG2, of the video", "MOG2, of the empty room"


def region_about_mask(mask: np.ndarray, size: int) -> Region:
    """The window of ``size`` cells about a mask (H, W) bool; about the whole image if it is empty.

    Args:
        mask: where the person is expected.
        size: cells to a side.
    """
    rows, columns = (np.flatnonzero(mask.any(axis)) for axis in (1, 0))
    if not len(rows):
        rows, columns = (np.array([0, n - 1]) for n in mask.shape)
    low = np.array([columns[0], rows[0]], float)
    high = np.array([columns[-1], rows[-1]], float)
    extent = float((high - low).max()) + 1
    # Of whole pixels, as ``crop`` takes it.
    side = float(np.ceil(max(extent * (1 + 2 * MARGIN) + 2 * MARGIN_PX, size)))
    origin = np.round((low + high) / 2 - side / 2) - 0.5
    return Region(origin.astype(np.float32), np.array(side / size, np.float32))


class Look(NamedTuple):
    """One instant: images, where someone is, and would be in a pose that is off; C cameras.

    Attributes:
        images: (H, W, 3) uint8 each.
        truths: (H, W) bool.
        starts: (H, W) bool.
    """

    images: list[np.ndarray]
    truths: list[np.ndarray]
    starts: list[np.ndarray]


class Scored(NamedTuple):
    """Of one image.

    Attributes:
        overlap: intersection over union.
        apart: mean distance between both outlines, pixels.
        milliseconds: it took, of the four images' time.
    """

    overlap: float
    apart: float
    milliseconds: float


Finder = Callable[[Look], list[np.ndarray]]


def overlap(mask: np.ndarray, truth: np.ndarray) -> float:
    """Intersection over union."""
    return float((mask & truth).sum() / max((mask | truth).sum(), 1))


def contour_distance(measured: np.ndarray, truth: np.ndarray) -> float:
    """Mean distance between two outlines, from each to the other, pixels; NaN if one has none."""
    edges = [outline(mask) for mask in (measured, truth)]
    if not all(edge.any() for edge in edges):
        return np.nan
    away = [cv2.distanceTransform((~edge).astype(np.uint8), cv2.DIST_L2, 5) for edge in edges]
    return float((away[0][edges[1]].mean() + away[1][edges[0]].mean()) / 2)


def outline(mask: np.ndarray) -> np.ndarray:
    """(H, W) bool: a mask's pixels with a neighbour outside."""
    filled = mask.astype(np.uint8)
    return mask & (cv2.erode(filled, np.ones((3, 3), np.uint8), borderValue=1) == 0)


def scored(finder: Finder, looks: Sequence[Look]) -> list[Scored]:
    """Every image of every look."""
    result = []
    for look in looks:
        began = perf_counter()
        masks = finder(look)
        spent = 1e3 * (perf_counter() - began)
        for mask, truth in zip(masks, look.truths, strict=True):
            result.append(Scored(overlap(mask, truth), contour_distance(mask, truth), spent))
    return result


def level_set(
    look: Look, plan: SegmentationPlan, rooms: Sequence[Background | None]
) -> list[np.ndarray]:
    """Masks by one look of the tracker."""
    phi, region = looked(look, plan, rooms)
    views = [Region(*each) for each in zip(*region, strict=True)]
    shape = look.images[0].shape[:2]
    return [full_mask(each, view, shape) for each, view in zip(phi, views, strict=True)]


def looked(
    look: Look, plan: SegmentationPlan, rooms: Sequence[Background | None]
) -> tuple[np.ndarray, Region]:
    """Φ (C, S, S) and where the canvases are, by one look of the tracker."""
    settings = Settings(plan=plan)
    size, none = settings.rim.size, np.zeros(0)
    views = [region_about_mask(start, size) for start in look.starts]
    masks = [
        mask_canvas(start, view, size) > 0.5 for start, view in zip(look.starts, views, strict=True)
    ]
    region = Region(*(np.stack(parts) for parts in zip(*views, strict=True)))
    rim = Rim(none, none, none, none, none, np.stack(masks).astype(np.uint8), region)
    before = Histograms.empty(len(views), plan)
    outlines = find_outlines(look.images, rooms, rim, before, settings)
    return np.asarray(outlines.segmentation.phi), region


def grabbed(look: Look) -> list[np.ndarray]:
    """Masks by GrabCut."""
    result = []
    for image, start in zip(look.images, look.starts, strict=True):
        near = np.ones((2 * GRABBED_PX + 1,) * 2, np.uint8)
        marks = np.where(cv2.dilate(start.astype(np.uint8), near), cv2.GC_PR_BGD, cv2.GC_BGD)
        marks = np.where(start, cv2.GC_PR_FGD, marks).astype(np.uint8)
        models = np.zeros((2, 1, 65))
        cv2.grabCut(image, marks, None, *models, GRABS, cv2.GC_INIT_WITH_MASK)  # type: ignore[call-overload]
        result.append((marks == cv2.GC_FGD) | (marks == cv2.GC_PR_FGD))
    return result


class Case:
    """A rendered recording, the models of its rooms, and its looks.

    Attributes:
        looks: those that are evaluated.
    """

    def __init__(self, clip: Clip, people: Path, who: str, seconds: float):
        """Render what is missing: poses that are off, empty rooms."""
        performer = exercise(load_rig(people, who, clip.seed), clip.group, seconds, clip.seed)
        self._views = cameras_around(performer, seconds)
        self._rng, self._performer = np.random.default_rng([clip.seed, 9]), performer
        truths = read_masks(clip.path.with_name("truth_masks.npz"))
        videos = [open_video(source) for source in Recording.load(clip.path).videos]
        with forward_readers(videos, colour=True) as readers:
            self._images = [
                [np.array(reader.at(i)) for reader in readers] for i in range(len(videos[0].times))
            ]
        self._times = videos[0].times
        evaluated = np.linspace(0, len(self._times) - 1, EVALUATED + 2).round().astype(int)[1:-1]
        self.looks = [self._look(i, truths) for i in evaluated]
        self._evaluated, self._seed = evaluated, clip.seed
        self._exposed = [self._empty(view) for view in self._views]

    def _look(self, i: int, truths: dict[str, np.ndarray]) -> Look:
        off = displaced(self._performer, self._rng)
        starts = [view.mask(off, float(self._times[i])) for view in self._views]
        return Look(self._images[i], [truths[view.name][i] for view in self._views], starts)

    def _empty(self, view: RoomCamera) -> np.ndarray:
        """(N, H, W, 3) uint8, exposures of the empty room."""
        room = view.scene(self._performer, self._seed).background
        sensor = Sensor.create(room.shape[1::-1], np.random.default_rng([self._seed, 10]))
        return np.stack([sensor.expose(room) for _ in range(EXPOSURES)])

    def rooms(self, which: str) -> Sequence[Background | None]:
        """The models of them: ``none``, ``learned`` or ``empty``."""
        if which == "empty":
            return [background_of_picture(exposed[0]) for exposed in self._exposed]
        return self._learned() if which == "learned" else [None] * len(self._views)

    def _learned(self) -> list[Background | None]:
        chosen = range(0, len(self._times), LEARNED_EVERY)
        learners = [BackgroundLearner(len(chosen)) for _ in self._views]
        plan, nothing = SegmentationPlan(), [None] * len(self._views)
        for i in chosen:
            off = displaced(self._performer, self._rng)
            starts = [view.mask(off, float(self._times[i])) for view in self._views]
            phi, region = looked(Look(self._images[i], [], starts), plan, nothing)
            for learner, image, camera, *where in zip(
                learners, self._images[i], phi, *region, strict=True
            ):
                learner.add_frame(image, camera, Region(*where))
        return [learner.background() for learner in learners]

    def subtracted(self, empty: bool) -> list[Scored]:
        """By MOG2 as it has followed the video, or learned the empty room."""
        makers = [cv2.createBackgroundSubtractorMOG2(**MOG2) for _ in self._views]
        if empty:
            for maker, exposed in zip(makers, self._exposed, strict=True):
                for image in exposed:
                    maker.apply(image)
            rate = 0.0
        else:
            rate = -1.0
        result = []
        for i, images in enumerate(self._images):
            if empty and i not in self._evaluated:
                continue

            def masks(look: Look, images: list[np.ndarray] = images) -> list[np.ndarray]:
                pairs = zip(makers, images, strict=True)
                return [maker.apply(image, None, rate) == PERSON for maker, image in pairs]

            if i in self._evaluated:
                result += scored(masks, [self.looks[int(np.flatnonzero(self._evaluated == i)[0])]])
            else:
                masks(self.looks[0])
        return result

    def results(self) -> dict[str, list[Scored]]:
        """Name of a row -> every image."""
        result = {START: scored(lambda look: look.starts, self.looks)}
        for name, (plan, which) in LEVEL_SETS.items():
            rooms = self.rooms(which)
            level_set(self.looks[0], plan, rooms)
            result[name] = scored(lambda look, p=plan, r=rooms: level_set(look, p, r), self.looks)
        result[GRABCUT] = scored(grabbed, self.looks)
        return result | {
            MOG2_VIDEO: self.subtracted(False), MOG2_EMPTY: self.subtracted(True)
        }  # fmt: skip


def text(rows: dict[str, list[Scored]]) -> str:
    """A line for each way."""
    lines = [["", "overlap, median", "mean", "10 %", "outlines, median", "mean", "time, median"]]
    for name, every in rows.items():
        over, apart, spent = np.array(every).T
        finite = apart[np.isfinite(apart)]
        figures = [np.median(over), over.mean(), np.percentile(over, 10)]
        cells = [f"{value:.3f}" for value in figures]
        cells += [f"{np.median(finite):.2f} px", f"{finite.mean():.2f} px"]
        lines.append([name, *cells, f"{np.median(spent):.0f} ms" if name != START else ""])
    return align_columns(lines)


def metrics(rows: dict[str, list[Scored]]) -> Iterator[Metric]:
    """Medians of the table."""
    for name, every in rows.items():
        over, apart, spent = np.array(every).T
        yield Metric(f"overlap, {name}", 100 * float(np.median(over)), "%", "higher", 0.05)
        yield Metric(f"outlines apart, {name}", float(np.nanmedian(apart)), "px")
        if name != START:
            yield Metric(f"four images, {name}", float(np.median(spent)), "ms")


def parser() -> argparse.ArgumentParser:
    """The command line."""
    result = command("bench.segmentation", __doc__)
    add = result.add_argument
    add("recordings", help="folder with person/person.npz")
    add("--exercises", default=",".join(EXERCISES), metavar="A,B", help="default: %(default)s")
    add("--quick", action="store_true", help="two exercises of a second each")
    add_rendered(result)
    return result


def main(arguments: Sequence[str] | None = None) -> None:
    """Parse, measure, print."""
    options = parser().parse_args(arguments)
    names = ["arm_raises", "push_ups"] if options.quick else options.exercises.split(",")
    seconds = 1.0 if options.quick else options.seconds
    people, rows = Path(options.recordings) / "person" / "person.npz", {}
    keep_compiled()
    with kept(options.keep) as keep:
        for who in options.people.split(","):
            for clip in exercises(people, names, options.seeds, [who], seconds, keep):
                for name, scores in Case(clip, people, who, seconds).results().items():
                    rows.setdefault(name, []).extend(scores)
    print(text(rows))
    write_json(list(metrics(rows)), options.json)


if __name__ == "__main__":
    main()
