"""Binary glTF files of others: refused in one sentence, in bounded time and memory."""

import json
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import measured_complaint, problem_of
from hostile_mutations import glb_of

from jaxmocap.formats.animation.gltf_in import read_gltf

complaint = partial(problem_of, read_gltf)

# Generous: what bombs takes thousands.
MOST_MB = 1500
KEYS = np.arange(4, dtype="<f4")
TURNS = np.tile(np.array([0, 0, 0, 1], "<f4"), (4, 1))


def document() -> dict[str, Any]:
    """A hip and a knee that turn, each with four keys."""
    return {
        "asset": {"version": "2.0"},
        "nodes": [{"name": "hip", "children": [1]}, {"name": "knee", "translation": [0, -0.4, 0]}],
        "animations": [
            {
                "channels": [
                    {"sampler": 0, "target": {"node": node, "path": "rotation"}} for node in (0, 1)
                ],
                "samplers": [{"input": 0, "output": 1}],
            }
        ],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 4, "type": "SCALAR"},
            {"bufferView": 1, "componentType": 5126, "count": 4, "type": "VEC4"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": 16},
            {"buffer": 0, "byteOffset": 16, "byteLength": 64},
        ],
        "buffers": [{"byteLength": 80}],
    }


def written(path: Path, content: Any, block: bytes = KEYS.tobytes() + TURNS.tobytes()) -> Path:
    """A .glb file of a document, or of the text of one."""
    text = content if isinstance(content, bytes) else json.dumps(content).encode()
    path.write_bytes(glb_of(text, block))
    return path


def put(content: dict, place: str, value: Any) -> dict:
    """The document with one value changed; ``place`` is its keys and indices, by spaces."""
    *way, last = [int(word) if word.isdigit() else word for word in place.split()]
    part: Any = content
    for step in way:
        part = part[step]
    part[last] = value
    return content


def test_the_document_that_is_changed_below_is_read(tmp_path):
    armature = read_gltf(written(tmp_path / "a.glb", document()))
    assert armature.names == ("hip", "knee") and armature.rotations.shape == (4, 2, 3, 3)
    np.testing.assert_allclose(armature.offsets, [[0, 0, 0], [0, -0.4, 0]])


def test_numbers_of_other_programs_are_read(tmp_path):
    """Interleaved, normalised, and with a stride."""
    rows = np.zeros(4, np.dtype([("key", "<f4"), ("turn", "<i2", 4)]))
    rows["key"], rows["turn"] = KEYS, [0, 0, 0, 32767]
    content = put(document(), "bufferViews 0", {"buffer": 0, "byteLength": 48, "byteStride": 12})
    for accessor, more in ((0, {}), (1, {"byteOffset": 4, "componentType": 5122})):
        content["accessors"][accessor] |= {"bufferView": 0, "normalized": accessor == 1} | more
    armature = read_gltf(written(tmp_path / "a.glb", content, rows.tobytes()))
    np.testing.assert_allclose(armature.times, KEYS)
    np.testing.assert_allclose(armature.rotations[3, 1], np.eye(3), atol=1e-9)


def walking(above: dict | None) -> tuple[dict[str, Any], bytes]:
    """The same, the hip going along, below a node or none; and its block."""
    content, way = document(), np.outer(KEYS, [0.1, 0, 0]).astype("<f4") + np.float32([0, 1, 0])
    more = {"bufferView": 2, "componentType": 5126, "count": 4, "type": "VEC3"}
    content["accessors"].append(more)
    content["bufferViews"].append({"buffer": 0, "byteOffset": 80, "byteLength": 48})
    content["buffers"] = [{"byteLength": 128}]
    (animation,) = content["animations"]
    animation["samplers"].append({"input": 0, "output": 2})
    target = {"sampler": 1, "target": {"node": 0, "path": "translation"}}
    animation["channels"].append(target)
    if above is not None:
        content["nodes"].append({"name": "Armature", "children": [0]} | above)
        content["skins"] = [{"joints": [0, 1]}]
    return content, KEYS.tobytes() + TURNS.tobytes() + way.tobytes()


def test_the_object_that_a_skeleton_stands_on_is_no_joint(tmp_path):
    plain = read_gltf(written(tmp_path / "a.glb", *walking(None)))
    same = read_gltf(written(tmp_path / "b.glb", *walking({})))
    assert same.names == plain.names == ("hip", "knee")
    for name in ("offsets", "positions", "rotations"):
        np.testing.assert_allclose(getattr(same, name), getattr(plain, name), atol=1e-12)
    # Quarter a turn about x, and elsewhere: y up becomes z up.
    half = float(np.sqrt(0.5))
    turned = {"rotation": [half, 0, 0, half], "translation": [0, 0, 3]}
    other = read_gltf(written(tmp_path / "c.glb", *walking(turned)))
    expected = plain.positions[:, [0, 2, 1]] * [1, -1, 1] + [0, 0, 3]
    np.testing.assert_allclose(other.positions, expected, atol=1e-6)
    np.testing.assert_allclose(other.offsets[1], [0, 0, -0.4], atol=1e-6)
    np.testing.assert_allclose(other.rotations, plain.rotations, atol=1e-6)


@pytest.mark.parametrize(
    ("place", "value", "message"),
    [
        ("nodes", {}, "nodes: found {}, expected a JSON list"),
        ("nodes 0 children", [1, 1], "found node 1, which has a parent already"),
        ("nodes 1 children", [0], "nodes[0]: hangs on itself, a loop"),
        ("nodes 0 children", [0], "nodes[0]: hangs on itself, a loop"),
        ("nodes 0 children", [2], "found 2, expected an index of nodes, which has 2"),
        ("nodes 0 children", ["knee"], "found 'knee', expected an index of nodes"),
        ("nodes 0 children", 1, "found 1, expected a JSON list"),
        ("nodes 0 children", [-1], "found -1, expected an index of nodes"),
        ("nodes 0", None, "nodes[0]: found None, expected a JSON table"),
        ("nodes 1 name", "\x1b[31m", "expected a text that prints"),
        ("nodes 1 name", ["knee"], "expected a text that prints"),
        ("nodes 1 rotation", [0, 0, 0, 0], "found a quaternion of length 0"),
        ("nodes 1 rotation", [0, 0, 1], "expected 4 numbers"),
        ("nodes 1 translation", [0, 1e300, 0], "found 1e+300, expected a number"),
        ("nodes 1 translation", [0, 10**400, 0], "found a whole number of 1329 bits"),
        ("nodes 1 matrix", [0] * 16, "joint 'knee' is scaled"),
        ("nodes 1 matrix", [-1] + [0] * 4 + [1] + [0] * 4 + [1] + [0] * 4 + [1], "mirrors"),
        ("skins", [{"joints": [5]}], "skins[0].joints[0]: found 5, expected an index"),
        ("skins", [{}], "skins[0].joints: found None, expected a JSON list"),
        ("animations 0 channels", 7, "animations[0].channels: found 7, expected a JSON list"),
        ("animations 0 channels 0 sampler", 9, "expected an index of animations[0].samplers"),
        ("animations 0 channels 1 target node", 0, "moves the rotation of node 0 a second time"),
        ("animations 0 channels 0 target path", "colour", "found 'colour', expected one of"),
        ("animations 0 samplers 0 input", None, "expected an index of accessors"),
        ("animations 0 samplers 0 output", 0, "accessors[0].type: found SCALAR, expected VEC4"),
        ("animations 0 extras", {"start": "now"}, "start: found 'now', expected a number"),
        ("accessors", [], "expected an index of accessors, which has 0"),
        ("accessors 0 count", 10**9, "found 1000000000 numbers more, expected at most"),
        ("accessors 1 count", 5, "found 5 times 16 bytes from 0 on, 16 apart, its view has 64"),
        ("accessors 1 count", -1, "accessors[1].count: found -1, expected a whole number"),
        ("accessors 1 count", 2.5, "found 2.5, expected a whole number"),
        ("accessors 1 count", 3, "found 3 values for 4 keys"),
        ("accessors 0 count", 0, "times of keys that do not ascend"),
        ("accessors 1 byteOffset", -16, "found -16, expected a whole number, 0 or more"),
        ("accessors 1 componentType", 5124, "found 5124, expected one of 5120"),
        ("accessors 1 type", ["VEC4"], "expected one of SCALAR"),
        ("accessors 1 sparse", {}, "accessors[1]: found sparse numbers, which are not read"),
        ("accessors 1 bufferView", 2, "expected an index of bufferViews, which has 2"),
        ("bufferViews 1 byteLength", 10**12, "found bytes 16 to 1000000000016, the file holds 80"),
        ("bufferViews 1 byteOffset", -1, "found -1, expected a whole number"),
        ("bufferViews 1 byteStride", 1, "found 1, expected a whole number, 16 or more"),
        ("bufferViews 1 byteStride", 10**9, "1000000000 apart, its view has 64"),
        ("buffers 0 uri", "file:///dev/zero", "found numbers in another file"),
    ],
)
def test_a_document_that_contradicts_itself_is_refused(tmp_path, place, value, message):
    assert message in complaint(written(tmp_path / "a.glb", put(document(), place, value)))


@pytest.mark.parametrize(
    ("keys", "quaternions", "message"),
    [
        ([0, 1, np.nan, 3], TURNS, "accessors[0]: found what is no number"),
        ([0, 2, 1, 3], TURNS, "times of keys that do not ascend"),
        ([0, 1, 2, 1e12], TURNS, "do not ascend within"),
        (KEYS, np.full((4, 4), np.inf), "accessors[1]: found what is no number"),
        (KEYS, np.zeros((4, 4)), "found a quaternion of length 0, expected 1"),
    ],
)
def test_numbers_that_no_animation_has_are_refused(tmp_path, keys, quaternions, message):
    block = np.array(keys, "<f4").tobytes() + np.array(quaternions, "<f4").tobytes()
    assert message in complaint(written(tmp_path / "a.glb", document(), block))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (b"[" * 100_000, "JSON nested too deeply"),
        (b'{"a":' * 200 + b"1" + b"}" * 200, "JSON nested too deeply"),
        (b'{"a": ' + b"9" * 5000 + b"}", "a number of thousands of digits"),
        (b'{"a": NaN}', "found NaN, expected a number"),
        (b'{"a": \xff}', "not UTF-8 text"),
        (b"[]", "found [], expected a JSON table"),
        (b"[" + b"[]," * 2_100_000 + b"[]]", "parts, expected at most 2000000"),
        (b'"' + b"a" * 2**24 + b'"', "bytes of JSON, expected at most 16777216"),
    ],
)
def test_text_that_is_no_document_is_refused(tmp_path, text, message):
    assert message in complaint(written(tmp_path / "a.glb", text))


def test_joints_without_end_are_refused(tmp_path):
    deep = document()
    deep["nodes"] = [{"children": [i + 1]} for i in range(300)] + [{}]
    assert "200 deep below one another" in complaint(written(tmp_path / "a.glb", deep))
    broad = document()
    broad["nodes"] = [{"children": list(range(1, 3000))}] + [{} for _ in range(2999)]
    assert "nodes: expected at most 2000 joints" in complaint(written(tmp_path / "a.glb", broad))
    many = document()
    many["nodes"] = [{}] * 100_001
    assert "found 100001 nodes, expected at most" in complaint(written(tmp_path / "a.glb", many))


def test_ways_that_meet_and_bytes_read_again_take_little_memory(tmp_path):
    """Diamonds of nodes double the ways at each level; thousands of names for the same bytes."""
    diamonds = document()
    diamonds["nodes"] = [{"children": [2 * i + 2, 2 * i + 3]} for i in range(40) for _ in "ab"]
    diamonds["nodes"] += [{}, {}]
    again, count = document(), 400
    keys = np.arange(100_000, dtype="<f4")
    block = keys.tobytes() + np.tile(TURNS[0], (len(keys), 1)).tobytes()
    again["nodes"] = [{"children": list(range(1, count))}] + [{} for _ in range(count - 1)]
    again["bufferViews"][0]["byteLength"] = 4 * len(keys)
    again["bufferViews"][1] |= {"byteOffset": 4 * len(keys), "byteLength": 16 * len(keys)}
    for accessor in again["accessors"]:
        accessor["count"] = len(keys)
    again["accessors"] = again["accessors"][:1] + again["accessors"][1:] * count
    animation = again["animations"][0]
    animation["samplers"] = [{"input": 0, "output": i + 1} for i in range(count)]
    animation["channels"] = [
        {"sampler": i, "target": {"node": i, "path": "rotation"}} for i in range(count)
    ]
    for path, message in (
        (written(tmp_path / "diamonds.glb", diamonds), "has a parent already"),
        (written(tmp_path / "again.glb", again, block), "expected at most 10000000 orientations"),
    ):
        refused_with, size = measured_complaint(read_gltf, path)
        assert message in refused_with and size < MOST_MB
