"""A person as ``silhouette model`` leaves them to other commands and other programs.

INPUTS: a PersonalModel of four photographs, and a folder; or such a folder.
OUTPUTS: ``subject.toml``, the bones, for either tracker; ``surface.npz``, the body around them;
``texture.png``, its colours; ``model.glb``, all of it with a skeleton and a skin; ``person.png``,
the person from four sides. Or a Person.
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jaxmocap.body.skeleton import Skeleton
from jaxmocap.body.surfaces.cones import with_thickness
from jaxmocap.body.surfaces.loft import stature_of
from jaxmocap.body.surfaces.surface import Surface
from jaxmocap.capture.photographs import picture_of, png_of, write_picture
from jaxmocap.formats.animation.export import write_avatar
from jaxmocap.formats.armatures.skin import TEXEL_M, check_texture
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.files.reading import read_bytes
from jaxmocap.formats.files.writing import replacing
from jaxmocap.formats.recordings.recording import Recording
from jaxmocap.formats.recordings.subject import read_subject, write_subject
from jaxmocap.formats.recordings.surface import check_surface_extent, load_surface, save_surface
from jaxmocap.silhouette.modelling.personal import PersonalModel
from jaxmocap.silhouette.modelling.pictures.views import PhotographView
from jaxmocap.silhouette.modelling.texture.avatar import avatar_of

# Bones, the body around them, its colours.
SUBJECT = "subject.toml"
SURFACE = "surface.npz"
TEXTURE = "texture.png"
PERSON_FILES = (SUBJECT, SURFACE, TEXTURE, "model.glb", "person.png")


class Person(NamedTuple):
    """Somebody's body; the picture, a PNG file's content, is the surface's colours."""

    skeleton: Skeleton
    surface: Surface
    picture: bytes | None


def write_person(
    person: PersonalModel,
    images: Mapping[str, np.ndarray],
    views: Mapping[str, PhotographView],
    directory: str | Path,
) -> list[Path]:
    """Write the shape by the photographs, and its colours; the files."""
    files = [Path(directory) / name for name in PERSON_FILES]
    thick = with_thickness(person.skeleton, person.surface)
    basis = "Lengths and diameters by four photographs; what they do not show, by the stature."
    write_subject(files[0], thick, stature_of(thick), [basis])
    save_surface(files[1], person.surface, person.skeleton.tree)
    # As others will read them: rounded, so that they lay the picture out to the same texel.
    skeleton, surface = _read(Path(directory))
    person = person._replace(skeleton=skeleton, surface=surface)
    avatar = avatar_of(person, images, views, TEXEL_M)
    content = png_of(avatar.picture)
    with replacing(files[2]) as beside:
        beside.write_bytes(content)
    write_avatar(files[3], person.skeleton, person.surface, content)
    write_picture(files[4], avatar.around())
    return files


def with_model(recording: Recording, model: str | Path | None) -> tuple[Recording, Person | None]:
    """The recording with a model's bones, and the person of the model; as it is without a model.

    Raises:
        InputError: a file of the folder is missing or cannot be used.
    """
    if model is None:
        return recording, None
    person = read_person(model)
    return replace(recording, skeleton=person.skeleton), person


def person_files(folder: Path) -> list[Path]:
    """The files of a folder that ``read_person`` reads."""
    return [folder / name for name in (SUBJECT, SURFACE, TEXTURE)]


def read_person(directory: str | Path) -> Person:
    """The person of a folder that ``silhouette model`` wrote.

    Raises:
        InputError: a file is missing or cannot be used.
    """
    folder = Path(directory)
    for name in (SUBJECT, SURFACE):
        if not (folder / name).is_file():
            raise InputError(folder, f"found no {name}, expected what 'silhouette model' writes")
    skeleton, surface = _read(folder)
    if not (folder / TEXTURE).is_file():
        return Person(skeleton, surface, None)
    picture = read_bytes(folder / TEXTURE)
    check_texture(folder / TEXTURE, skeleton, surface, picture)
    # A later decoder would not have its name.
    picture_of(folder / TEXTURE, picture)
    return Person(skeleton, surface, picture)


def _read(folder: Path) -> tuple[Skeleton, Surface]:
    """Bones and body of a folder."""
    skeleton = read_subject(folder / SUBJECT, "", {"file": SUBJECT})
    surface = load_surface(folder / SURFACE, skeleton.tree)
    check_surface_extent(folder / SURFACE, surface, skeleton)
    return skeleton, surface
