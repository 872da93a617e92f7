"""What a live run listens to, whose body it is, and where the poses go: a TOML file.

INPUTS: a TOML file with [markers.on], [osc] or [lsl], [[video]], [calibration], [subject], [vmc]
and [vrchat]; its paths are relative to it.
OUTPUTS: a LiveSetup.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxmocap.body.skeleton import Skeleton
from jaxmocap.formats.axes import UP, read_axes
from jaxmocap.formats.calibration import pick_camera, read_calibration
from jaxmocap.formats.errors import InputError
from jaxmocap.formats.filters import OneEuroSettings, read_filters
from jaxmocap.formats.recording import MarkerPlace, read_place
from jaxmocap.formats.subject import DEFAULT_HEIGHT, read_subject
from jaxmocap.formats.toml import Fields, read_toml
from jaxmocap.geometry.cameras import Camera

# Unity's frame is left-handed: x right, y up, z forward. The matrix is a reflection.
R_WORLD_UNITY = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
# What VRChat takes trackers of; the head tells it where our world lies in its own.
TRACKED = ("hip", "chest", "foot_l", "foot_r", "elbow_l", "elbow_r", "knee_l", "knee_r", "head")
# Knees hide little that feet and hips do not tell.
USUALLY_TRACKED = tuple(name for name in TRACKED if not name.startswith("knee"))
_TABLES = ("markers", "osc", "lsl", "video", "calibration", "subject", "vmc", "vrchat")


class Address(NamedTuple):
    """Where packets come in or go out.

    Attributes:
        host: name or number; the loopback interface unless told otherwise.
        port: of UDP.
    """

    host: str = "127.0.0.1"
    port: int = 0

    def __str__(self) -> str:
        return f"{self.host}:{self.port}"


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
        return {"lsl": Fields(top.path, "[lsl]", top.table["lsl"], ("stream",)).text("stream")}
    fields = Fields(top.path, "[osc]", top.table.get("osc", {}), ("listen", "names", "raw"))
    names = Fields(top.path, "[osc.names]", fields.table.get("names", {}))
    markers = [place.name for place in places]
    for sent in names.table:
        if (marker := names.text(sent)) not in markers:
            problem = f"no marker {marker!r} in [markers.on], found {', '.join(markers)}"
            raise names.error(sent, problem)
    raw = fields.table.get("raw", False)
    if not isinstance(raw, bool):
        raise fields.error("raw", f"found {raw!r}, expected true or false")
    return {"listen": _address(fields, "listen", LISTEN), "aliases": names.table, "raw": raw}


def _sinks(top: Fields) -> dict[str, Any]:
    """Where poses go."""
    vmc = Fields(top.path, "[vmc]", top.table.get("vmc", {}), ("send",))
    found: dict[str, Any] = {"vmc": _address(vmc, "send", VMC)}
    if "vrchat" in top:
        fields = Fields(top.path, "[vrchat]", top.table["vrchat"], ("send", "trackers"))
        chosen = fields.table.get("trackers", list(USUALLY_TRACKED))
        if (
            not isinstance(chosen, list)
            or not chosen
            or any(name not in TRACKED for name in chosen)
        ):
            expected = f"a list of some of {', '.join(TRACKED)}"
            raise fields.error("trackers", f"found {chosen!r}, expected {expected}")
        found |= {"vrchat": _address(fields, "send", VRCHAT), "trackers": tuple(chosen)}
    return found


def _address(fields: Fields, key: str, default: Address) -> Address:
    """An address as "host:port" or as a port alone; or the default."""
    value = fields.table.get(key, default.port)
    host, _, port = str(value).rpartition(":")
    if isinstance(value, bool) or not port.isdecimal() or not 0 <= int(port) < 65536:
        expected = f"an address such as '{default}', or a port"
        raise fields.error(key, f"found {value!r}, expected {expected}")
    return Address(host.strip("[]") or default.host, int(port))


def _videos(top: Fields) -> tuple[Path | None, tuple[LiveVideo, ...]]:
    """The calibration file and the cameras."""
    tables = top.table.get("video", [])
    if not isinstance(tables, list):
        raise top.error("[video]", "found one table, expected [[video]] in double brackets")
    if not tables:
        return None, ()
    if "calibration" not in top:
        raise top.error("", "[calibration] is missing, which every [[video]] needs")
    calibration = Fields(top.path, "[calibration]", top.table["calibration"], ("file",))
    file = calibration.file("file")
    cameras = read_calibration(file)
    videos = tuple(_video(top.path, i, table, file, cameras) for i, table in enumerate(tables, 1))
    names = [video.camera_name for video in videos]
    if len(set(names)) < len(names):
        raise top.error("", f"found two [[video]] of one camera: {', '.join(names)}")
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
    source: int | Path | str
    if given == ["device"]:
        device = fields.number("device")
        if device != int(device) or device < 0:
            raise fields.error("device", f"found {device:g}, expected 0, 1, 2, ...")
        source = int(device)
    else:
        source = fields.file("file") if given == ["file"] else fields.text("url")
    name = fields.text("camera")
    camera = pick_camera(calibration, cameras, name)
    return LiveVideo(name, camera, source, fields.number("offset", 0.0))
