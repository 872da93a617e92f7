"""A person's surface as a file: plain arrays, so that any program can write one.

INPUTS: .npz with ``patch_names`` (P), ``patch_sizes`` (P, 2: along, around), ``bone_names`` (B),
``bones`` (N, K: indices of the names), ``points_bone`` (N, K, 3: metres, in bones' frames) and
``shares`` (N, K). Nodes come patch by patch, ring by ring. OUTPUTS: a Surface; and the other way.
"""

from pathlib import Path
from zipfile import BadZipFile

import jax.numpy as jnp
import numpy as np

from jaxmocap.body.skeleton import Tree
from jaxmocap.body.surface import BodyPoints, Patch, Surface
from jaxmocap.formats.errors import InputError
from jaxmocap.formats.writing import replacing

FIELDS = ("patch_names", "patch_sizes", "bone_names", "bones", "points_bone", "shares")


def save_surface(path: str | Path, surface: Surface, tree: Tree) -> None:
    """Write a surface to a .npz file."""
    arrays = dict(zip(("bones", "points_bone", "shares"), surface.points, strict=True))
    sizes = [(patch.along, patch.around) for patch in surface.patches]
    with replacing(path) as part, part.open("wb") as file:
        np.savez(
            file,
            patch_names=np.array([patch.name for patch in surface.patches]),
            patch_sizes=np.array(sizes),
            bone_names=np.array(tree.bones),
            **{name: np.asarray(array) for name, array in arrays.items()},  # type: ignore[arg-type]
        )


def load_surface(path: str | Path, tree: Tree) -> Surface:
    """Read a surface for a body with this tree.

    Raises:
        InputError: no such file, not one of arrays, a field missing or of another shape, or a bone
            that the body does not have.
    """
    try:
        with np.load(path) as data:
            arrays = {name: data[name] for name in FIELDS if name in data}
    except (OSError, ValueError, BadZipFile) as error:
        raise InputError(path, f"cannot be read as a .npz file ({error})") from None
    missing = [name for name in FIELDS if name not in arrays]
    if missing:
        raise InputError(path, f"found no {missing[0]!r}, expected {', '.join(FIELDS)}")
    sizes, bones, places, shares = (
        arrays[name] for name in ("patch_sizes", "bones", "points_bone", "shares")
    )
    nodes = int(np.prod(sizes, -1).sum())
    if bones.shape != (nodes, *bones.shape[1:]) or places.shape != (*bones.shape, 3):
        shapes = f"bones {bones.shape} and points_bone {places.shape}"
        raise InputError(path, f"found {shapes}, expected {nodes} nodes by patch_sizes")
    if shares.shape != bones.shape or not np.allclose(shares.sum(-1), 1, atol=1e-3):
        raise InputError(path, "shares: expected one per bone, together 1 at every node")
    unknown = [str(name) for name in arrays["bone_names"] if name not in tree.bones]
    if unknown:
        expected = ", ".join(tree.bones)
        raise InputError(path, f"bone_names: unknown bone {unknown[0]!r}, expected {expected}")
    index = np.array([tree.bone(str(name)) for name in arrays["bone_names"]], np.int32)
    patches, start = [], 0
    for name, (along, around) in zip(arrays["patch_names"], sizes, strict=True):
        patches.append(Patch(str(name), int(around), int(along), start))
        start += int(along) * int(around)
    points = BodyPoints(index[bones], jnp.asarray(places, float), jnp.asarray(shares, float))
    return Surface(tuple(patches), points)
