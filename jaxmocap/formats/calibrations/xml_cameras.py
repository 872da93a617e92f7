"""Cameras of XML files of others: bounded, without document types and entities.

INPUTS: bytes in UTF-8 or UTF-16. OUTPUTS: elements; a camera's attributes as numbers, and its
section in our layout; InputError in one sentence.

A document type may define entities that grow without end; no calibration has one.
"""

import json
import xml.etree.ElementTree as ET
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from jaxmocap.formats.cameras.calibration import is_rotation
from jaxmocap.formats.files.errors import InputError, short_name, short_repr
from jaxmocap.formats.files.toml import TomlTable

# A camera takes some ten elements and a hundred attributes.
MAX_ELEMENTS = 100_000
MAX_ATTRIBUTES = 1_000_000
# A camera's frame as OpenGL has it, to OpenCV's and back: x to the right, y up, z backwards.
R_CAM_OPENGL = np.diag([1.0, -1.0, -1.0])


def parse_xml(path: Path, content: bytes) -> Element:
    """An element that holds the root element; InputError for no XML, or too much of it."""
    try:
        text = content.decode(json.detect_encoding(content)).lstrip()
    except UnicodeDecodeError:
        raise InputError(path, "found bytes that are not UTF-8 or UTF-16 text") from None
    if (keyword := "<!DOCTYPE") in text:
        raise InputError(path, f"found {keyword}, expected XML without a document type")
    if text.count("<") > 2 * MAX_ELEMENTS or text.count("=") > MAX_ATTRIBUTES:
        most = f"{MAX_ELEMENTS} elements and {MAX_ATTRIBUTES} attributes"
        raise InputError(path, f"found a larger XML file than any calibration, expected {most}")
    top = Element("file")
    try:
        top.append(ET.fromstring(text))
    except (ET.ParseError, ValueError, RecursionError) as error:
        raise InputError(path, f"not XML: {error}") from None
    return top


class XmlCamera:
    """A camera's element, whose attributes are numbers where they are that.

    Attributes:
        name: of the camera.
        where: how messages name it.
        element: its element.
    """

    def __init__(self, path: Path, element: Element, name_attribute: str):
        """The camera that an attribute names; InputError where that is empty."""
        self.path, self.element = path, element
        self.name = element.get(name_attribute, "").strip()
        self.where = f"camera {short_name(self.name)}"
        if not self.name:
            found = f"found {short_repr(element.get(name_attribute))}, expected text"
            raise InputError(path, f"<{element.tag}> {name_attribute}: {found}")

    def fields(self, tags: str) -> TomlTable:
        """Attributes of the element at these tags, ``.`` the camera's; InputError without one."""
        element = self.element.find(tags)
        if element is None:
            raise InputError(self.path, f"{self.where}: <{tags}> is missing")
        fields = {name: _numbers_or_text(text) for name, text in element.attrib.items()}
        return TomlTable(self.path, f"{self.where} <{element.tag}>", fields)

    def numbers(self, tags: str, *names: str) -> np.ndarray:
        """Attributes of an element, a number each; InputError where one is missing or none."""
        fields = self.fields(tags)
        return np.array([fields.number(name) for name in names])

    def rotation(self, tags: str, *names: str) -> np.ndarray:
        """A (3, 3) rotation by nine attributes, row by row; InputError where they are none."""
        matrix = self.numbers(tags, *names).reshape(3, 3)
        if not is_rotation(matrix):
            problem = "found a 3 × 3 matrix that is not a rotation"
            raise self.fields(tags).error(f"{names[0]} ... {names[-1]}", problem)
        return matrix

    def section(
        self,
        size: np.ndarray,
        matrix: np.ndarray,
        distortions: np.ndarray,
        R_cam_source: np.ndarray,
        position_source: np.ndarray,
    ) -> tuple[str, TomlTable]:
        """Its name and section, of a camera at a position in the file's unit."""
        arrays = {
            "size": size,
            "matrix": matrix,
            "distortions": distortions,
            "rotation": R_cam_source,
            "translation": -R_cam_source @ position_source,
        }
        # As lists: messages show them as files do.
        lists = {key: each.tolist() for key, each in arrays.items()}
        return self.name, TomlTable(self.path, self.where, lists)


def pinhole(focal: np.ndarray, centre: np.ndarray, skew: float = 0.0) -> np.ndarray:
    """The intrinsic matrix (3, 3) of focal lengths (2,) and a principal point (2,), pixels."""
    return np.array([[focal[0], skew, centre[0]], [0, focal[1], centre[1]], [0, 0, 1]])


def _numbers_or_text(text: str) -> float | list[float] | str:
    try:
        numbers = [float(part) for part in text.split()]
    except ValueError:
        return text
    if not numbers:
        return text
    return numbers if len(numbers) > 1 else numbers[0]
