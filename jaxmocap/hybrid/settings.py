"""How the hybrid tracker works: everything that a user may choose, in one place.

What changes the shape of the computation is static; every number is a traced array, since a Python
float in a pytree would trace anew.
"""

from dataclasses import dataclass, field
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.images.edges import EdgeSettings
from jaxmocap.smoothing.settings import SmoothingSettings


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class IKSettings:
    """What a user may tune; all traced.

    Attributes:
        iterations: most iterations of algorithm 1 in a frame.
        settle: iterations that every frame makes, so that the secondary task acts while the
            markers are met.
        following: iterations that follow the elbows seen in the video; as many as are needed then
            bring the markers home.
        wish_damping: of those elbows' step, metres per weighted radian.
        tolerance: distance at which an effector is at its target, metres.
        rest: largest weighted angle of a step at which the solve has come to rest.
        leg_weight: of markers and held feet below the pelvis, against 1 for the others.
        largest_step: Gamma of equation (8), in weighted radians.
        relaxation: gain of the secondary task (9).
        uprightness: gain of the pull of the pelvis to the upright, in the same projection.
        floor: height of the ground, metres.
        stance_radius: the head's farthest horizontal distance from the middle between the feet
            before they are planted anew, as a fraction of the leg's length.
        leg_overstretch: distance by which a held foot is missed before it is planted anew, metres.
    """

    iterations: Array
    settle: Array
    following: Array
    wish_damping: Array
    tolerance: Array
    rest: Array
    leg_weight: Array
    largest_step: Array
    relaxation: Array
    uprightness: Array
    floor: Array
    stance_radius: Array
    leg_overstretch: Array

    @classmethod
    def create(
        cls,
        iterations: int = 30,
        settle: int = 4,
        following: int = 4,
        wish_damping: float = 0.03,
        tolerance: float = 1e-3,
        rest: float = 2e-3,
        leg_weight: float = 0.8,
        largest_step: float = np.pi / 4,
        relaxation: float = 0.9,
        uprightness: float = 0.1,
        floor: float = 0.0,
        stance_radius: float = 0.45,
        leg_overstretch: float = 0.03,
    ) -> "IKSettings":
        """Settings as arrays (a Python float in a pytree would trace anew)."""
        counts = (jnp.asarray(n, jnp.int32) for n in (iterations, settle, following))
        numbers = (
            wish_damping, tolerance, rest, leg_weight, largest_step, relaxation, uprightness,
            floor, stance_radius, leg_overstretch,
        )  # fmt: skip
        return cls(*counts, *(jnp.asarray(value, float) for value in numbers))


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class EvidenceSettings:
    """What a user may tune; all traced.

    Attributes:
        truncation: distances count no more than this, metres at the limb's depth.
        edge_scale: distance that costs one unit, metres at the limb's depth.
        softness: of the raster's borders, samples.
        hold: lambda of equation (14), units per metre that the grip leaves its marker.
    """

    truncation: Array
    edge_scale: Array
    softness: Array
    hold: Array

    @classmethod
    def create(
        cls,
        truncation: float = 0.06,
        edge_scale: float = 0.0042,
        softness: float = 1.0,
        hold: float = 2000.0,
    ) -> "EvidenceSettings":
        """Settings as arrays (a Python float in a pytree would trace anew)."""
        return cls(*(jnp.asarray(v, float) for v in (truncation, edge_scale, softness, hold)))


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class SearchSettings:
    """What a user may tune; all traced.

    Attributes:
        shoulder_slack: standard deviation of the shoulder's place along the upper arm, metres.
        elbow_prior: standard deviation of the elbow about the markers' pose, metres.
        elbow_speed: standard deviation of its speed against the markers' pose, metres per second.
        surprise: price of any jump, in nats: what the memory can be wrong by.
    """

    shoulder_slack: Array
    elbow_prior: Array
    elbow_speed: Array
    surprise: Array

    @classmethod
    def create(
        cls,
        shoulder_slack: float = 0.10,
        elbow_prior: float = 0.13,
        elbow_speed: float = 1.2,
        surprise: float = 8.0,
    ) -> "SearchSettings":
        """Settings as arrays (a Python float in a pytree would trace anew)."""
        values = (shoulder_slack, elbow_prior, elbow_speed, surprise)
        return cls(*(jnp.asarray(value, float) for value in values))


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class RefineSettings:
    """What a user may tune; all traced.

    Attributes:
        iterations: most steps of the simplex.
        swivel_edge: of the first simplex along the arm's swivel, radians.
        other_edge: of the first simplex along the other three, radians.
        trust: standard deviation of the elbow about the searched one, metres.
        limit: price of a radian beyond a joint's range.
    """

    iterations: Array
    swivel_edge: Array
    other_edge: Array
    trust: Array
    limit: Array

    @classmethod
    def create(
        cls,
        iterations: int = 40,
        swivel_edge: float = 0.2,
        other_edge: float = 0.04,
        trust: float = 0.02,
        limit: float = 100.0,
    ) -> "RefineSettings":
        """Settings as arrays (a Python float in a pytree would trace anew)."""
        numbers = (jnp.asarray(value, float) for value in (swivel_edge, other_edge, trust, limit))
        return cls(jnp.asarray(iterations, jnp.int32), *numbers)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class GradientSettings:
    """What a user may tune of the gradient refinement; all but the first three are traced.

    Attributes:
        method: "levenberg-marquardt", "gauss-newton" or "bfgs" (static).
        steps: most of them (static).
        tolerance: at rest where nothing moves by more than this share of its prior's deviation
            (static); BFGS, whose first steps are short, wants a smaller one.
        marker: standard deviation of a marker about its point on the body, metres.
        elbow: of an elbow about the searched one, metres; its tails are long.
        bend: distance to an edge at which its price turns from square to straight, metres.
        shift: standard deviation of the pelvis about the markers' pose, metres.
        turn: the same of its orientation, radians.
        lean: of the pelvis from the vertical, radians.
        spine: of each of its joints about the markers' pose, radians.
        neck: the same.
        arm: the same.
        leg: the same.
        limit: by which a joint may exceed its range, radians.
    """

    method: Literal["levenberg-marquardt", "gauss-newton", "bfgs"] = field(
        metadata={"static": True}
    )
    steps: int = field(metadata={"static": True})
    tolerance: float = field(metadata={"static": True})
    marker: Array
    elbow: Array
    bend: Array
    shift: Array
    turn: Array
    lean: Array
    spine: Array
    neck: Array
    arm: Array
    leg: Array
    limit: Array

    @classmethod
    def create(
        cls,
        method: Literal["levenberg-marquardt", "gauss-newton", "bfgs"] = "levenberg-marquardt",
        steps: int = 20,
        tolerance: float = 1e-2,
        marker: float = 0.004,
        elbow: float = 0.02,
        bend: float = 0.005,
        shift: float = 0.1,
        turn: float = 0.3,
        lean: float = 0.15,
        spine: float = 0.1,
        neck: float = 0.4,
        arm: float = 1.0,
        leg: float = 0.4,
        limit: float = 0.02,
    ) -> "GradientSettings":
        """Settings as arrays (a Python float in a pytree would trace anew)."""
        numbers = (marker, elbow, bend, shift, turn, lean, spine, neck, arm, leg, limit)
        return cls(method, steps, tolerance, *(jnp.asarray(value, float) for value in numbers))


def _static(default: object) -> Any:
    return field(default=default, metadata={"static": True})


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Settings:
    """How the tracker works. The first eight are static; the rest are traced.

    Attributes:
        refine: "simplex" (each arm by itself, the paper's way), "gradient" (the whole body by
            least squares, differentiable), or "none" for markers only.
        search: look for the elbows globally and remember; without it the simplex starts from the
            markers' pose in every frame, as in the paper.
        evidence: "outline" (mean distance along it) or "raster" (the paper's sum, (13)).
        balance: bow the spine in a squat.
        region: pixels along a side of a region of interest, in which edges are found.
        spacing: of them per sample of the distance fields.
        directions: channels into which edges are sorted; 1 is the paper's plain field.
        edges: how edges are found.
        margin: around a region, as a fraction of the arm's extent.
        ik: of inverse kinematics.
        fit: of the evidence.
        look: of the search.
        polish: of the simplex.
        descent: of the gradient refinement.
        smooth: smooth over the whole recording where it is there as a whole (static).
        over_time: of that smoothing.
    """

    refine: Literal["simplex", "gradient", "none"] = _static("simplex")
    search: bool = _static(True)
    evidence: Literal["outline", "raster"] = _static("outline")
    balance: bool = _static(True)
    region: int = _static(160)
    spacing: int = _static(2)
    directions: int = _static(6)
    edges: EdgeSettings = field(default=EdgeSettings(), metadata={"static": True})
    margin: Array = field(default_factory=lambda: jnp.asarray(0.35, float))
    ik: IKSettings = field(default_factory=IKSettings.create)
    fit: EvidenceSettings = field(default_factory=EvidenceSettings.create)
    look: SearchSettings = field(default_factory=SearchSettings.create)
    polish: RefineSettings = field(default_factory=RefineSettings.create)
    descent: GradientSettings = field(default_factory=GradientSettings.create)
    smooth: bool = _static(True)
    over_time: SmoothingSettings = field(default_factory=SmoothingSettings.create)

    @classmethod
    def paper(cls) -> "Settings":
        """The first paper's own way: plain edges, its sum, the simplex, one pass, no memory."""
        return cls(
            search=False, evidence="raster", directions=1, spacing=1,
            edges=EdgeSettings(equalise=True), smooth=False,
        )  # fmt: skip

    @property
    def samples(self) -> int:
        """Along a side of a distance field."""
        return self.region // self.spacing
