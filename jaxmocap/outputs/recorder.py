"""The parts of a recording for the rerun viewer. It, ``layout`` and ``skin`` alone import rerun.

INPUTS: a recording stream and what to log. OUTPUTS: none; the stream's sink holds the data.

Poses, outlines and series are sent as columns, images one by one. Entities: ``world/body/BONE``,
``world/skeleton``, ``world/deviations``, ``world/markers/NAME``, ``world/cameras/NAME`` with
``image``, ``outlines``, ``bones`` and ``markers``; ``fields/CAMERA/NAME``; one root per kind
of time series.
"""

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import rerun as rr
from rerun.blueprint import Blueprint

from jaxmocap.body.motion import Motion, Report, landmarks_over_time
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.geometry.cameras import Camera
from jaxmocap.geometry.rotations import quaternion_from_matrix
from jaxmocap.geometry.solids import limb_solid
from jaxmocap.outputs.layout import TIMELINE, entity_path
from jaxmocap.outputs.overlay import encode_jpeg
from jaxmocap.outputs.scene import BodyScene, limb_outlines, pixels

# RGB of the middle, the left and the right of the body.
COLOURS = {"": (190, 190, 200), "l": (70, 170, 255), "r": (255, 160, 60)}
# Of the limbs, 0 to 255: the skeleton is visible through them.
LIMB_OPACITY = 170
# RGB of measured markers.
TARGET_COLOUR = (255, 60, 255)
# Standard deviations, metres, at which an ellipsoid is green, yellow and red.
DEVIATION_STEPS_M = (0.02, 0.06, 0.15)
DEVIATION_COLOURS = ((60, 200, 90), (250, 210, 60), (230, 50, 40))
# RGB of landmarks that only the prior determines.
PRIOR_COLOUR = (140, 140, 140)
# Of the ellipsoids, 0 to 255.
DEVIATION_OPACITY = 90
SIDES = ("left", "right")
# RGB of a plot's lines that are of no side.
LINE_COLOURS = (
    (200, 60, 120), (60, 150, 90), (230, 170, 30), (110, 90, 200), (40, 160, 190), (140, 110, 80),
)  # fmt: skip


@contextmanager
def recording(path: Path, blueprint: Blueprint) -> Iterator[rr.RecordingStream]:
    """A stream into a file, which is written at the end.

    Until then it is in memory, which holds the few images and surfaces. On a full disk the
    library's own files end without an error, or it waits for ever.

    Raises:
        OSError: the file cannot be written.
    """
    stream = rr.RecordingStream("jaxmocap")
    content = stream.binary_stream()
    stream.send_blueprint(blueprint)
    try:
        yield stream
        # Each read gives a complete file, so it is read at once.
        path.write_bytes(content.read() or b"")
    finally:
        stream.disconnect()


def log_body(
    stream: rr.RecordingStream, motion: Motion, scene: BodyScene, limbs: bool = True
) -> None:
    """Limbs as solids, if wanted, moved by their bones' transforms; the skeleton as lines."""
    log_limbs(stream, motion.skeleton, limbs)
    wxyz = np.asarray(quaternion_from_matrix(jnp.asarray(scene.R_world_bone)))
    for i, bone in enumerate(scene.tree.bones):
        turns = np.roll(wxyz[:, i], -1, axis=-1)
        columns = rr.Transform3D.columns(translation=scene.near[:, i], quaternion=turns)
        stream.send_columns(f"world/body/{bone}", [_at(scene.times)], columns)
    strips = np.stack([scene.near, scene.far], 2)
    _send_strips(stream, "world/skeleton", scene.times, strips, rr.LineStrips3D)


def log_moment(stream: rr.RecordingStream, scene: BodyScene) -> None:
    """The pose of the body of ``log_limbs`` at the one time of a scene."""
    stream.set_time(TIMELINE, duration=float(scene.times[0]))
    for i, bone in enumerate(scene.tree.bones):
        placed = rr.Transform3D(translation=scene.near[0, i], mat3x3=scene.R_world_bone[0, i])
        stream.log(f"world/body/{bone}", placed)
    strips = np.stack([scene.near[0], scene.far[0]], 1)
    stream.log("world/skeleton", rr.LineStrips3D.from_fields(strips=strips))


def log_values(stream: rr.RecordingStream, root: str, values: Mapping[str, float]) -> None:
    """One point of each line of a time series, at the stream's present time."""
    for name, value in values.items():
        stream.log(entity_path(root, name), rr.Scalars(float(value)))


def log_limbs(stream: rr.RecordingStream, skeleton: Skeleton, solids: bool = True) -> None:
    """The static parts of a body: the limbs' solids, if wanted, the style of the skeleton."""
    stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    colours = [COLOURS[segment.side] for segment in skeleton.tree.segments]
    reach = np.asarray(skeleton.lengths[:, None] * skeleton.directions)
    radii = np.asarray(skeleton.diameters) / 2
    for i, bone in enumerate(skeleton.tree.bones if solids else ()):
        solid = limb_solid(reach[i], radii[i])
        stream.log(
            f"world/body/{bone}",
            rr.Mesh3D(
                vertex_positions=solid.vertices,
                vertex_normals=solid.normals,
                triangle_indices=solid.triangles,
                albedo_factor=(*colours[i], LIMB_OPACITY),
            ),
            static=True,
        )
    style = rr.LineStrips3D.from_fields(radii=0.006, colors=colours)
    stream.log("world/skeleton", style, static=True)


def log_targets(
    stream: rr.RecordingStream, times: np.ndarray, targets: Mapping[str, np.ndarray]
) -> None:
    """Measured markers as points; none where one is missing."""
    for name, positions in targets.items():
        entity = entity_path("world", "markers", name)
        style = rr.Points3D.from_fields(
            radii=0.012, colors=TARGET_COLOUR, labels=name, show_labels=False
        )
        stream.log(entity, style, static=True)
        is_visible = np.isfinite(positions).all(-1)
        columns = rr.Points3D.columns(positions=np.asarray(positions)[is_visible])
        stream.send_columns(entity, [_at(times)], columns.partition(is_visible.astype(int)))


def log_deviations(stream: rr.RecordingStream, motion: Motion) -> None:
    """An ellipsoid of one standard deviation about each landmark, coloured by how large it is.

    A landmark that only the prior determines is grey; one without a deviation is left out.
    """
    report = motion.report
    if report is None:
        return
    centres = landmarks_over_time(motion.skeleton, motion.poses)
    deviations = np.asarray(report.landmarks_std, float)
    has_deviation = np.isfinite(centres).all(-1) & np.isfinite(deviations).all(-1)
    columns = rr.Ellipsoids3D.columns(
        centers=centres[has_deviation],
        half_sizes=deviations[has_deviation],
        colors=deviation_colours(deviations, np.asarray(report.from_prior))[has_deviation],
    )
    style = rr.Ellipsoids3D.from_fields(fill_mode=rr.components.FillMode.Solid)
    stream.log("world/deviations", style, static=True)
    counts = has_deviation.sum(1).astype(int)
    stream.send_columns("world/deviations", [_at(motion.times)], columns.partition(counts))


def deviation_colours(deviations: np.ndarray, from_prior: np.ndarray) -> np.ndarray:
    """RGBA (..., 4) of landmarks that deviate by (..., 3) metres: green, yellow, red, or grey."""
    spread = np.sqrt(np.sum(np.asarray(deviations) ** 2, -1))
    shares = [
        np.interp(spread, DEVIATION_STEPS_M, channel)
        for channel in zip(*DEVIATION_COLOURS, strict=True)
    ]
    colours = np.stack([*shares, np.full(spread.shape, DEVIATION_OPACITY)], -1)
    colours[np.asarray(from_prior) > 0] = (*PRIOR_COLOUR, DEVIATION_OPACITY)
    return np.nan_to_num(colours).astype(np.uint8)


def log_camera(stream: rr.RecordingStream, name: str, camera: Camera) -> None:
    """The camera's frustum in the world."""
    width, height = np.asarray(camera.size, int).tolist()
    T = np.asarray(camera.T_cam_world)
    entity = entity_path("world", "cameras", name)
    centre = np.asarray(camera.position_world)
    stream.log(entity, rr.Transform3D(translation=centre, mat3x3=T[:3, :3].T), static=True)
    stream.log(
        entity,
        rr.Pinhole(
            image_from_camera=np.asarray(camera.matrix),
            resolution=[width, height],
            camera_xyz=rr.ViewCoordinates.RDF,
            image_plane_distance=0.6,
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
    bones = pixels(camera, np.stack([near, far], 2))
    for label, strips, colours, width in (
        ("outlines", outlines, [COLOURS[scene.tree.segments[i].side] for i in arms], 1.0),
        ("bones", bones, COLOURS[""], 0.6),
    ):
        entity = entity_path("world", "cameras", name, label)
        style = rr.LineStrips2D.from_fields(colors=colours, radii=rr.Radius.ui_points(width))
        stream.log(entity, style, static=True)
        _send_strips(stream, entity, at, strips, rr.LineStrips2D)


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
        at = pixels(camera, positions)
        is_visible = np.isfinite(at).all(-1)
        columns = rr.Points2D.columns(positions=at[is_visible])
        columns = columns.partition(is_visible.astype(int))
        stream.send_columns(entity, [_at(times)], columns)


def log_field(
    stream: rr.RecordingStream,
    name: str,
    label: str,
    images: Iterable[tuple[float, np.ndarray]],
) -> None:
    """Grey images of a region of the camera's image, in a view of their own."""
    for time, image in images:
        stream.set_time(TIMELINE, duration=time)
        stream.log(entity_path("fields", name, label), rr.Image(image, color_model="L"))


def log_report(stream: rr.RecordingStream, times: np.ndarray, report: Report) -> None:
    """Time series of a tracker's report, and its statuses."""
    errors = 1000 * np.asarray(report.marker_errors, float)
    _send_series(stream, "marker_errors", times, report.markers, errors)
    _send_series(stream, "arm_costs", times, SIDES, report.arm_costs)
    _send_series(stream, "elbow_deviations", times, SIDES, 100 * report.elbow_deviations)
    _send_series(stream, "swivel", times, SIDES, np.degrees(report.swivels))
    for i, (stage, spent) in enumerate(report.milliseconds.items()):
        # A stage that ran once would dwarf the rest.
        if len(spent) == 1 < len(times):
            continue
        # A stage that does not run at every sample has its calls spread evenly over the time.
        spread = np.linspace(times[0], times[-1], len(spent)) if len(spent) != len(times) else times
        _send_series(stream, "milliseconds", spread, (stage,), np.asarray(spent)[:, None], i)
    statuses = [
        (time, "; ".join(lines))
        for time, lines in zip(times, report.statuses, strict=True)
        if lines
    ]
    if statuses:
        at, texts = zip(*statuses, strict=True)
        stream.send_columns("statuses", [_at(np.array(at))], rr.TextLog.columns(text=texts))


def _send_series(
    stream: rr.RecordingStream,
    root: str,
    times: np.ndarray,
    names: Iterable[str],
    values: np.ndarray,
    first: int = 0,
) -> None:
    """One line per column of (T, N) values; what is NaN is left out."""
    for i, (name, column) in enumerate(zip(names, np.asarray(values, float).T, strict=True)):
        is_finite = np.isfinite(column)
        if not is_finite.any():
            continue
        log_line(stream, root, name, first + i)
        columns = rr.Scalars.columns(scalars=column[is_finite])
        stream.send_columns(entity_path(root, name), [_at(times[is_finite])], columns)


def log_line(stream: rr.RecordingStream, root: str, name: str, number: int) -> None:
    """The style of a time series' line: the body's colour of a side, others by their number."""
    colour = COLOURS[name[0]] if name in SIDES else LINE_COLOURS[number % len(LINE_COLOURS)]
    style = rr.SeriesLines(names=name, colors=colour)
    stream.log(entity_path(root, name), style, static=True)


def _send_strips(
    stream: rr.RecordingStream,
    entity: str,
    times: np.ndarray,
    strips: np.ndarray,
    archetype: type[rr.LineStrips2D] | type[rr.LineStrips3D],
) -> None:
    """(T, N, P, 2 or 3) lines. One with a NaN becomes a point, which keeps the others' colours."""
    is_finite = np.isfinite(strips).all((-1, -2), keepdims=True)
    drawn = np.where(is_finite, strips, 0.0).astype(np.float32)
    columns = archetype.columns(strips=list(drawn.reshape(-1, *drawn.shape[2:])))
    counts = np.full(len(drawn), drawn.shape[1])
    stream.send_columns(entity, [_at(times)], columns.partition(counts))


def _at(times: np.ndarray) -> rr.TimeColumn:
    return rr.TimeColumn(TIMELINE, duration=np.asarray(times, np.float64))
