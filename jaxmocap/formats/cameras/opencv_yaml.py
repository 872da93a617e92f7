"""Camera calibrations in YAML, as OpenCV's FileStorage and ROS write them.

INPUTS: a .yml or .yaml file with camera_matrix, distortion_coefficients, image_width and
image_height; rvec (or R) and tvec (or T), world to camera, where the camera was placed.
OUTPUTS: the camera as a table of the TOML layout, by its name (``camera_name``, or the file's).
"""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.files.reading import read_lines

YAML_SUFFIXES = (".yml", ".yaml")
# Field of the TOML layout -> what it is called in such files.
_NAMES = {
    "size": ("image_width", "image_height"),
    "matrix": ("camera_matrix", "cameraMatrix", "Camera_Matrix"),
    "distortions": ("distortion_coefficients", "distCoeffs", "dist_coeffs"),
    "rotation": ("rvec", "R", "rotation"),
    "translation": ("tvec", "T", "translation"),
}
_ENTRY = re.compile(r"(\s*)([\w.-]+)\s*:\s*(.*)")
_TAGS = ("!!opencv-matrix", "!!opencv-nd-matrix")
_MATRIX = ("rows", "cols", "sizes", "dt", "data")


def read_opencv_yaml(path: str | Path) -> dict[str, dict[str, Any]]:
    """A camera by its name: size, matrix, distortions, place if it has one; InputError for none."""
    path = Path(path)
    entries = read_entries(path)
    # As OpenCV's calibration sample and ROS say so.
    model = str(entries.get("distortion_model", "")).strip("\"'").lower()
    flag = str(entries.get("fisheye_model", entries.get("fisheye", "0"))).lower()
    fisheye = model in ("equidistant", "fisheye", "kannala_brandt") or flag in ("1", "true")
    table = {"fisheye": fisheye} | camera_table(path, entries, _NAMES)
    if "matrix" not in table:
        raise InputError(path, "found no camera_matrix, expected a calibration in OpenCV's YAML")
    name = entries.get("camera_name", "")
    return {(name.strip("\"'") if isinstance(name, str) else "") or path.stem: table}


def camera_table(
    path: Path, entries: dict[str, Any], names: Mapping[str, Sequence[str]]
) -> dict[str, Any]:
    """The fields of a camera that ``read_entries`` has; InputError for an incomplete matrix.

    Of each field's names the first that is there counts; of the size both sides' are needed.
    """
    table = {}
    for field, keys in names.items():
        there = [key for key in keys if key in entries]
        if field == "size" and there == list(keys):
            table[field] = [_number_or_text(entries[key]) for key in keys]
        elif field != "size" and there:
            table[field] = _matrix(path, there[0], entries[there[0]], flat=field != "matrix")
    return table


def read_entries(path: Path) -> dict[str, Any]:
    """Top-level keys: their text, or a dict of text of indented keys; InputError names the line."""
    entries: dict[str, Any] = {}
    inside: dict[str, Any] | None = None
    # Where data that goes on belongs: a key's lines, joined at the end.
    last: list[str] | None = None
    for number, line in enumerate(read_lines(path), 1):
        bare = line.split("#")[0].rstrip()
        if not bare.strip() or bare.startswith(("%", "---", "...")):
            continue
        match = _ENTRY.fullmatch(bare)
        if match and not match[1]:
            key, text = match[2], match[3]
            # A matrix, or another map: what is indented belongs to it.
            inside, last = ({}, None) if text in ("", *_TAGS) else (None, [text])
            entries[key] = last if inside is None else inside
        elif match and inside is not None and match[2] in _MATRIX:
            inside[match[2]] = last = [match[3]]
        elif bare[0].isspace() and last is not None:
            last.append(bare.strip())
        elif not bare[0].isspace() and not bare.startswith(("-", "]")):
            shown = bare.strip()[:40]
            raise InputError(path, f"line {number}: found {shown!r}, expected OpenCV's YAML")
    return {
        key: " ".join(value)
        if isinstance(value, list)
        else {inner: " ".join(lines) for inner, lines in value.items()}
        for key, value in entries.items()
    }


def _number_or_text(text: Any) -> Any:
    try:
        return float(text)
    except (TypeError, ValueError):
        return text


def _matrix(path: Path, name: str, entry: Any, flat: bool) -> list:
    """Rows of numbers, or flat numbers where it is a vector by its nature."""
    fields = entry if isinstance(entry, dict) else {}
    text = fields.get("data", "").strip()
    try:
        # OpenCV 5 writes a vector with its sizes only.
        rows, columns = (
            (1, int(fields["sizes"].strip("[] ")))
            if "sizes" in fields
            else (int(fields["rows"]), int(fields["cols"]))
        )
        if not (text.startswith("[") and text.endswith("]")):
            raise ValueError
        data = [float(number) for number in text[1:-1].split(",") if number.strip()]
        if min(rows, columns) < 1 or rows * columns != len(data):
            raise ValueError
    except (KeyError, ValueError, TypeError):
        expected = "expected rows, cols and as many numbers in data"
        raise InputError(path, f"{name}: is not a complete matrix, {expected}") from None
    if flat and 1 in (rows, columns):
        return data
    return [data[i * columns : (i + 1) * columns] for i in range(rows)]
