"""What a calibration of another system holds, before its axes and unit become ours.

INPUTS: a file or a folder, opened once. OUTPUTS: its content by its kind; a record of its cameras.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from jaxmocap.formats.calibrations.plain_pickle import FIRST_BYTE, read_plain_pickle
from jaxmocap.formats.calibrations.xml_text import is_xml, parse_xml
from jaxmocap.formats.cameras.opencv_yaml import read_entries
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.files.reading import read_bytes
from jaxmocap.formats.files.short_repr import short_name
from jaxmocap.formats.files.toml import is_folder, read_toml

# A Motive file with the masks of a hundred cameras takes some ten megabytes.
MAX_SOURCE_BYTES = 32 * 2**20
YAML_START = (b"%YAML", b"---")


@dataclass(frozen=True)
class Source:
    """A file that may be a calibration, parsed by its kind.

    Attributes:
        path: of the file or folder.
        xml: root element of an XML file.
        toml: tables of a TOML file.
        yaml: entries of a file of OpenCV's YAML.
        pickled: what a pickle holds.
    """

    path: Path
    xml: Element | None = None
    toml: Mapping[str, Any] | None = None
    yaml: Mapping[str, Any] | None = None
    pickled: Any = None

    @property
    def is_folder(self) -> bool:
        """Whether it is a folder of files."""
        return is_folder(self.path)


@dataclass(frozen=True)
class SourceCamera:
    """One camera, its frame OpenCV's, its world the file's.

    Attributes:
        name: of the camera.
        matrix: (3, 3) intrinsic matrix, pixels; the first pixel's centre is 0, 0.
        distortions: OpenCV's k1 k2 p1 p2 k3 k4 k5 k6, or a fisheye's k1 k2 k3 k4.
        R_cam_source: (3, 3) from the file's world to the camera.
        t_cam_source: (3,) from the file's world to the camera, in the file's unit.
        size: (2,) width and height in pixels; None where the file does not state it.
        fisheye: whether it is one.
    """

    name: str
    matrix: np.ndarray
    distortions: np.ndarray
    R_cam_source: np.ndarray
    t_cam_source: np.ndarray
    size: np.ndarray | None
    fisheye: bool = False


@dataclass(frozen=True)
class SourceCalibration:
    """All cameras of a calibration.

    Attributes:
        cameras: those that it places.
        unit: of its lengths, a key of ``registry.METRES_PER_UNIT``.
        up: its axis that points up, a key of ``registry.R_WORLD_OF_SOURCE_UP``.
        states_unit: whether the unit is the system's own; else a user may state another.
        assumed_up: what was assumed about the axis, where it is not documented; else empty.
        notes: sentences about what was left out or assumed.
    """

    cameras: tuple[SourceCamera, ...]
    unit: str
    up: str
    states_unit: bool = True
    assumed_up: str = ""
    notes: tuple[str, ...] = ()


def open_source(path: Path) -> Source:
    """Read a file by what it begins with, or take a folder as it is.

    Raises:
        InputError: no such file, too large, or not what it begins as.
    """
    if is_folder(path):
        return Source(path)
    content = read_bytes(path, MAX_SOURCE_BYTES)
    if not content.strip():
        raise InputError(path, "the file is empty")
    if is_xml(content):
        return Source(path, xml=parse_xml(path, content))
    if content[:1] == FIRST_BYTE:
        return Source(path, pickled=read_plain_pickle(path, content))
    is_yaml = path.suffix.lower() in (".yml", ".yaml")
    if is_yaml or content.removeprefix(b"\xef\xbb\xbf").startswith(YAML_START):
        return Source(path, yaml=read_entries(path))
    if path.suffix.lower() == ".toml":
        return Source(path, toml=read_toml(path))
    return Source(path)


def from_position(R_cam_source: np.ndarray, position_source: np.ndarray) -> np.ndarray:
    """The translation (3,), world to camera, of a camera at a position (3,)."""
    return -R_cam_source @ position_source


def camera_place(name: str) -> str:
    """How messages name a camera."""
    return f"camera {short_name(name)}"
