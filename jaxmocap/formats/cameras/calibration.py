"""Camera calibrations in the TOML layout that anipose and Pose2Sim share, or in OpenCV's YAML.

INPUTS: a .toml file with one section per camera: size, matrix, distortions, rotation (Rodrigues
vector, world to camera), translation (metres, world to camera), fisheye; or a .yml file.
OUTPUTS: Cameras by the name of their section, or one camera's Intrinsics; such a .toml file, or one
section of it replaced.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from scipy.spatial.transform import Rotation

from jaxmocap.formats.cameras.opencv_yaml import YAML_SUFFIXES, read_opencv_yaml
from jaxmocap.formats.cameras.toml_sections import replace_entries, rewrite_toml
from jaxmocap.formats.files.errors import InputError, comma_list, short_name, short_repr
from jaxmocap.formats.files.toml import (
    TomlTable,
    file_name_problem,
    parse_toml,
    read_toml,
    toml_key,
    write_toml,
)
from jaxmocap.formats.files.writing import check_target, write_text
from jaxmocap.formats.time_series.tables import FARTHEST_M
from jaxmocap.geometry.cameras import Camera, lens_problem
from jaxmocap.geometry.lenses import BROWN_CONRADY, FISHEYE, LENSES
from jaxmocap.geometry.rotations import log

# A section of this name is about the calibration, not of a camera.
METADATA_SECTION = "metadata"
# How far R Rᵀ may be from the identity: files print four digits or more.
ORTHONORMAL_TOLERANCE = 1e-3
# Radians of a Rodrigues vector, which need not be the shortest.
LARGEST_ROTATION = 1e3
# Of a focal length in the picture's longer side: a lens of 170° has 1/23.
LEAST_FOCAL_SHARE = 1 / 25
_Section = TypeVar("_Section")


@dataclass(frozen=True)
class Intrinsics:
    """A camera's intrinsics, in double precision, as files hold them."""

    size: np.ndarray  # (2,) width and height, pixels
    matrix: np.ndarray  # (3, 3) intrinsic matrix, pixels
    # Up to 8 of OpenCV's k1 k2 p1 p2 k3 k4 k5 k6; of a fisheye up to 4, k1 k2 k3 k4.
    distortions: np.ndarray
    fisheye: bool = False

    @property
    def model(self) -> str:
        """Its name in ``geometry.lenses.LENSES``."""
        return FISHEYE if self.fisheye else BROWN_CONRADY

    def entries(self) -> dict[str, Any]:
        """Its fields in a section of the file."""
        fields = {"size": self.size, "matrix": self.matrix, "distortions": self.distortions}
        return fields | {"fisheye": self.fisheye}


def read_sections(path: str | Path) -> dict[str, Any]:
    """A calibration file's sections as they stand; InputError without any. See ``camera_of``."""
    path = Path(path)
    sections = _sections(path)
    if not sections:
        raise InputError(path, "found no camera section")
    return sections


def camera_of(
    path: str | Path, sections: Mapping[str, Any], name: str, origin_world: np.ndarray | None = None
) -> Camera:
    """The camera of one of ``read_sections``; the others need not be complete, nor placed.

    ``origin_world`` (3,), metres, is subtracted from the camera's position.

    Raises:
        InputError: no such section, or a field of it that is missing or does not fit.
    """
    fields = TomlTable(Path(path), f"[{name}]", pick_camera(path, sections, name))
    lens = read_lens(fields)
    R_cam_world, translation = read_place(fields)
    # In double precision, before a camera has it in single.
    translation = translation + R_cam_world @ (
        np.zeros(3) if origin_world is None else origin_world
    )
    size = (lens.size[0], lens.size[1])
    return Camera.create(size, lens.matrix, lens.distortions, R_cam_world, translation, lens.model)


def read_intrinsics(path: str | Path, name: str) -> Intrinsics:
    """A camera's intrinsics, placed or not; in an OpenCV file, which holds one, of any name."""
    path = Path(path)
    sections = _sections(path)
    if path.suffix.lower() in YAML_SUFFIXES:
        return read_lens(TomlTable(path, "", next(iter(sections.values()))))
    return read_lens(TomlTable(path, f"[{name}]", pick_camera(path, sections, name)))


def _sections(path: Path) -> dict[str, Any]:
    if path.suffix.lower() in YAML_SUFFIXES:
        return read_opencv_yaml(path)
    try:
        tables = read_toml(path)
    except InputError as error:
        if path.suffix.lower() == ".toml" or not path.is_file():
            raise
        others = "jaxmocap convert makes .toml of other systems' calibrations"
        raise InputError(path, f"{error.problem} ({others})") from None
    return {name: table for name, table in tables.items() if name != METADATA_SECTION}


def pick_camera(path: str | Path, cameras: Mapping[str, _Section], name: str) -> _Section:
    """The camera of that section; InputError lists the sections there are."""
    if name not in cameras:
        sections = f"found {comma_list(cameras)}" if cameras else "found no camera section"
        raise InputError(path, f"section [{short_name(name)}] is missing, {sections}")
    return cameras[name]


def read_place(
    fields: TomlTable, unit: str = "metres", farthest: float = FARTHEST_M
) -> tuple[np.ndarray, np.ndarray]:
    """R_cam_world (3, 3), exactly a rotation, and translation (3,), world to camera, of a section.

    InputError where a field is missing, no rotation or translation, or beyond ``farthest`` units.
    """
    for key in ("rotation", "translation"):
        if key not in fields:
            raise fields.error("", f"{key!r} is missing (jaxmocap calibrate extrinsics finds it)")
    translation = fields.array("translation", [(3,)], f"3 numbers in {unit}", farthest)
    expected = "a Rodrigues vector of 3 numbers or a 3 × 3 rotation matrix"
    rotation = fields.array("rotation", [(3,), (3, 3)], expected, LARGEST_ROTATION)
    if rotation.ndim == 1:
        return Rotation.from_rotvec(rotation).as_matrix(), translation
    if not is_rotation(rotation):
        raise fields.error("rotation", "found a 3 × 3 matrix that is not a rotation")
    return Rotation.from_matrix(rotation).as_matrix(), translation


def read_lens(fields: TomlTable) -> Intrinsics:
    """The intrinsics in a camera's section; InputError where they are missing or do not fit."""
    size = fields.array("size", [(2,)], "[width, height] in pixels")
    matrix = fields.array("matrix", [(3, 3)], "a 3 × 3 matrix")
    fisheye = fields.flag("fisheye")
    names = LENSES[FISHEYE if fisheye else BROWN_CONRADY].coefficients
    expected = f"at most {len(names)} numbers ({' '.join(names)})"
    counts = [(n,) for n in range(len(names) + 1)]
    distortions = np.zeros(0)
    if "distortions" in fields:
        entry = fields.entries["distortions"]
        if isinstance(entry, list) and not fisheye and not any(entry[len(names) :]):
            # Later coefficients that are all 0 change nothing: OpenCV writes up to 14.
            cut = fields.entries | {"distortions": entry[: len(names)]}
            fields = TomlTable(fields.path, fields.where, cut)
        distortions = fields.array("distortions", counts, expected)
    lens = Intrinsics(size, matrix, distortions, fisheye)
    if problem := lens_problem(size, matrix, distortions, lens.model):
        raise fields.error(*problem)
    if (np.diag(matrix)[:2] < (least := LEAST_FOCAL_SHARE * size.max())).any():
        expected = f"expected focal lengths in pixels, here {least:g} or more"
        raise fields.error("matrix", f"found {matrix.tolist()}, {expected}")
    return lens


def is_rotation(matrix: np.ndarray) -> bool:
    """Is a (3, 3) matrix a rotation, as far as files print it?"""
    return is_orthonormal(matrix) and bool(np.linalg.det(matrix) > 0)


def is_orthonormal(matrix: np.ndarray) -> bool:
    """Are the rows of a (3, 3) matrix unit vectors at right angles, as far as files print them?"""
    return bool(np.abs(matrix @ matrix.T - np.eye(3)).max() <= ORTHONORMAL_TOLERANCE)


def write_calibration(path: str | Path, cameras: dict[str, Camera]) -> None:
    """Write a calibration file with one section per camera."""
    sections = {}
    for name, camera in cameras.items():
        size, matrix, k = (np.asarray(getattr(camera, part), float)
                           for part in ("size", "matrix", "distortion"))  # fmt: skip
        sections[name] = Intrinsics(size, matrix, shortest(k), camera.lens == FISHEYE).entries() | {
            "rotation": np.asarray(log(camera.T_cam_world[:3, :3]), float),
            "translation": np.asarray(camera.T_cam_world[:3, 3], float),
        }
    write_sections(path, sections)


def shortest(distortions: np.ndarray) -> np.ndarray:
    """The first four coefficients where the others are 0, as most readers expect, or five."""
    count = 4 if not distortions[4:].any() else 5 if not distortions[5:].any() else 8
    return distortions[:count]


def write_sections(path: str | Path, sections: Mapping[str, Mapping[str, Any]]) -> None:
    """Write each camera's ``Intrinsics.entries()``, rotation and translation (metres)."""
    write_toml(path, [(f"[{toml_key(name)}]", {"name": name, **entries})
                      for name, entries in sections.items()])  # fmt: skip


def write_camera(path: str | Path, name: str, entries: Mapping[str, Any]) -> None:
    """Add one camera's section to a .toml file, or replace these entries of it, or make the file.

    All else in the file stays as it is: other sections, unknown keys, comments. InputError where it
    is there and no TOML, or the name is not a camera's.
    """
    path = Path(path)
    check_camera_writable(path, name)

    def change(text: str) -> str:
        parse_toml(path, text)
        try:
            return replace_entries(text, name, {"name": name, **entries})
        except ValueError as error:
            raise InputError(path, f"camera {short_repr(name)} {error}") from None

    if path.exists():
        rewrite_toml(path, change)
    else:
        write_text(path, change(""))


def check_camera_writable(path: Path, name: str) -> None:
    """InputError where ``write_camera`` could not write this camera; asked before any work.

    OutputError where no file can be written there.
    """
    if path.suffix.lower() != ".toml":
        raise InputError(path, "cannot be written to, expected a .toml file")
    if not name or name == METADATA_SECTION:
        raise InputError(path, f"found {name!r} as a camera's name, expected another")
    if problem := file_name_problem(name):
        raise InputError(path, f"found {short_repr(name)} as a camera's name, {problem}")
    if path.exists():
        TomlTable(path, f"[{name}]", read_toml(path).get(name, {}))
    check_replaceable(path, name)
    check_target(path)


def check_replaceable(path: Path, name: str | None = None) -> None:
    """InputError where a file that is there holds no camera: it was not meant to be changed.

    Whatever stands in the section of that name is the camera's.
    """
    tables = _sections(path) if path.exists() else {}
    if tables and not any(
        key == name or (isinstance(each, dict) and {"size", "matrix"} & each.keys())
        for key, each in tables.items()
    ):
        raise InputError(path, "is there and is no calibration, expected another name")
