"""The second paper's system: images of one to four cameras to a person's poses, without markers.

A frame goes through ``tracker.step``: predict, segment (``segmentation/``), find the rim of the
body's surface (``surfaces/``), pair both and solve (``fit/``), recover lost limbs (``recovery/``).
A recording goes through ``passes.run_passes``, each pass of which learns backgrounds and the
person's shape for the next. All that a tracker remembers is in ``state.State``; all that a user may
tune is in ``settings.Settings``. A person's own body comes from four photographs (``modelling/``).
Begin with ``tracker``.

Apart from persons, ``solve_contour_pose`` finds a rigid object, a wire or a ``RigidSurface``, by
its contour.
"""

from jaxmocap.silhouette.contour_pose import ContourPose, ContourPoseSettings, solve_contour_pose
from jaxmocap.silhouette.surfaces.rigid import RigidSurface

__all__ = ["ContourPose", "ContourPoseSettings", "RigidSurface", "solve_contour_pose"]
