"""NPZ files of others: refused in one sentence, before anything is allocated."""

import json
import struct
import zipfile
from contextlib import nullcontext
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from conftest import measured_complaint, problem_of
from hostile_mutations import npy
from moving_body import SAMPLES, moving_body
from rigged_people import rigged

from jaxmocap.formats.files import arrays
from jaxmocap.formats.files.arrays import INTEGERS, NAMES, ArraySpec, NpzArrays
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.motion_npz import load_motion, save_motion
from jaxmocap.synthetic.four_cameras import read_masks
from jaxmocap.synthetic.people.rigged_mesh import load_rig

complaint = partial(problem_of, load_motion)

# Generous: what bombs takes thousands.
MOST_MB = 1500


@pytest.fixture(scope="module")
def motion(tmp_path_factory) -> dict[str, np.ndarray]:
    """The arrays of a good motion."""
    path = tmp_path_factory.mktemp("good") / "motion.npz"
    save_motion(path, moving_body())
    with np.load(path) as data:
        return dict(data)


def changed(folder: Path, arrays: dict[str, np.ndarray], **change) -> Path:
    """A file of arrays, some of them others; None leaves one out."""
    path = folder / "changed.npz"
    actual = arrays | {name.replace("__", "."): array for name, array in change.items()}
    np.savez(path, **{name: a for name, a in actual.items() if a is not None})  # type: ignore[arg-type]
    return path


def zipped(path: Path, *members: tuple[str, bytes], how: int = zipfile.ZIP_DEFLATED) -> Path:
    with zipfile.ZipFile(path, "w", how) as file:
        for name, content in members:
            file.writestr(name, content)
    return path


def header(descr: str, shape: str) -> bytes:
    """An array's header alone."""
    text = f"{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    return b"\x93NUMPY\1\0" + struct.pack("<H", len(text)) + text


# Any .npz file ----------------------------------------------------------------------------------


def test_half_precision_is_read_without_a_warning(tmp_path, motion, recwarn):
    """Bounds are beyond its range."""
    halves = {name: a.astype(np.float16) for name, a in motion.items() if a.dtype == np.float32}
    assert len(halves) > 2
    load_motion(changed(tmp_path, motion | halves))
    assert not recwarn.list


def test_what_is_no_archive_of_arrays_is_refused(tmp_path):
    path = tmp_path / "a.npz"
    path.write_bytes(b"")
    assert complaint(path) == "the file is empty"
    path.write_bytes(npy(np.arange(3)))
    assert "found a single array (.npy)" in complaint(path)
    path.write_bytes(b"PK\3\4 and no more")
    assert complaint(path) == "not an .npz file, or cut off"
    assert "no NumPy array" in complaint(zipped(path, ("version.npy", b"text")))
    assert "no NumPy array" in complaint(zipped(path, ("version.npy", b"")))
    assert "at most 1000" in complaint(zipped(path, *((f"{i}.npy", b"") for i in range(1001))))


def test_an_encrypted_member_is_refused(tmp_path):
    path = zipped(tmp_path / "a.npz", ("version.npy", npy(np.array(2))))
    content = bytearray(path.read_bytes())
    content[content.index(b"PK\3\4") + 6] |= 1
    content[content.index(b"PK\1\2") + 8] |= 1
    path.write_bytes(content)
    assert complaint(path) == "version: encrypted, which is not read"


def test_another_compression_is_refused(tmp_path):
    member = ("version.npy", npy(np.array(2)))
    path = zipped(tmp_path / "a.npz", member, how=zipfile.ZIP_LZMA)
    assert complaint(path) == "version: compressed by method 14, expected none or deflate"


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_an_array_that_is_there_twice_is_refused(tmp_path):
    members = ("times.npy", npy(np.zeros(1))), ("times.npy", npy(np.ones(1)))
    assert complaint(zipped(tmp_path / "a.npz", *members)) == "the array 'times' is there twice"


def test_pickles_are_refused_and_never_run(tmp_path):
    objects = npy(np.array([Path()], object))
    path = zipped(tmp_path / "a.npz", ("version.npy", objects))
    assert complaint(path) == "version: found Python objects, expected whole numbers"


@pytest.mark.parametrize("damaged", [60, 100, 300])
def test_a_flipped_byte_is_noticed(tmp_path, damaged):
    path = zipped(tmp_path / "a.npz", ("version.npy", npy(np.arange(40))), how=zipfile.ZIP_STORED)
    content = bytearray(path.read_bytes())
    content[damaged] ^= 0x55
    path.write_bytes(content)
    with pytest.raises(InputError):
        NpzArrays(path).read({"version": ArraySpec(("N",), INTEGERS)})


def test_sizes_that_contradict_the_bytes_are_refused_before_anything_is_allocated(tmp_path):
    path = tmp_path / "a.npz"
    larger = header("<f8", "(4000000000000, 3)") + bytes(48)
    zipped(path, ("x.npy", larger))
    with pytest.raises(InputError, match="states 96000000000000 bytes of values, but 48 are there"):
        NpzArrays(path).read({"x": ArraySpec(("N", 3))})
    zipped(path, ("x.npy", header("<f8", "(-2, -3)") + bytes(48)))
    with pytest.raises(InputError, match=r"found shape \(-2, -3\)"):
        NpzArrays(path).read({"x": ArraySpec(("N", "M"))})


@pytest.mark.parametrize("descr", ["<f16", "|O", "<c16", "<M8[s]", "|V8", "|S3", "<U0", "|b1"])
def test_values_of_another_type_are_refused(tmp_path, descr):
    path = zipped(tmp_path / "a.npz", ("x.npy", header(descr, "(1,)") + bytes(16)))
    with pytest.raises(InputError, match=r"x: (found|no NumPy array)"):
        NpzArrays(path).read({"x": ArraySpec(("N",))})


def test_names_must_print_and_be_short(tmp_path):
    def message(*names: str) -> str:
        path = changed(tmp_path, {"x": np.array(names)})
        return problem_of(lambda at: NpzArrays(at).read({"x": ArraySpec(("N",), NAMES)}), path)

    assert message("a", "\x1b[31mred") == r"x: found '\x1b[31mred', expected a name that prints"
    assert "expected a name that prints" in message("a", "")
    assert "found texts of 201 characters, expected at most 200" in message("a" * 201)
    assert "expected at most 10000" in message(*map(str, range(10_001)))
    beyond = header("<U1", "(1,)") + struct.pack("<I", 0x110000)
    path = zipped(tmp_path / "b.npz", ("x.npy", beyond))
    with pytest.raises(InputError, match="found what is no text"):
        NpzArrays(path).read({"x": ArraySpec(("N",), NAMES)})


def test_other_orders_and_widths_are_read(tmp_path):
    numbers = np.arange(6.0).reshape(2, 3)
    stated = {"x": ArraySpec(("N", 3))}
    for array in (np.asfortranarray(numbers), numbers.astype(">f4"), numbers.astype("<u2")):
        path = changed(tmp_path, {"x": array})
        np.testing.assert_array_equal(NpzArrays(path).read(stated)["x"], numbers)


# Motions ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"times": None}, "the array 'times' is missing"),
        ({"times": np.zeros((SAMPLES, 2))}, "times: found shape (60, 2), expected (T)"),
        ({"times": np.arange(59.0)}, "expected (T, 3) with T = 59 as in times"),
        ({"times": np.zeros(SAMPLES)}, "time runs backwards"),
        ({"times": np.full(SAMPLES, np.nan)}, "times[0]: found nan"),
        ({"times": np.zeros(0)}, "expected (T, 3) with T = 0 as in times"),
        ({"version": np.array([2, 2])}, "version: found shape (2,), expected ()"),
        ({"version": np.array("2")}, "expected whole numbers"),
        ({"pose__angles": np.zeros((SAMPLES, 20))}, "with T = 60 as in times, D = 21 as in"),
        ({"pose__position": np.full((SAMPLES, 3), np.inf)}, "pose.position[0, 0]: found inf"),
        ({"pose__quaternion": np.zeros((SAMPLES, 4))}, "[0]: found length 0, expected 1"),
        ({"tree__parents": np.arange(21)}, "tree.parents: found 0, 1, 2"),
        ({"tree__parents": np.full(21, -1)}, "tree.parents: found -1, -1"),
        ({"tree__bones": np.array(["tail"] * 21)}, "tree.bones: found tail"),
        ({"tree__dof_bones": np.full(21, 21)}, "tree.dof_bones: found bone 21 for"),
        ({"tree__joints": np.array(["bow"] * 21)}, "tree.joints: 'bow' is no joint of ours"),
        ({"skeleton__lengths": np.zeros(21)}, "found 0, expected metres above 0"),
        ({"skeleton__lengths": np.full(21, -1.0)}, "found -1.0, expected numbers from 0 to 10"),
        ({"skeleton__axes": np.zeros((21, 3))}, "skeleton.axes[0]: found length 0, expected 1"),
        ({"skeleton__limits": np.tile([1.0, 0], (21, 1))}, "expected the smaller angle first"),
        ({"skeleton__costs": np.ones(5)}, "skeleton.costs: found 5 numbers, expected 27"),
    ],
)
def test_a_motion_that_contradicts_itself_is_refused(tmp_path, motion, change, message):
    assert message in complaint(changed(tmp_path, motion, **change))


def report(**change) -> dict[str, np.ndarray]:
    good = {
        "report.markers": np.array(["Head"]),
        "report.marker_errors": np.zeros((SAMPLES, 1)),
        "report.arm_costs": np.full((SAMPLES, 2), np.nan),
        "report.swivels": np.zeros((SAMPLES, 2)),
        "report.landmarks_std": np.full((SAMPLES, 20, 3), np.inf),
        "report.from_prior": np.zeros((SAMPLES, 20)),
        "report.statuses": np.array(json.dumps([[]] * SAMPLES)),
        # With an entry that no version has any more.
        "report.settings": np.array('{"mode": "own", "gain": 1, "tracker": {"gain": NaN}}'),
        "milliseconds.solve": np.zeros(3),
    }
    return good | {f"report.{name}": array for name, array in change.items()}


def test_a_report_may_hold_what_is_unknown_or_unbounded(tmp_path, motion):
    read = load_motion(changed(tmp_path, motion | report()))
    assert read.report is not None and np.isnan(read.report.run.tracker["gain"])
    assert len(read.report.statuses) == SAMPLES and list(read.report.milliseconds) == ["solve"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"statuses": np.array("[[]]")}, "expected a JSON list of 60 entries"),
        ({"statuses": np.array(json.dumps([[1]] * SAMPLES))}, "found [1], expected sentences"),
        ({"statuses": np.array(json.dumps([0] * SAMPLES))}, "statuses[0]: found 0, expected sent"),
        ({"statuses": np.array("[" * 200_000)}, "JSON nested too deeply"),
        ({"settings": np.array("{" + '"a":{' * 200 + "}" * 201)}, "JSON nested too deeply"),
        ({"settings": np.array("3")}, "report.settings: found 3, expected a JSON table"),
        ({"settings": np.array('{"seconds": 3}')}, "settings.seconds: found 3, expected a JSON t"),
        ({"settings": np.array('{"warnings": "a"}')}, "found 'a', expected a JSON list"),
        ({"settings": np.array('{"mode": {}}')}, "settings.mode: found {}, expected a text"),
        ({"settings": np.array(f'{{"a": {"9" * 5000}}}')}, "a number of thousands of digits"),
        ({"settings": np.array("{")}, "holds no readable JSON (line 1, column 2"),
        ({"from_prior": np.full((SAMPLES, 20), 2.0)}, "found 2.0, expected numbers from 0 to 1"),
        ({"marker_errors": np.zeros((SAMPLES, 2))}, "with T = 60 as in times, M = 1 as in"),
    ],
)
def test_a_report_that_contradicts_its_motion_is_refused(tmp_path, motion, change, message):
    assert message in complaint(changed(tmp_path, motion | report(**change)))


# In bounded time and memory ---------------------------------------------------------------------


def test_a_bomb_is_refused_before_it_goes_off(tmp_path, motion):
    """A gigabyte of zeros in some megabytes."""
    path = tmp_path / "bomb.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as file:
        for name in motion.keys() - {"times"}:
            file.writestr(f"{name}.npy", npy(motion[name]))
        with file.open("times.npy", "w", force_zip64=True) as member:
            member.write(header("<f8", f"({2**27},)"))
            for _ in range(64):
                member.write(bytes(2**24))
    message, size = measured_complaint(load_motion, path)
    assert (
        message == f"{path}: times: states 1024 MB, expected at most 768 MB of arrays in one file"
    )
    assert size < MOST_MB / 5


@pytest.mark.parametrize(("kind", "is_read"), [("<f4", True), ("<f8", False), ("<i4", False)])
def test_what_may_be_read_counts_as_it_is_in_memory(tmp_path, monkeypatch, kind, is_read):
    """Fractions of single precision stay so: a million samples of a motion can be read again."""
    monkeypatch.setattr(arrays, "MAX_ARRAY_BYTES", 5_000)
    np.savez_compressed(tmp_path / "a.npz", times=np.arange(1000).astype(kind))
    file = NpzArrays(tmp_path / "a.npz")
    with nullcontext() if is_read else pytest.raises(InputError, match="expected at most"):
        assert file.read({"times": ArraySpec(("T",))})["times"].nbytes <= 5_000


def test_sentences_of_many_empty_lists_take_little_memory(tmp_path, motion):
    text = "[" + "[]," * 3_000_000 + "[]]"
    path = tmp_path / "changed.npz"
    np.savez_compressed(path, **(motion | report(statuses=np.array(text))))
    message, size = measured_complaint(load_motion, path)
    assert "parts, expected at most 2000000" in message and size < MOST_MB


# Rigged people and masks ------------------------------------------------------------------------


def test_the_first_person_of_a_file_will_do_where_nobody_is_called_man(tmp_path):
    path = changed(tmp_path, rigged())
    assert load_rig(path).mesh.vertices.shape == (8, 3)
    with pytest.raises(ValueError, match="unknown person 'man'; expected one of woman"):
        load_rig(path, "man")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"people": np.array([], str)}, "vertices: found shape (1, 8, 3)"),
        ({"quads": np.array([[0, 1, 2, 8]])}, "quads: found index 8, expected one below 8"),
        ({"quads": np.array([[0, 1, 2, -1]])}, "found -1, expected whole numbers from 0"),
        ({"quads": np.zeros((0, 4), int)}, "quads: found 0, expected 1 to 200000"),
        ({"skin_joint": np.full((8, 1), 99)}, "expected one below 20"),
        ({"skin_weight": np.zeros((8, 1))}, "skin_weight[0]: together 0, expected 1"),
        ({"joint_parents": np.roll(np.arange(20), 1)}, "found roots (-1)"),
        ({"joint_parents": np.array([-1, 2, 1] + [0] * 17)}, "hangs on no root, a loop"),
        ({"joint_names": np.array(["a"] * 20)}, "joint_names: found no Hips"),
        ({"vertices": np.full((1, 8, 3), np.nan)}, "vertices[0, 0, 0]: found nan"),
        ({"vertices": np.zeros((1, 8, 3))}, "woman: found a body 0 m tall"),
        ({"joints": np.zeros((1, 20, 3))}, "found LeftArm and LeftForeArm at one place"),
    ],
)
def test_people_who_contradict_themselves_are_refused(tmp_path, change, message):
    assert message in problem_of(load_rig, changed(tmp_path, rigged(**change)))


def test_masks_of_another_size_are_refused(tmp_path):
    path = changed(tmp_path, {"cam_1": np.zeros((3, 48, 8), np.uint8)})
    assert read_masks(path, (64, 48))["cam_1"].shape == (3, 48, 64)
    message = problem_of(read_masks, path)
    assert message == "cam_1: found shape (3, 48, 8), expected (F, 480, 80)"
