"""How the hybrid tracker works: everything that a user may choose, in one place.

INPUTS: nothing. OUTPUTS: Settings, whose numbers are traced and whose choices are static.
"""

from dataclasses import fields
from typing import Literal, get_args

import numpy as np
from jax import Array

from jaxmocap.compilation.settings import counted, group, settings, static, traced
from jaxmocap.evidence.edges import EdgeEvidence
from jaxmocap.evidence.ground import KneesOverFeet
from jaxmocap.evidence.limits import JointLimits
from jaxmocap.evidence.markers import ElbowGoals, PointGoals, SearchedElbows
from jaxmocap.evidence.posture import NearPose
from jaxmocap.evidence.terms import Term
from jaxmocap.hybrid.paper.chamfer import Chamfer
from jaxmocap.images.edges import EdgeSettings
from jaxmocap.smoothing.settings import SmoothingSettings

Refinement = Literal["simplex", "gradient", "search", "none"]


@settings
class IKSettings:
    """What a user may tune of inverse kinematics; each other ``Term`` among it is reached for.

    Elbows come second: as far as the others hold, and against a weighted radian of deviation 1.
    """

    goals: PointGoals = group(PointGoals, "of markers and unmarked feet")
    elbows: ElbowGoals = group(lambda: ElbowGoals(deviation=0.03), "of the searched elbows")  # type: ignore[arg-type]
    knees: KneesOverFeet = group(
        KneesOverFeet, "of shanks over feet that no marker holds; not for algorithm 1"
    )

    solver: Literal["newton", "sdls"] = static(
        "newton",
        "the minimum of goals and secondary task by a damped Newton method; or algorithm 1 by "
        "selectively damped least squares, as in the paper",
    )
    memory: Array = traced(
        1.0,
        "of a degree of freedom about the last sample's pose, weighted radians; not for algorithm "
        "1, which remembers by few iterations",
    )
    iterations: Array = counted(30, "most iterations of algorithm 1 in a frame")
    settle: Array = counted(
        4, "iterations that it always makes, so that the secondary task acts while markers are met"
    )
    following: Array = counted(
        4,
        "iterations of it that follow the elbows of the search; as many as are needed then bring "
        "the markers home",
    )
    tolerance: Array = traced(1e-3, "distance at which it has an effector at its target, metres")
    rest: Array = traced(2e-3, "largest weighted angle of a step at which it has come to rest")
    leg_weight: Array = traced(
        0.8, "of markers and unmarked feet below the pelvis, against 1 for the others"
    )
    largest_step: Array = traced(np.pi / 4, "Gamma of equation (8), in weighted radians")
    relaxation: Array = traced(0.9, "gain of the secondary task (9)", least=0)
    uprightness: Array = traced(
        0.1, "gain of the pull of the pelvis to the upright, in the same projection", least=0
    )
    floor: Array = traced(0.0, "height of the ground, metres")
    stance_radius: Array = traced(
        0.45,
        "the head's farthest horizontal distance from the middle between the feet before they are "
        "planted again, as a fraction of the leg's length",
    )
    leg_overstretch: Array = traced(
        0.03, "distance by which an unmarked foot is missed before it is planted again, metres"
    )
    feet: Literal["follow", "stand"] = static(
        "follow",
        "feet without markers are planted again where the head has left them, and their knees bend "
        "easily; or they stand where they began, as in the paper",
    )
    augmented_body: Literal["distal", "proximal"] = static(
        "distal",
        "whose weight a joint bears in (9): of what it carries, or, in the paper's words, of what "
        "is between root and joint",
    )
    lost: Array = traced(
        0.6,
        "markers farther than this from the last pose's points: the body is placed again, metres",
    )

    @property
    def terms(self) -> tuple[Term, ...]:
        """What is reached for, in the order of the fields."""
        others = ("elbows", "knees")
        each = (getattr(self, field.name) for field in fields(self) if field.name not in others)
        return tuple(term for term in each if isinstance(term, Term))

    @property
    def secondary_terms(self) -> tuple[Term, ...]:
        """What is approached as far as the terms hold."""
        return (self.elbows,)


@settings
class ElbowSearchSettings:
    """What a user may tune of the search for elbows."""

    shoulder_slack: Array = traced(0.10, "of the shoulder's place along the upper arm, metres")
    elbow_prior: Array = traced(0.13, "of the elbow about the markers' pose, metres")
    elbow_speed: Array = traced(1.2, "of its speed against the markers' pose, metres per second")
    surprise: Array = traced(8.0, "price of any jump, nats: what the memory can be wrong by")
    fading: Array = traced(1.0, "time in which the last image is forgotten, seconds")
    drift: Array = traced(
        0.1, "share of the speed by which an elbow's deviation grows without an image"
    )


@settings
class SimplexSettings:
    """What a user may tune of the downhill simplex."""

    iterations: Array = counted(40, "most steps")
    swivel_edge: Array = traced(0.2, "of the first simplex along the arm's swivel, radians")
    other_edge: Array = traced(0.04, "of the first simplex along the other three, radians")
    elbow: Array = traced(0.02, "deviation of the elbow about the searched one, metres")
    limit: Array = traced(100.0, "price of a radian beyond a joint's range", least=0)
    hold: Array = traced(
        2000.0, "lambda of equation (14), units per metre that the grip leaves its marker", least=0
    )


@settings
class GradientSettings:
    """What a user may tune of the gradient refinement; each ``Term`` among it takes part."""

    method: Literal["levenberg-marquardt", "gauss-newton", "bfgs"] = static(
        "levenberg-marquardt", "of descent"
    )
    steps: int = static(40, "most of them")
    tolerance: float = static(
        1e-2,
        "at rest where nothing moves by more than this share of its prior's deviation; BFGS, whose "
        "first steps are short, needs a smaller one",
    )
    goals: PointGoals = group(PointGoals, "of markers and unmarked feet")
    elbows: SearchedElbows = group(SearchedElbows, "of the searched elbows")
    near: NearPose = group(NearPose, "of the pose about that of the markers alone")
    limits: JointLimits = group(JointLimits, "of the joints' ranges")

    @property
    def terms(self) -> tuple[Term, ...]:
        """The terms, in the order of the fields."""
        each = (getattr(self, field.name) for field in fields(self))
        return tuple(term for term in each if isinstance(term, Term))


@settings
class Settings:
    """How the tracker works."""

    refine: Refinement = static(
        "search",
        "what video does to the pose of the markers: the body follows the search for the elbows; "
        "then each arm is fitted by a downhill simplex, as in the paper, or the whole body by "
        "least squares, both frame by frame; or none: markers only",
    )
    search: bool = static(
        True,
        "look for the elbows globally and remember; without it frames are refined as in the paper, "
        "from the markers' pose, and nothing is carried to samples between frames: take the "
        "nearest frame then",
    )
    balance: bool = static(True, "the spine bows in a squat, so that the body stands in balance")
    region: int = static(
        160, "pixels along a side of a region of interest, in which edges are found", (16, 1024)
    )
    spacing: int = static(2, "of them per sample of the distance fields", (1, 8))
    directions: int = static(
        6, "channels into which edges are sorted; 1 is a plain field, as in the paper"
    )
    edge_detection: EdgeSettings = group(EdgeSettings, "how edges are found")
    smooth: bool = static(True, "smooth over time, what the first paper does not")
    low_pass: Array = traced(
        0.0,
        "cut-off of a low-pass over poses that are found frame by frame, hertz; 0 for none. It "
        "looks ahead",
        least=0,
    )
    margin: Array = traced(0.35, "around a region, as a fraction of the arm's extent", least=0)
    ik: IKSettings = group(IKSettings, "of inverse kinematics")
    edges: EdgeEvidence = group(EdgeEvidence, "of distances to edges")
    elbow_search: ElbowSearchSettings = group(ElbowSearchSettings, "of the search for elbows")
    simplex: SimplexSettings = group(SimplexSettings, "of the downhill simplex")
    gradient: GradientSettings = group(GradientSettings, "of the gradient refinement")
    smoothing: SmoothingSettings = group(SmoothingSettings, "over time")

    @classmethod
    def paper(cls) -> "Settings":
        """The first paper's own way (``hybrid.paper``): algorithm 1, plain edges, (13), simplex."""
        return cls(
            refine="simplex", search=False, spacing=1, directions=1, smooth=False,
            edge_detection=EdgeSettings(
                equalise="image", blur_first=False, canny="thresholds", memory=0.0
            ),
            ik=IKSettings(solver="sdls", feet="stand"),
            edges=Chamfer(),
            simplex=SimplexSettings(iterations=60),  # type: ignore[arg-type]
        )  # fmt: skip

    @property
    def gradient_terms(self) -> tuple[Term, ...]:
        """What gradient refinement minimises."""
        return (self.edges, *self.gradient.terms)

    @property
    def samples(self) -> int:
        """Along a side of a distance field."""
        return self.region // self.spacing


def unused_setting(settings: Settings, smooth: bool, causal: bool = False) -> str | None:
    """A sentence where something was chosen that has no part in what is to be done.

    Args:
        settings: that were chosen.
        smooth: whether poses are smoothed over time.
        causal: whether nothing may look ahead.
    """
    if settings.refine not in get_args(Refinement):
        return (
            f"found refine = {settings.refine!r}, expected one of {', '.join(get_args(Refinement))}"
        )
    if smooth and settings.refine not in ("none", "search"):
        return (
            f'found refine = "{settings.refine}", which fits frame by frame and has no part in '
            'smoothed poses: expected "search" or "none", or no smoothing (smooth = false in a '
            "settings file; track --paper; live without --smooth)"
        )
    if (smooth or causal) and (cutoff := float(settings.low_pass)) > 0:
        why = "has no part in smoothed poses" if smooth else "looks ahead, as no live run can"
        return f"found low_pass = {cutoff:g}, which {why}: expected 0, or track with smooth = false"
    return None
