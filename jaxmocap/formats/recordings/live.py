"""What a live run listens to, whose body it is, and where the poses go: a TOML file.

INPUTS: a TOML file with [markers.on], [osc] or [lsl], [[video]], [calibration], [subject], [vmc]
and [vrchat]; its paths are relative to it.
OUTPUTS: a LiveSetup.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from jaxmocap.body.skeleton import Skeleton
from jaxmocap.formats.cameras.calibration import check_one_kind, pick_camera, read_calibration
from jaxmocap.formats.files.addresses import (
    LOOPBACK,
    Address,
    Network,
    read_address,
    read_senders,
)
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.files.shortened import listed, shown
from jaxmocap.formats.files.toml import Fields, read_toml, same_file_name
from jaxmocap.formats.recordings.filters import OneEuroSettings, read_filters
from jaxmocap.formats.recordings.recording import MarkerPlace, read_place
from jaxmocap.formats.recordings.subject import DEFAULT_HEIGHT, read_subject
from jaxmocap.formats.time_series.axes import UP, read_axes
from jaxmocap.geometry.cameras import Camera

# Unity's frame is left-handed: x right, y up, z forward. The matrix is a reflection.
R_WORLD_UNITY = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
# What VRChat takes trackers of; the head tells it where our world lies in its own.
TRACKED = ("hip", "chest", "foot_l", "foot_r", "elbow_l", "elbow_r", "knee_l", "knee_r", "head")
# Knees hide little that feet and hips do not tell.
USUALLY_TRACKED = tuple(name for name in TRACKED if not name.startswith("knee"))
# More than any live run has; compiling takes as long as there are markers and cameras.
MOST_MARKERS = 200
MOST_CAMERAS = 16
# No camera is slower, seconds.
MOST_DELAY_S = 60.0
# Devices are counted from 0.
MOST_DEVICE = 999
# Characters of the name of an LSL stream.
LONGEST_STREAM = 200
# The address of a stream; a file has a field of its own.
_URL = re.compile(r"(?!file:)[a-z][a-z0-9+.-]*://[!-~]+", re.IGNORECASE)
_TABLES = ("markers", "osc", "lsl", "video", "calibration", "subject", "vmc", "vrchat")


LISTEN, VMC, VRCHAT = (Address(port=port) for port in (39540, 39539, 9000))


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
    """What a live run needs to know.

    Attributes:
        path: of the file.
        skeleton: of the person.
        places: of the M markers.
        R_world_source: (3, 3) from the markers' axes to the world's.
        videos: any number of cameras.
        listen: where OSC comes in.
        senders: networks whose packets count; what others send is counted and ignored.
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
    listen: Address = LISTEN
    senders: tuple[Network, ...] = LOOPBACK
    aliases: Mapping[str, str] = field(default_factory=dict)
    raw: bool = False
    lsl: str | None = None
    vmc: Address = VMC
    vrchat: Address | None = None
    trackers: tuple[str, ...] = USUALLY_TRACKED
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
    top = Fields(path, "", read_toml(path), _TABLES)
    if "osc" in top and "lsl" in top:
        raise top.error("", "found both [osc] and [lsl], expected one source of markers")
    places = _places(top)
    skeleton, warnings = Skeleton.human(DEFAULT_HEIGHT), ()
    if "subject" in top:
        skeleton = read_subject(path, "[subject]", top.table["subject"])
    else:
        warnings = (f"{path}: no [subject], a height of {DEFAULT_HEIGHT} m is assumed",)
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
        subject=top.table.get("subject"),
        one_euro=_one_euro(top),
        warnings=warnings,
        **_source(top, places),
        **_sinks(top),
    )


def _places(top: Fields) -> tuple[MarkerPlace, ...]:
    keys = ("up", "to_world", "on", "filters")
    fields = Fields(top.path, "[markers]", top.required("markers"), keys)
    on = Fields(top.path, "[markers.on]", fields.required("on"))
    if not on.table:
        raise on.error("", "names no marker, expected entries such as Hmd = { bone = 'head' }")
    if len(on.table) > MOST_MARKERS:
        raise on.error("", f"names {len(on.table)} markers, expected at most {MOST_MARKERS}")
    for name in on.table:
        # It becomes part of a line of markers.csv.
        if not name or name != name.strip() or not name.isprintable():
            raise on.error("", f"found {shown(name)}, expected a name of printable characters")
    return tuple(read_place(top.path, name, entry) for name, entry in on.table.items())


def _one_euro(top: Fields) -> OneEuroSettings | None:
    """The one filter that does not look ahead."""
    table = top.table["markers"].get("filters", {})
    return read_filters(Fields(top.path, "[markers.filters]", table, ("one_euro",))).one_euro


def _axes(top: Fields) -> np.ndarray:
    """As [markers] says; else Unity's for OSC, Z up for LSL."""
    fields = Fields(top.path, "[markers]", top.table["markers"])
    if "up" in fields or "to_world" in fields:
        return read_axes(fields)
    return UP["z"] if "lsl" in top else R_WORLD_UNITY


def _source(top: Fields, places: tuple[MarkerPlace, ...]) -> dict[str, Any]:
    """Where the markers come from."""
    if "lsl" in top:
        return {"lsl": _stream(Fields(top.path, "[lsl]", top.table["lsl"], ("stream",)))}
    keys = ("listen", "from", "names", "raw")
    fields = Fields(top.path, "[osc]", top.table.get("osc", {}), keys)
    names = Fields(top.path, "[osc.names]", fields.table.get("names", {}))
    markers = [place.name for place in places]
    for sent in names.table:
        if (marker := names.text(sent)) not in markers:
            problem = f"no marker {shown(marker)} in [markers.on], found {listed(markers)}"
            raise names.error(sent, problem)
    raw = fields.table.get("raw", False)
    if not isinstance(raw, bool):
        raise fields.error("raw", f"found {shown(raw)}, expected true or false")
    listen = read_address(fields, "listen", LISTEN)
    senders = read_senders(fields, listen)
    return {"listen": listen, "senders": senders, "aliases": names.table, "raw": raw}


def _stream(fields: Fields) -> str:
    """The name of an LSL stream, which is looked for by a query with the name in quotes."""
    name = fields.text("stream")
    if not name.isprintable() or "'" in name or len(name) > LONGEST_STREAM:
        expected = f"at most {LONGEST_STREAM} printable characters and no '"
        raise fields.error("stream", f"found {shown(name)}, expected {expected}")
    return name


def _sinks(top: Fields) -> dict[str, Any]:
    """Where poses go."""
    vmc = Fields(top.path, "[vmc]", top.table.get("vmc", {}), ("send",))
    found: dict[str, Any] = {"vmc": read_address(vmc, "send", VMC)}
    if "vrchat" in top:
        fields = Fields(top.path, "[vrchat]", top.table["vrchat"], ("send", "trackers"))
        found |= {"vrchat": read_address(fields, "send", VRCHAT), "trackers": _trackers(fields)}
    return found


def _trackers(fields: Fields) -> tuple[str, ...]:
    """Which of ``TRACKED`` are sent, each once."""
    chosen = fields.table.get("trackers", list(USUALLY_TRACKED))
    named = isinstance(chosen, list) and all(name in TRACKED for name in chosen)
    if not named or not 0 < len(chosen) == len(set(chosen)):
        expected = f"a list of some of {', '.join(TRACKED)}, each once"
        raise fields.error("trackers", f"found {shown(chosen)}, expected {expected}")
    return tuple(chosen)


def _videos(top: Fields) -> tuple[Path | None, tuple[LiveVideo, ...]]:
    """The calibration file and the cameras."""
    tables = top.table.get("video", [])
    if not isinstance(tables, list):
        raise top.error("[video]", "found one table, expected [[video]] in double brackets")
    if not tables:
        return None, ()
    if len(tables) > MOST_CAMERAS:
        raise top.error("", f"found {len(tables)} [[video]], expected at most {MOST_CAMERAS}")
    if "calibration" not in top:
        raise top.error("", "[calibration] is missing, which every [[video]] needs")
    calibration = Fields(top.path, "[calibration]", top.table["calibration"], ("file",))
    file = calibration.file("file")
    cameras = read_calibration(file)
    videos = tuple(_video(top.path, i, table, file, cameras) for i, table in enumerate(tables, 1))
    check_one_kind(top, {video.camera_name: video.camera for video in videos})
    names = [video.camera_name for video in videos]
    # Their videos are files side by side.
    if len(set(map(same_file_name, names))) < len(names):
        raise top.error("", f"found two [[video]] of one camera: {listed(names)}")
    return file, videos


def _video(
    path: Path, number: int, table: Any, calibration: Path, cameras: dict[str, Camera]
) -> LiveVideo:
    keys = ("device", "file", "url", "camera", "offset")
    fields = Fields(path, f"[[video]] number {number}", table, keys)
    given = [key for key in ("device", "file", "url") if key in fields]
    if len(given) != 1:
        found = " and ".join(given) or "none"
        raise fields.error("", f"found {found}, expected one of device, file, url")
    name = fields.file_name("camera")
    camera = pick_camera(calibration, cameras, name)
    offset = fields.number("offset", 0.0, -MOST_DELAY_S, MOST_DELAY_S)
    return LiveVideo(name, camera, _camera_source(fields, given[0]), offset)


def _camera_source(fields: Fields, key: str) -> int | Path | str:
    """A device's number, a file, or the address of a stream."""
    if key == "device":
        return fields.whole("device", 0, MOST_DEVICE)
    if key == "file":
        return fields.file("file")
    url = fields.text("url")
    if not _URL.fullmatch(url):
        raise fields.error("url", f"found {shown(url)}, expected an address such as rtsp://...")
    return url
