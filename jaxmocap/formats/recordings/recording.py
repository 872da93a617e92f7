"""A recording: markers over time, where they sit, videos, and whose body it is.

INPUTS: a TOML file with [markers], [markers.on], [markers.rigid], [[video]], [calibration] and
[subject]; its paths are relative to it. Of markers and videos, one is enough.
OUTPUTS: a Recording: marker positions in the world (metres, Z up) and float64 seconds, sites on
bones, video sources with their cameras, a scaled skeleton.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from jaxmocap.body.skeleton import Skeleton
from jaxmocap.formats.cameras.video_sources import VideoSource, read_videos
from jaxmocap.formats.files.errors import InputError, comma_list, short_name
from jaxmocap.formats.files.toml import TomlTable, read_toml, write_toml
from jaxmocap.formats.marker_sets.sets import SET_KEYS, MarkerSet, PlacedMarkers, placed_markers
from jaxmocap.formats.recordings.filters import FILTER_KEYS, Filters, read_filters
from jaxmocap.formats.recordings.marker_places import (
    MarkerPlace,
    bone_point_binder,
    bone_points,
    check_bones,
    need_wrists,
)
from jaxmocap.formats.recordings.rigid_bodies import with_rigid_sets
from jaxmocap.formats.recordings.subject import subject_or_default
from jaxmocap.formats.time_series.axes import read_axes, to_world
from jaxmocap.formats.time_series.exchanged import undo_exchanges
from jaxmocap.formats.time_series.markers import read_markers
from jaxmocap.formats.time_series.tables import Markers, check_times
from jaxmocap.geometry.cameras import on_host
from jaxmocap.geometry.origin import local_origin

# Of a recording's file; and what a live run's has besides.
TABLES = ("markers", "video", "calibration", "subject")
LIVE_TABLES = ("osc", "lsl", "vmc", "vrchat")


@dataclass(frozen=True)
class Recording:
    """What there is to track.

    Attributes:
        skeleton: scaled to the person.
        times: (T,) seconds of the markers, float64, ascending; none without markers.
        positions_world: (T, M, 3) metres, Z up; NaN where a marker is missing.
        places: of the M markers, in the same order; their offsets are in the bones' axes.
        videos: any number of them.
        name: of the recording.
        path: the file it came from, or None.
        warnings: sentences that a user should see.
        markers_file: the file that the markers came from, or None.
        stated_rate: samples per second as that file states them, or None.
        filters: that the markers are to go through before they are tracked.
        origin_world: (3,) metres, float64: what was subtracted from the world's coordinates of
            markers and cameras; not zero where they are far from 0, see ``geometry.origin``.
        marker_set: that places markers, and what the file has of it; or None.
        fit: whether bone lengths and the markers' places are fitted to the markers, where these
            determine the body.
    """

    skeleton: Skeleton
    times: np.ndarray
    positions_world: np.ndarray
    places: tuple[MarkerPlace, ...]
    videos: tuple[VideoSource, ...] = ()
    name: str = "recording"
    path: Path | None = None
    warnings: tuple[str, ...] = ()
    markers_file: Path | None = None
    stated_rate: float | None = None
    filters: Filters = field(default_factory=Filters)
    origin_world: np.ndarray = field(default_factory=lambda: np.zeros(3))
    marker_set: MarkerSet | None = None
    fit: bool = True

    def __post_init__(self):
        """Check that the parts fit, wherever they came from."""
        where, expected = self.path or self.name, (len(self.times), len(self.places), 3)
        if np.shape(self.positions_world) != expected:
            shape = np.shape(self.positions_world)
            raise InputError(where, f"marker positions: found shape {shape}, expected {expected}")
        check_times(where, self.times, "marker sample")
        if self.places and not np.isfinite(self.positions_world).all(-1).any():
            raise InputError(where, "no marker has a position in any sample, all positions are NaN")
        check_bones(where, self.places, self.skeleton)

    def __repr__(self) -> str:
        """In one line."""
        times, cameras = self.times, [source.camera_name for source in self.videos]
        span = f" from {times[0]:.2f} to {times[-1]:.2f} s" if len(times) else ""
        markers = f"{len(self.places)} markers ({comma_list(self.marker_names)})"
        videos = f"{len(cameras)} videos ({comma_list(cameras)})"
        name = short_name(self.name)
        return f"Recording({name}: {len(times)} samples of {markers}{span}, {videos})"

    @property
    def marker_names(self) -> tuple[str, ...]:
        """Names of the M markers."""
        return tuple(place.name for place in self.places)

    def require_markers(self) -> "Recording":
        """The recording itself, where it has markers; InputError where it has none."""
        if not self.places:
            problem = "[markers] is missing, which is needed to follow markers"
            raise self.error(f"{problem}; without any, use jaxmocap silhouette track")
        return self

    def error(self, problem: str) -> InputError:
        """The error to raise about the recording: its file, or its name where there is none."""
        return InputError(self.path or self.name, problem)

    @classmethod
    def load(cls, path: str | Path) -> "Recording":
        """Read a recording file; see ``load_recording``."""
        return load_recording(path)


def load_recording(path: str | Path, subject: Mapping[str, Any] | None = None) -> Recording:
    """Read a recording file and all that it names but the video's frames.

    Args:
        path: of the file.
        subject: the keys of [subject], in place of those in the file.

    Raises:
        InputError: a file that is missing or cannot be used, or a field that is missing, unknown
            or does not fit.
    """
    path = Path(path)
    top = _tables(path)
    if subject is not None:
        top.entries["subject"] = dict(subject)
    skeleton, warnings = subject_or_default(top)
    if "markers" not in top and not top.entries.get("video"):
        raise top.error("", "neither [markers] nor [[video]], expected one of them")
    if "markers" not in top:
        no_markers = np.zeros(0), np.zeros((0, 0, 3)), ()
        videos = read_videos(top)
        return _at_local_origin(
            top, Recording(skeleton, *no_markers, videos, path.stem, path, warnings)
        )
    markers, (skeleton, places, marker_set), filters = _read_placed_markers(top, skeleton)
    if need_wrists(places):
        skeleton, warnings = subject_or_default(top, wrists=True)
    markers, exchanges = undo_exchanges(markers)
    warnings += tuple(f"{path}: {sentence}" for sentence in exchanges)
    is_present = np.isfinite(markers.positions.sum(-1))
    warnings += tuple(
        f"{path}: marker {place.name!r} is missing in every sample"
        for place, samples in zip(places, is_present.T, strict=True)
        if not samples.any()
    )
    warnings += tuple(
        f"{path}: marker {place.name!r} is at exactly 0, 0, 0 in {markers.at_zero[place.name]} of "
        f"{len(markers.times)} samples, which are taken as missing"
        for place in places
        if place.name in markers.at_zero
    )
    positions_world, points = _bone_points(path, skeleton, places, markers)
    recording = Recording(
        skeleton,
        markers.times,
        positions_world,
        points,
        read_videos(top),
        path.stem,
        path,
        warnings,
        top.path.parent / top.entries["markers"]["file"],
        markers.rate,
        filters,
        marker_set=marker_set,
        fit=TomlTable(path, "[markers]", top.entries["markers"]).flag("fit", True),
    )
    return _at_local_origin(top, recording)


def _tables(path: Path) -> TomlTable:
    """The file's tables; InputError for those of a live run's file."""
    entries = read_toml(path)
    if live := [name for name in LIVE_TABLES if name in entries]:
        problem = f"found [{live[0]}], as in the file of a live run, expected a recording's"
        raise InputError(path, f"{problem}; 'jaxmocap live' takes this file")
    return TomlTable(path, "", entries, TABLES)


def _at_local_origin(top: TomlTable, recording: Recording) -> Recording:
    """The recording about a local origin, where the world's is far from markers or cameras."""
    places = recording.positions_world
    if not recording.places:
        places = np.array([on_host(source.camera).position_world for source in recording.videos])
    origin = local_origin(places)
    if not origin.any():
        return recording
    (x, y, z), away = origin, np.linalg.norm(origin) / 1e3
    warning = (
        f"{recording.path}: the world's origin is {away:.4g} km away, where single precision is "
        f"coarse: tracked from ({x:.0f}, {y:.0f}, {z:.0f}) m, which is added "
        "again to what is written, but for recording.rrd"
    )
    return replace(
        recording,
        positions_world=recording.positions_world - origin,
        videos=read_videos(top, origin),
        warnings=(*recording.warnings, warning),
        origin_world=origin,
    )


def load_markers(path: str | Path) -> tuple[Markers, tuple[MarkerPlace, ...]]:
    """A recording file's markers as measured, in the world's axes, and their places."""
    path = Path(path)
    top, skeleton = _tables(path), Skeleton.human()
    markers, (_, places, _), _ = _read_placed_markers(top, skeleton)
    check_bones(path, places, skeleton)
    return markers, places


def _read_placed_markers(
    top: TomlTable, skeleton: Skeleton
) -> tuple[Markers, PlacedMarkers, Filters]:
    """The markers that are placed in the world's axes, where they sit, their filters."""
    keys = ("file", "up", "to_world", *SET_KEYS, "on", "filters", "rigid", "fit")
    fields = TomlTable(top.path, "[markers]", top.require("markers"), keys)
    file = fields.file("file")
    R_world_file = read_axes(fields)
    if not {"on", "set"} & fields.entries.keys():
        expected = "expected [markers.on], or set = ... of a common set of markers"
        raise fields.error("on", f"is missing, {expected}")
    given = fields.entries.get("on", {})
    on = TomlTable(top.path, "[markers.on]", given)
    if not on.entries and "set" not in fields:
        raise on.error("", "names no marker, expected entries such as Head = { bone = 'head' }")
    sets = TomlTable(top.path, "[markers.rigid]", fields.entries.get("rigid", {}))
    stated = fields.entries.get("filters", {})
    filters = read_filters(TomlTable(top.path, "[markers.filters]", stated, FILTER_KEYS))
    all_markers = read_markers(file)
    available = (*all_markers.names, *sets.entries)
    placed = placed_markers(fields, on, all_markers.names, skeleton)
    entries = [place.name for place in placed[1]]
    markers = with_rigid_sets(sets, all_markers, entries)
    # A long recording's numbers are not to be in memory thrice.
    del all_markers
    for name in on.entries.keys() - set(available):
        raise on.error(name, f"no such marker in {file}, found {comma_list(available)}")
    columns = [markers.names.index(name) for name in entries]
    if (orientations := markers.orientations) is not None:
        if np.linalg.det(R_world_file) < 0:
            problem = "found a reflection, which leaves no orientation of a marker"
            raise fields.error("to_world", problem)
        orientations = R_world_file @ orientations[:, columns]
    markers = replace(
        markers,
        times=markers.times.copy(),
        names=tuple(entries),
        positions=to_world(R_world_file, markers.positions[:, columns]),
        orientations=orientations,
    )
    return markers, placed, filters


def _bone_points(
    path: Path, skeleton: Skeleton, places: tuple[MarkerPlace, ...], markers: Markers
) -> tuple[np.ndarray, tuple[MarkerPlace, ...]]:
    """Points on bones (T, P, 3), world, metres, that the markers measure, and their places."""
    check_bones(path, places, skeleton)
    orientations = markers.orientations
    if orientations is None:
        # Of a long recording, a whole array would take as much as three of positions.
        orientations = np.broadcast_to(np.nan, (*markers.positions.shape, 3))
    for i, place in enumerate(places):
        if place.needs_orientation and not np.isfinite(orientations[:, i]).any():
            key = "offset_in = 'marker'" if place.orientation is None else "turn"
            problem = f"{key} needs the marker's orientation, which the file never states"
            raise InputError(path, f"[markers.on] {short_name(place.name)}: {problem}")
    if not any(place.needs_orientation for place in places):
        return markers.positions, bone_points(skeleton, places)
    bind = bone_point_binder(skeleton, places)
    return bind(markers.positions, orientations), bone_points(skeleton, places)


def write_recording(
    path: str | Path,
    markers_file: str | Path | None,
    on: Mapping[str, Mapping[str, Any]],
    videos: Sequence[Mapping[str, Any]] = (),
    calibration_file: str | Path | None = None,
    subject: Mapping[str, Any] | None = None,
    up: str = "z",
) -> Path:
    """Write a recording file; the files that it names are written by others.

    Args:
        path: of the .toml file, or a folder, in which it is then called ``recording.toml``.
        markers_file: relative to it, as are all others; None where there are no markers.
        on: marker -> ``bone``, and ``at`` and ``offset`` where they differ from the defaults.
        videos: ``file``, ``camera``, and ``offset``, ``background`` and ``keypoints`` (with
            ``keypoints_model`` and ``keypoints_first``) where there are any.
        calibration_file: needed with videos.
        subject: the keys of [subject], or None.
        up: the marker file's axis that points up.

    Returns:
        The path of the file.
    """
    path = Path(path)
    if path.suffix != ".toml":
        path = path / "recording.toml"
    tables: list[tuple[str, dict[str, Any]]] = []
    if markers_file is not None:
        tables.append(("[markers]", {"file": markers_file, "up": up}))
        tables.append(("[markers.on]", {name: dict(place) for name, place in on.items()}))
    tables += [("[[video]]", dict(video)) for video in videos]
    if calibration_file is not None:
        tables.append(("[calibration]", {"file": calibration_file}))
    if subject is not None:
        tables.append(("[subject]", dict(subject)))
    write_toml(path, tables)
    return path
