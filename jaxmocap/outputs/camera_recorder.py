"""A camera's images in a recording for the rerun viewer, and what is drawn over them.

INPUTS: a recording stream, a camera, its frames, the body. OUTPUTS: none.

Images are sent one by one, what is drawn over them as columns. Entities: ``world/cameras/NAME``
with ``image``, ``outlines``, ``bones``, ``ellipses`` and ``markers``; ``fields/CAMERA/NAME``.
"""

from collections.abc import Iterable, Mapping

import numpy as np
import rerun as rr

from jaxmocap.geometry.cameras import Camera, on_host, visible_pixels
from jaxmocap.outputs.ellipses import Uncertainty, ellipses_in
from jaxmocap.outputs.layout import TIMELINE, entity_path
from jaxmocap.outputs.overlay import encode_jpeg
from jaxmocap.outputs.recorder import COLOURS, TARGET_COLOUR, at_times, send_strips
from jaxmocap.outputs.scene import BodyScene, limb_outlines

# Of the images' plane from the camera, metres: a frustum is then smaller than a head or two.
FRUSTUM_M = 0.2
# RGB of ellipses of other landmarks than elbows.
ELLIPSE_COLOUR = (150, 150, 165)
# Widths of lines, points of the screen.
OUTLINE_WIDTH, BONE_WIDTH, ELLIPSE_WIDTH = 1.0, 1.2, 1.2


def log_camera(stream: rr.RecordingStream, name: str, camera: Camera) -> None:
    """The camera's frustum in the world."""
    width, height = np.asarray(camera.size, int).tolist()
    T = np.asarray(camera.T_cam_world)
    entity = entity_path("world", "cameras", name)
    centre = on_host(camera).position_world
    stream.log(entity, rr.Transform3D(translation=centre, mat3x3=T[:3, :3].T), static=True)
    stream.log(
        entity,
        rr.Pinhole(
            image_from_camera=np.asarray(camera.matrix),
            resolution=[width, height],
            camera_xyz=rr.ViewCoordinates.RDF,
            image_plane_distance=FRUSTUM_M,
        ),
        static=True,
    )


def log_images(
    stream: rr.RecordingStream,
    name: str,
    frames: Iterable[tuple[float, np.ndarray | None]],
    jpeg_quality: int,
) -> np.ndarray:
    """Frames as JPEG images, cleared where one is None; their times (F,), seconds."""
    entity, times = entity_path("world", "cameras", name, "image"), []
    for time, image in frames:
        stream.set_time(TIMELINE, duration=time)
        if image is None:
            stream.log(entity, rr.Clear(recursive=False))
        else:
            jpeg = encode_jpeg(image, jpeg_quality)
            stream.log(entity, rr.EncodedImage(contents=jpeg, media_type="image/jpeg"))
        times.append(time)
    return np.array(times, float)


def log_outlines(
    stream: rr.RecordingStream, name: str, camera: Camera, scene: BodyScene, times: np.ndarray
) -> None:
    """The arms' outlines and all bones over the image, at the frames' times."""
    arms, ends = scene.tree.bones_in("arm"), [(time, scene.at(time)) for time in times]
    at = np.array([time for time, pair in ends if pair is not None])
    if not len(at):
        return
    near, far = np.stack([pair for _, pair in ends if pair is not None], 1)
    outlines = limb_outlines(camera, near[:, arms], far[:, arms], scene.radii[arms])
    bones = visible_pixels(camera, np.stack([near, far], 2))
    for label, strips, colours, width in (
        ("outlines", outlines, [COLOURS[scene.tree.segments[i].side] for i in arms], OUTLINE_WIDTH),
        ("bones", bones, COLOURS[""], BONE_WIDTH),
    ):
        entity = entity_path("world", "cameras", name, label)
        style = rr.LineStrips2D.from_fields(colors=colours, radii=rr.Radius.ui_points(width))
        stream.log(entity, style, static=True)
        send_strips(stream, entity, at, strips, rr.LineStrips2D)


def log_ellipses(
    stream: rr.RecordingStream,
    name: str,
    camera: Camera,
    uncertainty: Uncertainty,
    times: np.ndarray,
) -> None:
    """Ellipses of the landmarks' standard deviations over the image, at the frames' times."""
    entity = entity_path("world", "cameras", name, "ellipses")
    loops = [ellipses_in(camera, uncertainty, time) for time in times]
    if not any(map(len, loops)):
        return
    width = rr.Radius.ui_points(ELLIPSE_WIDTH)
    stream.log(entity, rr.LineStrips2D.from_fields(radii=width), static=True)
    colours = {f"elbow_{side}": COLOURS[side] for side in "lr"}
    columns = rr.LineStrips2D.columns(
        strips=[loop.astype(np.float32) for each in loops for loop in each.values()],
        colors=[colours.get(landmark, ELLIPSE_COLOUR) for each in loops for landmark in each],
    ).partition([len(each) for each in loops])
    stream.send_columns(entity, [at_times(times)], columns)


def log_projected_targets(
    stream: rr.RecordingStream,
    name: str,
    camera: Camera,
    times: np.ndarray,
    targets: Mapping[str, np.ndarray],
) -> None:
    """Measured markers as points over the image, at the markers' times."""
    for marker, positions in targets.items():
        entity = entity_path("world", "cameras", name, "markers", marker)
        style = rr.Points2D.from_fields(radii=rr.Radius.ui_points(3.0), colors=TARGET_COLOUR)
        stream.log(entity, style, static=True)
        at = visible_pixels(camera, positions)
        is_visible = np.isfinite(at).all(-1)
        columns = rr.Points2D.columns(positions=at[is_visible])
        columns = columns.partition(is_visible.astype(int))
        stream.send_columns(entity, [at_times(times)], columns)


def log_field(
    stream: rr.RecordingStream, name: str, label: str, images: Iterable[tuple[float, np.ndarray]]
) -> None:
    """Grey images of a region of the camera's image, in a view of their own."""
    for time, image in images:
        stream.set_time(TIMELINE, duration=time)
        stream.log(entity_path("fields", name, label), rr.Image(image, color_model="L"))
