"""A body's surface in a recording for the rerun viewer, which itself carries no skin on bones.

INPUTS: a recording stream, a Motion, the body's Surface, optionally its colours.
OUTPUTS: none; entity ``world/skin``.

Vertices are logged pose by pose, of so many poses at most: of a surface with fewer nodes, or, where
its colours were measured, of the surface itself, without shades.
"""

from typing import Any

import numpy as np
import rerun as rr

from jaxmocap.body.motion import Motion
from jaxmocap.body.subject import rest_joints
from jaxmocap.body.surfaces.mesh import atlas_of, coarser, mesh_of, normals_of
from jaxmocap.body.surfaces.surface import Surface, bones_over_time, nodes_over_time, rest_nodes
from jaxmocap.formats.armatures.skin import TEXEL_M
from jaxmocap.outputs.layout import TIMELINE
from jaxmocap.outputs.recorder import SKIN_COLOUR

# Metres between nodes; with MOST_POSES some six megabytes of a recording.
SPACING_M = 0.045
# Poses of the skin in a recording.
MOST_POSES = 150


def log_skin(
    stream: rr.RecordingStream, motion: Motion, surface: Surface, picture: np.ndarray | None = None
) -> None:
    """The surface as the motion moves it; nothing where the pose is unknown.

    The picture (H, W, 3) is its colours, BGR uint8, laid out by ``atlas_of``.
    """
    joints = rest_joints(motion.skeleton)
    if picture is None:
        surface = coarser(surface, rest_nodes(surface, joints), SPACING_M)
    rest = rest_nodes(surface, joints)
    mesh = mesh_of(surface, rest, atlas_of(surface, rest, TEXEL_M))
    colours: dict[str, Any] = {"albedo_factor": SKIN_COLOUR}
    if picture is not None:
        height, width = picture.shape[:2]
        colours = {
            "vertex_texcoords": mesh.places,
            "albedo_texture_buffer": np.ascontiguousarray(picture[..., ::-1]).tobytes(),
            "albedo_texture_format": rr.components.ImageFormat(
                width=width, height=height, color_model="RGB", channel_datatype="U8"
            ),
        }
    # Triangles, and colours or a texture, are sent once.
    triangles = rr.Mesh3D.from_fields(triangle_indices=mesh.triangles, **colours)
    stream.log("world/skin", triangles, static=True)
    R, places = bones_over_time(motion.skeleton, motion.poses)
    for i in range(0, len(motion.times), -(-len(motion.times) // MOST_POSES)):
        (nodes,) = nodes_over_time(surface.points, R[i : i + 1], places[i : i + 1])
        stream.set_time(TIMELINE, duration=float(motion.times[i]))
        vertices = np.nan_to_num(nodes)[mesh.nodes]
        normals = None if picture is not None else normals_of(vertices, mesh.triangles)
        posed = rr.Mesh3D.from_fields(vertex_positions=vertices, vertex_normals=normals)
        stream.log("world/skin", posed)
