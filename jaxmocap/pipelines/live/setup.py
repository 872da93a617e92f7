"""What a live run listens to, whose body it is, and where the poses go: a TOML file.

INPUTS: a TOML file with [markers.on], [[video]], [calibration], [subject], and a table of a source
or of senders; its paths are relative to it.
OUTPUTS: a LiveSetup.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from jaxmocap.body.skeleton import Skeleton, has_wrists
from jaxmocap.capture.streams.cameras import LiveVideo, read_live_videos
from jaxmocap.capture.streams.lsl import LslTable
from jaxmocap.capture.streams.source import SourceTable
from jaxmocap.capture.streams.udp import OscTable
from jaxmocap.formats.files.errors import short_repr
from jaxmocap.formats.files.toml import TomlTable, read_toml
from jaxmocap.formats.recordings.filters import OneEuroSettings, read_filters
from jaxmocap.formats.recordings.marker_places import (
    MarkerPlace,
    check_bones,
    need_wrists,
    read_place,
)
from jaxmocap.formats.recordings.subject import subject_or_default
from jaxmocap.formats.time_series.axes import read_axes
from jaxmocap.outputs.senders.osc import SenderTable
from jaxmocap.outputs.senders.vmc import VmcTable
from jaxmocap.outputs.senders.vrchat import VrchatTable

# Name of a table -> what it asks for. A run has one source, the first where its file names none.
SOURCES: dict[str, type[SourceTable]] = {"osc": OscTable, "lsl": LslTable}
SENDERS: dict[str, type[SenderTable]] = {"vmc": VmcTable, "vrchat": VrchatTable}
# Of [markers].
LIVE_MARKERS_KEYS = ("up", "to_world", "on", "filters")
# More than any live run has; compiling takes as long as there are markers.
MAX_MARKERS = 200
# The rotation by nothing, wxyz.
_NO_ROTATION = (1.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class LiveSetup:
    """The set-up of a live run."""

    path: Path  # of the file
    skeleton: Skeleton  # of the person
    places: tuple[MarkerPlace, ...]  # of the M markers
    R_world_source: np.ndarray  # (3, 3) from the markers' axes to the world's
    videos: tuple[LiveVideo, ...] = ()  # any number of cameras
    source: SourceTable = field(default_factory=OscTable)  # where markers come from
    # Where poses go.
    senders: tuple[SenderTable, ...] = field(default_factory=lambda: (VmcTable(),))
    calibration: Path | None = None  # the calibration file, or None
    subject: Mapping[str, Any] | None = None  # the table [subject] as it stands, or None
    one_euro: OneEuroSettings | None = None  # of the filter that the markers go through, or None
    warnings: tuple[str, ...] = ()  # sentences that a user should see

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
    tables = ("markers", *SOURCES, "video", "calibration", "subject", *SENDERS)
    top = TomlTable(path, "", read_toml(path), tables)
    asked = [name for name in SOURCES if name in top]
    if len(asked) > 1:
        found = " and ".join(f"[{name}]" for name in asked)
        raise top.error("", f"found both {found}, expected one source of markers")
    name, on = next(iter(asked or SOURCES)), _on(top)
    source = SOURCES[name].read(_table(top, name, SOURCES[name].keys), on.entries)
    places = _places(on, source)
    skeleton, warnings = subject_or_default(top, need_wrists(places))
    places, unused = _without_what_no_neck_follows(on, skeleton, places)
    check_bones(path, places, skeleton)
    calibration, videos = read_live_videos(top)
    fields = TomlTable(path, "[markers]", top.entries["markers"])
    states_axes = "up" in fields or "to_world" in fields
    # The one filter that does not look ahead.
    filters = TomlTable(path, "[markers.filters]", fields.entries.get("filters", {}), ("one_euro",))
    return LiveSetup(
        path,
        skeleton,
        places,
        read_axes(fields) if states_axes else source.R_world_source,
        videos,
        source,
        tuple(
            kind.read(_table(top, name, kind.keys))
            for name, kind in SENDERS.items()
            if name in top or kind.is_default
        ),
        calibration,
        top.entries.get("subject"),
        read_filters(filters).one_euro,
        (*warnings, *unused),
    )


def _table(top: TomlTable, name: str, keys: tuple[str, ...]) -> TomlTable:
    """A table of the file, empty where there is none."""
    return TomlTable(top.path, f"[{name}]", top.entries.get(name, {}), keys)


def _places(on: TomlTable, source: SourceTable) -> tuple[MarkerPlace, ...]:
    """Where the markers sit; a headset's orientation is the head's where nothing else is stated."""
    places = []
    for name, entry in on.entries.items():
        place = read_place(on.path, name, entry)
        is_default = not {"turn", "offset_in"} & set(entry) and place.bone == "head"
        if is_default and name in source.headsets:
            place = replace(place, orientation=_NO_ROTATION)
        places.append(place)
    return tuple(places)


def _on(top: TomlTable) -> TomlTable:
    """The table [markers.on], its names checked."""
    fields = TomlTable(top.path, "[markers]", top.require("markers"), LIVE_MARKERS_KEYS)
    on = TomlTable(top.path, "[markers.on]", fields.require("on"))
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
    on: TomlTable, skeleton: Skeleton, places: tuple[MarkerPlace, ...]
) -> tuple[tuple[MarkerPlace, ...], tuple[str, ...]]:
    """Places without a headset's orientation by default, where the neck does not turn."""
    if has_wrists(skeleton):
        return places, ()
    dropped = [p.name for p in places
               if p.orientation == _NO_ROTATION and "turn" not in on.entries[p.name]]  # fmt: skip
    kept = tuple(replace(p, orientation=None) if p.name in dropped else p for p in places)
    problem = "its orientation is not used, for [subject] has wrists = false and no neck that turns"
    return kept, tuple(f"{on.path}: {name}: {problem}" for name in dropped)
