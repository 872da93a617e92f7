"""A motion in memory against a reference.

INPUTS: a Motion; a marker file or points over time. OUTPUTS: Errors.
"""

from collections.abc import Mapping
from pathlib import Path

from jaxmocap.body.motion import Motion
from jaxmocap.evaluation.errors import Errors, points_z_up, position_errors
from jaxmocap.formats.time_series.markers import default_up, read_markers
from jaxmocap.formats.time_series.tables import Markers


def evaluate(
    motion: Motion, truth: str | Path | Markers, pairs: Mapping[str, str], up: str | None = None
) -> Errors:
    """Errors of a motion's joints against a reference, matched by time stamp.

    Args:
        motion: what was tracked.
        truth: a file of markers, a .bvh or .glb whose joints are compared, or Markers.
        pairs: joint name -> the name of its marker in the reference.
        up: the reference's vertical axis, "z" or "y" (world = (z, x, y) of the file); None is "y"
            for .bvh and .glb, else "z".

    Raises:
        InputError: a file that is missing or no marker file, an unknown name, no common time.
        ValueError: another ``up``.

    Example:
        >>> from jaxmocap import Recording, Settings, evaluate, track
        >>> motion = track(Recording.load("recording.toml"), Settings(refine="none"))
        >>> errors = evaluate(motion, "truth.trc", {"elbow_r": "elbow_r"})
        >>> bool(errors.mean < 1.0)  # metres
        True
    """
    in_memory = isinstance(truth, Markers)
    markers = truth if in_memory else read_markers(truth)
    return position_errors(
        motion.times,
        motion.joints(),
        markers.times,
        points_z_up(markers, up or ("z" if in_memory else default_up(truth))),
        pairs,
        sources=("motion", "reference" if in_memory else truth),
        deviations=motion.deviations(),
    )
