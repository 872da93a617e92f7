"""Everything that ``silhouette track`` writes: what ``track`` does, and what was segmented.

INPUTS: a SilhouetteResult, the Recording, a folder.
OUTPUTS: joints.trc, angles.mot and the motion's other files, report.json, recording.rrd, and
overlay_NAME.mp4 and segmentation_NAME.mp4 of each camera.
"""

from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from jaxmocap.body.subject import rest_joints
from jaxmocap.body.surfaces.mesh import coarser
from jaxmocap.body.surfaces.surface import Surface, rest_nodes
from jaxmocap.capture.photographs import picture_of
from jaxmocap.capture.video import TimedImage, open_video
from jaxmocap.formats.files.output_folder import OutputFolder
from jaxmocap.formats.recordings.recording import Recording
from jaxmocap.images.canvases import full_mask
from jaxmocap.images.regions import Region
from jaxmocap.outputs.viewer import Footage, write_rerun
from jaxmocap.pipelines.progress import Progress, progress_bar
from jaxmocap.pipelines.silhouettes.person import Person
from jaxmocap.pipelines.silhouettes.track import Masks, SilhouetteResult
from jaxmocap.pipelines.viewer_frames import FrameCounter, viewer_frame_count, viewer_frames
from jaxmocap.pipelines.writing import (
    Warn,
    ignore_warning,
    overlay_names,
    tracked_folder,
    write_motion,
    write_overlays,
)

# Metres between the nodes of a skin in files: the tracker's are denser.
SKIN_M = 0.018
# Videos of each camera.
VIDEO_KINDS = ("overlay", "segmentation")
# Colour over the person, BGR.
TINT_BGR = np.array([60, 220, 60])
# Its weight there.
TINT_WEIGHT = 0.45


def write_results(
    result: SilhouetteResult,
    recording: Recording,
    directory: str | Path,
    progress: Progress | bool | None = None,
    person: Person | None = None,
    inputs: Iterable[Path] = (),
    warn: Warn = ignore_warning,
) -> list[Path]:
    """Write all files; see ``pipelines.writing.write_outputs``.

    The skin is the person's own surface, if its colours were measured.

    Raises:
        InputError: see ``tracked_folder``.
        OutputError: the disk is full; every file that is there is complete.
    """
    folder, skin = results_folder(directory, recording, inputs), _skin(result, person)
    motion = result.motion
    files = folder.write(
        lambda stage: write_motion(motion, stage, *skin, warn, recording), more_follows=True
    )
    return files + folder.write(
        lambda stage: _write_pictures(result, recording, stage, skin, progress)
    )


def results_folder(
    directory: str | Path, recording: Recording, inputs: Iterable[Path] = ()
) -> OutputFolder:
    """The folder for these files, checked before any work; see ``tracked_folder``."""
    return tracked_folder(directory, recording, overlay_names(recording, VIDEO_KINDS[1]), inputs)


def write_into(
    result: SilhouetteResult,
    recording: Recording,
    folder: Path,
    progress: Progress | bool | None = None,
    person: Person | None = None,
) -> list[Path]:
    """The same into a folder that is there, of which nothing is asked."""
    skin = _skin(result, person)
    files = write_motion(result.motion, folder, *skin, recording=recording)
    return files + _write_pictures(result, recording, folder, skin, progress)


def _write_pictures(
    result: SilhouetteResult,
    recording: Recording,
    folder: Path,
    skin: tuple[Surface, bytes | None],
    progress: Progress | bool | None,
) -> list[Path]:
    """The videos and the viewer's recording."""
    motion, (surface, picture) = result.motion, skin
    videos = [open_video(source) for source in recording.videos]
    with progress_bar("drawing", progress) as show:
        counter = FrameCounter(
            show, sum(2 * len(video) + viewer_frame_count(video) for video in videos)
        )
        files = write_overlays(motion, recording, videos, folder, {}, counter)
        # The person tinted as segmented, and the body over that.
        segmented = lambda name, frames: tint_frames(frames, result.masks[name])  # noqa: E731
        where = motion, recording, videos, folder, {}, counter
        files += write_overlays(*where, VIDEO_KINDS[1], segmented)
        files.append(folder / "recording.rrd")
        footage = {
            source.camera_name: Footage(source.camera, counter.over(viewer_frames(video)))
            for source, video in zip(recording.videos, videos, strict=True)
        }
        colours = None if picture is None else picture_of(folder, picture)
        write_rerun(files[-1], motion, footage, {}, surface=surface, picture=colours)
    return files


def _skin(result: SilhouetteResult, person: Person | None) -> tuple[Surface, bytes | None]:
    """What the body looks like in files: as photographed, or else as tracked."""
    if person is not None and person.picture is not None:
        return person.surface, person.picture
    nodes = rest_nodes(result.surface, rest_joints(result.motion.skeleton))
    return coarser(result.surface, nodes, SKIN_M), None


def tint_frames(frames: Iterable[TimedImage], masks: Masks) -> Iterator[TimedImage]:
    """The frames, the person's pixels in another colour; as they are where nobody was segmented."""
    for time, image in frames:
        k = int(np.argmin(np.abs(masks.times - time)))
        if image is None:
            yield time, None
            continue
        region = Region(masks.origins[k], masks.scales[k])
        mask = full_mask(masks.phi[k].astype(np.float32), region, image.shape[:2])
        tinted_image = image.copy()
        tinted_image[mask] = ((1 - TINT_WEIGHT) * image[mask] + TINT_WEIGHT * TINT_BGR).astype(
            np.uint8
        )
        yield time, tinted_image
