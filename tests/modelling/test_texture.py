"""A person's colours: what photographs show comes back, and what they do not is taken from near."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.body.subject import rest_joints
from jaxmocap.body.surfaces.loft import generic_surface
from jaxmocap.body.surfaces.mesh import atlas_of, mesh_of
from jaxmocap.body.surfaces.surface import bones_over_time, nodes_over_time, rest_nodes
from jaxmocap.geometry.cameras import Camera
from jaxmocap.silhouette.modelling.personal import PersonalModel
from jaxmocap.silhouette.modelling.pictures.medial_axis import rim_distance
from jaxmocap.silhouette.modelling.pictures.views import PhotographView
from jaxmocap.silhouette.modelling.texture.avatar import Avatar, avatar_of
from jaxmocap.silhouette.modelling.texture.fusion import (
    blend_colours,
    close_holes,
    feathered_weight,
    gains,
    weighted_blur,
    wide_blend,
)
from jaxmocap.silhouette.modelling.texture.texels import (
    NONE,
    nearest_points,
    splat_points,
    texels_of,
    visible_points,
)

TEXEL = 0.008
BACKDROP = np.array([90, 200, 60], np.uint8)
SHAPE = (400, 400)


def looking(azimuth: float) -> Camera:
    """From 6 m at the pelvis, 4 mm to a pixel."""
    turn = np.radians(azimuth)
    back = np.array([np.cos(turn), np.sin(turn), 0.0])
    T = np.eye(4)
    T[:3, :3] = [[-back[1], back[0], 0], [0, 0, -1], -back]
    T[:3, 3] = -T[:3, :3] @ (6.0 * back)
    matrix = np.array([[800.0, 0, 200], [0, 800, 200], [0, 0, 1]])
    size = np.array(SHAPE[::-1])
    return Camera(matrix=matrix, distortion=np.zeros(8), T_cam_world=T, size=size)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def person():
    """Legs spread, arms held aside, as the front view has them."""
    skeleton = Skeleton.human(1.75)
    angles = np.zeros(len(skeleton.tree.joints))
    for name, degrees in {"arm_abduct": 35, "hip_abduction": 7}.items():
        for side in "lr":
            angles[skeleton.tree.joint(f"{name}_{side}")] = np.radians(degrees)
    pose = Pose(np.zeros(3), np.array([1.0, 0, 0, 0]), angles)  # type: ignore[arg-type]
    return PersonalModel(skeleton, generic_surface(skeleton), {"front": pose, "side": pose})


def painted(person: PersonalModel) -> tuple[Avatar, np.ndarray]:
    """Symmetric colours without green, slowly changing with where a place is at rest."""
    nodes = rest_nodes(person.surface, rest_joints(person.skeleton))
    atlas = atlas_of(person.surface, nodes, TEXEL)
    mesh = mesh_of(person.surface, nodes, atlas)
    texels = texels_of(person.surface, atlas, mesh, nodes)
    red = 150 + 80 * np.sin(6 * texels.points[:, 2])
    blue = 60 + 150 * np.abs(texels.points[:, 1])
    picture = np.zeros((atlas.height, atlas.width, 3), np.uint8)
    picture[texels.rows, texels.columns] = np.stack([blue, np.full(len(red), 20), red], 1)
    return Avatar(person, atlas, mesh, picture, {}), texels.patches


def rendered(
    avatar: Avatar, nodes: np.ndarray, view: PhotographView, shape: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """The person with nodes at (N, 3) as a camera sees them, and where: (H, W, 3), (H, W)."""
    texels = texels_of(avatar.person.surface, avatar.atlas, avatar.mesh, nodes)
    towards = view.centre - texels.points
    front = np.sum(towards * texels.normals, 1) > 0
    colours = avatar.picture[texels.rows, texels.columns]
    depths, pixels = np.linalg.norm(towards, axis=1), view.pixels(texels.points)
    return splat_points(pixels[front], depths[front], colours[front], shape)


@pytest.fixture(scope="module")
def photographs(person):
    """Images and views of the painted person from ahead and from the left."""
    avatar, _ = painted(person)
    pose = person.poses["front"]
    poses = Pose(*(np.asarray(part)[None] for part in pose))  # type: ignore[arg-type]
    (nodes,) = nodes_over_time(person.surface.points, *bones_over_time(person.skeleton, poses))
    images, views = {}, {}
    for name, azimuth in {"front": 0.0, "side": 90.0}.items():
        camera = looking(azimuth)
        empty = PhotographView(np.zeros(SHAPE, bool), camera)
        image, shown = rendered(avatar, nodes, empty, SHAPE)
        images[name] = np.where(shown[..., None], image, BACKDROP)
        views[name] = PhotographView(shown, camera)
    return images, views


@pytest.fixture(scope="module")
def avatar(person, photographs):
    return avatar_of(person, *photographs, TEXEL)


def test_colours_come_back_and_on_the_side_that_no_camera_saw_too(person, avatar):
    truth, patches = painted(person)
    texels = texels_of(person.surface, avatar.atlas, avatar.mesh, avatar.shots["front"].nodes_world)
    off = np.abs(avatar.picture.astype(int) - truth.picture).max(-1)[texels.rows, texels.columns]
    ahead = texels.normals[:, 0] > -0.3
    names = np.array([patch.name for patch in person.surface.patches])[patches]
    for name in ("torso", "leg_l", "leg_r", "arm_l", "arm_r"):
        mine = ahead & (names == name)
        assert np.median(off[mine]) < 8 and np.percentile(off[mine], 90) < 40, name


def test_nothing_of_the_backdrop_comes_onto_the_person(avatar):
    assert avatar.picture[..., 1].max() < 40


def test_an_avatar_looks_like_its_photographs(avatar):
    for name, shot in avatar.shots.items():
        picture, drawn = rendered(avatar, shot.nodes_world, shot.view, shot.view.mask.shape)
        both = drawn & shot.view.mask
        assert np.abs(picture[both].astype(float) - shot.image[both]).mean() < 6, name


def test_a_person_is_shown_from_four_sides(avatar):
    quarters = np.split(avatar.around(), 4, axis=1)
    widths = [np.ptp(np.flatnonzero((quarter != 245).any((0, 2)))) for quarter in quarters]
    assert widths[0] == pytest.approx(widths[2], abs=3) and widths[0] > 1.5 * widths[1]


def test_exposure_and_white_balance_are_undone_by_the_backdrop():
    rng = np.random.default_rng(0)
    colours, ones = rng.uniform(40, 200, (500, 3)), np.ones(500)
    exposed, backdrop = np.array([0.7, 0.8, 0.9]), np.array([120.0, 90, 60])
    actual = gains(
        [colours, colours * exposed], [ones, ones], np.array([backdrop, backdrop * exposed])
    )
    np.testing.assert_allclose(actual[0], 1)
    np.testing.assert_allclose(actual[1], 1 / exposed)


def test_another_wall_behind_the_person_is_not_taken_for_exposure():
    colours, ones = np.full((100, 3), 100.0), np.ones(100)
    walls = np.array([[200.0, 200, 200], [60, 90, 120]])
    np.testing.assert_allclose(gains([colours, colours], [ones, ones], walls), 1)


@settings(max_examples=30, deadline=None)
@given(st.floats(0.02, 1), st.floats(0.02, 1))
def test_a_blend_lies_between_its_pictures_and_nearer_to_the_one_that_counts_more(first, second):
    blend, weight = blend_colours(
        [np.zeros((1, 3)), np.ones((1, 3))], [np.array([first]), np.array([second])]
    )
    assert weight[0] == max(first, second)
    assert 0 <= blend[0, 0] <= 1
    assert (blend[0, 0] >= 0.5 - 1e-9) == (second >= first - 1e-9)


def test_light_that_differs_slowly_is_the_same_where_two_pictures_meet():
    share = np.tile(np.clip((np.arange(120) - 20) / 80, 0, 1), (9, 1)).astype(np.float32)
    stripes = np.where(np.arange(120) // 4 % 2, 60.0, 140.0)[None, :, None]
    dark, bright = (gain * np.broadcast_to(stripes, (9, 120, 3)) for gain in (0.7, 1.3))
    colours, weights = [dark, bright], [1 - share, share]
    wide = wide_blend(colours, weights)
    even = [
        c * np.exp(weighted_blur((wide - np.log(c)).astype(np.float32), w, 6.0))
        for c, w in zip(colours, weights, strict=True)
    ]
    # In the middle they agree, details and all; at either end each is as it was.
    np.testing.assert_allclose(even[0][:, 60], even[1][:, 60], rtol=0.12)
    np.testing.assert_allclose(even[0][:, 56] / even[0][:, 61], 140 / 60, rtol=0.1)
    np.testing.assert_allclose(even[0][:, 2], dark[:, 2], rtol=0.02)
    np.testing.assert_allclose(even[1][:, -2], bright[:, -2], rtol=0.02)


def test_holes_are_filled_from_aside_and_across_the_seam():
    picture = np.zeros((60, 96, 3), np.float32)
    picture[:30], picture[30:] = 50, 200
    valid = np.ones((60, 96), bool)
    valid[:, :20] = valid[:, -20:] = False
    filled = close_holes(np.where(valid[..., None], picture, 0), valid)
    assert (filled[valid] == picture[valid]).all()
    assert np.abs(filled - picture)[np.r_[:22, 38:60]].max() < 25


def test_a_picture_without_valid_places_stays():
    picture = np.full((8, 9, 3), 7.0)
    assert (close_holes(picture, np.zeros((8, 9), bool)) == 7).all()


def test_the_nearest_point_of_a_cell_is_kept_and_what_lies_behind_is_hidden():
    cells = np.array([[2.0, 1], [2.2, 0.9], [4, 3], [-1, 0], [9, 9]])
    depths = np.array([3.0, 2.0, 5.0, 1.0, 1.0])
    actual = nearest_points(cells, depths, (5, 6))
    assert actual[1, 2] == 1 and actual[3, 4] == 2 and (actual != NONE).sum() == 2
    assert visible_points(cells, depths, (5, 6), [(0, 0.1)]).tolist() == [
        False,
        True,
        True,
        False,
        False,
    ]
    assert not visible_points(cells, depths, (5, 6), [(2, 0.1)])[2]


def test_single_open_cells_of_a_picture_are_closed_and_wide_ones_are_not():
    rows, columns = np.divmod(np.arange(100), 10)
    there = ((rows != 5) | (columns != 5)) & (columns < 8)
    cells = np.stack([columns, rows], 1)[there].astype(float)
    picture, shown = splat_points(
        cells, np.ones(len(cells)), np.full((len(cells), 3), 40), (10, 10)
    )
    assert shown[5, 5] and (picture[5, 5] == 40).all() and not shown[:, 9].any()


def test_weights_fade_towards_what_is_hidden_and_towards_the_rim():
    hidden = np.zeros((5, 20), bool)
    hidden[:, 0] = True
    assert feathered_weight(hidden, 10.0)[2, [0, 5, 15]] == pytest.approx([0, 0.5, 1], abs=0.05)
    assert rim_distance(np.ones((9, 9), bool), False)[4, [0, 4]] == pytest.approx([1, 5], abs=0.2)
