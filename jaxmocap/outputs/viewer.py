"""A recording for the rerun viewer: the tracked body among cameras, images and time series.

INPUTS: a Motion; per camera its calibration and frames. OUTPUTS: an .rrd file with its blueprint.

The viewer's library loads when ``write_rerun`` is called, not on import.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from jaxmocap.body.motion import Motion, every_nth
from jaxmocap.body.surfaces.pieces import body_pieces
from jaxmocap.body.surfaces.surface import Surface
from jaxmocap.formats.files.writing import replacing
from jaxmocap.geometry.cameras import Camera
from jaxmocap.outputs.ellipses import uncertainty_of
from jaxmocap.outputs.scene import floor_of, make_scene

if TYPE_CHECKING:
    from rerun import RecordingStream

# Samples of a motion in a recording, at most: half an hour at 30 Hz.
MOST_SAMPLES = 60_000
# Of images, 1 to 100.
JPEG_QUALITY = 75
# Samples that the viewer's library takes at once: it needs twenty times what they are in the file.
SAMPLES_AT_ONCE = 1024


@dataclass(frozen=True)
class Footage:
    """The frames of one camera, which are iterated over once, and its fields."""

    camera: Camera  # its calibration
    # Seconds of marker time, rising, and image (H, W, 3) BGR uint8 or None.
    frames: Iterable[tuple[float, np.ndarray | None]]
    # Name -> time and (h, w) uint8 image, such as an arm's edges or distance field.
    fields: Mapping[str, Iterable[tuple[float, np.ndarray]]] = field(default_factory=dict)


def shown_every(motion: Motion) -> int:
    """One sample in so many is in a recording: 1 for ``MOST_SAMPLES`` and fewer."""
    return -(-len(motion.times) // MOST_SAMPLES)


def write_rerun(
    path: str | Path,
    motion: Motion,
    footage: Mapping[str, Footage] | None = None,
    targets: Mapping[str, np.ndarray] | None = None,
    surface: Surface | None = None,
    picture: np.ndarray | None = None,
) -> None:
    """Write a recording that ``rerun FILE`` shows, laid out in a prepared blueprint.

    The timeline "time" holds seconds of marker time. Of a long motion one sample in
    ``shown_every`` is shown.

    Args:
        path: of the .rrd file; it appears when it is complete.
        motion: shown as a body on a floor; with a report also time series and standard deviations.
        footage: camera name -> its frames.
        targets: marker -> (T, 3) measured positions at the motion's times, world, metres.
        surface: of the body, shown in place of a generic one.
        picture: the surface's colours, as for ``log_skin``.

    Raises:
        OutputError: the disk is full; what was there before is as it was.
    """
    from jaxmocap.outputs import recorder

    step = shown_every(motion)
    targets = {name: positions[::step] for name, positions in (targets or {}).items()}
    shown, footage = every_nth(motion, step), dict(footage or {})
    with replacing(path) as beside, recorder.recording(beside) as stream:
        # What it makes of the motion is gone before the file is, or both would be in memory.
        _log_motion(stream, shown, footage, targets, surface, picture)


def _log_motion(
    stream: "RecordingStream",
    motion: Motion,
    footage: Mapping[str, Footage],
    targets: Mapping[str, np.ndarray],
    surface: Surface | None,
    picture: np.ndarray | None,
) -> None:
    """The layout and all that it shows; see ``write_rerun``."""
    from jaxmocap.outputs import camera_recorder, layout, recorder, viewer_skin

    scene, pieces = make_scene(motion), body_pieces(motion.skeleton)
    floor, uncertainty = floor_of(scene, pieces), uncertainty_of(motion)
    fields = {name: list(shot.fields) for name, shot in footage.items()}
    without = motion.report.run.deviations_without_m if motion.report else None
    stream.send_blueprint(layout.lay_out(fields, scene, floor, why=bool(without)))
    recorder.log_pieces(stream, scene.tree, {} if surface else pieces, floor)
    recorder.log_styles(stream, targets)
    for first in range(0, len(scene.times), SAMPLES_AT_ONCE):
        rows = slice(first, first + SAMPLES_AT_ONCE)
        recorder.log_body(stream, scene.part(rows))
        recorder.log_targets(
            stream, scene.times[rows], {name: at[rows] for name, at in targets.items()}
        )
        if uncertainty is not None:
            recorder.log_deviations(stream, uncertainty.part(rows))
    if surface is not None:
        viewer_skin.log_skin(stream, motion, surface, picture)
    recorder.log_angles(stream, motion)
    if motion.report is not None:
        recorder.log_report(stream, scene.times, motion.report)
    if without:
        recorder.log_why(stream, without)
    for name, shot in footage.items():
        camera_recorder.log_camera(stream, name, shot.camera)
        times = camera_recorder.log_images(stream, name, shot.frames, JPEG_QUALITY)
        camera_recorder.log_outlines(stream, name, shot.camera, scene, times)
        if uncertainty is not None:
            camera_recorder.log_ellipses(stream, name, shot.camera, uncertainty, times)
        camera_recorder.log_projected_targets(stream, name, shot.camera, scene.times, targets)
        for label, images in shot.fields.items():
            camera_recorder.log_field(stream, name, label, images)
