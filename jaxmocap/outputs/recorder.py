"""The body in the world, in a recording for the rerun viewer, and the recording itself.

INPUTS: a recording stream and what to log. OUTPUTS: none; the stream's sink holds the data.

Meshes are sent once, poses as columns. Entities: ``world/floor``, ``world/body/BONE``,
``world/skeleton``, ``world/deviations``, ``world/markers/NAME``; one root for each kind of time
series, one entity below it for each line. ``camera_recorder`` logs the images.
"""

import warnings
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import rerun as rr

from jaxmocap.body.motion import Motion, Report
from jaxmocap.body.tree import Tree
from jaxmocap.formats.files.errors import InputError
from jaxmocap.geometry.rotations import quaternion_from_matrix
from jaxmocap.geometry.solids import Solid
from jaxmocap.outputs.ellipses import Uncertainty
from jaxmocap.outputs.layout import ANGLES, DEVIATIONS, TIMELINE, WHY, entity_path
from jaxmocap.outputs.report import SIDES
from jaxmocap.outputs.scene import BodyScene, Floor

# RGB of the middle, the left and the right of the body: bones, outlines and lines of plots.
COLOURS = {"": (225, 225, 230), "l": (70, 170, 255), "r": (255, 160, 60)}
# RGB of the lit body and of the floor.
SKIN_COLOUR = (212, 172, 146)
FLOOR_COLOUR = (186, 194, 203)
# The floor's mesh lies so far below its grid and the soles, metres.
FLOOR_GAP_M = 0.004
# RGB of measured markers.
TARGET_COLOUR = (255, 60, 255)
# An ellipsoid is shown of a landmark that deviates by more, over the three axes, metres.
SHOWN_DEVIATION_M = 0.05
# RGBA of the ellipsoids.
DEVIATION_COLOUR = (90, 110, 190, 45)


@contextmanager
def recording(path: Path) -> Iterator[rr.RecordingStream]:
    """A stream into a file, which is written at the end.

    Until then it is in memory, which holds some 2 kB a sample, the few images and surfaces. On a
    full disk the library's own files end without an error, or it waits for ever.

    Raises:
        OSError: the file cannot be written.
    """
    stream = rr.RecordingStream("jaxmocap")
    content = stream.binary_stream()
    try:
        yield stream
        # Each read gives a complete file, so it is read at once.
        path.write_bytes(content.read() or b"")
    finally:
        stream.disconnect()


def log_body(stream: rr.RecordingStream, scene: BodyScene) -> None:
    """The poses of the body of ``log_pieces``: its bones' transforms, the skeleton as lines."""
    wxyz = quaternion_from_matrix(scene.R_world_bone)
    for i, bone in enumerate(scene.tree.bones):
        turns = np.roll(wxyz[:, i], -1, axis=-1)
        columns = rr.Transform3D.columns(translation=scene.near[:, i], quaternion=turns)
        stream.send_columns(f"world/body/{bone}", [at_times(scene.times)], columns)
    strips = np.stack([scene.near, scene.far], 2)
    send_strips(stream, "world/skeleton", scene.times, strips, rr.LineStrips3D)


def log_pieces(
    stream: rr.RecordingStream, tree: Tree, pieces: Mapping[str, Solid], floor: Floor | None
) -> None:
    """What of a body is sent once: its pieces, lit; the floor; the style of the skeleton."""
    stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    for bone, solid in pieces.items():
        stream.log(f"world/body/{bone}", _mesh(solid, SKIN_COLOUR), static=True)
    if floor is not None:
        stream.log("world/floor", _mesh(_square(floor), FLOOR_COLOUR), static=True)
    colours = [COLOURS[segment.side] for segment in tree.segments]
    style = rr.LineStrips3D.from_fields(radii=0.006, colors=colours)
    stream.log("world/skeleton", style, static=True)


def _mesh(solid: Solid, colour: tuple[int, int, int]) -> rr.Mesh3D:
    return rr.Mesh3D(
        vertex_positions=solid.vertices,
        vertex_normals=solid.normals,
        triangle_indices=solid.triangles,
        albedo_factor=colour,
    )


def _square(floor: Floor) -> Solid:
    """The floor's mesh, seen from above."""
    corners = floor.half_size_m * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    level = np.full((4, 1), floor.height_m - FLOOR_GAP_M)
    vertices = np.concatenate([floor.centre_xy + corners, level], 1)
    return Solid(vertices, np.tile([0.0, 0.0, 1.0], (4, 1)), np.array([[0, 1, 2], [0, 2, 3]]))


def log_styles(stream: rr.RecordingStream, targets: Iterable[str]) -> None:
    """What of measured markers and of deviations is sent once."""
    for name in targets:
        style = rr.Points3D.from_fields(
            radii=0.012, colors=TARGET_COLOUR, labels=name, show_labels=False
        )
        stream.log(entity_path("world", "markers", name), style, static=True)
    style = rr.Ellipsoids3D.from_fields(
        colors=DEVIATION_COLOUR, fill_mode=rr.components.FillMode.Solid
    )
    stream.log("world/deviations", style, static=True)


def log_targets(
    stream: rr.RecordingStream, times: np.ndarray, targets: Mapping[str, np.ndarray]
) -> None:
    """Measured markers as points; none where one is missing."""
    for name, positions in targets.items():
        entity = entity_path("world", "markers", name)
        is_visible = np.isfinite(positions).all(-1)
        columns = rr.Points3D.columns(positions=np.asarray(positions)[is_visible])
        stream.send_columns(entity, [at_times(times)], columns.partition(is_visible.astype(int)))


def log_deviations(stream: rr.RecordingStream, uncertainty: Uncertainty) -> None:
    """An ellipsoid of one standard deviation about each landmark that deviates by much."""
    times, centres = uncertainty.times, uncertainty.centres
    deviations = uncertainty.deviations
    spread = np.sqrt(np.sum(deviations**2, -1))
    is_shown = np.isfinite(centres).all(-1) & (spread > SHOWN_DEVIATION_M)
    columns = rr.Ellipsoids3D.columns(centers=centres[is_shown], half_sizes=deviations[is_shown])
    counts = columns.partition(is_shown.sum(1).astype(int))
    stream.send_columns("world/deviations", [at_times(times)], counts)


def send_strips(
    stream: rr.RecordingStream,
    entity: str,
    times: np.ndarray,
    strips: np.ndarray,
    archetype: type[rr.LineStrips2D] | type[rr.LineStrips3D],
) -> None:
    """(T, N, P, 2 or 3) lines. One with a NaN becomes a point, which keeps the others' colours."""
    is_finite = np.isfinite(strips).all((-1, -2), keepdims=True)
    drawn = np.where(is_finite, strips, 0.0).astype(np.float32)
    columns = archetype.columns(strips=drawn.reshape(-1, *drawn.shape[2:]))
    counts = np.full(len(drawn), drawn.shape[1])
    stream.send_columns(entity, [at_times(times)], columns.partition(counts))


def at_times(times: np.ndarray) -> rr.TimeColumn:
    """Seconds (T,) on the recording's timeline."""
    return rr.TimeColumn(TIMELINE, duration=np.asarray(times, np.float64))


def send_recording(path: Path, url: str) -> None:
    """Send a recording (.rrd) to a viewer, as itself; this process must go on while it loads.

    Raises:
        ImportError: the installed rerun-sdk cannot read such files.
        InputError: the file is no recording, or not all of one.
    """
    from rerun.chunk import RrdReader

    try:
        with warnings.catch_warnings(action="ignore"):  # of files without an index
            (entry, *_) = RrdReader(path).recordings()
    except (RuntimeError, ValueError) as error:
        reason = f"expected a recording of rerun, found none ({str(error).rpartition(': ')[2]})"
        raise InputError(path, reason) from None
    stream = rr.RecordingStream(
        entry.application_id, recording_id=entry.recording_id, send_properties=False
    )
    stream.connect_grpc(url)
    stream.log_file_from_path(path)
    stream.flush()


# Joints whose angles are shown, as angles.mot names them.
SHOWN_JOINTS = ("elbow_flex_l", "elbow_flex_r", "knee_flexion_l", "knee_flexion_r")
# Of a body that has none of these, so many joints.
MOST_JOINTS = 4
# RGB of a plot's lines that are of no side.
LINE_COLOURS = (
    (200, 60, 120), (60, 150, 90), (230, 170, 30), (110, 90, 200), (40, 160, 190), (140, 110, 80),
)  # fmt: skip
# Brightness of the lines of legs, to tell them from those of arms.
LEG_BRIGHTNESS = 0.6


def shown_joints(tree: Tree) -> dict[str, int]:
    """Joint -> its index among a pose's angles."""
    shown = [name for name in SHOWN_JOINTS if name in tree.joints] or tree.joints[:MOST_JOINTS]
    return {name: tree.joints.index(name) for name in shown}


def log_angles(stream: rr.RecordingStream, motion: Motion) -> None:
    """The shown joints' angles, degrees."""
    joints = shown_joints(motion.skeleton.tree)
    angles = np.degrees(np.asarray(motion.poses.angles, float)[:, list(joints.values())])
    _send_series(stream, ANGLES, motion.times, joints, angles)


def log_report(stream: rr.RecordingStream, times: np.ndarray, report: Report) -> None:
    """Time series of a tracker's report, and its statuses."""
    errors = 1000 * np.asarray(report.marker_errors, float)
    _send_series(stream, "marker_errors", times, report.markers, errors)
    _send_series(stream, "arm_costs", times, SIDES, report.arm_costs)
    _send_series(stream, DEVIATIONS, times, SIDES, 100 * report.elbow_deviations)
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
        stream.send_columns("statuses", [at_times(np.array(at))], rr.TextLog.columns(text=texts))


def log_why(stream: rr.RecordingStream, deviations_m: Mapping[str, Mapping[str, float]]) -> None:
    """A table of each landmark's deviation without each part of the evidence, centimetres."""
    parts = list(dict.fromkeys(part for own in deviations_m.values() for part in own))
    rows = [["without", *parts], ["---"] * (len(parts) + 1)]
    rows += [
        [name, *(f"{100 * own[part]:.1f}" if part in own else "" for part in parts)]
        for name, own in deviations_m.items()
    ]
    text = "\n".join(f"| {' | '.join(row)} |" for row in rows)
    document = rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN)
    stream.log(WHY, document, static=True)


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
        stream.send_columns(entity_path(root, name), [at_times(times[is_finite])], columns)


def log_line(stream: rr.RecordingStream, root: str, name: str, number: int) -> None:
    """The style of a time series' line: the body's colour of a side, others by their number."""
    colour = LINE_COLOURS[number % len(LINE_COLOURS)]
    if name in SIDES:
        colour = COLOURS[name[0]]
    elif root == ANGLES and name[-2:] in ("_l", "_r"):
        brightness = LEG_BRIGHTNESS if name.startswith(("knee", "hip")) else 1.0
        colour = tuple(round(brightness * part) for part in COLOURS[name[-1]])
    style = rr.SeriesLines(names=name, colors=colour)
    stream.log(entity_path(root, name), style, static=True)


def log_values(stream: rr.RecordingStream, root: str, values: Mapping[str, float]) -> None:
    """One point of each line of a time series, at the stream's present time."""
    for name, value in values.items():
        stream.log(entity_path(root, name), rr.Scalars(float(value)))
