"""Scaling to a person: by height after Winter, by the landmarks of a static trial."""

import jax
import numpy as np
import pytest
from conftest import double, on_device

from jaxmocap.body.kinematics import landmarks as landmarks_of
from jaxmocap.body.model_files import proportions_of
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import JOINT_CENTRES, LANDMARKS, Skeleton, scale_to_height
from jaxmocap.body.subject import scale_to_landmarks, skeleton_stature
from jaxmocap.formats.time_series.trc import read_trc

LANDMARKS_OF = jax.jit(landmarks_of)
# Landmark -> marker of the static trial in shared/recordings/balancing.
STATIC_MARKERS = {"neck": "Neck", "vertex": "Head"} | {
    f"{landmark}_{side}": f"{side.upper()}{marker}"
    for landmark, marker in {
        "shoulder": "Shoulder",
        "elbow": "Elbow",
        "wrist": "Wrist",
        "hip": "Hip",
        "knee": "Knee",
        "ankle": "Ankle",
        "toe": "BigToe",
    }.items()
    for side in "lr"
}


def length(skeleton, *bones):
    return sum(float(skeleton.lengths[skeleton.tree.bone(bone)]) for bone in bones)


def mass(skeleton, *bones):
    return sum(float(skeleton.masses[skeleton.tree.bone(bone)]) for bone in bones)


def standing(skeleton):
    """Landmark -> (3,) of the body upright, arms hanging, hips at a height of 0.53 of 1.8 m."""
    pose = Pose(np.array([0, 0, 0.954]), np.eye(4)[0], np.zeros(21))
    points = LANDMARKS_OF(skeleton, on_device(pose))
    return dict(zip(LANDMARKS, np.asarray(points), strict=True))


@pytest.mark.parametrize("height", [1.5, 1.8, 2.0])
def test_winters_segments_by_his_name(height):
    person = Skeleton.human(height, proportions="winter")
    winter = {"humerus": 0.186, "radius": 0.146, "hand": 0.108, "femur": 0.245, "tibia": 0.246}
    for bone, fraction in winter.items():
        for side in "lr":
            assert length(person, f"{bone}_{side}") == pytest.approx(fraction * height, rel=1e-5)
    trunk = length(person, "spine1", "spine2", "spine3")
    assert trunk == pytest.approx((0.870 - 0.530) * height, rel=1e-5)
    assert length(person, "neck", "head") == pytest.approx((1 - 0.870) * height, rel=1e-5)


def test_a_person_of_1_80_m_stands_1_80_m_tall():
    points = standing(Skeleton.human(1.8, proportions="winter"))
    assert points["vertex"][2] == pytest.approx(1.8, abs=1e-5)
    # Winter's Fig. 4.1: shoulders at 0.818 of the height and 0.259 apart, hips 0.191 apart,
    # ankles at 0.039.
    assert points["shoulder_l"][2] == pytest.approx(0.818 * 1.8, abs=1e-5)
    assert (points["shoulder_l"] - points["shoulder_r"])[1] == pytest.approx(0.258 * 1.8, abs=2e-3)
    assert (points["hip_l"] - points["hip_r"])[1] == pytest.approx(0.191 * 1.8, abs=1e-5)
    assert points["ankle_r"][2] == pytest.approx(0.039 * 1.8, abs=1e-5)


def test_joints_of_a_stature_are_where_peoples_are():
    points = standing(Skeleton.human(1.8))
    # Hips at 0.512 of the height.
    up = points["vertex"][2] - 0.954 + 0.512 * 1.8
    assert up == pytest.approx(1.8, abs=1e-5)
    assert points["ankle_l"][2] - 0.954 + 0.512 * 1.8 == pytest.approx(0.041 * 1.8, abs=1e-5)
    apart = {joint: points[f"{joint}_l"] - points[f"{joint}_r"] for joint in ("shoulder", "hip")}
    np.testing.assert_allclose(apart["shoulder"], [0, 0.200 * 1.8, 0], atol=1e-5)
    np.testing.assert_allclose(apart["hip"], [0, 0.100 * 1.8, 0], atol=1e-5)
    drop = points["neck"] - points["shoulder_l"]
    np.testing.assert_allclose(drop, 1.8 * np.array([0.010, -0.100, 0.028]), atol=1e-5)


@pytest.mark.parametrize(
    ("part", "ends"),
    {
        "upper_arm": ("Shoulder", "Elbow"),
        "forearm": ("Elbow", "Wrist"),
        "thigh": ("Hip", "Knee"),
        "shank": ("Knee", "Ankle"),
        "hip": ("LHip", "RHip"),
    }.items(),
)
def test_real_people_differ_from_their_statures_lengths_by_what_is_stated(recordings, part, ends):
    """Six people by Plug-in Gait's joint centres, both sides."""
    table, off = proportions_of(JOINT_CENTRES), []
    for folder in sorted((recordings / "people").glob("person_*")):
        points = read_trc(folder / "static.trc").points()
        height = points["Crown"][:, 2]
        pairs = [ends] if part == "hip" else [(side + ends[0], side + ends[1]) for side in "LR"]
        for near, far in pairs:
            long = np.linalg.norm(points[near] - points[far], axis=-1) / height
            long = long / 2 if part == "hip" else long
            off.append(np.log(np.nanmedian(long) / table["lengths"][part]))
    assert len(off) in (6, 12)
    deviation = table["deviation"][part]
    assert deviation / 3 < np.sqrt(np.mean(np.square(off))) < 1.3 * deviation


@pytest.mark.parametrize(("sex", "legs", "shoulder"), [("female", -1, -1), ("male", 1, 1)])
def test_a_stated_sex_moves_joints_as_published_tables_do(sex, legs, shoulder):
    person, mean = Skeleton.human(1.7, proportions=sex), Skeleton.human(1.7)
    assert skeleton_stature(person) == pytest.approx(1.7, abs=1e-5)
    own, usual = standing(person), standing(mean)
    thigh = length(person, "femur_l") / length(mean, "femur_l")
    # Half of the tables' mean, which is a twentieth; and within a deviation of either.
    assert np.log(thigh) == pytest.approx(legs * 0.0225, abs=0.002)
    assert abs(np.log(thigh)) < proportions_of(JOINT_CENTRES)["deviation"]["thigh"]
    broad = (own["shoulder_l"] - own["shoulder_r"])[1] / (
        usual["shoulder_l"] - usual["shoulder_r"]
    )[1]
    assert np.log(broad) == pytest.approx(shoulder * 0.025, abs=0.002)
    # What both have in the mean is what nobody's sex states.
    both = [Skeleton.human(1.7, proportions=each).lengths for each in ("female", "male")]
    np.testing.assert_allclose(np.mean(both, 0), mean.lengths, rtol=3e-3)


def test_unknown_proportions_are_refused_by_name():
    found = "found 'vitruvius', expected one of winter, joint_centres, female, male"
    with pytest.raises(KeyError, match=found):
        Skeleton.human(1.8, proportions="vitruvius")


def test_scaling_by_mass_gives_winters_masses():
    person = Skeleton.human(1.8, 75.0)
    assert person.masses.sum() == pytest.approx(75.0, abs=1e-4)
    winter = {
        "humerus": 0.028,
        "radius": 0.016,
        "hand": 0.006,
        "femur": 0.100,
        "tibia": 0.0465,
        "foot": 0.0145,
    }
    for bone, fraction in winter.items():
        assert mass(person, f"{bone}_r") == pytest.approx(fraction * 75, rel=1e-5)
    assert mass(person, "neck", "head") == pytest.approx(0.081 * 75, rel=1e-5)


def test_without_a_mass_it_follows_the_height():
    assert Skeleton.human(2.0).masses.sum() == pytest.approx(23 * 4, rel=1e-5)


def test_a_mass_alone_changes_nothing_but_masses(skeleton):
    lighter = Skeleton.human(mass=40.335)
    np.testing.assert_allclose(lighter.masses, skeleton.masses / 2, rtol=1e-6)
    np.testing.assert_array_equal(lighter.lengths, skeleton.lengths)


def test_girths_keep_each_bones_density(skeleton):
    def densities(body):
        mean = np.asarray(body.diameters).mean(1)
        return np.asarray(body.masses) / (np.asarray(body.lengths) * mean**2)

    person = Skeleton.human(1.6, 90, "winter")
    np.testing.assert_allclose(densities(person), densities(skeleton), rtol=1e-5)
    # Where joints are changes no girth.
    np.testing.assert_array_equal(person.diameters, Skeleton.human(1.6, 90).diameters)


@pytest.mark.parametrize(
    ("height", "mass", "sentence"),
    [
        (0.4, None, r"height = 0\.4: expected metres between 0\.5 and 2\.5"),
        (175.0, None, r"height = 175\.0: expected metres"),
        (float("nan"), None, "height = nan: expected metres"),
        (1.8, 5.0, r"mass = 5\.0: expected kilograms between 10 and 400"),
        (None, 75000.0, r"mass = 75000\.0: expected kilograms"),
    ],
)
def test_heights_and_masses_of_nobody_are_refused(height, mass, sentence):
    with pytest.raises(ValueError, match=sentence):
        Skeleton.human(height, mass)


@pytest.fixture(scope="module")
def static_trial(recordings):
    points = read_trc(recordings / "balancing" / "static.trc").points()
    return {landmark: points[marker] for landmark, marker in STATIC_MARKERS.items()}


def test_a_real_static_trial_gives_the_persons_own_lengths(skeleton, static_trial):
    person = scale_to_landmarks(skeleton, static_trial)
    millimetres = {
        ("humerus_l",): 280,
        ("humerus_r",): 277,
        ("femur_r",): 368,
        ("tibia_r",): 384,
        ("neck", "head"): 236,
        ("spine1", "spine2", "spine3"): 618,
        ("clavicle_l",): 218,
        ("clavicle_r",): 218,
    }
    for bones, expected in millimetres.items():
        assert 1000 * length(person, *bones) == pytest.approx(expected, abs=1.5), bones


def test_in_a_real_static_trial_the_shoulders_lie_below_the_neck(skeleton, static_trial):
    person = scale_to_landmarks(skeleton, static_trial)
    for side, left in (("l", 1), ("r", -1)):
        clavicle = skeleton.tree.bone(f"clavicle_{side}")
        vector = np.asarray(person.lengths[clavicle] * person.directions[clavicle])
        assert vector[2] == pytest.approx(-0.08, abs=0.01)
        assert left * vector[1] == pytest.approx(0.20, abs=0.01)


def test_a_body_scaled_to_its_own_landmarks_is_itself():
    with double():
        person = Skeleton.human(1.7)
        points = {name: np.asarray(point, float)[None] for name, point in standing(person).items()}
        again = scale_to_landmarks(Skeleton.human(), points)
    np.testing.assert_allclose(again.lengths, person.lengths, atol=1e-12)
    np.testing.assert_allclose(again.directions, person.directions, atol=1e-12)
    np.testing.assert_allclose(again.masses, person.masses, rtol=1e-12)


def test_scaling_does_not_depend_on_where_the_person_stands_and_faces(skeleton, static_trial):
    turn = np.array([[0.6, -0.8, 0], [0.8, 0.6, 0], [0, 0, 1]])
    moved = {name: points @ turn.T + [3, -2, 0.5] for name, points in static_trial.items()}
    here, there = (scale_to_landmarks(skeleton, points) for points in (static_trial, moved))
    np.testing.assert_allclose(there.lengths, here.lengths, atol=1e-6)
    np.testing.assert_allclose(there.directions, here.directions, atol=1e-5)


def test_gaps_and_a_wild_frame_do_not_matter(skeleton, static_trial):
    marred = {name: points.copy() for name, points in static_trial.items()}
    marred["elbow_l"][:4] = np.nan
    marred["neck"][5] = np.nan
    marred["wrist_r"][7] += 0.5
    complete, other = (scale_to_landmarks(skeleton, points) for points in (static_trial, marred))
    np.testing.assert_allclose(other.lengths, complete.lengths, atol=2e-3)


def test_what_no_landmark_tells_follows_from_the_limbs(skeleton):
    person = Skeleton.human(1.9)
    points = {name: point[None] for name, point in standing(person).items()}
    for name in ("hand_l", "hand_r", "toe_l", "toe_r", "vertex", "wrist_l"):
        del points[name]
    guessed = scale_to_landmarks(skeleton, points)
    np.testing.assert_allclose(guessed.lengths, person.lengths, atol=1e-4)


@pytest.mark.parametrize(("axes", "stands"), [([2, 0, 1], "x"), ([1, 2, 0], "y")])
def test_a_static_trial_of_another_vertical_is_refused(skeleton, axes, stands):
    """Its height would be that of the shoulders' breadth, its limbs as thin and light."""
    points = {name: point[None, axes] for name, point in standing(skeleton).items()}
    with pytest.raises(ValueError, match=f"stands along {stands} in the static trial, expected z"):
        scale_to_landmarks(skeleton, points)
    upside_down = {name: point[None] * [1, -1, -1] for name, point in standing(skeleton).items()}
    with pytest.raises(ValueError, match="stands along -z"):
        scale_to_landmarks(skeleton, upside_down)


NEEDED = ("neck", "hip_l", "hip_r", "shoulder_l", "shoulder_r")


@pytest.mark.parametrize("more", [(), ("vertex",)])
def test_without_limbs_the_trunk_tells_the_height(skeleton, more):
    person = Skeleton.human(1.45)
    points = {name: standing(person)[name][None] for name in (*NEEDED, *more)}
    guessed = scale_to_landmarks(skeleton, points)
    np.testing.assert_allclose(guessed.lengths, person.lengths, atol=1e-4)


@pytest.mark.parametrize(
    "sides", [("hip_r", "hip_l"), ("shoulder_r", "shoulder_l"), ("hip_l",) * 2]
)
def test_left_and_right_exchanged_in_a_static_trial_are_refused(skeleton, sides):
    points = {name: point[None] for name, point in standing(skeleton).items()}
    part = sides[0].split("_")[0]
    left, right = (points[name] for name in sides)
    with pytest.raises(ValueError, match="hips and shoulders on opposite sides, or in one place"):
        scale_to_landmarks(skeleton, points | {f"{part}_l": left, f"{part}_r": right})


@pytest.mark.parametrize("part", ["elbow", "knee", "ankle", None])
def test_a_pair_or_all_sides_exchanged_are_refused(skeleton, part):
    """A pair makes two bones too long; all sides make the head lean back that leaned forward."""
    points = {name: point[None] for name, point in standing(skeleton).items()}
    other = {"_l": "_r", "_r": "_l"}
    exchanged = {
        name: points[name[:-2] + other[name[-2:]]] if name[-2:] in other and (
            part is None or name.startswith(part)) else point
        for name, point in points.items()
    }  # fmt: skip
    found = f"found {part}_l on the right of {part}_r" if part else "found toe_l behind ankle_l"
    with pytest.raises(ValueError, match=f"{found}: expected left landmarks on the left"):
        scale_to_landmarks(skeleton, exchanged)
    crossed = points | {"wrist_l": points["wrist_r"], "wrist_r": points["wrist_l"]}
    scale_to_landmarks(skeleton, crossed)


@pytest.mark.parametrize("needed", NEEDED)
def test_a_trial_without_trunk_is_refused(skeleton, needed):
    points = {name: point[None] for name, point in standing(skeleton).items()}
    points[needed] = np.full((1, 3), np.nan)
    with pytest.raises(ValueError, match=f"needs the landmark '{needed}' in at least one frame"):
        scale_to_landmarks(skeleton, points)
    del points[needed]
    with pytest.raises(ValueError, match=f"needs the landmark '{needed}'"):
        scale_to_landmarks(skeleton, points)


def test_an_unknown_landmark_is_answered_with_the_valid_ones(skeleton):
    with pytest.raises(ValueError, match=r"unknown landmark 'nose'; expected one of pelvis, neck"):
        scale_to_landmarks(skeleton, {"nose": np.zeros((1, 3))})


def test_scaling_leaves_the_given_skeleton_as_it_was(skeleton):
    before = np.array(skeleton.lengths)
    scale_to_height(skeleton, 2.0, 100.0)
    np.testing.assert_array_equal(skeleton.lengths, before)
