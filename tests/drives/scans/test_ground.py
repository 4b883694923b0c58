"""Ground points as bytes: nothing is lost, and nothing in a file is trusted."""

from __future__ import annotations

import struct
import zlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from interloc.drive import GroundPoints
from interloc.drives.scans.reduced_format import MAX_BYTES, MAX_POINTS, decode_ground, encode_ground
from interloc.errors import DriveError

FINITE = st.floats(width=32, allow_nan=False, allow_infinity=False, allow_subnormal=True)
NAME = "ground/labels/000003.ground"


def ground(count: int = 6, road: int = 4) -> GroundPoints:
    steps = np.arange(3 * count, dtype=np.float32).reshape(-1, 3)
    return GroundPoints(steps / 7 - 1, road)


def file(planes: bytes, *, count: int = 6, road: int = 4, magic: bytes = b"ILGP", version: int = 1) -> bytes:
    return struct.pack("<4sIII", magic, version, count, road) + zlib.compress(planes)


@given(st.data())
def test_every_finite_float_comes_back_bit_by_bit(data: st.DataObject) -> None:
    xyz = data.draw(arrays.arrays(np.float32, st.tuples(st.integers(0, 30), st.just(3)), elements=FINITE))
    road = data.draw(st.integers(0, len(xyz)))
    again = decode_ground(encode_ground(GroundPoints(xyz, road)), NAME)
    assert again.xyz.tobytes() == xyz.tobytes()
    assert (again.xyz.shape, again.xyz.dtype, again.road_count) == (xyz.shape, np.float32, road)


def test_zeros_of_either_sign_and_the_edges_of_floats() -> None:
    tiny, largest = np.finfo(np.float32).smallest_subnormal, np.finfo(np.float32).max
    xyz = np.array([[0.0, -0.0, tiny], [-tiny, largest, -largest]], np.float32)
    assert decode_ground(encode_ground(GroundPoints(xyz, 1)), NAME).xyz.tobytes() == xyz.tobytes()


def test_a_scan_without_ground() -> None:
    again = decode_ground(encode_ground(GroundPoints(np.empty((0, 3), np.float32), 0)), NAME)
    assert (again.xyz.shape, again.road_count) == ((0, 3), 0)


def test_the_bytes_are_those_of_the_format() -> None:
    """Two points, worked out by hand: bits of 1.0 are 3f800000, of 2.0 40000000; their difference is 00800000."""
    xyz = np.array([[1.0, 0.0, 2.0], [2.0, 0.0, 1.0]], np.float32)
    data = encode_ground(GroundPoints(xyz, 2))
    assert data[:16] == b"ILGP" + bytes([1, 0, 0, 0, 2, 0, 0, 0, 2, 0, 0, 0])
    x, y, z = (0x7F000000, 0x01000000), (0, 0), (0x80000000, 0x00FFFFFF)
    planes = [value >> shift & 0xFF for shift in (24, 16, 8, 0) for axis in (x, y, z) for value in axis]
    assert zlib.decompress(data[16:]) == bytes(planes)


def test_views_of_larger_arrays_are_written_too() -> None:
    xyz = np.arange(24, dtype=np.float32).reshape(6, 4)[:, :3]
    np.testing.assert_array_equal(decode_ground(encode_ground(GroundPoints(xyz, 6)), NAME).xyz, xyz)


@pytest.mark.parametrize(
    "points",
    [
        GroundPoints(np.zeros((3, 3), np.float64), 1),  # type: ignore[arg-type]
        GroundPoints(np.zeros((3, 4), np.float32), 1),
        GroundPoints(np.zeros((3, 3), np.float32), 4),
    ],
)
def test_what_is_no_scan_is_not_written(points: GroundPoints) -> None:
    with pytest.raises(ValueError, match=r"expected \(N, 3\) float32"):
        encode_ground(points)


def test_no_scan_is_that_large() -> None:
    with pytest.raises(ValueError, match="4,000,001 ground points; no scan has more than 4,000,000"):
        encode_ground(GroundPoints(np.zeros((MAX_POINTS + 1, 3), np.float32), 0))
    with pytest.raises(DriveError, match="is larger than 51 MB, which the ground points of one scan never are"):
        decode_ground(bytes(MAX_BYTES + 1), NAME)


SOUND = encode_ground(ground())
NAN = np.full((6, 3), 1.0, np.float32)
NAN[4, 1] = np.nan

DAMAGED = {
    "empty": (b"", r"is empty\. Usual cause: an upload or copy that did not finish"),
    "head only": (SOUND[:16], "holds 16 bytes; expected at least 24"),
    "cut short": (SOUND[:-30], r"is damaged: its 6 points unpack to \d+ of 72 bytes"),
    "checksum cut": (SOUND[:-1], "is damaged: the end of its 6 points is missing"),
    "one bit turned": (SOUND[:-1] + bytes([SOUND[-1] ^ 1]), "is damaged: .*incorrect data check"),
    "no zlib": (SOUND[:16] + b"\xff" * 20, "is damaged: .*incorrect header check"),
    "something behind": (SOUND + b"123", "3 bytes follow after its points"),
    "another kind of file": (b"PK\x03\x04" + SOUND[4:], r"starts with b'PK\\x03\\x04'; expected b'ILGP'"),
    "a later version": (file(bytes(72), version=2), "is of version 2; this InterLoc reads version 1"),
    "too many points": (file(b"", count=MAX_POINTS + 1), "promises 4,000,001 points; no scan has more than 4,000,000"),
    "more road than points": (file(bytes(72), road=7), "promises 7 road points among 6 points"),
    "fewer points than promised": (file(bytes(60)), "its 6 points unpack to 60 of 72 bytes"),
    "more points than promised": (file(bytes(84)), "its 6 points unpack to more than 72 bytes"),
    "points where none are promised": (file(bytes(12), count=0, road=0), "its 0 points unpack to more than 0 bytes"),
    "not finite": (encode_ground(GroundPoints(NAN, 6)), r"point 4 of 6 is not finite \(1, nan, 1\)"),
}


@pytest.mark.parametrize(("data", "words"), DAMAGED.values(), ids=DAMAGED)
def test_damage_is_named(data: bytes, words: str) -> None:
    with pytest.raises(DriveError, match=words) as caught:
        decode_ground(data, NAME)
    assert str(caught.value).startswith(f"{NAME}: ")


def test_a_bomb_is_not_unpacked() -> None:
    """64 MB of zeros behind a header of six points: no more than those are unpacked."""
    bomb = zlib.compress(bytes(1 << 26), level=1)
    with pytest.raises(DriveError, match="unpack to more than 72 bytes"):
        decode_ground(SOUND[:16] + bomb, NAME)


@given(st.integers(0, len(SOUND) - 1), st.integers(0, 255), st.booleans())
def test_whatever_byte_is_wrong_it_is_refused_or_harmless(at: int, byte: int, cut: bool) -> None:
    data = SOUND[:at] if cut else SOUND[:at] + bytes([byte]) + SOUND[at + 1 :]
    try:
        points = decode_ground(data, NAME)
    except DriveError as error:
        assert str(error).startswith(f"{NAME}: ")  # noqa: PT017 - both outcomes are right
    else:
        assert points.xyz.tobytes() == ground().xyz.tobytes()
        assert 0 <= points.road_count <= 6
