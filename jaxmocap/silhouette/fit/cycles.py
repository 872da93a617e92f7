"""From a predicted pose to a fitted one: rim, contour, pairs, solve, cycle by cycle.

A new pose is another start of the segmentation, and new contours are another aim of the pose. The
paper iterates both until they converge (section 5); where that is asked for, they go on in turn
until neither changes the other any more.

INPUTS: a frame's images and background models, a predicted pose. OUTPUTS: a FittedPose; what
is left of its information without the pairs of some joints. Which cameras count, by how rim and
contour match and how they agree with the others.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from scipy.spatial import KDTree

from jaxmocap.body.model import Model
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.body.tree import ROOT_DOF
from jaxmocap.compilation.programs import Program, program
from jaxmocap.evidence.keypoints import KeyPoints
from jaxmocap.evidence.markers import MarkerPositions
from jaxmocap.evidence.terms import Measurements
from jaxmocap.geometry.cameras import Camera
from jaxmocap.images.background_model import Background
from jaxmocap.silhouette.first_pose import landmark_points
from jaxmocap.silhouette.fit.correspond import (
    Contour,
    ContourPairs,
    Matches,
    match_pairs,
    pairs_of,
)
from jaxmocap.silhouette.pose import PoseResult, PoseSettings, Prior, TermEvidence, solve_pose
from jaxmocap.silhouette.segmentation.inner_edges import (
    EDGE_WEIGHT,
    concatenate_pairs,
    inner_edge_pairs,
)
from jaxmocap.silhouette.segmentation.outlines import Outlines, find_outlines
from jaxmocap.silhouette.segmentation.segment import Histograms
from jaxmocap.silhouette.settings import Cycle, Settings
from jaxmocap.silhouette.state import TrackedBody, TrackerConstants
from jaxmocap.silhouette.surfaces.morph import Morph, without_followers
from jaxmocap.silhouette.surfaces.rim import Rim

# A pose has settled where its landmarks move no farther in a round, on average, metres. What
# outlines hardly determine, as a hand's turn, moves on by more.
POSE_M = 0.001
# Contours have settled where their points lie no farther across those of the round before, on
# average, cells of the canvas: pixels of the image are the finer the larger it is.
CONTOUR_CELLS = 0.05
_free_pose = Program(without_followers, "free_pose", effort="full")


@program("full")
def fit(
    skeleton: Skeleton,
    cameras: Camera,
    pose: Pose,
    pairs: ContourPairs,
    settings: PoseSettings,
    prior: Prior,
    beside: TermEvidence | None = None,
    morph: Morph | None = None,
) -> PoseResult:
    """The pose that brings the rims' points to the contours' rays; see ``solve_pose``."""
    rays = pairs_of(cameras, pairs)
    return solve_pose(skeleton, pose, rays, settings, prior, beside=beside, morph=morph)


def matched_shares(rim: Rim, pairs: Matches, points: Sequence[int]) -> np.ndarray:
    """(C,) the smaller of the shares of rim points and of contour points that found a partner.

    ``points`` are as many as each camera's contour has.
    """
    outline = rim.valid & ~rim.inner
    shares = []
    for camera, count in enumerate(points):
        width = int((~rim.inner[camera]).sum())
        of_rim = pairs.valid[camera, :width].sum() / max(outline[camera].sum(), 1)
        taken = min(count, pairs.valid.shape[1] - width)
        of_contour = pairs.valid[camera, width:].sum() / max(taken, 1)
        shares.append(min(of_rim, of_contour))
    return np.array(shares)


def disagreeing(distances: np.ndarray, real: np.ndarray, apart: float, near: float) -> np.ndarray:
    """(C,) bool: cameras whose pairs lie much farther apart than all cameras' together.

    By distances (C, N), metres, of those that are pairs: ``apart`` times as far, unless they are
    within ``near``, metres. Of two it is open which is wrong.
    """
    if real.any(1).sum() < 3:
        return np.zeros(len(real), bool)
    each = np.array(
        [np.median(d[r]) if r.any() else 0.0 for d, r in zip(distances, real, strict=True)]
    )
    usual = np.median(each[real.any(1)])
    return each > max(near, apart * usual)


def kept_histograms(used: np.ndarray, new: Histograms, old: Histograms) -> Histograms:
    """The new histograms of cameras that were used, the old ones of the others."""
    mask = jnp.asarray(used)[:, None]
    return Histograms(*(jnp.where(mask, a, b) for a, b in zip(new, old, strict=True)))


def combined_prior(expected: Pose, deviations: np.ndarray, rest: np.ndarray) -> Prior:
    """The prior of a pose that the motion expects to deviations (6 + D,), metres and radians.

    ``rest`` (D,) are those about 0, radians; infinite for joints that are not held there.
    """
    moving, still = deviations[ROOT_DOF:] ** -2.0, rest**-2.0
    both = moving + still
    angles = (moving / both * np.asarray(expected.angles)).astype(np.float32)
    joined = np.concatenate([deviations[:ROOT_DOF], both**-0.5]).astype(np.float32)
    return Prior(expected._replace(angles=jnp.asarray(angles)), jnp.asarray(joined))


class FrameEvidence(NamedTuple):
    """What a frame brings, and what was learned before it is segmented."""

    # (H, W, 3) BGR uint8 of each camera, None where it shows nothing of use.
    images: Sequence[np.ndarray | None]
    backgrounds: Sequence[Background | None]  # of each camera, None where unknown
    histograms: Histograms  # of the frames before
    beside: TermEvidence | None  # evidence that is no image, such as markers, where there is any
    is_first: bool


class FittedPose(NamedTuple):
    """How the last cycle ended."""

    result: PoseResult
    used: np.ndarray  # (C,) bool: cameras that counted
    matched_shares: np.ndarray  # (C,) of rim and contour that found a partner
    outlines: Outlines
    pairs: ContourPairs  # with what robust weighting leaves of their weights


def fit_pose(
    constants: TrackerConstants,
    body: TrackedBody,
    frame: FrameEvidence,
    predicted: Pose,
    deviations: np.ndarray,
) -> FittedPose:
    """The pose that brings the body's rims to the contours, from the one predicted.

    ``deviations`` (6 + D,) are the prior's about that, metres and radians.
    """
    s, morph = constants.settings, constants.finder.morph
    centre = predicted if morph is None else _free_pose(morph, predicted)
    prior = combined_prior(centre, deviations, constants.rest_deviations)
    first, *rest = (*(s.starting_cycles if frame.is_first else ()), *s.cycles)
    fitted = _run_cycle(constants, body, frame, prior, first, predicted)
    for cycle in rest:
        fitted = _run_cycle(constants, body, frame, prior, cycle, fitted.result.pose, fitted)
    again = s.cycles[-1]._replace(segments=True)
    for _ in range(s.settling_rounds):
        before = fitted
        fitted = _run_cycle(constants, body, frame, prior, again, before.result.pose, before)
        poses = before.result.pose, fitted.result.pose
        outlines = before.outlines, fitted.outlines
        if has_settled(body.shape.skeleton, poses, outlines):
            break
    return fitted


def _run_cycle(
    constants: TrackerConstants,
    body: TrackedBody,
    frame: FrameEvidence,
    prior: Prior,
    cycle: Cycle,
    pose: Pose,
    before: FittedPose | None = None,
) -> FittedPose:
    """One cycle from a pose, with what the cycle before left, if there was one."""
    s = constants.settings
    rim = constants.finder.find(body.shape, pose, constants.cameras, cycle.level)
    if before is None or cycle.segments:
        outlines = find_outlines(frame.images, frame.backgrounds, rim, frame.histograms, s)
        used = np.ones(len(frame.images), bool)
    else:
        outlines, used = before.outlines, before.used
    pairs, shares, used = _pair_contours(constants, body, frame, rim, outlines, used, cycle.level)
    how = PoseSettings(deviation=cycle.deviation, iterations=s.iterations)
    skeleton, cameras, morph = body.shape.skeleton, constants.cameras, constants.finder.morph
    result = fit(skeleton, cameras, pose, pairs, how, prior, frame.beside, morph)
    weights = pairs.weights
    distances = np.asarray(result.distances).reshape(weights.shape)
    used = used & ~disagreeing(distances, np.asarray(weights) > 0, s.disagreement, s.agreement_m)
    robust = np.asarray(result.shares).reshape(weights.shape)
    left = pairs._replace(weights=robust * weights)
    return FittedPose(result, used, shares, outlines, left)


def _pair_contours(
    constants: TrackerConstants,
    body: TrackedBody,
    frame: FrameEvidence,
    rim: Rim,
    outlines: Outlines,
    used: np.ndarray,
    level: int,
) -> tuple[ContourPairs, np.ndarray, np.ndarray]:
    """Pairs of rim and contour and of inner edges; shares that matched; cameras (C,) that count."""
    s = constants.settings
    matches = match_pairs(rim, outlines.contours)
    counts = [len(contour.pixels_xy) for contour in outlines.contours]
    shares = matched_shares(rim, matches, counts)
    used = used & (shares >= s.least_matched_share)
    edges = inner_edge_pairs(frame.images, rim, constants.carriers)
    weights = np.concatenate([matches.valid, EDGE_WEIGHT * edges.valid], 1)
    matches = concatenate_pairs(matches, edges)
    weights = (weights * used[:, None]).astype(np.float32)
    points = body.shape.points(matches.nodes, level)
    moves = constants.finder.moves(matches.nodes)
    pixels, normals = matches.pixels_xy, matches.normals
    pairs = ContourPairs(points, pixels, normals, weights, matches.nodes, moves)
    return pairs, shares, used


def has_settled(
    skeleton: Skeleton,
    poses: tuple[Pose, Pose],
    outlines: tuple[Outlines, Outlines],
) -> bool:
    """Whether poses and cameras' contours of a round are those of the round before."""
    here, there = (np.asarray(landmark_points(skeleton, pose)) for pose in poses)
    if np.linalg.norm(there - here, axis=1).mean() > POSE_M:
        return False
    before, now = outlines
    scales = np.asarray(now.region.scale)
    return contours_apart(before.contours, now.contours, scales) <= CONTOUR_CELLS


def contours_apart(
    before: Sequence[Contour], now: Sequence[Contour], scales: Sequence[float] | np.ndarray
) -> float:
    """Mean distance across the old contours of the new ones' points, cells, of C cameras.

    Cells are ``scales`` (C,) pixels wide.

    Infinite where a camera shows the person in only one of the two; 0 where none does.
    """
    apart = []
    for old, new, scale in zip(before, now, scales, strict=True):
        if not len(old.pixels_xy) or not len(new.pixels_xy):
            if len(old.pixels_xy) or len(new.pixels_xy):
                return np.inf
            continue
        nearest = KDTree(old.pixels_xy).query(new.pixels_xy)[1]
        away = new.pixels_xy - old.pixels_xy[nearest]
        apart.append(np.abs(np.sum(away * old.normals[nearest], 1)) / scale)
    return float(np.mean(np.concatenate(apart))) if apart else 0.0


def information_without(
    constants: TrackerConstants,
    body: TrackedBody,
    hidden: np.ndarray,
    pose: Pose,
    pairs: ContourPairs,
    measured: Measurements,
) -> PoseResult:
    """Hessian and slope at a pose by its pairs, without those of hidden joints (D,).

    For what hides a part has outlines too; ``measured`` of the frame, see ``term_evidence``.
    """
    s, skeleton = constants.settings, body.shape.skeleton
    moved = np.any(skeleton.tree.carries[ROOT_DOF:][hidden], 0)
    gone = moved[constants.carriers[pairs.nodes]]
    weights = np.where(gone, np.float32(0), pairs.weights)
    # The pairs have their robust weights already.
    how = PoseSettings(deviation=s.cycles[-1].deviation, reach=np.inf, iterations=0)
    flat = np.full(skeleton.costs.shape, s.predicted_deviation)
    here = combined_prior(pose, flat, constants.rest_deviations)
    beside = term_evidence(body.model, measured, s)
    visible, morph = pairs._replace(weights=weights), constants.finder.morph
    return fit(skeleton, constants.cameras, pose, visible, how, here, beside, morph)


def term_evidence(model: Model, measured: Measurements, settings: Settings) -> TermEvidence | None:
    """What the settings' terms have to say; None where markers or key points would, without any.

    ``measured`` of a frame are ``markers`` (M, 3) where there are any, world, metres, NaN where one
    is missing, and ``sight_lines`` to key points.
    """
    count = len(model.markers.bone_indices)
    idle = (() if count else (MarkerPositions,)) + (
        (KeyPoints,) if measured.sight_lines is None else ()
    )
    terms = tuple(term for term in settings.terms if not isinstance(term, idle))
    if not terms:
        return None
    if measured.markers is None:
        measured = measured._replace(markers=np.full((count, 3), np.nan, np.float32))
    return TermEvidence(model, terms, measured)
