"""One file made into another, between formats that carry the same thing.

INPUTS: a file of markers (.c3d, .trc, .csv) or of a motion (.npz, .bvh, .glb, .mot), or a
calibration of another system. OUTPUTS: another of the same kind, or the joints of a motion as
markers, or a calibration (.toml); what was left out or added on the way, as sentences.

Markers keep the axes of their file. Motions are Y up in .bvh and .glb and Z up elsewhere, and are
rotated; joints made from them are Z up, as ``joints.trc`` is. With ``up = "y"`` what is Z up
becomes Y up. OpenSim's coordinates are Y up always.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from jaxmocap.body.motion import Motion
from jaxmocap.formats.animation.bvh import read_bvh, write_bvh
from jaxmocap.formats.animation.export import DEFAULT_CONVENTION, R_FILE_WORLD
from jaxmocap.formats.animation.gltf import write_gltf
from jaxmocap.formats.animation.gltf_in import read_gltf
from jaxmocap.formats.armatures.armature import (
    Armature,
    fill_from_nearest,
    joint_positions,
    rotated_armature,
)
from jaxmocap.formats.armatures.body_armature import armature_of, motion_of
from jaxmocap.formats.armatures.joint_names import CONVENTIONS, landmark_names, names_to_ours
from jaxmocap.formats.calibrations.registry import convert_calibration
from jaxmocap.formats.files.errors import FileError, InputError, comma_list
from jaxmocap.formats.motion_npz import load_motion, save_motion
from jaxmocap.formats.opensim.coordinates import OPENSIM, write_opensim
from jaxmocap.formats.time_series.axes import Y_UP, from_world
from jaxmocap.formats.time_series.c3d import write_c3d
from jaxmocap.formats.time_series.csv import write_csv
from jaxmocap.formats.time_series.markers import read_markers
from jaxmocap.formats.time_series.mot import motion_from_angles, read_mot, write_isb, write_mot
from jaxmocap.formats.time_series.resampling import (
    even_times,
    resample_armature,
    resample_markers,
    resample_motion,
)
from jaxmocap.formats.time_series.tables import Markers
from jaxmocap.formats.time_series.trc import write_trc

T = TypeVar("T", Markers, Armature, Motion)
MARKER_SUFFIXES = (".c3d", ".trc", ".csv")
MOTION_SUFFIXES = (".npz", ".bvh", ".glb", ".mot")
# Of a calibration that is written; its source is known by its content.
CALIBRATION_SUFFIX = ".toml"


@dataclass(frozen=True)
class ConversionOptions:
    """How to convert."""

    # Convention of the joints' names, one of ``CONVENTIONS``; None is customary for the target, or
    # what the source says. ``opensim`` is for a .mot with OpenSim's coordinates.
    names: str | None = None
    # Of the BVH file, of the one written if both are; None is metres when written, inferred by the
    # body's size when read. Of a calibration that does not state its own.
    unit: str | None = None
    rate: float | None = None  # samples per second of the target; None keeps the source's times
    # File whose skeleton the angles of a .mot are of; None where the source has one.
    body: Path | None = None
    angles: str | None = None  # of the .mot written, ``hinges`` or ``isb``; None is hinges
    up: str | None = None  # vertical axis of the markers written, "z" or "y"; None is as they are
    # Axis of a calibration's world that points up, a key of
    # ``calibrations.registry.R_WORLD_OF_SOURCE_UP``; None is what its system documents.
    source_up: str | None = None
    # Width and height of the pictures, pixels, of a calibration that does not state them.
    size: tuple[int, int] | None = None


@dataclass
class _Conversion:
    """A conversion under way, and its warnings."""

    source: Path
    target: Path
    options: ConversionOptions
    warnings: list[str] = field(default_factory=list)


def convert_file(
    source: str | Path, target: str | Path, options: ConversionOptions | None = None
) -> list[str]:
    """Make one file into another, by their suffixes; sentences on what was left out or put in.

    InputError for an unknown suffix, a source that cannot be used, or a target that cannot hold it.
    """
    conversion = _Conversion(Path(source), Path(target), options or ConversionOptions())
    options = conversion.options
    kinds = [path.suffix.lower() for path in (conversion.source, conversion.target)]
    if kinds[1] == CALIBRATION_SUFFIX:
        for name in ("names", "rate", "body", "angles", "up"):
            if getattr(options, name) is not None:
                raise InputError(conversion.source, f"--{name} does not apply to a calibration")
        chosen = options.unit, options.source_up, options.size
        return convert_calibration(conversion.source, conversion.target, *chosen)
    for path, kind in zip((conversion.source, conversion.target), kinds, strict=True):
        if kind not in (*MARKER_SUFFIXES, *MOTION_SUFFIXES):
            expected = ", ".join((*MARKER_SUFFIXES, *MOTION_SUFFIXES))
            calibration = f"a calibration is made into {CALIBRATION_SUFFIX}"
            problem = f"unknown suffix {kind!r}, expected one of {expected} ({calibration})"
            raise InputError(path, problem)
    if kinds[0] in MARKER_SUFFIXES and kinds[1] in MOTION_SUFFIXES:
        content = "positions of markers, not orientations of bones"
        problem = f"cannot be made from {conversion.source}: {content}"
        raise InputError(target, f"{problem} (jaxmocap track finds those)")
    _check_options(conversion, *kinds)
    if kinds[0] in MARKER_SUFFIXES:
        _write_markers(conversion, _read_markers(conversion))
        return conversion.warnings
    unit = None if kinds[1] == ".bvh" else options.unit
    motion = _read_motion(conversion.source, unit, options.body)
    if kinds[1] in MARKER_SUFFIXES:
        _write_markers(conversion, _joints_as_markers(conversion, motion))
    elif kinds[1] in DEFAULT_CONVENTION:
        _write_armature(conversion, motion)
    else:
        _write_motion(conversion, motion)
    return conversion.warnings


def _check_options(conversion: _Conversion, source: str, target: str) -> None:
    """InputError for an option that would not do anything."""
    options = conversion.options
    useless = {
        "--unit": options.unit and ".bvh" not in (source, target),
        "--body": options.body and source != ".mot",
        "--names": options.names and source in MARKER_SUFFIXES,
        f"--names {options.names}": options.names
        and (target == ".npz" or (target == ".mot") != (options.names == OPENSIM)),
        "--angles": options.angles and (target != ".mot" or options.names == OPENSIM),
        f"--up {options.up}": options.up
        and target not in MARKER_SUFFIXES
        and (options.up, options.names) != (Y_UP, OPENSIM),
        "--source-up": options.source_up,
        "--size": options.size,
    }
    for option, given in useless.items():
        if given:
            raise InputError(conversion.source, f"{option} does not apply to {source} to {target}")
    if source == ".mot" and options.body is None:
        problem = "holds angles without bones: name a file with the same body"
        raise InputError(conversion.source, f"{problem} (--body motion.npz)")


def _read_markers(conversion: _Conversion) -> Markers:
    markers = read_markers(conversion.source)
    if count := sum(markers.at_zero.values()):
        conversion.warnings.append(f"left out: {count} positions at exactly 0, 0, 0, as missing")
    conversion.warnings += [f"left out: {content}" for content in markers.left_out]
    return markers


def _at_rate(
    conversion: _Conversion, samples: T, columns: int, resampled: Callable[[T, np.ndarray], T]
) -> T:
    """The same at the rate that is asked for; each sample has so many numbers."""
    if (rate := conversion.options.rate) is None:
        return samples
    return resampled(samples, even_times(samples.times, rate, columns, conversion.source))


def _write_markers(conversion: _Conversion, markers: Markers) -> None:
    kind = conversion.target.suffix.lower()
    if conversion.options.up == Y_UP:
        markers = from_world(markers, Y_UP)
    columns = (3 if markers.orientations is None else 12) * len(markers.names)
    markers = _at_rate(conversion, markers, columns, resample_markers)
    markers = replace(markers, rate=conversion.options.rate or markers.rate)
    if markers.orientations is not None and kind != ".csv":
        conversion.warnings.append(
            f"left out: the markers' orientations, which {kind} does not hold"
        )
    try:
        if kind == ".c3d":
            conversion.warnings += write_c3d(conversion.target, markers)
            return
        if kind == ".csv":
            write_csv(
                conversion.target, markers.times, markers.points(), markers.measured_orientations()
            )
        else:
            write_trc(conversion.target, markers.times, markers.points())
    except ValueError as error:
        # Names that a format cannot hold.
        raise (
            error if isinstance(error, FileError) else InputError(conversion.target, str(error))
        ) from None


def _read_motion(path: Path, unit: str | None, body: Path | None) -> Motion | Armature:
    """What a file holds, in the world's axes; the angles of a .mot are those of a ``body``."""
    kind = path.suffix.lower()
    if kind == ".npz":
        return load_motion(path)
    if kind == ".mot":
        if body is None or body.suffix.lower() not in (".npz", ".bvh", ".glb"):
            raise InputError(body or path, "expected a .npz, .bvh or .glb file, which holds a body")
        times, columns = read_mot(path)
        motion = _read_motion(body, unit, None)
        motion = motion if isinstance(motion, Motion) else motion_of(motion, body)
        return motion_from_angles(path, times, columns, motion.skeleton)
    armature = read_bvh(path, unit) if kind == ".bvh" else read_gltf(path)
    return rotated_armature(armature, R_FILE_WORLD.T)


def _joint_names(conversion: _Conversion, joints: tuple[str, ...]) -> tuple[str, ...]:
    """Names of joints in the convention asked for; joints that it does not name keep theirs."""
    if conversion.options.names is None:
        return joints
    ours, convention = names_to_ours(joints), CONVENTIONS[conversion.options.names]
    if ours is None:
        raise InputError(conversion.source, f"joints of no supported naming: {comma_list(joints)}")
    return tuple(convention[ours[name]] if name in ours else name for name in joints)


def _write_armature(conversion: _Conversion, motion: Motion | Armature) -> None:
    kind, names = conversion.target.suffix.lower(), conversion.options.names
    if isinstance(motion, Motion):
        conversion.warnings.append("left out: masses, limits, and the report where there is one")
        armature = armature_of(motion, names or DEFAULT_CONVENTION[kind])
    else:
        armature = replace(motion, names=_joint_names(conversion, motion.names))
    armature = _at_rate(conversion, armature, 9 * len(armature.names), resample_armature)
    armature = rotated_armature(armature, R_FILE_WORLD)
    if kind == ".glb":
        write_gltf(conversion.target, armature)
        return
    if unknown := int((~armature.is_valid).sum()):
        conversion.warnings.append(
            f"added: {unknown} samples without a pose hold that of the nearest"
        )
    if armature.times[0] != 0:
        conversion.warnings.append(
            f"left out: that the first sample is at {armature.times[0]:g} s, not 0"
        )
    write_bvh(
        conversion.target,
        fill_from_nearest(armature, conversion.source),
        conversion.options.unit or "m",
    )


def _write_motion(conversion: _Conversion, motion: Motion | Armature) -> None:
    kind = conversion.target.suffix.lower()
    if isinstance(motion, Armature):
        motion = motion_of(motion, conversion.source)
        if kind == ".npz":
            made_up = "added: masses, girths and limits of a person with bones as long"
            conversion.warnings.append(made_up)
    motion = _at_rate(conversion, motion, 9 * len(motion.skeleton.tree.bones), resample_motion)
    if kind == ".npz":
        save_motion(conversion.target, motion)
    elif conversion.options.names == OPENSIM:
        conversion.warnings += write_opensim(conversion.target, motion)
    else:
        isb = conversion.options.angles == "isb"
        conversion.warnings += (write_isb if isb else write_mot)(conversion.target, motion)
        if isb:
            conversion.warnings.append(
                "left out: where the pelvis is, and what ISB's angles leave open"
            )
        conversion.warnings.append("left out: the body, and the report where there is one")


def _joints_as_markers(conversion: _Conversion, motion: Motion | Armature) -> Markers:
    """Where the joints are, as markers: landmarks of a motion of ours, else all joints."""
    conversion.warnings.append("left out: the bones' orientations")
    if isinstance(motion, Motion):
        names = tuple(landmark_names(conversion.options.names).values())
        return Markers(motion.times, names, motion.joint_positions())
    return Markers(motion.times, _joint_names(conversion, motion.names), joint_positions(motion))
