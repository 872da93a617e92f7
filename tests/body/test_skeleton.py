"""The body of Table 1: numbers, tree, chains; what is static and what is traced."""

import dataclasses

import jax
import numpy as np
import pytest
from conftest import double

from jaxmocap.body.skeleton import ELBOWS, LANDMARKS, Skeleton, landmark_rows, load_skeleton
from jaxmocap.body.tree import ROOT_DOF

# Table 1 as printed: length in millimetres, mass in grams, degrees of freedom.
TABLE_1 = {
    "spine1": (156, 5790, 1),
    "spine2": (171, 5790, 1),
    "spine3": (142, 4130, 1),
    "neck": (90, 3520, 2),
    "head": (100, 4390, 0),
    "clavicle": (190, 4130, 0),
    "humerus": (300, 2180, 3),
    "radius": (350, 1310, 1),
    "hand": (80, 520, 0),
    "hip": (85, 5715, 0),
    "femur": (386, 10050, 3),
    "tibia": (550, 3510, 1),
    "foot": (128, 1110, 0),
}
CENTRAL = ("spine1", "spine2", "spine3", "neck", "head")


def rows():
    """(bone, row of Table 1) of all 21 bones."""
    for name, row in TABLE_1.items():
        for bone in (name,) if name in CENTRAL else (f"{name}_l", f"{name}_r"):
            yield bone, row


def test_there_are_21_bones_and_21_degrees_of_freedom(skeleton):
    assert len(skeleton.tree.bones) == 21 == len(set(skeleton.tree.bones))
    assert len(skeleton.tree.joints) == 21 == len(set(skeleton.tree.joints))
    assert set(skeleton.tree.bones) == {bone for bone, _ in rows()}


@pytest.mark.parametrize(("bone", "row"), list(rows()))
def test_every_bone_is_as_table_1_prints_it(skeleton64, bone, row):
    length, mass, dofs = row
    i = skeleton64.tree.bone(bone)
    assert np.asarray(skeleton64.lengths)[i] == pytest.approx(length / 1000, abs=1e-12)
    assert np.asarray(skeleton64.masses)[i] == pytest.approx(mass / 1000, abs=1e-12)
    assert skeleton64.tree.dof_bones.count(i) == dofs


def test_the_body_weighs_80_kilograms_and_670_grams(skeleton64):
    assert round(1000 * np.asarray(skeleton64.masses).sum()) == 80670
    assert sum(mass for _, (_, mass, _) in rows()) == 80670


@pytest.mark.parametrize("model", ["human", "torso", "legs", "whole", "supple"])
def test_the_sides_mirror_each_other(model):
    skeleton = load_skeleton(f"{model}.toml")
    names, mirror = skeleton.tree.bones, np.array([1, -1, 1])
    for i, name in enumerate(names):
        if name.endswith("_l"):
            j = names.index(name[:-1] + "r")
            for column in ("lengths", "masses", "centres", "diameters"):
                np.testing.assert_array_equal(*np.asarray(getattr(skeleton, column))[[i, j]])
            left, right = np.asarray(skeleton.directions)[[i, j]]
            np.testing.assert_array_equal(left, mirror * right)
    joints = skeleton.tree.joints
    for i, name in enumerate(joints):
        if name.endswith("_l"):
            j = joints.index(name[:-1] + "r")
            # A turn is a pseudovector: mirrored, it keeps the component across the mirror.
            left, right = np.asarray(skeleton.axes)[[i, j]]
            np.testing.assert_array_equal(left, -mirror * right)
            for column in ("limits", "relaxed"):
                np.testing.assert_array_equal(*np.asarray(getattr(skeleton, column))[[i, j]])
            a, b = np.asarray(skeleton.costs)[[ROOT_DOF + i, ROOT_DOF + j]]
            assert a == b


def test_the_numbers_make_sense(skeleton):
    np.testing.assert_allclose(np.linalg.norm(skeleton.directions, axis=1), 1, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(skeleton.axes, axis=1), 1, atol=1e-6)
    low, high = np.asarray(skeleton.limits).T
    assert (low < high).all()
    assert (low <= skeleton.relaxed).all() and (skeleton.relaxed <= high).all()
    assert (low >= -np.pi).all() and (high <= np.pi + 1e-6).all()
    assert skeleton.costs.shape == (27,) and (np.asarray(skeleton.costs) > 0).all()
    assert ((np.asarray(skeleton.centres) > 0) & (np.asarray(skeleton.centres) < 1)).all()
    assert (np.asarray(skeleton.diameters) > 0.03).all()


def test_an_elbow_costs_less_than_a_shoulder_and_a_shoulder_less_than_the_spine(skeleton):
    elbow, shoulder, spine = (
        skeleton.costs[ROOT_DOF + skeleton.tree.joint(name)]
        for name in ("elbow_flex_l", "arm_flex_l", "spine1_flexion")
    )
    assert elbow < shoulder < spine


def test_the_axes_of_each_joint_are_orthogonal(skeleton):
    for bone in set(skeleton.tree.dof_bones):
        axes = np.asarray(skeleton.axes)[np.array(skeleton.tree.dof_bones) == bone]
        np.testing.assert_allclose(axes @ axes.T, np.eye(len(axes)), atol=1e-6)


def test_chains_run_from_the_root_to_the_leaves(skeleton):
    tree = skeleton.tree

    def chain(bone):
        return [tree.bones[i] for i in tree.chain(bone)]

    spine = ["spine1", "spine2", "spine3"]
    assert chain("head") == [*spine, "neck", "head"]
    assert chain("hand_l") == [*spine, "clavicle_l", "humerus_l", "radius_l", "hand_l"]
    assert chain("foot_r") == ["hip_r", "femur_r", "tibia_r", "foot_r"]


def test_the_root_carries_everything_and_a_joint_what_hangs_on_it(skeleton):
    tree = skeleton.tree
    assert tree.carries.shape == (27, 21)
    assert tree.carries[:ROOT_DOF].all()
    elbow = tree.carries[ROOT_DOF + tree.joint("elbow_flex_r")]
    assert {tree.bones[i] for i in np.flatnonzero(elbow)} == {"radius_r", "hand_r"}


def test_doublings_are_links_at_powers_of_two_up_the_chain(skeleton):
    tree, links, root = skeleton.tree, skeleton.tree.links, 1
    for bone in tree.bones:
        own = [2 + np.flatnonzero(links.bones == i) for i in tree.chain(bone)]
        chain = [root, *np.concatenate(own)]
        assert links.last[tree.bone(bone)] == chain[-1]
        for place, link in enumerate(chain):
            for power, ancestors in enumerate(links.doublings):
                above = place - 2**power
                assert ancestors[link] == (chain[above] if above >= 0 else 0)
        assert 2 ** len(links.doublings) >= len(chain)


def test_unknown_names_are_answered_with_the_valid_ones(skeleton):
    with pytest.raises(KeyError, match=r"unknown bone 'ulna_l'; the bones are spine1, .*foot_r"):
        skeleton.tree.bone("ulna_l")
    with pytest.raises(KeyError, match=r"unknown joint 'wrist'; the joints are spine1_flexion, "):
        skeleton.tree.joint("wrist")


def test_landmarks_are_found_by_name_and_unknown_ones_answered_with_the_valid_ones():
    rows = landmark_rows(["wrist_r", "neck"])
    assert [LANDMARKS[row] for row in rows] == ["wrist_r", "neck"]
    assert [LANDMARKS[row] for row in ELBOWS] == ["elbow_l", "elbow_r"]
    assert rows.dtype == np.int32 and landmark_rows([]).shape == (0,)
    with pytest.raises(KeyError, match="'ellbow'; the landmarks are pelvis, neck"):
        landmark_rows(["ellbow"])


def test_only_names_and_tree_are_static(skeleton):
    numbers = {field.name for field in dataclasses.fields(Skeleton)} - {"tree"}
    paths, _ = jax.tree_util.tree_flatten_with_path(skeleton)
    assert {path[0].name for path, _ in paths} == numbers
    assert {"lengths", "masses", "diameters", "costs", "limits", "relaxed"} <= numbers
    assert not any(leaf.weak_type for _, leaf in paths)
    assert hash(skeleton.tree) == hash(Skeleton.human(1.6).tree)
    assert skeleton.tree == Skeleton.human(1.6).tree


def test_the_human_is_made_in_the_precision_of_the_moment(skeleton):
    with double():
        assert Skeleton.human().lengths.dtype == np.float64
    assert Skeleton.human().lengths.dtype == np.float32
    assert isinstance(jax.jit(lambda x: x * Skeleton.human().masses.sum())(1.0), jax.Array)
    np.testing.assert_array_equal(Skeleton.human().lengths, skeleton.lengths)
