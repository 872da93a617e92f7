"""Mutations of a file's bytes, lines, tables, trees and arrays, and of what each format alone has.

INPUTS: a random generator and a file's content. OUTPUTS: another content.
"""

import io
import json
import re
import struct
import tomllib
import warnings
import zipfile
import zlib
from collections.abc import Callable, Iterable
from functools import cache
from itertools import islice
from xml.sax.saxutils import quoteattr

import numpy as np
from hostile_values import NUMBERS, as_json, as_toml, change_tree, hostile_number, hostile_text

Mutation = Callable[[np.random.Generator, bytes], bytes]
# What counts and sizes in binary headers become.
WORDS = (0, 1, 2**15, 2**31 - 1, 2**31, 2**32 - 1)
# What files grow to, bytes; and of how many places in them one is taken.
MOST, MOST_PLACES, MOST_TOML = 2 * 2**20, 20_000, 15_000
# What a bomb unpacks to, bytes: more than a case may take.
BOMB = 5 * 2**29
MOST_UNPACKED = 2**26
VALUES = (np.nan, np.inf, 1e308, 1e24, 1e39, -1.0, 0.0, 1e9, -(2.0**63), 1e-320)
DTYPES = ("f2", "f4", "f8", "i1", "i8", "u8", "?", "c16", "S3", "U9", "M8[s]", "m8[s]", "V7", "O")
MAGIC = {
    "png": b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR", "jpeg": b"\xff\xd8\xff\xe0\0\x10JFIF\0",
    "zip": b"PK\x03\x04\x14\0\0\0\x08\0", "npy": b"\x93NUMPY\x01\0\x76\0{'descr': '<f8'}",
    "glb": b"glTF\x02\0\0\0\x14\0\0\0", "mp4": b"\0\0\0\x18ftypisom", "pickle": b"\x80\x04\x95.",
    "gzip": b"\x1f\x8b\x08\0", "elf": b"\x7fELF\x02\x01\x01", "xml": b"<?xml version='1.0'?><a/>",
    "json": b'{"people": []}', "toml": b"[markers]\nfile = 'a'\n", "bvh": b"HIERARCHY\nROOT Hips\n",
    "trc": b"PathFileType\t4\t(X/Y/Z)\ta.trc\n", "yaml": b"%YAML:1.0\n---\n", "c3d": b"\x02\x50",
}  # fmt: skip


def one_of(rng: np.random.Generator, ways: dict[str, bytes] | dict[str, str]) -> bytes:
    """One of the ways."""
    way = ways[str(rng.choice(list(ways)))]
    return way if isinstance(way, bytes) else way.encode()


# Any file ----------------------------------------------------------------------------------------


def truncated(rng, content):
    """Cut off anywhere, most often near its beginning or end."""
    at = rng.choice([0, 1, 4, 12, rng.integers(len(content) + 1), max(0, len(content) - 1)])
    return content[: int(at)]


def flipped(rng, content):
    """A few bytes changed, half of them early, where headers are."""
    count = int(rng.choice([1, 3, 30]))
    held = bytearray(content or b"\0")
    for at in rng.integers(0, int(rng.choice([min(200, len(held)), len(held)])), count):
        held[at] ^= int(rng.integers(1, 256))
    return bytes(held)


def spliced(rng, content):
    """A slice inserted, doubled or deleted."""
    start, end = sorted(int(i) for i in rng.integers(0, len(content) + 1, 2))
    end = min(end, start + int(rng.choice([1, 8, 100, 5000])))
    part, how = content[start:end], rng.choice(["noise", "double", "delete"])
    new = {"noise": rng.bytes(end - start) + part, "double": part * 2, "delete": b""}[how]
    return content[:start] + new + content[end:]


def word_changed(rng, content):
    """Two or four bytes that may be a count become a huge one, or none."""
    at = int(rng.integers(0, max(1, min(len(content), int(rng.choice([64, 1024, 10**9]))) - 4)))
    word, order = WORDS[rng.integers(len(WORDS))], str(rng.choice(["<", ">"]))
    two = rng.random() < 0.4
    held = struct.pack(order + ("H" if two else "I"), min(word, 65535) if two else word)
    return content[:at] + held + content[at + len(held) :]


def other_content(rng, content):
    """Another format's beginning, whatever the suffix says."""
    begun = MAGIC[str(rng.choice(list(MAGIC)))]
    return begun + [b"", bytes(1000), content, rng.bytes(500)][rng.integers(4)]


def emptied(rng, content):
    """Nothing, or nothing to see."""
    ways = [b"", b"\n", b" " * 1000, bytes(4096), b"\xff" * 4096, b"\xef\xbb\xbf"]
    return ways[rng.integers(6)]


BYTES = (truncated, flipped, spliced, word_changed, other_content, emptied)

# Text --------------------------------------------------------------------------------------------


def recoded(rng, content):
    """A byte-order mark, other ends of lines, another encoding."""
    text, half, third = content.decode("latin-1"), len(content) // 2, len(content) // 3
    ways = {
        "BOM": b"\xef\xbb\xbf" + content,
        "two BOMs": b"\xef\xbb\xbf" * 2 + content,
        "CRLF": content.replace(b"\n", b"\r\n"),
        "CR": content.replace(b"\n", b"\r"),
        "UTF-16": text.encode("utf-16"),
        "UTF-32": text.encode("utf-32"),
        "no UTF-8": content[:half] + b"\xff\xfe\x80" + content[half:],
        "a surrogate": content[:third] + b"\xed\xa0\x80" + content[third:],
        "a NUL": content[:half] + b"\0" + content[half:],
        "form feeds": content.replace(b" ", b"\x0c"),
        "line separators": text.replace("\n", "\x85"),
    }
    return one_of(rng, ways)


def times(line: bytes, wanted: int) -> int:
    """How often a line may be repeated."""
    return max(1, min(wanted, MOST // max(1, len(line))))


def lines_changed(rng, content):
    """Lines doubled, deleted, swapped, joined, repeated, or long."""
    lines = content.split(b"\n")
    i, j = (int(k) for k in rng.integers(0, len(lines), 2))
    how = str(rng.choice(["double", "delete", "swap", "join", "many", "rest", "long"]))
    if how == "double":
        lines.insert(i, lines[j])
    elif how == "swap":
        lines[i], lines[j] = lines[j], lines[i]
    else:
        until = {"join": i + 2, "rest": len(lines)}.get(how, i + 1)
        many, long = [lines[i]] * times(lines[i], 3000), (lines[i] or b"a") * times(lines[i], 2000)
        new = {"join": [b"".join(lines[i : i + 2])], "many": many, "long": [long]}
        lines[i:until] = new.get(how, [])
    return b"\n".join(lines)


def numbers_changed(rng, content):
    """One number, or all of a line, become hostile ones."""
    pattern = rb"-?\d+(\.\d+)?([eE][+-]?\d+)?"
    actual = list(islice(re.finditer(pattern, content), MOST_PLACES))
    if not actual:
        return flipped(rng, content)
    # Headers come first and are few: half of the time one of the first.
    few = min(len(actual), int(rng.choice([8, 60, len(actual)])))
    match, number = actual[rng.integers(few)], hostile_number(rng)
    if rng.random() < 0.2:
        start = content.rfind(b"\n", 0, match.start()) + 1
        end = content.find(b"\n", match.start()) % (len(content) + 1)
        line = re.sub(rb"-?\d+(\.\d+)?", lambda _: number[:30].encode(), content[start:end])
        return content[:start] + line + content[end:]
    return content[: match.start()] + number.encode() + content[match.end() :]


def zeroed(rng, content):
    """From one of the lines on, all numbers behind a row's first two are zeros."""
    lines = content.split(b"\n")
    start, rows = int(rng.integers(len(lines))), rb"((?:[^\t, ]+[\t, ]+){2})(.*)"
    for i in range(start, len(lines)):
        if match := re.fullmatch(rows, lines[i]):
            lines[i] = match[1] + re.sub(rb"-?\d[\d.eE+-]*", b"0.0", match[2])
    return b"\n".join(lines)


def words_changed(rng, content):
    """A word becomes a hostile text."""
    actual = list(islice(re.finditer(rb"[A-Za-z_][\w.]*", content), MOST_PLACES))
    if not actual:
        return flipped(rng, content)
    match, text = actual[rng.integers(min(len(actual), 60))], hostile_text(rng)
    return content[: match.start()] + text.encode() + content[match.end() :]


def gap(rng, content):
    """The times of the last rows lie hours, or ages, after the others'."""
    lines, far = content.decode().split("\n"), float(rng.choice([7200.0, 1e5, 1e9, 1e15]))
    rows = [i for i, line in enumerate(lines) if re.match(r"(\d+\t)?\d+\.\d+[\t, ]", line)]
    for i in range(rows[len(rows) // 2] if rows else len(lines), len(lines)):
        lines[i] = re.sub(r"\d+\.\d+", lambda m: repr(float(m[0]) + far), lines[i], count=1)
    return "\n".join(lines).encode()


TEXT = (lines_changed, numbers_changed, numbers_changed, words_changed, recoded)

# Trees -------------------------------------------------------------------------------------------


def changed_tree(rng, tree):
    """A tree with one place changed, or with two."""
    for _ in range(int(rng.choice([1, 1, 2]))):
        change_tree(rng, tree)
    return tree


def toml_changed(rng, content):
    """Keys and values of other kinds."""
    if len(content) > MOST_TOML:
        # Keys of 100,000 parts take Python's own reader gigabytes.
        raise ValueError("too much to be taken apart")
    return as_toml(changed_tree(rng, tomllib.loads(content.decode())))


def toml_deep(rng, content):
    """Keys, arrays or tables many levels deep, or very many of them."""
    depth = int(rng.choice([101, 5000, 100_000]))
    ways = {
        "dotted key": "a" + ".a" * depth + " = 1\n",
        "arrays": "a = " + "[" * depth + "]" * depth + "\n",
        "tables": "a = " + "{a=" * depth + "1" + "}" * depth + "\n",
        "header": "[a" + ".a" * depth + "]\n",
        "whole number": f"a = {'9' * 5000}\n",
        "unclosed": 'a = "' + "x" * depth,
        "many keys": "".join(f"k{i} = {i}\n" for i in range(min(depth, 20_000))),
        "date": "a = 9999-99-99T99:99:99Z\n",
    }
    new = one_of(rng, ways)
    return new + content if rng.random() < 0.5 else content + b"\n" + new


def json_changed(rng, content):
    """Keys and values of other kinds."""
    return as_json(changed_tree(rng, json.loads(content)))


def json_deep(rng, content):
    """Deep brackets, alone or in place of a number."""
    depth = int(rng.choice([1000, 100_000]))
    deep = b"[" * depth + b"]" * depth
    return deep if rng.random() < 0.5 else re.sub(rb"\d+\.?\d*", lambda _: deep, content, count=1)


def yaml_changed(rng, content):
    """What YAML can do and OpenCV's never does."""
    text = content.decode()
    ways = {
        "continued": text.replace("data: [", "data: [ 1,\n" + "  1,\n" * 300_000, 1),
        "tag": text + "x: !!python/object/apply:os.system ['touch EVIL']\n",
        "aliases": text + "a: &a [1]\nb: [*a, *a]\n",
        "rows": re.sub(r"rows: \d+", f"rows: {rng.choice(NUMBERS)}", text, count=1),
        "sizes": text.replace("rows: 3", "sizes: [1000000000]", 1),
        "deep": text + "a: " + "[" * 100_000 + "\n",
        "many": text + "".join(f"k{i}: {i}\n" for i in range(50_000)),
        "colons": text + "a" + ": a" * 20_000 + "\n",
    }
    return one_of(rng, ways)


def xml_changed(rng, content):
    """Attributes with other values, and what XML can do and no calibration does."""
    text = content.decode()
    values = list(re.finditer(r'="[^"]*"', text))
    at = values[rng.integers(len(values))]
    before, after = text[: at.start()], text[at.end() :]
    if rng.random() < 0.6:
        held = hostile_number(rng) if rng.random() < 0.7 else hostile_text(rng)
        return f"{before}={quoteattr(held)}{after}".encode(errors="surrogatepass")
    grown = "".join(f'<!ENTITY a{i} "{f"&a{i - 1};" * 10}">' for i in range(1, 12))
    tag = re.sub(r"\W.*", "", text.lstrip("<"), flags=re.DOTALL)
    entities = f'<!DOCTYPE {tag} [<!ENTITY a0 "a">{grown}]>'
    many = "".join(f' b{i}="1"' for i in range(100_000))
    ways = {
        "entities": entities + text.replace('="', '="&a11;', 1),
        "a file": f'<!DOCTYPE {tag} [<!ENTITY x SYSTEM "file:///etc/passwd">]>{text}',
        "deep": text.replace("</", "<a>" * 50_000 + "</", 1),
        "attributes": text[: at.end()] + many + after,
        "spaces": before + '="' + "1 " * 500_000 + '"' + after,
        "namespace": text.replace(f"<{tag}", f'<{tag} xmlns="urn:a"', 1),
    }
    return one_of(rng, ways)


def bvh_changed(rng, content):
    """A hierarchy or a rate that no body has."""
    text, depth = content.decode(), int(rng.choice([500, 3000, 20_000]))
    joint = "JOINT a{} {{\nOFFSET 0 0 0\nCHANNELS 3 Zrotation Xrotation Yrotation\n"
    deep = "".join(joint.format(i) for i in range(depth)) + "End Site {\nOFFSET 0 0 0\n}\n"
    ways = {
        "deep": text.replace("End Site", deep + "}\n" * depth + "End Site", 1),
        "unclosed": text.replace("End Site", deep + "End Site", 1),
        "frames": re.sub(r"Frames:\s*\d+", f"Frames: {rng.choice(NUMBERS)}", text),
        "time": re.sub(r"Frame Time:.*", f"Frame Time: {rng.choice(NUMBERS)}", text),
        "long time": re.sub(r"Frame Time:.*", "Frame Time: 1e300", text),
        "channels": text.replace("CHANNELS 3", f"CHANNELS {rng.choice(NUMBERS)}", 1),
        "twice": text.replace("Xrotation", "Yrotation"),
        "no end": text.replace("}", "", int(rng.integers(1, 5))),
        "same name": re.sub(r"JOINT \w+", "JOINT same", text),
    }
    return one_of(rng, ways)


# Headers of binary formats -----------------------------------------------------------------------


def png_changed(rng, content):
    """A header that claims other sizes or depths; the checksum is right."""
    fields = list(struct.unpack_from(">IIBBBBB", content, 16))
    at = int(rng.integers(len(fields)))
    number = int(rng.choice([0, 1, 16, 30_000, 2**31 - 1, 2**32 - 1]))
    fields[at] = number % (2**32 if at < 2 else 256)
    head = b"IHDR" + struct.pack(">IIBBBBB", *fields)
    return content[:12] + head + struct.pack(">I", zlib.crc32(head)) + content[33:]


def png_bomb(rng, content):
    """30,000 × 30,000 pixels, all of them there."""
    side = int(rng.choice([10_000, 30_000]))
    head = b"IHDR" + struct.pack(">IIBBBBB", side, side, 1, 0, 0, 0, 0)
    data = b"IDAT" + zlib.compress(bytes(side * (1 + -(-side // 8))), 1)
    sealed = (
        struct.pack(">I", len(chunk) - 4) + chunk + struct.pack(">I", zlib.crc32(chunk))
        for chunk in (head, data, b"IEND")
    )
    return content[:8] + b"".join(sealed)


def jpeg_changed(rng, content):
    """Another height and width in the frame's header."""
    at = max(content.find(b"\xff\xc0"), content.find(b"\xff\xc2"))
    size = [int(n) for n in rng.choice([0, 1, 7, 65_535], 2)]
    return content[: at + 5] + struct.pack(">HH", *size) + content[at + 9 :]


def boxes_changed(rng, content):
    """A box of an MP4 file claims another size or content."""
    names = rb"ftyp|moov|mvhd|trak|tkhd|mdia|mdhd|minf|stbl|stsd|stts|stsc|stsz|stco|ctts|mdat|avc1"
    actual = [match.start() for match in re.finditer(names, content)]
    at = actual[rng.integers(len(actual))] + int(rng.choice([-4, 4, 8, 12, 16, 20, 24]))
    return content[:at] + struct.pack(">I", WORDS[rng.integers(len(WORDS))]) + content[at + 4 :]


def c3d_changed(rng, content):
    """A word of the header, or of the parameters behind it."""
    places = {
        "points": 2,
        "analogue": 4,
        "first": 6,
        "last": 8,
        "scale": 12,
        "data": 16,
        "rate": 20,
    }
    name = str(rng.choice([*places, "parameters"]))
    at = places.get(name, int(rng.integers(512, min(len(content), 3000))))
    new = struct.pack("<f", float(rng.choice([np.nan, np.inf, 1e38, 1e24, 1e-39, 0, -1])))
    if name not in ("scale", "rate"):
        new = struct.pack("<H", int(rng.choice([0, 1, 32_767, 65_535])))
    return content[:at] + new + content[at + len(new) :]


# Archives of arrays ------------------------------------------------------------------------------


class Evil:
    """Unpickled it leaves a file behind."""

    def __reduce__(self):
        return open, ("EVIL", "w")


def unpacked(content: bytes) -> dict[str, np.ndarray]:
    """Name -> array of an npz file."""
    with np.load(io.BytesIO(content)) as file:
        if sum(member.file_size for member in file.zip.infolist()) > MOST_UNPACKED:
            raise ValueError("too much to be taken apart")
        return dict(file)


def zipped(members: Iterable[tuple[str, bytes]]) -> bytes:
    """A zip file, of two members of a name if need be."""
    held = io.BytesIO()
    with zipfile.ZipFile(held, "w") as archive, warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        for name, content in members:
            archive.writestr(zipfile.ZipInfo(name), content)
    return held.getvalue()


def packed(arrays: dict[str, np.ndarray]) -> bytes:
    """An npz file; pickles where arrays hold objects."""
    return zipped((f"{name}.npy", npy(array)) for name, array in arrays.items())


def npy(array: np.ndarray) -> bytes:
    """An npy file."""
    held = io.BytesIO()
    np.lib.format.write_array(held, np.asarray(array), allow_pickle=True)
    return held.getvalue()


def npz_changed(rng, content):
    """One of the arrays is missing, called otherwise, or of another kind, shape or content."""
    arrays = unpacked(content)
    name = str(rng.choice(list(arrays)))
    how = str(rng.choice(["drop", "rename", "dtype", "shape", "values", "copy", "object", "none"]))
    if how == "drop":
        del arrays[name]
    elif how == "rename":
        arrays[f"../{name}"] = arrays.pop(name)
    elif how == "copy":
        arrays[name] = arrays[str(rng.choice(list(arrays)))]
    elif how == "object":
        arrays[name] = np.array([Evil()], object)
    elif how == "none":
        arrays = {}
    else:
        change = {"dtype": other_dtype, "shape": other_shape, "values": other_values}[how]
        arrays[name] = change(rng, arrays[name])
    return packed(arrays)


def other_dtype(rng, array):
    """The same numbers, or zeros, of another kind."""
    dtype = str(rng.choice(DTYPES))
    try:
        with np.errstate(all="ignore"):
            return array.astype(dtype)
    except (ValueError, TypeError):
        return np.zeros(array.shape, dtype)


def other_shape(rng, array):
    """Fewer or more of them, an axis more or less, or transposed."""
    flat = array.reshape(-1)
    shapes = [
        array[..., None], array[None], flat, array.T, array[:0] if array.ndim else flat[:0],
        flat[:1].reshape(()) if array.size else flat, np.concatenate([flat, flat]),
        array[1:] if array.ndim else flat, array[..., :-1] if array.ndim else flat,
        np.repeat(flat[:1], 300_000),
    ]  # fmt: skip
    return shapes[rng.integers(len(shapes))]


def other_values(rng, array):
    """One or all of them hostile; parents in a circle."""
    value = VALUES[rng.integers(len(VALUES))]
    new = np.array(array)
    if new.dtype.kind in "US":
        texts = np.array(["", "\0", "\x1b[31m", "x/../../../EVIL", "a" * 1000, new.flat[0]])
        return np.where(rng.random(new.shape) < 0.5, texts[rng.integers(len(texts))], new)
    at = np.ones(new.shape, bool) if rng.random() < 0.3 else rng.random(new.shape) < 0.1
    at.flat[rng.integers(max(1, at.size))] = True
    with np.errstate(all="ignore"):
        if rng.random() < 0.2:
            new[at] = np.flip(new)[at]
        elif rng.random() < 0.3 and new.ndim == 1:
            new = np.arange(new.size).astype(new.dtype)
        else:
            new[at] = np.asarray(value).astype(new.dtype)
    return new


def npz_archive(rng, content):
    """What an archive can be: encrypted, of two members of a name, an npy, another's."""
    arrays = unpacked(content)
    name = str(rng.choice(list(arrays)))
    one, swapped = npy(arrays[name]), lambda a: a.astype(a.dtype.newbyteorder(">"))
    claiming = _header("<f8", 2**34) + arrays[name].tobytes()[:4096]
    ways = {
        "encrypted": _headers_with(packed(arrays), 6, 1),
        "npy": one,
        "pickle": MAGIC["pickle"] + one,
        "twice": zipped((f"{n}.npy", npy(a)) for n, a in [*arrays.items(), *arrays.items()]),
        "method": _headers_with(packed(arrays), 8, 99),
        "nested": zipped([(f"{name}.npy", content)]),
        "header": zipped([(f"{name}.npy", one.replace(b"'shape': (", b"'shape': (-", 1))]),
        "big-endian": packed({n: swapped(a) for n, a in arrays.items()}),
        "fortran": packed({n: np.asfortranarray(a) for n, a in arrays.items()}),
        "huge": zipped((f"{n}.npy", claiming if n == name else npy(a)) for n, a in arrays.items()),
        "text": zipped([("readme.txt", b"no array"), (f"{name}.npy", b"no array either")]),
    }
    return one_of(rng, ways)


def npz_bomb(rng, content):
    """An array that unpacks to gigabytes, all of which are there."""
    arrays = unpacked(content)
    name, dtype = str(rng.choice(list(arrays))), str(rng.choice(["<f8", "|u1", "<U4"]))
    others = packed({other: array for other, array in arrays.items() if other != name})
    return _with_zeros(others, f"{name}.npy", _header(dtype, BOMB // np.dtype(dtype).itemsize))


def _header(dtype: str, count: int) -> bytes:
    held = io.BytesIO()
    fields = {"descr": dtype, "fortran_order": False, "shape": (count,)}
    np.lib.format.write_array_header_2_0(held, fields)
    return held.getvalue()


@cache
def _zeros() -> bytes:
    """``BOMB`` zeros deflated, some MB."""
    block = bytes(2**24)
    squeezer = zlib.compressobj(1, zlib.DEFLATED, -15)
    once = squeezer.compress(block) + squeezer.flush(zlib.Z_FULL_FLUSH)
    return once * (BOMB // len(block)) + b"\x03\0"


@cache
def _checksum(header: bytes) -> int:
    """Of a header and ``BOMB`` zeros."""
    block, checksum = bytes(2**24), zlib.crc32(header)
    for _ in range(BOMB // len(block)):
        checksum = zlib.crc32(block, checksum)
    return checksum


def _with_zeros(archive: bytes, name: str, header: bytes) -> bytes:
    """An archive and one more member: a header and ``BOMB`` zeros."""
    stored = struct.pack("<BHH", 0, len(header), len(header) ^ 0xFFFF) + header + _zeros()
    end = archive.rfind(b"PK\x05\x06")
    (count,) = struct.unpack_from("<H", archive, end + 10)
    directory_size, directory = struct.unpack_from("<II", archive, end + 12)
    sizes = struct.pack("<III", _checksum(header), len(stored), BOMB + len(header))
    # Version, flags, deflated, midnight of a day in 1980.
    fields = struct.pack("<HHHHH", 20, 0, 8, 0, 33) + sizes
    local = b"PK\3\4" + fields + struct.pack("<HH", len(name), 0) + name.encode() + stored
    entry = b"PK\1\2" + struct.pack("<H", 20) + fields
    entry += struct.pack("<HHHHHII", len(name), 0, 0, 0, 0, 0, directory) + name.encode()
    body = archive[:directory] + local + archive[directory : directory + directory_size] + entry
    counts = struct.pack("<HHHH", 0, 0, count + 1, count + 1)
    place = struct.pack("<II", directory_size + len(entry), directory + len(local))
    return body + b"PK\5\6" + counts + place + b"\0\0"


def _headers_with(archive: bytes, offset: int, value: int) -> bytes:
    """An archive whose members' headers, both of each, hold another number at an offset."""
    held = bytearray(archive)
    for match in re.finditer(b"PK\x01\x02|PK\x03\x04", archive):
        at = match.start() + offset + 2 * (match[0] == b"PK\x01\x02")
        struct.pack_into("<H", held, at, value)
    return bytes(held)


# Binary glTF -------------------------------------------------------------------------------------


def glb_parts(content: bytes) -> tuple[dict, bytes]:
    """The document of a binary glTF file and its block of numbers."""
    (length,) = struct.unpack_from("<I", content, 12)
    return json.loads(content[20 : 20 + length]), content[28 + length :]


def glb_of(text: bytes, block: bytes) -> bytes:
    """A binary glTF file of a document's text."""
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    chunks += struct.pack("<I4s", len(block), b"BIN\0") + block
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def glb_changed(rng, content):
    """Keys and values of other kinds; half of the time where the numbers are described."""
    document, block = glb_parts(content)
    part = str(rng.choice([*document, "accessors", "accessors", "bufferViews", "nodes", "skins"]))
    tree = document if rng.random() < 0.3 else {part: document.get(part, {})}
    change_tree(rng, tree)
    return glb_of(as_json({**document, **tree}), block)


def glb_nodes(rng, content):
    """Nodes in loops, diamonds, chains, and crowds; accessors without end; deep JSON."""
    document, block = glb_parts(content)
    nodes, depth = document["nodes"], int(rng.choice([40, 3000, 50_000]))
    how = str(rng.choice(["loop", "self", "diamond", "chain", "crowd", "count", "stride", "deep",
                          "offset", "weights", "same"]))  # fmt: skip
    first = len(nodes)
    if how == "loop":
        nodes[-1]["children"] = [0]
    elif how == "self":
        nodes[rng.integers(first)]["children"] = [int(rng.integers(first))]
    elif how in ("diamond", "chain", "crowd"):
        depth = min(depth, 3000) if how == "diamond" else depth
        below = {
            "diamond": [{"children": [first + i + 1] * 2} for i in range(depth)] + [{}],
            "chain": [{"children": [first + i + 1], "name": f"n{i}"} for i in range(depth)] + [{}],
            "crowd": [{"name": f"n{i}"} for i in range(depth)],
        }
        nodes += below[how]
        children = range(first, first + (depth if how == "crowd" else 1))
        nodes[0]["children"] = [*nodes[0].get("children", ()), *children]
    elif how == "count":
        for accessor in document["accessors"]:
            accessor["count"] = int(rng.choice([0, -1, 10**6, 10**9, 10**18]))
    elif how == "stride":
        document["bufferViews"][0] |= {"byteStride": int(rng.choice([0, 1, 252, 10**9]))}
    elif how == "offset":
        view = document["bufferViews"][rng.integers(len(document["bufferViews"]))]
        view["byteOffset"] = int(rng.choice([-1, -(10**6), 2**31, 10**18]))
    elif how == "weights":
        document["animations"] *= 2
        document["animations"][0]["channels"] *= 3000
    elif how == "same":
        document["skins"] = [{"joints": list(range(first)) * 100}]
    else:
        document["asset"] = "@raw@" + "[" * depth + "]" * depth + "@raw@"
    return glb_of(as_json(document), block)


XML, ROWS = (xml_changed, xml_changed, *TEXT), (*TEXT, gap, zeroed)
# Suffix -> mutations of such files, beside those of any file's bytes.
MUTATIONS: dict[str, tuple[Mutation, ...]] = {
    ".toml": (toml_changed, toml_changed, toml_changed, toml_deep, *TEXT),
    ".json": (json_changed, json_changed, json_deep, *TEXT),
    ".npz": (npz_changed, npz_changed, npz_changed, npz_archive, npz_bomb),
    ".glb": (glb_changed, glb_changed, glb_nodes),
    **dict.fromkeys((".trc", ".csv", ".mot"), ROWS),
    ".bvh": (bvh_changed, bvh_changed, *TEXT),
    ".yml": (yaml_changed, yaml_changed, *TEXT),
    ".c3d": (c3d_changed, c3d_changed),
    **dict.fromkeys((".txt", ".xcp", ".mcal"), XML),
    ".pickle": (word_changed,),
    ".png": (png_changed, png_changed, png_bomb),
    ".jpg": (jpeg_changed, jpeg_changed),
    ".mp4": (boxes_changed, boxes_changed, boxes_changed),
    ".rrd": (),
}
