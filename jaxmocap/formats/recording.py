"""A recording: markers over time, where they sit, videos, and whose body it is.

INPUTS: a TOML file with [markers], [markers.on], [markers.rigid], [[video]], [calibration] and
[subject]; its paths are relative to it. Of markers and videos, one is enough.
OUTPUTS: a Recording: marker positions in the world (metres, Z up) and float64 seconds, sites on
bones, video sources with their cameras, a scaled skeleton.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from jaxmocap.body.skeleton import Skeleton
from jaxmocap.formats.axes import read_axes, to_world
from jaxmocap.formats.calibration import pick_camera, read_calibration
from jaxmocap.formats.errors import InputError
from jaxmocap.formats.filters import KEYS as FILTERS
from jaxmocap.formats.filters import Filters, read_filters
from jaxmocap.formats.keypoint_models import MODELS
from jaxmocap.formats.keypoints import Detections
from jaxmocap.formats.markers import read_markers
from jaxmocap.formats.places import MarkerPlace, bound_places, bound_positions, read_place
from jaxmocap.formats.rigid import with_rigid_sets
from jaxmocap.formats.subject import DEFAULT_HEIGHT, read_subject
from jaxmocap.formats.tables import Markers, Places, check_times
from jaxmocap.formats.toml import Fields, read_toml, write_toml
from jaxmocap.geometry.cameras import Camera

# What [[video]] may say of 2-D detections.
_KEYPOINTS = ("keypoints", "keypoints_model", "keypoints_first")


@dataclass(frozen=True)
class VideoSource:
    """One video and the camera that took it.

    Attributes:
        camera_name: of the camera.
        camera: its calibration.
        path: of the video file; None where the frames are in memory.
        offset: seconds to add to video time to get marker time.
        keypoints: folder (or file) of 2-D detections, what was read from it already, or None.
        keypoints_model: whose points they are, or None to tell it from them.
        keypoints_first: number that they give the video's first frame, or None to tell it.
        frames: video times (F,) in seconds and images (F, H, W, 3) BGR uint8, or None.
        background: image file of what the camera sees without the person, or None.
    """

    camera_name: str
    camera: Camera
    path: Path | None = None
    offset: float = 0.0
    keypoints: Path | Detections | None = None
    keypoints_model: str | None = None
    keypoints_first: int | None = None
    frames: tuple[np.ndarray, Sequence[np.ndarray] | np.ndarray] | None = None
    background: Path | None = None


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

    def __post_init__(self):
        """Check that the parts fit, wherever they came from."""
        where, expected = self.path or self.name, (len(self.times), len(self.places), 3)
        if np.shape(self.positions_world) != expected:
            found = np.shape(self.positions_world)
            raise InputError(where, f"marker positions: found shape {found}, expected {expected}")
        check_times(where, self.times, Places("marker sample"))
        if self.places and not np.isfinite(self.positions_world).all(-1).any():
            raise InputError(where, "no marker is seen in any sample, all positions are NaN")
        bones = self.skeleton.tree.bones
        for place in self.places:
            if place.bone not in bones:
                raise InputError(
                    where,
                    f"[markers.on] {place.name}: unknown bone {place.bone!r}, "
                    f"expected one of {', '.join(bones)}",
                )

    @property
    def marker_names(self) -> tuple[str, ...]:
        """Names of the M markers."""
        return tuple(place.name for place in self.places)

    def marked(self) -> "Recording":
        """The recording itself, for whoever cannot do without markers.

        Raises:
            InputError: it has none.
        """
        if not self.places:
            raise InputError(
                self.path or self.name, "[markers] is missing, which is needed to follow markers"
            )
        return self

    @classmethod
    def load(cls, path: str | Path) -> "Recording":
        """Read a recording file; see ``load_recording``."""
        return load_recording(path)


def load_recording(path: str | Path) -> Recording:
    """Read a recording file and all that it names but the video's frames.

    Raises:
        InputError: a file that is missing or cannot be used, or a field that is missing, unknown
            or does not fit.
    """
    path = Path(path)
    top = Fields(path, "", read_toml(path), ("markers", "video", "calibration", "subject"))
    warnings = []
    if "subject" in top:
        skeleton = read_subject(path, "[subject]", top.table["subject"])
    else:
        skeleton = Skeleton.human(DEFAULT_HEIGHT)
        warnings.append(f"{path}: no [subject], a height of {DEFAULT_HEIGHT} m is assumed")
    if "markers" not in top and not top.table.get("video"):
        raise top.error("", "neither [markers] nor [[video]], expected one of them")
    if "markers" not in top:
        return Recording(
            skeleton,
            np.zeros(0),
            np.zeros((0, 0, 3)),
            (),
            _read_videos(top),
            path.stem,
            path,
            tuple(warnings),
        )
    markers, places, filters = _read_marked(top)
    seen = np.isfinite(markers.positions.sum(-1))
    warnings += [
        f"{path}: marker {place.name!r} is never seen"
        for place, samples in zip(places, seen.T, strict=True)
        if not samples.any()
    ]
    positions_world, points = _bound(path, skeleton, places, markers)
    return Recording(
        skeleton,
        markers.times,
        positions_world,
        points,
        _read_videos(top),
        path.stem,
        path,
        tuple(warnings),
        top.path.parent / top.table["markers"]["file"],
        markers.rate,
        filters,
    )


def load_markers(path: str | Path) -> tuple[Markers, tuple[MarkerPlace, ...]]:
    """The markers of a recording file as measured, in the world's axes, and their places.

    Raises:
        InputError: see ``load_recording``.
    """
    path = Path(path)
    keys = ("markers", "video", "calibration", "subject")
    markers, places, _ = _read_marked(Fields(path, "", read_toml(path), keys))
    bones = Skeleton.human().tree.bones
    for place in places:
        if place.bone not in bones:
            raise InputError(path, f"[markers.on] {place.name}: unknown bone {place.bone!r}")
    return markers, places


def _read_marked(top: Fields) -> tuple[Markers, tuple[MarkerPlace, ...], Filters]:
    """The markers of [markers.on] in the world's axes, their places, and their filters."""
    keys = ("file", "up", "to_world", "on", "filters", "rigid")
    fields = Fields(top.path, "[markers]", top.required("markers"), keys)
    file = fields.file("file")
    R_world_file = read_axes(fields)
    on = Fields(top.path, "[markers.on]", fields.required("on"))
    if not on.table:
        raise on.error("", "names no marker, expected entries such as Head = { bone = 'head' }")
    places = tuple(read_place(top.path, name, entry) for name, entry in on.table.items())
    sets = Fields(top.path, "[markers.rigid]", fields.table.get("rigid", {}))
    markers = with_rigid_sets(sets, read_markers(file))
    for place in places:
        if place.name not in markers.names:
            raise on.error(
                place.name, f"no such marker in {file}, found {', '.join(markers.names)}"
            )
    columns = [markers.names.index(place.name) for place in places]
    names = tuple(place.name for place in places)
    positions_world = to_world(R_world_file, markers.positions[:, columns])
    turns = None if markers.turns is None else R_world_file @ markers.turns[:, columns]
    if turns is not None and np.linalg.det(R_world_file) < 0:
        raise fields.error("to_world", "found a reflection, which leaves no turn of a marker")
    marked = Markers(markers.times, names, positions_world, rate=markers.rate, turns=turns)
    wanted = Fields(top.path, "[markers.filters]", fields.table.get("filters", {}), FILTERS)
    return marked, places, read_filters(wanted)


def _bound(
    path: Path, skeleton: Skeleton, places: tuple[MarkerPlace, ...], markers: Markers
) -> tuple[np.ndarray, tuple[MarkerPlace, ...]]:
    """Points on bones (T, P, 3), world, metres, that the markers tell of, and their places."""
    bones = skeleton.tree.bones
    known = np.full((*markers.positions.shape, 3), np.nan)
    known = known if markers.turns is None else markers.turns
    for i, place in enumerate(places):
        if place.bone not in bones:
            problem = f"unknown bone {place.bone!r}, expected one of {', '.join(bones)}"
            raise InputError(path, f"[markers.on] {place.name}: {problem}")
        if place.is_turned and not np.isfinite(known[:, i]).any():
            key = "offset_in = 'marker'" if place.turn is None else "turn"
            problem = f"{key} needs to know how the marker is turned, which the file never says"
            raise InputError(path, f"[markers.on] {place.name}: {problem}")
    positions = bound_positions(skeleton, places, markers.positions, known)
    return positions, bound_places(skeleton, places)


def _read_videos(top: Fields) -> tuple[VideoSource, ...]:
    tables = top.table.get("video", [])
    if not isinstance(tables, list):
        raise top.error("[video]", "found one table, expected [[video]] in double brackets")
    if not tables:
        return ()
    if "calibration" not in top:
        raise top.error("", "[calibration] is missing, which every [[video]] needs")
    calibration = Fields(top.path, "[calibration]", top.table["calibration"], ("file",))
    file = calibration.file("file")
    cameras = read_calibration(file)
    return tuple(_video(top.path, i, table, file, cameras) for i, table in enumerate(tables, 1))


def _video(
    path: Path, number: int, table: Any, calibration: Path, cameras: dict[str, Camera]
) -> VideoSource:
    keys = ("file", "camera", "offset", "background", *_KEYPOINTS)
    fields = Fields(path, f"[[video]] number {number}", table, keys)
    name = fields.text("camera")
    return VideoSource(
        camera_name=name,
        camera=pick_camera(calibration, cameras, name),
        path=fields.file("file"),
        offset=fields.number("offset", 0.0),
        background=fields.file("background") if "background" in fields else None,
        **_keypoints(fields),
    )


def _keypoints(fields: Fields) -> dict[str, Any]:
    """Where a video's 2-D detections are, and what is said of them."""
    given: dict[str, Any] = {}
    for key in _KEYPOINTS:
        if key in fields and "keypoints" not in fields:
            raise fields.error(key, "found without 'keypoints', which it is about")
    if "keypoints" in fields:
        is_file = fields.text("keypoints").lower().endswith(".json")
        given["keypoints"] = fields.file("keypoints", folder=not is_file)
    if "keypoints_model" in fields:
        given["keypoints_model"] = model = fields.text("keypoints_model")
        if model not in MODELS:
            expected = ", ".join(MODELS)
            raise fields.error("keypoints_model", f"found {model!r}, expected one of {expected}")
    if "keypoints_first" in fields:
        first = fields.number("keypoints_first")
        if first != int(first):
            raise fields.error("keypoints_first", f"found {first:g}, expected a whole number")
        given["keypoints_first"] = int(first)
    return given


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
