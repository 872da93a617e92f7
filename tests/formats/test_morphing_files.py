"""Files of what goes along with joints: both sides of them, surfaces to go over into, mistakes."""

import numpy as np
import pytest

from jaxmocap.body.skeleton import Skeleton, with_joints
from jaxmocap.body.subject import rest_joints
from jaxmocap.body.surfaces.loft import generic_surface
from jaxmocap.body.surfaces.morphing import shoulders
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.recordings.morphing import read_morphing
from jaxmocap.formats.recordings.surface import save_surface
from jaxmocap.silhouette.surfaces.swelling import morph_around

BODY = with_joints(Skeleton.human(1.75), "supple.toml")
SURFACE, TREE = generic_surface(BODY), BODY.tree
GOOD = """
[[joint]]
name = "clavicle_raise"
steered_by = ["arm_flex", "arm_abduct"]
gain = 0.2

[[swelling]]
patch = "arm"
steered_by = ["elbow_flex"]
weighting = "squared"
gain = 0.02
centre = [30, 0.3]
radii = [60, 0.1]
direction = [0, 1, 0]

[[transition]]
to = "stouter.npz"
steered_by = ["elbow_flex_l"]
patches = ["torso"]
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("morphing")
    save_surface(folder / "stouter.npz", generic_surface(BODY, 1.3), TREE)
    return folder


def read(folder, text):
    (folder / "moves.toml").write_text(text)
    return read_morphing(folder / "moves.toml", TREE, SURFACE.patches)


def test_the_package_s_own_file_reads_as_the_package_has_it(folder):
    from importlib import resources

    own = resources.files("jaxmocap.body").joinpath("data", "shoulder.toml").read_text("utf-8")
    assert read(folder, own) == shoulders()


def test_joints_and_swellings_are_for_either_side_and_transitions_as_written(folder):
    morphing = read(folder, GOOD)
    assert [each.joint for each in morphing.followers] == ["clavicle_raise_l", "clavicle_raise_r"]
    left, right = morphing.swellings
    assert (left.patch, right.patch) == ("arm_l", "arm_r")
    assert left.direction == (0, 1, 0) and right.direction == (0, -1, 0)
    assert left.driver.joints == ("elbow_flex_l",) and left.driver.weighting == "squared"
    (over,) = morphing.transitions
    assert over.patches == ("torso",) and over.driver.joints == ("elbow_flex_l",)
    morph = morph_around(morphing, TREE, SURFACE, rest_joints(BODY))
    torso = next(patch for patch in SURFACE.patches if patch.name == "torso")
    gone = np.linalg.norm(np.asarray(morph.moves)[..., morphing.drivers.index(over.driver)], axis=1)
    assert gone[torso.nodes].max() > 0.01 and np.delete(gone, np.r_[torso.nodes]).max() == 0


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('name = "clavicle_raise"', 'name = "wing"', "joint 1: no joint 'wing', expected of"),
        ('"arm_abduct"]', "3]", "joint 1 steered_by: found .* expected one or two joints"),
        ("gain = 0.2\n", "gain = 9\n", "joint 1 gain: found 9, expected a number from -3.14"),
        ('patch = "arm"', 'patch = "tail"', "swelling 1 patch: found 'tail', expected of torso"),
        ("squared", "cubed", "weighting: found 'cubed', expected of linear, square_root"),
        ("[60, 0.1]", "[60, 0]", "swelling 1 radii: .* expected both above 0"),
        ("[30, 0.3]", "[30]", "swelling 1 centre: found .* expected degrees around"),
        ("[0, 1, 0]", "[0, 1]", "swelling 1 direction: .* expected three numbers"),
        ("stouter.npz", "gone.npz", "transition 1 to: no such file"),
        ('["torso"]', '["tail"]', "transition 1 patches: .* expected of torso"),
        ("clavicle_raise", "arm_flex", "arm_flex_l drives and follows"),
        ("gain = 0.02", "gian = 0.02", "swelling 1: unknown key 'gian', expected patch, gain"),
        ("[[joint]]", "[joint]", "joint: found .* expected"),
        (GOOD, "", "nothing goes along, expected"),
    ],
)
def test_a_mistake_is_named(folder, old, new, says):
    assert old in GOOD
    with pytest.raises(InputError, match=says):
        read(folder, GOOD.replace(old, new))


def test_a_surface_of_other_nodes_is_refused(folder):
    patches = (SURFACE.patches[0].__class__("torso", 8, 4, 0), *SURFACE.patches[1:])
    (folder / "moves.toml").write_text(GOOD)
    with pytest.raises(InputError, match=r"stouter\.npz has other patches, expected node for node"):
        read_morphing(folder / "moves.toml", TREE, patches)
