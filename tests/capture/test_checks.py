"""Load checks: sound recordings pass, and every way of spoiling one is found and named."""

import json
import re
import tracemalloc
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import on_device
from gait_person import BODY_MARKERS
from small_recording import small_recording, write_small_recording

from jaxmocap.body.kinematics import forward, landmark_sites, landmarks, site_positions
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import LANDMARKS, Skeleton
from jaxmocap.body.subject import skeleton_stature
from jaxmocap.capture.checks.body_reach import max_marker_distances, standing_points
from jaxmocap.capture.checks.cameras import check_recording
from jaxmocap.capture.checks.lengths import (
    check_lengths,
    check_proportions,
    check_stretched_arms,
)
from jaxmocap.capture.checks.markers import check_markers
from jaxmocap.capture.checks.sides import check_sides
from jaxmocap.capture.filters import filter_markers
from jaxmocap.capture.footage import open_footage
from jaxmocap.capture.photographs import write_picture
from jaxmocap.cli.program import main
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.recordings.filters import Filters
from jaxmocap.formats.recordings.recording import MarkerPlace, Recording, VideoSource
from jaxmocap.formats.recordings.subject import read_subject
from jaxmocap.formats.time_series.markers import read_markers
from jaxmocap.formats.time_series.trc import write_trc
from jaxmocap.geometry.cameras import Camera, project, visible_pixels
from jaxmocap.synthetic.movements import motions
from jaxmocap.synthetic.people.clothed_person import MARKERS
from jaxmocap.synthetic.recording import marker_noise
from jaxmocap.synthetic.renderer import camera_at

PLACES = tuple(MarkerPlace(name, *on) for name, on in MARKERS.items())
FIVE = tuple(MarkerPlace(name, bone) for name, bone in BODY_MARKERS.items())
SECONDS, RATE = 5.0, 30
VIDEO_TIMES = [np.arange(SECONDS * 30) / 30]


def performed(performance: motions.Performance, azimuth: float = 30.0, five=False) -> Recording:
    """A synthetic recording without pictures, with a headset's noise."""
    times = np.arange(SECONDS * RATE) / RATE
    bones, figure = performance.bones(times), performance.figure
    if five:
        landmarks = figure.landmarks(bones)
        points = np.stack([landmarks[name] for name in BODY_MARKERS], 1)
    else:
        points = np.stack([figure.points(bones, *on) for on in MARKERS.values()], 1)
    points = points + marker_noise(times, points.shape[1], np.random.default_rng(0))
    video = VideoSource("webcam", camera_at(azimuth))
    places = FIVE if five else PLACES
    return Recording(Skeleton.human(1.75), times, points, places, (video,), "performed")


@pytest.fixture(scope="module")
def sound() -> Recording:
    """Table tennis with head and hands."""
    return performed(motions.table_tennis(SECONDS, 3))


@pytest.fixture(scope="module")
def five() -> Recording:
    """Table tennis with ankles too."""
    return performed(motions.table_tennis(SECONDS, 3), five=True)


def names(recording: Recording, video_times=VIDEO_TIMES) -> list[tuple[str, bool]]:
    actual = check_recording(recording, video_times[: len(recording.videos)])
    return [(finding.check, finding.fatal) for finding in actual]


def projected_in(recording: Recording, camera: Camera) -> Recording:
    return replace(recording, videos=(VideoSource("webcam", camera),))


def moved(camera: Camera, T_world: np.ndarray) -> Camera:
    """The camera as a calibration by other axes of the world has it."""
    T = jnp.asarray(np.asarray(camera.T_cam_world) @ T_world, camera.T_cam_world.dtype)
    return replace(camera, T_cam_world=T)


# No false alarm ----------------------------------------------------------------------------------


@pytest.mark.parametrize("azimuth", [-60.0, 0.0, 60.0])
@pytest.mark.parametrize("five", [False, True])
@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("kind", ["table_tennis", "squat", "reaching", "across", "thrust"])
def test_every_synthetic_movement_passes(kind, seed, azimuth, five):
    assert names(performed(getattr(motions, kind)(SECONDS, seed), azimuth, five)) == []


@pytest.mark.parametrize("which", ["all_cameras", "cam_01", "cam_02", "cam_03", "cam_04"])
def test_the_real_recording_passes(recordings, which):
    recording = Recording.load(recordings / "balancing" / f"recording_{which}.toml")
    assert names(recording, [recording.times] * 4) == []


def test_a_recorded_tennis_serve_passes(recordings):
    markers = read_markers(recordings / "motions" / "tennis_serve.c3d")
    on = {"LFHD": "head", "LWRA": "radius_l", "RWRA": "radius_r", "LANK": "tibia_l"}
    columns = [markers.names.index(name) for name in on]
    places = tuple(MarkerPlace(*pair) for pair in on.items())
    recording = Recording(Skeleton.human(1.8), markers.times, markers.positions[:, columns], places)
    assert names(recording) == []


# Spoilt ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("factor", "unit"),
    [(1000, "like millimetres"), (100, "like centimetres"), (0.001, "metres, not millimetres")],
)
def test_markers_in_another_unit_are_refused(sound, factor, unit):
    spoilt = replace(sound, positions_world=sound.positions_world * factor)
    (finding,) = check_recording(spoilt, VIDEO_TIMES)
    assert finding.check == "unit" and finding.fatal and unit in finding.sentence
    assert "[markers] file" in finding.sentence and "which must be metres" in finding.sentence
    trc = replace(spoilt, markers_file=Path("m.trc"))
    assert "change Units in its third line" in check_recording(trc, VIDEO_TIMES)[0].sentence
    if factor == 1000:
        text = float(finding.sentence.split("person of ")[1].split(" m")[0])
        assert 1200 < text < 2000


def test_noise_of_a_metre_is_no_unit(sound):
    noise = np.random.default_rng(0).normal(0, 1.0, sound.positions_world.shape)
    spoilt = replace(sound, positions_world=sound.positions_world + 2 * noise)
    (finding,) = check_recording(spoilt, VIDEO_TIMES)
    assert finding.fatal and "no unit explains that" in finding.sentence


def test_a_body_or_a_calibration_in_millimetres_is_refused(sound):
    giant = replace(sound.skeleton, lengths=sound.skeleton.lengths * 1000)
    finding = check_recording(replace(sound, skeleton=giant), VIDEO_TIMES)[0]
    assert finding.fatal and "[subject]: the person is 17" in finding.sentence
    camera = sound.videos[0].camera
    T = camera.T_cam_world.at[:3, 3].multiply(1000)
    (finding,) = check_recording(projected_in(sound, replace(camera, T_cam_world=T)), VIDEO_TIMES)
    assert finding.fatal and "translation must be in metres" in finding.sentence


@pytest.mark.parametrize("marked", ["sound", "five"])
@pytest.mark.parametrize(
    ("axes", "message"),
    [([2, 0, 1], "world's x"), ([1, 2, 0], "world's y"), ([0, 2, 1], "world's y")],
)
def test_another_axis_upwards_is_refused(request, marked, axes, message):
    recording = request.getfixturevalue(marked)
    spoilt = replace(recording, positions_world=recording.positions_world[..., axes])
    finding = check_recording(spoilt, VIDEO_TIMES)[0]
    assert finding.check == "up axis" and finding.fatal
    assert message in finding.sentence and "change [markers] up" in finding.sentence


@pytest.mark.parametrize("marked", ["sound", "five"])
@pytest.mark.parametrize("height", [1.0, 1.8, 3.0])
@pytest.mark.parametrize("axes", [[1, -1, -1], [-1, 1, -1], [1, 1, -1]], ids=str)
def test_a_person_upside_down_above_the_floor_is_refused(request, marked, height, axes):
    recording = request.getfixturevalue(marked)
    spoilt = replace(recording, positions_world=recording.positions_world * axes + [0, 0, height])
    finding = next(f for f in check_recording(spoilt, VIDEO_TIMES) if f.check == "up axis")
    # Of headset and controllers alone it may be hands that are held up.
    assert finding.fatal == (marked == "five")
    assert "[markers] up: the person is upside down" in finding.sentence
    assert "to_world" in finding.sentence


def test_a_handstand_for_part_of_a_recording_passes(five):
    handstand = [[0, 0, 0.4], [0, -0.3, 0.05], [0, 0.3, 0.05], [0, -0.1, 1.9], [0, 0.1, 1.9]]
    positions = five.positions_world.copy()
    positions[: int(0.4 * len(positions))] = handstand
    assert names(replace(five, positions_world=positions, videos=())) == []


@pytest.mark.parametrize("raised", ["above the head", "up, lying on the back"])
def test_hands_held_up_all_the_time_pass(sound, raised):
    places = {
        "above the head": [[0, 0, 1.7], [0, 0.2, 2.1], [0, -0.2, 2.1]],
        "up, lying on the back": [[0, 0, 0.1], [-0.3, 0.2, 0.68], [-0.3, -0.2, 0.68]],
    }
    positions = np.tile(np.array(places[raised]), (len(sound.times), 1, 1))
    actual = check_recording(replace(sound, positions_world=positions, videos=()), [])
    assert not any(finding.fatal for finding in actual)


@pytest.mark.parametrize("value", [1e200, -1e308, 2e7, np.inf])
@pytest.mark.parametrize("samples", [slice(None), slice(20, 21)], ids=["always", "once"])
def test_a_place_on_no_map_is_refused(sound, value, samples):
    positions = sound.positions_world.copy()
    positions[samples, 1, 0] = value
    (finding,) = check_recording(replace(sound, positions_world=positions), VIDEO_TIMES)
    assert finding.fatal and "LeftController is at (" in finding.sentence
    assert "expected a place within 1e+07 m" in finding.sentence


def exchanged(recording: Recording, *pairs: tuple[int, int]) -> Recording:
    order = list(range(len(recording.places)))
    for left, right in pairs:
        order[left], order[right] = right, left
    return replace(recording, positions_world=recording.positions_world[:, order])


def test_left_and_right_exchanged_is_a_warning(sound, five):
    (finding,) = check_recording(exchanged(sound, (1, 2)), VIDEO_TIMES)
    assert finding.check == "left and right" and not finding.fatal
    assert "[markers.on] LeftController and RightController" in finding.sentence
    assert "left-handed" in finding.sentence
    (finding,) = check_recording(exchanged(five, (1, 2)), VIDEO_TIMES)
    assert "wrist_l and wrist_r" in finding.sentence and "ankle" not in finding.sentence
    assert "left-handed" not in finding.sentence, "the ankles are not"
    (finding,) = check_recording(exchanged(five, (1, 2), (3, 4)), VIDEO_TIMES)
    assert "ankle_l and ankle_r" in finding.sentence and "left-handed" in finding.sentence


OTHER_SIDES = (
    ("ankle_{}", "ankle_{}"),
    ("RAnkle", "LAnkle"),
    ("Right.Foot", "Left.Foot"),
    ("FOOT-R", "FOOT-L"),
    ("Shoe 1", "Shoe 2"),
)


@pytest.mark.parametrize("names", OTHER_SIDES)
def test_names_of_the_other_side_are_a_warning(five, names):
    """What ankles alone do shows no side; their names do."""
    right, left = names[0].format("r"), names[1].format("l")
    on_left, on_right = five.places[3], five.places[4]
    assert (on_left.bone, on_right.bone) == ("tibia_l", "tibia_r")
    for first, second, is_wrong in ((right, left, "Shoe" not in right), (left, right, False)):
        ankles = replace(on_left, name=first), replace(on_right, name=second)
        found = [
            each.sentence for each in check_sides(replace(five, places=(*five.places[:3], *ankles)))
        ]
        assert bool(found) == is_wrong
        if found:
            assert f"{right} on tibia_l and {left} on tibia_r: by their names" in found[0]


@pytest.fixture(scope="module")
def walkers(recordings) -> list[Recording]:
    """Real people who walk to and fro; their hands swing beside them."""
    files = sorted((recordings / "people").glob("person_*/recording_*_height.toml"))
    return [Recording.load(file) for file in files]


def checks_of(recording: Recording) -> set[str]:
    return {finding.check for finding in check_markers(recording)}


def test_walking_shows_which_side_is_left(walkers):
    for walker in walkers:
        assert not checks_of(walker)
        assert checks_of(exchanged(walker, (1, 2))) == {"left and right"}
        mirrored = replace(walker, positions_world=walker.positions_world * [1, -1, 1])
        assert checks_of(mirrored) == {"left and right"}
    (finding,) = check_markers(exchanged(walkers[0], (1, 2)))
    assert "of the way is walked backwards; left and right are exchanged" in finding.sentence


def test_one_sample_shows_no_walk(walkers):
    alone = replace(
        walkers[0], times=walkers[0].times[:1], positions_world=walkers[0].positions_world[:1]
    )
    assert not checks_of(alone)


@pytest.mark.parametrize("pair", [(0, 1), (0, 2)])
def test_a_head_stated_as_a_hand_is_a_warning(walkers, recordings, sound, pair):
    lab = Recording.load(recordings / "balancing" / "recording_cam_01.toml")
    for recording in (*walkers, lab, sound):
        assert checks_of(exchanged(recording, pair)) & {"exchanged", "reach"}
    findings = {finding.check: finding for finding in check_markers(exchanged(sound, pair))}
    finding = findings["exchanged"]
    names = [sound.marker_names[i] for i in pair]
    assert finding.sentence.startswith(
        f"[markers.on] {names[0]} and {names[1]}: {names[1]} is above"
    )
    assert not finding.fatal


def test_a_mirror_image_that_leaves_the_picture_is_recognised(sound):
    away = np.array([0.0, 3.0, 0.0])
    there = replace(sound, positions_world=sound.positions_world + away)
    T_away = np.eye(4)
    T_away[:3, 3] = -away
    there = projected_in(there, moved(sound.videos[0].camera, T_away))
    assert names(there) == []
    spoilt = replace(there, positions_world=there.positions_world * [1, -1, 1])
    actual = {finding.check: finding for finding in check_recording(spoilt, VIDEO_TIMES)}
    assert set(actual) == {"handedness", "left and right"}
    assert "x, -y, z in place of x, y, z (a mirror image, left-handed)" in (
        actual["handedness"].sentence
    )
    assert actual["handedness"].fatal, "no camera sees anything of the person"


@pytest.mark.parametrize(("share", "fatal"), [(0.02, False), (0.6, True)])
def test_a_marker_out_of_reach_is_told(sound, share, fatal):
    spoilt = sound.positions_world.copy()
    rows = np.arange(len(spoilt)) < share * len(spoilt)
    spoilt[rows, 2] += [0, 1.0, 3.0]
    actual = {
        f.check: f for f in check_recording(replace(sound, positions_world=spoilt), VIDEO_TIMES)
    }
    assert actual["reach"].fatal is fatal
    text = f"in {rows.sum()} of {len(rows)} samples farther than"
    assert "[markers.on] RightController" in actual["reach"].sentence
    assert text in actual["reach"].sentence


def test_a_head_that_jumps_is_told_with_the_filter_that_takes_it_out(sound):
    """Every fiftieth sample has it 90 m away."""
    spoilt = sound.positions_world.copy()
    spoilt[24::50, 0, 1] += 90.0
    jumping = replace(sound, positions_world=spoilt)
    (found,) = check_recording(jumping, VIDEO_TIMES)
    assert found.check == "reach" and not found.fatal
    assert found.sentence.startswith("[markers.on] Headset: up to ")
    assert found.sentence.endswith("; [markers.filters] hampel takes such outliers out")
    filtered, _ = filter_markers(replace(jumping, filters=Filters(hampel=True)))
    assert not check_recording(filtered, VIDEO_TIMES)


def with_arms(stretch: float, spread: float = 1.0) -> Recording:
    """The small recording with both arms to the sides, so many times as long, or less apart."""
    recording = small_recording()
    reach = max_marker_distances(recording.skeleton, recording.places)[1, 2]
    positions = recording.positions_world.copy()
    for row, side in ((1, 1.0), (2, -1.0)):
        positions[:, row] = 0.0, side * stretch * spread * reach / 2, 1.43
    return replace(recording, positions_world=positions, path=Path("clip.toml"))


@pytest.mark.parametrize("stretch", [1.08, 1.0])
def test_hands_farther_apart_than_the_arms_say_which_bones_are_too_short(stretch):
    found = [f for f in check_markers(with_arms(stretch)) if f.check == "lengths"]
    if stretch == 1.0:
        assert not found
        return
    (finding,) = found
    assert "LWrist and RWrist are up to" in finding.sentence and not finding.fatal
    assert "clavicle, humerus, radius are too short by 8 %" in finding.sentence


@pytest.mark.parametrize(("factor", "word"), [(0.85, "short by 18 %"), (1.15, "long by 13 %")])
def test_a_bone_between_two_markers_is_compared_with_their_distance(factor, word):
    sound = small_recording()
    tree, lengths = sound.skeleton.tree, sound.skeleton.lengths
    places = (*sound.places, MarkerPlace("LElbow", "humerus_l"))
    forearm = float(lengths[tree.bone("radius_l")])
    elbow = sound.positions_world[:, 1:2] + [0.0, 0.0, forearm]
    full = replace(
        sound, places=places, positions_world=np.concatenate([sound.positions_world, elbow], 1)
    )
    assert not check_markers(full)
    other = replace(sound.skeleton, lengths=lengths.at[tree.bone("radius_l")].set(forearm * factor))
    (finding,) = check_markers(replace(full, skeleton=other))
    assert f"radius_l is too {word}" in finding.sentence


def test_stretched_arms_name_the_command_that_measures_them():
    measured = ("humerus_l", "radius_l")
    (finding,) = check_stretched_arms(with_arms(0.98), ())
    assert "`jaxmocap scale --recording clip.toml" in finding.sentence
    assert not list(check_stretched_arms(with_arms(0.98), measured))
    assert not list(check_stretched_arms(with_arms(0.98, 0.8), ()))
    assert not list(check_stretched_arms(replace(with_arms(0.98), videos=()), ()))


def test_the_command_that_measures_arms_writes_to_no_body_that_is_read(tmp_path, refusal):
    """A recording's body is mostly called subject.toml, as in the pages."""
    path, person = write_small_recording(tmp_path), tmp_path / "subject.toml"
    path.write_text(path.read_text().replace("height = 1.75", 'file = "subject.toml"'))
    assert main(["scale", "--height", "1.75", "--out", str(person)]) == 0
    (finding,) = check_stretched_arms(with_arms(0.98), ())
    (name,) = re.findall(r"--out (\S+)`", finding.sentence)
    refused = refusal("scale", "--recording", path, "--out", tmp_path / name)
    assert "s of markers are too few" in refused


@pytest.mark.parametrize("factor", [1000.0, RATE])
def test_times_that_are_not_seconds_are_refused(sound, factor):
    spoilt = replace(sound, times=sound.times * factor, videos=())
    (finding,) = check_recording(spoilt, [])
    assert finding.check == "rate" and finding.fatal
    assert "the column of times must be seconds" in finding.sentence


def test_a_stated_rate_that_its_time_stamps_contradict_is_a_warning(tmp_path, sound):
    path = tmp_path / "m.trc"
    points = dict(zip(MARKERS, np.moveaxis(sound.positions_world, 1, 0), strict=True))
    write_trc(path, sound.times, points, rate=60.0)
    spoilt = replace(sound, stated_rate=read_markers(path).rate)
    (finding,) = check_recording(spoilt, VIDEO_TIMES)
    assert not finding.fatal
    assert "states 60 samples per second (DataRate), its time stamps state 30" in finding.sentence
    write_trc(path, sound.times, points)
    assert names(replace(sound, stated_rate=read_markers(path).rate)) == []


def test_a_video_at_the_wrong_frame_rate_covers_too_little(sound):
    (finding,) = check_recording(sound, [VIDEO_TIMES[0] / 4])
    assert not finding.fatal and "lasts during 25 % of the marker samples" in finding.sentence


@pytest.mark.parametrize("height", [-0.75, 0.5])
def test_a_floor_elsewhere_than_feet_without_markers_stand_is_a_warning(sound, five, height):
    """Legs and pelvis would be half a metre off without a word."""

    def lifted(recording: Recording) -> Recording:
        positions_world = recording.positions_world + np.array([0.0, 0.0, height])
        return replace(recording, positions_world=positions_world, videos=())

    (finding,) = check_recording(lifted(sound), [])
    assert finding.check == "floor" and not finding.fatal
    stated = float(re.search(r"state floor = (\S+) in \[ik\]", finding.sentence)[1])
    assert stated == pytest.approx(height, abs=0.15)
    assert "stand on z = 0 m" in finding.sentence
    # Markers on the feet tell.
    assert names(lifted(five)) == []


def test_a_camera_below_the_floor_is_a_warning(sound):
    camera = sound.videos[0].camera
    below = np.diag([1.0, 1.0, 1.0, 1.0])
    below[2, 3] = 1.7
    actual = check_recording(projected_in(sound, moved(camera, below)), VIDEO_TIMES)
    (finding,) = [finding for finding in actual if finding.check == "camera below the floor"]
    assert not finding.fatal and "stands at z = -0.40 m" in finding.sentence


def test_an_inverted_calibration_shows_nobody_and_is_refused(sound):
    camera = sound.videos[0].camera
    T = jnp.asarray(np.linalg.inv(np.asarray(camera.T_cam_world)), camera.T_cam_world.dtype)
    actual = check_recording(projected_in(sound, replace(camera, T_cam_world=T)), VIDEO_TIMES)
    assert (actual[0].check, actual[0].fatal) == ("person out of the image", True)
    assert "[webcam] of the calibration" in actual[0].sentence


def test_a_person_out_of_one_of_two_images_is_a_warning(sound):
    camera = sound.videos[0].camera
    turn = np.diag([-1.0, -1.0, 1.0, 1.0])
    turn[0, 3] = 8.0
    other = VideoSource("other", moved(camera, turn))
    both = replace(sound, videos=(sound.videos[0], other))
    actual = check_recording(both, [*VIDEO_TIMES, *VIDEO_TIMES])
    assert [(f.check, f.fatal) for f in actual] == [("person out of the image", False)]
    assert "[other] of the calibration" in actual[0].sentence


def test_missing_markers_are_no_mistake(sound):
    spoilt = sound.positions_world.copy()
    spoilt[::2, 0] = np.nan
    spoilt[5:40] = np.nan
    spoilt[:, 1] = np.nan
    assert names(replace(sound, positions_world=spoilt)) == []


# What the checks stand on ------------------------------------------------------------------------


def test_the_standing_body_is_the_one_of_the_kinematics():
    skeleton = Skeleton.human(1.75)
    landmarks = ("vertex", "wrist_l", "wrist_r", "ankle_l", "ankle_r")
    pose = Pose(jnp.zeros(3), jnp.array([1.0, 0, 0, 0]), jnp.zeros(len(skeleton.tree.joints)))
    expected = site_positions(
        skeleton, forward(skeleton, pose), landmark_sites(skeleton, landmarks)
    )
    points = standing_points(skeleton, FIVE)
    np.testing.assert_allclose(np.ptp(points - np.asarray(expected), axis=0), 0, atol=1e-6)
    assert skeleton_stature(skeleton) == pytest.approx(1.75, abs=0.06)
    assert points[0, 2] == pytest.approx(skeleton_stature(skeleton))


def test_reach_is_the_length_of_the_stretched_body():
    skeleton = Skeleton.human(1.75)
    length = dict(zip(skeleton.tree.bones, np.asarray(skeleton.lengths, float), strict=True))
    places = (
        MarkerPlace("a", "humerus_l", 0.5),
        MarkerPlace("b", "hand_l", 0.25, (0.0, 0.03, 0.04)),
        MarkerPlace("c", "humerus_l", 0.9),
        MarkerPlace("d", "femur_r", 0.5),
    )
    actual = max_marker_distances(skeleton, places)
    arm = length["humerus_l"] / 2 + length["radius_l"] + length["hand_l"] / 4 + 0.05
    assert actual[0, 1] == actual[1, 0] == pytest.approx(arm)
    assert actual[0, 2] == pytest.approx(0.4 * length["humerus_l"])
    trunk = sum(length[f"spine{i}"] for i in (1, 2, 3)) + length["clavicle_l"]
    leg = length["hip_r"] + length["femur_r"] / 2
    assert actual[0, 3] == pytest.approx(trunk + length["humerus_l"] / 2 + leg)


@pytest.mark.parametrize("wrists", [{"wrist_l": "wrist_r", "wrist_r": "wrist_l"}, {}])
def test_a_limb_between_other_landmarks_is_a_warning(tmp_path, sound, wrists):
    """Exchanged wrists of a person whose arms hang; both tables of proportions are usual."""
    pose = Pose(np.zeros(3), np.eye(4)[0], np.zeros(21))
    points = np.asarray(jax.jit(landmarks)(sound.skeleton, on_device(pose)))
    at = dict(zip(LANDMARKS, points, strict=True))
    used = {name: wrists.get(name, name) for name in LANDMARKS if name not in ("pelvis", "head")}
    write_trc(tmp_path / "static.trc", np.zeros(1), {name: at[name][None] for name in used})
    stated = {"static": "static.trc", "landmarks": used}
    skeleton = read_subject(tmp_path / "a.toml", "[subject]", stated)
    found = [each.sentence for each in check_markers(replace(sound, skeleton=skeleton))]
    assert [s[:26] for s in found if "exchanged?" in s] == (
        ["[subject]: radius_l is 0.4", "[subject]: radius_r is 0.4"] if wrists else []
    )
    for proportions in ("winter", "joint_centres"):
        body = Skeleton.human(1.6, proportions=proportions)
        assert not list(check_proportions(replace(sound, skeleton=body)))


def test_lengths_of_a_long_recording_take_no_more_memory_than_those_of_a_short_one():
    """Distances of all pairs of markers would be 5 GB of half an hour's."""
    skeleton, peaks = Skeleton.human(1.75), []
    places = tuple(MarkerPlace(bone, bone, 0.5, (0.0, 0.0, 0.01)) for bone in skeleton.tree.bones)
    standing = standing_points(skeleton, places)
    for count in (20_000, 60_000):
        positions = np.tile(standing, (count, 1, 1))
        positions[:, 0] += [0.0, 0.0, 1.0]
        long = Recording(skeleton, np.arange(count) / 200, positions, places, (), fit=False)
        tracemalloc.start()
        assert any("spine1" in finding.sentence for finding in check_lengths(long))
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.1 * peaks[0]


def test_pixels_are_those_of_the_camera_model(sound):
    camera, points = sound.videos[0].camera, sound.positions_world[::10].reshape(-1, 3)
    expected = np.asarray(jax.jit(project)(camera, jnp.asarray(points, jnp.float32)))
    np.testing.assert_allclose(visible_pixels(camera, points), expected, atol=0.01)
    behind = np.asarray(camera.position_world)[None] * 2
    assert np.isnan(visible_pixels(camera, behind)).all()


# The commands ------------------------------------------------------------------------------------


def test_check_tells_what_it_looked_at(tmp_path, capsys):
    path = write_small_recording(tmp_path)
    assert main(["check", str(path), "--json", str(tmp_path / "c.json")]) == 0
    printed = capsys.readouterr().out
    assert "nothing wrong was found" in printed and "24 samples at 60 Hz" in printed
    figures = json.loads((tmp_path / "c.json").read_text())
    assert figures["findings"] == [] and figures["cameras"][0]["shown_share"] == 1.0


def test_check_says_where_no_marker_is_measured_while_a_camera_films(tmp_path, capsys):
    path, recording = write_small_recording(tmp_path), small_recording()
    # A second more, during which there are markers and no video.
    times = np.concatenate([recording.times, recording.times[-1] + np.arange(1, 61) / 60])
    missing = np.full_like(recording.positions_world, np.nan)
    points = np.concatenate([missing, recording.positions_world[np.arange(60) % 24]])
    columns = zip(recording.marker_names, np.moveaxis(points, 1, 0), strict=True)
    write_trc(tmp_path / "markers.trc", times, dict(columns))
    assert main(["check", str(path), "--json", str(tmp_path / "c.json")]) == 0
    assert "of which none is measured while it films" in capsys.readouterr().out
    figures = json.loads((tmp_path / "c.json").read_text())
    assert figures["cameras"][0]["shown_share"] is None


def test_check_does_not_find_nothing_wrong_below_a_warning(tmp_path, capsys):
    path = write_small_recording(tmp_path)
    path.write_text(path.read_text().partition("[subject]")[0])
    assert main(["check", str(path)]) == 0
    printed = capsys.readouterr().out
    assert "\nwarning  " in printed and "nothing wrong" not in printed


@pytest.mark.parametrize(
    ("field", "says"),
    [
        ('background = "markers.trc"', "markers.trc: is not an image"),
        ('background = "small.png"', "small.png: found 2 × 2 pixels"),
        ('keypoints = "empty"', "empty"),
    ],
)
def test_check_refuses_what_the_commands_refuse(tmp_path, refusal, field, says):
    path = write_small_recording(tmp_path)
    (tmp_path / "empty").mkdir()
    write_picture(tmp_path / "small.png", np.zeros((2, 2, 3), np.uint8))
    path.write_text(path.read_text().replace('camera = "cam"', f'camera = "cam"\n{field}'))
    assert says in refusal("check", path)


def test_check_counts_the_frames_that_cannot_be_decoded(tmp_path, capsys):
    path = write_small_recording(tmp_path)
    video = (tmp_path / "cam.mp4").read_bytes()
    start, end = video.index(b"mdat") + 4, video.index(b"moov") - 4
    kept = (start + end) // 2
    (tmp_path / "cam.mp4").write_bytes(video[:kept] + bytes(end - kept) + video[end:])
    assert main(["check", str(path)]) == 0
    assert "frames cannot be decoded, they are missing" in capsys.readouterr().out


def test_check_and_track_refuse_what_is_in_millimetres(tmp_path, capsys, refusal):
    path = write_small_recording(tmp_path)
    markers = tmp_path / "markers.trc"
    recording = small_recording()
    points = np.moveaxis(1000 * recording.positions_world, 1, 0)
    write_trc(markers, recording.times, dict(zip(recording.marker_names, points, strict=True)))
    assert main(["check", str(path)]) == 2
    printed = capsys.readouterr()
    # The error is the last line, and is not printed twice.
    assert "[markers] file" not in printed.out
    assert printed.err.startswith(f"jaxmocap check: {path}: [markers] file: the markers span")
    message = refusal("track", path, "--out", tmp_path / "out")
    assert "change Units in its third line" in message
    assert not (tmp_path / "out").exists()


def test_a_warning_reaches_whoever_opens_the_recording():
    recording = replace(small_recording(), stated_rate=30.0)
    _, (warning,) = open_footage(recording)
    assert warning.startswith("small: [markers] file: its header states 30 samples per second")
    with pytest.raises(InputError, match="the column of times must be seconds"):
        open_footage(replace(recording, times=recording.times * 1000, videos=()))
