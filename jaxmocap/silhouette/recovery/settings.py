"""What a user may tune of finding lost limbs.

INPUTS: nothing. OUTPUTS: RecoverySettings and its parts, whose defaults were chosen on rendered
exercises.
"""

from typing import NamedTuple

from jax import Array


class LimbSearchSettings(NamedTuple):
    """Numbers of the particle filter; traced.

    Attributes:
        uniform_share: of the particles that are drawn evenly from all of the joints' ranges.
        spreads: deviations of the others about those before, layer by layer, radians.
        inverse_temperatures: by what a log-ratio counts in the weights, layer by layer.
        angle_deviation: of an angle about the pose given, radians: of two that explain alike, the
            nearer.
    """

    uniform_share: Array | float = 0.35
    spreads: Array | tuple[float, ...] = (0.5, 0.25, 0.1)
    inverse_temperatures: Array | tuple[float, ...] = (4.0, 10.0, 25.0)
    angle_deviation: Array | float = 2.0


class ChromaticitySettings(NamedTuple):
    """How alike colours are; static.

    Attributes:
        deviation: of a chromaticity about its mean, shares of all three colours.
        largest_cost: half squared deviations are cut off here.
        least_gain: weight of a new frame in the mean, at least.
        depth_margin_m: a point so far behind the nearest about its cell is visible as well.
    """

    deviation: float = 0.04
    largest_cost: float = 8.0
    least_gain: float = 0.05
    depth_margin_m: float = 0.05


class LimbLikelihood(NamedTuple):
    """Log-ratios of a limb against what else may be visible in its place; static.

    Attributes:
        chromaticity: how alike colours are.
        largest_colour: of what surely has the limb's chromaticity and not that of the rest.
        other_cost: half the squared deviations from the limb's chromaticity beyond which any is
            likelier: about the log of a normal density at its mean by an even one.
        occluder: of what is neither background nor body, nor of the limb's chromaticity: the limb
            may be behind it.
        penetration_cost: of lying wholly within other parts of the body.
        least_visible: however little is visible of a limb, another place must show more than this.
    """

    chromaticity: ChromaticitySettings = ChromaticitySettings()
    largest_colour: float = 2.5
    other_cost: float = 4.0
    occluder: float = 0.1
    penetration_cost: float = 1.0
    least_visible: float = -0.05


class PartAppearanceSettings(NamedTuple):
    """When a part of the body has another colour than before.

    Attributes:
        deviations: so many from the mean,
        share: and so much of all three colours.
        gain: weight of a new frame in mean and variance, at least.
        youngest: frames before a mean counts.
        least_points: visible points that make a mean.
        longest: after so many frames a part has changed its colour for good: somebody put on a
            coat.
    """

    deviations: float = 4.0
    share: float = 0.03
    gain: float = 0.1
    youngest: int = 5
    least_points: int = 8
    longest: int = 90


class ProjectionSettings(NamedTuple):
    """The canvas that limbs are searched on.

    Attributes:
        node_stride: of the surface's nodes one in so many is drawn.
        cell_margin: cells about such a node that it covers.
        size: of the canvas, cells.
        extent: of the canvas, by that of the segmentation's.
        background_log_ratio: of what surely is, or is not, background beyond the segmentation.
    """

    node_stride: int = 8
    cell_margin: int = 1
    size: int = 96
    extent: float = 1.5
    background_log_ratio: float = 2.0


class RecoverySettings(NamedTuple):
    """When a limb is searched for, and when it is believed to be elsewhere.

    Attributes:
        reach: of a limb, by its length, within which person without a body counts.
        unexplained_share: so much of it, by the limb's own size, calls for a search;
        person_log_ratio: of its cells, which are so much likelier person than not.
        contradicted: a limb that explains less than minus this is searched for.
        weak: one that explains less than this is, where there is unexplained person.
        least_gain: mean log-ratio by which a better place must explain more.
        earlier_gain: the same of a place where an earlier pass found the limb,
        earlier_distance_m: if that is so far away.
        weakest_rest: log-ratios are no less than minus this: half of a limb in the right place is
            a beginning.
        hidden_log_ratio: a part whose cells are less likely person than this is hidden.
        longest_wait: frames after a search that found nothing, at most; twice as long each time.
        promising_share: a place that explains more by this share of ``least_gain`` is not nothing.
        likelihood: of limbs.
        parts: their appearance.
        projection: of the body.
    """

    reach: float = 1.6
    unexplained_share: float = 0.08
    person_log_ratio: float = 1.5
    contradicted: float = 0.1
    weak: float = 0.2
    least_gain: float = 0.15
    earlier_gain: float = 0.08
    earlier_distance_m: float = 0.05
    weakest_rest: float = 0.7
    hidden_log_ratio: float = 0.0
    longest_wait: int = 2
    promising_share: float = 0.5
    likelihood: LimbLikelihood = LimbLikelihood()
    parts: PartAppearanceSettings = PartAppearanceSettings()
    projection: ProjectionSettings = ProjectionSettings()
