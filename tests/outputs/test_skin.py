"""A body's surface as a skin in glTF files, as pygltflib and trimesh see it."""

import io
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from gltf_player import Player
from moving_body import moving_body
from PIL import Image
from scipy.spatial import cKDTree
from test_outputs import read_recording

from jaxmocap.body.kinematics import forward
from jaxmocap.body.motion import Motion
from jaxmocap.body.pose import Pose
from jaxmocap.body.subject import rest_joints
from jaxmocap.body.surfaces.cones import with_thickness
from jaxmocap.body.surfaces.loft import generic_surface
from jaxmocap.body.surfaces.mesh import atlas_of, coarser, mesh_of
from jaxmocap.body.surfaces.surface import bones_over_time, nodes_over_time, pose_points, rest_nodes
from jaxmocap.capture.photographs import png_of
from jaxmocap.formats.animation.export import write_animation, write_avatar
from jaxmocap.formats.armatures.skin import TEXEL_M
from jaxmocap.formats.files.errors import InputError
from jaxmocap.outputs.viewer import write_rerun

# Our world is Z up, facing X; the files' Y up, facing Z.
R_FILE_WORLD = np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]])
TENTH_OF_A_MILLIMETRE = 1e-4
PLACE = jax.jit(forward)


@pytest.fixture(scope="module")
def surface():
    return generic_surface(moving_body().skeleton)


@pytest.fixture(scope="module")
def atlas(surface):
    nodes = rest_nodes(surface, rest_joints(moving_body().skeleton))
    return atlas_of(surface, nodes, TEXEL_M)


@pytest.fixture(scope="module")
def folder(surface, atlas, tmp_path_factory):
    folder = tmp_path_factory.mktemp("skins")
    write_animation(folder / "motion.glb", moving_body(), surface)
    picture = np.zeros((atlas.height, atlas.width, 3), np.uint8)
    for i, rectangle in enumerate(atlas.rectangles):
        picture[rectangle.within] = colour(i)[::-1]
    write_avatar(folder / "person.glb", moving_body().skeleton, surface, png_of(picture))
    return folder


def colour(patch: int) -> tuple[int, int, int]:
    """RGB by which a patch is identified."""
    return 30 * patch + 10, 200 - 20 * patch, 90


def traced_nodes(surface, key: int) -> np.ndarray:
    """(N, 3) of the moving body at a sample, world."""
    motion = moving_body()
    pose = Pose(*(jnp.asarray(np.asarray(part)[key], jnp.float32) for part in motion.poses))
    return np.asarray(pose_points(PLACE(motion.skeleton, pose), surface.points))


@pytest.mark.parametrize("key", [0, 37])
def test_the_files_own_numbers_put_every_vertex_where_our_skinning_does(
    folder, surface, atlas, key
):
    nodes = rest_nodes(surface, rest_joints(moving_body().skeleton))
    mesh = mesh_of(surface, nodes, atlas)
    ours, played = traced_nodes(surface, key), Player(folder / "motion.glb").vertices(key)
    assert np.abs(played - ours[mesh.nodes] @ R_FILE_WORLD.T).max() < TENTH_OF_A_MILLIMETRE


def test_nodes_over_time_are_where_the_traced_ones_are(surface):
    motion = moving_body()
    nodes = nodes_over_time(surface.points, *bones_over_time(motion.skeleton, motion.poses))
    for key in (0, 37):
        assert np.abs(nodes[key] - traced_nodes(surface, key)).max() < TENTH_OF_A_MILLIMETRE


def test_every_patch_of_a_skin_is_closed_and_faces_outwards(folder, surface):
    player = Player(folder / "motion.glb")
    triangles = player.numbers(player.file.meshes[0].primitives[0].indices).reshape(-1, 3)
    mesh = trimesh.Trimesh(player.attribute("POSITION"), triangles, process=False)
    normals = np.asarray(player.attribute("NORMAL"))
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-5)
    kept = mesh.nondegenerate_faces()
    towards = np.sum(normals[triangles[:, 0]] * mesh.face_normals, 1)[kept]
    assert np.mean(towards > 0) > 0.99
    mesh.merge_vertices(merge_tex=True, merge_norm=True, digits_vertex=5)
    mesh.update_faces(mesh.nondegenerate_faces())
    parts = mesh.split()
    assert len(parts) == len(surface.patches)
    assert all(part.is_watertight and part.volume > 1e-4 for part in parts)


def test_a_person_stands_in_a_t_on_the_ground(folder):
    player = Player(folder / "person.glb")
    assert not player.file.animations
    low, high = player.vertices(None).min(0), player.vertices(None).max(0)
    assert abs(low[1]) < 0.02 and abs(high[1] - 1.75) < 0.06
    assert abs((high - low)[0] - 1.75) < 0.25
    shown = trimesh.load_scene(folder / "person.glb").geometry["body"]
    assert shown.visual.kind == "texture"


def test_every_vertex_has_the_colours_of_its_own_patch(folder, surface):
    player = Player(folder / "person.glb")
    view = player.file.bufferViews[player.file.images[0].bufferView]
    start = view.byteOffset or 0
    content = player.file.binary_blob()[start : start + view.byteLength]
    picture = np.asarray(Image.open(io.BytesIO(content)).convert("RGB"))
    height, width, _ = picture.shape
    places = player.attribute("TEXCOORD_0") * [width, height]
    colours = picture[places[:, 1].astype(int), places[:, 0].astype(int)]
    counts = [patch.along * (patch.around + 1) for patch in surface.patches]
    expected = np.repeat([colour(i) for i in range(len(counts))], counts, axis=0)
    assert (colours == expected).all()


def test_the_seam_lies_at_both_ends_of_a_row(surface, atlas):
    rng = np.random.default_rng(0)
    for patch, rectangle in zip(surface.patches, atlas.rectangles, strict=True):
        texels = rectangle.texels(rng.random((patch.along, patch.around, 3)))
        np.testing.assert_allclose(texels[:, 0], texels[:, -1], atol=1e-12)


def test_rectangles_of_an_atlas_do_not_overlap(atlas):
    count = np.zeros((atlas.height, atlas.width), int)
    for rectangle in atlas.rectangles:
        count[rectangle.within] += 1
    assert count.max() == 1 and count.mean() > 0.6
    assert count.sum() == sum(r.width * r.height for r in atlas.rectangles)


def test_a_coarser_surface_is_the_same_body_with_fewer_nodes(surface):
    joints = rest_joints(moving_body().skeleton)
    nodes = rest_nodes(surface, joints)
    thin = coarser(surface, nodes, 0.06)
    fewer = rest_nodes(thin, joints)
    assert len(fewer) < 0.5 * len(nodes)
    assert {tuple(node) for node in fewer.tolist()} <= {tuple(node) for node in nodes.tolist()}
    for patch, full in zip(thin.patches, surface.patches, strict=True):
        extents = [np.ptp(part, axis=0) for part in (fewer[patch.nodes], nodes[full.nodes])]
        np.testing.assert_allclose(*extents, atol=0.02)
    # What is to be finer than it is stays.
    assert coarser(surface, nodes, 0.001).patches == surface.patches


def test_the_viewer_shows_the_skin_where_the_motion_carries_it(surface, tmp_path):
    moving = moving_body()
    few = Pose(*(np.asarray(part)[[0, 37]] for part in moving.poses))
    motion = Motion(moving.skeleton, moving.times[[0, 37]], few)
    write_rerun(tmp_path / "a.rrd", motion, surface=surface)
    timed, static = read_recording(tmp_path / "a.rrd")
    assert "/world/body/humerus_l" not in static
    (look,) = static["/world/skin"]
    triangles = np.array(look.column("Mesh3D:triangle_indices").to_pylist()[0])
    rows = {}
    for batch in timed["/world/skin"]:
        stamps = np.asarray(batch.column("time").cast("int64"))
        rows |= dict(zip(stamps, batch.column("Mesh3D:vertex_positions").to_pylist(), strict=True))
    assert len(rows) == len(motion.times)
    vertices = np.array(rows[np.round(motion.times[1] * 1e9).astype(int)])
    assert triangles.max() < len(vertices)
    apart, _ = cKDTree(traced_nodes(surface, 37)).query(vertices)
    assert apart.max() < TENTH_OF_A_MILLIMETRE


def test_the_viewer_shows_a_skin_with_its_colours(surface, atlas, tmp_path):
    moving = moving_body()
    first = Pose(*(np.asarray(part)[:1] for part in moving.poses))
    picture = np.full((atlas.height, atlas.width, 3), (10, 20, 30), np.uint8)
    motion = Motion(moving.skeleton, moving.times[:1], first)
    write_rerun(tmp_path / "a.rrd", motion, surface=surface, picture=picture)
    timed, static = read_recording(tmp_path / "a.rrd")
    (look,) = static["/world/skin"]
    texture = np.array(look.column("Mesh3D:albedo_texture_buffer").to_pylist()[0], np.uint8)
    assert (texture.reshape(-1, 3) == [30, 20, 10]).all() and texture.size == picture.size
    places = np.array(look.column("Mesh3D:vertex_texcoords").to_pylist()[0])
    (batch,) = timed["/world/skin"]
    vertices = np.array(batch.column("Mesh3D:vertex_positions").to_pylist()[0])
    assert len(places) == len(vertices) and places.min() > 0 and places.max() < 1
    nodes = rest_nodes(surface, rest_joints(moving.skeleton))
    own = traced_nodes(surface, 0)[mesh_of(surface, nodes, atlas).nodes]
    assert np.abs(vertices - own).max() < TENTH_OF_A_MILLIMETRE


def test_a_surface_that_gltf_cannot_hold_is_refused_in_one_sentence(surface, tmp_path):
    moved = np.array(surface.points.points_bone)
    moved[:, 0, 0] += 0.03
    torn = replace(surface, points=surface.points._replace(points_bone=jnp.asarray(moved)))
    with pytest.raises(InputError, match=r"mm apart at rest, expected 1 mm at most"):
        write_avatar(tmp_path / "torn.glb", moving_body().skeleton, torn)
    other = png_of(np.zeros((30, 40, 3), np.uint8))
    with pytest.raises(InputError, match=r"a texture of 40 x 30 texels, expected \d+ x \d+"):
        write_avatar(tmp_path / "torn.glb", moving_body().skeleton, surface, other)
    assert not list(tmp_path.iterdir())


def test_limbs_are_as_thick_as_the_surface():
    skeleton = moving_body().skeleton
    slim, stout = (generic_surface(skeleton, girth) for girth in (0.8, 1.2))
    thin, thick = (np.asarray(with_thickness(skeleton, s).diameters) for s in (slim, stout))
    arm, spine = skeleton.tree.bone("humerus_r"), skeleton.tree.bone("spine1")
    assert (thick[arm] / thin[arm] > 1.2).all() and 0.05 < thin[arm].mean() < 0.1
    assert (thick[spine] == np.asarray(skeleton.diameters)[spine]).all()
