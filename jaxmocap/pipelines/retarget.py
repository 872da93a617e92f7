"""A tracked motion played by another person.

INPUTS: a folder that ``track`` or ``silhouette track`` wrote, or its motion.npz; a subject file, or
a folder of ``silhouette model``.
OUTPUTS: that person's motion in every format, with their skin where it was measured; recording.rrd;
retargeted.png, a picture of both.

Joints bend as they did (second paper, Figs. 6, 32). What is left is where the pelvis goes: as it
went, by the length of the legs, but so that feet on the ground are there, and go no further than
they went.
"""

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy.linalg import solveh_banded

from jaxmocap.body.motion import Motion, landmarks_over_time
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import LANDMARKS, Skeleton
from jaxmocap.body.surfaces.surface import Surface
from jaxmocap.capture.photographs import picture_of
from jaxmocap.evaluation.plots import plot_stick_figures
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.files.output_folder import OutputFolder
from jaxmocap.formats.motion_npz import load_motion
from jaxmocap.formats.recordings.subject import read_subject
from jaxmocap.outputs.viewer import write_rerun
from jaxmocap.pipelines.silhouettes.person import person_files, read_person
from jaxmocap.pipelines.writing import MOTION, MOTION_FILES, Warn, ignore_warning, write_motion

FEET = ("ankle_l", "toe_l", "ankle_r", "toe_r")
# A foot's end is on the ground so near to its usual lowest place, metres and per cent.
NEAR_M, USUAL_LOWEST = 0.03, 5.0
# How firmly, against the pelvis's own way from frame to frame: feet on the ground go as they went,
# and keep their height; the pelvis does not drift from its way where none is on the ground.
STAY, HEIGHT, ANCHOR = 100.0, 1.0, 1e-4


def retarget_motion(motion: Motion, skeleton: Skeleton) -> Motion:
    """The motion, played by another person.

    The skeleton is the other's, with the same bones; the motion's joints move it. Where a pose is
    missing, it stays so.

    Raises:
        ValueError: the bones are others, or every pose is missing.
    """
    whole, is_posed = motion, _is_posed(motion)
    motion = _posed_part(motion)
    if not len(motion.times):
        raise ValueError("expected a pose; found none")
    mine, other = motion.skeleton, skeleton
    if other.tree.bones != mine.tree.bones:
        raise ValueError(
            f"expected the bones {', '.join(mine.tree.bones)}; found {', '.join(other.tree.bones)}"
        )
    # Bones are theirs, and what joints there are and how they turn is the motion's.
    bones = ("lengths", "directions", "masses", "centres", "diameters")
    other = replace(mine, **{key: getattr(other, key) for key in bones})
    before = feet(mine, motion.poses)
    way, feet_way = (
        scale_by_legs(motion, other, at) for at in (np.asarray(motion.poses.position), before)
    )
    poses = Pose(jnp.zeros_like(motion.poses.position), *motion.poses[1:])
    by_feet = feet_way - feet(other, poses)
    root = jnp.asarray(_way(way, by_feet, ground_contacts(before)), float)
    rows = np.flatnonzero(is_posed)

    def in_place(part: Array) -> Array:
        every = np.full((len(is_posed), *part.shape[1:]), np.nan, part.dtype)
        every[rows] = part
        return jnp.asarray(every)

    poses = jax.tree.map(in_place, poses._replace(position=root))
    return Motion(other, whole.times, poses, origin_world=whole.origin_world)


def _is_posed(motion: Motion) -> np.ndarray:
    """(T,) whether there is a pose."""
    every = np.concatenate([np.asarray(part) for part in motion.poses], 1)
    return np.asarray(np.isfinite(every).all(1))


def _posed_part(motion: Motion) -> Motion:
    """The motion at the samples that have a pose."""
    rows = _is_posed(motion)
    poses = jax.tree.map(lambda part: jnp.asarray(np.asarray(part)[rows]), motion.poses)
    return replace(motion, times=motion.times[rows], poses=poses, report=None)


def scale_by_legs(motion: Motion, skeleton: Skeleton, points: np.ndarray) -> np.ndarray:
    """Where points (T, ..., 3) of a motion go by the other's length of legs, world, metres.

    From where the pelvis began, and upwards from the floor.
    """
    ratio = leg_length(skeleton) / leg_length(motion.skeleton)
    floor = floors(feet(motion.skeleton, motion.poses))[1]
    origin = np.append(np.asarray(motion.poses.position[0, :2], float), floor)
    return origin + ratio * (np.asarray(points, float) - origin)


def leg_length(skeleton: Skeleton) -> float:
    """Thigh and shank, mean of both sides, metres."""
    bones = skeleton.tree.bones_in("thigh", "shank")
    return float(np.sum(np.asarray(skeleton.lengths)[bones]) / 2)


def feet(skeleton: Skeleton, poses: Pose) -> np.ndarray:
    """(T, F, 3) both ends of both feet, world, metres."""
    rows = np.array([LANDMARKS.index(name) for name in FEET])
    return landmarks_over_time(skeleton, poses, rows).astype(float)


def floors(points: np.ndarray) -> np.ndarray:
    """(2,) usual lowest height of ankles and of toes, of the ``FEET`` (T, F, 3), metres."""
    # Of left and right together: one leg may be in the air all the time.
    return np.percentile(points.reshape(len(points), 2, 2, 3)[..., 2], USUAL_LOWEST, axis=(0, 1))


def ground_contacts(points: np.ndarray) -> np.ndarray:
    """(T, F) bool: which of the ``FEET`` (T, F, 3) are on the ground; on a treadmill they move."""
    return points[..., 2] < np.tile(floors(points), 2) + NEAR_M


def _way(wanted: np.ndarray, by_feet: np.ndarray, low: np.ndarray) -> np.ndarray:
    """The pelvis's way (T, 3): linear least squares, tridiagonal, coordinate by coordinate.

    Args:
        wanted: (T, 3) as it would go without ground.
        by_feet: (T, F, 3) as each of the feet would have it.
        low: (T, F) bool: which are on the ground.
    """
    both = STAY * (low[1:] & low[:-1])
    fixed = np.full(wanted.T.shape, ANCHOR)
    fixed[2] += HEIGHT * low.sum(1)
    pulled = ANCHOR * wanted.T
    pulled[2] += HEIGHT * np.sum(low * by_feet[..., 2], 1)
    if len(wanted) == 1:
        return pulled.T / fixed.T
    joined = 1.0 + both.sum(1)
    steps = np.diff(wanted, axis=0) + np.einsum("tf,tfi->ti", both, np.diff(by_feet, axis=0))
    root = np.empty_like(wanted)
    for axis in range(3):
        diagonal = fixed[axis].copy()
        diagonal[1:] += joined
        diagonal[:-1] += joined
        right = pulled[axis].copy()
        right[1:] += steps[:, axis]
        right[:-1] -= steps[:, axis]
        root[:, axis] = solveh_banded(np.array([np.append(0.0, -joined), diagonal]), right)
    return root


MOTION_NPZ = "motion.npz"
VIEWER_FILE = "recording.rrd"
PICTURE_FILE = "retargeted.png"


class RetargetedMotion(NamedTuple):
    """A motion before and after, the other's surface and its colours, a PNG file's content."""

    tracked: Motion
    retargeted: Motion
    surface: Surface | None
    picture: bytes | None

    def figures(self) -> dict:
        """Lengths of the legs, metres; errors of feet on the ground, metres (per second)."""
        before, after = _posed_part(self.tracked), _posed_part(self.retargeted)
        feet_before, feet_after = (
            feet(motion.skeleton, motion.poses) for motion in (before, after)
        )
        on_ground = ground_contacts(feet_before)
        errors = feet_after - scale_by_legs(before, after.skeleton, feet_before)
        speeds = np.linalg.norm(np.diff(errors, axis=0), axis=-1) / np.diff(before.times)[:, None]
        return {
            "legs_before_m": round(leg_length(before.skeleton), 4),
            "legs_after_m": round(leg_length(after.skeleton), 4),
            "on_the_ground_share": dict(
                zip(FEET, on_ground.mean(0).round(3).tolist(), strict=True)
            ),
            "slide_m_s": _mean(speeds[on_ground[1:] & on_ground[:-1]]),
            "height_error_m": _mean(np.abs(errors[..., 2])[on_ground]),
        }

    def text(self, files: list[Path]) -> str:
        """The same figures, and the files, as lines of text."""
        figures = self.figures()
        errors, slide = figures["height_error_m"], figures["slide_m_s"]
        ground = f"error of the feet's height {_centimetres(errors)}"
        if slide is not None:
            ground += f"; they slide {_centimetres(slide)} a second more"
        lines = [
            f"legs           {_centimetres(figures['legs_before_m'])} before, "
            f"{_centimetres(figures['legs_after_m'])} now",
            f"on the ground  {ground}",
        ]
        return "\n".join([*lines, *(f"written        {path}" for path in files)])


def retarget(source: str | Path, onto: str | Path) -> RetargetedMotion:
    """Play a motion with another person's body, with the options of ``jaxmocap retarget``.

    Raises:
        InputError: a file cannot be used, or the bodies have other bones.
    """
    before, onto = load_motion(_motion_file(source)), Path(onto)
    if not onto.exists():
        raise InputError(onto, "no such file or folder, expected a person's")
    surface = picture = None
    if onto.is_dir():
        skeleton, surface, picture = read_person(onto)
    else:
        skeleton = read_subject(onto, "", {"file": onto.name})
    try:
        return RetargetedMotion(before, retarget_motion(before, skeleton), surface, picture)
    except ValueError as error:
        raise InputError(source, str(error)) from None


def retarget_folder(directory: str | Path, source: str | Path, onto: str | Path) -> OutputFolder:
    """The folder for a retargeted motion, checked before any work; see ``tracked_folder``."""
    person = Path(onto)
    inputs = [_motion_file(source), *(person_files(person) if person.is_dir() else [person])]
    return OutputFolder(directory, MOTION, [*MOTION_FILES, VIEWER_FILE, PICTURE_FILE], inputs)


def write_retargeted(
    motions: RetargetedMotion, folder: OutputFolder, warn: Warn = ignore_warning
) -> list[Path]:
    """Write the motion and the picture; see ``write_outputs``."""
    motion, skin = motions.retargeted, (motions.surface, motions.picture)
    files = folder.write(lambda stage: write_motion(motion, stage, *skin, warn), more_follows=True)
    return files + folder.write(partial(_write_pictures, motions))


def _write_pictures(motions: RetargetedMotion, folder: Path) -> list[Path]:
    """The viewer's recording and the picture."""
    files, picture = [folder / VIEWER_FILE, folder / PICTURE_FILE], motions.picture
    colours = None if picture is None else picture_of(folder, picture)
    write_rerun(files[0], motions.retargeted, surface=motions.surface, picture=colours)
    people = {"as tracked": motions.tracked, "as played": motions.retargeted}
    plot_stick_figures(files[1], people)
    return files


def _motion_file(source: str | Path) -> Path:
    """The motion.npz of a folder, or the file itself."""
    path = Path(source)
    if path.is_dir():
        path = path / MOTION_NPZ
        if not path.is_file():
            raise InputError(source, f"found no {MOTION_NPZ} in this folder, expected one")
    return path


def _mean(values: np.ndarray) -> float | None:
    return round(float(values.mean()), 4) if len(values) else None


def _centimetres(metres: float) -> str:
    return f"{100 * metres:.1f} cm"
