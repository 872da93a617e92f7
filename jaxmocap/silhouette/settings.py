"""What a user may tune of the silhouette tracker.

INPUTS: nothing. OUTPUTS: Settings, whose defaults were chosen on rendered exercises.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

from jaxmocap.body.surfaces.morphing import Morphing
from jaxmocap.evidence.keypoints import KeyPoints
from jaxmocap.evidence.markers import MarkerPositions
from jaxmocap.evidence.terms import Term
from jaxmocap.silhouette.keypoint_poses import KeypointPoseSettings
from jaxmocap.silhouette.segmentation import segment
from jaxmocap.silhouette.smoothing import PoseSmoothingSettings
from jaxmocap.silhouette.surfaces.body_shape import FULL
from jaxmocap.silhouette.surfaces.rim import RimSettings


class Cycle(NamedTuple):
    """A rim, its pairs with the contours, and a solve."""

    # Of points about their rays, metres. At first it must be large: a limb that moved fast is an
    # outlier to the rest, and would be left behind. At last it is small: what another limb's
    # outline was taken for is an outlier then.
    deviation: float
    # Of the surface's low-passes (``RimSettings.levels``) that is matched; ``FULL`` for all its
    # frequencies.
    level: int = FULL
    # Whether it begins with a segmentation; a frame's first does in any case.
    segments: bool = False


# The paper's own feature: grey levels alone, without a model of the room, whose are colours.
GREY = segment.SegmentationPlan(colour=False, background=False)
# Of a first pose that is off by 10 degrees and 6 cm: half of such poses are then found.
FAR_OFF = (Cycle(0.08, 0, True), Cycle(0.08, 0, True))


def progressive(cycles: tuple[Cycle, ...], levels: int, available: int) -> tuple[Cycle, ...]:
    """Cycles of which the first match the surface's finest low-passes, coarse to fine.

    So many ``levels``, one a cycle; where there are too few cycles, the first is repeated.

    Raises:
        ValueError: more levels than there are.
    """
    if levels > available:
        raise ValueError(f"found {levels} levels, expected {available} at most")
    repeated = (cycles[0]._replace(segments=False),) * (levels + 1 - len(cycles))
    longer = (*cycles[:1], *repeated, *cycles[1:])
    chosen = range(available - levels, available)
    coarse = (cycle._replace(level=level) for cycle, level in zip(longer, chosen, strict=False))
    return (*coarse, *longer[levels:])


@dataclass(frozen=True)
class Settings:
    """How to work.

    Attributes:
        body: file in ``body/data`` whose joints move the person, and whose parts are tracked.
        rim: sizes; its canvases are the level sets' too, so that its margin holds a step's error.
        level_set: of the segmentation, traced.
        plan: of it, static.
        points: of each camera's contour, static.
        contrast: least of a contour's point, 0 to 1: below, the image does not separate its two
            sides.
        cycles: of every frame.
        starting_cycles: before those in the first frame, where its pose may be far off, such as
            ``FAR_OFF``. From a pose nearly right they lead to no better one.
        settling_rounds: of a segmentation and a solve in turn after these cycles, at most, until
            neither changes the other; 0 for none.
        iterations: of the pose in each cycle.
        predicted_deviation: of every degree of freedom about its prediction, metres and radians.
            Pairs of one outline err alike, and count as if they did not: more freedom than this
            lets a stretched arm turn over.
        expected_deviation: the same about where key points have the person.
        expected_place: that of the pelvis' place where there is one camera, metres: to one, a body
            that is 1 % too wide is as one 1 % nearer.
        undetermined_deviation: the same of one that the last frame did not determine.
        rest: factor on the skeleton's ``rest_deviations``, of joints that outlines hardly
            determine; see ``expected_pose``.
        morphing: what goes along with the joints' angles; ``Morphing()`` for nothing. Joints that
            do are held at rest about where they go.
        unknown_deviation: of a degree of freedom that nothing determines.
        determined_share: a degree of freedom is determined where its deviation falls below this
            share of ``predicted_deviation``, and observed where below this share of
            ``unknown_deviation``.
        damping: share of the velocity that the next frame is predicted with.
        velocity_gain: weight of a frame's own velocity.
        changed_share: an image that differs from the last of its camera in more than this share of
            it is torn, black or another camera's, and ignored.
        patience: frames of a camera, one after the other, that may be ignored so.
        particles: of where a limb is that may be lost, static; 1 for the estimated pose alone.
        smoothing: of all frames of a recording together.
        terms: of evidence beside the images. Markers count where any are followed, key points
            where there are any; hundreds of pairs that err alike stand against each.
        keypoint_poses: of poses by key points alone.
        least_matched_share: of a camera's rim and contour that must find a partner.
        disagreement: a camera whose pairs lie so many times as far apart as all is left out,
        agreement_m: unless they are within this.
        settling_steps: times that the first frame is tracked before the second.
    """

    body: str = "supple.toml"
    rim: RimSettings = field(default_factory=lambda: RimSettings(margin=0.1))
    level_set: segment.LevelSetSettings = field(default_factory=segment.LevelSetSettings)
    plan: segment.SegmentationPlan = field(default_factory=segment.SegmentationPlan)
    points: int = 512
    contrast: float = 0.1
    cycles: tuple[Cycle, ...] = (Cycle(0.03, segments=True), Cycle(0.008), Cycle(0.004))
    starting_cycles: tuple[Cycle, ...] = ()
    settling_rounds: int = 0
    iterations: int = 4
    predicted_deviation: float = 0.08
    expected_deviation: float = 0.03
    expected_place: float = 0.01
    undetermined_deviation: float = 0.02
    rest: float = 1.0
    morphing: Morphing = field(default_factory=Morphing)
    unknown_deviation: float = 0.25
    determined_share: float = 0.5
    damping: float = 0.8
    velocity_gain: float = 0.7
    changed_share: float = 0.16
    patience: int = 15
    particles: int = 128
    smoothing: PoseSmoothingSettings = field(default_factory=PoseSmoothingSettings)
    terms: tuple[Term, ...] = field(
        default_factory=lambda: (MarkerPositions(deviation=0.003), KeyPoints(deviation=0.005))  # type: ignore[arg-type]
    )
    keypoint_poses: KeypointPoseSettings = field(default_factory=KeypointPoseSettings)
    least_matched_share: float = 0.4
    disagreement: float = 3.0
    agreement_m: float = 0.03
    settling_steps: int = 4
