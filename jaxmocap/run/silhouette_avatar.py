"""What other programs and people want of a person's model: a body with its colours on.

INPUTS: a Personal, the photographs and what was seen in them, a folder.
OUTPUTS: ``texture.png``; ``model.glb`` with skeleton, skin and texture; ``person.png``, the person
from four sides.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from jaxmocap.capture.photographs import png_of, write_picture
from jaxmocap.formats.animation import write_avatar
from jaxmocap.formats.atomic import replacing
from jaxmocap.formats.skin import TEXEL_M
from jaxmocap.silhouette.modelling.avatar import avatar_of
from jaxmocap.silhouette.modelling.personal import Personal
from jaxmocap.silhouette.modelling.views import View


def write_coloured(
    person: Personal,
    images: Mapping[str, np.ndarray],
    views: Mapping[str, View],
    directory: str | Path,
) -> list[Path]:
    """Write the three files; their paths.

    Args:
        person: what the photographs told of the shape.
        images: photograph -> (H, W, 3) BGR uint8.
        views: photograph -> mask and camera.
        directory: where to.
    """
    avatar = avatar_of(person, images, views, TEXEL_M)
    files = [Path(directory) / name for name in ("texture.png", "model.glb", "person.png")]
    content = png_of(avatar.picture)
    with replacing(files[0]) as beside:
        beside.write_bytes(content)
    write_avatar(files[1], person.skeleton, person.surface, content)
    write_picture(files[2], avatar.around())
    return files
