"""A body's surface in a recording for the rerun viewer, which itself carries no skin on bones.

INPUTS: a recording stream, a Motion, the body's Surface. OUTPUTS: none; entity ``world/skin``.

Vertices are logged pose by pose: of a surface with fewer nodes, and of so many poses at most.
"""

import numpy as np
import rerun as rr

from jaxmocap.body.host_skin import bones_over_time, nodes_over_time
from jaxmocap.body.loft import rest_joints
from jaxmocap.body.mesh import atlas_of, coarser, mesh_of, normals_of
from jaxmocap.body.motion import Motion
from jaxmocap.body.surface import Surface, rest_nodes
from jaxmocap.outputs.layout import TIMELINE

# Metres between nodes, and poses in a recording: about eight megabytes together.
SPACING_M, MOST_POSES = 0.045, 150
# RGBA: what lies within shines through.
COLOUR = (205, 175, 150, 150)


def log_skin(stream: rr.RecordingStream, motion: Motion, surface: Surface) -> None:
    """The surface as the motion moves it; cleared where the pose is unknown."""
    joints = rest_joints(motion.skeleton)
    coarse = coarser(surface, rest_nodes(surface, joints), SPACING_M)
    rest = rest_nodes(coarse, joints)
    mesh = mesh_of(coarse, rest, atlas_of(coarse, rest, SPACING_M))
    look = rr.Mesh3D.from_fields(triangle_indices=mesh.triangles, albedo_factor=COLOUR)
    stream.log("world/skin", look, static=True)
    R, places = bones_over_time(motion.skeleton, motion.poses)
    stride = -(-len(motion.times) // MOST_POSES)
    for i in range(0, len(motion.times), stride):
        stream.set_time(TIMELINE, duration=float(motion.times[i]))
        vertices = nodes_over_time(coarse.points, R[i : i + 1], places[i : i + 1])[0, mesh.nodes]
        if not np.isfinite(vertices).all():
            vertices = np.zeros_like(vertices)
        normals = normals_of(vertices, mesh.triangles)
        stream.log(
            "world/skin",
            rr.Mesh3D.from_fields(
                vertex_positions=vertices.astype(np.float32),
                vertex_normals=normals.astype(np.float32),
            ),
        )
