"""XML from files of others: bounded, without document types and entities.

INPUTS: bytes in UTF-8 or UTF-16. OUTPUTS: elements, and their attributes as numbers; InputError
in one sentence.

A document type may define entities that grow without end; no calibration has one.
"""

import xml.etree.ElementTree as ET
from pathlib import Path
from xml.etree.ElementTree import Element

from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.files.short_repr import short_repr
from jaxmocap.formats.files.toml import TomlTable

# A camera takes some ten elements and a hundred attributes.
MAX_ELEMENTS = 100_000
MAX_ATTRIBUTES = 1_000_000
_UTF8_MARK = b"\xef\xbb\xbf"
_UTF16_MARKS = (b"\xff\xfe", b"\xfe\xff")


def is_xml(content: bytes) -> bool:
    """Does a file begin as XML does?"""
    start = content[:256]
    if start.startswith((*_UTF16_MARKS, b"<\0", b"\0<")):
        return True
    return start.removeprefix(_UTF8_MARK).lstrip().startswith(b"<")


def parse_xml(path: Path, content: bytes) -> Element:
    """The root element.

    Raises:
        InputError: not XML, not UTF-8 or UTF-16, with a document type, or of too many parts.
    """
    text = _decoded(path, content)
    for keyword in ("<!DOCTYPE", "<!ENTITY"):
        if keyword in text:
            raise InputError(path, f"found {keyword}, expected XML without a document type")
    if text.count("<") > 2 * MAX_ELEMENTS or text.count("=") > MAX_ATTRIBUTES:
        most = f"{MAX_ELEMENTS} elements and {MAX_ATTRIBUTES} attributes"
        raise InputError(path, f"found a larger XML file than any calibration, expected {most}")
    try:
        return ET.fromstring(text)
    except (ET.ParseError, ValueError, RecursionError) as error:
        raise InputError(path, f"not XML: {error}") from None


def _decoded(path: Path, content: bytes) -> str:
    if content.startswith(_UTF16_MARKS):
        encoding = "utf-16"
    elif content.startswith(b"<\0"):
        encoding = "utf-16-le"
    elif content.startswith(b"\0<"):
        encoding = "utf-16-be"
    else:
        encoding = "utf-8-sig"
    try:
        return content.decode(encoding).lstrip()
    except UnicodeDecodeError:
        raise InputError(path, "found bytes that are not UTF-8 or UTF-16 text") from None


def attributes(path: Path, where: str, element: Element | None, tag: str) -> TomlTable:
    """An element's attributes as fields, each a number or a list of numbers where it is that.

    Args:
        path: of the file, for messages.
        where: the camera, for messages.
        element: the element; InputError where it is None.
        tag: of the element.
    """
    if element is None:
        raise InputError(path, f"{where}: <{tag}> is missing")
    fields = {name: _numbers_or_text(text) for name, text in element.attrib.items()}
    return TomlTable(path, f"{where} <{tag}>", fields)


def _numbers_or_text(text: str) -> float | list[float] | str:
    try:
        numbers = [float(part) for part in text.split()]
    except ValueError:
        return text
    if not numbers:
        return text
    return numbers if len(numbers) > 1 else numbers[0]


def text_attribute(path: Path, where: str, element: Element, name: str) -> str:
    """A required attribute that is not empty."""
    text = element.get(name, "").strip()
    if not text:
        found = short_repr(element.get(name))
        raise InputError(path, f"{where} {name}: found {found}, expected text")
    return text
