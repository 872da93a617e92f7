"""What a live run listens to, whose body it is, and where the poses go: a TOML file.

INPUTS: a TOML file with [markers.on], [osc] or [lsl], [[video]], [calibration], [subject], [vmc]
and [vrchat]; its paths are relative to it.
OUTPUTS: a LiveSetup.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from jaxmocap.body.skeleton import Skeleton, has_wrists
from jaxmocap.formats.cameras.calibration import camera_of, check_one_kind, read_sections
from jaxmocap.formats.files.addresses import (
    LOOPBACK,
    Address,
    Network,
    read_address,
    read_allowed_networks,
)
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.files.short_repr import comma_list, short_repr
from jaxmocap.formats.files.toml import TomlTable, read_toml, same_file_name
from jaxmocap.formats.recordings.filters import OneEuroSettings, read_filters
from jaxmocap.formats.recordings.marker_places import MarkerPlace, need_wrists, read_place
from jaxmocap.formats.recordings.subject import subject_or_default
from jaxmocap.formats.time_series.axes import R_WORLD_OF_UP, read_axes
from jaxmocap.geometry.cameras import Camera

# Unity's frame is left-handed: x right, y up, z forward. The matrix is a reflection.
R_WORLD_UNITY = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
# What VRChat takes trackers of; by the head it finds where our world lies in its own.
TRACKED = ("hip", "chest", "foot_l", "foot_r", "elbow_l", "elbow_r", "knee_l", "knee_r", "head")
# Feet and hips determine the knees well enough.
DEFAULT_TRACKED = tuple(name for name in TRACKED if not name.startswith("knee"))
# More than any live run has; compiling takes as long as there are markers and cameras.
MAX_MARKERS = 200
MAX_CAMERAS = 16
# No camera is slower, seconds.
MAX_DELAY_S = 60.0
# What VMC's senders and VRChat's call a headset. Its axes are the head's: x ahead, y left, z up.
HEADSETS = ("Hmd", "head")
# The rotation by nothing, wxyz.
_NO_ROTATION = (1.0, 0.0, 0.0, 0.0)
# Devices are counted from 0.
MAX_DEVICE = 999
# Characters of the name of an LSL stream.
MAX_STREAM_CHARACTERS = 200
# The address of a stream; a file has a field of its own.
_URL = re.compile(r"(?!file:)[a-z][a-z0-9+.-]*://[!-~]+", re.IGNORECASE)
_TABLES = ("markers", "osc", "lsl", "video", "calibration", "subject", "vmc", "vrchat")


# Ports that VMC's senders, VMC's receivers and VRChat use by default.
DEFAULT_LISTEN = Address(port=39540)
DEFAULT_VMC = Address(port=39539)
DEFAULT_VRCHAT = Address(port=9000)


@dataclass(frozen=True)
class LiveVideo:
    """One camera that is on.

    Attributes:
        camera_name: its section in the calibration.
        camera: its calibration.
        source: index of a device, path of a file, or address of a network stream.
        offset: seconds to add to a frame's arrival to get when it was exposed, on the markers'
            clock; negative by the camera's delay.
    """

    camera_name: str
    camera: Camera
    source: int | Path | str
    offset: float = 0.0


@dataclass(frozen=True)
class LiveSetup:
    """The set-up of a live run.

    Attributes:
        path: of the file.
        skeleton: of the person.
        places: of the M markers.
        R_world_source: (3, 3) from the markers' axes to the world's.
        videos: any number of cameras.
        listen: where OSC comes in.
        allowed_networks: networks whose packets count; what other hosts send is counted and
            ignored.
        aliases: name that a sender uses -> marker.
        raw: whether VMC's devices are taken as tracked (``Pos/Local``), not scaled to an avatar.
        lsl: name of the LSL stream that brings the markers in place of OSC, or None.
        vmc: where VMC goes.
        vrchat: where VRChat's trackers go, or None.
        trackers: which of ``TRACKED`` go there.
        calibration: the calibration file, or None.
        subject: the table [subject] as it stands, or None.
        one_euro: of the filter that the markers go through, or None.
        warnings: sentences that a user should see.
    """

    path: Path
    skeleton: Skeleton
    places: tuple[MarkerPlace, ...]
    R_world_source: np.ndarray
    videos: tuple[LiveVideo, ...] = ()
    listen: Address = DEFAULT_LISTEN
    allowed_networks: tuple[Network, ...] = LOOPBACK
    aliases: Mapping[str, str] = field(default_factory=dict)
    raw: bool = False
    lsl: str | None = None
    vmc: Address = DEFAULT_VMC
    vrchat: Address | None = None
    trackers: tuple[str, ...] = DEFAULT_TRACKED
    calibration: Path | None = None
    subject: Mapping[str, Any] | None = None
    one_euro: OneEuroSettings | None = None
    warnings: tuple[str, ...] = ()

    @property
    def marker_names(self) -> tuple[str, ...]:
        """Names of the M markers."""
        return tuple(place.name for place in self.places)


def load_live(path: str | Path) -> LiveSetup:
    """Read the file of a live run.

    Raises:
        InputError: a file that is missing or cannot be used, or a field that is missing, unknown
            or does not fit.
    """
    path = Path(path)
    top = TomlTable(path, "", read_toml(path), _TABLES)
    if "osc" in top and "lsl" in top:
        raise top.error("", "found both [osc] and [lsl], expected one source of markers")
    source = _marker_source(top)
    places = _places(top, source)
    skeleton, warnings = subject_or_default(top, need_wrists(places))
    places, unused = _without_what_no_neck_follows(path, skeleton, places, top)
    for place in places:
        if place.bone not in skeleton.tree.bones:
            expected = ", ".join(skeleton.tree.bones)
            problem = f"unknown bone {place.bone!r}, expected one of {expected}"
            raise InputError(path, f"[markers.on] {place.name}: {problem}")
    calibration, videos = _videos(top)
    return LiveSetup(
        path,
        skeleton,
        places,
        _axes(top),
        videos,
        calibration=calibration,
        subject=top.entries.get("subject"),
        one_euro=_one_euro(top),
        warnings=(*warnings, *unused),
        **source,
        **_pose_targets(top),
    )


def _places(top: TomlTable, source: Mapping[str, Any]) -> tuple[MarkerPlace, ...]:
    """Where the markers sit; a headset's orientation is the head's where nothing else is stated."""
    on = _on(top)
    headsets = {*HEADSETS, *(marker for sent, marker in source.get("aliases", {}).items()
                             if sent in HEADSETS)}  # fmt: skip
    places = []
    for name, entry in on.entries.items():
        place = read_place(top.path, name, entry)
        is_default = not {"turn", "offset_in"} & set(entry) and place.bone == "head"
        if is_default and "aliases" in source and name in headsets:
            place = replace(place, orientation=_NO_ROTATION)
        places.append(place)
    return tuple(places)


def _on(top: TomlTable) -> TomlTable:
    """The table [markers.on], its names checked."""
    keys = ("up", "to_world", "on", "filters")
    fields = TomlTable(top.path, "[markers]", top.required("markers"), keys)
    on = TomlTable(top.path, "[markers.on]", fields.required("on"))
    if not on.entries:
        raise on.error("", "names no marker, expected entries such as Hmd = { bone = 'head' }")
    if len(on.entries) > MAX_MARKERS:
        raise on.error("", f"names {len(on.entries)} markers, expected at most {MAX_MARKERS}")
    for name in on.entries:
        # It becomes part of a line of markers.csv.
        if not name or name != name.strip() or not name.isprintable():
            raise on.error("", f"found {short_repr(name)}, expected a name of printable characters")
    return on


def _without_what_no_neck_follows(
    path: Path, skeleton: Skeleton, places: tuple[MarkerPlace, ...], top: TomlTable
) -> tuple[tuple[MarkerPlace, ...], tuple[str, ...]]:
    """Places without a headset's orientation by default, where the neck does not turn."""
    if has_wrists(skeleton):
        return places, ()
    stated = _on(top).entries
    is_default = [p.orientation == _NO_ROTATION and "turn" not in stated[p.name] for p in places]
    kept = tuple(
        replace(place, orientation=None) if dropped else place
        for place, dropped in zip(places, is_default, strict=True)
    )
    problem = "its orientation is not used, for [subject] has wrists = false and no neck that turns"
    dropped = [p.name for p, dropped in zip(places, is_default, strict=True) if dropped]
    return kept, tuple(f"{path}: {name}: {problem}" for name in dropped)


def _one_euro(top: TomlTable) -> OneEuroSettings | None:
    """The one filter that does not look ahead."""
    table = top.entries["markers"].get("filters", {})
    return read_filters(TomlTable(top.path, "[markers.filters]", table, ("one_euro",))).one_euro


def _axes(top: TomlTable) -> np.ndarray:
    """As [markers] says; else Unity's for OSC, Z up for LSL."""
    fields = TomlTable(top.path, "[markers]", top.entries["markers"])
    if "up" in fields or "to_world" in fields:
        return read_axes(fields)
    return R_WORLD_OF_UP["z"] if "lsl" in top else R_WORLD_UNITY


def _marker_source(top: TomlTable) -> dict[str, Any]:
    """Where the markers come from."""
    if "lsl" in top:
        return {"lsl": _stream(TomlTable(top.path, "[lsl]", top.entries["lsl"], ("stream",)))}
    keys = ("listen", "from", "names", "raw")
    fields = TomlTable(top.path, "[osc]", top.entries.get("osc", {}), keys)
    names = TomlTable(top.path, "[osc.names]", fields.entries.get("names", {}))
    markers = list(_on(top).entries)
    for sent in names.entries:
        if (marker := names.text(sent)) not in markers:
            problem = f"no marker {short_repr(marker)} in [markers.on], found {comma_list(markers)}"
            raise names.error(sent, problem)
    raw = fields.entries.get("raw", False)
    if not isinstance(raw, bool):
        raise fields.error("raw", f"found {short_repr(raw)}, expected true or false")
    listen = read_address(fields, "listen", DEFAULT_LISTEN)
    allowed = read_allowed_networks(fields, listen)
    return {"listen": listen, "allowed_networks": allowed, "aliases": names.entries, "raw": raw}


def _stream(fields: TomlTable) -> str:
    """The name of an LSL stream, which is resolved by a query with the name in quotes."""
    name = fields.text("stream")
    if not name.isprintable() or "'" in name or len(name) > MAX_STREAM_CHARACTERS:
        expected = f"at most {MAX_STREAM_CHARACTERS} printable characters and no '"
        raise fields.error("stream", f"found {short_repr(name)}, expected {expected}")
    return name


def _pose_targets(top: TomlTable) -> dict[str, Any]:
    """Where poses go."""
    vmc = TomlTable(top.path, "[vmc]", top.entries.get("vmc", {}), ("send",))
    targets: dict[str, Any] = {"vmc": read_address(vmc, "send", DEFAULT_VMC)}
    if "vrchat" in top:
        fields = TomlTable(top.path, "[vrchat]", top.entries["vrchat"], ("send", "trackers"))
        targets |= {
            "vrchat": read_address(fields, "send", DEFAULT_VRCHAT),
            "trackers": _trackers(fields),
        }
    return targets


def _trackers(fields: TomlTable) -> tuple[str, ...]:
    """Which of ``TRACKED`` are sent, each once."""
    chosen = fields.entries.get("trackers", list(DEFAULT_TRACKED))
    is_valid = isinstance(chosen, list) and all(name in TRACKED for name in chosen)
    if not is_valid or not 0 < len(chosen) == len(set(chosen)):
        expected = f"a list of some of {', '.join(TRACKED)}, each once"
        raise fields.error("trackers", f"found {short_repr(chosen)}, expected {expected}")
    return tuple(chosen)


def _videos(top: TomlTable) -> tuple[Path | None, tuple[LiveVideo, ...]]:
    """The calibration file and the cameras."""
    tables = top.entries.get("video", [])
    if not isinstance(tables, list):
        raise top.error("[video]", "found one table, expected [[video]] in double brackets")
    if not tables:
        return None, ()
    if len(tables) > MAX_CAMERAS:
        raise top.error("", f"found {len(tables)} [[video]], expected at most {MAX_CAMERAS}")
    if "calibration" not in top:
        raise top.error("", "[calibration] is missing, which every [[video]] needs")
    calibration = TomlTable(top.path, "[calibration]", top.entries["calibration"], ("file",))
    file = calibration.file("file")
    cameras = partial(camera_of, file, read_sections(file))
    videos = tuple(_video(top.path, i, table, cameras) for i, table in enumerate(tables, 1))
    check_one_kind(top, {video.camera_name: video.camera for video in videos})
    names = [video.camera_name for video in videos]
    # Their videos are files side by side.
    if len(set(map(same_file_name, names))) < len(names):
        raise top.error("", f"found two [[video]] of one camera: {comma_list(names)}")
    return file, videos


def _video(path: Path, number: int, table: Any, cameras: Callable[[str], Camera]) -> LiveVideo:
    keys = ("device", "file", "url", "camera", "offset")
    fields = TomlTable(path, f"[[video]] number {number}", table, keys)
    given = [key for key in ("device", "file", "url") if key in fields]
    if len(given) != 1:
        stated = " and ".join(given) or "none"
        raise fields.error("", f"found {stated}, expected one of device, file, url")
    name = fields.file_name("camera")
    camera = cameras(name)
    offset = fields.number("offset", 0.0, -MAX_DELAY_S, MAX_DELAY_S)
    return LiveVideo(name, camera, _camera_source(fields, given[0]), offset)


def _camera_source(fields: TomlTable, key: str) -> int | Path | str:
    """A device's number, a file, or the address of a stream."""
    if key == "device":
        return fields.integer("device", 0, MAX_DEVICE)
    if key == "file":
        return fields.file("file")
    url = fields.text("url")
    if not _URL.fullmatch(url):
        raise fields.error(
            "url", f"found {short_repr(url)}, expected an address such as rtsp://..."
        )
    return url
