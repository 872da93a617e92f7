"""What is drawn and written of a motion: overlay, viewer recording, report."""

import json
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace

import av
import cv2
import numpy as np
import pytest
from conftest import complaint, rerun_chunks
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxmocap.body.motion import Motion, Report, Run
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import ELBOWS, LANDMARKS, Skeleton
from jaxmocap.body.surfaces.pieces import body_pieces
from jaxmocap.formats.time_series.mot import read_mot, write_mot
from jaxmocap.geometry.cameras import Camera, visible_pixels
from jaxmocap.geometry.solids import limb_solid
from jaxmocap.outputs import overlay, viewer
from jaxmocap.outputs.ellipses import SIGMAS, ellipses_in, landmark_ellipses, uncertainty_of
from jaxmocap.outputs.layout import lay_out
from jaxmocap.outputs.overlay import JOINT_COLOUR, OUTLINE_COLOURS, OverlayArtist, write_overlay
from jaxmocap.outputs.report import summarise, write_figures
from jaxmocap.outputs.scene import floor_of, limb_outlines, make_scene
from jaxmocap.outputs.viewer import Footage, write_rerun

SAMPLES, RATE, START = 40, 90.0, 12.5
GAP = slice(5, 9)


def make_motion() -> Motion:
    """A person who moves all joints smoothly within their limits."""
    skeleton = Skeleton.human(1.75)
    times = START + np.arange(SAMPLES) / RATE
    limits, relaxed = np.asarray(skeleton.limits), np.asarray(skeleton.relaxed)
    phases = np.random.default_rng(3).uniform(0, 6, len(relaxed))
    turn = 2 * np.pi * (times - START)[:, None] + phases
    angles = np.clip(relaxed + 0.15 * np.ptp(limits, axis=1) * np.sin(turn), *limits.T)
    position = np.tile([0.0, 0.0, 0.95], (SAMPLES, 1))
    quaternion = np.tile([1.0, 0.0, 0.0, 0.0], (SAMPLES, 1))
    return Motion(skeleton, times, Pose(position, quaternion, angles), make_report())


def make_report() -> Report:
    errors = np.tile(np.arange(SAMPLES)[:, None] / 1000, (1, 2))
    errors[GAP, 1] = np.nan
    costs = np.full((SAMPLES, 2), np.nan)
    costs[::3] = 2.0
    missing = [("marker LWrist is missing",) if 5 <= i < 9 else () for i in range(SAMPLES)]
    missing[20] = ("marker LWrist is missing", "planted again")
    deviations = np.full((SAMPLES, len(LANDMARKS), 3), 0.02)
    deviations[:, ELBOWS[0]], deviations[:, ELBOWS[1]] = 0.0, 0.2
    return Report(
        markers=("Head", "L Wrist:1"),
        marker_errors=errors,
        arm_costs=costs,
        swivels=np.full((SAMPLES, 2), 0.1),
        landmarks_std=deviations,
        from_prior=np.zeros((SAMPLES, len(LANDMARKS))),
        statuses=tuple(missing),
        milliseconds={"solve": np.arange(101.0), "refine": np.full(13, 2.0)},
        run=Run(tracker={"refine": "none", "weights": np.ones(2, np.float32), "limit": np.inf}),
    )


@pytest.fixture(scope="module")
def motion() -> Motion:
    return make_motion()


@pytest.fixture(scope="module")
def targets(motion) -> dict[str, np.ndarray]:
    joints = motion.joints()
    wrist = joints["wrist_l"].copy()
    wrist[GAP] = np.nan
    return {"Head": joints["vertex"] + 0.01, "L Wrist:1": wrist}


def make_camera(width: int = 320, height: int = 240) -> Camera:
    """Three metres before the person, looking back along -x, with some distortion."""
    R = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])
    focal = 1.2 * height
    matrix = [[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]]
    return Camera.create(
        (width, height), np.array(matrix), [-0.1, 0.02], R, -R @ np.array([3.0, 0.0, 1.1])
    )


def make_frames(count: int = 6, shape=(240, 320)) -> Iterator[tuple[float, np.ndarray | None]]:
    """Grey frames at 30 Hz, off the markers' phase; the third cannot be decoded."""
    for i in range(count):
        yield START + 0.004 + i / 30, None if i == 2 else np.full((*shape, 3), 90, np.uint8)


def decode(path) -> tuple[list[float], list[np.ndarray], tuple]:
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        frames = list(container.decode(stream))
        codec = (stream.codec_context.name, stream.pix_fmt, stream.width, stream.height)
    return [frame.time for frame in frames], [f.to_ndarray(format="bgr24") for f in frames], codec


def test_the_overlay_is_h264_that_browsers_play_with_each_frame_at_its_time(
    tmp_path, motion, targets
):
    path = tmp_path / "overlay.mp4"
    assert write_overlay(path, make_frames(), make_camera(), motion, targets) == 6
    times, images, codec = decode(path)
    assert codec == ("h264", "yuv420p", 320, 240)
    np.testing.assert_allclose(times, np.arange(6) / 30, atol=2e-5)
    content = path.read_bytes()
    assert 0 < content.index(b"moov") < content.index(b"mdat")
    # The frame that could not be decoded is black under the drawing.
    assert np.median(images[2]) < 20 < np.median(images[1])


def test_uneven_frame_times_and_odd_sizes_are_kept(tmp_path, motion):
    image = np.full((121, 81, 3), 90, np.uint8)
    stamps = [START, START + 0.02, START + 0.1, START + 0.11]
    path = tmp_path / "overlay.mp4"
    write_overlay(path, [(t, image) for t in stamps], make_camera(81, 121), motion)
    times, images, codec = decode(path)
    assert codec[2:] == (82, 122)
    np.testing.assert_allclose(times, np.array(stamps) - START, atol=2e-5)
    assert images[0][121].max() < 30


def test_elbows_outlines_and_targets_are_drawn_where_they_project(motion, targets):
    camera = make_camera(640, 480)
    artist = OverlayArtist(camera, motion, targets)
    canvas = artist.canvas(np.full((480, 640, 3), 90, np.uint8))
    time = float(motion.times[20])
    artist.draw(canvas, time)
    joints = {name: points[20] for name, points in motion.joints().items()}
    for name in ("elbow_l", "elbow_r"):
        x, y = visible_pixels(camera, joints[name]).round().astype(int)
        assert tuple(canvas[y, x]) == JOINT_COLOUR
    # The right elbow may be 20 cm away along each axis; the left one's ellipse is a point.
    ellipse = ellipses_in(camera, artist.uncertainty, time)["elbow_r"]
    inside = ((ellipse >= 0) & (ellipse < [640, 480])).all(1)
    x, y = ellipse[inside].round().astype(int).T
    near = np.abs(canvas[y, x].astype(int) - OUTLINE_COLOURS["r"]).sum(-1) < 120
    assert near.mean() > 0.7
    x, y = visible_pixels(camera, targets["Head"][20]).round().astype(int)
    np.testing.assert_allclose(canvas[y, x], (255, 60, 255), atol=60)
    scene = artist.scene
    arms = scene.tree.bones_in("arm")
    loops = limb_outlines(camera, scene.near[20, arms], scene.far[20, arms], scene.radii[arms])
    for bone, loop in zip(arms, loops, strict=True):
        x, y = loop.round().astype(int).T
        # Blue and red trade places between the left and the right arm's colours.
        cooler = canvas[y, x, 0].astype(int) - canvas[y, x, 2]
        assert np.median(cooler if scene.tree.bones[bone].endswith("_l") else -cooler) > 40


def test_a_missing_marker_is_not_drawn_and_beyond_the_motion_there_is_no_body(motion, targets):
    artist = OverlayArtist(make_camera(), motion, {"L Wrist:1": targets["L Wrist:1"]})
    during, after, late = (artist.canvas(np.zeros((240, 320, 3), np.uint8)) for _ in range(3))
    artist.draw(during, float(motion.times[20]))
    artist.draw(after, float(motion.times[6]))
    artist.draw(late, float(motion.times[-1]) + 1.0)
    body = slice(85, 220)
    purple = [(image[body] == (255, 60, 255)).all(-1).sum() for image in (during, after)]
    assert purple[0] > 5 and purple[1] == 0
    assert after[body].any() and not late[body].any()
    assert late[:60].any()


def test_without_a_pose_the_legend_says_so_and_states_no_deviation(motion, targets, monkeypatch):
    position = np.array(motion.poses.position)
    position[:10] = np.nan
    gone = motion.poses._replace(position=position)
    drawn = []
    monkeypatch.setattr(
        overlay, "draw_legend", lambda _, lines: drawn.append([t for t, _ in lines])
    )
    artist = OverlayArtist(make_camera(), replace(motion, poses=gone), targets)
    for time in (motion.times[4], motion.times[20], motion.times[-1] + 50):
        artist.draw(artist.canvas(None), float(time))
    first, during, after = drawn
    assert first == [f"{motion.times[4]:.2f} s, no pose"] and after[0].endswith("no pose")
    assert len(after) == 1 and any("elbow" in text for text in during)


def test_shares_of_undetermined_landmarks_are_of_the_samples_that_have_a_deviation(motion):
    deviations = np.full((SAMPLES, len(LANDMARKS), 3), 0.5)
    deviations[:10] = np.nan
    deviations[:, 2] = np.nan
    report = replace(motion.report, landmarks_std=deviations)
    shares = report.undetermined_shares
    assert np.isnan(shares[2]) and (np.delete(shares, 2) == 1).all()
    written = summarise(replace(motion, report=report))["landmarks"][LANDMARKS[0]][
        "undetermined_share"
    ]
    assert written == shares[0]


def test_a_camera_amid_the_body_draws_only_what_is_before_it(motion):
    R = np.asarray(make_camera().T_cam_world)[:3, :3]
    inside = Camera.create(
        (320, 240), np.array([[300.0, 0, 160], [0, 300, 120], [0, 0, 1]]), [], R, -R @ [0, 0, 1.2]
    )
    artist = OverlayArtist(inside, motion)
    canvas = artist.canvas(None)
    artist.draw(canvas, float(motion.times[0]))
    scene = make_scene(motion)
    outlines = limb_outlines(inside, scene.near[0], scene.far[0], scene.radii)
    assert np.isnan(outlines).all((1, 2)).any()
    assert canvas.shape == (240, 320, 3)


def test_no_frame_is_an_input_error_and_leaves_earlier_output_as_it_was(tmp_path, motion):
    path = tmp_path / "overlay.mp4"
    path.write_bytes(b"earlier")
    assert "overlay.mp4" in complaint(write_overlay, path, [], make_camera(), motion)

    def failing():
        yield from make_frames(2)
        raise RuntimeError("the disk is gone")

    with pytest.raises(RuntimeError):
        write_overlay(path, failing(), make_camera(), motion)
    assert path.read_bytes() == b"earlier"
    assert [file.name for file in tmp_path.iterdir()] == ["overlay.mp4"]


@settings(max_examples=20, deadline=None)
@given(
    st.tuples(*[st.floats(-0.6, 0.6)] * 3),
    st.tuples(*[st.floats(0.001, 0.02)] * 3),
    st.integers(0, 1000),
)
def test_an_ellipse_is_where_points_that_scatter_so_are_seen(place, deviations, seed):
    """The covariance of the pixels of many points, against that of the ellipse's own line."""
    R = np.asarray(make_camera().T_cam_world)[:3, :3]
    matrix = np.array([[300.0, 0, 160], [0, 300, 120], [0, 0, 1]])
    camera = Camera.create((320, 240), matrix, [], R, -R @ [3.0, 0, 1.1])
    centre, spread = np.add(place, [0, 0, 1.1]), np.array(deviations)
    points = centre + spread * np.random.default_rng(seed).normal(size=(40000, 3))
    expected = np.cov(visible_pixels(camera, points).T)
    loops, half_axes = landmark_ellipses(camera, centre[None], spread[None])
    ring = loops[0, :-1] - visible_pixels(camera, centre[None])
    found = 2 / SIGMAS**2 * ring.T @ ring / len(ring)
    np.testing.assert_allclose(found, expected, atol=0.05 * np.trace(expected))
    assert half_axes[0] == pytest.approx(np.linalg.norm(ring, axis=1).max(), rel=0.02)


def test_elbows_have_ellipses_and_others_only_where_they_are_large(motion):
    deviations = np.full((SAMPLES, len(LANDMARKS), 3), 0.005)
    deviations[:, LANDMARKS.index("knee_l")] = 0.1
    deviations[:, LANDMARKS.index("elbow_r")] = np.nan
    report = replace(motion.report, landmarks_std=deviations)
    uncertainty = uncertainty_of(replace(motion, report=report))
    shown = ellipses_in(make_camera(), uncertainty, float(motion.times[20]))
    assert shown.keys() == {"elbow_l", "knee_l"}
    assert ellipses_in(make_camera(), uncertainty, float(motion.times[-1]) + 1.0) == {}
    assert uncertainty_of(replace(motion, report=None)) is None


def test_the_legend_is_small_and_the_image_behind_it_can_be_seen(motion, targets):
    artist = OverlayArtist(make_camera(640, 480), motion, targets)
    plain, canvas = (artist.canvas(np.full((480, 640, 3), 200, np.uint8)) for _ in range(2))
    artist.draw(canvas, float(motion.times[-1]) + 1.0)
    rows, columns = np.nonzero((canvas != plain).any(-1))
    assert rows.max() < 0.25 * 480 and columns.max() < 0.25 * 640
    dark = canvas[: rows.max() + 1, : columns.max() + 1]
    assert 40 < np.median(dark) < 160


coordinates = st.floats(-0.6, 0.6)


@settings(max_examples=25, deadline=None)
@given(st.tuples(*[coordinates] * 6), st.floats(0.02, 0.12), st.floats(0.02, 0.12))
def test_an_outline_holds_the_whole_limb_and_little_more(ends, near_radius, far_radius):
    camera = make_camera(640, 480)
    near, far = np.array(ends).reshape(2, 3) + np.array([0.0, 0.0, 1.1])
    radii = np.array([near_radius, far_radius])
    loop = limb_outlines(camera, near[None], far[None], radii[None])[0].astype(np.float32)
    at = np.linspace(0, 1, 40)[:, None, None]
    turns = np.random.default_rng(0).normal(size=(1, 300, 3))
    turns /= np.linalg.norm(turns, axis=-1, keepdims=True)
    surface = (1 - at) * near + at * far + ((1 - at) * near_radius + at * far_radius) * turns
    points = visible_pixels(camera, surface.reshape(-1, 3)).astype(np.float32)
    # The discs stand for slightly elliptic images of the spheres, the loop for their round ends.
    slack = 0.15 * 576 * radii.max() / 2.3 + 1.0
    inside = [cv2.pointPolygonTest(loop, tuple(map(float, point)), True) for point in points]
    assert min(inside) > -slack
    hull = cv2.contourArea(cv2.convexHull(points))
    assert cv2.contourArea(loop) == pytest.approx(hull, rel=0.12)


def test_between_two_samples_limbs_are_between_their_places(motion):
    scene = make_scene(motion)
    near, far = scene.at(float(scene.times[3:5].mean()))
    np.testing.assert_allclose(near, scene.near[3:5].mean(0), atol=1e-6)
    np.testing.assert_allclose(far, scene.far[3:5].mean(0), atol=1e-6)
    assert scene.at(float(scene.times[0]) - 0.02) is None
    np.testing.assert_allclose(scene.at(float(scene.times[-1]) + 0.005)[0], scene.near[-1])


def test_a_scene_of_one_sample_is_there_at_its_time(motion):
    one = replace(motion, times=motion.times[:1], poses=Pose(*(part[:1] for part in motion.poses)))
    near, _ = make_scene(one).at(float(motion.times[0]))
    np.testing.assert_allclose(near, make_scene(motion).near[0], atol=1e-6)
    assert make_scene(one).at(float(motion.times[0]) + 1.0) is None


def test_within_a_gap_nobody_is_drawn(motion):
    times = np.array(motion.times)
    step = times[1] - times[0]
    times[5:] += 10.0
    scene = make_scene(replace(motion, times=times))
    assert scene.at(times[4] + 2 * step) is None and scene.at((times[4] + times[5]) / 2) is None
    for time, sample in ((times[4] + 0.5 * step, 4), (times[5] - 0.5 * step, 5)):
        np.testing.assert_allclose(scene.at(time)[0], scene.near[sample])


def test_what_is_far_outside_the_view_is_not_folded_into_the_image():
    # 59.5° off the axis of a barrel lens, whose polynomial brings it back to the middle.
    matrix = np.array([[900.0, 0, 640], [0, 900, 360], [0, 0, 1]])
    camera = Camera.create((1280, 720), matrix, [-0.35, 0, 0, 0], np.eye(3), np.zeros(3))
    ((u, _),) = visible_pixels(camera, np.array([[1.7, 0, 1.0]]))
    assert u == pytest.approx(640 + 900 * 1.7)
    near, far = np.array([[1.6, 0, 1.0]]), np.array([[1.8, 0, 1.0]])
    outline = limb_outlines(camera, near, far, np.array([[0.03, 0.03]]))
    assert outline[0, :, 0].min() > 1280


@settings(max_examples=25, deadline=None)
@given(
    st.tuples(*[st.floats(-1, 1)] * 3),
    st.floats(0.05, 0.6),
    st.floats(0.01, 0.2),
    st.floats(0.01, 0.2),
)
def test_a_solid_is_closed_and_its_faces_look_outwards(direction, length, near, far):
    vector = np.array(direction) + np.array([0.0, 0.0, 2.0])
    reach = length * vector / np.linalg.norm(vector)
    solid = limb_solid(reach, np.array([near, far]))
    corners = solid.vertices[solid.triangles]
    # The middle lies inside: every pyramid over a face has a volume that is not negative.
    volumes = np.linalg.det(corners - reach / 2) / 6
    assert volumes.min() > -1e-9
    cone = np.pi / 3 * length * (near**2 + near * far + far**2)
    ends = 2 * np.pi / 3 * (near**3 + far**3)
    if abs(near - far) < 0.3 * length:
        assert volumes.sum() == pytest.approx(cone + ends, rel=0.12)
    np.testing.assert_allclose(np.linalg.norm(solid.normals, axis=1), 1.0, atol=1e-9)
    reached = np.min(
        [np.linalg.norm(solid.vertices, axis=1), np.linalg.norm(solid.vertices - reach, axis=1)], 0
    )
    assert (reached > min(near, far) - 1e-9).all()


def read_recording(path) -> tuple[dict[str, list], dict[str, list]]:
    """Entity -> record batches with time, and entity -> static ones."""
    chunks = rerun_chunks()
    reader = chunks.RrdReader(path)
    assert len(reader.recordings()) == 1 and len(reader.blueprints()) == 1
    timed, static = {}, {}
    for chunk in reader.stream():
        rows = static if chunk.is_static else timed
        rows.setdefault(chunk.entity_path, []).append(chunk.to_record_batch())
    return timed, static


def nanoseconds(batches: list) -> np.ndarray:
    """All time stamps of an entity on the timeline "time"."""
    stamps = [np.asarray(batch.column("time").cast("int64")) for batch in batches]
    return np.sort(np.concatenate(stamps))


def test_the_viewer_recording_reads_back_with_every_part_at_its_time(tmp_path, motion, targets):
    path = tmp_path / "recording.rrd"
    edges = [(START + i / 30, np.full((32, 32), 40 * i, np.uint8)) for i in range(6)]
    footage = {"cam 01": Footage(make_camera(), make_frames(), {"edges left": edges})}
    write_rerun(path, motion, footage, targets)
    timed, static = read_recording(path)
    expected = np.round(motion.times * 1e9)
    for bone in motion.skeleton.tree.bones:
        if not bone.startswith(("clavicle", "hip")):
            assert "Mesh3D:vertex_positions" in static[f"/world/body/{bone}"][0].schema.names
        np.testing.assert_allclose(nanoseconds(timed[f"/world/body/{bone}"]), expected, atol=1)
    camera = r"/world/cameras/cam\ 01"
    frames = np.round((START + 0.004 + np.arange(6) / 30) * 1e9)
    for part in ("image", "outlines", "bones"):
        np.testing.assert_allclose(nanoseconds(timed[f"{camera}/{part}"]), frames, atol=1)
    strips = timed[f"{camera}/outlines"][0].column("LineStrips2D:strips").to_pylist()
    assert {len(row) for row in strips} == {6}
    assert r"/fields/cam\ 01/edges\ left" in timed
    assert len(nanoseconds(timed["/statuses"])) == 5
    assert len(nanoseconds(timed["/arm_costs/left"])) == 14
    assert len(nanoseconds(timed["/milliseconds/refine"])) == 13
    scalars = timed["/marker_errors/Head"][0].column("Scalars:scalars").to_pylist()
    np.testing.assert_allclose([row[0] for row in scalars], np.arange(SAMPLES))


def test_the_recorded_transforms_carry_the_solids_to_the_joints(tmp_path, motion, targets):
    path = tmp_path / "recording.rrd"
    write_rerun(path, motion, targets=targets)
    timed, _ = read_recording(path)
    batch = timed["/world/body/radius_l"][0]
    x, y, z, w = np.array(batch.column("Transform3D:quaternion").to_pylist())[:, 0].T
    elbows = np.array(batch.column("Transform3D:translation").to_pylist())[:, 0]
    joints = motion.joints()
    np.testing.assert_allclose(elbows, joints["elbow_l"], atol=1e-5)
    tree = motion.skeleton.tree
    reach = np.asarray(motion.skeleton.lengths[:, None] * motion.skeleton.directions)
    v, u = reach[tree.bone("radius_l")], np.stack([x, y, z], -1)
    turned = v + 2 * np.cross(u, np.cross(u, v) + w[:, None] * v)
    np.testing.assert_allclose(elbows + turned, joints["wrist_l"], atol=1e-5)
    points = timed[r"/world/markers/L\ Wrist\:1"][0].column("Points3D:positions").to_pylist()
    assert [len(row) for row in points] == [0 if 5 <= i < 9 else 1 for i in range(SAMPLES)]


def test_the_viewer_shows_where_landmarks_deviate_by_much(tmp_path, motion):
    deviations = np.full((SAMPLES, len(LANDMARKS), 3), 0.01)
    deviations[:, 2] = 0.2
    deviations[3, 2] = np.nan
    report = replace(motion.report, landmarks_std=deviations)
    write_rerun(tmp_path / "recording.rrd", replace(motion, report=report))
    timed, _ = read_recording(tmp_path / "recording.rrd")
    (batch,) = timed["/world/deviations"]
    sizes = batch.column("Ellipsoids3D:half_sizes").to_pylist()
    assert [len(row) for row in sizes] == [int(i != 3) for i in range(SAMPLES)]
    np.testing.assert_allclose(sizes[0], [[0.2] * 3], atol=1e-6)


def test_the_viewer_plots_the_joint_angles_as_angles_mot_has_them(tmp_path, motion):
    write_rerun(tmp_path / "recording.rrd", motion)
    timed, _ = read_recording(tmp_path / "recording.rrd")
    write_mot(tmp_path / "angles.mot", motion)
    columns = read_mot(tmp_path / "angles.mot")[1]
    shown = [name for name in timed if name.startswith("/joint_angles/")]
    assert "/joint_angles/elbow_flex_l" in shown and len(shown) == 4
    for name in shown:
        rows = [row[0] for b in timed[name] for row in b.column("Scalars:scalars").to_pylist()]
        np.testing.assert_allclose(rows, np.degrees(columns[name.rpartition("/")[2]]), atol=1e-4)


def test_the_viewer_has_a_table_of_why_landmarks_are_where_they_are(tmp_path, motion):
    without = {"elbow_l": {"nothing": 0.05, "camera cam": 0.19}, "neck": {"nothing": 0.02}}
    run = replace(motion.report.run, deviations_without_m=without)
    explained = replace(motion, report=replace(motion.report, run=run))
    write_rerun(tmp_path / "recording.rrd", explained)
    _, static = read_recording(tmp_path / "recording.rrd")
    ((text,),) = static["/why"][0].column("TextDocument:text").to_pylist()
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines()]
    assert rows[0] == ["without", "nothing", "camera cam"]
    assert rows[2:] == [["elbow_l", "5.0", "19.0"], ["neck", "2.0", ""]]


def test_a_long_motion_goes_into_the_file_piece_by_piece_and_every_nth_sample_of_it(
    tmp_path, motion, targets, monkeypatch
):
    monkeypatch.setattr(viewer, "MOST_SAMPLES", 20)
    monkeypatch.setattr(viewer, "SAMPLES_AT_ONCE", 8)
    statuses = tuple(("lost",) if i == 3 else () for i in range(SAMPLES))
    warned = replace(motion, report=replace(motion.report, statuses=statuses))
    write_rerun(tmp_path / "recording.rrd", warned, targets=targets)
    timed, static = read_recording(tmp_path / "recording.rrd")
    shown = np.round(motion.times[::2] * 1e9)
    parts = timed["/world/body/radius_l"]
    # No more is in memory at once than one part.
    assert max(batch.num_rows for batch in parts) <= 8
    for entity in ("/world/body/radius_l", "/world/skeleton", "/world/markers/Head"):
        np.testing.assert_allclose(nanoseconds(timed[entity]), shown, atol=1)
    assert len(static["/world/body/radius_l"]) == 1
    # A status between two shown samples is shown with the first of them.
    assert nanoseconds(timed["/statuses"]) == pytest.approx([shown[1]], abs=1)


def test_the_floor_lies_under_the_feet_and_where_nothing_is_known_there_is_none(motion):
    pieces = body_pieces(motion.skeleton)
    standing = np.zeros_like(np.asarray(motion.poses.angles))
    still = replace(motion, poses=motion.poses._replace(angles=standing))
    floor, joints = floor_of(make_scene(still), pieces), still.joints()
    ankle = float(joints["ankle_l"][0, 2])
    assert floor is not None and ankle - 0.13 < floor.height_m < ankle - 0.03
    up = np.add(still.poses.position, [0, 0, 7.0])
    lifted = replace(still, poses=still.poses._replace(position=up))
    assert floor_of(make_scene(lifted), pieces).height_m == pytest.approx(floor.height_m + 7.0)
    unknown = replace(still, poses=still.poses._replace(angles=standing * np.nan))
    assert floor_of(make_scene(unknown), pieces) is None
    write = Motion(unknown.skeleton, unknown.times, unknown.poses)
    assert lay_out({}, make_scene(write), None) is not None


def test_a_motion_without_report_or_camera_can_be_viewed(tmp_path, motion):
    write_rerun(tmp_path / "recording.rrd", replace(motion, report=None))
    timed, _ = read_recording(tmp_path / "recording.rrd")
    assert "/world/skeleton" in timed and "/elbow_deviations/left" not in timed
    assert [file.name for file in tmp_path.iterdir()] == ["recording.rrd"]


def test_the_report_tells_times_costs_and_statuses_and_has_null_for_nan(tmp_path, motion):
    path = tmp_path / "report.json"
    more = {"warnings": ["cropped"], "offset": float("nan")}
    written = write_figures(summarise(motion) | more, path)
    report = json.loads(path.read_text(encoding="utf-8"), parse_constant=pytest.fail)
    assert path.read_text(encoding="utf-8") == written + "\n"
    assert report["frames"] == SAMPLES and report["start_s"] == START
    assert report["milliseconds"]["solve"] == {"count": 101, "mean": 50, "median": 50, "p99": 99}
    assert report["costs_px"]["left"] == {"count": 14, "mean": 2, "median": 2, "p95": 2}
    assert report["marker_errors_m"]["L Wrist:1"]["count"] == SAMPLES - 4
    knee = report["landmarks"]["knee_l"]
    assert knee["deviation_m"]["median"] == pytest.approx(0.02 * 3**0.5)
    assert 0 <= knee["from_prior_share"] <= 1
    assert report["elbow_deviations_m"]["right"]["mean"] == pytest.approx(0.2 * 3**0.5)
    times = motion.times
    assert report["statuses"]["marker LWrist is missing"] == {
        "count": 5,
        "spans_s": [[times[5], times[8]], [times[20], times[20]]],
    }
    assert report["statuses"]["planted again"]["count"] == 1
    tracker = {"refine": "none", "weights": [1.0, 1.0], "limit": None}
    assert report["settings"]["tracker"] == tracker
    assert report["warnings"] == ["cropped"] and report["offset"] is None
    assert {"jaxmocap", "jax", "numpy", "opencv", "python"} == set(report["versions"])
    assert all(report["versions"].values()) and report["backend"]["platform"]


def test_a_report_without_any_sample_seen_has_nulls_and_counts_of_zero(motion):
    blind = replace(
        motion.report,
        landmarks_std=np.full_like(motion.report.landmarks_std, np.nan),
        statuses=((),) * SAMPLES,
    )
    report = json.loads(write_figures(summarise(replace(motion, report=blind))))
    nothing = {"count": 0, "mean": None, "median": None, "p95": None}
    assert report["elbow_deviations_m"]["left"] == nothing
    assert report["statuses"] == {}


# A full disk --------------------------------------------------------------------------------------

# From here on nothing more can be written to a file than so many bytes.
FULL = """
import resource, sys
sys.path[:0] = {tests!r}
import test_outputs
from jaxmocap.formats.files.errors import OutputError
from jaxmocap.outputs.viewer import write_rerun
from jaxmocap.outputs.overlay import write_overlay
motion, camera = test_outputs.make_motion(), test_outputs.make_camera()
rng = test_outputs.np.random.default_rng(0)
frames = [
    (time, rng.integers(0, 255, (240, 320, 3), "uint8"))
    for time, _ in test_outputs.make_frames(30)
]
name = sys.argv[1]


def write():
    if name.endswith(".rrd"):
        write_rerun(name, motion, {{"cam": test_outputs.Footage(camera, frames)}})
    else:
        write_overlay(name, frames, camera, motion)


write()
with open(name, "rb") as file:
    intact = file.read()
for share in (0.0, 0.1, 0.99):
    most = int(share * len(intact))
    resource.setrlimit(resource.RLIMIT_FSIZE, (most, resource.RLIM_INFINITY))
    try:
        write()
    except OutputError as error:
        print(error)
    with open(name, "rb") as file:
        assert file.read() == intact
"""


@pytest.mark.parametrize("name", ["recording.rrd", "overlay.mp4"])
def test_a_full_disk_is_an_error_and_leaves_the_earlier_file(tmp_path, name):
    """The viewer's library says nothing of it, and leaves half a file."""
    pytest.importorskip("resource", reason="this system has no limits of file sizes")
    code, path = FULL.format(tests=sys.path), tmp_path / name
    command = [sys.executable, "-c", code, str(path)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    says = f"{path}: cannot be written (File too large)"
    assert done.stdout.splitlines() == [says] * 3 and done.stderr == ""
    assert [file.name for file in tmp_path.iterdir()] == [name]
