"""Pictures from files: their size is read before they are decoded, whatever the file states."""

import struct
import zlib
from contextlib import suppress
from functools import partial

import cv2
import numpy as np
import pytest
from conftest import measured_complaint, problem_of

from jaxmocap.capture.photographs import (
    is_picture_file,
    picture_size,
    read_empty_room,
    read_picture,
    write_picture,
)
from jaxmocap.formats.files.errors import InputError

complaint = partial(problem_of, read_picture)

PICTURE = np.random.default_rng(0).integers(0, 255, (30, 50, 3), np.uint8)
SUFFIXES = ("png", "jpg", "bmp", "tiff", "webp", "ppm", "gif")
# Generous: a decoded picture of 30000 x 30000 pixels takes 2700.
MOST_MB = 500


def content(suffix: str) -> bytes:
    return cv2.imencode(f".{suffix}", PICTURE)[1].tobytes()


def chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def huge_png(side: int = 30_000) -> bytes:
    """A valid picture, all black, of some kilobytes."""
    rows = zlib.compressobj(9)
    row = bytes(1 + side // 8)
    data = b"".join(rows.compress(row) for _ in range(side)) + rows.flush()
    header = struct.pack(">IIBBBBB", side, side, 1, 0, 0, 0, 0)
    parts = chunk(b"IHDR", header) + chunk(b"IDAT", data) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + parts


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_the_header_tells_the_size_that_the_decoder_finds(tmp_path, suffix):
    path = tmp_path / f"a.{suffix}"
    path.write_bytes(content(suffix))
    assert picture_size(content(suffix)) == (50, 30) and is_picture_file(path)
    assert read_picture(path).shape == (30, 50, 3)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_picture_that_is_cut_off_anywhere_is_refused_or_read(tmp_path, suffix):
    """A decoder may make up what is missing at the end; nothing else may happen."""
    path, intact = tmp_path / f"a.{suffix}", content(suffix)
    for end in (0, 1, 4, 11, 17, 25, 30, len(intact) // 2, len(intact) - 1):
        path.write_bytes(intact[:end])
        try:
            assert read_picture(path).shape == (30, 50, 3)
        except InputError as error:
            assert "is not an image that can be read" in error.problem


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_nothing_is_printed_of_damage_whatever_comes_of_it(tmp_path, capfd, suffix):
    path, intact, rng = tmp_path / f"a.{suffix}", content(suffix), np.random.default_rng(0)
    for place in rng.integers(0, len(intact), 60):
        path.write_bytes(intact[:place] + bytes([intact[place] ^ 0x55]) + intact[place + 1 :])
        with suppress(InputError):
            read_picture(path)
    assert capfd.readouterr() == ("", "")


def test_what_is_no_picture_is_refused(tmp_path):
    path = tmp_path / "a.png"
    path.write_bytes(b"")
    assert complaint(path) == "is not an image that can be read, it is empty"
    path.write_bytes(b"text")
    assert "expected PNG, JPEG, BMP, TIFF" in complaint(path)
    path.write_bytes(b"\xff\xd8" + b"\xff" * 100_000)
    assert "is not an image that can be read" in complaint(path)


def test_a_huge_picture_is_refused_before_it_is_decoded(tmp_path):
    path = tmp_path / "room.png"
    path.write_bytes(huge_png())
    message, size = measured_complaint(read_empty_room, path, "path, (640, 480)")
    problem = "found an image of 30000 x 30000 pixels, expected up to 50 million"
    assert message == f"{path}: {problem}" and size < MOST_MB


def test_an_empty_room_of_another_size_is_refused(tmp_path):
    (tmp_path / "room.png").write_bytes(content("png"))
    with pytest.raises(InputError, match="found 50 × 30 pixels, expected 640 × 480"):
        read_empty_room(tmp_path / "room.png", (640, 480))


def test_a_picture_that_is_written_is_read_back(tmp_path):
    path = write_picture(tmp_path / "a.png", PICTURE)
    np.testing.assert_array_equal(read_picture(path), PICTURE)
