"""What calibrations of all systems share: a file opened once, and the cameras that it holds.

INPUTS: a file or a folder. OUTPUTS: its content by its kind; a record of its cameras.
"""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

from jaxmocap.formats.calibrations.plain_pickle import FIRST_BYTE, read_plain_pickle
from jaxmocap.formats.calibrations.xml_cameras import parse_xml
from jaxmocap.formats.cameras.opencv_yaml import read_entries
from jaxmocap.formats.files.errors import InputError, comma_list
from jaxmocap.formats.files.reading import read_bytes
from jaxmocap.formats.files.toml import TomlTable, read_toml

# A Motive file with the masks of a hundred cameras takes some ten megabytes.
MAX_SOURCE_BYTES = 32 * 2**20
YAML_START = (b"%YAML", b"---")


@dataclass(frozen=True)
class Source:
    """A file that may be a calibration, parsed by its kind."""

    path: Path  # of the file or folder
    # An element that holds the root of an XML file, else nothing.
    xml: Element = field(default_factory=lambda: Element("file"))
    toml: Mapping[str, Any] = field(default_factory=dict)  # tables of a TOML file
    yaml: Mapping[str, Any] = field(default_factory=dict)  # entries of a file of OpenCV's YAML
    pickled: Any = None  # what a pickle holds


@dataclass(frozen=True)
class SourceCalibration:
    """All cameras of a calibration, in the file's own unit and axes."""

    # Name and section of each: size (missing where the file does not state it), matrix,
    # distortions, fisheye, rotation and translation as in our own files.
    cameras: Sequence[tuple[str, TomlTable]]
    unit: str  # of its lengths, a key of ``tables.UNITS``
    up: str  # its axis that points up, a key of ``registry.R_WORLD_OF_SOURCE_UP``
    states_unit: bool = True  # whether the unit is the system's own; else a user may state another
    assumed_up: str = ""  # what was assumed about the axis, where it is not documented; else empty
    notes: Sequence[str] = ()  # sentences about what was left out or assumed


def open_source(path: Path) -> Source:
    """Read a file by what it begins with, or take a folder as it is; InputError for neither."""
    if os.path.isdir(path):
        return Source(path)
    content = read_bytes(path, MAX_SOURCE_BYTES)
    if not content.strip():
        raise InputError(path, "the file is empty")
    # In UTF-8 or UTF-16.
    if content[:256].lstrip(b"\xef\xbb\xbf\xfe\xff\0 \t\r\n").startswith(b"<"):
        return Source(path, xml=parse_xml(path, content))
    if content[:1] == FIRST_BYTE:
        return Source(path, pickled=read_plain_pickle(path, content))
    is_yaml = path.suffix.lower() in (".yml", ".yaml")
    if is_yaml or content.removeprefix(b"\xef\xbb\xbf").startswith(YAML_START):
        return Source(path, yaml=read_entries(path))
    return Source(path, toml=read_toml(path) if path.suffix.lower() == ".toml" else {})


def left_out(why: str, names: Sequence[str]) -> list[str]:
    """The sentence about cameras that are left out, where there are any."""
    return [f"left out: {why}: {comma_list(names)}"] if names else []
