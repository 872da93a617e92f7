"""What a user may tune of the silhouette tracker.

INPUTS: nothing. OUTPUTS: Settings, whose defaults were chosen on rendered exercises.
"""

from dataclasses import dataclass, field

from jaxmocap.silhouette.correspond import MatchSettings
from jaxmocap.silhouette.recovery.limb_particle_filter import SearchSettings
from jaxmocap.silhouette.segmentation import segment
from jaxmocap.silhouette.segmentation.inner_edges import EdgeSettings
from jaxmocap.silhouette.smoothing import SmoothingSettings
from jaxmocap.silhouette.surfaces.morph import Morphing
from jaxmocap.silhouette.surfaces.rim import RimSettings

# What finds starts that are off by 10 degrees and 6 cm, half of them.
FAR_OFF = (0.08, 0.08)


@dataclass(frozen=True)
class Settings:
    """How to work.

    Attributes:
        rim: sizes; its canvases are the level sets' too, so that its margin holds a step's error.
        match: what makes a pair of rim and contour.
        level_set: of the segmentation, traced.
        sharpen: whether pixels then say where exactly its contours are.
        points: of each camera's contour, static.
        contrast: least of a contour's point, 0 to 1: below, the image does not tell its two sides.
        deviations: of points about their rays, metres, one cycle each. The first must be large: a
            limb that moved fast is an outlier to the rest, and would be left behind. The last is
            small: what another limb's outline was taken for is an outlier then.
        starting: the same of cycles before those in the first frame, where its pose may be far
            off, such as ``FAR_OFF``: each looks anew, and matches the surface's low-pass (coarse
            to fine). From a pose nearly right they lead to no better one.
        looks: cycles that begin with a segmentation; the first does in any case.
        edges: what shows one limb before another.
        iterations: of the pose in each cycle.
        expected: deviation of every degree of freedom about its prediction, metres and radians.
            Pairs of one outline err alike, and count as if they did not: more freedom than this
            lets a stretched arm turn over.
        held: the same of one of which the last frame told little.
        held_at_rest: factor on the skeleton's ``rest_deviations``, of joints that outlines tell
            little of; see ``expected_pose``.
        morphing: what goes along with the joints' angles; ``Morphing()`` for nothing. Joints that
            do are held at rest about where they go.
        blind: deviation of a degree of freedom of which nothing is known.
        told: it is told of where its deviation falls below this share of ``expected``, and seen
            where below this share of ``blind``.
        damping: share of the velocity that the next frame is predicted with.
        newest: weight of a frame's own velocity.
        changed: an image that differs from the last of its camera in more than this share of it is
            torn, black or another camera's, and not looked at.
        patience: frames of a camera, one after the other, that may be passed over so.
        hypotheses: of where a limb is that may be lost, static; 1 for the pose found alone.
        search: among them.
        smoothing: of all frames of a recording together; None leaves them as they were found.
        marked: deviation of markers, metres, where they are followed too. Hundreds of pairs that
            err alike stand against each.
        share: of a camera's rim and contour that must find each other.
        apart: a camera whose pairs lie so many times as far apart as all is left out.
        near: unless they are within this, metres.
        settling: times that the first frame is looked at before tracking begins.
    """

    rim: RimSettings = field(default_factory=lambda: RimSettings(margin=0.1))
    match: MatchSettings = field(default_factory=MatchSettings)
    level_set: segment.Settings = field(default_factory=segment.Settings)
    sharpen: bool = True
    points: int = 512
    contrast: float = 0.1
    deviations: tuple[float, ...] = (0.03, 0.008, 0.004)
    starting: tuple[float, ...] = ()
    looks: tuple[int, ...] = (0,)
    edges: EdgeSettings = field(default_factory=EdgeSettings)
    iterations: int = 4
    expected: float = 0.08
    held: float = 0.02
    held_at_rest: float = 1.0
    morphing: Morphing = field(default_factory=Morphing)
    blind: float = 0.25
    told: float = 0.5
    damping: float = 0.8
    newest: float = 0.7
    changed: float = 0.16
    patience: int = 15
    hypotheses: int = 128
    search: SearchSettings = field(default_factory=SearchSettings)
    smoothing: SmoothingSettings | None = field(default_factory=SmoothingSettings)
    marked: float = 0.003
    share: float = 0.4
    apart: float = 3.0
    near: float = 0.03
    settling: int = 4
