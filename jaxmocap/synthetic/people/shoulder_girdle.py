"""The shoulder girdle of a rigged mesh, which goes along with the arm.

Of an arm's elevation beyond the first 30 degrees or so a third is the shoulder blade's, two thirds
are the arm's against it (Inman, Saunders and Abbott, J. Bone Joint Surg. 26, 1944: 2 to 1). What of
it moves the shoulder joint on the chest is mostly the collar bone: in a raise of the arm it rises
by 11 to 15 degrees and goes back by 15 to 29 (Ludewig et al., J. Orthop. Sports Phys. Ther. 34,
2004), here 15 and 22 at 150 degrees. The rig has one bone for both, from the breast bone to the
shoulder; it turns as the collar bone does. The shoulder blade's own turn about the collar bone's
end, the rest of the third, moves no joint of such a rig.

INPUTS: where upper arms point. OUTPUTS: turns of the girdle's bones.
"""

import numpy as np
from scipy.spatial.transform import Rotation

# Elevation of the arm, degrees, from which on the girdle goes along,
SETTING_DEG = 30.0
# and width of that onset.
SETTING_WIDTH_DEG = 6.0
# Degrees up, by the arm's beyond that,
RAISED = 15 / 120
# and back.
DRAWN_BACK = 22 / 120


def girdle_angles(elevation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How far (...) it is up and back, by an arm's elevation (...) from hanging; degrees."""
    beyond = SETTING_WIDTH_DEG * np.logaddexp(0.0, (elevation - SETTING_DEG) / SETTING_WIDTH_DEG)
    return RAISED * beyond, DRAWN_BACK * beyond


def girdle_turn(upper: np.ndarray, out: float) -> np.ndarray:
    """Turns (T, 3, 3) from rest, in the chest's frame: x ahead, y left, z up.

    ``upper`` (T, 3) are unit vectors along the upper arm there; ``out`` is 1 left, -1 right.
    """
    up, back = girdle_angles(np.degrees(np.arccos(np.clip(-upper[:, 2], -1, 1))))
    turned = np.stack([out * back, out * up], -1)
    return Rotation.from_euler("ZX", turned, degrees=True).as_matrix()
