"""A tracked motion as animation files.

INPUTS: a Motion. OUTPUTS: a .bvh or .glb file, Y up, facing Z, metres, the rest pose a T.

Both are written whatever the motion is like: where no pose is known the nearest one is held in
BVH, and samples that are not evenly spaced are taken anew at their median rate.
"""

from pathlib import Path

import numpy as np

from jaxmocap.body.motion import Motion
from jaxmocap.formats.armature import settled, turned
from jaxmocap.formats.axes import UP
from jaxmocap.formats.body_armature import armature_of
from jaxmocap.formats.bvh import write_bvh
from jaxmocap.formats.gltf import write_gltf
from jaxmocap.formats.resampling import even_times, resampled
from jaxmocap.formats.tables import is_even

# What names joints have in a file if nothing else is asked for.
CUSTOMARY = {".bvh": "humanik", ".glb": "vrm"}
R_file_world = UP["y"].T


def write_animation(path: str | Path, motion: Motion) -> None:
    """Write a motion to a .bvh or .glb file, told by its suffix; its joints have customary names.

    Raises:
        InputError: no pose is known in any sample.
    """
    kind = Path(path).suffix
    armature = turned(armature_of(motion, CUSTOMARY[kind]), R_file_world)
    if kind == ".glb":
        write_gltf(path, armature)
        return
    if not is_even(armature.times):
        rate = 1 / float(np.median(np.diff(armature.times)))
        armature = resampled(armature, even_times(armature.times, rate))
    write_bvh(path, settled(armature, path))
