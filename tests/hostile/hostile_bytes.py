"""Mutations of a file's bytes and lines, and of formats whose parts must be found first.

INPUTS: a random generator and a file's content. OUTPUTS: another content, and what was done.
"""

import json
import re
import struct
import tomllib
import zlib
from collections.abc import Callable
from itertools import islice
from xml.sax.saxutils import quoteattr

import numpy as np
from hostile_values import (
    NUMBERS,
    as_json,
    as_toml,
    brief,
    change_tree,
    hostile_number,
    hostile_text,
)

Mutated = tuple[bytes, str]
Mutation = Callable[[np.random.Generator, bytes], Mutated]
# What counts and sizes in binary headers become.
WORDS = (0, 1, 2**15, 2**31 - 1, 2**31, 2**32 - 1)
# What files grow to, bytes; and of how many places in them one is taken.
MOST, MOST_PLACES, MOST_TOML = 2 * 2**20, 20_000, 15_000
MAGIC = {
    "png": b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR", "jpeg": b"\xff\xd8\xff\xe0\0\x10JFIF\0",
    "zip": b"PK\x03\x04\x14\0\0\0\x08\0", "npy": b"\x93NUMPY\x01\0\x76\0{'descr': '<f8'}",
    "glb": b"glTF\x02\0\0\0\x14\0\0\0", "mp4": b"\0\0\0\x18ftypisom", "pickle": b"\x80\x04\x95.",
    "gzip": b"\x1f\x8b\x08\0", "elf": b"\x7fELF\x02\x01\x01", "xml": b"<?xml version='1.0'?><a/>",
    "json": b'{"people": []}', "toml": b"[markers]\nfile = 'a'\n", "bvh": b"HIERARCHY\nROOT Hips\n",
    "trc": b"PathFileType\t4\t(X/Y/Z)\ta.trc\n", "yaml": b"%YAML:1.0\n---\n", "c3d": b"\x02\x50",
}  # fmt: skip


def truncated(rng: np.random.Generator, content: bytes) -> Mutated:
    """Cut off anywhere, most often near its beginning or end."""
    at = int(rng.choice([0, 1, 4, 12, rng.integers(len(content) + 1), max(0, len(content) - 1)]))
    return content[:at], f"cut off after {at} bytes"


def flipped(rng: np.random.Generator, content: bytes) -> Mutated:
    """A few bytes changed, half of them early, where headers are."""
    count = int(rng.choice([1, 3, 30]))
    held = bytearray(content or b"\0")
    most = int(rng.choice([min(200, len(held)), len(held)]))
    for at in rng.integers(0, most, count):
        held[at] ^= int(rng.integers(1, 256))
    return bytes(held), f"{count} of the first {most} bytes changed"


def spliced(rng: np.random.Generator, content: bytes) -> Mutated:
    """A slice inserted, doubled or deleted."""
    start, end = sorted(int(i) for i in rng.integers(0, len(content) + 1, 2))
    end = min(end, start + int(rng.choice([1, 8, 100, 5000])))
    part = content[start:end]
    how = rng.choice(["noise", "double", "delete"])
    new = {"noise": rng.bytes(end - start) + part, "double": part * 2, "delete": b""}[how]
    return content[:start] + new + content[end:], f"{how} bytes {start} to {end}"


def word_changed(rng: np.random.Generator, content: bytes) -> Mutated:
    """Two or four bytes that may be a count become a huge one, or none."""
    at = int(rng.integers(0, max(1, min(len(content), int(rng.choice([64, 1024, 10**9]))) - 4)))
    word, order = WORDS[rng.integers(len(WORDS))], str(rng.choice(["<", ">"]))
    two = rng.random() < 0.4
    held = struct.pack(order + ("H" if two else "I"), min(word, 65535) if two else word)
    return content[:at] + held + content[at + len(held) :], f"{order}{word} at byte {at}"


def other_content(rng: np.random.Generator, content: bytes) -> Mutated:
    """Another format's beginning, whatever the suffix says."""
    name = str(rng.choice(list(MAGIC)))
    rest = [b"", bytes(1000), content, rng.bytes(500)][rng.integers(4)]
    return MAGIC[name] + rest, f"begins as {name}"


def emptied(rng: np.random.Generator, content: bytes) -> Mutated:
    """Nothing, or nothing to see."""
    new = [b"", b"\n", b" " * 1000, bytes(4096), b"\xff" * 4096, b"\xef\xbb\xbf"][rng.integers(6)]
    return new, f"only {brief(new)}"


def recoded(rng: np.random.Generator, content: bytes) -> Mutated:
    """A byte-order mark, other ends of lines, another encoding."""
    text = content.decode("latin-1")
    ways = {
        "BOM": b"\xef\xbb\xbf" + content,
        "two BOMs": b"\xef\xbb\xbf" * 2 + content,
        "CRLF": content.replace(b"\n", b"\r\n"),
        "CR": content.replace(b"\n", b"\r"),
        "UTF-16": text.encode("utf-16"),
        "UTF-32": text.encode("utf-32"),
        "no UTF-8": content[: len(content) // 2] + b"\xff\xfe\x80" + content[len(content) // 2 :],
        "a surrogate": content[: len(content) // 3]
        + b"\xed\xa0\x80"
        + content[len(content) // 3 :],
        "a NUL": content[: len(content) // 2] + b"\0" + content[len(content) // 2 :],
        "form feeds": content.replace(b" ", b"\x0c"),
        "line separators": text.replace("\n", "\x85").encode(),
    }
    name = str(rng.choice(list(ways)))
    return ways[name], name


BYTES = (truncated, flipped, spliced, word_changed, other_content, emptied)


def times(line: bytes, wanted: int) -> int:
    """How often a line may be repeated."""
    return max(1, min(wanted, MOST // max(1, len(line))))


def lines_changed(rng: np.random.Generator, content: bytes) -> Mutated:
    """Lines doubled, deleted, swapped, moved or repeated."""
    lines = content.split(b"\n")
    i, j = (int(k) for k in rng.integers(0, len(lines), 2))
    how = str(rng.choice(["double", "delete", "swap", "join", "many", "rest", "long"]))
    if how == "double":
        lines.insert(i, lines[j])
    elif how == "delete":
        del lines[i]
    elif how == "swap":
        lines[i], lines[j] = lines[j], lines[i]
    elif how == "join":
        lines[i : i + 2] = [b"".join(lines[i : i + 2])]
    elif how == "many":
        lines[i : i + 1] = [lines[i]] * times(lines[i], 3000)
    elif how == "rest":
        del lines[i:]
    else:
        lines[i] = (lines[i] or b"a") * times(lines[i], 2000)
    return b"\n".join(lines), f"{how} lines {i + 1} and {j + 1}"


def numbers_changed(rng: np.random.Generator, content: bytes) -> Mutated:
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
        return content[:start] + line + content[end:], f"a line's numbers = {brief(number)}"
    new = content[: match.start()] + number.encode() + content[match.end() :]
    return new, f"{match[0].decode()} at byte {match.start()} = {brief(number)}"


def zeroed(rng: np.random.Generator, content: bytes) -> Mutated:
    """From one of the lines on, all numbers behind a row's first two are zeros."""
    lines = content.split(b"\n")
    start, rows = int(rng.integers(len(lines))), rb"((?:[^\t, ]+[\t, ]+){2})(.*)"
    for i in range(start, len(lines)):
        if match := re.fullmatch(rows, lines[i]):
            lines[i] = match[1] + re.sub(rb"-?\d[\d.eE+-]*", b"0.0", match[2])
    return b"\n".join(lines), f"zeros from line {start + 1} on"


def words_changed(rng: np.random.Generator, content: bytes) -> Mutated:
    """A word becomes a hostile text."""
    actual = list(islice(re.finditer(rb"[A-Za-z_][\w.]*", content), MOST_PLACES))
    if not actual:
        return flipped(rng, content)
    match, text = actual[rng.integers(min(len(actual), 60))], hostile_text(rng)
    new = content[: match.start()] + text.encode() + content[match.end() :]
    return new, f"{match[0].decode()} at byte {match.start()} = {brief(text)}"


TEXT = (lines_changed, numbers_changed, numbers_changed, words_changed, recoded)


def toml_changed(rng: np.random.Generator, content: bytes) -> Mutated:
    """Keys and values of other kinds."""
    if len(content) > MOST_TOML:
        # Keys of 100,000 parts take Python's own reader gigabytes.
        raise ValueError("too much to be taken apart")
    tree = tomllib.loads(content.decode())
    done = [change_tree(rng, tree) for _ in range(int(rng.choice([1, 1, 2])))]
    return as_toml(tree), "; ".join(done)


def toml_deep(rng: np.random.Generator, content: bytes) -> Mutated:
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
    name = str(rng.choice(list(ways)))
    before = rng.random() < 0.5
    new = ways[name].encode()
    return (new + content if before else content + b"\n" + new), f"{name}, {depth}"


def json_changed(rng: np.random.Generator, content: bytes) -> Mutated:
    """Keys and values of other kinds."""
    tree = json.loads(content)
    done = [change_tree(rng, tree) for _ in range(int(rng.choice([1, 1, 2])))]
    return as_json(tree), "; ".join(done)


def json_deep(rng: np.random.Generator, content: bytes) -> Mutated:
    """Deep brackets, alone or in place of a number."""
    depth = int(rng.choice([1000, 100_000]))
    deep = b"[" * depth + b"]" * depth
    if rng.random() < 0.5:
        return deep, f"{depth} brackets"
    return re.sub(rb"\d+\.?\d*", lambda _: deep, content, count=1), f"{depth} brackets in it"


def png_changed(rng: np.random.Generator, content: bytes) -> Mutated:
    """A header that claims other sizes or depths; the checksum is right."""
    fields = list(struct.unpack_from(">IIBBBBB", content, 16))
    at = int(rng.integers(len(fields)))
    fields[at] = int(rng.choice([0, 1, 16, 30_000, 2**31 - 1, 2**32 - 1])) % (
        2**32 if at < 2 else 256
    )
    head = b"IHDR" + struct.pack(">IIBBBBB", *fields)
    sealed = head + struct.pack(">I", zlib.crc32(head))
    return content[:12] + sealed + content[33:], f"IHDR {fields}"


def png_bomb(rng: np.random.Generator, content: bytes) -> Mutated:
    """30,000 × 30,000 pixels, all of them there."""
    side = int(rng.choice([10_000, 30_000]))
    head = b"IHDR" + struct.pack(">IIBBBBB", side, side, 1, 0, 0, 0, 0)
    data = b"IDAT" + zlib.compress(bytes(side * (1 + -(-side // 8))), 1)
    chunks = [head, data, b"IEND"]
    sealed = (struct.pack(">I", len(c) - 4) + c + struct.pack(">I", zlib.crc32(c)) for c in chunks)
    return content[:8] + b"".join(sealed), f"{side} × {side} pixels"


def jpeg_changed(rng: np.random.Generator, content: bytes) -> Mutated:
    """Another height and width in the frame's header."""
    at = max(content.find(b"\xff\xc0"), content.find(b"\xff\xc2"))
    size = [int(n) for n in rng.choice([0, 1, 7, 65_535], 2)]
    return content[: at + 5] + struct.pack(">HH", *size) + content[at + 9 :], f"frame of {size}"


def boxes_changed(rng: np.random.Generator, content: bytes) -> Mutated:
    """A box of an MP4 file claims another size or content."""
    names = rb"ftyp|moov|mvhd|trak|tkhd|mdia|mdhd|minf|stbl|stsd|stts|stsc|stsz|stco|ctts|mdat|avc1"
    actual = [match.start() for match in re.finditer(names, content)]
    at = actual[rng.integers(len(actual))] + int(rng.choice([-4, 4, 8, 12, 16, 20, 24]))
    word = WORDS[rng.integers(len(WORDS))]
    return content[:at] + struct.pack(">I", word) + content[at + 4 :], f"{word} at byte {at}"


def c3d_changed(rng: np.random.Generator, content: bytes) -> Mutated:
    """A word of the header, or of the parameters behind it."""
    header = {
        "points": 2,
        "analogue": 4,
        "first": 6,
        "last": 8,
        "scale": 12,
        "data": 16,
        "rate": 20,
    }
    name = str(rng.choice([*header, "parameters"]))
    at = header.get(name, int(rng.integers(512, min(len(content), 3000))))
    new = struct.pack("<f", float(rng.choice([np.nan, np.inf, 1e38, 1e24, 1e-39, 0, -1])))
    if name not in ("scale", "rate"):
        new = struct.pack("<H", int(rng.choice([0, 1, 32_767, 65_535])))
    return content[:at] + new + content[at + len(new) :], f"{name}: {new.hex()} at byte {at}"


def bvh_changed(rng: np.random.Generator, content: bytes) -> Mutated:
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
    name = str(rng.choice(list(ways)))
    return ways[name].encode(), f"{name}, {depth}"


def yaml_changed(rng: np.random.Generator, content: bytes) -> Mutated:
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
    name = str(rng.choice(list(ways)))
    return ways[name].encode(), name


def xml_changed(rng: np.random.Generator, content: bytes) -> Mutated:
    """Attributes with other values, and what XML can do and no calibration does."""
    text = content.decode()
    values = list(re.finditer(r'="[^"]*"', text))
    at = values[rng.integers(len(values))]
    if rng.random() < 0.6:
        held = hostile_number(rng) if rng.random() < 0.7 else hostile_text(rng)
        changed = f"{text[: at.start()]}={quoteattr(held)}{text[at.end() :]}"
        return changed.encode(errors="surrogatepass"), f"a value {brief(held)}"
    grown = "".join(f'<!ENTITY a{i} "{f"&a{i - 1};" * 10}">' for i in range(1, 12))
    tag = re.sub(r"\W.*", "", text.lstrip("<"), flags=re.DOTALL)
    ways = {
        "entities": f'<!DOCTYPE {tag} [<!ENTITY a0 "a">{grown}]>'
        + text.replace('="', '="&a11;', 1),
        "a file": f'<!DOCTYPE {tag} [<!ENTITY x SYSTEM "file:///etc/passwd">]>{text}',
        "deep": text.replace("</", "<a>" * 50_000 + "</", 1),
        "attributes": text[: at.end()]
        + "".join(f' b{i}="1"' for i in range(100_000))
        + text[at.end() :],
        "spaces": text[: at.start()] + '="' + "1 " * 500_000 + '"' + text[at.end() :],
        "namespace": text.replace(f"<{tag}", f'<{tag} xmlns="urn:a"', 1),
    }
    name = str(rng.choice(list(ways)))
    return ways[name].encode(), name


def gap(rng: np.random.Generator, content: bytes) -> Mutated:
    """The times of the last rows lie hours, or ages, after the others'."""
    lines, far = content.decode().split("\n"), float(rng.choice([7200.0, 1e5, 1e9, 1e15]))
    rows = [i for i, line in enumerate(lines) if re.match(r"(\d+\t)?\d+\.\d+[\t, ]", line)]
    start = rows[len(rows) // 2] if rows else len(lines)
    for i in range(start, len(lines)):
        lines[i] = re.sub(r"\d+\.\d+", lambda m: repr(float(m[0]) + far), lines[i], count=1)
    return "\n".join(lines).encode(), f"a gap of {far:g} s"
